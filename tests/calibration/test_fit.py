"""The surface fit: the paper's least squares, its weights, and intervals that cover what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.fit import (
    TERMS,
    SurfaceFit,
    fit_surface,
    rms,
    scaled_surface,
    studentised_residuals,
)
from gyrocal.inference.flicker import TIME_CONSTANTS_S
from gyrocal.physics.surface import SHAPE, Surface
from tests.calibration.simulation import SURFACE, Floats, quick_run, simulate

#: Chance that a correct test of coverage fails.
FALSE_ALARM = 1e-3
#: The bias over temperature alone.
BIAS = np.arange(TERMS) < SHAPE[1]


def true_coefficients(scaled: Surface) -> Floats:
    """The simulated surface in the variables of a scaled one: exact, both are polynomials of the same orders."""
    g, t = (a.ravel() for a in np.meshgrid(np.linspace(-100, 100, 9), np.linspace(-10, 50, 7)))
    design = scaled.design(g, t)
    return np.asarray(np.linalg.lstsq(design, SURFACE.error_dps(g, t), rcond=None)[0]).reshape(4, 3)


def test_without_noise_the_surface_comes_back_exactly() -> None:
    sets = simulate(np.random.default_rng(1), arw_dps_rt_s=1e-9, floor_dps=1e-12, jitter=0.0)
    fit = fit_surface(sets)
    np.testing.assert_allclose(fit.surface.coefficients_dps, true_coefficients(fit.surface), atol=1e-8)


def test_equal_weights_are_the_least_squares_of_the_paper() -> None:
    """But for the noise in the measured output, which moves the surface by a share of its slope: 2 % of 0.3 mdeg/s."""
    sets = simulate(np.random.default_rng(2))
    fit = fit_surface(sets, "ols")
    design = scaled_surface(sets).design(sets.gyro_dps, sets.temp_c)
    expected = np.linalg.lstsq(design, sets.gyro_dps - sets.rate_dps, rcond=None)[0]
    np.testing.assert_allclose(fit.surface.coefficients_dps.ravel(), expected, atol=2e-5)
    np.testing.assert_allclose(fit.ols.coefficients_dps, fit.surface.coefficients_dps)
    np.testing.assert_allclose(fit.residual_dps, sets.error_dps - design @ expected, atol=2e-5)


def test_scaled_design_is_well_conditioned() -> None:
    sets = simulate(np.random.default_rng(3))
    raw = np.polynomial.polynomial.polyvander2d(sets.gyro_dps, sets.temp_c, [3, 2])
    assert fit_surface(sets).condition < 40 < 1e6 < np.linalg.cond(raw)


def test_sample_noise_in_the_output_does_not_bias_the_slope() -> None:
    """Errors in variables: per-sample regression at low rates attenuates, data-set means do not.

    Rates of +-0.02 deg/s against 4.4 mdeg/s of sample noise: theory gives var(noise) / var(output) = 0.10 of the
    slope 1 of output over rate for samples, and 1 / 200 of that for means of 200 samples.
    """
    rng = np.random.default_rng(4)
    rate = np.repeat(np.linspace(-0.02, 0.02, 9), 30)
    samples = rate[:, None] + rng.normal(0.0, 4.4e-3, (rate.size, 200))
    error = samples - rate[:, None]

    def slope(x: Floats, y: Floats) -> float:
        return float(np.polyfit(x.ravel(), y.ravel(), 1)[0])

    attenuation = 4.4e-3**2 / (4.4e-3**2 + rate.var())
    uncertainty = 4.4e-3 / np.sqrt(error.size * rate.var())
    by_sample, by_set = slope(samples, error), slope(samples.mean(axis=1), error.mean(axis=1))
    assert by_sample == pytest.approx(attenuation, abs=4 * uncertainty)
    assert by_sample > 20 * uncertainty
    assert by_set == pytest.approx(attenuation / 200, abs=4 * uncertainty)
    # At the paper's rates the bias of means is far below every uncertainty: 0.31 mdeg/s against 60 deg/s rms.
    assert (0.31e-3 / 60.0) ** 2 < 1e-10


def test_flicker_sum_has_the_spectrum_of_bias_instability() -> None:
    """A unit variance a decade is S(f) = 1 / (ln 10 f) to 6 %, over the decades in the middle."""
    f = np.geomspace(1e-3, 1e-2, 50)
    one_sided = sum(4 * tau / (1 + (2 * np.pi * f * tau) ** 2) for tau in TIME_CONSTANTS_S)
    np.testing.assert_allclose(one_sided * f * np.log(10.0), 1.0, rtol=0.06)


@pytest.mark.slow
def test_levels_of_the_scatter_are_found() -> None:
    rng = np.random.default_rng(5)
    found = []
    for _ in range(8):
        sets = simulate(rng, jitter=2e-5, floor_dps=1e-3)
        s = estimate_scatter(sets, scaled_surface(sets).design(sets.gyro_dps, sets.temp_c))
        found.append((s.flicker_dps, s.jitter))
    # S(f) = B^2 / (2 pi f) two-sided, r^2 / (ln 10 f) one-sided: r^2 = B^2 ln 10 / pi.
    truth = np.array([1e-3 / 0.664 * np.sqrt(np.log(10.0) / np.pi), 2e-5])
    uncertainty = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    factor = stats.t.ppf(1 - FALSE_ALARM / 4, len(found) - 1)
    assert np.all(np.abs(np.mean(found, axis=0) - truth) < factor * uncertainty)
    assert np.all(uncertainty < 0.1 * truth)


def test_noisy_rates_count_for_less() -> None:
    errors = []
    for seed in range(10):
        sets = simulate(np.random.default_rng([6, seed]), jitter=3e-4, floor_dps=1e-5)
        g, t = np.meshgrid(np.linspace(-20, 20, 5), np.linspace(-10, 50, 4))
        truth = SURFACE.error_dps(g, t)
        fit = fit_surface(sets)
        errors.append([rms(s.error_dps(g, t) - truth) for s in (fit.surface, fit.ols)])
    weighted, equal = np.mean(np.square(errors), axis=0)
    assert weighted < 0.3 * equal


def _studentised(fit: SurfaceFit) -> NDArray[np.float64]:
    return studentised_residuals(fit.scatter, fit.sets.error_dps)


def test_studentised_residuals_are_student() -> None:
    values = np.concatenate(
        [_studentised(fit_surface(simulate(np.random.default_rng([7, k])))) for k in range(8)]
    )
    assert stats.kstest(values, stats.t(100).cdf).pvalue > FALSE_ALARM


def _white(dof: float) -> SurfaceFit:
    """A fit under white scatter alone, whose variance is an inverse gamma law of so many degrees of freedom."""
    sets = simulate(np.random.default_rng(8))
    law = stats.invgamma(dof / 2.0, scale=dof / 2.0 * 1e-6)
    n, level = len(sets), float(law.mean())
    scatter = replace(
        fit_surface(sets).scatter,
        matrix=level * np.eye(n),
        parts=(np.ones(n),),
        level_covariance=np.array([[float(law.var())]]),
    )
    return fit_surface(sets, scatter=scatter)


def test_a_variance_that_is_known_to_a_few_degrees_of_freedom_makes_students_law_of_as_many() -> None:
    fit = _white(12.0)
    np.testing.assert_allclose(fit.dof, 12.0, rtol=1e-6)
    unit = stats.t(12.0, scale=1.0 / stats.t(12.0).std())
    np.testing.assert_allclose(fit.half_width_dps() / fit.std_dps, unit.ppf(0.975), rtol=1e-6)


def test_a_studentised_residual_is_that_of_a_fit_to_the_others() -> None:
    fit = _white(12.0)
    y, x, studentised = fit.sets.error_dps, fit.design, _studentised(fit)
    for k in (0, 17, 40):
        others = np.delete(np.arange(y.size), k)
        b, squares, *_ = np.linalg.lstsq(x[others], y[others], rcond=None)
        variance = float(squares[0]) / (others.size - x.shape[1])
        spread = 1.0 + x[k] @ np.linalg.solve(x[others].T @ x[others], x[k])
        expected = (y[k] - x[k] @ b) / np.sqrt(variance * spread)
        assert studentised[k] == pytest.approx(expected, rel=1e-6)


def inside(fit: SurfaceFit) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which 95 % intervals hold the truth: of the coefficients, shape (12,), and of errors predicted over the range."""
    g, t = (a.ravel() for a in np.meshgrid(np.linspace(-100, 100, 9), np.linspace(-10, 50, 7)))
    design = fit.surface.design(g, t)
    miss = (fit.surface.coefficients_dps - true_coefficients(fit.surface)).ravel()
    # What `Coefficients.sigma_dps` gives to the user.
    sigma = np.sqrt(np.sum(design @ fit.covariance_dps2 * design, axis=1))
    coefficients = np.abs(miss) <= fit.half_width_dps().ravel()
    return coefficients, np.asarray(np.abs(design @ miss) <= stats.norm.ppf(0.975) * sigma)


