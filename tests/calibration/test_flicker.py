"""What records at rest say about 1/f noise, and levels that are integrated over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.fit import scaled_surface
from gyrocal.inference.flicker import Rest, flicker_correlation, merge_rest, rest_of_windows
from gyrocal.inference.levels import integrate
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.simulation import Floats, quick_run

#: Standard deviation a decade of 1/f noise whose Allan floor is 0.5 mdeg/s.
DECADE_DPS = 5e-4 / 0.664 * np.sqrt(np.log(10.0) / np.pi)


def test_flicker_correlation_is_the_mean_over_both_windows() -> None:
    t, d = np.array([5.0, 40.0]), np.array([10.0, 20.0])
    fine = [np.linspace(a - b / 2, a + b / 2, 4001)[:-1] + b / 8000 for a, b in zip(t, d, strict=True)]
    found = flicker_correlation(t, d, (7.0,))
    for i, j in ((0, 0), (0, 1), (1, 1)):
        x, y = fine[i][::10], fine[j][::10]
        expected = np.exp(-np.abs(x[:, None] - y[None, :]) / 7.0).mean()
        assert found[i, j] == pytest.approx(expected, rel=2e-3)


def best_level(rest: Rest) -> float:
    levels = np.geomspace(1e-5, 1e-2, 61)
    return float(levels[np.argmin([rest.cost(level**2)[0] for level in levels])])


def test_records_at_rest_tell_the_level() -> None:
    levels = [best_level(quick_run(np.random.default_rng([1, k]), floor_dps=5e-4)[1]) for k in range(12)]
    assert np.mean(levels) == pytest.approx(DECADE_DPS, rel=0.1)


def test_slope_of_the_cost() -> None:
    _, rest = quick_run(np.random.default_rng(2))
    level, step = 1e-7, 1e-10
    numeric = (rest.cost(level + step)[0] - rest.cost(level - step)[0]) / (2 * step)
    assert rest.cost(level)[1] == pytest.approx(numeric, rel=1e-3)


def test_bias_drift_in_time_and_with_temperature_is_not_flicker() -> None:
    rng = np.random.default_rng(3)
    t = 5.0 + 10.0 * np.arange(64, dtype=np.float64)
    temp = 0.3 * np.exp(-t / 200.0) + rng.normal(0, 1e-3, t.size)
    white = rng.normal(0, 4e-4, t.size)
    plain = rest_of_windows(t, white, temp, 10.0)
    tilted = rest_of_windows(t, white + 0.02 + 1e-4 * t + 0.05 * temp, temp, 10.0)
    np.testing.assert_allclose(tilted.square, plain.square, atol=1e-15)
    np.testing.assert_allclose(tilted.gain, plain.gain)


def test_merged_records_add_up() -> None:
    _, one = quick_run(np.random.default_rng(4))
    both = merge_rest([one, None, one])
    assert both is not None
    assert both.cost(1e-7)[0] == pytest.approx(2 * one.cost(1e-7)[0])
    assert (both.records, both.span_s) == (2 * one.records, 2 * one.span_s)
    assert merge_rest([None]) is None


def at_rest(kind: str, seconds: int, temp_c: Floats, outcome: str = "ok") -> Part:
    rng = np.random.default_rng(5)
    rows = [gyro_row(float(i), f"{rng.normal(0, 1e-3):.6f}", f"{temp_c[i]:.4f}") for i in range(seconds)]
    return Part(rows, kind=kind, outcome=outcome, averaging_s=1.0)


def test_which_segments_are_records_at_rest(tmp_path: Path) -> None:
    steady = np.full(700, 20.0)
    settling = 20.0 - 5.0 * np.exp(-np.arange(700) / 80.0)
    parts = [
        at_rest("rate", 40, steady),
        at_rest("static", 640, steady),
        at_rest("soak", 640, settling),
        at_rest("soak", 640, np.linspace(0.0, 30.0, 700)),
        at_rest("static", 640, steady, "unsettled"),
        at_rest("static", 200, steady),
    ]
    rest = load_recording(write_run(tmp_path / "run", parts)).rest
    assert rest is not None
    # The soak counts from when it is within half a degree of its end: 80 s times ln(5 / 0.5), about.
    assert rest.records == 2
    assert rest.span_s == pytest.approx(640 + 640 - 185, abs=15)
    # A constant and two straight lines are taken off; the static one has no slope in temperature.
    assert rest.gain.size == 64 - 2 + round((rest.span_s - 640) / 10) - 3


def test_a_gap_and_missing_temperatures_are_no_trouble(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    rows = [
        gyro_row(float(i), f"{rng.normal(0, 1e-3):.6f}", "" if i > 300 else 20.0)
        for i in range(640)
        if not 100 <= i < 200
    ]
    rest = load_recording(write_run(tmp_path / "run", [Part(rows, kind="static")])).rest
    assert rest is not None
    assert rest.span_s == pytest.approx(540.0, abs=11.0)


def test_integration_of_a_normal_law() -> None:
    """Two correlated normal shares far from zero: moments of the squares are known (prior as good as flat)."""
    mean, covariance = np.array([0.03, 0.05]), 1e-6 * np.array([[4.0, 2.4], [2.4, 9.0]])
    precision = np.linalg.inv(covariance)

    def log_likelihood(share: Floats) -> float:
        return float(-0.5 * (share - mean) @ precision @ (share - mean))

    found = integrate(log_likelihood, mean)
    np.testing.assert_allclose(found.mean, mean**2 + np.diag(covariance), rtol=2e-3)
    cross = 4 * np.outer(mean, mean) * covariance + 2 * covariance**2
    np.testing.assert_allclose(found.covariance, cross, rtol=0.05)
    np.testing.assert_allclose(found.upper, (mean + 1.645 * np.sqrt(np.diag(covariance))) ** 2, rtol=0.04)


def test_a_level_at_the_boundary_is_not_known_to_be_nothing() -> None:
    def log_likelihood(share: Floats) -> float:
        return float(-0.5 * (share[0] / 0.1) ** 2)

    found = integrate(log_likelihood, np.zeros(1))
    # Half a normal law: the mean square is its variance, the 95 % bound 1.96 of its standard deviations.
    assert found.mean[0] == pytest.approx(0.01, rel=0.03)
    assert found.covariance[0, 0] == pytest.approx(2e-4, rel=0.1)
    assert np.sqrt(found.upper[0]) == pytest.approx(0.196, rel=0.05)


def test_drift_that_the_temperatures_hide_is_in_the_interval() -> None:
    """The run's own data sets hardly see drift between five temperatures; the stated error must hold it all the same."""
    rng = np.random.default_rng(7)
    sets, rest = quick_run(rng, floor_dps=5e-4)
    design = scaled_surface(sets).design(sets.gyro_dps, sets.temp_c)
    with_rest = estimate_scatter(sets, design, rest)
    assert with_rest.rest is rest
    assert with_rest.seen[1]
    assert with_rest.flicker_dps == pytest.approx(DECADE_DPS, rel=0.4)
    alone = estimate_scatter(sets, design)
    assert alone.upper[1] > DECADE_DPS**2


def test_data_sets_that_drift_more_than_rest_allows_speak_for_themselves() -> None:
    rng = np.random.default_rng(8)
    sets, _ = quick_run(rng, floor_dps=4e-3)
    _, quiet = quick_run(rng, floor_dps=2e-4)
    design = scaled_surface(sets).design(sets.gyro_dps, sets.temp_c)
    scatter = estimate_scatter(sets, design, quiet)
    assert scatter.rest_disagrees
    assert scatter.rest is None
    assert scatter.flicker_dps > 4 * DECADE_DPS
