"""A table of data sets as rows with coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.diagnosis.model.parts import design_at, slope_by_temperature
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.history import COARSEST_C, TemperatureHistory, temperature_history
from gyrocal.diagnosis.rows.nominal import at_nominal
from gyrocal.diagnosis.rows.order import clock_s
from gyrocal.diagnosis.rows.series import (
    BIN_LONG_S,
    OUTLIER_SIGMAS,
    Raw,
    Series,
    outliers,
    reach_of,
    sample_notes,
)
from gyrocal.errors import DataError
from gyrocal.inference.course import smooth_course
from gyrocal.inference.rounding import lattice, lattice_of_few, lattice_of_means
from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.physics.smooth import Frame
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.scale import copies
from gyrocal.units import STDS_PER_MAD, plural

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: A diagnosis of fewer rows says nothing: it takes a surface of eight terms, and some rows to see what that leaves.
FEWEST_ROWS = 12
#: Longer static logs are binned.
_LONG_LOG = 1000
#: A mean is not known better, deg/s: files round to that.
_LEAST_STD_DPS = 1e-7
#: Directions of a surface weaker than this are not carried.
_CARRIED = 1e-9
#: A course that misses readings by more than so many times what neighbours differ by is none of a thermometer: noise, which
#: scatters about its own course as neighbours do about each other, gives 1.
_MISSED = 3.0
#: Evidence that a thermometer's scatter is real, nats: where the gyro cannot tell it is noise, as it mostly is.
_REAL_NATS = 3.0
#: The same of a thermometer whose scatter somebody's simulation has row by row, to this share of it: whoever simulated took it for
#: the temperature, and the output has to tell only which of the two is likelier, by more than chance.
_REAL_BESIDE_NATS, _SAME_SCATTER = 1.0, 0.1
#: Steps of thermometers whose readings noise carries to and fro, so that means of them lie on no steps, degC; finer ones bend
#: no mean by as much as a gyro sees. And of how many readings a mean may be, the first for all steps.
_DITHERED_C, _READINGS = (1.0, 0.5, 0.25, 0.2, 0.1), (32.0, 4.0, 16.0, 64.0, 256.0)
#: Steps of what was read that are this much finer are those of a mean.
_STEPS_OF_MEAN = 8.0
#: Where it stays near a step this many times as long as mostly, a chamber holds it there.
_HELD = 3.0
#: Means of readings in steps lie near a step more often than this: of a straight course half of them.
_NEAR = 0.6
#: Where so many readings lose this much for each row, nats, no other number of them gains.
_HOPELESS = 0.8
#: Rates of which each was visited some times, as a share of the data sets; and data sets in which bias and scale factor hardly change.
_FEW_RATES, _STRETCH = 0.25, 12
#: Evidence that means are of such readings, nats: steps that nothing but a mean tells are rare.
_DITHERED_NATS = 5.0


def series_of_table(table: DataSetTable, partner: DataSetTable | None = None) -> Series:
    """Rows of a table of data sets; without time stamps the row number stands for time.

    A table at one rate is a static log: its rows are samples, so isolated ones that no noise makes are set aside
    before anything is averaged, by the rule for the samples of a run.

    Parameters
    ----------
    partner : what it is compared with, a simulation or a recording

    Raises
    ------
    DataError
        Too few rows.
    """
    n = table.rate_dps.size
    if n < FEWEST_ROWS:
        raise DataError(
            f"{table.source.name}: has {n} {plural(n, '[row|rows]')}; a diagnosis needs at least {FEWEST_ROWS}. "
            "Record longer."
        )
    t_s = clock_s(table.temp_c) if table.t_s is None else table.t_s
    one_rate = bool(np.ptp(table.rate_dps) == 0)
    wild = outliers(table.gyro_dps) if one_rate else np.zeros(n, dtype=bool)
    groups = _groups(t_s, binned=one_rate and table.t_s is not None and n > _LONG_LOG)
    count = np.bincount(groups[~wild], minlength=groups[-1] + 1).astype(np.float64)
    filled = count > 0

    def mean(values: Floats) -> Floats:
        total = np.bincount(groups[~wild], weights=values[~wild], minlength=count.size)
        return np.asarray(total[filled] / count[filled])

    white, states_noise, notes = _white(table)
    times, read = mean(t_s), mean(table.temp_c)
    rate, gyro, gathered = at_nominal(mean(table.rate_dps), mean(table.gyro_dps), partial(_free, temp_c=read))
    step_c = lattice_of_means(table.temp_c) or 0.0
    history, seen = _history(times, rate, gyro, read, count[filled], step_c, partner)
    course_c = history.temp_at(times)
    given = table.temp_rate_c_per_min
    return Series(
        name=table.source.name,
        t_s=times,
        gyro_dps=gyro,
        rate_dps=rate,
        temp_c=course_c,
        white_std_dps=np.sqrt(mean(white**2) / count[filled]),
        averaging_s=np.zeros(times.size),
        set_index=np.flatnonzero(filled) if groups[-1] + 1 == n else np.arange(times.size),
        is_set=np.ones(times.size, dtype=bool),
        temp_rate_c_per_min=history.rate_at(times) if given is None else mean(given),
        history=history,
        raw=_raw(table, t_s, wild, one_rate),
        untestable=_untestable(table),
        notes=(*table.notes, *gathered, *notes, *seen, *sample_notes(int(wild.sum()), table.temp_c)),
        has_time=table.t_s is not None,
        is_table=True,
        states_noise=states_noise,
        copies=copies(table.rate_dps, table.gyro_dps, table.temp_c, table.t_s),
        reach=reach_of(groups[~wild], table.gyro_dps[~wild], table.temp_c[~wild]),
    )


def _history(
    t_s: Floats,
    rate_dps: Floats,
    gyro_dps: Floats,
    read_c: Floats,
    count: Floats,
    step_c: float,
    partner: DataSetTable | None,
) -> tuple[TemperatureHistory, list[Remark]]:
    """The course of the temperature through readings, or the readings where no smooth course is behind them.

    And the steps that noise carried the readings to and fro of, if it is these that the course is seen through; or that it stands
    in the place of readings, where it is off them by more than their rounding.

    Parameters
    ----------
    partner : what the table is compared with
    """
    history = temperature_history(t_s, read_c, count, step_c)
    course_c = history.temp_at(t_s)
    noise_c = 0.0 if history.course is None else history.course.noise
    as_read = max(step_c, noise_c) > COARSEST_C or _missed(read_c, course_c, step_c)
    if as_read:
        return history.as_read(t_s, read_c), []
    history, dithered_c = _through_dither(history, t_s, read_c, count, step_c)
    course_c = history.temp_at(t_s)
    shared = (
        partner is not None
        and partner.temp_c.size == read_c.size
        and float(np.std(partner.temp_c - read_c)) < _SAME_SCATTER * float(np.std(read_c - course_c))
    )
    if _scatter_is_real(rate_dps, gyro_dps, read_c, course_c, shared=shared):
        return history.as_read(t_s, read_c), []
    if dithered_c is not None:
        return history, [Remark(Said.DITHERED, {"step_c": dithered_c})]
    rms_c = float(np.std(course_c - read_c))
    smoothed = rms_c > step_c / np.sqrt(12.0)
    return history, [Remark(Said.SMOOTHED, {"rms_c": rms_c})] if smoothed else []


def _through_dither(
    plain: TemperatureHistory, t_s: Floats, read_c: Floats, count: Floats, step_c: float
) -> tuple[TemperatureHistory, float | None]:
    """The course by means of readings in steps, and the steps, where that makes them likelier: such means lie near steps.

    So do those at the set points of a chamber: only what passes from step to step tells.
    """
    if plain.course is None or np.any(count > 1.0):
        return plain, None
    # Of a short table steps are not told, but that means would not all lie on them is.
    coarsest_c = lattice_of_few(read_c) or 0.0
    passing = {
        step: _passing(read_c, step)
        for step in _DITHERED_C
        if step >= _STEPS_OF_MEAN * max(step_c, coarsest_c)
    }
    passing = {
        s: rows for s, rows in passing.items() if rows.size >= FEWEST_ROWS and _near_steps(read_c[rows], s)
    }
    if not passing:
        return plain, None
    alone = plain.course.evidence

    def evidence(rows: Ints, step: float, readings: float) -> float:
        return smooth_course(t_s[rows], read_c[rows], np.full(rows.size, readings), step).evidence

    # Where all rows pass, the course without is at hand.
    without = {
        s: alone if rows.size == read_c.size else evidence(rows, step_c, 1.0) for s, rows in passing.items()
    }

    def gain(step: float, readings: float) -> float:
        return evidence(passing[step], step, readings) - without[step]

    first, *others = _READINGS
    gains = {step: gain(step, first) for step in passing}
    step = max(gains, key=lambda s: gains[s])
    if gains[step] < -_HOPELESS * passing[step].size:
        return plain, None
    by_count = {first: gains[step]} | {k: gain(step, k) for k in others}
    readings = max(by_count, key=lambda k: by_count[k])
    if by_count[readings] <= _DITHERED_NATS:
        return plain, None
    return temperature_history(t_s, read_c, readings * count, step), step


def _near_steps(read_c: Floats, step_c: float) -> bool:
    """Whether more than by a straight course lie in the half of each step that is around it."""
    off = np.abs(read_c / step_c - np.round(read_c / step_c))
    return bool(np.mean(off < 0.25) > _NEAR)


def _passing(read_c: Floats, step_c: float) -> Ints:
    """Rows in which a temperature passes from step to next step, and is not held at one."""
    near = np.round(read_c / step_c)
    first = np.flatnonzero(np.diff(near, prepend=np.nan) != 0.0)
    long = np.diff(np.append(first, near.size))
    leaps = np.abs(np.diff(near[first])) > 1.0
    beside = ~(np.append(False, leaps) | np.append(leaps, False))
    passing = beside & (long <= _HELD * np.median(long[beside])) if beside.any() else beside
    return np.flatnonzero(np.repeat(passing, long))


def _missed(read_c: Floats, course_c: Floats, step_c: float) -> bool:
    """Whether a smooth course misses readings by more than they scatter: a plan that leaps from temperature to temperature.

    By more, too, than they are rounded: the last digits of a file are steps as those of a thermometer are.
    """
    scatter_c = STDS_PER_MAD * float(np.median(np.abs(np.diff(read_c)))) / np.sqrt(2.0)
    scatter_c = max(scatter_c, step_c / np.sqrt(12.0))
    off_c = STDS_PER_MAD * float(np.median(np.abs(read_c - course_c)))
    # Set points that repeat scatter by nothing, and a course through them is off by a rounding.
    return bool(np.round(off_c, 9) > _MISSED * scatter_c)


def _scatter_is_real(
    rate_dps: Floats, gyro_dps: Floats, read_c: Floats, course_c: Floats, *, shared: bool
) -> bool:
    """Whether the gyro follows a thermometer where it scatters about its smooth course.

    Then the scatter is the temperature's; what is the thermometer's own the gyro knows nothing of.

    Parameters
    ----------
    shared : whether a simulation has that scatter, too
    """
    frame = _frame(rate_dps, course_c)
    columns, error = design_at(rate_dps, course_c, frame), gyro_dps - rate_dps
    surface: Floats = np.asarray(np.linalg.lstsq(columns, error, rcond=_CARRIED)[0], dtype=np.float64)
    left = np.abs(error - columns @ surface)
    sound = left <= OUTLIER_SIGMAS * STDS_PER_MAD * np.median(left)
    along = (read_c - course_c) * slope_by_temperature(rate_dps, course_c, frame, surface)
    by_surface, by_all = (
        _nats_of_following(along[sound], error[sound], free[sound])
        for free in (columns, _free(rate_dps, course_c))
    )
    # Physics that the simulation lacks, which is asked for here, the surface alone would leave in the way.
    return max(by_surface, by_all) > _REAL_NATS or (shared and by_all > _REAL_BESIDE_NATS)


def _frame(rate_dps: Floats, temp_c: Floats) -> Frame:
    low, high = float(temp_c.min()), float(temp_c.max())
    return Frame(float(np.abs(rate_dps).max()) or 1.0, 0.5 * (low + high), max(0.5 * (high - low), 0.5))


def _free(rate_dps: Floats, temp_c: Floats) -> Floats:
    """Columns of all that an output may do over rate, temperature and stretches of time, shape (n, p)."""
    surface = design_at(rate_dps, temp_c, _frame(rate_dps, temp_c))
    return np.column_stack([surface, *_beyond_surface(rate_dps)])


def _nats_of_following(along: Floats, error: Floats, columns: Floats) -> float:
    """Evidence that an error follows what a scatter of the temperature makes of it, beside columns that are free, nats."""
    size = np.linalg.norm(columns, axis=0)
    basis = linalg.orth(columns[:, size > 0.0] / size[size > 0.0], rcond=_CARRIED)
    freedom = error.size - basis.shape[1]
    x, y = (values - basis @ (basis.T @ values) for values in (along, error))
    without, within = float(y @ y), float((y - x) @ (y - x))
    return 0.5 * freedom * float(np.log(without / within)) if freedom > 0 and within > 0.0 else 0.0


def _beyond_surface(rate_dps: Floats) -> Iterator[Floats]:
    """Columns of what a surface may leave and would hide the scatter: any law of the rate, the way that it came, and what bias and scale factor do in time."""
    rates, rate = np.unique(np.round(rate_dps, 2), return_inverse=True)
    if rates.size > _FEW_RATES * rate_dps.size:
        return
    yield np.sign(np.diff(rate_dps, prepend=0.0))
    stretch = np.arange(rate_dps.size) // _STRETCH
    for number in (rate, stretch):
        yield from (number == np.unique(number)[:, None]).astype(np.float64)
    yield from np.where(stretch == np.unique(stretch)[:, None], rate_dps, 0.0)


def _groups(t_s: Floats, binned: bool) -> Ints:
    """Row to bin, shape (n,)."""
    if not binned:
        return np.arange(t_s.size)
    return np.unique((t_s - t_s[0]) // BIN_LONG_S, return_inverse=True)[1].astype(np.int64)


def _white(table: DataSetTable) -> tuple[Floats, bool, list[Remark]]:
    """White noise of each row, whether in deg/s or all alike, and what is odd about what the table says of it."""
    notes = []
    if table.t_s is not None:
        same = int(np.count_nonzero(np.diff(table.t_s) == 0))
        if same:
            notes.append(Remark(Said.SAME_TIMES, {"count": same}))
    if table.gyro_std_dps is None or table.n is None:
        return np.ones(table.rate_dps.size), False, notes
    several = table.n > 1
    none = several & (table.gyro_std_dps == 0)
    if none.any():
        notes.append(Remark(Said.NO_SPREAD, {"count": int(none.sum())}))
    known = several & ~none
    if not known.any():
        return np.ones(table.rate_dps.size), False, notes
    std = np.where(known, table.gyro_std_dps, np.median(table.gyro_std_dps[known]))
    return np.maximum(std / np.sqrt(np.maximum(table.n, 1.0)), _LEAST_STD_DPS), True, notes


def _raw(table: DataSetTable, t_s: Floats, wild: Bools, one_rate: bool) -> Raw:
    kept = table.gyro_dps[~wild]
    if not one_rate:
        # Means of data sets at many rates lie on no lattice that says anything of a sample.
        return Raw(np.empty(0), np.empty(0), t_s.size)
    neighbours = np.interp(t_s[wild], t_s[~wild], kept)
    return Raw(
        outliers_t_s=t_s[wild],
        outliers_dps=table.gyro_dps[wild] - neighbours,
        samples=t_s.size,
        sample_std_dps=float(np.std(np.diff(kept)) / np.sqrt(2.0)),
        lattice_dps=lattice(kept),
    )


def _untestable(table: DataSetTable) -> dict[str, Reason]:
    found: dict[str, Reason] = {
        "table_angle": Lack(Why.TABLE_NO_ANGLE),
        "supply": Lack(Why.TABLE_NO_SUPPLY),
        "time_since_power_on": Lack(Why.TABLE_NO_POWER_ON),
        "time_since_step": Lack(Why.TABLE_NO_SAMPLES),
    }
    if table.t_s is None:
        found["time"] = Lack(Why.UNTIMED_ORDER)
    return found
