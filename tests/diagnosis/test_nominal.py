"""Rates that a table was told, behind readings of its own rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.nominal import nominal_rates
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.table_series import series_of_table
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
    assert np.unique(nominal).size == 41
    assert np.unique(np.abs(nominal)).size == 21
    assert np.all(nominal[SWEEPS == 0.0] == 0.0)
    # Of six readings each, both ways together.
    assert np.std(nominal - SWEEPS) == pytest.approx(scatter_dps / np.sqrt(6.0), rel=0.35)


def test_one_way_and_fine_rates_stay_apart() -> None:
    rng = np.random.default_rng(1)
    one_way = SWEEPS[SWEEPS >= 0.0]
    nominal = nominal_rates(one_way + 0.01 * rng.standard_normal(one_way.size))
    assert nominal is not None
    assert np.unique(nominal).size == 21
    nominal = nominal_rates(FINE + 0.0005 * rng.standard_normal(FINE.size))
    assert nominal is None or np.unique(nominal).size == np.unique(FINE).size
    # Readings that blur the fine rates are not gathered at those that they do not blur.
    assert nominal_rates(FINE + 0.02 * rng.standard_normal(FINE.size)) is None


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
    assert said.facts["rates"] == 41
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
