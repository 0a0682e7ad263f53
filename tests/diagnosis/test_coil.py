"""The search of a table: laws that it tells apart, and models that are averaged by their evidence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.correction import correction
from gyrocal.diagnosis.answer.effects import _instead_of_each_rate, named_effects
from gyrocal.diagnosis.answer.locate import located
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import _beyond_doubt, examine
from gyrocal.diagnosis.laws.at_rows import Laws, laws_of
from gyrocal.diagnosis.model.blocks import idle
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.model.parts import frame_of
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.candidates import AVERAGED_NATS, Candidate, averaged, sine_nats
from gyrocal.diagnosis.sweeps.changes import Change, Changes
from gyrocal.diagnosis.sweeps.coil import SHAPES, TOLL_NATS, replaced, table_search
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import Term
from gyrocal.physics.timewise import AGEING_NATS, growth
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]


def _blank(sine: object = None) -> Any:
    return SimpleNamespace(model=SimpleNamespace(open_loop=sine))


def test_models_weigh_by_their_evidence_and_far_ones_not_at_all() -> None:
    scores = [10.0, 10.5, 13.0, 10.0 + AVERAGED_NATS + 0.1]
    found = averaged([Candidate(None, (), _blank(), score) for score in scores])
    assert [c.score for _, c in found] == scores[:3]
    expected = np.exp([0.0, -0.5, -3.0])
    assert [w for w, _ in found] == pytest.approx((expected / expected.sum()).tolist())


def test_models_with_a_sine_count_together_against_those_without() -> None:
    """Two as good as the best without are twice as likely, and one that stands for e models counts as e."""
    with_it = [
        Candidate(None, (), _blank(object()), score, stands_for)
        for score, stands_for in ((10.0, 0.0), (10.0, 0.0))
    ]
    assert sine_nats([*with_it, Candidate(None, (), _blank(), 10.0)]) == pytest.approx(np.log(2.0))
    assert sine_nats([*with_it, Candidate(None, (), _blank(), 10.0, 1.0)]) == pytest.approx(np.log(2.0) - 1.0)
    assert sine_nats(with_it) == sine_nats([Candidate(None, (), _blank(), 10.0)]) == 0.0


@pytest.mark.parametrize(("behind", "kept"), [(3.8, False), (4.1, True)])
def test_a_shape_in_temperature_has_a_name_where_laws_in_its_place_are_200_times_less_likely_by_chance(
    behind: float, kept: bool
) -> None:
    """Half of the square of the normal quantile of 0.5 % on both sides: 3.94 nats, as of any law of the search."""
    ranked = [Candidate((1.0, 200.0), (), _blank(), 0.0)]
    plain = [Candidate((1.0, 200.0), (Change("warm_up", 300.0),), _blank(), behind)]
    assert (SHAPES in _beyond_doubt({SHAPES: 30.0}, ranked, plain, cast(Laws, None))) is kept


def test_a_warm_up_is_in_the_file_if_most_of_the_weight_has_one() -> None:
    """The best has none, and two others together outweigh it, or do not."""

    def kept(score: float) -> list[float]:
        scores = {10.0: (), score: (Change("warm_up", 300.0),), score + 0.1: (Change("warm_up", 600.0),)}
        found = averaged([Candidate(None, changes, _blank(), s) for s, changes in scores.items()])
        assert sum(w for w, _ in found) == pytest.approx(1.0)
        return [c.score for _, c in found]

    assert kept(10.2) == [10.2, 10.2 + 0.1]
    assert kept(11.0) == [10.0]


def test_a_sine_is_in_the_file_if_most_of_the_weight_has_one() -> None:
    near = [
        Candidate(None, (), _blank(sine), score)
        for sine, score in ((None, 10.0), ("sine", 10.5), ("sine", 10.6))
    ]
    assert [c.score for _, c in averaged(near)] == [10.5, 10.6]
    assert [c.score for _, c in averaged(near[:2])] == [10.0]


def _soaks(what: str, *, of_scale: bool = False) -> DataSetTable:
    """A closed-loop gyro at temperatures in turn, up and down, whose bias has 4 mdeg/s per degC of memory, or its scale factor at 100 deg/s."""
    rng = np.random.default_rng(5)
    rates = np.tile([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0], 8)
    target_c = np.repeat([20.0, 35.0, 50.0, 20.0, 5.0, 35.0, 50.0, 20.0], 7)
    seconds = np.arange(40)
    at_s = 40.0 * np.arange(rates.size, dtype=np.float64)
    temp, inside, play = 20.0, 20.0, 20.0
    outside_c, behind_c = np.empty(rates.size), np.empty(rates.size)
    for k, goal in enumerate(target_c):
        reached = []
        for _ in seconds:
            temp += (goal - temp) / 150.0
            inside += (temp - inside) / 400.0
            play = min(max(play, temp - 3.0), temp + 3.0)
            reached.append((temp, temp - inside if what == "shupe_gradient" else play - temp))
        outside_c[k], behind_c[k] = np.mean(reached, axis=0)
    gyro = rates * (1.0002 + 1e-4 * (outside_c - 27.0) / 25.0) + 0.005
    gyro += 4e-3 * behind_c * (rates / 100.0 if of_scale else 1.0)
    gyro = gyro + 6e-4 * rng.standard_normal(rates.size)
    return DataSetTable(Path("soaks.csv"), rates, gyro, outside_c, t_s=at_s + 20.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "shape", "true"), [("shupe_gradient", "tau_s", 400.0), ("thermal_hysteresis", "width_c", 3.0)]
)
def test_what_the_bias_of_a_table_remembers_is_told_from_a_lag_of_its_coil(
    effect: str, shape: str, true: float
) -> None:
    found = examine(series_of_table(_soaks(effect)), 1e-3)
    best = found.ranked[0]
    assert best.coil is None
    assert best.effects == {effect}
    assert best.fitted.model.laws[0].shape[shape] == pytest.approx(true, rel=0.2)


@pytest.mark.slow
def test_hysteresis_of_the_scale_factor_is_named_as_such_and_leaves_another_run() -> None:
    """It had been a lag of the coil."""
    found = examine(series_of_table(_soaks("thermal_hysteresis", of_scale=True)), 1e-3)
    (effect,) = named_effects(found)
    assert effect.effect == "thermal_hysteresis"
    assert effect.parameters["of_scale"].value == 1.0
    low, high = effect.parameters["amplitude"].interval_95
    assert low < 4.0 < high
    low, high = effect.parameters["width_c"].interval_95
    assert low < 3.0 < high
    written = [t for t in correction(found).terms if isinstance(t, Term) and t.name == "thermal_hysteresis"]
    assert {t.parameters["of_scale"]["value"] for t in written} == {1.0}


def _warming(of_scale_mdps: float, seed: int, starts_c: float) -> DataSetTable:
    """A gyro that warms up for some minutes, in bias and at 100 deg/s, in a room that warms and cools."""
    rng = np.random.default_rng(seed)
    rates = np.tile([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0], 14)
    t_s = 60.0 * np.arange(rates.size, dtype=np.float64) + 30.0
    temp_c = starts_c + 8.0 * np.sin(t_s / 900.0)
    settles = np.exp(-t_s / 900.0)
    gyro = rates * (1.0002 + 1e-4 * (temp_c - 27.0) / 25.0) + 0.005 + 1e-4 * temp_c
    gyro += settles * (12e-3 + 1e-3 * of_scale_mdps * rates / 100.0)
    return DataSetTable(
        Path("warms.csv"), rates, gyro + 6e-4 * rng.standard_normal(rates.size), temp_c, t_s=t_s
    )


@pytest.mark.slow
@pytest.mark.parametrize("of_scale_mdps", [-30.0, 0.0])
def test_a_warm_up_may_be_of_bias_and_scale_factor_and_comes_again(of_scale_mdps: float) -> None:
    """It had been one of the bias beside a drift of the scale factor, whose state at the end a file had."""
    found = examine(series_of_table(_warming(of_scale_mdps, 1, 27.0)), 1e-3)
    (effect,) = named_effects(found)
    assert effect.effect == "warm_up"
    if of_scale_mdps:
        assert effect.parameters["of_scale"].value == 1.0
        low, high = effect.parameters["amplitude"].interval_95
        assert low < of_scale_mdps < high
        assert effect.beside is not None
        ((_, low, high),) = effect.beside.facts["too"]
        assert low < 12.0 < high
    else:
        assert effect.beside is None
    again = _warming(of_scale_mdps, 2, 28.0)
    since_s = again.t_s
    assert since_s is not None
    corrected = Compensator(correction(found)).correct(
        since_s, again.gyro_dps, again.temp_c, since_power_on_s=since_s
    )
    assert np.std(corrected - again.rate_dps) < 1e-3


def test_what_stands_beside_a_law_goes_and_moves_with_it() -> None:
    step, bias = Change("scale_step", 7.0), Change("warm_up", 600.0)
    scale, later = bias._replace(of_scale=True), bias._replace(at=700.0)
    assert (scale.beside, bias.beside, step.beside) == (bias, None, None)
    assert replaced((step, bias, scale), bias, None) == (step,)
    assert replaced((step, bias, scale), scale, None) == (step, bias)
    assert replaced((step, bias, scale), bias, later) == (step, later, later._replace(of_scale=True))
    hysteresis = Change("thermal_hysteresis", 2.0, of_scale=True)
    assert hysteresis.beside is None


@pytest.mark.slow
def test_without_times_the_bias_remembers_in_data_sets_and_the_coil_does_not_stand_for_it() -> None:
    table = replace(_soaks("shupe_gradient"), t_s=None)
    named = {e.effect: e for e in named_effects(examine(series_of_table(table), 1e-3))}
    assert named.keys() == {"shupe_gradient"}
    low, high = named["shupe_gradient"].parameters["tau_data_sets"].interval_95
    assert low < 10.0 < high


@pytest.mark.slow
def test_a_bias_that_follows_the_temperature_rate_is_told_from_one_that_remembers() -> None:
    """A difference from an inside that follows within half a minute is nearly the rate, and had been its name."""
    rng = np.random.default_rng(4)
    t_s = 40.0 * np.arange(120, dtype=np.float64)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 24)
    temp_c = 30.0 + 20.0 * np.sin(t_s / 700.0)
    c_per_min = 60.0 * 20.0 / 700.0 * np.cos(t_s / 700.0)
    gyro = rate * (1.0 + 5e-5 * (temp_c - 30.0)) + 3e-3 * c_per_min + 3e-4 * rng.standard_normal(t_s.size)
    found = examine(series_of_table(DataSetTable(Path("rate.csv"), rate, gyro, temp_c, t_s=t_s)), 1e-3)
    best = found.ranked[0]
    assert best.coil is None
    assert best.effects == {"shupe"}
    (named,) = named_effects(found)
    assert named.effect == "shupe"
    assert named.parameters["amplitude"].value == pytest.approx(3.0, rel=0.1)


@pytest.mark.slow
def test_a_scale_factor_that_follows_the_temperature_rate_goes_from_another_run() -> None:
    """No lag of the coil is like it: that one is as large as the slope of the scale factor."""
    rng = np.random.default_rng(6)
    t_s = 40.0 * np.arange(120, dtype=np.float64)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 24)

    def gyro_dps(temp_c: Floats, c_per_min: Floats) -> Floats:
        return np.asarray(rate * (1.0 + 5e-6 * (temp_c - 30.0) + 2e-4 * c_per_min))

    def course(*waves: tuple[float, float]) -> tuple[Floats, Floats]:
        temp_c = 30.0 + np.sum([half_c * np.sin(t_s / period_s) for half_c, period_s in waves], axis=0)
        return temp_c, np.sum([60.0 * c / s * np.cos(t_s / s) for c, s in waves], axis=0)

    temp_c, c_per_min = course((15.0, 700.0), (5.0, 240.0))
    gyro = gyro_dps(temp_c, c_per_min) + 3e-4 * rng.standard_normal(t_s.size)
    found = examine(series_of_table(DataSetTable(Path("rate.csv"), rate, gyro, temp_c, t_s=t_s)), 1e-3)
    other_c, other_rate = course((12.0, 450.0), (4.0, 300.0))
    corrected = Compensator(correction(found)).correct(t_s, gyro_dps(other_c, other_rate), other_c)
    assert np.std(corrected - rate) < 0.1 * np.std(2e-4 * other_rate * rate)


def test_what_took_the_evidence_of_a_lag_is_exchanged_for_it() -> None:
    """Beside a drift that mends most of what the lag does the lag gains nothing, and without either the step is dearer."""
    t_s = 40.0 * np.arange(120, dtype=np.float64)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 24)
    table = DataSetTable(Path("any.csv"), rate, rate * 1.0001, 30.0 + 20.0 * np.sin(t_s / 500.0), t_s=t_s)
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    lag = 0.7, 200.0
    search.best_coil = lambda candidate: lag  # type: ignore[method-assign]
    drift, step = Change("scale_drift", 1.0), Change("bias_step", 40.0)
    moves = set(search.moves(search.fit(None, (drift, step), search.fit(None, (), None))))
    assert {(lag, (drift,)), (lag, (step,)), (lag, (drift, step))} <= {
        (coil, tuple(sorted(changes, reverse=True))) for coil, changes in moves
    }


def test_a_coil_that_never_got_warm_is_not_looked_for() -> None:
    """Heated once, from 20 to 60 degC: behind a lag of eight hours the coil has not left 22 degC."""
    t_s = np.linspace(0.0, 3600.0, 61)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 13)[:61]
    table = DataSetTable(Path("once.csv"), rate, rate, 20.0 + t_s / 90.0, t_s=t_s)
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    assert search._reached((1.0, 300.0))
    assert not search._reached((1.0, 28800.0))
    # A share of the lag is a share of the way.
    assert search._reached((0.1, 28800.0))
    for candidate in search.run():
        assert candidate.coil is None or search._reached(candidate.coil)


def test_the_lag_that_gains_most_is_foreseen_without_a_fit() -> None:
    """A coil that is wholly 200 s behind: beside a model without a lag the surface's slope tells of it."""
    t_s = 40.0 * np.arange(120, dtype=np.float64)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 24)
    temp_c = 30.0 + 20.0 * np.sin(t_s / 500.0)
    fine_s = np.arange(0.0, t_s[-1] + 1.0)
    coil_c, behind = np.empty(fine_s.size), 30.0
    for k, outside in enumerate(30.0 + 20.0 * np.sin(fine_s / 500.0)):
        behind += (outside - behind) / 200.0
        coil_c[k] = behind
    at_coil = np.interp(t_s, fine_s, coil_c) - 30.0
    noise = 3e-4 * np.random.default_rng(2).standard_normal(t_s.size)
    gyro = rate * (1.0 + 5e-5 * at_coil) + 1e-3 * at_coil + noise
    table = DataSetTable(Path("behind.csv"), rate, gyro, temp_c, t_s=t_s)
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    found = search.best_coil(search.fit(None, (), None))
    assert found is not None
    assert found[0] >= 0.7
    assert found[1] == pytest.approx(200.0, rel=0.5)


