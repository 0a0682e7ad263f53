"""Whether a given surface is still that of the gyro."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.given import surface_change
from gyrocal.diagnosis.means import means_of
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable

_WHITE_DPS = 1e-4


@pytest.mark.parametrize("of", ["given", "fitted"])
def test_a_surface_has_changed_where_neither_covariance_allows_for_it(of: str) -> None:
    rate, temp = np.tile(np.linspace(-50.0, 50.0, 11), 6), np.repeat(np.linspace(10.0, 40.0, 6), 11)
    means = means_of(
        series_of_table(DataSetTable(Path("sweep.csv"), rate, rate, temp, t_s=30.0 * np.arange(66.0)))
    )
    whole = SimpleNamespace(
        model=SimpleNamespace(means=means), fit=SimpleNamespace(variance={"white": _WHITE_DPS**2})
    )
    found = cast(Examination, SimpleNamespace(whole=whole))
    file = Coefficients(
        sensor={"model": "made up"},
        surface=Surface(np.zeros(SHAPE), 0.0, 50.0, 25.0, 15.0),
        covariance_dps2=1e-12 * np.eye(12),
        valid=Valid((-50.0, 50.0), (10.0, 40.0)),
    )
    bias = np.zeros(SHAPE)
    bias[0, 0] = 1e-3
    moved = replace(file, surface=replace(file.surface, coefficients_dps=bias))
    change = surface_change(found, moved, file)
    assert change is not None
    assert change.coordinate == "rate"
    assert change.rms_dps == pytest.approx(1e-3)
    unsure = 1e-6 * np.eye(12)
    pair = {"given": moved, "fitted": file}
    pair[of] = replace(pair[of], covariance_dps2=unsure)
    assert surface_change(found, pair["given"], pair["fitted"]) is None
