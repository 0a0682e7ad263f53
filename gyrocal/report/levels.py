"""Which data sets belong together: levels of rate and temperature, found in the values themselves."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: A level is tight: the widest is below this share of the narrowest gap between levels.
_TIGHT = 0.5
#: Differences below this share of the span are noise of a reference, never levels.
_NOISE = 1e-4
#: The narrowest gap between levels is this many times the widest gap inside one.
_STEEP = 5.0
_ROUND_STEPS = (1.0, 2.0, 5.0)
#: Rates and temperatures of a map, on levels and else in bins.
_MOST_RATES, _RATE_BINS = 64, 24
_MOST_TEMPERATURES = 12


@dataclass(frozen=True)
class Level:
    """Data sets at (nearly) one value: their rows, the mean value, and the range that they were put together for."""

    value: float
    low: float
    high: float
    rows: NDArray[np.int64]


def levels(values: Floats, most: int, bins: int) -> tuple[list[Level], bool]:
    """Group values into at most `most` tight levels, or, where there are none, into at most `bins` round bins.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    levels : list of Level, in ascending order, none empty
    tight : bool
        True: the values sit on levels, as a plan leaves them. False: they are continuous and were binned.
    """
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    cuts = _tight_cuts(ordered, most)
    tight = cuts is not None
    if cuts is None:
        edges = round_edges(float(ordered[0]), float(ordered[-1]), bins)
        cuts = np.searchsorted(ordered, edges[1:-1], side="left")
        limits = [(float(low), float(high)) for low, high in pairwise(edges)]
    groups = np.split(order, cuts)
    if tight:
        limits = [(float(values[g].min()), float(values[g].max())) for g in groups]
    found = [
        Level(float(values[g].mean()), float(low), float(high), np.sort(g))
        for g, (low, high) in zip(groups, limits, strict=True)
        if g.size
    ]
    return found, tight


def map_levels(rate_dps: Floats, temp_c: Floats) -> tuple[list[Level], list[Level]]:
    """Levels of the rates and of the temperatures of data sets, for the columns and the rows of a map."""
    rates, _ = levels(rate_dps, most=_MOST_RATES, bins=_RATE_BINS)
    temps, _ = levels(temp_c, most=_MOST_TEMPERATURES, bins=_MOST_TEMPERATURES)
    return rates, temps


def _tight_cuts(ordered: Floats, most: int) -> NDArray[np.int64] | None:
    """Where to cut sorted values so that groups are tight; None when there is no such cut.

    The cuts are the widest gaps: as many as can be before the sorted gaps fall steeply, to noise.
    """
    span = ordered[-1] - ordered[0]
    if span == 0:
        return np.empty(0, dtype=np.int64)
    gaps = np.diff(ordered)
    by_size = np.argsort(gaps, kind="stable")[::-1]
    falling = np.maximum(np.append(gaps[by_size], 0.0), _NOISE * span)
    steepness = falling[:-1] / falling[1:]
    for k in np.flatnonzero(steepness[: most - 1] > _STEEP)[::-1] + 1:
        cuts = np.sort(by_size[:k]) + 1
        starts = np.concatenate(([0], cuts))
        ends = np.concatenate((cuts, [ordered.size])) - 1
        if (ordered[ends] - ordered[starts]).max() < _TIGHT * gaps[by_size[k - 1]] and steepness[
            k - 1
        ] > _STEEP:
            return np.asarray(cuts)
    return None


def round_edges(low: float, high: float, bins: int) -> Floats:
    """Edges of at most `bins` equal bins that cover [low, high], at round numbers."""
    span = max(high - low, 1e-9)
    decade = 10.0 ** np.floor(np.log10(span / bins))
    for step in [s * decade * f for f in (1.0, 10.0, 100.0) for s in _ROUND_STEPS]:
        first, last = np.floor(low / step), np.floor(high / step) + 1
        if last - first <= bins:
            return np.asarray(np.arange(first, last + 1) * step)
    return np.array([low, high + span * 1e-9])


def cell_edges(found: list[Level]) -> Floats:
    """Edges of map cells around the levels: halfway between neighbours, shape (len + 1,)."""
    centres = np.array([level.value for level in found])
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate(([2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]))
