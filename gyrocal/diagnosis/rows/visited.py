"""Places that a record visited in temperature and rate: how many it can tell apart, and whether they tell of the scale factor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.means import Means
from gyrocal.physics.smooth import Frame
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Places in temperature from the lowest to the highest that a record may visit.
TEMP_BUMPS = 11
#: Temperatures that differ by less are one, degC.
LEAST_SPAN_C = 0.5


def visits_turned_at(rate_dps: Floats, temp_c: Floats) -> int:
    """How many visits to a temperature, one after the other, the gyro turned in."""
    return _count(temp_c[rate_dps != 0.0], temp_c)


def temperatures_told(temp_c: Floats) -> int:
    """How many temperatures a record tells apart: what scatters about two of them is no third."""
    return _count(np.sort(temp_c), temp_c)


def _count(temp_c: Floats, all_c: Floats) -> int:
    return int(np.unique(_visits(temp_c, all_c)).size)


def _visits(temp_c: Floats, all_c: Floats) -> Ints:
    """Number of the visit to a temperature that each of some rows belongs to, of all of a record."""
    return _each_beyond(temp_c, next_visit_c(all_c))


def next_visit_c(temp_c: Floats) -> float:
    """By how much two temperatures of a record differ that are not one visit, degC."""
    return max(LEAST_SPAN_C, float(np.ptp(temp_c)) / (TEMP_BUMPS - 1.0))


def _each_beyond(temp_c: Floats, apart_c: float) -> Ints:
    """Number of the stretch that each of some temperatures belongs to: one that is so far from where the last began begins a new one."""
    visits, last_c = list[int](), -np.inf
    for here_c in temp_c.tolist():
        new = abs(here_c - last_c) > apart_c
        last_c = here_c if new else last_c
        visits.append((visits[-1] if visits else 0) + new)
    return np.array(visits, dtype=np.int64)


def visits_tell(visits: int) -> bool:
    """Whether so many visits to a temperature tell what changes bias or scale factor beyond the surface: one, or five and more.

    Of four in turn the surface takes three numbers, and the last is as well a step as a lag, a branch or an order.
    """
    return visits == 1 or visits >= SHAPE[1] + 2


def turned(means: Means) -> Bools:
    """Rows that tell of the scale factor, shape (n,): at which it turned; none at one rate, where that is the bias as well."""
    return np.asarray((means.rate_dps != 0.0) & (np.ptp(means.rate_dps) > 0.0))


def tells_of_scale(means: Means) -> bool:
    """Whether the visits of a record in which it turned tell what changes the scale factor."""
    return visits_tell(_count(temperatures_turned(means), means.temp_c))


def tells_of_branches(temp_c: Floats) -> bool:
    """Whether visits to these temperatures, one after the other, tell what the bias remembers of where they turned back."""
    return visits_tell(_count(temp_c, temp_c))


def steps_of_scale(means: Means, fewest: int) -> Ints:
    """Rows at which it turned, and from which on a scale factor that had jumped could be told from the surface.

    Where the temperatures do not tell of it, those with so many others before and after at the same temperature.
    """
    turning = np.flatnonzero(turned(means))
    if tells_of_scale(means):
        return turning
    visits = _visits(means.temp_c[turning], means.temp_c)
    before = np.arange(turning.size) - np.searchsorted(visits, visits)
    after = np.searchsorted(visits, visits, side="right") - np.arange(turning.size)
    return np.asarray(turning[np.minimum(before, after) >= fewest])


def apart(coordinate: Floats, spacing: float) -> int:
    """How many places the record has visited, that bumps of this spacing can tell from each other."""
    return int(np.unique(np.round(coordinate / spacing)).size)


def temperatures_turned(means: Means) -> Floats:
    """The temperatures at which it turned, which tell of the scale factor, degC."""
    return np.asarray(means.temp_c[turned(means)])


def temperatures_apart(temp_c: Floats, frame: Frame, places: int = TEMP_BUMPS) -> int:
    """How many of the places of bumps over the temperature were visited: where it drifted by less than half of their distance, one."""
    spacing_c = 2.0 * frame.temp_scale_c / (places - 1.0)
    one_by_one = np.unique(_each_beyond(np.sort(temp_c), 0.5 * spacing_c)).size
    return min(apart(temp_c - frame.temp_center_c, spacing_c), int(one_by_one))