def _read_late(course_c: np.ndarray, t_s: np.ndarray, seed: int) -> DataSetTable:
    """A gyro whose thermometer is 20 s behind its coil, at times of a course of one value a second."""
    behind, read_c = course_c[0], np.empty(course_c.size)
    for k, coil_c in enumerate(course_c):
        behind += (coil_c - behind) / 20.0
        read_c[k] = behind
    at = t_s.astype(np.int64)
    rate = np.tile([0.0, 40.0, -40.0, 100.0, -100.0], t_s.size // 5 + 1)[: t_s.size]
    own_c = course_c[at] - 30.0
    noise = 4e-4 * np.random.default_rng(seed).standard_normal(t_s.size)
    gyro = rate * (1.0 + 5e-5 * own_c) + 2e-3 * own_c + noise
    return DataSetTable(Path("late.csv"), rate, gyro, read_c[at], t_s=t_s)


@pytest.mark.slow
def test_a_thermometer_that_lags_behind_the_coil_is_a_lag_the_other_way() -> None:
    """A box in the rate of change of the temperature had been steps of the scale factor."""
    ramp = np.linspace(15.0, 45.0, 1200)
    course = np.concatenate([ramp, np.full(900, 45.0), ramp[::-1], np.full(900, 15.0), ramp])
    t_s = np.arange(20.0, course.size, 40.0)
    found = examine(series_of_table(_read_late(course, t_s, 3)), 1e-3)
    named = {e.effect: e for e in named_effects(found)}
    assert named.keys() == {"thermal_lag"}
    assert named["thermal_lag"].parameters["amplitude"].interval_95[1] < 0.0
    t_s = np.arange(200.0, 6000.0, 50.0)
    other = _read_late(30.0 + 14.0 * np.sin(np.arange(6000.0) / 600.0), t_s, 4)
    left = Compensator(correction(found)).correct(t_s, other.gyro_dps, other.temp_c) - other.rate_dps
    # Where the late reading alone would leave some 5e-3 deg/s.
    assert np.std(left) < 7e-4


@pytest.mark.slow
@pytest.mark.parametrize("rates", [15, 20])
def test_what_a_narrow_peak_hid_is_looked_for_beside_it(rates: int) -> None:
    """No smooth shape follows a peak of 2 deg/s, so that the noise does, and hides errors of each rate and a cubic bend."""
    rng = np.random.default_rng(3)
    sizes = np.linspace(0.0, 100.0, rates + 1)[1:]
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 4)
    temp_c = np.repeat([20.0, 50.0, 35.0, 12.0], 2 * rates + 1)
    of_each = rng.normal(0.0, 6e-5, sizes.size)
    share = np.tile(np.concatenate([of_each[::-1], [0.0], of_each]), 4)
    peak = 0.06 / (1.0 + ((np.abs(rate) - 36.0) / 2.0) ** 2)
    bend = 4e-3 * ((temp_c - 31.0) / 19.0) ** 3
    gyro = rate * (1.0 + share) + peak + bend + 3e-4 * rng.standard_normal(rate.size)
    t_s = 30.0 * np.arange(rate.size, dtype=np.float64)
    found = examine(series_of_table(DataSetTable(Path("peak.csv"), rate, gyro, temp_c, t_s=t_s)), 1e-3)
    named = {e.effect for e in named_effects(found)}
    assert named == {"mechanical_resonance", "reference_rate_error", "temperature_order"}
    # What has a name is in every model that the file is made of.
    assert all(c.fitted.model.laws for _, c in found.candidates)


