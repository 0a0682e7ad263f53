"""What is left of a recording once everything that was found is taken off, each part of it once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.answer.residual import residuals
from gyrocal.diagnosis.answer.surface import surface_alone
from gyrocal.diagnosis.engine import _explained_scatter, _found
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.model.blocks import plain
from gyrocal.diagnosis.model.layers import DIRECTION
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.rows.scatter import Finding
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.physics.rate import MECHANICAL_RESONANCE
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable


@pytest.mark.slow
def test_a_surface_between_output_and_input_is_taken_off_once() -> None:
    c = np.zeros(SHAPE)
    c[0, 0], c[1, 0], c[3, 0] = 0.05, 1.0, 2.0
    bent = Surface(c, 0.0, 100.0, 20.0, 30.0, "output")
    rng = np.random.default_rng(2)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 21), np.linspace(-10.0, 50.0, 7)))
    middle = 0.5 * (bent.output_dps(rate, temp) + rate + bent.error_dps(rate, temp))
    gyro = middle + 1e-3 * rng.standard_normal(rate.size)
    found = examine(series_of_table(DataSetTable(Path("between.csv"), rate, gyro, temp)), 1e-3)
    fitted = found.whole
    free = fitted.refit(plain(fitted.model, "free", fitted.model.bend_of(fitted.solve())))
    solution = free.solve()
    direction = free.model.components[DIRECTION].columns
    assert direction is not None
    assert np.std(direction @ solution.amplitudes[DIRECTION]) > 0.01
    between = replace(found, naming=replace(found.naming, fitted=free))
    left = residuals(between, found.series, surface_alone(found)).after_dps
    np.testing.assert_allclose(left, solution.left, atol=1e-9)


@pytest.mark.parametrize(("coordinate", "stays"), [("rate", False), ("time", False), ("table_angle", True)])
def test_a_resonance_brings_scatter_at_its_rate_and_none_at_an_angle(coordinate: str, stays: bool) -> None:
    place = Located(coordinate, "variance", 1e-6, 1.0, True)
    named = _found(Finding(MECHANICAL_RESONANCE.id, Remark(Said.TRUTH_RADIANS), {}, 1e-9, place))
    assert bool(_explained_scatter([place], [named])) == stays
    assert _explained_scatter([place], []) == [place]
