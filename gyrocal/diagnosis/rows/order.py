"""The order of the data sets of a table without times, as a clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.visited import next_visit_c
from gyrocal.physics.offer import turned_back_c

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Stand-in for the time between data sets, s.
SURROGATE_PERIOD_S = 20.0
#: Data sets that stand for a leap of the temperature: with the stand-in above half an hour, as a chamber takes to get there and
#: to soak. Of eight tables with soaks of other lengths the evidence at 30 and at 100 was more than at none in seven.
LEAP_SETS = 100.0
#: A temperature that never turns back by more than this share of its range was seen once, early or late.
_TURNS_BACK = 0.1
#: Where leaps make up more than this share of the way that the temperature went, a chamber held it in between.
_MOST_OF_THE_WAY = 0.5


def leaps_before(temp_c: Floats) -> Bools:
    """Before which data sets the temperature leaps, by what takes a chamber far longer than one, shape (n,).

    Before none where it drifts as well: a pause in it is no soak.
    """
    way_c = np.abs(np.diff(temp_c, prepend=temp_c[0]))
    leaps = way_c > next_visit_c(temp_c)
    return leaps & (float(way_c[leaps].sum()) > _MOST_OF_THE_WAY * float(way_c.sum()))


def one_way(temp_c: Floats) -> bool:
    """Whether a temperature was gone through once, so that what time does looks like what it does."""
    return turned_back_c(temp_c) < _TURNS_BACK * float(np.ptp(temp_c))


def clock_s(temp_c: Floats) -> Floats:
    """Stand-ins for the times of data sets at these temperatures, s, shape (n,).

    In a plan that goes one way what happens while the temperature leaps looks like what that does itself: leaps take no time there.
    """
    sets = np.arange(temp_c.size, dtype=np.float64)
    if not one_way(temp_c):
        sets += LEAP_SETS * np.cumsum(leaps_before(temp_c))
    return SURROGATE_PERIOD_S * sets