@pytest.mark.slow
def test_drifts_of_bias_and_scale_factor_that_show_little_alone_are_asked_together() -> None:
    t_s = 40.0 * np.arange(120, dtype=np.float64)
    rate = np.tile([0.0, 50.0, -50.0, 100.0, -100.0], 24)
    gyro = rate * 1.0001 + 3e-4 * np.random.default_rng(7).standard_normal(t_s.size)
    table = DataSetTable(Path("any.csv"), rate, gyro, 30.0 + t_s / 200.0, t_s=t_s)
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    search.moves = lambda candidate: ()  # type: ignore[method-assign]
    search.run()
    asked = {frozenset(change.effect for change in changes) for coil, changes in search.known if coil is None}
    for of_bias in ("bias_drift", "bias_step"):
        assert {frozenset({of_bias, of_scale}) for of_scale in ("scale_drift", "scale_step")} <= asked


def _knee(rates: int, seed: int) -> DataSetTable:
    """A gyro whose gain falls by 0.2 % above 62 deg/s, at rates of both signs and temperatures up and down."""
    rng = np.random.default_rng(seed)
    sizes = np.linspace(0.0, 100.0, rates + 1)[1:]
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 8)
    temp = np.repeat([20.0, 30.0, 40.0, 50.0, 45.0, 35.0, 25.0, 15.0], 2 * rates + 1)
    beyond = np.sign(rate) * np.maximum(np.abs(rate) - 62.0, 0.0)
    gyro = rate * (1.0 + 1e-5 * (temp - 30.0)) - 2e-3 * beyond + 3e-4 * rng.standard_normal(rate.size)
    return DataSetTable(Path("knee.csv"), rate, gyro, temp, t_s=30.0 * np.arange(rate.size, dtype=np.float64))


