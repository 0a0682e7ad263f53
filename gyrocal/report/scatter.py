"""Scatter of data sets that share a rate: what the figure draws and the sentences say. The tests are `calibration`'s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.corrected import Examined, Floats
from gyrocal.calibration.residuals import ALARM_RATE, ScatterByRate
from gyrocal.report.levels import levels
from gyrocal.units import p_equals

#: Data sets at one rate below which its scatter is not estimated.
_FEWEST = 4
#: Rates in the running median that is drawn as the trend.
TREND_RATES = 5


@dataclass(frozen=True)
class SignedScatter:
    """Scatter at each signed rate, arrays of shape (levels,).

    Attributes
    ----------
    between_dps, low_dps, high_dps : ndarray
        Standard deviation of the residuals about their mean at that rate, and its 95 % interval
        (chi-square, as if data sets were independent).
    expected_dps : ndarray
        Root mean square of the standard errors of the means, as if the samples inside a data set were independent;
        NaN where they are not known.
    """

    rate_dps: Floats
    count: NDArray[np.int64]
    between_dps: Floats
    low_dps: Floats
    high_dps: Floats
    expected_dps: Floats


def signed_scatter(data: Examined) -> SignedScatter | None:
    """Scatter at each rate that has at least four data sets; None when fewer than three rates have."""
    found, tight = levels(data.sets.rate_dps, most=max(2, len(data.sets) // 2), bins=1)
    groups = [level.rows for level in found if level.rows.size >= _FEWEST]
    if not tight or len(groups) < 3:
        return None
    count = np.array([g.size for g in groups])
    between = np.array([data.residual_dps[g].std(ddof=1) for g in groups])
    dof = count - 1
    return SignedScatter(
        rate_dps=np.array([data.sets.rate_dps[g].mean() for g in groups]),
        count=count,
        between_dps=between,
        low_dps=between * np.sqrt(dof / stats.chi2.ppf(0.975, dof)),
        high_dps=between * np.sqrt(dof / stats.chi2.ppf(0.025, dof)),
        expected_dps=np.sqrt(np.array([data.sets.mean_variance_dps2[g].mean() for g in groups])),
    )


def odd_rates(scatter: ScatterByRate) -> NDArray[np.int64]:
    """Groups of |rate| that scatter more than the trend, at the family-wise false-alarm rate of `calibration`."""
    return np.flatnonzero((scatter.p_value < ALARM_RATE) & (scatter.std_dps > scatter.trend_dps))


def usual_trend(scatter: ScatterByRate) -> Floats:
    """Running median of the scatter over |rate| without the rates that `odd_rates` names, deg/s; shape (groups,).

    The straight line of the tests has all rates in it, as their permutations must: odd rates pull it up, and
    scatter that levels off leaves it. The window shrinks towards both ends.
    """
    usual = np.ones(scatter.n.size, dtype=bool)
    usual[odd_rates(scatter)] = False
    if not usual.any():
        return scatter.trend_dps
    rate, std = scatter.rate_dps[usual], scatter.std_dps[usual]
    reach = [min(i, std.size - 1 - i, TREND_RATES // 2) for i in range(std.size)]
    median = [np.median(std[i - k : i + k + 1]) for i, k in enumerate(reach)]
    return np.interp(scatter.rate_dps, rate, median)


def scatter_statements(scatter: ScatterByRate) -> list[str]:
    """Plain sentences on what is odd in the scatter; empty when nothing is."""
    said = []
    if scatter.growth_p_value < ALARM_RATE:
        trend = usual_trend(scatter)
        low, high = trend[0], trend[-1]
        said.append(
            f"Scatter between data sets grows with |rate|, from {low * 3600:.3g} deg/h at {scatter.rate_dps[0]:.1f} deg/s "
            f"to {high * 3600:.3g} deg/h at {scatter.rate_dps[-1]:.1f} deg/s ({p_equals(scatter.growth_p_value)})."
        )
    for i in odd_rates(scatter):
        sign = "±" if scatter.rate_dps[i] > 0 else ""
        said.append(
            f"Data sets at {sign}{scatter.rate_dps[i]:.1f} deg/s scatter {scatter.neighbours[i]:.1f} times as much as "
            f"those at the neighbouring rates ({p_equals(float(scatter.p_value[i]))}): suspect the table or its mount there."
        )
    return said
