"""Grids of shapes that become finer where a record tells their values apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.coil import table_search
from gyrocal.diagnosis.sweeps.finer import halved, neighbours
from gyrocal.records.datasets import DataSetTable

COARSE = (100.0, 200.0, 400.0, 800.0, 1600.0)


@given(st.floats(np.log(150.0), np.log(1000.0)), st.floats(0.02, 0.2))
def test_the_best_is_found_to_within_a_deviation_and_what_was_tried_stays(
    true: float, deviation: float
) -> None:
    grid = [*COARSE]

    def cost(at: float) -> float:
        return 0.5 * float((np.log(at) - true) / deviation) ** 2

    at = halved(grid, min(grid, key=cost), cost)
    assert cost(at) <= 0.5
    assert at in grid
    assert grid == sorted({*grid})
    assert {*COARSE} <= {*grid}


def test_a_grid_that_is_fine_enough_stays_as_it_is() -> None:
    """A step is a deviation."""
    grid = [*COARSE]
    assert halved(grid, 400.0, lambda at: 0.5 * (np.log(at / 500.0) / np.log(2.0)) ** 2) == 400.0
    assert grid == [*COARSE]


def test_shares_of_either_sign_have_their_middle_between() -> None:
    grid = [-0.3, -0.1, 0.1, 0.3]
    at = halved(grid, 0.1, lambda x: 0.5 * (x / 0.01) ** 2)
    assert at == pytest.approx(0.0, abs=0.01)


def test_the_ends_of_a_grid_and_what_is_not_on_it() -> None:
    assert neighbours(COARSE, 100.0) == [200.0]
    assert neighbours(COARSE, 300.0) == []
    grid = [*COARSE]
    assert halved(grid, 1600.0, lambda at: -at) == 1600.0
    assert grid == [*COARSE]


@pytest.mark.slow
def test_a_warm_up_of_a_small_gyro_has_its_time_constant_and_not_that_of_a_grid() -> None:
    """2 deg/s at the first row, 10 at power-on, which was soaked through: a step of the grid would leave 50 mdeg/s."""
    rng = np.random.default_rng(3)
    rates = np.tile([0.0, 30.0, -30.0, 60.0, -60.0, 100.0, -100.0], 6)
    temp_c = np.repeat([20.0, 40.0, 20.0, 0.0, 40.0, 20.0], 7) + 0.02 * rng.standard_normal(rates.size)
    t_s = 3600.0 + 300.0 * np.arange(rates.size, dtype=np.float64)
    gyro = 1.001 * rates + 0.2 + 2e-3 * temp_c + 10.0 * np.exp(-t_s / 2200.0)
    gyro += 2e-3 * rng.standard_normal(rates.size)
    series = series_of_table(DataSetTable(Path("soaked.csv"), rates, gyro, temp_c, t_s=t_s))
    search = table_search(full_model(means_of(series), memory=False))
    best = search.run()[0]
    (warm_up,) = (change for change in best.changes if change.effect == "warm_up")
    assert warm_up.at == pytest.approx(2200.0, rel=0.01)
    assert warm_up.at in search.changes.values["warm_up"]
    (law,) = (law for law in best.fitted.model.laws if law.effect == "warm_up")
    assert 1e-3 * best.fitted.solve().amplitudes[law.name][0] == pytest.approx(10.0, rel=0.03)
