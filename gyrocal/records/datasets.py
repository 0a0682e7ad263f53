"""Table of data sets: what other loggers can hand to `fit` and `diagnose`. One row a data set, in time order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrocal.errors import InputError
from gyrocal.records.csvio import Floats, format_columns, read_columns, read_header, require_columns
from gyrocal.units import S_PER_H

COLUMNS = ("rate_dps", "gyro_dps", "gyro_counts", "temp_c", "gyro_std_dps", "n", "t_s", "temp_rate_c_per_min")

ABSOLUTE_ZERO_C = -273.15
#: No table turns faster, deg/s.
_FASTEST_DPS = 1e5
#: A gyro that goes through more than so many °C needs at least a second for each.
_LEAST_SPAN_C, _FASTEST_C_PER_S = 5.0, 1.0
#: No record is longer: ten years, s.
_LONGEST_S = 3.2e8
#: Units that are taken for seconds, with how many make one: a data set takes a second at the least.
_SHORTER = {"nanoseconds": 1e9, "microseconds": 1e6}
#: A plan of several rates that stays longer at each, s, is one of days, or in milliseconds.
_LONG_STEP_S = 1e4
#: A plan of several rates whose fastest is slower, deg/s, is in another unit: the earth turns four times as fast.
_SLOWEST_DPS = 1e-3


@dataclass(frozen=True)
class DataSetTable:
    """Data sets as arrays, shape (n,); an optional column that the file does not have is None.

    ``rate_dps`` is the reference, ``gyro_dps`` the mean output, ``temp_c`` the mean gyro temperature.
    """

    source: Path
    rate_dps: Floats
    gyro_dps: Floats
    temp_c: Floats
    gyro_std_dps: Floats | None = None
    n: Floats | None = None
    t_s: Floats | None = None
    temp_rate_c_per_min: Floats | None = None
    counts_per_dps: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What is doubtful about the table, in words."""
        said = []
        if self.temp_c.size > 1 and np.ptp(self.temp_c) == 0:
            said.append(
                f"temp_c is {self.temp_c[0]:.4g} degC in every row: if no thermometer was read, what the temperature does passes "
                "for a drift; log the gyro's temperature"
            )
        return (*said, *self.clock_notes)

    @property
    def clock_notes(self) -> tuple[str, ...]:
        """That its times may be in milliseconds."""
        if self.t_s is None or np.ptp(self.rate_dps) == 0:
            return ()
        step_s = float(np.median(np.diff(self.t_s)))
        if step_s <= _LONG_STEP_S:
            return ()
        return (
            f"from one data set to the next t_s grows by {step_s:.6g} in the median, which is {step_s / S_PER_H:.3g} h if it is in "
            f"seconds; if it is in milliseconds, which makes it {step_s / 1e3:.4g} s, write it in seconds: all that hangs on time, "
            "drift and random walk is off otherwise",
        )


def read_data_sets(path: Path, counts_per_dps: float | None = None) -> DataSetTable:
    """Read a table of data sets.

    Parameters
    ----------
    counts_per_dps : float, optional
        Nominal scale; needed when, and only when, the file has ``gyro_counts`` for ``gyro_dps``.

    Raises
    ------
    InputError
        A missing or unknown column, a cell that is empty, infinite or text, a value that nothing has,
        time going backwards or standing still, no rows, or counts without their scale.
    """
    header = read_header(path)
    counts = "gyro_counts" in header
    require_columns(path, header, ("rate_dps", "gyro_counts" if counts else "gyro_dps", "temp_c"), COLUMNS)
    if counts and "gyro_dps" in header:
        raise InputError(f"{path}, line 1: has both gyro_dps and gyro_counts. Remove one of them.")
    if counts_per_dps is not None and not (counts_per_dps and np.isfinite(counts_per_dps)):
        raise InputError(
            f"--counts-per-dps: {counts_per_dps:g} is no scale. Give counts for each deg/s, its sign included."
        )
    if counts and counts_per_dps is None:
        raise InputError(
            f"{path}: is in counts; give the nominal scale with --counts-per-dps (its sign included)."
        )
    if not counts and counts_per_dps is not None:
        raise InputError(
            f"{path}: is in deg/s already; --counts-per-dps is for a gyro_counts column. Leave it out."
        )
    columns = read_columns(path, header)
    if columns["rate_dps"].size == 0:
        raise InputError(f"{path}: has a header and no rows. Check that it was written to its end.")
    for name, values in columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            msg = f"{path}, line {bad[0] + 2}: {name} is empty or not finite ({bad.size} such cells). Repair or remove the row."
            raise InputError(msg)
    _check_values(path, columns)
    _check_plan(path, columns)
    if "t_s" in columns:
        _check_times(path, columns["t_s"], several_rates=bool(np.ptp(columns["rate_dps"]) > 0))
        _check_seconds(
            path, float(np.ptp(columns["t_s"])), float(np.ptp(columns["temp_c"])), len(columns["t_s"])
        )
    gyro_dps = columns["gyro_counts"] / counts_per_dps if counts and counts_per_dps else columns["gyro_dps"]
    return DataSetTable(
        path,
        columns["rate_dps"],
        gyro_dps,
        columns["temp_c"],
        columns.get("gyro_std_dps"),
        columns.get("n"),
        columns.get("t_s"),
        columns.get("temp_rate_c_per_min"),
        counts_per_dps,
    )


