"""Spread between sources: alike ones are not told apart, and the intervals cover."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.inference.spread import mean_square, spread_between, white_at_rest


@pytest.mark.parametrize("spread", [0.0, 2.0])
def test_intervals_of_mean_and_spread_cover(spread: float) -> None:
    rng = np.random.default_rng(11)
    held = np.zeros(3)
    for _ in range(400):
        stds = rng.uniform(0.5, 1.5, 5)
        values = 7.0 + spread * rng.standard_normal(5) + stds * rng.standard_normal(5)
        found = spread_between(values, stds)
        held += [
            found.mean_interval_95[0] <= 7.0 <= found.mean_interval_95[1],
            found.spread_interval_95[0] <= spread <= found.spread_interval_95[1],
            found.p_value < 0.05,
        ]
    mean, between, found_apart = held / 400
    # Binomial scatter of 400 draws is 1.1 %.
    assert 0.92 < mean <= 1.0
    assert 0.92 < between <= 1.0
    assert found_apart < 0.09 if spread == 0.0 else found_apart > 0.5


def test_equal_estimates_have_no_spread() -> None:
    found = spread_between(np.array([3.0, 3.0]), np.array([1.0, 1.0]))
    assert found.spread == 0.0
    assert found.spread_interval_95[0] == 0.0
    assert found.mean == 3.0
    assert found.p_value == pytest.approx(1.0)


@pytest.mark.parametrize("step", [0.0, 1.0])
def test_a_mean_square_minds_neither_outliers_nor_steps(step: float) -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=4000)
    if step:
        values = step * np.round(values / step)
    values[::50] *= 30.0
    # Rounding adds a twelfth of its step squared.
    assert mean_square(values**2) == pytest.approx(1.0 + step**2 / 12.0, rel=0.12)


def test_white_noise_of_a_rest_is_that_of_its_rows_whether_they_come_once_or_twice() -> None:
    rng = np.random.default_rng(5)
    rate, resting, dt_s = 0.2 * rng.standard_normal(4000), np.arange(4000) % 1000 < 500, np.full(4000, 0.02)
    found = white_at_rest(rate, resting, dt_s)
    assert found is not None
    assert found.sure
    assert found.per_rt_hz == pytest.approx(0.2 * np.sqrt(0.02), rel=0.1)
    twice, pairs_s = np.repeat(np.arange(4000), 2), np.tile([0.02, 0.0], 4000)
    assert white_at_rest(rate[twice], resting[twice], pairs_s) == found
    assert white_at_rest(np.zeros(4000), resting, dt_s) is None
    assert white_at_rest(rate, np.zeros(4000, dtype=np.bool_), dt_s) is None


def test_what_a_short_rest_tells_of_the_white_noise_scatters_as_it_says() -> None:
    rng = np.random.default_rng(9)
    resting, dt_s = np.arange(200) < 50, np.full(200, 0.02)
    found = [white_at_rest(0.2 * rng.standard_normal(200), resting, dt_s) for _ in range(400)]
    off = [np.log(x.per_rt_hz / (0.2 * np.sqrt(0.02))) / x.log_std for x in found if x is not None]
    assert not any(x.sure for x in found if x is not None)
    assert len(off) == 400
    assert abs(np.mean(off)) < 0.5
    assert 0.7 < np.std(off) < 1.3