def coverage(
    runs: int, seed: int, weights: str, plan: str, **conditions: float | bool
) -> tuple[Floats, Floats]:
    """Share of 95 % intervals that hold the truth: coefficients, shape (12,), and predicted errors, shape (63,)."""
    found = []
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        if plan == "quick":
            sets, rest = quick_run(rng, **conditions)
        else:
            sets, rest = simulate(rng, **conditions), None  # type: ignore[arg-type]
        found.append(inside(fit_surface(sets, "gls" if weights == "gls" else "ols", rest=rest)))
    coefficients, predicted = (np.mean(column, axis=0) for column in zip(*found, strict=True))
    return coefficients, predicted


@pytest.mark.slow
def test_intervals_cover() -> None:
    """Twelve intervals of 12 runs, correlated among themselves: an effective size of about 12 x 12 / 3."""
    found = coverage(12, 8, "gls", "quick")[0].mean()
    low, high = stats.binom(48, 0.95).interval(1 - FALSE_ALARM)
    assert low / 48 <= found <= high / 48


@pytest.mark.slow
def test_intervals_of_forty_small_tables_cover() -> None:
    """Fifteen data sets for twelve coefficients: the levels of the scatter are hardly known, and have to be integrated.

    With the levels taken at their peak, exactly or with its curvature, a share of 0.82 is covered. The twelve
    intervals of a table hang together like three.
    """
    few: dict[str, Any] = {"rates": np.linspace(-100.0, 100.0, 5), "temps": np.array([-10.0, 50.0, 20.0])}
    tables = [simulate(np.random.default_rng([12, k]), floor_dps=1e-3, **few) for k in range(40)]
    found = np.mean([inside(fit_surface(sets))[0] for sets in tables])
    low, high = stats.binom(3 * len(tables), 0.95).interval(1 - FALSE_ALARM)
    assert low <= 3 * len(tables) * found <= high


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("weights", "plan", "conditions"),
    [
        ("gls", "full", {}),
        ("gls", "full", {"floor_dps": 2e-3, "jitter": 2e-5}),
        ("gls", "full", {"timed": False}),
        ("ols", "full", {}),
        ("gls", "quick", {}),
        ("gls", "quick", {"floor_dps": 2e-3}),
    ],
)
def test_intervals_cover_93_to_97_percent(
    weights: str,
    plan: str,
    conditions: dict[str, float | bool],
    record_property: Callable[[str, object], None],
) -> None:
    runs = 500
    coefficients, predicted = coverage(runs, 9, weights, plan, **conditions)
    record_property("coefficients", coefficients.round(3).tolist())
    record_property("predicted", [predicted.mean(), predicted.min(), predicted.max()])
    # A single share has its own binomial scatter about those bounds; predicted errors of a run hang together like
    # about three, which leaves their mean some scatter too.
    error = np.sqrt(0.05 * 0.95 / runs)
    slack = stats.norm.ppf(1 - FALSE_ALARM / 24) * error
    assert 0.93 <= coefficients.mean() <= 0.97
    assert np.all(coefficients > 0.93 - slack)
    assert abs(predicted.mean() - 0.95) <= 0.02 + stats.norm.ppf(1 - FALSE_ALARM / 2) * error / np.sqrt(3.0)
    assert np.all(predicted > 0.93 - slack)


