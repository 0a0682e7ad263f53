"""The surface that everything begins with, on records that tell little of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gyrocal.diagnosis.base import fit_surface
from gyrocal.diagnosis.table_series import series_of_table
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
