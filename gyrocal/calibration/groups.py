"""Groups of data sets: whole rates, whole temperatures, stretches of time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets
from gyrocal.physics.surface import TEMPERATURE_ORDER

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Values nearer than this share of their span are one.
_SAME_LEVEL = 0.02
#: Levels are groups of values that gaps of more than this share of the span hold apart.
_LEVEL_GAP = 0.05
#: Where values have no levels, or too many, this many groups of equal size stand for them.
MOST_GROUPS = 24
_STRETCHES = 6
#: Stretches of time order in the test of structure and in cross-validation.
STRETCHES = 12


def distinct(values: Floats) -> int:
    """Number of values that stand at least 2 % of the span apart."""
    ordered = np.sort(values)
    apart = _SAME_LEVEL * (ordered[-1] - ordered[0])
    number, last = 1, ordered[0]
    for value in ordered:
        if value - last > apart:
            number, last = number + 1, value
    return number


def temperature_levels(temp_c: Floats) -> int:
    """Temperatures that a recording visited: the levels of a chamber, however its readings scatter about them.

    Where gaps do not make most of the span it drifted freely, and `distinct` counts.
    """
    gaps = np.diff(np.sort(temp_c))
    wide = gaps > _LEVEL_GAP * float(np.ptp(temp_c))
    return int(wide.sum()) + 1 if 2.0 * gaps[wide].sum() > np.ptp(temp_c) else distinct(temp_c)


def determined_order(temp_c: Floats) -> int:
    """Order in temperature that the temperatures visited determine, at most that of the surface."""
    return min(TEMPERATURE_ORDER, temperature_levels(temp_c) - 1)


def rate_groups(rate_dps: Floats) -> Ints:
    """Group number of each data set by signed rate, shape (n,); equal parts where rates hardly repeat."""
    ordered = np.sort(rate_dps)
    tolerance = 1e-3 * max(ordered[-1] - ordered[0], np.finfo(float).tiny)
    edges = ordered[1:][np.diff(ordered) > tolerance]
    groups = np.searchsorted(edges, rate_dps, side="right")
    if rate_dps.size < 2 * (edges.size + 1):
        return equal_groups(rate_dps, min(MOST_GROUPS, rate_dps.size // 3))
    return np.asarray(groups, dtype=np.int64)


def temperature_groups(temp_c: Floats) -> Ints:
    """Group number by temperature: the levels of a chamber, or equal parts where it drifts freely."""
    ordered = np.sort(temp_c)
    gaps = np.diff(ordered)
    edges = ordered[1:][gaps > _LEVEL_GAP * (ordered[-1] - ordered[0])]
    if edges.size >= 2:
        return np.asarray(np.searchsorted(edges, temp_c, side="right"), dtype=np.int64)
    return equal_groups(temp_c, _STRETCHES)


def time_groups(size: int, parts: int) -> Ints:
    """`parts` stretches of equal number in time order, shape (size,)."""
    groups = np.empty(size, dtype=np.int64)
    for number, rows in enumerate(np.array_split(np.arange(size), parts)):
        groups[rows] = number
    return groups


def left_out_groups(sets: DataSets) -> dict[str, Ints]:
    """Groups that are left out together, by kind: whole temperatures, whole rates, stretches of time."""
    groups = {
        "temperature": temperature_groups(sets.temp_c),
        "rate": rate_groups(sets.rate_dps),
        "time": time_groups(len(sets), STRETCHES),
    }
    return {name: g for name, g in groups.items() if np.unique(g).size > 1}


def equal_groups(values: Floats, parts: int) -> Ints:
    """Group number by rank of the value, in `parts` groups of equal size."""
    groups = np.empty(values.size, dtype=np.int64)
    groups[np.argsort(values, kind="stable")] = time_groups(values.size, max(parts, 1))
    return groups


def indicators(groups: Ints) -> Floats:
    """One column for each group, 1 for its members; shape (n, number of groups)."""
    return np.asarray(groups[:, None] == np.unique(groups)[None, :], dtype=np.float64)
