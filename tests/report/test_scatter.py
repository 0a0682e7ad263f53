"""Scatter by rate: growth and odd rates are said when they are there, and not when they are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gyrocal.report.scatter import (
    FALSE_ALARM,
    growth_with_rate,
    holm,
    scatter_by_rate,
    scatter_statements,
)

RATES = np.tile(np.linspace(-100, 100, 41), 12)
ALL = np.ones(RATES.size, dtype=bool)


def test_numbers_by_hand() -> None:
    rate = np.repeat([-10.0, 0.0, 10.0], 4)
    residual = np.tile([-3.0, -1.0, 1.0, 3.0], 3) * 1e-3
    scatter = scatter_by_rate(rate, residual, np.full(12, 2e-3), np.ones(12, dtype=bool))
    assert scatter is not None
    np.testing.assert_allclose(scatter.rate_dps, [-10, 0, 10])
    np.testing.assert_allclose(scatter.between_dps, np.sqrt(20 / 3) * 1e-3)
    assert scatter.expected_dps is not None
    np.testing.assert_allclose(scatter.expected_dps, 2e-3)
    np.testing.assert_allclose(
        scatter.between_high_dps, scatter.between_dps * np.sqrt(3 / stats.chi2.ppf(0.025, 3))
    )
    np.testing.assert_allclose(scatter.size_dps, [0.0, 10.0])
    np.testing.assert_allclose(scatter.neighbour_ratio, 1.0)


def test_odd_rates_are_found() -> None:
    rng = np.random.default_rng(3)
    sigma = (20 + 2 * np.abs(RATES)) * np.where(np.isclose(np.abs(RATES), 55.0), 3.0, 1.0)
    scatter = scatter_by_rate(RATES, rng.normal(0, sigma), None, ALL)
    assert scatter is not None
    np.testing.assert_allclose(scatter.size_dps[scatter.local], [55.0])
    said = scatter_statements(scatter)
    assert len(said) == 2
    assert said[0].startswith("Scatter between data sets grows with |rate|")
    assert said[1].startswith("Data sets at ±55.0 deg/s scatter")


def test_multiples_of_one_rate_are_said() -> None:
    rng = np.random.default_rng(4)
    odd = np.isin(np.round(np.abs(RATES), 6), [30.0, 60.0, 90.0])
    scatter = scatter_by_rate(RATES, rng.normal(0, np.where(odd, 4.0, 1.0)), None, ALL)
    assert scatter is not None
    assert "whole multiples of 30.0 deg/s" in scatter_statements(scatter)[-1]


@pytest.mark.parametrize("tails", ["normal", "t4"])
def test_even_scatter_raises_no_alarm(tails: str) -> None:
    rng = np.random.default_rng(5)
    trials = 150
    alarms = 0
    for _ in range(trials):
        noise = rng.normal(size=RATES.size) if tails == "normal" else rng.standard_t(4, RATES.size)
        scatter = scatter_by_rate(RATES, noise * (20 + 2 * np.abs(RATES)), None, ALL)
        assert scatter is not None
        alarms += bool(scatter.local.any())
    # Exceeded by chance once in 1,000 such tests if the family-wise rate is twice the nominal one.
    assert alarms <= stats.binom.ppf(0.999, trials, 2 * FALSE_ALARM)


def test_no_growth_is_not_claimed() -> None:
    rng = np.random.default_rng(6)
    scatter = scatter_by_rate(RATES, rng.normal(size=RATES.size), None, ALL)
    assert scatter is not None
    assert growth_with_rate(scatter)[1] > FALSE_ALARM
    assert scatter_statements(scatter) == []


def test_too_few_data_sets_give_none() -> None:
    rate = np.array([-10.0, 0.0, 10.0] * 2)
    assert scatter_by_rate(rate, rate, None, np.ones(6, dtype=bool)) is None


def test_holm_by_hand() -> None:
    p = np.array([0.001, 0.04, 0.012, np.nan])
    assert holm(p, 0.05).tolist() == [True, True, True, False]
    assert holm(p, 0.03).tolist() == [True, False, True, False]