@pytest.mark.slow
def test_a_knee_between_few_rates_is_corrected_between_them() -> None:
    """Errors of each rate follow it as well where it was seen, know nothing of the rates between, and leave 3 mdeg/s there."""
    found = examine(series_of_table(_knee(6, 0)), 1e-3)
    again = _knee(9, 1)
    assert again.t_s is not None
    file = Compensator(correction(found))
    assert np.std(file.correct(again.t_s, again.gyro_dps, again.temp_c) - again.rate_dps) < 4e-4


@pytest.mark.slow
def test_errors_of_few_rates_are_the_tables_and_no_shape_in_rate() -> None:
    """Six rates: shapes in rate follow any errors of them, and would be in the file between the rates as well."""
    rng = np.random.default_rng(8)
    sizes = np.linspace(0.0, 100.0, 7)[1:]
    of_each = rng.normal(0.0, 3e-4, sizes.size)
    share = np.concatenate([of_each[::-1], [0.0], of_each])
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 8)
    temp = np.repeat([20.0, 30.0, 40.0, 50.0, 45.0, 35.0, 25.0, 15.0], share.size)
    gyro = rate * (1.0 + 1e-5 * (temp - 30.0) + np.tile(share, 8)) + 3e-4 * rng.standard_normal(rate.size)
    table = DataSetTable(Path("off.csv"), rate, gyro, temp, t_s=30.0 * np.arange(float(rate.size)))
    found = examine(series_of_table(table), 1e-3)
    (effect,) = named_effects(found)
    assert effect.effect == "reference_rate_error"
    low, high = effect.parameters["amplitude"].interval_95
    assert low < 300.0 < high
    # What has a name is not said to be left.
    assert [(p.coordinate, p.remains) for p in located(found, 0.01)] == [("rate", False)]
    models = [(weight, c.fitted.model) for weight, c in found.candidates]
    assert sum(w for w, m in models if "odd rate" not in m.blocks.values()) > 0.5


