"""What records at rest say about 1/f noise and a walk, and levels that are integrated over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.fit import scaled_surface
from gyrocal.inference.flicker import Rest, flicker_correlation, merge_rest, rest_of_windows, walk_covariance
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


def test_covariance_of_a_walk_is_half_of_each_ends() -> None:
    """The mean over both windows of walks from the first instant and from the last."""
    t, d = np.array([5.0, 40.0, 90.0]), np.array([10.0, 20.0, 20.0])
    fine = [a - b / 2 + b * (np.arange(400) + 0.5) / 400 for a, b in zip(t, d, strict=True)]
    found = walk_covariance(t, d)
    for i, x in enumerate(fine):
        for j, y in enumerate(fine):
            first = np.minimum(x[:, None], y[None, :])
            last = np.minimum(100.0 - x[:, None], 100.0 - y[None, :])
            assert found[i, j] == pytest.approx(0.5 * (first + last).mean(), rel=1e-3)


def best_level(rest: Rest) -> float:
    levels = np.geomspace(1e-5, 1e-2, 61)
    return float(levels[np.argmin([rest.cost(level**2, 0.0)[0] for level in levels])])


def test_records_at_rest_tell_the_level() -> None:
    levels = [best_level(quick_run(np.random.default_rng([1, k]), floor_dps=5e-4)[1]) for k in range(12)]
    assert np.mean(levels) == pytest.approx(DECADE_DPS, rel=0.1)


def test_records_at_rest_tell_the_level_of_a_walk() -> None:
    """White noise of 1 mdeg/s a window and a walk of 0.5 from window to window, 20 s long, by cumulated sums of a fine grid."""
    rng, step_s, finer = np.random.default_rng(9), 20.0, 20
    walk = 5e-4 / np.sqrt(step_s)
    found = []
    for _ in range(12):
        fine = np.cumsum(rng.normal(0.0, walk * np.sqrt(step_s / finer), (8, 40 * finer)), axis=1)
        rows = fine.reshape(8, 40, finer).mean(axis=2) + rng.normal(0.0, 1e-3, (8, 40))
        middle, none = step_s * (np.arange(40, dtype=np.float64) + 0.5), np.full(40, np.nan)
        rest = merge_rest(
            [rest_of_windows(middle, np.asarray(row, dtype=np.float64), none, step_s) for row in rows]
        )
        assert rest is not None
        levels = walk * np.geomspace(0.3, 3.0, 41)
        found.append(levels[np.argmin([rest.cost(0.0, level**2)[0] for level in levels])])
    assert np.mean(found) == pytest.approx(walk, rel=0.1)


def test_slope_of_the_cost() -> None:
    _, rest = quick_run(np.random.default_rng(2))
    levels = np.array([1e-7, 1e-10])
    for k, step in enumerate(1e-3 * np.diag(levels)):
        numeric = (rest.cost(*(levels + step))[0] - rest.cost(*(levels - step))[0]) / (2 * step[k])
        assert rest.cost(*levels)[1 + k] == pytest.approx(numeric, rel=1e-3)


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
    assert both.cost(1e-7, 1e-10)[0] == pytest.approx(2 * one.cost(1e-7, 1e-10)[0])
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


def test_a_rare_level_that_is_not_seen_is_mostly_nothing() -> None:
    """Even odds of nothing against a law of which the likelihood, half a normal law, leaves a part."""
    spread = 0.4

    def log_likelihood(share: Floats) -> float:
        return float(-0.5 * (share[0] / spread) ** 2)

    found = integrate(log_likelihood, np.zeros(1), np.array([True]))
    share = np.linspace(0.0, 20.0, 2_000_001)
    left = np.exp(-0.5 * (share / spread) ** 2) * 4.0 / np.pi * (share / (1.0 + share**2)) ** 2 * share[1]
    assert found.mean[0] == pytest.approx(float(left @ share**2) / (1.0 + float(left.sum())), rel=0.1)


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
    assert scatter.flicker_dps > 2 * DECADE_DPS
