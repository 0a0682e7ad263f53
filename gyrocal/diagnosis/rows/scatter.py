"""Changes of variance, a dead gyro, bursts, steps of the output, the sample clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm, poisson

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate, Located
from gyrocal.diagnosis.rows.base import fit_surface
from gyrocal.diagnosis.rows.series import FEWEST_OUTLIERS, OUTLIER_SIGMAS, Series, set_means
from gyrocal.errors import DataError
from gyrocal.inference.multiple import holm
from gyrocal.inference.whitening import NoiseLevels, NoiseModel
from gyrocal.physics.rate import DEAD_ZONE, SATURATION
from gyrocal.physics.sampling import BURSTS, QUANTISATION, TIME_BASE
from gyrocal.physics.surface import SHAPE
from gyrocal.records.scale import output_scale, unclipped
from gyrocal.units import STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: P-value of what is counted and not tested: noise does not put every sample on a lattice.
CERTAIN = 0.0
#: By the surface of the other sets a data set in the dead zone lacks no more than the least output that is left, or little
#: more, since that surface is known to some percent only: a set that lacks more than this many times as much has lost its gyro.
_DEEPER = 1.5
#: Fewest data sets of no output that are a dead zone, and the share of them all beyond which the gyro is not read.
_FEWEST_DEAD, _MOST_DEAD_SHARE = 3, 0.5
#: What is lost must stand out of the noise of a row by this factor.
_LOST_SIGMAS = 5.0
#: Output steps that make less than this share of the variance of a sample are no effect: where they are less than two
#: standard deviations of the noise, rounding is white and independent of it, and averages away as the noise does (Widrow).
_STEP_VARIANCE = 0.25
#: A step is known to this share: distances of many steps are whole multiples of it.
_STEP_KNOWN = 1e-3
#: Sample clocks nearer to nominal than this are as good as any; one that is off is so by this many standard deviations,
#: and is not known better than the crystal that timed it.
_CLOCK_PPM, _CLOCK_STDS, _LEAST_CLOCK_STD_PPM = 20.0, 5.0, 0.01
#: The scale of the noise is an estimate too: outliers that it makes are counted half a standard deviation lower.
_COUNTED_FROM_SIGMAS = OUTLIER_SIGMAS - 0.5
#: Groups whose scatter is compared: fewest rows, stretches of time, and sectors of a turn, deg.
_FEWEST_ROWS, _STRETCHES, _SECTOR_DEG = 20, 40, 15.0


@dataclass(frozen=True)
class Finding:
    """An effect of sampling or scatter, found by a test of its own."""

    effect: str
    seen: Remark
    parameters: dict[str, Estimate]
    p_value: float
    place: Located


def dead_sets(series: Series, output_dps: Floats) -> tuple[Ints, Floats, tuple[float, float]]:
    """Data sets of exactly no output where the surface of the others has one, what it has, and the dead zone's width.

    The zone is at least as wide as the largest output that is lost, and no wider than the least that is not.
    """
    nothing = np.empty(0, dtype=np.int64), np.empty(0), (0.0, 0.0)
    largest = np.zeros(int(series.set_index.max()) + 1)
    np.maximum.at(largest, series.set_index, np.abs(output_dps))
    sets = np.unique(series.set_index[series.is_set])
    dead = sets[largest[sets] == 0.0]
    if not _FEWEST_DEAD <= dead.size < _MOST_DEAD_SHARE * sets.size or np.ptp(series.rate_dps) == 0:
        return nothing
    others = series.take(~np.isin(series.set_index, dead))
    base = fit_surface(others)
    first = np.array([np.flatnonzero(series.set_index == n)[0] for n in dead])
    try:
        lost = base.surface.output_dps(series.rate_dps[first], series.temp_c[first])
    except DataError:
        # Of a gyro that nobody can invert nothing is known of what it would have said.
        return nothing
    noise = STDS_PER_MAD * float(np.median(np.abs(base.residual_dps)))
    least_alive = float(np.min(np.abs(set_means(others, others.gyro_dps)[1])))
    deepest = float(np.max(np.abs(lost)))
    # Sets that lack far more than others show lost their gyro, not a small input.
    if float(np.sqrt(np.mean(lost**2))) < _LOST_SIGMAS * noise or deepest > _DEEPER * least_alive:
        return nothing
    return dead, lost, (deepest, max(least_alive, deepest))


def dead_finding(dead: Ints, lost_dps: Floats, reach: tuple[float, float], sets: int) -> Finding:
    """What data sets of no output say of the dead zone."""
    size, spread = 1e3 * float(np.sqrt(np.mean(lost_dps**2))), 1e3 * float(np.std(lost_dps))
    seen = Remark(Said.DEAD_SETS, {"count": dead.size, "sets": sets, "lost_mdps": 1e3 * reach[0]})
    parameters = {
        "amplitude": Estimate(
            size, spread, "mdeg/s", (1e3 * float(np.min(np.abs(lost_dps))), 1e3 * reach[0])
        ),
        # It may be no wider than what it is seen to swallow.
        "width_dps": Estimate(reach[0], 0.25 * (reach[1] - reach[0]), "deg/s", reach),
    }
    place = Located("rate", "mean", CERTAIN, 1.0, target="output", finding=DEAD_ZONE.id)
    return Finding(DEAD_ZONE.id, seen, parameters, CERTAIN, place)


def clipped_finding(series: Series, output_dps: Floats) -> tuple[Ints, Finding | None]:
    """Data sets of an output at an end of its range, and what they say of the saturation; none where the others are too few for a surface.

    Parameters
    ----------
    output_dps : ndarray, shape (n,)
        The output as recorded.
    """
    nothing = np.empty(0, dtype=np.int64), None
    if not series.is_set.any():
        return nothing
    (sets, rate_dps), (_, output_dps), (_, temp_c) = (
        set_means(series, x) for x in (series.rate_dps, output_dps, series.temp_c)
    )
    free = unclipped(rate_dps, output_dps, temp_c)
    clipped, size_dps = sets[~free], np.abs(rate_dps)
    if not 0 < clipped.size < sets.size - SHAPE[0] * SHAPE[1]:
        return nothing
    slowest = float(np.min(size_dps[~free]))
    fastest = float(np.max(size_dps[free & (size_dps < slowest)], initial=0.0))
    scale = output_scale(rate_dps[free], output_dps[free])
    at_dps = float(np.median(np.abs(output_dps[~free]))) / scale
    knee = Estimate.spanning(float(np.clip(at_dps, fastest, slowest)), (fastest, slowest), "deg/s")
    facts = {"count": int(clipped.size), "sets": int(sets.size), "least_dps": slowest}
    # All of the gain is lost: the output is the same at the last digit, or as good as.
    parameters = {"amplitude": Estimate(1.0, 0.0, "1", (1.0, 1.0)), "knee_dps": knee}
    place = Located("rate", "mean", CERTAIN, 1.0, target="output", finding=SATURATION.id)
    return clipped, Finding(SATURATION.id, Remark(Said.CLIPPED, facts), parameters, CERTAIN, place)


def outlier_findings(series: Series) -> list[Finding]:
    """Isolated samples that no Gaussian noise makes."""
    count = series.raw.outliers_t_s.size
    if count < FEWEST_OUTLIERS:
        return []
    expected = series.raw.samples * 2.0 * float(norm.sf(_COUNTED_FROM_SIGMAS))
    # Tails far out are not those of a Gaussian to the last digit: where none is expected, each counts as one in e.
    p = float(np.exp(-count) if expected < 1 else poisson.sf(count - 1, expected))
    size = 1e3 * float(np.sqrt(np.mean(series.raw.outliers_dps**2)))
    share = count / series.raw.samples
    times = series.raw.outliers_t_s
    seen = Remark(Said.BURST_SAMPLES, {"count": count, "samples": series.raw.samples})
    place = Located(
        "data_set_index",
        "variance",
        p,
        0.0,
        **_when(series, float(times.min()), float(times.max())),
        target="samples",
        finding=BURSTS.id,
    )
    spread = size / np.sqrt(2.0 * count)
    low = float(chi2.ppf(0.025, 2 * count)) / 2.0 / series.raw.samples
    high = float(chi2.ppf(0.975, 2 * count + 2)) / 2.0 / series.raw.samples
    return [
        Finding(
            BURSTS.id,
            seen,
            {
                "amplitude": Estimate.normal(size, spread, "mdeg/s"),
                # Of a burst the lesser samples are within the noise: the share of time inside bursts is larger.
                "share_seen": Estimate(share, share / np.sqrt(count), "1", (low, high)),
            },
            p,
            place,
        )
    ]


def step_findings(series: Series) -> list[Finding]:
    """Output in steps coarse enough to add noise to a sample."""
    step, noise = series.raw.lattice_dps, series.raw.sample_std_dps
    if step is None or noise is None or step**2 / 12.0 < _STEP_VARIANCE * noise**2:
        return []
    size = 1e3 * step
    seen = Remark(Said.OUTPUT_STEPS, {"step_mdps": size, "noise_mdps": size / np.sqrt(12)})
    place = Located("rate", "variance", CERTAIN, 0.0, target="samples", finding=QUANTISATION.id)
    return [
        Finding(
            QUANTISATION.id,
            seen,
            {"amplitude": Estimate.normal(size, _STEP_KNOWN * size, "mdeg/s")},
            CERTAIN,
            place,
        )
    ]


def clock_findings(series: Series) -> list[Finding]:
    """A sample clock whose samples arrive at another interval than the data sheet's."""
    ratio, std = series.raw.interval_ratio, series.raw.interval_ratio_std
    if ratio is None or std is None:
        return []
    ppm, std_ppm = 1e6 * ratio, max(1e6 * std, _LEAST_CLOCK_STD_PPM)
    if abs(ppm) < max(_CLOCK_PPM, _CLOCK_STDS * std_ppm):
        return []
    p = float(2.0 * norm.sf(abs(ppm) / std_ppm))
    seen = Remark(Said.SAMPLE_CLOCK, {"ppm": ppm})
    place = Located("rate", "mean", p, 0.0, target="sample times", finding=TIME_BASE.id)
    return [Finding(TIME_BASE.id, seen, {"amplitude": Estimate.normal(ppm, std_ppm, "ppm")}, p, place)]


