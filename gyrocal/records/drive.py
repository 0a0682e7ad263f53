"""The drive log: what `replay` reads. Rows in time order, in blocks of bounded memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from gyrocal.errors import InputError, ProfileError
from gyrocal.records.columns import REQUIRED, UNITS, ColumnMap, ColumnRule
from gyrocal.records.csvio import Floats, format_columns, iterate_columns, read_header, require_columns

COLUMNS = (
    "t_s",
    "left_m",
    "right_m",
    "left_ticks",
    "right_ticks",
    "gyro_dps",
    "gyro_temp_c",
    "truth_x_m",
    "truth_y_m",
    "truth_heading_deg",
)
_CHUNK_ROWS = 200_000


@dataclass(frozen=True)
class DriveBlock:
    """Consecutive rows of a drive log, arrays of shape (n,); NaN where the log has none.

    Attributes
    ----------
    first_line : int
        Line of the first row in the file, for messages.
    t_s : ndarray, s
    left_m, right_m : ndarray, m
        Distance of each side since the row before.
    gyro_dps, gyro_temp_c : ndarray, deg/s, deg C
    truth_x_m, truth_y_m, truth_heading_deg : ndarray
        REP 103: x forward at the start when the truth is in the robot's frame; heading counter-clockwise.
    """

    first_line: int
    t_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    gyro_temp_c: Floats
    truth_x_m: Floats
    truth_y_m: Floats
    truth_heading_deg: Floats

    def __len__(self) -> int:
        return int(self.t_s.size)


def iterate_drive_log(
    path: Path,
    metres_per_tick: tuple[float, float] | None = None,
    columns: ColumnMap | None = None,
    chunk_rows: int = _CHUNK_ROWS,
) -> Iterator[DriveBlock]:
    """Yield the drive log `path` in blocks of at most `chunk_rows` rows.

    Parameters
    ----------
    metres_per_tick : (left, right), m
        From the robot file; needed when the log is in ticks.
    columns : ColumnMap, optional
        Mapping of a foreign log; None reads the columns of formats.md.

    Raises
    ------
    InputError
        A missing or unknown column, a cell that is text or infinite, time empty or going backwards, no rows.
    ProfileError
        The log is in ticks and the robot file has no ``metres_per_tick``.
    """
    header = read_header(path)
    rules = _native_rules(path, header) if columns is None else _foreign_rules(path, header, columns)
    scales = _tick_scales(path, rules, metres_per_tick)
    only = list(dict.fromkeys(rule.source for rule in rules.values()))
    last_t_s = -np.inf
    counters = {"left_m": np.nan, "right_m": np.nan}
    for first_line, raw in iterate_columns(path, header, chunk_rows, only):
        if raw[only[0]].size == 0:
            continue
        values = {name: _scaled(path, first_line, rule, raw[rule.source]) for name, rule in rules.items()}
        t_s = values["t_s"]
        _check_time(path, first_line, t_s, last_t_s)
        for side in ("left_m", "right_m"):
            values[side] = scales[side] * _steps(rules[side], values[side], t_s, last_t_s, counters, side)
        empty = np.full(t_s.shape, np.nan)
        yield DriveBlock(first_line, *(values.get(name, empty) for name in UNITS))
        last_t_s = t_s[-1]
    if last_t_s == -np.inf:
        raise InputError(f"{path}: has a header and no rows. Check that it was written to its end.")


def read_drive_log(
    path: Path, metres_per_tick: tuple[float, float] | None = None, columns: ColumnMap | None = None
) -> DriveBlock:
    """The whole drive log in memory; see `iterate_drive_log`."""
    return join(iterate_drive_log(path, metres_per_tick, columns))


def join(blocks: Iterable[DriveBlock]) -> DriveBlock:
    """Blocks that follow each other, as one."""
    parts = list(blocks)
    if len(parts) == 1:
        return parts[0]
    names = [f.name for f in fields(DriveBlock) if f.name != "first_line"]
    return DriveBlock(parts[0].first_line, *(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def cut(block: DriveBlock, rows: slice) -> DriveBlock:
    """Some rows of a block."""
    names = [f.name for f in fields(DriveBlock) if f.name != "first_line"]
    first_line = block.first_line + (rows.start or 0)
    return DriveBlock(first_line, *(getattr(block, name)[rows] for name in names))


def format_drive_log(log: DriveBlock, metres_per_tick: float | None = None) -> str:
    """CSV text of a drive log, in metres or in whole cumulative ticks; truth that is not there is left out."""
    columns: dict[str, tuple[Floats, str]] = {"t_s": (log.t_s, "%.4f")}
    for side, step_m in (("left", log.left_m), ("right", log.right_m)):
        if metres_per_tick is None:
            columns[f"{side}_m"] = (step_m, "%.6f")
        else:
            columns[f"{side}_ticks"] = (np.cumsum(np.round(step_m / metres_per_tick)), "%.0f")
    columns |= {
        "gyro_dps": (log.gyro_dps, "%.6f"),
        "gyro_temp_c": (log.gyro_temp_c, "%.3f"),
    }
    truth: dict[str, tuple[Floats, str]] = {
        "truth_x_m": (log.truth_x_m, "%.4f"),
        "truth_y_m": (log.truth_y_m, "%.4f"),
        "truth_heading_deg": (log.truth_heading_deg, "%.4f"),
    }
    columns |= {name: (v, fmt) for name, (v, fmt) in truth.items() if np.any(np.isfinite(v))}
    return format_columns(columns)


def _native_rules(path: Path, header: list[str]) -> dict[str, ColumnRule]:
    ticks = "left_ticks" in header or "right_ticks" in header
    left, right = ("left_ticks", "right_ticks") if ticks else ("left_m", "right_m")
    require_columns(path, header, ("t_s", left, right, "gyro_dps", "gyro_temp_c"), COLUMNS)
    if ticks and ("left_m" in header or "right_m" in header):
        raise InputError(f"{path}, line 1: has both ticks and metres. Remove one pair of columns.")
    unit = UNITS["left_m"]["ticks_total" if ticks else "m"]
    rules = {"left_m": ColumnRule(left, unit), "right_m": ColumnRule(right, unit)}
    plain = {name: next(iter(units.values())) for name, units in UNITS.items()}
    return rules | {
        name: ColumnRule(name, unit) for name, unit in plain.items() if name in header and name not in rules
    }


def _foreign_rules(path: Path, header: list[str], columns: ColumnMap) -> dict[str, ColumnRule]:
    for name, rule in columns.items():
        if rule.source not in header:
            found = ", ".join(header)[:200]
            raise InputError(
                f"{path}, line 1: column {rule.source!r}, mapped to {name}, is missing (found: {found})."
            )
    return {name: columns[name] for name in (*REQUIRED, *UNITS) if name in columns}


def _tick_scales(
    path: Path, rules: dict[str, ColumnRule], metres_per_tick: tuple[float, float] | None
) -> dict[str, float]:
    in_ticks = [side for side in ("left_m", "right_m") if rules[side].unit.ticks]
    if in_ticks and metres_per_tick is None:
        msg = f"{path}: is in ticks, and the robot file has no metres_per_tick; add metres_per_tick = [LEFT, RIGHT] there."
        raise ProfileError(msg)
    scale = dict(zip(("left_m", "right_m"), metres_per_tick or (1.0, 1.0), strict=True))
    return {side: scale[side] if side in in_ticks else 1.0 for side in scale}


def _scaled(path: Path, first_line: int, rule: ColumnRule, raw: Floats) -> Floats:
    infinite = np.flatnonzero(np.isinf(raw))
    if infinite.size:
        raise InputError(
            f"{path}, line {first_line + infinite[0]}: {rule.source} is infinite. Repair the log."
        )
    return rule.sign * (rule.unit.factor * raw + rule.unit.shift) + rule.offset


def _check_time(path: Path, first_line: int, t_s: Floats, before_s: float) -> None:
    bad = np.flatnonzero(~np.isfinite(t_s))
    if bad.size:
        raise InputError(f"{path}, line {first_line + bad[0]}: time is empty or not finite. Repair the log.")
    steps = np.diff(t_s, prepend=before_s)
    back = np.flatnonzero(steps < 0)
    if back.size:
        msg = f"{path}, line {first_line + back[0]}: time goes backwards by {-steps[back[0]]:.6g} s. Rows must be in time order; repair the log."
        raise InputError(msg)


def _steps(
    rule: ColumnRule, values: Floats, t_s: Floats, before_s: float, counters: dict[str, float], side: str
) -> Floats:
    """Distance since the row before; a running total keeps its last value in `counters` between blocks."""
    if rule.unit.speed:
        dt_s = np.diff(t_s, prepend=t_s[0] if before_s == -np.inf else before_s)
        return values * dt_s
    if not rule.unit.total:
        return values
    known = np.flatnonzero(np.isfinite(values))
    steps = np.zeros(values.shape)
    if np.isnan(counters[side]):  # never told: missing, not standing
        steps[: known[0] if known.size else None] = np.nan
    if known.size:
        first = values[known[0]] if np.isnan(counters[side]) else counters[side]
        # A counter that misses a row tells the whole distance at the next one: nothing is lost.
        steps[known] = np.diff(values[known], prepend=first)
        counters[side] = float(values[known[-1]])
    if rule.wrap is not None:
        half = 0.5 * rule.wrap * rule.unit.factor
        steps = (steps + half) % (2.0 * half) - half
    return steps
