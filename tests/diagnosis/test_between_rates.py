"""Models over all shapes that a law of the rate may have: so many stand for all of them."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from gyrocal.diagnosis.answer.between_rates import Weighted, sampled
from gyrocal.diagnosis.model.layers import Fitted


def models(sizes: np.ndarray, weights: np.ndarray) -> list[Weighted]:
    """Models of which nothing but a size is asked."""
    return [(float(w), cast(Fitted, x)) for w, x in zip(weights / weights.sum(), sizes.tolist(), strict=True)]


def test_a_sample_of_models_has_the_mean_and_the_spread_of_all() -> None:
    rng = np.random.default_rng(3)
    # Candidates that differ, each with shapes that differ.
    sizes = (rng.standard_normal(200)[:, None] + 0.7 * rng.standard_normal(33)).ravel()
    weights = (rng.exponential(size=200)[:, None] * rng.exponential(size=33)).ravel()
    every, few = (
        np.array([(w, cast(float, x)) for w, x in near])
        for near in (models(sizes, weights), sampled(models(sizes, weights), 400))
    )
    assert len(few) <= 400
    assert few[:, 0].sum() == pytest.approx(1.0)
    (mean, spread), (sampled_mean, sampled_spread) = (
        (m := float(np.average(x, weights=w)), float(np.average((x - m) ** 2, weights=w)) ** 0.5)
        for w, x in (every.T, few.T)
    )
    assert abs(sampled_mean - mean) < spread / 20.0
    assert sampled_spread == pytest.approx(spread, rel=0.1)


def test_a_model_heavier_than_a_draw_is_there_with_its_weight() -> None:
    near = models(np.arange(1000.0), np.r_[np.full(999, 1.0), 999.0])
    few = {cast(float, x): w for w, x in sampled(near, 100)}
    assert few[999.0] == pytest.approx(0.5, abs=0.01)


def test_few_models_are_all_there() -> None:
    near = models(np.arange(5.0), np.array([5.0, 4.0, 3.0, 2.0, 1.0]))
    assert sampled(near, 5) == near
