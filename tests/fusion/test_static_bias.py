"""Static bias: its value, its honest standard error, and when it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.errors import DataError
from gyrocal.fusion import StaticBias, static_bias
from gyrocal.fusion.static_bias import _variance_of_mean

Floats = NDArray[np.float64]
RATE_HZ = 10.0
REST_S = 10.0
T = np.arange(0.0, REST_S + 5.0, 1.0 / RATE_HZ)
STILL = np.zeros(T.size)


def rest(rng: np.random.Generator, correlated: float = 0.0) -> Floats:
    """Bias of 0.3 deg/s, white noise of 0.004 deg/s, and correlated noise of 1 s."""
    noise = rng.normal(0.0, 0.004, T.size)
    state = rng.normal(0.0, 1.0)
    for k in range(T.size):
        state = np.exp(-0.1) * state + np.sqrt(1.0 - np.exp(-0.2)) * rng.normal()
        noise[k] += correlated * state
    return np.asarray(0.3 + noise)


def bias(rate: Floats) -> StaticBias:
    return static_bias(T, STILL, STILL, rate, REST_S)


def test_only_the_rest_is_used() -> None:
    rate = rest(np.random.default_rng(0))
    rate[T > REST_S] = 50.0
    moving = np.where(T > REST_S, 0.1, 0.0)
    found = static_bias(T, moving, moving, rate, REST_S)
    assert found.n == 101
    assert found.duration_s == pytest.approx(REST_S)
    assert found.bias_dps == pytest.approx(0.3, abs=5 * found.std_error_dps)


def test_standard_error_is_honest_for_white_noise() -> None:
    z = [
        (b.bias_dps - 0.3) / b.std_error_dps
        for b in (bias(rest(np.random.default_rng(seed))) for seed in range(400))
    ]
    spread = float(np.dot(z, z))
    # At least white noise's own error, so it may be cautious, but never much too sure.
    assert 0.6 * len(z) < spread < stats.chi2.isf(1e-3, len(z))


def test_standard_error_grows_with_correlated_noise() -> None:
    draws = [bias(rest(np.random.default_rng(seed), 0.004)) for seed in range(200)]
    true = np.std([b.bias_dps for b in draws])
    stated = np.sqrt(np.mean([b.std_error_dps**2 for b in draws]))
    assert 0.7 * true < stated < 1.3 * true


def test_outliers_hardly_move_it() -> None:
    rate = rest(np.random.default_rng(1))
    clean = bias(rate)
    rate[[10, 40]] += 0.4
    spoiled = bias(rate)
    assert abs(spoiled.bias_dps - clean.bias_dps) < 0.0006  # the mean would move by 0.008
    assert spoiled.std_error_dps < 2.0 * clean.std_error_dps


def test_quantised_and_constant_output() -> None:
    rate = np.round(rest(np.random.default_rng(2)) / 0.004) * 0.004
    assert bias(rate).bias_dps == pytest.approx(0.3, abs=0.002)
    constant = bias(np.full(T.size, 0.3))
    assert constant.bias_dps == pytest.approx(0.3)
    assert constant.std_error_dps == pytest.approx(0.0, abs=1e-12)


def test_missing_samples_are_left_out() -> None:
    rate = rest(np.random.default_rng(3))
    rate[5:20] = np.nan
    assert bias(rate).n == 86


@pytest.mark.parametrize("static_s", [0.0, 4.9])
def test_short_rest_is_refused(static_s: float) -> None:
    with pytest.raises(DataError, match=r"takes 5 to 10 s at rest: stand longer"):
        static_bias(T, STILL, STILL, rest(np.random.default_rng(0)), static_s)


def test_rest_without_samples_is_refused() -> None:
    rate = rest(np.random.default_rng(0))
    rate[T > 3.0] = np.nan
    with pytest.raises(DataError, match=r"only 31 finite gyro samples in its first 10 s, the last after 3 s"):
        bias(rate)
    with pytest.raises(DataError, match=r"only 0 finite gyro samples"):
        static_bias([], [], [], [], REST_S)


def test_wheels_that_move_are_refused() -> None:
    moving = np.where(T > 9.5, 0.01, 0.0)
    with pytest.raises(
        DataError, match=r"the robot moves in its first 10 s \(wheels 50 mm.*shorten static_s"
    ):
        static_bias(T, STILL, moving, rest(np.random.default_rng(0)), REST_S)


def test_gyro_that_turns_is_refused_though_the_encoders_stand() -> None:
    rate = rest(np.random.default_rng(0)) + np.where(T > 8.0, 5.0, 0.0)
    with pytest.raises(DataError, match=r"the robot moves"):
        bias(rate)


def test_vibration_is_no_motion() -> None:
    rng = np.random.default_rng(4)
    shaken = 0.3 + rng.normal(0.0, 2.0, T.size)
    assert bias(shaken).bias_dps == pytest.approx(0.3, abs=1.0)


def test_a_sample_a_second_is_enough_and_its_standard_error_holds() -> None:
    rng = np.random.default_rng(1)
    t_s, still = np.arange(8.0), np.zeros(8)
    found = [static_bias(t_s, still, still, 0.02 + 0.01 * rng.standard_normal(8), 7.0) for _ in range(400)]
    inside = [abs(b.bias_dps - 0.02) < 1.96 * b.std_error_dps for b in found]
    assert 0.90 < np.mean(inside) < 0.98


def test_the_variance_of_a_mean_is_that_of_newey_and_west() -> None:
    """Written out: each pair of samples with a weight that falls to nothing over a quarter of the record."""
    x = np.cumsum(np.random.default_rng(4).standard_normal(41))
    x -= x.mean()
    apart = np.abs(np.subtract.outer(np.arange(41), np.arange(41)))
    whole = float(np.sum(np.maximum(1.0 - apart / 11.0, 0.0) * np.outer(x, x)))
    assert _variance_of_mean(x) == pytest.approx(whole / (41 - 10 - 1) / 41)
    assert whole > x @ x
