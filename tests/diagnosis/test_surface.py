"""The surface alone of a diagnosis is the one that `gyrocal fit` chooses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.choice import fit_chosen
from gyrocal.calibration.datasets import load_recording
from gyrocal.diagnosis.answer.surface import surface_alone
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.model.layers import fit_model, full_model
from gyrocal.diagnosis.model.starts import alive
from gyrocal.diagnosis.names.naming import Naming
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.series import series_of_run
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.records.run import read_run


def _table(path: Path, wander_dps: float) -> Path:
    """Sweeps of a gyro that is cubic in the true rate, while the temperature drifts and the bias walks."""
    rng = np.random.default_rng(1)
    rate = np.tile(np.linspace(-100.0, 100.0, 11), 6)
    temp = 25.0 + 8.0 * np.sin(np.arange(rate.size) / 9.0)
    gyro = rate + 0.02 + 0.002 * rate - 3e-6 * rate**3 + 1e-4 * rate * (temp - 25.0) / 8.0
    gyro += 1e-3 * rng.standard_normal(rate.size)
    gyro += wander_dps * np.cumsum(rng.standard_normal(rate.size))
    rows = zip(25.0 * np.arange(rate.size), rate, gyro, temp, strict=True)
    lines = [f"{t:.1f},{w:.6f},{y:.6f},{c:.3f}" for t, w, y, c in rows]
    path.write_text("\n".join(["t_s,rate_dps,gyro_dps,temp_c", *lines]) + "\n")
    return path


@pytest.mark.slow
def test_a_file_is_valid_wherever_the_thermometer_was_read(tmp_path: Path) -> None:
    """Temperatures are smoothed, and samples averaged: of a table 3 in 147 rows were outside of its own file."""
    table = read_data_sets(_table(tmp_path / "sweeps.csv", 0.0))
    read_c = table.temp_c + 0.15 * np.random.default_rng(2).standard_normal(table.temp_c.size)
    found = diagnose(replace(table, temp_c=read_c), options=Options(heldout=False))
    assert found.surface is not None
    assert not found.surface.flags(table.gyro_dps, read_c).any()


def test_rows_of_a_run_know_how_far_their_samples_reach() -> None:
    run = read_run(Path("sample_data/run"))
    series = series_of_run(run)
    assert series.reach is not None
    read_c = np.concatenate([run.segment(r).gyro_temp_c[run.segment(r).good] for r in run.segments])
    assert np.fmin.reduce(series.reach)[2] == np.nanmin(read_c)
    assert np.fmax.reduce(series.reach)[3] == np.nanmax(read_c)
    assert np.all(series.reach[:, 0] <= series.gyro_dps)
    assert np.all(series.reach[:, 1] >= series.gyro_dps)


@pytest.mark.parametrize("wander_dps", [0.0, 1e-3])
def test_the_surface_alone_is_what_fit_chooses(tmp_path: Path, wander_dps: float) -> None:
    path = _table(tmp_path / "sweeps.csv", wander_dps)
    series = series_of_table(read_data_sets(path))
    means = means_of(series)
    whole = alive(fit_model(full_model(means, memory=False)))
    blank = Surface(np.zeros(SHAPE), 0.0, 100.0, 25.0, 8.0)
    found = Examination(series, (), whole, whole, {}, Naming(whole, ()), laws_of(means, blank))
    chosen = fit_chosen(load_recording(path).sets).fit
    alone = surface_alone(found)
    assert alone.surface.direction == chosen.surface.direction == "input"
    # The temperatures are those behind the readings.
    np.testing.assert_allclose(
        alone.surface.coefficients_dps, chosen.surface.coefficients_dps, rtol=1e-6, atol=2e-5
    )
    np.testing.assert_allclose(
        np.sqrt(np.diag(alone.covariance_dps2)),
        np.sqrt(np.diag(chosen.covariance_dps2)),
        rtol=0.01,
        atol=1e-9,
    )


@pytest.mark.slow
def test_a_bend_between_two_temperatures_is_in_the_band_and_not_in_the_surface() -> None:
    """Readings scatter by tenths of a degree about either of them: an improved file had such a bend of 8 mdeg/s from that."""
    rng = np.random.default_rng(5)
    rate = np.tile(
        [0.0, *(s * x for x in (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0) for s in (1.0, -1.0))], 4
    )
    settled = np.tile(0.5 * np.exp(-np.arange(15) / 5.0), 4) * np.repeat([1.0, -1.0, 1.0, -1.0], 15)
    temp = np.repeat([10.0, 40.0, 10.0, 40.0], 15) + settled
    truncated = -3e-3 * np.sign(rate)
    gyro = rate * (1.001 + 3e-5 * temp) + 0.02 + 2e-4 * temp + truncated + 1e-3 * rng.standard_normal(60)
    table = DataSetTable(Path("two.csv"), rate, gyro, temp, t_s=40.0 * np.arange(60.0))
    found = diagnose(table, options=Options(heldout=False))
    assert found.improved is not None
    assert found.surface is not None
    for file in (found.improved, found.surface):
        np.testing.assert_allclose(file.surface.coefficients_dps[:, 2], 0.0, atol=1e-12)
        at = np.array([[60.0, 10.0], [60.0, 25.0], [60.0, 40.0]])
        sigma_dps = Compensator(file).evaluate(np.arange(3.0), at[:, 0], at[:, 1]).sigma_dps
        assert sigma_dps[1] > 5.0 * max(sigma_dps[0], sigma_dps[2])
