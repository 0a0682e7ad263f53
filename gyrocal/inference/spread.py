"""Whether estimates of one quantity from several sources differ by more than their errors, and by how much; mean squares
and the white noise of a rest.

References
----------
Paule and Mandel, J. Res. NBS 87 (1982): the spread between the sources.
Viechtbauer, Stat. Med. 26 (2007): its interval, from the law of Q.
Hartung and Knapp, Stat. Med. 20 (2001): the interval of the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, t

from gyrocal.inference.runs import runs_of
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: The spread is looked for up to this many times the range of the estimates.
_FARTHEST = 1e3
#: Share of squares of which any may be outliers. The median, of which half may be, is known half as well, and a gyro's own
#: steps bend it: on 67 drives with rests 0.13 of scatter of the white noise in its logarithm, 0.06 of this.
_OUTLIERS = 0.1
#: Neighbouring means of a rest that are compared, s: over so short a time no bias moves, and steps of the output hide less.
#: How many steps between them tell anything of a level, and how many the level.
_REST_MEAN_S, _FEWEST_STEPS, _SURE_STEPS = 0.1, 4, 20


@dataclass(frozen=True)
class White:
    """White noise of a rate at rest, its unit per sqrt(Hz), by so many steps between neighbouring means."""

    per_rt_hz: float
    steps: int

    @property
    def sure(self) -> bool:
        """Whether there are enough steps to take the level for what it is."""
        return self.steps >= _SURE_STEPS

    @property
    def log_std(self) -> float:
        """Standard deviation of the level's logarithm: neighbouring steps share a mean, and the largest are left out."""
        return float(1.0 / np.sqrt(self.steps))


@dataclass(frozen=True)
class Spread:
    """Mean over the sources and standard deviation between them, with 95 % intervals.

    `p_value`: of estimates that differ so much, were the sources alike (Cochran's Q).
    """

    mean: float
    mean_interval_95: tuple[float, float]
    spread: float
    spread_interval_95: tuple[float, float]
    p_value: float


def spread_between(values: Floats, stds: Floats) -> Spread:
    """Random-effects summary of independent estimates, at least two, with their standard deviations."""
    free = values.size - 1
    q = _q(0.0, values, stds)
    tau = _where(float(free), values, stds)
    low = _where(float(chi2.ppf(0.975, free)), values, stds)
    high = _where(float(chi2.ppf(0.025, free)), values, stds)
    weight = 1.0 / (stds**2 + tau**2)
    mean = float(weight @ values / weight.sum())
    # Never less than what the errors of the estimates alone leave of the mean.
    inflation = max(_q(tau, values, stds) / free, 1.0)
    quantile = float(t.ppf(0.975, free)) if tau > 0 else NORMAL_95
    half = quantile * float(np.sqrt(inflation / weight.sum()))
    return Spread(mean, (mean - half, mean + half), tau, (low, high), float(chi2.sf(q, free)))


def _q(tau: float, values: Floats, stds: Floats) -> float:
    weight = 1.0 / (stds**2 + tau**2)
    return float(weight @ (values - weight @ values / weight.sum()) ** 2)


def _where(level: float, values: Floats, stds: Floats) -> float:
    """The spread at which the weighted squares are at a level; zero where they are below it without any."""
    if _q(0.0, values, stds) <= level:
        return 0.0
    farthest = _FARTHEST * float(np.ptp(values))
    return float(brentq(lambda tau: _q(tau, values, stds) - level, 0.0, farthest))


def mean_square(squares: Floats) -> float:
    """Mean of squares of normal values about zero, shape (n,), a tenth of which may be too large."""
    kept = np.sort(squares)[: max(int((1.0 - _OUTLIERS) * squares.size), 1)]
    # Below its quantile a squared normal value has the mean of a chi-square with two more degrees of freedom there.
    below = float(chi2.cdf(chi2.ppf(1.0 - _OUTLIERS, 1), 3)) / (1.0 - _OUTLIERS)
    return float(np.mean(kept)) / below


def white_at_rest(rate: Floats, resting: NDArray[np.bool_], dt_s: Floats) -> White | None:
    """White noise of a rate by neighbouring means at rest.

    None where hardly anything rests, or where the steps of the output hide all noise.

    Parameters
    ----------
    rate, resting, dt_s : shape (n,)
        The rate, finite where the robot stands; whether it does; time since the row before, the first of which is
        not looked at. A row at the time of the one before counts for nothing.
    """
    later = np.append(True, dt_s[1:] > 0)
    rate, resting, dt_s = rate[later], resting[later], dt_s[later]
    if dt_s.size < 2:
        return None
    step_s = float(np.median(dt_s[1:]))
    every = max(1, round(_REST_MEAN_S / max(step_s, 1e-6)))
    rows, squares = np.flatnonzero(resting), []
    for run in runs_of(rows):
        count = run.size // every
        if count >= 3:
            means = rate[run[: count * every]].reshape(count, every).mean(axis=1)
            squares.append(np.diff(means) ** 2)
    found = np.concatenate(squares) if squares else np.zeros(0)
    if found.size < _FEWEST_STEPS:
        return None
    # A difference has twice the variance.
    square = mean_square(found)
    return White(float(np.sqrt(0.5 * square * every * step_s)), found.size) if square > 0 else None
