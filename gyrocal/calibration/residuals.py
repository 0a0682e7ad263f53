"""What is left after the fit: outliers, structure, scatter by rate. Nothing here drops a data set.

Every test states its p-value under the estimated covariance, and families of tests are held together by Holm's
method (1979), so that a recording with nothing in it is called structured in one case of a hundred at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.datasets import DataSets
from gyrocal.calibration.fit import studentised_residuals
from gyrocal.calibration.groups import STRETCHES, indicators, rate_groups, temperature_groups, time_groups
from gyrocal.inference.multiple import holm
from gyrocal.inference.scatter import Scatter, projection

Floats = NDArray[np.float64]

#: False-alarm rate of each family of tests in a recording that has nothing to find.
ALARM_RATE = 0.01
_OUTLIER_ROUNDS = 5
_PERMUTATIONS = 9999
_SMALLEST_GROUP = 4


@dataclass(frozen=True)
class Outlier:
    """A data set that does not belong to the others, and why."""

    row: int
    segment: int
    rate_dps: float
    temp_c: float
    residual_dps: float
    sigmas: float
    p_value: float
    reason: str


@dataclass(frozen=True)
class StructureTest:
    """A test for structure in one coordinate; ``p_holm`` is corrected for the whole family."""

    coordinate: str
    statistic: float
    dof: int
    p_value: float
    p_holm: float

    @property
    def structured(self) -> bool:
        """Whether the coordinate holds structure at the family's false-alarm rate."""
        return self.p_holm < ALARM_RATE


@dataclass(frozen=True)
class ScatterByRate:
    """Scatter of residuals within each |rate|, shape (groups,).

    Attributes
    ----------
    rate_dps, n, std_dps : ndarray
        |rate|, number of data sets, standard deviation about the mean of each signed rate.
    trend_dps : ndarray
        What a straight line in |rate| through all groups gives.
    neighbours : ndarray
        Scatter over the mean scatter of the next lower and higher |rate|.
    p_value : ndarray
        Of a scatter as far from the trend, corrected for the number of groups (permutation of data sets).
    growth_p_value : float
        Of a scatter that grows with |rate| as much by chance.
    """

    rate_dps: Floats
    n: NDArray[np.int64]
    std_dps: Floats
    trend_dps: Floats
    neighbours: Floats
    p_value: Floats
    growth_p_value: float


def find_outliers(sets: DataSets, scatter: Scatter) -> tuple[tuple[Outlier, ...], NDArray[np.bool_], Scatter]:
    """Data sets that all others disown, the mask of the rest, and the scatter of the rest.

    In rounds: a large outlier widens the estimated scatter and so hides smaller ones.
    """
    design = scatter.design
    kept = np.ones(len(sets), dtype=np.bool_)
    found: dict[int, tuple[float, float]] = {}
    for _ in range(_OUTLIER_ROUNDS):
        rows = np.flatnonzero(kept)
        t = studentised_residuals(scatter, sets.error_dps[rows])
        dof = max(rows.size - scatter.design.shape[1] - 1, 1)
        p = np.minimum(2.0 * stats.t.sf(np.abs(t), dof) * len(sets), 1.0)
        new = p < ALARM_RATE
        # More than a tenth of all is not a few strangers but another distribution: that is for the structure tests.
        if not new.any() or kept.sum() - new.sum() < 0.9 * len(sets):
            break
        found |= {int(rows[i]): (float(t[i]), float(p[i])) for i in np.flatnonzero(new)}
        kept[rows[new]] = False
        rest = sets.select(kept)
        scatter = estimate_scatter(rest, design[kept], scatter.rest)
    rest = sets.select(kept)
    surface_dps = _predicted_from(rest, scatter, design)
    outliers = [
        Outlier(
            row=row,
            segment=int(sets.segment[row]),
            rate_dps=float(sets.rate_dps[row]),
            temp_c=float(sets.temp_c[row]),
            residual_dps=float(sets.error_dps[row] - surface_dps[row]),
            sigmas=t,
            p_value=p,
            reason="its mean is off what all other data sets predict",
        )
        for row, (t, p) in sorted(found.items())
    ]
    return (*outliers, *_peaks(sets)), kept, scatter


def _predicted_from(rest: DataSets, scatter: Scatter, design: Floats) -> Floats:
    lower = linalg.cholesky(scatter.matrix, lower=True)
    white = linalg.solve_triangular(lower, np.column_stack([scatter.design, rest.error_dps]), lower=True)
    coefficients = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0]
    return np.asarray(design @ coefficients)


