"""What the steps of an output hide is neither named nor corrected."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.answer.rounding import beyond_rounding
from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.model.layers import standing
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.series import Raw, Series
from gyrocal.diagnosis.rows.table_series import series_of_table
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
    assert raw(scatter_dps).rounding_dps == pytest.approx(_STEP_DPS * off, abs=2e-3 * _STEP_DPS)


def test_an_output_without_steps_is_off_by_nothing() -> None:
    assert Raw(np.empty(0), np.empty(0), 100, sample_std_dps=0.01).rounding_dps == 0.0


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
    assert said.facts["hidden_mdps"] == pytest.approx(1e3 * _STEP_DPS / 2)
    assert (found.naming.named, found.model.laws) == ((), ())


def test_what_no_noise_hides_less_than_is_not_said(warming: Examination) -> None:
    """Of an output whose noise covers its steps rounding leaves some 1e-9 of a step: a dead part is no larger."""
    fine = replace(warming.series, raw=replace(raw(0.0), lattice_dps=1e-8))
    dead = replace(warming.naming, unnamed={"temperature": 12.0})
    assert beyond_rounding(replace(warming, series=fine, naming=dead))[1] == []


def test_what_is_larger_stays(warming: Examination) -> None:
    assert [n.law.effect for n in warming.naming.named] == ["warm_up"]
    fine = replace(warming.series, raw=replace(raw(0.0), lattice_dps=0.015))
    assert beyond_rounding(replace(warming, series=fine))[1] == []


def test_what_follows_the_output_from_step_to_step_is_no_shape_in_temperature() -> None:
    t_s = 60.0 * np.arange(150.0)
    temp = 25.0 + 12.0 * np.sin(t_s / 1800.0)
    step_dps, noise_steps = 0.01, 0.25
    true = 1.2e-3 * temp
    off_dps = step_dps / np.pi * np.exp(-2.0 * np.pi**2 * noise_steps**2)
    gyro = true - off_dps * np.sin(2.0 * np.pi * true / step_dps)
    gyro += 1e-4 * np.random.default_rng(4).standard_normal(t_s.size)
    series = series_of_table(DataSetTable(Path("rest.csv"), np.zeros(t_s.size), gyro, temp, t_s=t_s))
    stepped = Raw(
        np.empty(0),
        np.empty(0),
        100,
        sample_std_dps=step_dps * np.sqrt(noise_steps**2 + 1.0 / 12.0),
        lattice_dps=step_dps,
    )
    assert examine(replace(series, raw=replace(stepped, lattice_dps=None)), 0.01).worth["temperature"] > 10.0
    assert "temperature" not in examine(replace(series, raw=stepped), 0.01).worth


def on_a_stair(scatter_dps: float) -> Series:
    """Data sets at rest whose bias follows the temperature and comes in steps, with samples that scatter by so much."""
    t_s = 60.0 * np.arange(150.0)
    temp = 25.0 + 15.0 * np.sin(t_s / 1500.0)
    gyro = _STEP_DPS * np.round(0.3 + 0.01 * (temp - 25.0) / _STEP_DPS)
    series = series_of_table(DataSetTable(Path("rest.csv"), np.zeros(150), gyro, temp, t_s=t_s))
    return replace(series, raw=raw(0.6 * _STEP_DPS), scatter_dps=np.full(150, scatter_dps))


def test_an_output_that_stands_has_one_error_for_each_step() -> None:
    means = means_of(on_a_stair(0.0))
    (component,) = standing(means)
    assert component.covariance is not None
    stds = np.sqrt(np.diag(component.covariance))
    # Of rounding a step over the square root of twelve; cut, it is twice that.
    np.testing.assert_allclose(stds, 2.0 * _STEP_DPS / np.sqrt(12.0), rtol=0.01)
    alike = component.covariance / np.outer(stds, stds)
    same = np.abs(means.gyro_dps[:, None] - means.gyro_dps) < 0.01 * _STEP_DPS
    assert np.all(alike[same] >= 0.5 - 1e-9)
    np.testing.assert_allclose(alike[~same], 0.0, atol=1e-9)


def test_an_output_that_scatters_as_the_data_sets_do_does_not_stand() -> None:
    assert standing(means_of(on_a_stair(0.6 * _STEP_DPS))) == []


def test_a_bias_that_comes_in_steps_has_no_shape_for_them() -> None:
    series = on_a_stair(0.0)
    stands = examine(series, 0.01).naming
    assert (stands.named, stands.unnamed) == ((), {})
    # The steps are there to be found by what knows nothing of them.
    assert examine(replace(series, scatter_dps=None), 0.01).naming.named