@pytest.mark.slow
def test_errors_of_each_rate_in_each_direction_may_be_the_tables() -> None:
    """Shapes that are even in rate follow them as well, and would be in the file by themselves."""
    rng = np.random.default_rng(9)
    sizes = np.linspace(0.0, 100.0, 7)[1:]
    signed = np.concatenate([-sizes[::-1], [0.0], sizes])
    rate = np.tile(signed, 8)
    temp = np.repeat([20.0, 30.0, 40.0, 50.0, 45.0, 35.0, 25.0, 15.0], signed.size)
    off = np.tile(rng.normal(0.0, 3e-4, signed.size), 8)
    gyro = rate * (1.0 + 1e-5 * (temp - 30.0) + off) + 3e-4 * rng.standard_normal(rate.size)
    table = DataSetTable(Path("off.csv"), rate, gyro, temp, t_s=30.0 * np.arange(float(rate.size)))
    models = [(w, c.fitted.model) for w, c in examine(series_of_table(table), 1e-3).candidates]
    assert sum(w for w, m in models if "each direction" in m.components) > 0.1


@pytest.mark.slow
def test_a_knee_has_its_name_at_six_sizes_where_its_true_softness_explains_all() -> None:
    """With the grid's softness it was a little worse than errors of each rate, and stood beside them as equally likely."""
    found = examine(series_of_table(_knee(6, 1)), 1e-3)
    (effect,) = named_effects(found)
    assert effect.effect == "saturation"
    low, high = effect.parameters["knee_dps"].interval_95
    assert low < 62.0 < high


@pytest.mark.slow
def test_a_law_that_is_none_of_the_catalogue_goes_into_the_file_as_smooth_parts() -> None:
    """Two gaps, a slow drift: of the models with laws alone the best is wrong by more on another course."""
    first, again = _of_two_gaps(0), _of_two_gaps(1)
    found = examine(series_of_table(first), 1e-3)
    best = found.smooth[0]
    assert best.score < found.ranked[0].score
    assert "play on bias" in {p.name for p in best.fitted.model.parts}

    def left(candidate: Candidate) -> float:
        file = Compensator(correction(replace(found, candidates=((1.0, candidate),))))
        assert again.t_s is not None
        return float(np.std(file.correct(again.t_s, again.gyro_dps, again.temp_c) - again.rate_dps))

    assert left(best) < 0.85 * left(found.ranked[0])
    assert found.candidates[0][1] is best


