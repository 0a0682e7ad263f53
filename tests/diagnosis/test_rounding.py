"""What the steps of an output hide is neither named nor corrected."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.rounding import beyond_rounding, rounding_dps
from gyrocal.diagnosis.series import Raw
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable

_STEP_DPS = 0.1


def raw(scatter_dps: float) -> Raw:
    return Raw(np.empty(0), np.empty(0), 100, sample_std_dps=scatter_dps, lattice_dps=_STEP_DPS)


@pytest.mark.parametrize("noise_steps", [0.3, 0.4, 0.5])
def test_rounding_is_off_by_what_the_noise_leaves_of_the_steps(noise_steps: float) -> None:
    rng = np.random.default_rng(1)
    true = np.arange(20) / 20.0
    rounded = np.round(true[:, None] + noise_steps * rng.standard_normal((20, 100_000)))
    off = 2.0 * abs(np.mean((rounded.mean(axis=1) - true) * np.sin(2.0 * np.pi * true)))
    scatter_dps = _STEP_DPS * np.sqrt(noise_steps**2 + 1.0 / 12.0)
    assert rounding_dps(raw(scatter_dps)) == pytest.approx(_STEP_DPS * off, abs=2e-3 * _STEP_DPS)


def test_an_output_without_steps_is_off_by_nothing() -> None:
    assert rounding_dps(Raw(np.empty(0), np.empty(0), 100, sample_std_dps=0.01)) == 0.0


@pytest.fixture(scope="module")
def warming() -> Examination:
    """Data sets at rest with a warm-up of 20 mdeg/s."""
    t_s = 60.0 * np.arange(200.0)
    noise = 2e-4 * np.random.default_rng(2).standard_normal(200)
    gyro = 0.01 + noise + 20e-3 * np.exp(-t_s / 420.0)
    temp = 25.0 + 10.0 * np.sin(t_s / 1500.0)
    return examine(series_of_table(DataSetTable(Path("rest.csv"), np.zeros(200), gyro, temp, t_s=t_s)), 0.01)


def test_what_rounding_may_make_is_not_found(warming: Examination) -> None:
    coarse = replace(warming, series=replace(warming.series, raw=raw(0.0)))
    found, (said,) = beyond_rounding(coarse)
    assert said.facts["hidden_mdps"] == pytest.approx(1e3 * _STEP_DPS / np.pi)
    assert (found.naming.named, found.model.laws) == ((), ())


def test_what_is_larger_stays(warming: Examination) -> None:
    assert [n.law.effect for n in warming.naming.named] == ["warm_up"]
    fine = replace(warming.series, raw=replace(raw(0.0), lattice_dps=0.02))
    assert beyond_rounding(replace(warming, series=fine))[1] == []
