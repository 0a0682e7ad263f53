"""Levels of scatter that are not known exactly: a posterior integrated on a lattice.

A level that is estimated as nothing is not known to be nothing. Intervals that rest on the estimate alone are then too
narrow, so the levels are integrated over. Each enters as a standard deviation (a share of the scatter of the
residual) under a half-Cauchy prior of scale one (Gelman 2006): flat below the scatter that is seen, falling above it.

A level may be *rare*: with even odds it is nothing, else its prior falls to nothing at nothing (``share^2 / (1 + share^2)^2``;
Johnson, Rossell 2010). A walk is one: a level that no recording would show, a fiftieth of the noise at each step, goes far
enough in a thousand steps to widen every interval of the bias, and most gyros have none.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Node = tuple[int, ...]

#: The lattice's step along each axis takes the log-posterior down by this much: 1.5 standard deviations of a normal
#: law, at which the sum over a lattice is its integral to four digits.
_STEP_DROP = 0.5 * 1.5**2
#: Nodes lower than this below the highest are left out: 1 % of a normal law in three dimensions, 3 % in four.
_DEPTH = 5.5
#: Nodes at the most: three times what levels that are hardly told apart take.
_MOST_NODES = 1500
#: Where the step along an axis is sought: from this share of the mode, or of the scatter where the mode is nothing, to so many
#: times the scatter, where the prior alone has fallen by as much.
_FIRST_STEP, _LONGEST_STEP = 0.05, 20.0


@dataclass(frozen=True)
class Posterior:
    """Moments of the squared shares, and the 95 % upper bound of each.

    Attributes
    ----------
    mean, upper : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    """

    mean: Floats
    covariance: Floats
    upper: Floats


def integrate(
    log_likelihood: Callable[[Floats], float], mode: Floats, rare: NDArray[np.bool_] | None = None
) -> Posterior:
    """Posterior of shares (standard deviations, not negative) given a log-likelihood and roughly where it peaks.

    Parameters
    ----------
    mode : ndarray, shape (k,)
    rare : ndarray of bool, shape (k,), optional
        Which are nothing with even odds; none of them where it is not given.
    """

    def log_posterior(share: Floats) -> float:
        return log_likelihood(share) - float(np.sum(np.log1p(share**2)))

    step = _steps(log_posterior, mode)
    nodes = _explore(lambda node: log_posterior(step * np.array(node)), _nearest(mode, step))
    places = np.array(list(nodes), dtype=np.float64)
    heights = np.array(list(nodes.values()))
    kept = heights > heights.max() - _DEPTH
    square = (step * places) ** 2
    rare = np.zeros(mode.size, dtype=np.bool_) if rare is None else rare
    # A node on the boundary stands for half a cell; of a rare level it stands for nothing, which has all of its odds there.
    boundary = np.where(rare, 0.5 * np.pi / step, 0.5)
    inside = np.where(rare, 2.0 * square / (1.0 + square), 1.0)
    weight = np.exp(heights - heights.max()) * np.prod(np.where(places == 0, boundary, inside), axis=1)
    weight, square = weight[kept] / weight[kept].sum(), square[kept]
    mean = weight @ square
    covariance = (square - mean).T @ ((square - mean) * weight[:, None])
    return Posterior(mean, covariance, _upper(square, weight, step))


def _steps(log_posterior: Callable[[Floats], float], mode: Floats) -> Floats:
    """Step along each axis, up from the mode, that lowers the posterior by `_STEP_DROP`."""
    top = log_posterior(mode)
    steps = np.empty(mode.size)
    for axis, direction in enumerate(np.eye(mode.size)):
        low, high = 0.0, _FIRST_STEP * max(float(mode[axis]), _FIRST_STEP)
        while high < _LONGEST_STEP and top - log_posterior(mode + high * direction) < _STEP_DROP:
            low, high = high, 2.0 * high
        for _ in range(3):
            middle = 0.5 * (low + high)
            if top - log_posterior(mode + middle * direction) < _STEP_DROP:
                low = middle
            else:
                high = middle
        steps[axis] = 0.5 * (low + high)
    return steps


def _nearest(mode: Floats, step: Floats) -> Node:
    return tuple(int(i) for i in np.rint(mode / step))


def _explore(log_posterior: Callable[[Node], float], start: Node) -> dict[Node, float]:
    """Heights of all nodes that hang together with the start and are not too low."""
    heights = {start: log_posterior(start)}
    best = heights[start]
    waiting = [start]
    while waiting and len(heights) < _MOST_NODES:
        node = waiting.pop(0)
        if heights[node] < best - _DEPTH:
            continue
        for axis, way in itertools.product(range(len(node)), (-1, 1)):
            near = (*node[:axis], node[axis] + way, *node[axis + 1 :])
            if near[axis] < 0 or near in heights:
                continue
            heights[near] = log_posterior(near)
            best = max(best, heights[near])
            waiting.append(near)
    return heights


def _upper(square: Floats, weight: Floats, step: Floats) -> Floats:
    """95 % upper bound of each squared share from its marginal."""
    bounds = np.empty(step.size)
    for axis in range(step.size):
        places, member = np.unique(np.rint(np.sqrt(square[:, axis]) / step[axis]), return_inverse=True)
        # Each node's weight is spread over its cell; that of the boundary reaches to half a step.
        edges = np.concatenate([[max(places[0] - 0.5, 0.0)], places + 0.5]) * step[axis]
        total = np.concatenate([[0.0], np.cumsum(np.bincount(member, weight))])
        bounds[axis] = np.interp(0.95, total, edges) ** 2
    return bounds