def _of_two_gaps(course: int) -> DataSetTable:
    """A gyro whose bias follows the temperature behind gaps of 2 and 12 degC, and on the first course drifts."""
    rng = np.random.default_rng(course)
    rates = np.tile([0.0, 20.0, -20.0, 60.0, -60.0], 16)
    goals = ([20.0, 45.0, 5.0, 35.0, 15.0, 30.0], [30.0, 5.0, 25.0, 10.0, 45.0, 20.0])[course]
    temp_c = np.interp(np.arange(rates.size), np.linspace(0, rates.size, 6), goals)
    behind_c = np.zeros(rates.size)
    for half_c in (1.0, 6.0):
        play = temp_c[0]
        for k, temp in enumerate(temp_c):
            play = min(max(play, temp - half_c), temp + half_c)
            behind_c[k] += play - temp
    t_s = 40.0 * np.arange(rates.size, dtype=np.float64)
    drift = 2e-6 * t_s if course == 0 else 0.0
    gyro = rates * 1.0002 + 3e-3 * behind_c + drift + 4e-4 * rng.standard_normal(rates.size)
    return DataSetTable(Path("gaps.csv"), rates, gyro, temp_c, t_s=t_s)


def _sweep() -> Changes:
    t_s, rate_dps = 60.0 * np.arange(40.0), np.linspace(-50.0, 50.0, 40)
    means = means_of(
        series_of_table(
            DataSetTable(Path("sweep.csv"), rate_dps, rate_dps, 40.0 - np.abs(t_s / 60.0 - 20.0), t_s=t_s)
        )
    )
    return Changes(means, frame_of(means))


def test_a_law_of_the_scale_factor_is_that_of_the_bias_at_100_dps() -> None:
    changes = _sweep()
    ((at, *_),) = [changes.grids("thermal_hysteresis")[0]]
    of_bias, of_scale = (changes.law(Change("thermal_hysteresis", at, of_scale=s)) for s in (False, True))
    by_rate = of_bias.columns * changes.means.rate_dps[:, None] / 100.0
    np.testing.assert_allclose(of_scale.columns, by_rate)
    assert (of_bias.goes_by_rate, of_scale.goes_by_rate) == (False, True)


@pytest.mark.parametrize(
    ("change", "shape"),
    [
        (Change("bias_step", 7), {"at_s": 390.0}),
        (Change("scale_step", 7), {"at_s": 390.0}),
        (Change("bias_drift", 1.0), {"power": 1.0}),
        (Change("scale_drift", 0.5), {"power": 0.5}),
        (Change("bias_drift", 0.0, 234.0), {"knee_s": 234.0, "from_s": 0.0}),
    ],
)
def test_a_law_of_time_is_that_of_the_catalogue_less_a_state_of_the_record(
    change: Change, shape: dict[str, float]
) -> None:
    changes = _sweep()
    t_s, rate_dps = changes.means.t_s, changes.means.rate_dps
    law = changes.law(change)
    assert dict(law.shape) == shape
    effect, ones = find_effect(change.effect), np.ones(40)
    by_rate = "rate_dps" in effect.needs
    c = Conditions(t_s, rate_dps, 20.0 * ones)
    unit = rate_dps if by_rate else ones
    grown = effect.unit_dps(c, shape, None) / unit
    # After a step the gyro is what it is; of a drift nobody knows whether it lasts.
    state = grown[-1] if "step" in change.effect else grown.mean()
    np.testing.assert_allclose(law.columns[:, 0], (grown - state) * unit, atol=1e-12)


@pytest.mark.parametrize(
    "change", [Change("bias_drift", 1.0), Change("bias_step", 7), Change("warm_up", 300.0)]
)
def test_what_is_straight_sudden_or_of_one_time_constant_is_plain(change: Change) -> None:
    assert change.plain
    assert not change._replace(spread=0.8).plain
    assert change._replace(at=0.5).plain == (change.effect != "bias_drift")


def test_what_ages_starts_with_less_than_what_goes_with_a_power_of_time() -> None:
    assert Change("bias_drift", 0.0, 300.0).prior_nats == AGEING_NATS < 0.0
    assert Change("bias_drift", 0.5).prior_nats == Change("warm_up", 300.0, 0.8).prior_nats == 0.0
    assert Change("rate_heating", 600.0).prior_nats < 0.0


def test_drifts_are_in_the_order_of_how_early_they_come() -> None:
    """Powers of time and of its logarithm lie between each other, and a search goes from one to the next."""
    changes = _sweep()
    t_s = np.array([0.5, 1.0]) * np.ptp(changes.means.t_s)
    shapes = [changes.law(change).shape for change in changes.shapes("bias_drift")]
    early = [half / whole for half, whole in (growth(t_s, shape) for shape in shapes)]
    assert early == sorted(early)
    assert {frozenset(shape) for shape in shapes} == {frozenset({"power"}), frozenset({"knee_s", "from_s"})}
    near = changes.neighbours(Change("bias_drift", 0.5))
    assert len(near) == 4
    assert any(change.spread for change in near)
    assert len(changes.neighbours(changes.shapes("bias_drift")[0])) == 2


