"""Bias that walks at random between data sets: whether intervals hold it, and whether unchanged gyros are told as such."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from gyrocal.calibration.compare import changes_between
from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.datasets import DataSets
from gyrocal.calibration.figures import common_span, figures_between
from gyrocal.calibration.fit import SurfaceFit, fit_surface, gls_gain, scaled_surface
from gyrocal.inference.flicker import walk_covariance
from tests.calibration.simulation import SURFACE, Floats, flicker

NOISE_DPS = 2e-3
SET_S, SOAK_S = 24.0, 1800.0
UP_AND_DOWN = (-10.0, 5.0, 20.0, 35.0, 50.0, 42.0, 28.0, 12.0, -3.0)


@dataclass(frozen=True)
class Walked:
    """Data sets and the bias at each of them."""

    sets: DataSets
    bias_dps: Floats


@dataclass(frozen=True)
class Plan:
    """Temperatures in order (none: seven, shuffled), rates at each, whether those are shuffled, and whether times are told."""

    temps_c: tuple[float, ...]
    rates: int
    shuffled: bool
    timed: bool


def recording(rng: np.random.Generator, plan: Plan, steps: float, kind: str = "white") -> Walked:
    """Noise, and a walk of so many times the noise from set to set; where times are told, by the time between them."""
    temps = np.array(plan.temps_c) if plan.temps_c else rng.permutation(np.linspace(-10.0, 50.0, 7))
    line = np.linspace(-100.0, 100.0, plan.rates)
    rate = np.concatenate([rng.permutation(line) if plan.shuffled else line for _ in temps])
    temp = np.repeat(temps, line.size) + rng.normal(0.0, 0.1, rate.size)
    t_s = SET_S * np.arange(rate.size) + SOAK_S * np.repeat(np.arange(temps.size), line.size)
    passed = np.diff(t_s, prepend=t_s[0]) / SET_S if plan.timed else np.arange(rate.size) > 0
    bias = np.cumsum(rng.normal(0.0, steps * NOISE_DPS * np.sqrt(passed)))
    noise = rng.normal(0.0, NOISE_DPS, rate.size)
    if kind == "flicker":
        every = int(t_s[-1] / SET_S) + 2
        bias = flicker(rng, every, NOISE_DPS, SET_S)[(t_s / SET_S).astype(np.int64)]
    if kind == "jitter":
        noise = 0.3 * noise + rate * rng.normal(0.0, NOISE_DPS / 50.0, rate.size)
    unknown, told = np.full(rate.size, np.nan), np.full(rate.size, float(plan.timed))
    times = np.where(told > 0, 1.0, np.nan)
    sets = DataSets(
        rate_dps=rate,
        gyro_dps=SURFACE.output_dps(rate, temp) + noise + bias,
        temp_c=temp,
        gyro_std_dps=unknown,
        n=unknown,
        gyro_peak_dps=unknown,
        t_s=t_s * times,
        duration_s=20.0 * times,
        temp_rate_c_per_min=unknown,
        averaging_s=unknown,
        segment=np.arange(1, rate.size + 1),
        outcome=np.full(rate.size, "ok"),
        kind=np.full(rate.size, "rate"),
        reference=np.full(rate.size, "given"),
    )
    return Walked(sets, bias)


def held(walked: Walked, fit: SurfaceFit) -> tuple[Floats, float]:
    """Shares of visited rates and temperatures whose interval holds the error at first, in the middle, at last; of coefficients."""
    g, t = (a.ravel() for a in np.meshgrid(np.linspace(-95.0, 95.0, 20), np.linspace(-9.0, 49.0, 9)))
    columns = fit.surface.design(g, t)
    off = fit.surface.error_dps(g, t) - SURFACE.error_dps(g, t)
    std = np.sqrt(np.einsum("ij,jk,ik->i", columns, fit.covariance_dps2, columns))
    places = [0, len(walked.sets) // 2, -1]
    shares = [np.mean(np.abs(off - walked.bias_dps[place]) < 1.96 * std) for place in places]
    true = np.linalg.lstsq(columns, SURFACE.error_dps(g, t), rcond=None)[0]
    right = np.abs(fit.surface.coefficients_dps.ravel() - true) < fit.half_width_dps().ravel()
    return np.array(shares), float(right[1:].mean())


def changed(one: SurfaceFit, other: SurfaceFit) -> bool:
    span = common_span([one.sets, other.sets])
    return any(c.changed for c in changes_between([figures_between(fit, span) for fit in (one, other)]))


@pytest.mark.parametrize("steps", [0.2, 1.0, 5.0])
def test_the_constant_is_off_from_the_bias_at_either_end_by_what_is_stated(steps: float) -> None:
    """In closed form, for levels that are known and rates and temperatures in random order."""
    rng = np.random.default_rng(1)
    place, apart = np.arange(90.0), np.ones(90)
    cover = np.eye(90) + steps**2 * walk_covariance(place, apart)
    x = np.column_stack([np.ones(90), rng.permutation(np.linspace(-1.0, 1.0, 90))])
    gain = gls_gain(cover, x)
    stated = (gain @ cover @ gain.T)[0, 0]
    for end in (place, place[::-1]):
        walk = np.minimum(end[:, None], end[None, :])
        assert (gain @ (np.eye(90) + steps**2 * walk) @ gain.T)[0, 0] == pytest.approx(stated, rel=0.15)


def test_a_walk_is_seen_and_its_level_told() -> None:
    plan = Plan(UP_AND_DOWN, 15, True, True)
    levels = []
    for k in range(6):
        sets = recording(np.random.default_rng([2, k]), plan, 1.0).sets
        scatter = estimate_scatter(sets, scaled_surface(sets).design(sets.gyro_dps, sets.temp_c))
        assert scatter.seen[3]
        levels.append(scatter.walk_dps)
    assert np.mean(levels) == pytest.approx(NOISE_DPS / np.sqrt(SET_S), rel=0.25)


PLANS = (
    Plan(UP_AND_DOWN, 11, True, False),
    Plan(UP_AND_DOWN, 11, True, True),
    Plan((), 15, False, False),
    Plan((), 15, False, True),
)


def study(
    seeds: Sequence[Sequence[int]], plan: Plan, steps: float, kind: str = "white"
) -> tuple[Floats, float, int]:
    """Means of `held` over recordings, and how many of pairs of neighbours are called changed."""
    walked = [recording(np.random.default_rng(seed), plan, steps, kind) for seed in seeds]
    fits = [fit_surface(each.sets) for each in walked]
    shares = [held(each, fit) for each, fit in zip(walked, fits, strict=True)]
    alarms = sum(changed(*pair) for pair in zip(fits[::2], fits[1::2], strict=True))
    return np.mean([a for a, _ in shares], axis=0), float(np.mean([b for _, b in shares])), alarms


@pytest.mark.slow
def test_intervals_hold_a_bias_that_walks() -> None:
    """A few of the slow test below: without the walk in the scatter 52 to 77 %, and eight of ten pairs changed."""
    shares, coefficients, alarms = study([[3, k] for k in range(20)], PLANS[1], 1.0)
    assert shares.mean() > 0.85
    assert coefficients > 0.9
    assert alarms <= 1


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("steps", [0.2, 0.5, 1.0, 2.0])
def test_coverage_and_false_changes_of_a_bias_that_walks(plan: Plan, steps: float) -> None:
    shares, coefficients, alarms = study([[4, k] for k in range(60)], plan, steps)
    # Of 40 recordings each of 32 others like these 89 to 99 and 90 to 97 % were held, and 13 of 640 pairs called changed.
    assert shares.mean() > 0.86
    assert coefficients > 0.88
    assert alarms <= 4


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("kind", ["white", "flicker", "jitter"])
def test_coverage_and_false_changes_without_a_walk(plan: Plan, kind: str) -> None:
    shares, coefficients, alarms = study([[5, k] for k in range(60)], plan, 0.0, kind)
    assert shares.mean() > 0.88
    assert coefficients > 0.92
    assert alarms <= 2
