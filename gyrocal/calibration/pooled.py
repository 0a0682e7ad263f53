"""One figure from several runs: their mean, and how much they differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from gyrocal.calibration.figure import Figure
from gyrocal.units import NORMAL_95, plural


def pooled(figures: Sequence[Figure]) -> Figure:
    """One figure from several runs: their mean; the interval allows for what changes between runs.

    With `n` runs the mean is Student t about the truth with n - 1 degrees of freedom; the error within the runs is
    never counted for less than it is. A figure that some of the runs do not tell from noise is bounded: the mean of those
    that do would be too large.
    """
    known = [f for f in figures if f.interval is not None]
    bounded = [f for f in figures if f.interval is None and f.high is not None]
    if bounded and known:
        most = max(max(abs(f.low or 0.0), abs(f.high or 0.0)) for f in [*known, *bounded])
        reason = f"told from noise in {len(known)} of {len(figures)} runs only"
        return replace(known[0], value=None, low=None, high=most, reason=reason)
    if len(known) < 2:
        return known[0] if known else max(figures, key=lambda f: f.high or 0.0)
    values = np.array([f.value for f in known], dtype=float)
    within = np.array(
        [(f.high - f.low) / (2 * NORMAL_95) for f in known if f.low is not None and f.high is not None]
    )
    n = values.size
    half = max(
        float(stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / math.sqrt(n)),
        float(NORMAL_95 * math.sqrt(np.mean(within**2) / n)),
    )
    mean = float(values.mean())
    low = max(mean - half, 0.0) if known[0].size else mean - half
    sample = f"{n} runs, {', '.join(dict.fromkeys(f.sample for f in known))}"
    return replace(known[0], value=mean, low=low, high=mean + half, sample=sample)


def repeatability(figures: Sequence[Figure]) -> Figure:
    """Standard deviation of a figure from run to run, less what the error within the runs makes of it.

    Without that the figure of a unit that repeats would be the noise of its runs. The variance of the values is chi-square
    about the sum of both; runs that happen to agree better than their own errors bound no tighter than those do.
    """
    known = [f for f in figures if f.interval is not None]
    blank = Figure(
        f"{figures[0].name}_repeatability",
        figures[0].unit,
        f"standard deviation of the {figures[0].title} from run to run, less the error within the runs",
        method="sample variance less that of the errors; chi-square interval",
        sample=f"{len(known)} {plural(len(known), '[run|runs]')}",
    )
    n = len(known)
    if n < 2:
        return replace(blank, reason="it takes two runs or more, better with the power off between")
    values = np.array([f.value for f in known], dtype=float)
    half = np.array([0.5 * (f.high - f.low) for f in known if f.low is not None and f.high is not None])
    within, both = float(np.mean((half / NORMAL_95) ** 2)), float(values.var(ddof=1))
    low, high = (
        math.sqrt(max((n - 1) * of / float(stats.chi2.ppf(q, n - 1)) - within, 0.0))
        for of, q in ((both, 0.975), (max(both, within), 0.025))
    )
    if low == 0.0:
        reason = f"not told from the error within the runs: less than {high:.3g} {blank.unit} with 95 %"
        return replace(blank, high=high, reason=reason)
    return replace(blank, value=math.sqrt(both - within), low=low, high=high)
