"""Front ends far from a straight line: the sine of an open loop, 18 % short at full rate; lock-in at small rates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.answer.effects import _SINE_FIFTH
from gyrocal.diagnosis.engine import diagnose
from gyrocal.diagnosis.laws.at_rows import Laws, effects_of, laws_of
from gyrocal.diagnosis.laws.contest import best_law
from gyrocal.diagnosis.model import blocks
from gyrocal.diagnosis.model.blocks import evidence, present
from gyrocal.diagnosis.model.layers import Fitted, Law, fit_model, full_model, surface_of
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.physics.rate import DEAD_ZONE, SAGNAC_SINE
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable

_K = 0.0107


@pytest.fixture(scope="module")
def open_loop() -> tuple[Fitted, Laws]:
    """Every part of a table of 21 rates at 7 temperatures."""
    rng = np.random.default_rng(2)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 21), np.linspace(-10.0, 50.0, 7)))
    v = (temp - 20.0) / 30.0
    surface = rate * (2e-3 * v - 3e-4 * v**2) + 0.02 * v + 0.005 * v**2
    gyro = np.sin(_K * rate) / _K + surface + 3e-4 * rng.standard_normal(rate.size)
    means = means_of(series_of_table(DataSetTable(Path("open.csv"), rate, gyro, temp)))
    fitted = present(fit_model(full_model(means, memory=False)))[0]
    return fitted, laws_of(means, surface_of(fitted.model, fitted.solve()))


def test_a_law_that_explains_a_strong_block_shrinks_the_noise_that_grew_in_its_place(
    open_loop: tuple[Fitted, Laws],
) -> None:
    fitted, laws = open_loop
    worth, without = evidence(fitted, "odd rate")
    trials = [t for e in effects_of("odd rate") for t in laws.trials(e)]
    best = best_law(fitted, without, "odd rate", trials, laws)
    assert best is not None
    assert best.effect is SAGNAC_SINE
    assert without.nll - best.fitted.nll > worth - 2.0


def test_a_surface_that_does_not_settle_is_one_of_the_input(
    open_loop: tuple[Fitted, Laws], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its file would be another model than the one that was fitted."""
    monkeypatch.setattr(blocks, "_BENDS", 1)
    fitted, _ = open_loop
    bend = 2.0 * fitted.model.bend_of(fitted.solve())
    found = blocks.around_itself(fitted.refit(fitted.model.directed("output", bend)))
    assert found.model.direction == "input"
    assert np.std(found.solve().left) == pytest.approx(3e-4, rel=0.1)


def test_lock_in_is_a_dead_zone() -> None:
    """Nothing comes out below 0.05 deg/s, and a hyperbola above."""
    rng = np.random.default_rng(3)
    small = np.array([0.01, 0.02, 0.04, 0.07, 0.1, 0.2, 0.5])
    rates = np.concatenate([np.linspace(-100.0, 100.0, 13), small, -small])
    rate, temp = (x.ravel() for x in np.meshgrid(rates, np.linspace(-10.0, 50.0, 5)))
    gyro = np.sign(rate) * np.sqrt(np.maximum(rate**2 - 0.05**2, 0.0))
    gyro = gyro + 1e-3 * rate + 4e-3 * rng.standard_normal(rate.size)
    means = means_of(series_of_table(DataSetTable(Path("lock.csv"), rate, gyro, temp)))
    fitted = present(fit_model(full_model(means, memory=False)))[0]
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))
    worth, without = evidence(fitted, "odd rate")
    trials = [t for e in effects_of("odd rate") for t in laws.trials(e)]
    best = best_law(fitted, without, "odd rate", trials, laws)
    assert best is not None
    assert best.effect is DEAD_ZONE
    assert best.fitted.model.laws[-1].shape["form"] == 2.0
    assert without.nll - best.fitted.nll > worth - 2.0


def test_a_direction_that_was_found_is_not_given_up_for_one_that_fits_worse() -> None:
    """Of a weak sine beside a surface of the output the cubic can stand for most."""
    rng = np.random.default_rng(4)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 15), np.linspace(-10.0, 50.0, 7)))
    v, k = (temp - 20.0) / 30.0, 0.0067
    c = np.zeros(SHAPE)
    c[1], c[3] = (0.5, 0.3, 0.05), (-1.0, 0.05, 0.0)
    gyro = Surface(c, 0.0, 100.0, 20.0, 30.0).output_dps(rate, temp) + 0.01 * v
    gyro = gyro + 0.17 * (np.sin(k * rate) / k - rate) + 1e-3 * rng.standard_normal(rate.size)
    means = means_of(series_of_table(DataSetTable(Path("weak.csv"), rate, gyro, temp)))
    fitted = fit_model(full_model(means, memory=False))
    laws = laws_of(means, surface_of(fitted.model, fitted.solve()))
    law = Law(SAGNAC_SINE.id, {"phase_rad_per_dps": k}, laws.at(SAGNAC_SINE, {"phase_rad_per_dps": k}))
    odd = [n for n, b in fitted.model.blocks.items() if b == "odd rate"]
    beside = fitted.refit(replace(fitted.model.without(odd), laws=(law,)))
    bend = beside.model.bend_of(beside.solve())
    found = blocks.around_itself(beside.refit(beside.model.directed("output", bend)))
    assert found.model.direction == "output"
    assert blocks.settle_direction(found).nll <= found.nll


@pytest.mark.slow
def test_how_much_of_the_input_a_surface_is_has_an_interval_that_is_none_of_a_variance_of_zero() -> None:
    """It was 1 to six digits where the record tells it to a tenth."""
    c = np.zeros(SHAPE)
    c[0, 0], c[1, 0], c[1, 2], c[3, 0] = 0.05, 0.1, -0.27, -0.44
    of_input = Surface(c, 0.0, 100.0, 20.0, 30.0, "input")
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 13), np.linspace(-10.0, 50.0, 7)))
    noise = 3e-4 * np.random.default_rng(4).standard_normal(rate.size)
    gyro = rate + of_input.error_dps(rate, temp) + noise
    (named,) = diagnose(DataSetTable(Path("of_input.csv"), rate, gyro, temp)).effects
    assert named.effect == "fit_direction"
    share = named.parameters["amplitude"]
    assert 0.05 < share.std < 0.2
    assert share.interval_95[0] < 1.0 < share.interval_95[1]
    # A sine of a small phase lies at 0.9.
    assert [other.effect for other in named.alternatives] == ["sagnac_sine"]


def test_of_what_a_cubic_of_the_output_has_beyond_one_of_the_input_a_sine_has_a_tenth() -> None:
    """Closed form of `answer._SINE_FIFTH`, from a sine and from a gyro whose error is a cubic of its own output."""
    w = np.linspace(-100.0, 100.0, 401)
    k = 1e-3
    cubics = np.column_stack([w, w**3])
    output = w
    for _ in range(20):
        output = w - k**2 / 6.0 * output**3
    beyond = [e - cubics @ np.linalg.lstsq(cubics, e)[0] for e in (np.sin(k * w) / k, output)]
    share = float(beyond[0] @ beyond[1] / (beyond[1] @ beyond[1]))
    assert share == pytest.approx(_SINE_FIFTH, rel=0.02)
