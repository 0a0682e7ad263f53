"""An amplitude that ends at the bound of the catalogue is known from one side only."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.result import Estimate
from gyrocal.records.datasets import DataSetTable


def test_an_interval_is_open_beyond_the_bound_that_its_value_ends_at() -> None:
    inside = Estimate(4.0, 0.1, "1", (3.8, 4.2))
    assert inside.open_at(-10.0, 10.0) is inside
    assert not inside.at_bound
    assert "at_bound" not in inside.to_json()
    high, low = inside.open_at(0.0, 4.001), Estimate(-4.0, 0.1, "1", (-4.2, -3.8)).open_at(-4.0, 4.0)
    assert high.interval_95 == (3.8, math.inf)
    assert low.interval_95 == (-math.inf, -3.8)
    assert high.to_json() == {
        "value": 4.001,
        "std": None,
        "unit": "1",
        "interval_95": [3.8, None],
        "at_bound": True,
    }
    # Nothing is no bound of a positive amplitude.
    assert not Estimate(0.0, 0.1, "1", (-0.2, 0.2)).open_at(0.0, 4.0).at_bound
    # A size that no shape shows is known from no side.
    assert not Estimate.spanning(1.0, (-math.inf, math.inf), "1").at_bound


@pytest.mark.slow
@pytest.mark.parametrize(("share", "held"), [(0.15, False), (0.05, True)])
def test_a_step_beyond_the_catalogue_is_at_least_as_large_as_its_bound(share: float, held: bool) -> None:
    rng = np.random.default_rng(5)
    rate = np.tile(np.linspace(-100.0, 100.0, 15), 6)
    temp = np.repeat(np.linspace(-20.0, 60.0, 6), 15) + 0.05 * rng.standard_normal(90)
    gyro = 1.01 * rate + 0.2 + 0.003 * rng.standard_normal(90)
    gyro[45:] *= 1.0 + share
    found = diagnose(DataSetTable(Path("made.csv"), rate, gyro, temp), options=Options(heldout=False))
    (step,) = (e for e in found.effects if e.effect == "scale_step")
    low, high = step.parameters["amplitude"].interval_95
    size_ppm = 1.01e6 * share
    assert low < size_ppm
    assert math.isfinite(high) == held
    assert step.parameters["amplitude"].at_bound == (not held)
    assert high > size_ppm