@dataclass(frozen=True)
class _Group:
    """Rows of a stretch of a coordinate: the p-value of their scatter, and by how much their squares exceed the others'."""

    coordinate: str
    stretch: Mapping[str, Any]
    p_value: float
    excess: float


def variance_places(
    series: Series, model: NoiseModel, levels: NoiseLevels, left_dps: Floats, level: float
) -> list[Located]:
    """Where the innovations scatter more than the noise model says: by rate, angle, time and data set.

    Each group's sum of squares is compared with the others', with the kurtosis that the innovations have, so
    that heavy tails alone raise no alarm. Holm over all groups of all coordinates.

    Parameters
    ----------
    left_dps : ndarray, shape (n,)
        What the model of the mean leaves of every row.
    """
    squares = model.whiten(levels, left_dps[:, None])[0][:, 0] ** 2
    mean, spread = float(np.mean(squares)), float(np.std(squares))
    found: list[_Group] = []
    for coordinate, groups, stretches in _groupings(series):
        count = np.bincount(groups).astype(np.float64)
        excess = np.bincount(groups, weights=squares) - count * mean
        # A sum of squares is skewed: a chi-square of as many degrees of freedom as give it its mean and spread.
        df = 2.0 * count * mean**2 / spread**2
        usable = np.flatnonzero(count >= _FEWEST_ROWS)
        z = excess[usable] / (spread * np.sqrt(count[usable]))
        p = np.minimum(2.0 * chi2.sf(df[usable] + z * np.sqrt(2.0 * df[usable]), df[usable]), 1.0)
        found += [
            _Group(coordinate, stretches[g], float(p_g), float(excess[g]))
            for g, p_g in zip(usable.tolist(), p, strict=True)
        ]
    if not found:
        return []
    passed = holm(np.array([g.p_value for g in found])) <= level
    beyond = [g for g, ok in zip(found, passed, strict=True) if ok]
    whole = sum(max(g.excess, 0.0) for g in beyond)
    best: dict[str, _Group] = {}
    for g in beyond:
        if g.coordinate not in best or g.p_value < best[g.coordinate].p_value:
            best[g.coordinate] = g
    places = [
        Located(
            g.coordinate,
            "variance",
            min(1.0, g.p_value * len(found)),
            float(np.clip(g.excess / whole, 0.0, 1.0)),
            True,
            **g.stretch,
        )
        for g in best.values()
    ]
    return sorted(places, key=lambda place: place.p_value)


