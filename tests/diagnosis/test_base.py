"""The surface that everything begins with, on records that tell little of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.rows.base import carried_terms, fit_surface
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable


def test_a_record_that_turns_at_its_coldest_and_hottest_alone_has_a_surface_all_the_same() -> None:
    """Its scale factor between the two may be anything: the best surface over the output has no output at rest."""
    rng = np.random.default_rng(1)
    inwards = np.where(np.arange(60) < 30, 1.0, -1.0)
    ends = np.repeat([-25.0, 31.0], 30) + inwards * rng.uniform(0.0, 1.0, 60)
    rate = np.concatenate([np.tile([-100.0, -60.0, -20.0, 20.0, 60.0, 100.0], 10), np.zeros(140)])
    temp = np.concatenate([ends, np.linspace(-24.0, 30.0, 140)])
    gyro = rate * (1.0 + 0.05 * rng.standard_normal(200)) + 0.01 + 1e-3 * rng.standard_normal(200)
    scatter = 1e-3 * (1.0 + 0.1 * rng.random(200))
    table = DataSetTable(Path("ends.csv"), rate, gyro, temp, gyro_std_dps=scatter, n=np.full(200, 100.0))
    found = fit_surface(series_of_table(table))
    assert np.isfinite(found.residual_dps).all()
    assert np.std(found.residual_dps) < np.std(gyro - rate)


def table_of(
    rate: NDArray[np.float64], temp: NDArray[np.float64], t_s: NDArray[np.float64] | None = None
) -> DataSetTable:
    """A gyro whose bias and scale factor follow the temperature, and white noise of 0.5 mdeg/s."""
    v = (temp - 20.0) / 30.0
    noise = 5e-4 * np.random.default_rng(2).standard_normal(rate.size)
    gyro = rate + 0.02 + 0.1 * v + (0.3 + 0.2 * v) * rate / 100.0 + noise
    return DataSetTable(Path("plan.csv"), rate, gyro, temp, t_s=t_s)


@pytest.mark.slow
@pytest.mark.parametrize("scatter_c", [0.0, 0.02])
def test_rates_that_were_visited_at_one_temperature_tell_of_no_slope_over_it(scatter_c: float) -> None:
    rng = np.random.default_rng(3)
    rate = np.concatenate([np.zeros(40), np.tile([-100.0, -50.0, 0.0, 50.0, 100.0], 4)])
    temp = np.concatenate([np.linspace(-10.0, 50.0, 40), 20.0 + scatter_c * rng.standard_normal(20)])
    table = table_of(rate, temp)
    # Bias over temperature, and the orders of the rate.
    assert carried_terms(series_of_table(table)).tolist() == [0, 1, 2, 3, 6, 9]
    assert diagnose(table, options=Options(heldout=False)).verdict == "consistent"


@pytest.mark.slow
@pytest.mark.parametrize("turns", [1, 3])
def test_a_rate_that_came_once_is_no_bug(turns: int) -> None:
    rate = np.concatenate([np.zeros(40), np.array([100.0, -100.0, 50.0])[:turns], np.zeros(40)])
    table = table_of(rate, np.linspace(-10.0, 50.0, rate.size))
    assert diagnose(table, options=Options(heldout=False)).verdict == "consistent"


@pytest.mark.slow
def test_one_rate_through_all_temperatures_after_the_other_is_no_thermometer_that_scatters() -> None:
    """The temperatures had been smoothed to nearly one: at -90 deg/s the surface was off by 84 deg/s."""
    rate, temp = np.repeat(np.linspace(-100.0, 100.0, 11), 7), np.tile(np.linspace(-10.0, 50.0, 7), 11)
    table = table_of(rate, temp, 3600.0 * np.arange(77.0))
    found = series_of_table(table)
    np.testing.assert_allclose(found.temp_c, temp, atol=1e-9)
    surface = diagnose(table, options=Options(heldout=False)).surface
    assert surface is not None
    np.testing.assert_allclose(surface.correct(table.gyro_dps, temp), rate, atol=5e-3)


@pytest.mark.parametrize("pause_days", [20.0, 200.0])
def test_a_long_pause_smears_no_temperature(pause_days: float) -> None:
    rate, temp = np.tile(np.linspace(-100.0, 100.0, 11), 5), np.repeat(np.linspace(-10.0, 50.0, 5), 11)
    t_s = 40.0 * np.arange(55.0) + 86400.0 * pause_days * (np.arange(55) >= 28)
    found = series_of_table(table_of(rate, temp, t_s))
    np.testing.assert_allclose(found.temp_c, temp, atol=1e-9)


def test_with_three_rates_no_improved_coefficients_are_written() -> None:
    """Between them a cubic may do anything, and a file would state what it cannot know."""
    temp = np.repeat(np.linspace(-10.0, 50.0, 13), 3)
    table = table_of(np.tile([-80.0, 0.0, 80.0], 13), temp)
    table.gyro_dps[:] += 0.05 * np.sin(temp / 4.0)
    found = diagnose(table, options=Options(heldout=False))
    assert found.unnamed or found.effects
    assert found.improved is None