def _peaks(sets: DataSets) -> list[Outlier]:
    """Data sets with an isolated sample that Gaussian noise would not give in the whole recording."""
    found = []
    known = np.isfinite(sets.gyro_peak_dps) & (sets.gyro_std_dps > 0) & (sets.n > _SMALLEST_GROUP)
    samples = float(np.sum(sets.n[known]))
    for row in np.flatnonzero(known):
        z = sets.gyro_peak_dps[row] / sets.gyro_std_dps[row]
        n = sets.n[row]
        # z^2 n/(n-1)^2 of a sample within its own data set is a beta variable.
        share = min(z * z * n / (n - 1.0) ** 2, 1.0)
        p = min(float(stats.beta.sf(share, 0.5, 0.5 * (n - 2.0))) * samples, 1.0)
        if p < ALARM_RATE:
            found.append(
                Outlier(
                    row=int(row),
                    segment=int(sets.segment[row]),
                    rate_dps=float(sets.rate_dps[row]),
                    temp_c=float(sets.temp_c[row]),
                    residual_dps=float(sets.gyro_peak_dps[row]),
                    sigmas=float(z),
                    p_value=p,
                    reason="a sample in it stands far from its mean",
                )
            )
    return found


def structure_tests(sets: DataSets, scatter: Scatter) -> tuple[StructureTest, ...]:
    """Whether the residual holds structure by rate, by temperature, in time, or from one data set to the next.

    The first three are F tests of one mean for each group beside the surface, in the metric of the estimated
    covariance; the last is the correlation of neighbouring innovations.
    """
    p_matrix, _ = projection(scatter.matrix, scatter.design)
    residual = (
        sets.error_dps - scatter.design @ np.linalg.lstsq(scatter.design, sets.error_dps, rcond=None)[0]
    )
    blocks = {
        "rate": rate_groups(sets.rate_dps),
        "temperature": temperature_groups(sets.temp_c),
        "time" if sets.timed else "data_set_index": time_groups(len(sets), STRETCHES),
    }
    results = [
        (name, *_block_test(p_matrix, residual, indicators(groups), scatter.design.shape[1]))
        for name, groups in blocks.items()
        if np.unique(groups).size > 1
    ]
    results = [r for r in results if r[2] > 0]
    results.append(("neighbours", *_neighbour_test(sets, scatter)))
    corrected = holm(np.array([p for *_, p in results]))
    return tuple(
        StructureTest(name, value, dof, p, float(p_holm))
        for (name, value, dof, p), p_holm in zip(results, corrected, strict=True)
    )


def _block_test(
    p_matrix: Floats, residual_dps: Floats, block: Floats, terms: int
) -> tuple[float, int, float]:
    """F statistic, degrees of freedom and p-value of extra columns beside the surface."""
    score = block.T @ (p_matrix @ residual_dps)
    information = block.T @ p_matrix @ block
    values, vectors = np.linalg.eigh(information)
    estimable = values > 1e-8 * max(float(values[-1]), np.finfo(float).tiny)
    gain = float(np.sum((vectors.T @ score)[estimable] ** 2 / values[estimable]))
    dof = int(estimable.sum())
    rest = residual_dps.size - terms - dof
    if dof == 0 or rest < 1:
        return 0.0, dof, 1.0
    noise = max(float(residual_dps @ p_matrix @ residual_dps) - gain, 1e-12) / rest
    f = gain / dof / noise
    return f, dof, float(stats.f.sf(f, dof, rest))


def _neighbour_test(sets: DataSets, scatter: Scatter) -> tuple[float, int, float]:
    """Correlation of each innovation with the one before; two-sided p-value."""
    lower = linalg.cholesky(scatter.matrix, lower=True)
    white = linalg.solve_triangular(lower, np.column_stack([scatter.design, sets.error_dps]), lower=True)
    q = linalg.qr(white[:, :-1], mode="economic")[0]
    innovation = white[:, -1] - q @ (q.T @ white[:, -1])
    power = float(innovation @ innovation)
    if not power > 0:
        return 0.0, 1, 1.0
    product = float(innovation[1:] @ innovation[:-1]) / power
    # Removing the surface correlates white residuals a little: mean and variance of e'Ae/e'e under e = M z.
    shift = np.eye(len(sets), k=1)
    symmetric = 0.5 * (shift + shift.T)
    reduced = symmetric - q @ (q.T @ symmetric)
    reduced -= (reduced @ q) @ q.T
    dof = len(sets) - q.shape[1]
    mean = float(np.trace(reduced)) / dof
    variance = 2.0 * (dof * float(np.sum(reduced**2)) - float(np.trace(reduced)) ** 2) / (dof**2 * (dof + 2))
    z = (product - mean) / np.sqrt(max(variance, np.finfo(float).tiny))
    return float(z), 1, float(2.0 * stats.norm.sf(abs(z)))


