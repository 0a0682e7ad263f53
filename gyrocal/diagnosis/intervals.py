"""One shape parameter at a time: descent, and intervals from the profile of the residual sum of squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

Floats = NDArray[np.float64]

#: Rise of the residual sum of squares at the ends of a 95 % interval: the quantile of chi-square, 1 df.
_RISE_95 = 3.841
_RATIO_95 = 2.0 * 1.959964


@dataclass(frozen=True)
class Profile:
    """Interval of 95 % and the standard deviation that belongs to its width."""

    interval: tuple[float, float]
    std: float


def descend(
    loss: Callable[[float], float], start: float, reach: float, candidates: Floats | None = None
) -> float:
    """Least loss within a ratio `reach` of a positive start, or among candidates."""
    if candidates is not None:
        values = [loss(float(x)) for x in candidates]
        best = int(np.argmin(values))
        return float(candidates[best]) if values[best] < loss(start) else start
    low, high = np.log(start / reach), np.log(start * reach)
    found = minimize_scalar(
        lambda x: loss(float(np.exp(x))),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 2e-3, "maxiter": 25},
    )
    return float(np.exp(found.x)) if found.fun < loss(start) else start


def profile_interval(
    loss: Callable[[float], float],
    best: float,
    reach: float,
    limits: tuple[float, float],
    candidates: Floats | None = None,
) -> Profile:
    """Where the loss rises by 3.84 on either side of its minimum."""
    floor = loss(best)
    if candidates is not None:
        inside = [float(x) for x in candidates if loss(float(x)) - floor < _RISE_95] or [best]
        gap = float(np.median(np.diff(candidates))) if candidates.size > 1 else 1.0
        interval = (min(*inside, best) - gap / 2, max(*inside, best) + gap / 2)
        return Profile(interval, (interval[1] - interval[0]) / _RATIO_95)
    low = _crossing(loss, floor, best, 1.0 / np.sqrt(reach), limits[0])
    high = _crossing(loss, floor, best, np.sqrt(reach), limits[1])
    return Profile((low, high), (high - low) / _RATIO_95)


def _crossing(loss: Callable[[float], float], floor: float, best: float, ratio: float, limit: float) -> float:
    inside, outside = best, best
    for _ in range(8):
        outside = inside * ratio
        if (ratio < 1.0) == (outside < limit):
            return limit
        if loss(outside) - floor > _RISE_95:
            break
        inside = outside
    else:
        return outside
    for _ in range(10):
        middle = float(np.sqrt(inside * outside))
        if loss(middle) - floor > _RISE_95:
            outside = middle
        else:
            inside = middle
    return float(np.sqrt(inside * outside))