def test_a_step_that_takes_its_time_is_half_done_at_its_instant() -> None:
    changes = _sweep()
    slow = changes.law(Change("bias_step", 7, 120.0))
    at_s, columns = slow.shape["at_s"], 1e3 * slow.columns[:, 0]
    at_instant = np.interp(at_s, changes.means.t_s, columns)
    assert at_instant - columns[0] == pytest.approx(0.5, abs=0.05)
    assert columns[-1] == 0.0
    assert slow.name != changes.law(Change("bias_step", 7)).name


@pytest.mark.parametrize("effect", ["warm_up", "shupe_gradient"])
def test_a_law_of_many_time_constants_is_a_sum_of_laws_of_one(effect: str) -> None:
    """What the file has is what was fitted: one term for each."""
    changes = _sweep()
    at = changes.grids(effect)[0][5]
    law = changes.law(Change(effect, at, 0.8))
    assert sum(weight for _, weight in law.members) == pytest.approx(1.0)
    laws = laws_of(changes.means, Surface(np.zeros((4, 3)), 0.0, 50.0, 40.0, 20.0))
    np.testing.assert_allclose(law.columns, laws.columns_of(law), atol=1e-12)
    assert len(law.members) > 2


@pytest.mark.slow
def test_a_file_has_each_time_constant_with_its_share_of_the_amplitude() -> None:
    """A warm-up that is no exponential, at five rates, whose cubic has all of any odd law of the rate."""
    rng = np.random.default_rng(3)
    t_s = 30.0 * np.arange(100.0)
    rate_dps = np.tile([0.0, 30.0, -30.0, 60.0, -60.0], 20)
    temp_c = 25.0 + 5.0 * np.sin(t_s / 200.0)
    settling = 0.05 * np.mean([np.exp(-t_s / tau) for tau in (80.0, 250.0, 800.0)], axis=0)
    gyro = rate_dps + 0.002 * (temp_c - 25.0) + settling + 2e-4 * rng.standard_normal(t_s.size)
    found = examine(series_of_table(DataSetTable(Path("warm.csv"), rate_dps, gyro, temp_c, t_s=t_s)), 1e-3)
    (change,) = found.ranked[0].changes
    assert change.effect == "warm_up"
    assert change.spread > 0.0
    corrected = Compensator(correction(found)).correct(t_s, gyro, temp_c, t_s)
    assert np.sqrt(np.mean((corrected - rate_dps) ** 2)) < 4e-4


def test_what_the_surface_can_take_back_is_not_believed_beyond_what_the_record_shows() -> None:
    means = _sweep().means
    wavy = replace(means, gyro_dps=means.rate_dps + 5e-4 * np.sin(np.arange(40.0)))
    search = table_search(full_model(wavy, memory=False))
    law = search.changes.law(Change("bias_drift", 1.0))
    solved = cast(Any, SimpleNamespace(amplitudes={law.name: np.array([1.0])}))
    added = search._added(cast(Any, SimpleNamespace(laws=(law,), components={})), solved)
    shown = search._beyond_rate(search.base.error_dps)
    own = search._beyond_rate(law.columns[:, 0])
    assert search._cancelled(added.values(), search.base.error_dps) == pytest.approx(
        max(0.0, own / shown - 1.0)
    )


def test_a_law_with_a_name_is_none_that_errors_of_each_rate_could_be() -> None:
    """It stands beside them; one that only a rival model has stands in their place."""
    law = SimpleNamespace(effect="mechanical_resonance")
    rival = Candidate(None, (), cast(Any, SimpleNamespace(model=SimpleNamespace(laws=(law,)))), 1.0)
    first = Candidate(None, (), cast(Any, None), 2.0)

    def instead(named: tuple[str, ...]) -> dict[str, float]:
        names = tuple(SimpleNamespace(law=SimpleNamespace(effect=e)) for e in named)
        found = SimpleNamespace(naming=SimpleNamespace(named=names), of_rate=(rival,), ranked=(first,))
        return _instead_of_each_rate(cast(Any, found))

    assert instead(()) == {"mechanical_resonance": 0.0}
    assert instead(("mechanical_resonance",)) == {}


