"""Tables at one rate: no clock, a change of the output that has one cause only, and what the temperature alone does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]
SETS = 140
TIMES: Floats = 60.0 * np.arange(SETS, dtype=np.float64)
CYCLES: Floats = 20.0 + 25.0 * np.sin(4.0 * np.pi * np.arange(SETS) / SETS)
STEPPED: Floats = np.where(np.arange(SETS) > 80, 0.02, 0.0)
SOAKS: Floats = np.repeat([20.0, 50.0, 20.0, -10.0, 20.0, 50.0, 20.0], SETS // 7)


def found_at(rate_dps: float, temp_c: Floats, hidden_dps: Floats | float, t_s: Floats | None) -> Diagnosis:
    rng = np.random.default_rng(3)
    rates = np.full(SETS, rate_dps)
    noise, scatter_c = 3e-4 * rng.standard_normal(SETS), 0.1 * rng.standard_normal(SETS)
    gyro = rates * 1.003 + 0.02 + 2e-4 * (temp_c - 20.0) + hidden_dps + noise
    table = DataSetTable(Path("one.csv"), rates, gyro, temp_c + (t_s is None) * scatter_c, t_s=t_s)
    return diagnose(table, options=Options(heldout=False))


@pytest.mark.parametrize("rate_dps", [0.0, 10.0])
def test_soaks_without_times_at_one_rate_are_told_of(rate_dps: float) -> None:
    """Smooth parts that go by a clock had left the model, and were looked up in it."""
    found = found_at(rate_dps, SOAKS, 0.0, None)
    assert found.verdict == "consistent"
    assert found.effects == ()


def test_what_changes_the_output_of_one_rate_is_not_told_as_the_scale_factors() -> None:
    """A bias that stepped by 20 mdeg/s at 10 deg/s was a scale factor that stepped by 1,997 ppm, without an alternative."""
    found = found_at(10.0, CYCLES, STEPPED, TIMES)
    (step,) = found.effects
    assert step.effect == "bias_step"
    low, high = step.parameters["amplitude"].interval_95
    assert low < 20.0 < high
    assert {"scale_step", "scale_drift"} <= set(found.not_testable)


def test_a_bias_that_steps_follows_more_than_the_temperature() -> None:
    """ "Bias is a function of temperature alone" had stood beside the step that says it is not."""

    def said(found: Diagnosis) -> set[Said]:
        return {note.said for note in found.notes if isinstance(note, Remark)}

    stepped = found_at(0.0, CYCLES, STEPPED, TIMES)
    assert [e.effect for e in stepped.effects] == ["bias_step"]
    assert Said.TEMPERATURE_ALONE not in said(stepped)
    (note,) = [n for n in stepped.notes if isinstance(n, Remark) and n.said is Said.NOT_TEMPERATURE_ALONE]
    # A step of 20 in the middle is ten either way.
    assert note.facts["left_mdps"] == pytest.approx(10.0, rel=0.1)
    assert Said.TEMPERATURE_ALONE in said(found_at(0.0, CYCLES, 0.0, TIMES))


def test_the_surface_alone_is_the_one_that_fit_would_choose() -> None:
    """A bias that wanders: under the noise that was found its surface had left half as much again as least squares."""
    cycle = 20.0 + 25.0 * np.sin(2.0 * np.pi * np.arange(SETS) / SETS)
    wandering = np.cumsum(6e-3 * np.random.default_rng(1).standard_normal(SETS))
    found = found_at(0.0, cycle, wandering, TIMES)
    assert found.surface is not None
    error = 0.02 + 2e-4 * (cycle - 20.0) + wandering
    left = error - np.polyval(np.polyfit(cycle, error, 2), cycle)
    surface = found.surface.surface
    told = surface.design(np.zeros(SETS), cycle) @ surface.coefficients_dps.ravel()
    assert np.std(error - told) < 1.05 * np.std(left)
