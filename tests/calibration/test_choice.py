"""The model that predicts best what was left out: found where it is known, the paper's where nothing is better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.calibration.choice import PAPER, Candidate, Model, best_of, fit_chosen, tried
from gyrocal.calibration.datasets import DataSets
from gyrocal.calibration.fit import rms
from gyrocal.calibration.groups import left_out_groups
from gyrocal.physics.surface import Surface
from tests.calibration.simulation import SURFACE, Floats, simulate

#: An open loop of 3 %: the output is a cubic of the true rate, and no cubic of the output.
OPEN_LOOP = replace(SURFACE, coefficients_dps=3.0 * SURFACE.coefficients_dps, direction="input")


def drifting(seed: int) -> tuple[DataSets, Surface]:
    """Sweeps of rate while a box warms up: rate and temperature are visited along a few lines only."""
    rng = np.random.default_rng(seed)
    rate = np.concatenate([np.linspace(-100, 100, 29)[:: (-1) ** k] for k in range(4)])
    temp = np.linspace(20.0, 45.0, rate.size)
    c = SURFACE.coefficients_dps * np.array([[1, 1, 0], [1, 1, 0], [1, 0, 0], [1, 0, 0]])
    surface = replace(SURFACE, coefficients_dps=c)
    sets = simulate(
        rng, rates=np.linspace(-100, 100, 29), temps=np.array([0.0, 10.0, 20.0, 30.0]), timed=False
    )
    # Rate errors of the table, the same at each visit of a rate, are what such a fit takes for terms in temperature.
    wrong = rng.normal(0.0, 0.03, 29)[np.searchsorted(np.linspace(-100, 100, 29) + 1e-6, rate)]
    gyro = surface.output_dps(rate, temp) + wrong + rng.normal(0.0, 5e-3, rate.size)
    return replace(sets, rate_dps=rate, temp_c=temp, gyro_dps=gyro), surface


def test_the_direction_of_an_open_loop_is_found() -> None:
    sets = simulate(np.random.default_rng(1), surface=OPEN_LOOP)
    chosen = fit_chosen(sets)
    assert chosen.choice.model == Model("input", (2, 2, 2, 2))
    assert chosen.fit.surface.direction == "input"
    assert "12 terms in the true rate instead of the paper's 12 in the output" in chosen.choice.reason
    gyro = OPEN_LOOP.output_dps(sets.rate_dps, sets.temp_c)
    assert rms(chosen.fit.surface.rate_dps(gyro, sets.temp_c) - sets.rate_dps) < 1e-3


def test_the_paper_s_model_stays_where_it_is_as_good() -> None:
    chosen = fit_chosen(simulate(np.random.default_rng(2)))
    assert chosen.choice.model == PAPER
    assert "the paper's, and nothing else does better" in chosen.choice.reason


def test_what_is_asked_for_is_taken() -> None:
    sets = simulate(np.random.default_rng(3), surface=OPEN_LOOP)
    assert fit_chosen(sets, model=PAPER).choice.model == PAPER
    one = fit_chosen(sets, direction="output", weights="ols")
    assert one.choice.model.direction == "output"
    assert one.fit.weights == "ols"
    assert "equal weights, as asked for" in one.choice.reason


def test_terms_that_are_not_determined_are_left_out_and_the_band_says_where() -> None:
    sets, surface = drifting(4)
    chosen = fit_chosen(sets)
    terms = chosen.fit.terms
    assert not terms.all()
    assert np.all(chosen.fit.surface.coefficients_dps.ravel()[~terms] == 0.0)
    rate, temp = (a.ravel() for a in np.meshgrid(np.linspace(-90, 90, 7), [20.0, 45.0]))
    gyro = surface.output_dps(rate, temp)
    design = chosen.fit.surface.design(rate if chosen.fit.surface.direction == "input" else gyro, temp)
    sigma = np.sqrt(np.sum(design @ chosen.fit.covariance_dps2 * design, axis=1))
    wrong = chosen.fit.surface.rate_dps(gyro, temp) - rate
    assert np.mean(np.abs(wrong) < 2.5 * sigma) > 0.9
    full = fit_chosen(sets, model=PAPER, weights="ols")
    assert rms(wrong) < rms(full.fit.surface.rate_dps(gyro, temp) - rate)
    near = chosen.fit.surface.design(chosen.fit.own_dps, sets.temp_c)
    assert np.median(sigma) > np.median(np.sqrt(np.sum(near @ chosen.fit.covariance_dps2 * near, axis=1)))


def test_candidates_are_scored_on_whole_groups_left_out() -> None:
    sets, _ = drifting(5)
    candidates = {c.model: c for c in tried(sets)}
    model = Model("output", (1, 1, 0, 0))
    groups = left_out_groups(sets)["time"]
    wrong: Floats = np.empty(len(sets))
    for label in np.unique(groups):
        out = groups == label
        columns = np.column_stack(
            [
                sets.gyro_dps**i * sets.temp_c**j
                for i, order in enumerate(model.orders)
                for j in range(order + 1)
            ]
        )
        c = np.linalg.lstsq(columns[~out] / np.abs(columns).max(axis=0), sets.error_dps[~out], rcond=None)[0]
        wrong[out] = sets.error_dps[out] - columns[out] / np.abs(columns).max(axis=0) @ c
    assert candidates[model].left_out_rms_dps["time"] == pytest.approx(rms(wrong), rel=1e-6)
    best = best_of(tuple(candidates.values()))
    rivals = [c for c in candidates.values() if c == candidates[PAPER] or c.pays_for(candidates[PAPER])]
    assert best.score <= min(c.score for c in rivals) + np.log(1.05) + 1e-12


def test_a_model_that_loses_on_one_kind_of_what_was_left_out_is_no_rival() -> None:
    def candidate(model: Model, temperature: float, time: float) -> Candidate:
        return Candidate(model, {"temperature": temperature, "time": time})

    paper = candidate(PAPER, 10.0, 1.0)
    few = candidate(Model("input", (1, 1, 0, 0)), 7.0, 1.2)
    fair = candidate(Model("input", (2, 2, 1, 1)), 8.0, 1.0)
    assert best_of((paper, few)) is paper
    assert best_of((paper, few, fair)) is fair
    # A tenth of the error is worth a tenth more on another kind.
    assert best_of((paper, candidate(Model("input", (1, 1, 0, 0)), 1.0, 1.1))) is not paper


def test_weights_are_never_those_that_predict_worse() -> None:
    """A misfit that grows with the rate looks like scatter that does; to weigh it down is to fit the rest only."""
    for seed in range(6):
        sets = simulate(np.random.default_rng([6, seed]), surface=OPEN_LOOP)
        chosen = fit_chosen(sets, direction="output")
        used = {v.left_out: v.rms_dps for v in chosen.left_out}
        other = {v.left_out: v.rms_dps for v in chosen.equal}
        assert used["time"] is not None
        assert other["time"] is not None
        assert used["time"] <= other["time"] * (1 + 1e-12)