def test_ordinary_intervals_of_least_squares_do_not_cover() -> None:
    """The reason for the covariance: what least squares says of itself is too narrow under 1/f noise."""
    hits = []
    for k in range(20):
        sets = simulate(np.random.default_rng([10, k]), floor_dps=2e-3)
        scaled = scaled_surface(sets)
        design, dof = scaled.design(sets.gyro_dps, sets.temp_c), len(sets) - 12
        found, squares, *_ = np.linalg.lstsq(design, sets.error_dps, rcond=None)
        variance = squares[0] / dof * np.diag(np.linalg.inv(design.T @ design))
        half = stats.t.ppf(0.975, dof) * np.sqrt(variance)
        hits.append(np.abs(found - true_coefficients(scaled).ravel()) <= half)
    over_temperature = np.mean(hits, axis=0)[:3]
    assert over_temperature.mean() < 0.85


def test_bias_terms_only() -> None:
    sets = simulate(np.random.default_rng(11), rates=np.zeros(1), temps=np.linspace(-10, 50, 30))
    fit = fit_surface(sets, "gls", BIAS)
    assert np.all(fit.surface.coefficients_dps[1:] == 0)
    assert np.all(fit.std_dps[1:] == 0)
    t = np.linspace(-5, 45, 7)
    np.testing.assert_allclose(fit.surface.error_dps(0.0, t), SURFACE.error_dps(0.0, t), atol=3e-3)
