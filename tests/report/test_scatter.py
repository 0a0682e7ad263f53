"""Scatter by rate: the numbers of the figure, and sentences only for what is there."""

from __future__ import annotations

import numpy as np
from scipy import stats

from gyrocal.calibration.residuals import ScatterByRate, scatter_by_rate
from gyrocal.report.scatter import odd_rates, scatter_statements, signed_scatter, usual_trend
from tests.report.examples import examined

RATES = np.tile(np.linspace(-100, 100, 41), 12)


def test_numbers_by_hand() -> None:
    data = examined(
        rate_dps=np.repeat([-10.0, 0.0, 10.0], 4),
        residual_dps=np.tile([-3.0, -1.0, 1.0, 3.0], 3) * 1e-3,
        gyro_std_dps=2e-2,
        n=100.0,
    )
    scatter = signed_scatter(data)
    assert scatter is not None
    np.testing.assert_allclose(scatter.rate_dps, [-10, 0, 10])
    np.testing.assert_allclose(scatter.between_dps, np.sqrt(20 / 3) * 1e-3)
    np.testing.assert_allclose(scatter.expected_dps, 2e-3)
    np.testing.assert_allclose(scatter.high_dps, scatter.between_dps * np.sqrt(3 / stats.chi2.ppf(0.025, 3)))


def test_odd_rates_are_said() -> None:
    rng = np.random.default_rng(3)
    sigma = (20 + 2 * np.abs(RATES)) * np.where(np.isclose(np.abs(RATES), 55.0), 3.0, 1.0)
    data = examined(rate_dps=RATES, residual_dps=rng.normal(0, sigma))
    tested = scatter_by_rate(data.sets, data.residual_dps, rng)
    assert tested is not None
    np.testing.assert_allclose(tested.rate_dps[odd_rates(tested)], [55.0])
    growth, odd = scatter_statements(tested)
    assert growth.startswith("Scatter between data sets grows with |rate|")
    assert odd.startswith("Data sets at ±55.0 deg/s scatter")


def test_even_scatter_is_not_commented_on() -> None:
    rng = np.random.default_rng(6)
    data = examined(rate_dps=RATES, residual_dps=rng.normal(size=RATES.size))
    tested = scatter_by_rate(data.sets, data.residual_dps, rng)
    assert tested is not None
    assert scatter_statements(tested) == []


def test_too_few_data_sets_give_none() -> None:
    rate = np.array([-10.0, 0.0, 10.0] * 2)
    assert signed_scatter(examined(rate_dps=rate, residual_dps=rate)) is None


def test_the_trend_is_not_pulled_by_the_rates_that_it_shows_as_odd() -> None:
    rate = np.arange(0.0, 11.0)
    std = np.minimum(1.0 + rate, 7.0)
    p_value = np.ones(rate.size)
    std[[4, 9]], p_value[[4, 9]] = 50.0, 1e-4
    tested = ScatterByRate(rate, np.full(rate.size, 12), std, np.full(rate.size, 9.0), std, p_value, 1e-4)
    np.testing.assert_allclose(usual_trend(tested), np.minimum(1.0 + rate, 7.0))
    assert "from 3.6e+03 deg/h at 0.0 deg/s to 2.52e+04 deg/h at 10.0 deg/s" in scatter_statements(tested)[0]
