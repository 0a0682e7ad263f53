"""Plain logs of a gyro that stands, or turns at one rate, for hours: CSV, PX4 ULog, ArduPilot; in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrocal.errors import InputError
from gyrocal.records.columns import MAP_THEM, ColumnMap, mapped_header, scaled
from gyrocal.records.csvio import Floats, iterate_columns, read_header, require_columns
from gyrocal.records.recognise import other_table
from gyrocal.records.timeline import Timeline, usual_step

COLUMNS = ("t_s", "gyro_dps", "temp_c", "rate_dps")
#: Columns of the run directory that a plain log may have as well; nothing is made of them here.
_PASSED_OVER = ("status", "chamber_temp_c", "supply_v")
#: Name in a mapping of columns -> ours.
_MAPPED: Mapping[str, str] = {"t_s": "t_s", "gyro_dps": "gyro_dps", "gyro_temp_c": "temp_c"}
_CHUNK_ROWS = 500_000
_HEAD_ROWS = 1000


@dataclass(frozen=True)
class StaticBlock:
    """Consecutive samples of one segment, arrays of shape (n,).

    Attributes
    ----------
    first_line : int
        Line of the first sample in the file (CSV), or its number from 1.
    segment : int
        Blocks of one segment follow each other; a step of the clock begins another.
    t_s, gyro_dps : ndarray, s, deg/s
        NaN where the sample is missing.
    temp_c, rate_dps : ndarray, deg C, deg/s
        Temperature, and the rate at which the table turned; NaN where the log has none.
    usual_dt_s : float, s
        Median step of the first rows of the log.
    notes : tuple of str
        Where the clock stepped just before this block, in words.
    """

    first_line: int
    segment: int
    t_s: Floats
    gyro_dps: Floats
    temp_c: Floats
    rate_dps: Floats
    usual_dt_s: float
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.t_s.size)


def iterate_static_log(
    path: Path, chunk_rows: int = _CHUNK_ROWS, mapping: ColumnMap | None = None
) -> Iterator[StaticBlock]:
    """Yield the CSV log `path` (``t_s, gyro_dps`` and perhaps ``temp_c, rate_dps``) in blocks of bounded memory.

    With `mapping` it is a foreign log, of which time, gyro and temperature are read.

    Raises
    ------
    InputError
        A missing or unknown column, a cell that is text or infinite, time that is empty, going backwards or not in
        seconds, no rows.
    """
    chunk_rows = max(chunk_rows, _HEAD_ROWS)
    blocks = _own_columns(path, chunk_rows) if mapping is None else _mapped_columns(path, chunk_rows, mapping)
    timeline: Timeline | None = None
    for first_line, columns in blocks:
        if columns["t_s"].size == 0:
            continue
        if timeline is None:
            usual_dt_s = _usual_step(path, columns, mapped=mapping is not None)
            timeline = Timeline(path, usual_dt_s, closes=False)
        yield from cut_at_steps(timeline, first_line, columns)
    if timeline is None:
        raise InputError(f"{path}: has a header and no rows. Check that it was written to its end.")


def _usual_step(path: Path, columns: dict[str, Floats], *, mapped: bool) -> float:
    """Usual time step of a log, s; refuses one in which no time passes, and a table of data sets, whose rows are minutes apart."""
    t_s = columns["t_s"][:_HEAD_ROWS]
    try:
        usual_dt_s = usual_step(path, t_s, mapped=mapped)
    except InputError as error:
        says = other_table(list(columns), ("t_s", "gyro_dps"))
        if says and np.unique(columns["rate_dps"]).size > 1:
            raise InputError(f"{path}: {says}") from error
        raise
    if t_s.size > 1 and np.ptp(t_s) == 0.0:
        raise InputError(f"{path}: t_s is {t_s[0]:.6g} in every row. Log the time of each sample.")
    return usual_dt_s


def _own_columns(path: Path, chunk_rows: int) -> Iterator[tuple[int, dict[str, Floats]]]:
    header = read_header(path)
    require_columns(path, header, ("t_s", "gyro_dps"), (*COLUMNS, *_PASSED_OVER), MAP_THEM)
    only = [name for name in COLUMNS if name in header]
    for first_line, columns in iterate_columns(path, header, chunk_rows, only):
        _refuse_infinite(path, first_line, columns)
        yield first_line, columns


def _mapped_columns(
    path: Path, chunk_rows: int, mapping: ColumnMap
) -> Iterator[tuple[int, dict[str, Floats]]]:
    rules = {own: mapping[name] for name, own in _MAPPED.items() if name in mapping}
    if any(rule.file is not None for rule in rules.values()):
        raise InputError(f"{path}: its temperature is mapped to another file, and one file is read here.")
    header = mapped_header(path, rules)
    only = list(dict.fromkeys(rule.source for rule in rules.values()))
    for first_line, raw in iterate_columns(path, header, chunk_rows, only):
        yield first_line, {name: scaled(path, first_line, rule, raw) for name, rule in rules.items()}


def cut_at_steps(timeline: Timeline, first_line: int, columns: dict[str, Floats]) -> Iterator[StaticBlock]:
    """The rows of `columns` (`COLUMNS`, the last two if there) as blocks, none of which spans a step of the clock."""
    t_s, segments, said = timeline.take(first_line, columns["t_s"])
    nothing = np.full(t_s.shape, np.nan)
    c = {name: columns.get(name, nothing) for name in COLUMNS}
    cuts = np.flatnonzero(np.diff(segments)) + 1
    # A step may lie before the very first row; then each sentence belongs to one block, else to all but the first.
    spoken = [*said] if len(said) > cuts.size else [None, *said]
    for start, stop, note in zip([0, *cuts], [*cuts, t_s.size], spoken, strict=True):
        rows = slice(int(start), int(stop))
        yield StaticBlock(
            first_line + int(start),
            int(segments[start]),
            c["t_s"][rows],
            c["gyro_dps"][rows],
            c["temp_c"][rows],
            c["rate_dps"][rows],
            timeline.usual_dt_s,
            () if note is None else (note,),
        )


def _refuse_infinite(path: Path, first_line: int, columns: dict[str, Floats]) -> None:
    for name, values in columns.items():
        bad = np.flatnonzero(np.isinf(values))
        if bad.size:
            raise InputError(f"{path}, line {first_line + bad[0]}: {name} is infinite. Repair the log.")
