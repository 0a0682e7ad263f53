"""Laws that a gyro obeys only nearly, in tables of sweeps at temperatures up and down."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.laws.misfit import changing, with_misfit, without_mending
from gyrocal.diagnosis.model.layers import Law, fit_model, full_model, surface_of
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.physics.catalogue import find_effect
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

_SIZES = np.array([0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0])
_RATE: Floats = np.tile(np.concatenate([-_SIZES[::-1], [0.0], _SIZES]), 8)
_TEMP: Floats = np.repeat([20.0, 30.0, 40.0, 50.0, 45.0, 35.0, 25.0, 15.0], 21)


def _table(error_dps: Floats, seed: int = 3) -> DataSetTable:
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(_RATE.size)
    gyro = _RATE * (1.0 + 1e-5 * (_TEMP - 30.0)) + error_dps + noise
    return DataSetTable(Path("nearly.csv"), _RATE, gyro, _TEMP, t_s=30.0 * np.arange(float(_RATE.size)))


def _named(error_dps: Floats) -> Examination:
    return examine(series_of_table(_table(error_dps)), 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("width_dps", [0.0, 12.0, 20.0])
def test_a_corner_that_is_round_is_no_second_effect(width_dps: float) -> None:
    """What a hard corner leaves of a soft one looks like a peak, or like what is lost at rest; a tanh is not the law's own side."""
    side = 0.5 * (1.0 + np.tanh(_RATE / width_dps)) if width_dps else 1.0 * (_RATE > 0.0)
    found = diagnose(_table(1e-3 * _RATE * side), options=Options(heldout=False))
    (named,) = found.effects
    assert named.effect == "scale_asymmetry"
    assert named.parameters["amplitude"].value == pytest.approx(1000.0, rel=0.35 if width_dps else 0.03)
    assert (named.parameters["softness_dps"].value > 2.0) == (width_dps > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_how_soft_a_corner_is_lies_in_its_interval(seed: int) -> None:
    soft = 9.0 * np.logaddexp(0.0, _RATE / 9.0)
    (named,) = diagnose(_table(1e-3 * soft, seed), options=Options(heldout=False)).effects
    assert named.effect == "scale_asymmetry"
    for name, true in (("amplitude", 1000.0), ("softness_dps", 9.0)):
        low, high = named.parameters[name].interval_95
        assert low < true < high


@pytest.mark.slow
def test_a_law_whose_size_changes_with_temperature_has_its_name() -> None:
    """Of one size for all temperatures it explains less of its block than a name takes."""
    (named,) = _named(4e-4 * (1.0 + 1.2 * (_TEMP - 32.5) / 17.5) * np.maximum(_RATE, 0.0)).naming.named
    assert named.law.effect == "scale_asymmetry"
    assert named.share < 0.6


def test_what_a_law_leaves_follows_its_size_its_shape_and_its_corner() -> None:
    means = means_of(series_of_table(_table(np.zeros(_RATE.size))))
    fitted = fit_model(full_model(means, memory=False))
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))

    def misfit(effect: str, **shape: float) -> tuple[Floats, Floats]:
        law = Law(effect, shape, laws.at(find_effect(effect), shape))
        beside = with_misfit(fitted, [law], laws).model.components[f"misfit of {law.name}"]
        assert beside.columns is not None
        return law.columns[:, 0], beside.columns

    law, left = misfit("scale_asymmetry")
    assert left[:, 0] == pytest.approx(law * (means.temp_c - 32.5) / 17.5)
    # A mean over rates is the law itself where all of them are on one side of the corner.
    widest = np.abs(left[:, -1])
    assert widest[_RATE == -100.0].max() < 1e-6 * widest[_RATE == 0.0].min()
    # A knee moves with temperature, too.
    assert misfit("saturation", knee_dps=60.0, softness_dps=0.0)[1].shape[1] == left.shape[1] + 1
    assert changing(fitted, [Law("bias_drift", {}, law[:, None])], laws) is fitted


def test_what_acts_on_the_bias_may_act_on_the_scale_factor_where_that_has_no_name_of_its_own() -> None:
    means = means_of(series_of_table(_table(np.zeros(_RATE.size))))
    fitted = fit_model(full_model(means, memory=False))
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))
    column, warmth = np.ones((_RATE.size, 1)), (_TEMP - 32.5) / 17.5
    for effect, left in (("warm_up", (warmth, _RATE / 100.0)), ("bias_step", (warmth,))):
        law = Law(effect, {}, column)
        beside = with_misfit(fitted, [law], laws).model.components[f"misfit of {law.name}"]
        assert beside.columns == pytest.approx(np.column_stack(left))


@pytest.mark.parametrize("stepped", [False, True])
def test_a_law_that_mends_another_is_dropped_and_one_that_is_there_stays(stepped: bool) -> None:
    """A warm-up of the scale factor looks like a step of it."""
    t_s = 30.0 * np.arange(float(_RATE.size))
    warm, late = np.exp(-t_s / 600.0), t_s > 900.0
    found = 1e-3 * warm * (30.0 + (0.0 if stepped else 0.3) * _RATE)
    means = means_of(series_of_table(_table(found + 3e-4 * (stepped * late) * _RATE)))
    model = full_model(means, memory=False)
    both = Law("warm_up", {"tau_s": 600.0}, warm[:, None]), Law("scale_step", {}, (late * _RATE)[:, None])
    fitted = fit_model(model.with_laws(*both))
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))
    left = without_mending(fitted, {law.name: () for law in both}, laws).model.laws
    assert left == (both if stepped else both[:1])
