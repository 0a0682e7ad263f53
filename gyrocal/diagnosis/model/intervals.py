"""One shape parameter at a time: refinement, descent, and intervals from the profile of the residual sum of squares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

Floats = NDArray[np.float64]
Interval = tuple[float, float]

#: Probabilities below the ends of a 95 % interval.
TAILS = (0.025, 0.975)
#: Rise of the residual sum of squares at the ends of a 95 % interval: the quantile of chi-square, 1 df.
RISE_95 = 3.841
#: The same for the instant of a jump, at which the likelihood has a corner: -2 log(1 - sqrt(0.95))
#: (B. E. Hansen, Econometrica 68, 2000, p. 575).
RISE_INSTANT_95 = 7.352
#: Shapes are refined over these factors either way, in turn, at so many points each.
_REFINED_OVER, _REFINED_AT = (1.5, 1.12), 7
#: An end of an interval is sought in steps of this ratio, then by halving the last one.
_STEP = 3.0
#: Shares below the lower end of the shortest interval that are tried.
_ENDS_TRIED = 101
#: Shapes at which an amplitude's likelihood is evaluated, and how near the ends of the shape's interval, in widths of it.
_SHAPES, _NEAR_END = 15, 0.005


def refined(
    shape: Mapping[str, float],
    names: Sequence[str],
    gain: Callable[[Mapping[str, float]], float],
    limits: Mapping[str, Interval] | None = None,
) -> dict[str, float]:
    """A shape between the points of the grid that it was found on: one parameter after the other, then closer.

    Parameters
    ----------
    names : parameters that are refined, as far as they are positive
    gain : what a shape is worth
    limits : lowest and highest value of a parameter, where it has any
    """
    best, most = dict(shape), gain(shape)
    for spread in _REFINED_OVER:
        for name in names:
            around, value = best, best.get(name, 0.0)
            if value <= 0.0:
                continue
            low, high = (limits or {}).get(name, (0.0, np.inf))
            for factor in np.geomspace(1.0 / spread, spread, _REFINED_AT):
                tried = {**around, name: float(np.clip(value * factor, low, high))}
                found = gain(tried)
                if found > most:
                    best, most = tried, found
    return best


def descend(loss: Callable[[float], float], start: float, reach: float) -> float:
    """Least loss within a ratio `reach` of a positive start."""
    low, high = np.log(start / reach), np.log(start * reach)
    found = minimize_scalar(
        lambda x: loss(float(np.exp(x))),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 2e-3, "maxiter": 25},
    )
    return float(np.exp(found.x)) if found.fun < loss(start) else start


def profile_interval(loss: Callable[[float], float], best: float, limits: Interval) -> Interval:
    """Where the loss has risen by 3.84 on either side of its minimum, which is positive, or the limits."""
    floor = loss(best)
    low, high = limits
    return _crossing(loss, floor, best, 1.0 / _STEP, low), _crossing(loss, floor, best, _STEP, high)


def instant_interval(loss: Callable[[float], float], best: float, instants: Floats) -> Interval:
    """The same for the instant of a jump, among instants in order."""
    floor = loss(best)
    inside = np.array([loss(float(x)) - floor < RISE_INSTANT_95 for x in instants])
    inside[np.argmin(np.abs(instants - best))] = True
    first, last = np.flatnonzero(inside)[[0, -1]]
    # The rise lies somewhere between the last instant inside and the next one outside.
    low = 0.5 * (instants[max(first - 1, 0)] + instants[first])
    high = 0.5 * (instants[last] + instants[min(last + 1, instants.size - 1)])
    return holding((float(low), float(high)), best)


def of_mass(values: Floats, mass: Floats) -> Interval:
    """The shortest interval with 95 % of a probability over ascending values, each of which stands for half of the way to either neighbour.

    What is likeliest at a bound has the bound inside.
    """
    edges = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])
    below = np.append(0.0, np.cumsum(mass) / mass.sum())
    left_out = np.linspace(0.0, TAILS[0] + 1.0 - TAILS[1], _ENDS_TRIED)
    low, high = (np.interp(share, below, edges) for share in (left_out, left_out + TAILS[1] - TAILS[0]))
    shortest = np.flatnonzero(np.isclose(high - low, np.min(high - low), rtol=1e-9))
    middle = shortest[shortest.size // 2]
    return float(low[middle]), float(high[middle])


def of_geometric(values: Floats, mass: Floats) -> Interval:
    """The same where it is their logarithms that lie between each other."""
    low, high = of_mass(np.log(values), mass)
    return float(np.exp(low)), float(np.exp(high))


def along_axis(values: Floats, loss: Floats, stated: float) -> Interval:
    """Where a profile on a grid of ascending values is less than 3.84 above what is stated, between the points by lines."""
    rise = loss - max(stated, float(loss.min()))
    first, last = np.flatnonzero(rise < RISE_95)[[0, -1]]
    low, high = float(values[first]), float(values[last])
    if first > 0:
        low = float(np.interp(-RISE_95, -rise[first - 1 : first + 1], values[first - 1 : first + 1]))
    if last < values.size - 1:
        high = float(np.interp(RISE_95, rise[last : last + 2], values[last : last + 2]))
    return low, high


def holding(interval: Interval, value: float) -> Interval:
    """The interval, wide enough for the value that is stated with it."""
    return min(interval[0], value), max(interval[1], value)


@dataclass(frozen=True)
class Point:
    """At a value of the shape: residual sum of squares, the best amplitude there and its standard deviation.

    `unit_dps`: what the law adds beyond the surface at an amplitude of one, rms.
    """

    loss: float
    amplitude: float
    std: float
    unit_dps: float = float("nan")


def shapes_within(interval: Interval) -> Floats:
    """Values of a positive shape all over its interval: beyond it no amplitude makes up for what the shape loses."""
    low, high = interval
    inside = (high / low) ** _NEAR_END
    return np.asarray(np.geomspace(low * inside, high / inside, _SHAPES))


def amplitude_interval(points: Sequence[Point]) -> Interval:
    """Interval of an amplitude that is traded against shapes: each shape may add as much as its own loss leaves of 3.84.

    The first point is the one whose amplitude is stated, and lies inside.
    """
    # A shape that no row shows says nothing of the amplitude.
    shown = [(p.loss, p.amplitude, p.std) for p in points if np.isfinite(p.std)]
    if not shown:
        return -np.inf, np.inf
    loss, amplitude, std = np.array(shown).T
    likely = loss - loss.min() < RISE_95
    reach = np.sqrt(RISE_95 - (loss[likely] - loss.min())) * std[likely]
    low, high = float(np.min(amplitude[likely] - reach)), float(np.max(amplitude[likely] + reach))
    return holding((low, high), points[0].amplitude)


def _crossing(loss: Callable[[float], float], floor: float, best: float, ratio: float, limit: float) -> float:
    inside, outside = best, best
    for _ in range(8):
        outside = max(inside * ratio, limit) if ratio < 1.0 else min(inside * ratio, limit)
        if loss(outside) - floor > RISE_95:
            break
        if outside == limit:
            return limit
        inside = outside
    else:
        return outside
    for _ in range(10):
        middle = float(np.sqrt(inside * outside))
        if loss(middle) - floor > RISE_95:
            outside = middle
        else:
            inside = middle
    return float(np.sqrt(inside * outside))
