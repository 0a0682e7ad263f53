"""Rates that a table was told, behind readings of its own rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.nominal import nominal_rates
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

#: Three sweeps over 41 rates, and one with fine rates near zero.
SWEEPS: Floats = np.tile(np.arange(-100.0, 101.0, 5.0), 3)
FINE: Floats = np.tile(np.concatenate([np.arange(-15, 16) * 0.01, np.arange(-100.0, 101.0, 5.0)]), 3)


@pytest.mark.parametrize("scatter_dps", [0.002, 0.02, 0.2])
@pytest.mark.parametrize("seed", range(3))
def test_readings_are_gathered_at_the_rates_that_were_told(scatter_dps: float, seed: int) -> None:
    read = SWEEPS + scatter_dps * np.random.default_rng(seed).standard_normal(SWEEPS.size)
    nominal = nominal_rates(read)
    assert nominal is not None
    turning = SWEEPS != 0.0
    assert np.unique(nominal[turning]).size == 40
    assert np.unique(np.abs(nominal[turning])).size == 20
    np.testing.assert_array_equal(nominal[~turning], read[~turning])
    # Of six readings each, both ways together.
    assert np.std((nominal - SWEEPS)[turning]) == pytest.approx(scatter_dps / np.sqrt(6.0), rel=0.35)


@pytest.mark.parametrize("offset_dps", [pytest.param(0.004, marks=pytest.mark.slow), -0.05])
@pytest.mark.parametrize("turned", [True, False], ids=["turned so", "noise of the encoder"])
def test_what_readings_of_both_ways_are_off_by_is_no_bias(turned: bool, offset_dps: float) -> None:
    """The Earth turns a table that goes both ways alike: it had become a bias where the output did not follow the scatter."""
    found, read_so = list[float](), list[float]()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        scatter = 0.005 * rng.standard_normal(SWEEPS.size)
        true = SWEEPS + offset_dps + (scatter if turned else 0.0)
        output = 1.001 * true + 0.01 + 1e-3 * rng.standard_normal(SWEEPS.size)
        temp_c = np.linspace(20.0, 50.0, SWEEPS.size)
        table = DataSetTable(Path("t.csv"), SWEEPS + offset_dps + scatter, output, temp_c)
        series = series_of_table(table)
        for biases, rate, out in (
            (found, series.rate_dps, series.gyro_dps),
            (read_so, table.rate_dps, table.gyro_dps),
        ):
            biases.append(float(np.polynomial.Polynomial.fit(rate, out - rate, 1)(0.0)))
    # No worse than by the readings one by one, but for the offsets that may be chance.
    assert np.mean(found) == pytest.approx(0.01, abs=6e-4)
    assert np.std(found) < 2.0 * np.std(read_so) + 1e-4


def test_one_way_and_fine_rates_stay_apart() -> None:
    rng = np.random.default_rng(1)
    one_way = SWEEPS[SWEEPS >= 0.0]
    nominal = nominal_rates(one_way + 0.01 * rng.standard_normal(one_way.size))
    assert nominal is not None
    assert np.unique(nominal[one_way > 0.0]).size == 20
    # Readings that blur fine rates stay as they are, whatever else is gathered.
    for scatter_dps in (0.0005, 0.02):
        read = FINE + scatter_dps * rng.standard_normal(FINE.size)
        nominal = nominal_rates(read)
        fine = np.abs(FINE) < 1.0
        if nominal is not None:
            assert np.max(np.abs(nominal - FINE)[fine]) <= np.max(np.abs(read - FINE)[fine])
            assert np.unique(nominal[~fine]).size == 40


def test_rates_as_they_were_told_and_rates_that_hardly_repeat_stay_as_they_are() -> None:
    assert nominal_rates(SWEEPS) is None
    assert nominal_rates(FINE) is None
    assert nominal_rates(FINE[:72]) is None
    rng = np.random.default_rng(2)
    gathered = 0
    for _ in range(300):
        free = rng.uniform(-100.0, 100.0, rng.integers(12, 300))
        by_powers = rng.choice([-1.0, 1.0], free.size) * np.exp(rng.uniform(-4.0, 5.0, free.size))
        gathered += (nominal_rates(free) is not None) + (nominal_rates(by_powers) is not None)
    assert gathered <= 6


@pytest.mark.parametrize("turned", [True, False], ids=["turned so", "noise of the encoder"])
def test_the_output_goes_along_where_the_table_did_turn_so(turned: bool) -> None:
    """Of an open loop whose slope falls by a quarter, whose temperature rises and whose every rate errs."""
    rng = np.random.default_rng(3)
    off = 0.03 * rng.standard_normal(SWEEPS.size)
    temp = np.linspace(20.0, 50.0, SWEEPS.size)
    errors = dict(zip(np.unique(SWEEPS).tolist(), 0.01 * rng.standard_normal(41), strict=True))
    true = SWEEPS + off if turned else SWEEPS
    output = true * (1.0 - 0.08 * (true / 100.0) ** 2) * (1.0 + 2e-4 * temp)
    output += [errors[rate] for rate in SWEEPS.tolist()] + 1e-3 * rng.standard_normal(SWEEPS.size)
    series = series_of_table(DataSetTable(Path("t.csv"), SWEEPS + off, output, temp))
    (said,) = [n for n in series.notes if isinstance(n, Remark) and n.said is Said.NOMINAL_RATES]
    assert said.facts["rates"] == 40
    assert said.facts["rms_dps"] == pytest.approx(0.03, rel=0.2)
    assert said.facts["does"] == ("follows" if turned else "does not follow")
    moved = np.abs(series.gyro_dps - output)
    assert moved.max() > 0.03 if turned else not moved.any()
    # A table that turned at the rates that are taken, without scatter, gives the same output.
    told = series.rate_dps if turned else SWEEPS
    exact = told * (1.0 - 0.08 * (told / 100.0) ** 2) * (1.0 + 2e-4 * temp) + [
        errors[r] for r in SWEEPS.tolist()
    ]
    assert np.std(series.gyro_dps - exact) < 1.3e-3
