"""Does the scatter between data sets depend on the rate: growing with it, or local to one?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.report.levels import Floats, levels

#: False-alarm rate of each statement about scatter, over all rates together.
FALSE_ALARM = 0.01
#: Data sets at one rate below which its scatter is not estimated.
_FEWEST = 4
#: How many sizes of rate on either side are a rate's neighbours.
_NEIGHBOURS = 3
#: How near to whole the ratio of two rates must be to be called a multiple.
_WHOLE = 0.02


@dataclass(frozen=True)
class RateScatter:
    """Scatter of data sets that share a rate. Arrays of shape (levels,), by rate; (sizes,), by \\|rate\\|.

    Attributes
    ----------
    between_dps, between_low_dps, between_high_dps : ndarray, shape (levels,)
        Standard deviation of the residuals about their mean at that rate, and its 95 % interval
        (chi-square, as if data sets were independent).
    expected_dps : ndarray, shape (levels,), or None
        Root mean square of the standard errors of the means, as if the samples inside a data set were independent;
        None where they are not known.
    size_dps, neighbour_ratio, neighbour_p : ndarray, shape (sizes,)
        \\|rate\\|; scatter at both its signs against the median of the neighbouring sizes; p-value that it is no
        larger than theirs (Brown-Forsythe on deviations divided by the trend with \\|rate\\|).
    """

    rate_dps: Floats
    count: NDArray[np.int64]
    between_dps: Floats
    between_low_dps: Floats
    between_high_dps: Floats
    expected_dps: Floats | None
    size_dps: Floats
    neighbour_ratio: Floats
    neighbour_p: Floats

    @property
    def local(self) -> NDArray[np.bool_]:
        """Sizes whose scatter exceeds their neighbours' (Holm over all sizes at `FALSE_ALARM`), shape (sizes,)."""
        return holm(self.neighbour_p, FALSE_ALARM)


def holm(p_values: Floats, level: float) -> NDArray[np.bool_]:
    """Which hypotheses fall when the chance of even one false alarm is `level` (Holm 1979); NaN never falls."""
    falls = np.zeros(p_values.shape, dtype=bool)
    tested = np.flatnonzero(np.isfinite(p_values))
    for rank, index in enumerate(tested[np.argsort(p_values[tested], kind="stable")]):
        if p_values[index] > level / (tested.size - rank):
            break
        falls[index] = True
    return falls