@pytest.mark.parametrize(("temperatures", "told"), [(1, True), (3, False), (5, True)])
def test_of_a_few_temperatures_no_step_of_the_scale_factor_between_them_is_told_from_the_surface(
    temperatures: int, told: bool
) -> None:
    """A drift, and a step that mended it, had taken the slope over three temperatures: 3.7 deg/s became 5.2 on another run."""
    rates = np.tile(np.linspace(-100.0, 100.0, 9), max(temperatures, 3))
    temp_c = np.repeat(np.linspace(0.0, 40.0, temperatures), rates.size // temperatures)
    t_s = 60.0 * np.arange(rates.size, dtype=np.float64)
    means = means_of(series_of_table(DataSetTable(Path("few.csv"), rates, rates, temp_c, t_s=t_s)))
    changes = Changes(means, frame_of(means))
    assert any(step.at == 9.0 for step in changes.shapes("scale_step")) is told
    assert bool(changes.shapes("scale_drift")) is told
    assert changes.shapes("bias_step")


def _ripple(of_scale_ppm: float) -> DataSetTable:
    """A scale factor that ripples every 3 degC, or does not, in a box that warms up."""
    rng = np.random.default_rng(4)
    rate = np.tile([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0], 20)
    t_s = 20.0 * np.arange(rate.size, dtype=np.float64)
    temp_c = 30.0 + t_s / 200.0 + np.sin(t_s / 150.0)
    share = 1e-4 * (temp_c - 37.0) / 7.0 + 1e-6 * of_scale_ppm * np.sin(2.0 * np.pi * temp_c / 3.0)
    gyro = rate * (1.0 + share) + 6e-4 * rng.standard_normal(rate.size)
    return DataSetTable(Path("box.csv"), rate, gyro, temp_c, t_s=t_s)


@pytest.mark.parametrize("of_scale_ppm", [0.0, 60.0])
def test_shapes_in_temperature_stay_where_they_pay_what_a_law_pays(of_scale_ppm: float) -> None:
    """Narrow ones that gain a nat or two had taken half of a step of the scale factor, while a box warms up."""
    search = table_search(full_model(means_of(series_of_table(_ripple(of_scale_ppm))), memory=False))
    first = search.fit(None, (), None)
    shapes = [p.name for p in search.shapes]
    names = idle(first.fitted, shapes, TOLL_NATS)
    less = search.without(names)
    kept = [p.name for p in less.shapes]
    assert kept == (["narrow temperature on scale"] if of_scale_ppm else [])
    without = less.fit(None, (), None)
    assert not {*names} & without.fitted.model.components.keys()
    # They compare with each other, and what went is worth less than a law's price each.
    assert -0.01 < without.score - first.score < TOLL_NATS * len(names)
    assert idle(without.fitted, kept, TOLL_NATS) == []


def test_a_model_in_which_shapes_had_died_is_known_without_them() -> None:
    search = table_search(full_model(means_of(series_of_table(_ripple(60.0))), memory=False))
    first = search.fit(None, (), None)
    dead = [p.name for p in search.shapes if first.fitted.has_died(p.name)]
    assert dead
    known = search.without(dead).known[None, ()]
    assert known.score == first.score
    assert not {*dead} & known.fitted.model.components.keys()
    anew = first.fitted.refit(known.fitted.model)
    assert anew.nll == pytest.approx(first.fitted.nll, abs=0.01)
    assert not search.without([p.name for p in search.shapes]).known


@pytest.mark.parametrize("seed", [0, 1])
def test_three_soaks_visited_once_tell_of_no_lag(seed: int) -> None:
    """A lag moves three temperatures to where the surface bends least; it had its name on six of six such tables."""
    rng = np.random.default_rng(seed)
    temp_c, rates_dps = np.repeat([-28.3, 74.1, 23.8], 5), np.array([-225.0, -111.6, 0.0, 111.6, 225.0])
    rate_dps = np.concatenate([rng.permutation(rates_dps) for _ in range(3)])
    t_s = np.concatenate([begin_s + 16.0 * np.arange(5) for begin_s in (2950.0, 6440.0, 9860.0)])
    v, u = (temp_c - 22.0) / 50.0, rate_dps / 225.0
    error_dps = -0.45 * v + 0.1 * v**2 + u * (-0.9 - 1.8 * v + 0.35 * v**2) + 0.1 * u**2 * v + 0.05 * u**3
    gyro_dps = rate_dps + error_dps + 0.03 * rng.standard_normal(15)
    table = DataSetTable(Path("soaks.csv"), rate_dps, gyro_dps, np.round(2.0 * temp_c) / 2.0, t_s=t_s)
    assert diagnose(table, options=Options(heldout=False)).effects == ()


def test_a_sensor_behind_its_coil_pays_what_any_law_pays() -> None:
    """A coil that is behind is what gyros have; a table that warms up hardly tells which of the two it is."""
    search = table_search(full_model(_sweep().means, memory=False))
    behind, ahead = search._toll((0.7, 238.0), ()), search._toll((-0.7, 238.0), ())
    assert ahead - behind == pytest.approx(TOLL_NATS)


def test_a_grid_that_became_finer_costs_no_more_behind_another_slope() -> None:
    """What a law pays is for the shapes that it had at first, and is compared before the sine and behind it."""
    changes = _sweep()
    before = dict(changes.trials)
    first, second = changes.values["warm_up"][:2]
    changes.values["warm_up"][1:1] = np.linspace(first, second, 12)[1:-1].tolist()
    assert changes.at(changes.means).trials == before
    assert len(changes.at(changes.means).shapes("warm_up")) > before["warm_up", False]
