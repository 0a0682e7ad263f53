"""Tests of several things at once, by their laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gyrocal.inference.multiple import holm, hotelling_p_value


def test_holm_is_the_procedure_of_the_book() -> None:
    """Holm, Scand. J. Statist. 6 (1979): the smallest counts for all, and none falls below one before it."""
    p_values = np.array([0.01, 0.04, 0.03, 0.5, 0.03])
    np.testing.assert_allclose(holm(p_values), [0.05, 0.12, 0.12, 0.5, 0.12])


@pytest.mark.parametrize(("draws", "size"), [(8, 2), (12, 4), (5, 1)])
def test_p_values_of_hotellings_law_are_uniform(draws: int, size: int) -> None:
    rng = np.random.default_rng([3, draws])
    p_values = []
    for x in rng.standard_normal((2000, draws, size)):
        mean, covariance = x.mean(axis=0), np.atleast_2d(np.cov(x.T)) / draws
        p_values.append(hotelling_p_value(float(mean @ np.linalg.solve(covariance, mean)), draws, size))
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