def nominal_scales(paths: Sequence[Path], counts_per_dps: float | None) -> list[float | None]:
    """The nominal scale for each of several recordings: it belongs to the tables that are in counts.

    Raises
    ------
    InputError
        A scale is given, and no table is in counts.
    """
    counted = [_in_counts(path) for path in paths]
    if counts_per_dps is not None and not any(counted):
        raise InputError("None of the recordings is in counts; leave --counts-per-dps out.")
    return [counts_per_dps if counts else None for counts in counted]


def _in_counts(path: Path) -> bool:
    # What is wrong with a recording is said where it is read.
    try:
        return not path.is_dir() and "gyro_counts" in read_header(path)
    except InputError:
        return False


def _check_values(path: Path, columns: dict[str, Floats]) -> None:
    """Refuse values that no data set can have."""
    none = np.empty(0)
    n, std, temp, rate = (columns.get(name, none) for name in ("n", "gyro_std_dps", "temp_c", "rate_dps"))
    rules = (
        ("n", (n < 1) | (n != np.round(n)), "a whole number of samples, 1 or more, is wanted"),
        ("gyro_std_dps", std < 0, "a standard deviation is not negative"),
        ("temp_c", temp < ABSOLUTE_ZERO_C, "no temperature is that low"),
        ("rate_dps", np.abs(rate) > _FASTEST_DPS, "no table turns so fast (rates are deg/s)"),
    )
    for name, wrong, why in rules:
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{path}, line {row + 2}: {name} is {columns[name][row]:.6g}; {why}. Repair the row."
            )


def _check_plan(path: Path, columns: dict[str, Floats]) -> None:
    """Refuse a table of several rates that are in another unit."""
    rate = columns["rate_dps"]
    if np.ptp(rate) == 0:
        return
    fastest = float(np.max(np.abs(rate)))
    if fastest < _SLOWEST_DPS:
        raise InputError(
            f"{path}: the fastest rate_dps is {fastest:.3g}, which no plan of several rates has. Rates are deg/s: "
            "convert rate_dps and gyro_dps."
        )


def _check_times(path: Path, t_s: Floats, *, several_rates: bool) -> None:
    """Refuse times that go backwards, that are all one, or that two data sets at several rates share."""
    steps = np.diff(t_s)
    back = np.flatnonzero(steps < 0)
    if back.size:
        raise InputError(f"{path}, line {back[0] + 3}: time goes backwards. Rows must be in time order.")
    if steps.size and not steps.any():
        raise InputError(
            f"{path}: t_s is {t_s[0]:.6g} in every row. Write when each was recorded, or leave the column out."
        )
    same = np.flatnonzero(steps == 0)
    if same.size and several_rates:
        raise InputError(
            f"{path}, line {same[0] + 3}: t_s is {t_s[same[0]]:.6g} as in the line before, and no gyro records two data sets "
            f"at once (lines with the time of the one before: {same.size}). Write times that tell them apart, or leave the column out."
        )


def _check_seconds(path: Path, span_s: float, span_c: float, sets: int) -> None:
    """Refuse times in another unit: the gyro would warm faster, or the record last longer, than any does."""
    what = ""
    if span_c > _LEAST_SPAN_C and span_c > _FASTEST_C_PER_S * span_s > 0.0:
        what = f"temp_c goes through {span_c:.3g} degC within {span_s:.3g} s of t_s (hours, days?)"
    elif span_s > _LONGEST_S:
        unit = next((name for name, each in _SHORTER.items() if span_s > each * sets), "milliseconds")
        what = f"t_s goes through {span_s:.3g} s, which is years ({unit}?)"
    if what:
        raise InputError(f"{path}: {what}, which no record of a gyro does. Write t_s in seconds.")


def switched_on_s(t_s: Floats) -> float:
    """Instant that counts as switch-on in a table, which does not say it, s.

    That is the zero of its clock, as of a run's, where that is no longer ago than the table is long: a bench soaks before
    the first data set. A clock of another origin says nothing, and then it is the first row.
    """
    since_zero_s = float(t_s[0])
    return 0.0 if 0.0 <= since_zero_s <= np.ptp(t_s) else since_zero_s


def format_data_sets(table: DataSetTable) -> str:
    """CSV text of a table of data sets, always in deg/s."""
    columns: dict[str, tuple[Floats, str]] = {
        "rate_dps": (table.rate_dps, "%.6f"),
        "gyro_dps": (table.gyro_dps, "%.8f"),
        "temp_c": (table.temp_c, "%.4f"),
    }
    optional = (
        ("gyro_std_dps", table.gyro_std_dps, "%.8f"),
        ("n", table.n, "%.0f"),
        ("t_s", table.t_s, "%.3f"),
        ("temp_rate_c_per_min", table.temp_rate_c_per_min, "%.5f"),
    )
    columns |= {name: (values, fmt) for name, values, fmt in optional if values is not None}
    return format_columns(columns)
