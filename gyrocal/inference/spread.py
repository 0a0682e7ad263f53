"""Whether estimates of one quantity from several sources differ by more than their errors, and by how much.

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

Floats = NDArray[np.float64]

#: The spread is looked for up to this many times the range of the estimates.
_FARTHEST = 1e3


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
    quantile = float(t.ppf(0.975, free)) if tau > 0 else 1.96
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
