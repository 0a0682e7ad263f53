"""A recording through a coefficient file, to CSV: every sample, or every data set, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.provenance import check_sensor, naming, refuse_compensated
from gyrocal.errors import CoefficientError, DataError
from gyrocal.fusion.coefficients import (
    FLAG_NOT_FINITE,
    FLAG_RATE,
    FLAG_TEMPERATURE,
    FLAG_TERM,
    Coefficients,
    load_coefficients,
)
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.terms import Part
from gyrocal.records.datasets import DataSetTable, read_data_sets, switched_on_s
from gyrocal.records.files import check_output_file, writing_atomically
from gyrocal.records.run import Run, read_run
from gyrocal.records.scale import odd_order, odd_output, odd_temperature

Floats = NDArray[np.float64]

COLUMNS = ("segment", "t_s", "gyro_dps", "temp_c", "corrected_dps", "sigma_dps", "flag")
_ROW = "%d,%.6f,%.9g,%.6g,%.9f,%.3e,%d\n"

#: Flags of this file beside those of `Compensator.evaluate` (1 rate, 2 temperature, 4 not finite, 32 term).
FLAG_STATUS = 8
FLAG_HELD = 16
FLAGS = {
    FLAG_RATE: "rate outside the valid range",
    FLAG_TEMPERATURE: "temperature outside the valid range",
    FLAG_NOT_FINITE: "not finite, or no rate has this output",
    FLAG_STATUS: "bad status of the gyro",
    FLAG_HELD: "temperature held from an earlier sample",
    FLAG_TERM: "beyond what a term was fitted to",
}

_CHUNK_ROWS = 100_000
#: Entry of the provenance: seconds that stood for a data set where a table without times was diagnosed.
SECONDS_A_DATA_SET = "seconds_a_data_set"


@dataclass(frozen=True)
class ApplyConfig:
    """What to correct, with what, and where to write it."""

    recording: Path
    coefficients: Path
    output: Path
    counts_per_dps: float | None = None
    force_sensor: bool = False
    overwrite: bool = False


@dataclass
class Applied:
    """What was written: rows, how many carry each flag, terms, and what is worth knowing."""

    output: Path
    segments: int = 0
    rows: int = 0
    flagged_rows: int = 0
    flagged: dict[int, int] = field(default_factory=lambda: dict.fromkeys(FLAGS, 0))
    terms: tuple[str, ...] = ()
    not_applied: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def count(self, flags: NDArray[np.int64]) -> None:
        """Add a block's flags."""
        self.rows += flags.size
        self.flagged_rows += int(np.count_nonzero(flags))
        for bit in FLAGS:
            self.flagged[bit] += int(np.count_nonzero(flags & bit))

    def to_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "output": str(self.output),
            "segments": self.segments,
            "rows": self.rows,
            "flagged_rows": self.flagged_rows,
            "flagged": {FLAGS[bit]: n for bit, n in self.flagged.items()},
            "terms_applied": list(self.terms),
            "terms_of_the_bench_not_applied": list(self.not_applied),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _Block:
    """Samples of one stretch of the recording, arrays of shape (n,)."""

    segment: NDArray[np.int64]
    t_s: Floats
    gyro_dps: Floats
    temp_c: Floats
    supply_v: Floats
    bad_status: NDArray[np.bool_]


def apply_recording(config: ApplyConfig, report: Callable[[float, str], None]) -> Applied:
    """Correct a run directory or a table of data sets.

    Every gyro sample of every segment goes through, ramps and soaks too, in the order of time. A missing
    temperature is that of the last sample that had one, and flagged.

    Parameters
    ----------
    report : callable
        Told the share done and what is being read.

    Raises
    ------
    InputError, DataError, CoefficientError, OutputError
        Nothing is written then.
    """
    inputs = (config.recording, config.coefficients)
    check_output_file(config.output, overwrite=config.overwrite, inputs=inputs)
    coefficients = load_coefficients(config.coefficients)
    with naming(config.coefficients):
        compensator = Compensator(coefficients)
    names = tuple(dict.fromkeys(term.name for term in compensator.terms))
    applied = Applied(config.output, terms=names, not_applied=compensator.not_applied)
    if config.recording.is_dir():
        if config.counts_per_dps is not None:
            raise DataError(
                f"{config.recording}: a run is in deg/s already; --counts-per-dps is for tables. Leave it out."
            )
        run = read_run(config.recording)
        refuse_compensated(run)
        sensor, power_on_t_s, blocks = run.sensor.to_json(), run.power_on_t_s, _blocks_of_run(run, report)
        applied.segments = len(run.segments)
    else:
        table = read_data_sets(config.recording, config.counts_per_dps)
        _check_times(table, compensator)
        block = _block_of_table(table, coefficients)
        sensor, power_on_t_s, blocks = {}, switched_on_s(block.t_s), iter([block])
        applied.segments = table.rate_dps.size
    applied.notes = check_sensor(coefficients.sensor, sensor, config.recording, force=config.force_sensor)
    if not config.recording.is_dir():
        applied.notes += _odd_columns(table, block, coefficients, power_on_t_s, force=config.force_sensor)
        if any(term.has_memory or _since_on(term) for term in compensator.terms):
            applied.notes += tuple(f"{config.recording.name}: {note}" for note in table.clock_notes)
        applied.notes += tuple(
            f"{config.recording.name}: {name} counts from t_s = {power_on_t_s:g} s; a table does not say when the gyro was switched on"
            for name in dict.fromkeys(term.name for term in compensator.terms if _since_on(term))
        )
        if table.temp_rate_c_per_min is not None and any(term.has_memory for term in compensator.terms):
            applied.notes += (
                f"{config.recording.name}: temp_rate_c_per_min is not used; the rate of the temperature is that of temp_c from row to row, and the first row has none",
            )
    with writing_atomically(config.output) as file:
        file.write((",".join(COLUMNS) + "\n").encode())
        for text, flags in _corrected(blocks, compensator, power_on_t_s):
            file.write(text.encode())
            applied.count(flags)
    return applied