def scatter_by_rate(
    rate_dps: Floats, residual_dps: Floats, mean_sigma_dps: Floats | None, use: NDArray[np.bool_]
) -> RateScatter | None:
    """Scatter at each rate; None when fewer than three rates have four data sets.

    Parameters
    ----------
    rate_dps, residual_dps, mean_sigma_dps : ndarray, shape (n,)
    use : ndarray of bool, shape (n,)
        Data sets to take; outliers belong to the scatter, broken ones do not.
    """
    rows = np.flatnonzero(use & np.isfinite(residual_dps))
    if rows.size < 3 * _FEWEST:
        return None
    found, tight = levels(rate_dps[rows], most=rows.size // _FEWEST, bins=24)
    groups = [rows[level.rows] for level in found if level.rows.size >= _FEWEST]
    if not tight or len(groups) < 3:
        return None
    count = np.array([g.size for g in groups])
    between = np.array([residual_dps[g].std(ddof=1) for g in groups])
    dof = count - 1
    low = between * np.sqrt(dof / stats.chi2.ppf(0.975, dof))
    high = between * np.sqrt(dof / stats.chi2.ppf(0.025, dof))
    expected = None
    if mean_sigma_dps is not None:
        expected = np.array([np.sqrt(np.mean(mean_sigma_dps[g] ** 2)) for g in groups])
    rate = np.array([rate_dps[g].mean() for g in groups])
    size, ratio, p = _against_neighbours(rate, between, [residual_dps[g] for g in groups])
    return RateScatter(rate, count, between, low, high, expected, size, ratio, p)


def _against_neighbours(
    rate_dps: Floats, between_dps: Floats, groups: list[Floats]
) -> tuple[Floats, Floats, Floats]:
    """\\|rate\\|, ratio of its scatter to its neighbours', and p-value; both signs of a rate are taken together."""
    sizes, _ = levels(np.abs(rate_dps), most=rate_dps.size, bins=rate_dps.size)
    trend = scatter_trend(rate_dps, between_dps)
    deviations = [
        np.concatenate([np.abs(groups[j] - np.median(groups[j])) / trend[j] for j in size.rows])
        for size in sizes
    ]
    scatter = np.array([np.sqrt(np.mean(between_dps[size.rows] ** 2)) for size in sizes])
    ratio, p = np.full(len(sizes), np.nan), np.full(len(sizes), np.nan)
    for i in range(len(sizes)):
        near = [j for j in range(max(0, i - _NEIGHBOURS), min(len(sizes), i + _NEIGHBOURS + 1)) if j != i]
        others = np.concatenate([deviations[j] for j in near])
        ratio[i] = scatter[i] / max(float(np.median(scatter[near])), np.finfo(float).tiny)
        if np.ptp(np.concatenate((deviations[i], others))) > 0:
            p[i] = stats.ttest_ind(deviations[i], others, alternative="greater").pvalue
    return np.array([size.value for size in sizes]), ratio, p


def scatter_trend(rate_dps: Floats, between_dps: Floats) -> Floats:
    """Scatter expected at each rate: a line in \\|rate\\| (Theil-Sen, deaf to single odd rates), shape (levels,)."""
    size = np.abs(rate_dps)
    left, right = np.triu_indices(size.size, k=1)
    run = size[right] - size[left]
    apart = np.abs(run) > 1e-6 * size.max()
    slope = np.median((between_dps[right] - between_dps[left])[apart] / run[apart]) if apart.any() else 0.0
    line = np.median(between_dps - slope * size) + slope * size
    return np.asarray(np.maximum(line, 0.1 * np.median(between_dps)))


def growth_with_rate(scatter: RateScatter) -> tuple[float, float]:
    """Rank correlation of scatter with \\|rate\\|, and its one-sided p-value."""
    result = stats.spearmanr(np.abs(scatter.rate_dps), scatter.between_dps, alternative="greater")
    return float(result.statistic), float(result.pvalue)


def scatter_statements(scatter: RateScatter) -> list[str]:
    """Plain sentences on what is odd in the scatter; empty when nothing is."""
    said = []
    correlation, p = growth_with_rate(scatter)
    if p < FALSE_ALARM:
        third = np.argsort(np.abs(scatter.rate_dps), kind="stable")
        n = max(1, third.size // 3)
        slow = np.median(scatter.between_dps[third[:n]])
        fast = np.median(scatter.between_dps[third[-n:]])
        said.append(
            f"Scatter between data sets grows with |rate|: {fast / slow:.1f} times as large in the fastest third of "
            f"the rates as in the slowest (rank correlation {correlation:.2f}, p = {p:.1g})."
        )
    for i in np.flatnonzero(scatter.local):
        sign = "\u00b1" if scatter.size_dps[i] > 0 else ""
        said.append(
            f"Data sets at {sign}{scatter.size_dps[i]:.1f} deg/s scatter {scatter.neighbour_ratio[i]:.1f} times as much "
            f"as those at the neighbouring rates (p = {scatter.neighbour_p[i]:.1g}): suspect the table or its mount there."
        )
    odd = scatter.size_dps[scatter.local & (scatter.size_dps > 0)]
    if odd.size >= 3 and np.abs(odd / odd[0] - np.round(odd / odd[0])).max() < _WHOLE:
        said.append(
            f"These rates are whole multiples of {odd[0]:.1f} deg/s, as a resonance of the table or mount would have it."
        )
    return said
