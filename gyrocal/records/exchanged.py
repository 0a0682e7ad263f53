"""Rate and output of a table in each other's place: the output comes to a plan's rates again, nearer than the rates do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A plan has so many rates at least, each so often.
_FEWEST_PLANNED, _REPEATS = 3, 2.0
#: Gaps between rates are wider than those between readings of one rate by this factor, and what a gyro says at one rate
#: spreads by more than these readings by as much.
_APART = 5.0
#: Means of equal numbers are off by no more, deg/s.
_ROUNDING_DPS = 1e-9


def exchanged_text(rate_dps: Floats, gyro_dps: Floats) -> str | None:
    """How rate and output of a table seem to be swapped: the output repeats a few values of both signs, as plans do; else None.

    No gyro puts out the same numbers in both directions, to the last digit or as near as a table's readings of its rate are,
    while a table turns less alike.
    """
    rates = np.unique(rate_dps).size
    for values, group in _gatherings(gyro_dps):
        within_dps = max(float(np.ptp(gyro_dps[group == k])) for k in range(values.size))
        mirrored = np.all(np.abs(values + values[::-1]) <= within_dps + _ROUNDING_DPS)
        if not mirrored or rates <= rate_dps.size / _REPEATS:
            continue
        spreads = [float(np.ptp(rate_dps[group == k])) for k in range(values.size)]
        if np.median(spreads) > _APART * within_dps:
            about = f" (within {within_dps:.2g} deg/s)" if within_dps else ""
            return (
                f"gyro_dps has {values.size} values{about} in {rate_dps.size} rows, the same in both directions, and rate_dps {rates}: "
                "the two seem to be swapped"
            )
    return None


def _gatherings(readings: Floats) -> Iterator[tuple[Floats, Ints]]:
    """Ways in which readings come to a few values again: the values, and to which of them each reading belongs.

    Gaps between readings of one value and gaps between values are of two kinds: where the first ends and the second
    begins, a gap is several times the one before it.
    """
    told, row = np.unique(readings, return_inverse=True)
    steps = np.diff(told)
    gaps = np.sort(steps)
    for narrowest in (0.0, *gaps[1:][gaps[1:] > _APART * gaps[:-1]]):
        group = np.append(0, np.cumsum(steps >= narrowest))[row]
        visits = np.bincount(group)
        if _FEWEST_PLANNED <= visits.size <= readings.size / _REPEATS:
            yield np.bincount(group, readings) / visits, group
