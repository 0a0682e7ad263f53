"""What a record gives the laws of the catalogue: conditions row by row, and the ranges that their shapes are tried in."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.series import Series
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.offer import Offer, turned_back_c
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Share of the data sets on either side of a jump at the least: fewer are as well off by themselves.
EDGE = 0.03


def conditions_of(series: Series) -> Conditions:
    """What the laws of the catalogue may depend on, row by row.

    Where it is not known when the gyro was switched on, that is when the clock or the record begins: a warm-up has the
    same shape whenever it is first seen.
    """
    since_on = series.since_power_on_s
    if since_on is None:
        since_on = series.t_s - series.switched_on_s
    return Conditions(
        t_s=series.t_s,
        rate_dps=series.rate_dps,
        temp_c=series.temp_c,
        angle_deg=series.angle_deg,
        supply_v=series.supply_v,
        since_power_on_s=since_on,
        since_step_s=series.since_set_s,
        step_dps=series.step_dps,
        temp_rate_c_per_s=series.temp_rate_c_per_min / S_PER_MIN,
        data_set_index=series.set_index.astype(np.float64),
        row_s=np.maximum(series.averaging_s, 0.1),
        sample_std_dps=0.0
        if series.is_table
        else float(np.max(series.white_std_dps[series.is_set], initial=0.0)),
    )


def offer_of(series: Series) -> Offer:
    """What a record offers the effects of the catalogue."""
    c, since_on = conditions_of(series), series.since_power_on_s
    return Offer(
        t_s=(float(series.t_s[0]), float(series.t_s[-1])),
        rates_dps=np.unique(np.round(series.rate_dps, 3)),
        largest_rate_dps=float(np.max(np.abs(series.rate_dps))),
        temp_c=(float(series.temp_c.min()), float(series.temp_c.max())),
        temp_span_c=float(np.ptp(series.history.temp_c)),
        temp_back_c=turned_back_c(series.history.temp_c),
        turn_starts_s=_between_turns(series),
        since_power_on_s=None if since_on is None else float(since_on.min()),
        channels=frozenset(f.name for f in fields(c) if getattr(c, f.name) is not None),
        lacking=series.untestable,
        supply_v=None if series.supply_v is None else float(np.median(series.supply_v)),
        continuous=not series.is_table and series.raw.samples > 0 and series.raw.lattice_dps is None,
    )


def _between_turns(series: Series) -> Floats:
    """Beginnings of data sets between the first and the last two turns of the table."""
    turning = np.flatnonzero(np.abs(series.rate_dps) > 0)
    if turning.size == 0:
        return np.empty(0)
    starts = series.t_s[np.flatnonzero(np.diff(series.set_index, prepend=-1))][1:] - 0.5
    sets = np.unique(series.set_index[turning])
    edge = min(max(2, round(EDGE * sets.size)), sets.size // 4)
    first = series.t_s[np.flatnonzero(series.set_index == sets[edge])[0]]
    last = series.t_s[np.flatnonzero(series.set_index == sets[-1 - edge])[-1]]
    return np.asarray(starts[(starts > first - 1.0) & (starts < last)])