def _odd_columns(
    table: DataSetTable, block: _Block, coefficients: Coefficients, power_on_t_s: float | None, *, force: bool
) -> tuple[str, ...]:
    """Refuse columns in another unit, of another sign or in another's place; forced, notes.

    The output is asked corrected: its scale may be what the coefficients are for.
    """
    since = None if power_on_t_s is None else block.t_s - power_on_t_s
    # One of its own: a compensator remembers what went through it.
    compensator = Compensator(coefficients)
    corrected = compensator.evaluate(block.t_s, block.gyro_dps, block.temp_c, since, block.supply_v).rate_dps
    known = np.isfinite(corrected)
    scale = odd_output(table.rate_dps[known], corrected[known], ideal=True) if known.any() else None
    said = []
    odds = (
        odd_order(table.rate_dps, table.gyro_dps),
        scale if scale and scale.a_scale else None,
        odd_temperature(table.temp_c),
    )
    for odd in filter(None, odds):
        what = f"{table.source}: {'corrected, ' * odd.a_scale}{odd.what}"
        if not force:
            raise DataError(f"{what}. {odd.remedy}, or say --force-sensor.")
        said.append(f"{what} (--force-sensor)")
    return tuple(said)


def _corrected(
    blocks: Iterator[_Block], compensator: Compensator, power_on_t_s: float | None
) -> Iterator[tuple[str, NDArray[np.int64]]]:
    last_c = float("nan")
    for block in blocks:
        held, last_c = hold(block.temp_c, last_c)
        since = None if power_on_t_s is None else block.t_s - power_on_t_s
        result = compensator.evaluate(block.t_s, block.gyro_dps, held, since, block.supply_v)
        flags = result.flags | FLAG_STATUS * block.bad_status
        flags = flags | FLAG_HELD * (np.isnan(block.temp_c) & np.isfinite(held))
        columns = (block.segment, block.t_s, block.gyro_dps, block.temp_c, result.rate_dps, result.sigma_dps)
        yield _text((*columns, flags)), flags


def hold(values: Floats, last: float) -> tuple[Floats, float]:
    """NaN replaced by the last value before, `last` before the first; and the last of all."""
    if not values.size:
        return values, last
    rows = np.maximum.accumulate(np.where(np.isnan(values), -1, np.arange(values.size)))
    held = np.where(rows >= 0, values[rows], last)
    return held, float(held[-1])


def _text(columns: tuple[NDArray[Any], ...]) -> str:
    cells = [cell for row in zip(*(c.tolist() for c in columns), strict=True) for cell in row]
    text = (_ROW * columns[0].size) % tuple(cells)
    # An unknown number is an empty cell; no finite one contains these letters.
    return text.replace("nan", "").replace("-inf", "").replace("inf", "")


def _blocks_of_run(run: Run, report: Callable[[float, str], None]) -> Iterator[_Block]:
    last_v = float("nan")
    for number, record in enumerate(run.segments):
        report(number / len(run.segments), record.file)
        run.verify(record)
        for part in run.iterate_segment(record, _CHUNK_ROWS):
            segment = np.full(part.t_s.size, record.id, dtype=np.int64)
            supply_v, last_v = part.supply_held(last_v)
            yield _Block(segment, part.t_s, part.gyro_dps, part.gyro_temp_c, supply_v, part.status != 0)
    report(1.0, "")


def _block_of_table(table: DataSetTable, coefficients: Coefficients) -> _Block:
    """Rows of a table; where neither it nor the table of the coefficients has times, the order stands for time."""
    n = table.rate_dps.size
    each_s = float(coefficients.provenance.get(SECONDS_A_DATA_SET, np.nan))
    t_s: Floats = each_s * np.arange(n, dtype=np.float64) if table.t_s is None else table.t_s
    supply_v = np.full(n, np.nan)
    return _Block(
        np.arange(1, n + 1), t_s, table.gyro_dps, table.temp_c, supply_v, np.zeros(n, dtype=np.bool_)
    )


def _since_on(term: Part) -> bool:
    return "since_power_on_s" in term.channels


def _check_times(table: DataSetTable, compensator: Compensator) -> None:
    timed = [term.name for term in compensator.terms if term.has_memory or _since_on(term)]
    if timed and table.t_s is None and SECONDS_A_DATA_SET not in compensator.coefficients.provenance:
        raise CoefficientError(
            f"{table.source}: has no t_s, and {timed[0]} of the coefficients depends on time. "
            "Add the times, or use coefficients without that term."
        )