def scatter_by_rate(sets: DataSets, residual_dps: Floats, rng: np.random.Generator) -> ScatterByRate | None:
    """Scatter within each |rate| against a straight line in |rate|; None where rates hardly repeat.

    Deviations are taken from the mean of each signed rate (what a surface cannot follow is not scatter) and
    enlarged for the degree of freedom that it costs; groups are compared by mean absolute deviation, which heavy
    tails disturb less than variances (Levene 1960), and by permutation, which assumes no distribution.
    """
    signed = rate_groups(sets.rate_dps)
    size, deviation = np.zeros(len(sets)), np.zeros(len(sets))
    for group in np.unique(signed):
        rows = signed == group
        size[rows] = rows.sum()
        deviation[rows] = residual_dps[rows] - residual_dps[rows].mean()
    usable = size >= _SMALLEST_GROUP
    speed = np.abs(sets.rate_dps)[usable]
    deviation = (deviation * np.sqrt(size / np.maximum(size - 1.0, 1.0)))[usable]
    if speed.size < 3 * _SMALLEST_GROUP or np.ptp(speed) == 0:
        return None
    groups = rate_groups(speed)
    labels = np.unique(groups)
    if labels.size < 3 or rate_groups(sets.rate_dps).max() + 1 > len(sets) // 2:
        return None
    members = indicators(groups)
    n = members.sum(axis=0)
    level = np.abs(deviation)
    line = _positive_line(speed, level)
    ratio = level / line
    std = np.sqrt((deviation**2) @ members / n)
    center = speed @ members / n
    p_value, growth = _permutation_tests(ratio, level, speed, members, rng)
    order = np.argsort(speed)
    at_center = np.interp(center, speed[order], line[order])
    return ScatterByRate(
        rate_dps=center,
        n=n.astype(np.int64),
        std_dps=std,
        trend_dps=at_center * float(np.sqrt(np.mean(ratio**2))),
        neighbours=_against_neighbours(std),
        p_value=p_value,
        growth_p_value=growth,
    )


def _positive_line(x: Floats, y: Floats) -> Floats:
    """Straight line through positive deviations, weighted as their spread grows with their size."""
    design = np.column_stack([np.ones_like(x), x / np.ptp(x)])
    line = np.full_like(y, max(float(y.mean()), np.finfo(float).tiny))
    for _ in range(20):
        weight = 1.0 / line
        fitted = design @ np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)[0]
        line = np.maximum(fitted, 0.05 * float(y.mean()) + np.finfo(float).tiny)
    return line


def _permutation_tests(
    ratio: Floats, level: Floats, speed: Floats, members: Floats, rng: np.random.Generator
) -> tuple[Floats, float]:
    """p-value of each group (largest of all groups under permutation), and of growth with speed."""
    n = members.sum(axis=0)
    shares = members / np.sqrt(n)
    centred = speed - speed.mean()
    seen = np.abs((ratio - ratio.mean()) @ shares)
    slope = float(level @ centred)
    beaten, steeper = np.zeros(n.size), 0
    for _ in range(_PERMUTATIONS):
        order = rng.permutation(ratio.size)
        beaten += np.max(np.abs((ratio[order] - ratio.mean()) @ shares)) >= seen
        steeper += float(level[order] @ centred) >= slope
    return (beaten + 1.0) / (_PERMUTATIONS + 1.0), (steeper + 1.0) / (_PERMUTATIONS + 1.0)


def _against_neighbours(std: Floats) -> Floats:
    lower = np.concatenate([std[1:2], std[:-1]])
    upper = np.concatenate([std[1:], std[-2:-1]])
    return np.asarray(std / np.maximum(0.5 * (lower + upper), np.finfo(float).tiny))