def _when(series: Series, from_s: float, to_s: float) -> dict[str, Any]:
    """A stretch of the record, in time or, where there is none, in data sets."""
    if series.has_time:
        return {"low": from_s, "high": to_s, "unit": "s"}
    return {
        "low": round(series.data_set_at(from_s)),
        "high": round(series.data_set_at(to_s)),
        "unit": "data set",
    }


def _groupings(series: Series) -> list[tuple[str, Ints, Sequence[Mapping[str, Any]]]]:
    """Coordinates, the group of each row, and where each group is."""
    found: list[tuple[str, Ints, Sequence[Mapping[str, Any]]]] = []
    sizes, by_size = np.unique(np.round(np.abs(series.rate_dps), 2), return_inverse=True)
    if 2 < sizes.size <= 60:
        at = [{"low": float(s), "high": float(s), "unit": "deg/s"} for s in sizes]
        found.append(("rate", by_size.astype(np.int64), at))
    edges_s = np.linspace(series.t_s[0], series.t_s[-1], _STRETCHES + 1)
    by_time = np.clip(np.searchsorted(edges_s, series.t_s, side="right") - 1, 0, _STRETCHES - 1)
    found.append(
        (series.time_coordinate, by_time, [_when(series, float(a), float(b)) for a, b in pairwise(edges_s)])
    )
    if series.angle_deg is not None and np.ptp(series.rate_dps) > 0:
        sectors = round(360.0 / _SECTOR_DEG)
        sector = np.floor(np.mod(series.angle_deg, 360.0) / _SECTOR_DEG).astype(np.int64)
        sector = np.where(np.abs(series.rate_dps) > 0, sector, sectors)
        at = [{"low": _SECTOR_DEG * k, "high": _SECTOR_DEG * (k + 1), "unit": "deg"} for k in range(sectors)]
        found.append(("table_angle", sector, [*at, {"target": "rest"}]))
    if not series.is_table:
        last = int(series.set_index.max()) + 1
        at = [{"low": k + 1.0, "high": k + 1.0, "unit": "data set"} for k in range(last)]
        found.append(("data_set_index", series.set_index, at))
    return found
