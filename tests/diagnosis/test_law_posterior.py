"""Intervals over all models of a law whose time constant scatters, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from gyrocal.diagnosis.sweeps.law_posterior import _between, _quantiles


def test_of_one_model_the_interval_is_normal() -> None:
    assert _quantiles(np.ones(1), np.array([20.0]), np.array([2.0])) == pytest.approx(
        (20.0 - 1.959964 * 2.0, 20.0 + 1.959964 * 2.0)
    )


def test_of_two_models_far_apart_each_tail_is_that_of_one() -> None:
    low, high = _quantiles(np.array([0.9, 0.1]), np.array([20.0, 60.0]), np.array([2.0, 1.0]))
    assert low == pytest.approx(norm.ppf(0.025 / 0.9, 20.0, 2.0))
    assert high == pytest.approx(norm.ppf(1.0 - 0.025 / 0.1, 60.0, 1.0))


def test_drawn_models_lie_within_as_often_as_it_says() -> None:
    rng = np.random.default_rng(4)
    share, mean, std = np.array([0.5, 0.3, 0.2]), np.array([10.0, 14.0, 30.0]), np.array([1.0, 2.0, 4.0])
    low, high = _quantiles(share, mean, std)
    kind = rng.choice(3, 20_000, p=share)
    drawn = rng.normal(mean[kind], std[kind])
    assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.95, abs=0.005)


def test_values_of_a_grid_stand_for_half_of_the_way_to_the_next() -> None:
    assert _between(np.array([0.01, 0.98, 0.01]), np.array([100.0, 200.0, 400.0])) == pytest.approx(
        (np.sqrt(100.0 * 200.0) * 2.0 ** (0.015 / 0.98), np.sqrt(200.0 * 400.0) / 2.0 ** (0.015 / 0.98)),
        rel=1e-6,
    )
    # Models that share a value count together.
    assert _between(np.array([0.4, 0.6]), np.array([300.0, 300.0])) == (300.0, 300.0)
