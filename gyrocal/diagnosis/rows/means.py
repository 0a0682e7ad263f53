"""Rows that the layers are fitted to: the mean of each data set, ramps and soaks in bins of some tens of seconds.

What an effect does within a data set is looked for elsewhere (`within`); the length of a run hardly matters here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.series import Series
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, NORMAL_95

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Bins of ramps and soaks, s: short where the temperature moves fast, as long as it takes elsewhere.
_BIN_FAST_S, _BIN_SLOW_S = 20.0, 60.0
#: Chambers ramp at 0.5 to 5 degC/min; what is slower is the end of one.
_FAST_C_PER_MIN = 0.5
#: More bins than this are made longer: the cost of a fit grows with the cube of the rows.
_MOST_BINS = 150


@dataclass(frozen=True)
class Means:
    """Rows in time order; arrays of shape (n,).

    Attributes
    ----------
    from_s, to_s : when the row begins and ends; the same for a row of a table
    error_dps : gyro minus reference
    white_dps : relative size of the row's white noise
    group : row of these that each row of the series goes into, shape (rows of the series,)
    slope : of the output over the rate, where what changes the scale factor acts before an open loop's sine
    """

    series: Series
    t_s: Floats
    from_s: Floats
    to_s: Floats
    rate_dps: Floats
    gyro_dps: Floats
    temp_c: Floats
    white_dps: Floats
    is_set: Bools
    set_index: Ints
    supply_v: Floats | None
    since_power_on_s: Floats | None
    group: Ints
    slope: Floats | float = 1.0

    def __len__(self) -> int:
        return int(self.t_s.size)

    @property
    def error_dps(self) -> Floats:
        """Gyro minus reference, deg/s."""
        return self.gyro_dps - self.rate_dps

    @property
    def felt_dps(self) -> Floats:
        """What a change of the scale factor by 1 adds to the output, deg/s."""
        return self.slope * self.rate_dps

    def group_of(self, other: Means) -> Ints:
        """For each row here the row of `other` that it goes into, shape (n,): itself, or that of the series' rows."""
        return np.arange(len(self)) if other is self else other.group

    def spread(self, values: Floats) -> Floats:
        """Means over the rows here of values of the series' rows, shape (rows of the series,)."""
        return _mean(self.group, 1.0 / self.series.white_std_dps**2, values)


def means_of(series: Series) -> Means:
    """Data sets and bins of a recording."""
    group = _groups(series)
    weight = 1.0 / series.white_std_dps**2

    def mean(values: Floats) -> Floats:
        return _mean(group, weight, values)

    half = 0.5 * series.averaging_s
    first = np.unique(group, return_index=True)[1]
    size = int(group[-1]) + 1
    start = np.full(size, np.inf)
    end = np.full(size, -np.inf)
    np.minimum.at(start, group, series.t_s - half)
    np.maximum.at(end, group, series.t_s + half)
    return Means(
        series=series,
        t_s=mean(series.t_s),
        from_s=start,
        to_s=end,
        rate_dps=mean(series.rate_dps),
        gyro_dps=mean(series.gyro_dps),
        temp_c=mean(series.temp_c),
        white_dps=np.sqrt(1.0 / np.bincount(group, weight)),
        is_set=series.is_set[first],
        set_index=series.set_index[first],
        supply_v=None if series.supply_v is None else mean(series.supply_v),
        since_power_on_s=None if series.since_power_on_s is None else mean(series.since_power_on_s),
        group=group,
    )


def rows_of(series: Series) -> Means:
    """Every row of a series by itself."""
    half = 0.5 * series.averaging_s
    return Means(
        series,
        series.t_s,
        series.t_s - half,
        series.t_s + half,
        series.rate_dps,
        series.gyro_dps,
        series.temp_c,
        series.white_std_dps,
        series.is_set,
        series.set_index,
        series.supply_v,
        series.since_power_on_s,
        np.arange(len(series), dtype=np.int64),
    )


def angle_random_walk(series: Series) -> tuple[float, float, float] | None:
    """What neighbouring samples scatter by, as a walk of the angle with its 95 % interval, deg/sqrt(h); None where nothing says how long samples are."""
    if not np.all(series.averaging_s > 0):
        return None
    dps_per_rt_hz = float(np.median(series.white_std_dps * np.sqrt(series.averaging_s)))
    walk, spread = dps_per_rt_hz / DEG_PER_RT_H_TO_DPS_PER_RT_HZ, NORMAL_95 / np.sqrt(2.0 * len(series))
    return walk, walk * (1.0 - spread), walk * (1.0 + spread)


def _mean(group: Ints, weight: Floats, values: Floats) -> Floats:
    return np.asarray(np.bincount(group, weight * values) / np.bincount(group, weight))


def _groups(series: Series) -> Ints:
    """Number of the mean that each row of the series goes into, shape (rows,), without gaps and in order."""
    if series.is_table and np.ptp(series.rate_dps) > 0:
        return np.arange(len(series), dtype=np.int64)
    loose = np.ones(len(series), dtype=bool) if series.is_table else ~series.is_set
    share = np.diff(series.t_s, prepend=series.t_s[0])
    segment = np.zeros(len(series)) if series.is_table else series.set_index
    share[np.flatnonzero(np.diff(segment, prepend=-1))] = 0.0
    share /= np.where(np.abs(series.temp_rate_c_per_min) > _FAST_C_PER_MIN, _BIN_FAST_S, _BIN_SLOW_S)
    share /= max(1.0, float(np.sum(share[loose])) / _MOST_BINS)
    bins = np.floor(np.cumsum(share * loose) - 1e-9)
    changes = (np.diff(segment, prepend=-1) != 0) | (np.diff(bins, prepend=bins[0]) != 0)
    return np.asarray(np.cumsum(changes) - 1, dtype=np.int64)
