"""Laws in place of smooth parts, on tables at rest through a cycle of temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose, series_of
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.laws.at_rows import effects_of, laws_of
from gyrocal.diagnosis.laws.contest import ALIKE_NATS, best_law
from gyrocal.diagnosis.laws.estimates import of_law
from gyrocal.diagnosis.laws.in_place import Alone, Named, _paired
from gyrocal.diagnosis.model import blocks
from gyrocal.diagnosis.model.blocks import REPLACED, less
from gyrocal.diagnosis.model.layers import Fitted, Law, full_model, surface_of
from gyrocal.diagnosis.model.parts import BLOCKS, EACH_RATE, ODD
from gyrocal.diagnosis.model.starts import fit_anyhow
from gyrocal.diagnosis.names.naming import (
    Naming,
    _at_one_size,
    _least_worth,
    _mechanisms,
    _of_some_size,
    may_lose,
    still_there,
)
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.coil import TOLL_NATS
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from gyrocal.records.datasets import DataSetTable
from gyrocal.trial.made_up import make_up

_SETS = 200
_T_S: NDArray[np.float64] = 60.0 * np.arange(_SETS, dtype=np.float64)
_NOISE_DPS = 2e-4


def naming_of(added_dps: NDArray[np.float64], seed: int, temp_c: NDArray[np.float64] | None = None) -> Naming:
    """What is named in data sets at rest, of noise of 0.2 mdeg/s and what is added."""
    noise = _NOISE_DPS * np.random.default_rng(seed).standard_normal(_SETS)
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0) if temp_c is None else temp_c
    table = DataSetTable(Path("rest.csv"), np.zeros(_SETS), 0.01 + noise + added_dps, temp, t_s=_T_S)
    return examine(series_of_table(table), 0.01).naming


@pytest.mark.parametrize("seed", range(2))
def test_a_shape_is_found_between_the_points_of_its_grid(seed: int) -> None:
    """The grid has 367 s and 532 s: either of the two leaves a misfit, for which the smooth part would have to stay."""
    found = naming_of(20e-3 * np.exp(-_T_S / 420.0), seed)
    (law,) = found.named
    assert law.law.effect == "warm_up"
    assert law.law.shape["tau_s"] == pytest.approx(420.0, rel=0.05)
    assert law.share == pytest.approx(1.0, abs=0.05)
    assert not found.unnamed


@pytest.mark.parametrize(
    ("warm_up", "drift", "again"), [(0.0, 0.0, 0.5), (0.0, 3.0, 0.953), (2.0, 0.0, 0.119)]
)
def test_a_warm_up_comes_again_as_surely_as_it_is_told_from_a_drift(
    warm_up: float, drift: float, again: float
) -> None:
    nearest = {"warm-up": {"warm_up": warm_up, "bias_drift": drift}}
    assert Naming(cast(Fitted, None), (), nearest=nearest).comes_again == pytest.approx(again, abs=1e-3)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_warm_up_of_two_time_constants_is_no_drift(seed: int) -> None:
    """One that slows down is nearer to two exponentials than one of them is, but does not come again."""
    found = naming_of(1e-3 * np.exp(-_T_S / 177.0) + 1e-3 * np.exp(-_T_S / 3369.0), seed)
    assert {n.law.effect for n in found.named} == {"warm_up"}
    assert found.comes_again > 0.9
    drift = naming_of(3e-3 * (_T_S / _T_S[-1]) ** 0.3, seed)
    assert [n.law.effect for n in drift.named] == ["bias_drift"]
    assert drift.comes_again < 0.1


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drift_that_grows_is_no_warm_up(seed: int) -> None:
    """Two exponentials that cancel each other at the beginning are as like it as can be, and come again."""
    found = naming_of(3e-3 * (_T_S / _T_S[-1]) ** 2.2, seed)
    (drift,) = found.named
    assert drift.law.effect == "bias_drift"
    assert drift.law.shape["power"] == pytest.approx(2.2, abs=0.4)
    assert found.comes_again < 0.1


def test_a_warm_up_of_two_time_constants_is_two_laws() -> None:
    """One law by itself takes a constant that is neither, beside which a second one is not seen."""
    found = naming_of(1e-3 * np.exp(-_T_S / 250.0) + 2e-3 * np.exp(-_T_S / 2700.0), 0)
    assert {n.law.effect for n in found.named} == {"warm_up"}
    taus = sorted(n.law.shape["tau_s"] for n in found.named)
    assert taus == pytest.approx([250.0, 2700.0], rel=0.3)
    assert not found.unnamed


def test_the_only_law_of_a_family_names_what_it_only_resembles() -> None:
    """A glass transition is no power of the temperature, and a shape of it all the same."""
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)
    found = naming_of(5e-3 * np.tanh((temp - 28.0) / 1.5), 0)
    (law,) = found.named
    assert law.law.effect == "temperature_order"
    assert law.share < 0.6
    assert "temperature" in found.unnamed, "what the law leaves stays in the model"


def heated_c() -> NDArray[np.float64]:
    """Ramps up and down, and soaks."""
    knots_s = [0.0, 1200.0, 2400.0, 4200.0, 5400.0, 7800.0, 9000.0, 10200.0, 13000.0]
    return np.interp(_T_S, knots_s, [15.0, 35.0, 35.0, 18.0, 18.0, 38.0, 30.0, 30.0, 12.0])


@pytest.mark.parametrize(
    ("width_c", "play", "tau_s", "gradient"),
    [(5.6, 0.5, 370.0, 0.6), pytest.param(1.6, -0.44, 420.0, -0.41, marks=pytest.mark.slow)],
)
def test_thermal_transients_that_hide_each_other_are_named_together(
    width_c: float, play: float, tau_s: float, gradient: float
) -> None:
    """Either alone takes a shape between both, beside which the other is not seen."""
    temp = heated_c()
    c = Conditions(_T_S, np.zeros(_SETS), temp)
    plays = CATALOGUE["thermal_hysteresis"].unit_dps(c, {"width_c": width_c}, None)
    lags = CATALOGUE["shupe_gradient"].unit_dps(c, {"tau_s": tau_s}, None)
    found = naming_of(play * plays + gradient * lags, 1, temp)
    shapes = {n.law.effect: n.law.shape for n in found.named}
    assert shapes.keys() == {"thermal_hysteresis", "shupe_gradient"}
    assert shapes["thermal_hysteresis"]["width_c"] == pytest.approx(width_c, rel=0.15)
    assert shapes["shupe_gradient"]["tau_s"] == pytest.approx(tau_s, rel=0.15)
    assert not found.unnamed


@pytest.mark.slow
def test_a_gradient_of_two_time_constants_is_one_mechanism() -> None:
    temp = heated_c()
    c = Conditions(_T_S, np.zeros(_SETS), temp)
    law = CATALOGUE["shupe_gradient"]
    both = law.unit_dps(c, {"tau_s": 100.0}, None) + law.unit_dps(c, {"tau_s": 900.0}, None)
    found = naming_of(0.5 * both, 1, temp)
    assert {n.law.effect for n in found.named} <= {"shupe", "shupe_gradient"}


@pytest.mark.slow
def test_laws_that_are_shaped_beside_each_other_keep_their_names() -> None:
    """Two plays: the first is shaped again beside the second, and is the same law."""
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)

    def play(half_width: float) -> NDArray[np.float64]:
        out = temp.copy()
        for k in range(1, out.size):
            out[k] = max(temp[k] - half_width, min(temp[k] + half_width, out[k - 1]))
        return out - temp

    found = naming_of(2e-3 * play(2.2) + 4e-3 * play(6.3), 3)
    plays = [n.law for n in found.named if n.law.effect == "thermal_hysteresis"]
    assert sorted(law.shape["width_c"] for law in plays) == pytest.approx([2.2, 6.3], rel=0.1)
    assert {law.name for law in plays} <= {law.name for law in found.fitted.model.laws}


def test_a_name_goes_with_the_smooth_parts_that_stood_for_it() -> None:
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)
    found = naming_of(5e-3 * np.tanh((temp - 28.0) / 1.5), 0)
    (law,) = found.named
    absent = replace(law.law, shape={"order": 4.0, "center_c": 0.0})
    by_block = Named(absent, "temperature", 50.0, 1.0, {}, 4)
    gone = Named(absent, "memory", 50.0, 1.0, {}, 4)
    kept = still_there([law, by_block, gone], found.fitted, {"temperature": 7.0})
    assert kept[0] is law
    assert [(n.block, n.gain) for n in kept[1:]] == [("temperature", 7.0)]


def test_a_law_that_may_be_nothing_in_place_of_smooth_parts_has_no_name() -> None:
    """A supply that a bend in temperature resembled had kept its name, of an amplitude between minus and plus 3e4."""
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)
    noise = _NOISE_DPS * np.random.default_rng(0).standard_normal(_SETS)
    bent = 0.01 + noise + 5e-3 * np.tanh((temp - 28.0) / 1.5)
    full = full_model(
        means_of(series_of_table(DataSetTable(Path("rest.csv"), np.zeros(_SETS), bent, temp, t_s=_T_S)))
    )
    fitted = fit_anyhow(full)
    laws = laws_of(full.means, surface_of(fitted.model, fitted.solve()))

    def for_block(block: str, effect: str, shape: dict[str, float]) -> Named:
        law = Law(effect, shape, laws.at(CATALOGUE[effect], shape))
        return Named(law, block, 50.0, 1.0, {}, 4)

    cubic = for_block("temperature", "temperature_order", {"order": 3.0, "center_c": 20.0})
    nothing = for_block("warm-up", "warm_up", {"tau_s": 300.0})
    assert _of_some_size([cubic, nothing], fitted, laws) == [cubic]
    # What the model itself holds has been weighed there.
    held = replace(fitted, model=fitted.model.with_laws(nothing.law))
    assert _of_some_size([nothing], held, laws) == [nothing]


@pytest.mark.slow
def test_a_step_is_not_named_a_shape_in_temperature_beside_itself(tmp_path: Path) -> None:
    """Cubic in temperature until the step was seen: the smooth parts went, and the name had stayed."""
    made = make_up("layers", 160, 3)
    found = diagnose(made.write(tmp_path), options=Options(heldout=False))
    names = {e.effect for e in found.effects}
    assert "scale_step" in names
    assert "temperature_order" not in names


@pytest.mark.slow
def test_a_step_that_shapes_in_temperature_follow_beside_a_law_is_found(tmp_path: Path) -> None:
    """A plan that goes through its temperatures once: a step of the scale factor is a shape in temperature, too."""
    made = make_up("layers", 106, 7)
    found = diagnose(made.write(tmp_path), options=Options(heldout=False))
    assert {"temperature_order", "scale_step"} <= {e.effect for e in found.effects}


@pytest.mark.slow
def test_smooth_parts_do_not_stand_in_for_the_surface(tmp_path: Path) -> None:
    """Five temperatures, and a scale factor that is quadratic in temperature: its own term may have died beside bumps."""
    made = make_up("sensors", 172, 1)
    found = examine(series_of(made.write(tmp_path)), 0.01)
    assert [n.law.effect for n in found.naming.named] == ["supply_voltage"]
    assert sum(found.naming.unnamed.values()) < 5.0


@pytest.mark.slow
def test_a_dead_zone_between_two_rates_is_seen_by_its_law_alone() -> None:
    """No smooth part is as narrow: what is not looked for as a law would pass for noise."""
    rng = np.random.default_rng(5)
    sizes = np.array([0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 5.0, 20.0, 50.0, 100.0])
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 4)
    error = np.where(np.abs(rate) < 0.03, -rate, 0.0) + 1e-3 * rng.standard_normal(rate.size)
    temp = 25.0 + 0.02 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("low.csv"), rate, rate + error, temp, t_s=20.0 * np.arange(rate.size, dtype=np.float64)
    )
    found = examine(series_of_table(table), 0.01)
    (law,) = found.naming.named
    assert law.law.effect == "dead_zone"
    width = of_law(found.naming.fitted, law.law, found.laws, []).parameters["width_dps"]
    assert width.interval_95 == pytest.approx((0.02, 0.05), rel=0.01), "no rate between the two was visited"
    for _, candidate in found.candidates:
        assert [law.effect for law in candidate.fitted.model.laws] == ["dead_zone"]


@pytest.mark.slow
def test_of_a_dead_zone_below_the_least_rate_no_more_is_known() -> None:
    rng = np.random.default_rng(6)
    sizes = np.array([0.5, 1.0, 2.0, 5.0, 20.0, 50.0, 100.0])
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0] * 3, sizes]), 6)
    error = np.where(rate == 0.0, -5e-3, 0.0) + 3e-4 * rng.standard_normal(rate.size)
    temp = 25.0 + 0.02 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("rest.csv"), rate, rate + error, temp, t_s=20.0 * np.arange(rate.size, dtype=np.float64)
    )
    found = diagnose(table, options=Options(heldout=False))
    (effect,) = found.effects
    low, high = effect.parameters["width_dps"].interval_95
    assert low < 1e-3
    assert high == pytest.approx(0.5, rel=0.01)


@pytest.mark.slow
def test_the_file_of_a_table_has_the_law_where_the_law_says_more_than_smooth_parts() -> None:
    """Between nine rates nothing but the law of a knee knows where it is."""
    rng = np.random.default_rng(5)
    sizes = np.linspace(0.0, 100.0, 9)
    rate = np.tile(np.r_[-sizes[::-1], sizes], 6)
    error = -0.02 * np.sign(rate) * np.maximum(np.abs(rate) - 70.0, 0.0) + 1e-3 * rng.standard_normal(
        rate.size
    )
    temp = 25.0 + 0.02 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("knee.csv"), rate, rate + error, temp, t_s=20.0 * np.arange(rate.size, dtype=np.float64)
    )
    found = examine(series_of_table(table), 0.01)
    assert found.candidates
    for _, candidate in found.candidates:
        assert [law.effect for law in candidate.fitted.model.laws] == ["saturation"]
    # It pays for what it was chosen from, and is the better for all that.
    gained = found.ranked[0].fitted.nll - candidate.fitted.nll
    assert 0.0 < found.ranked[0].score - candidate.score < gained - TOLL_NATS


def test_an_error_of_each_rate_has_no_law_that_would_be_in_no_file() -> None:
    assert all(effect.runtime for effect in effects_of("each rate"))
    assert any(not effect.runtime for block in BLOCKS for effect in effects_of(block))


@pytest.mark.parametrize(("width_dps", "at_one"), [(0.2, True), (6.0, False)])
def test_a_peak_that_one_size_of_rate_shows_alone_is_no_peak(width_dps: float, at_one: bool) -> None:
    """A real table had one at 3 deg/s for what its readings at 3.6 deg/s, either way, were off by."""
    rate = np.tile(np.arange(-36.0, 37.0, 3.6), 4)
    times: NDArray[np.float64] = 30.0 * np.arange(rate.size, dtype=np.float64)
    table = DataSetTable(Path("t.csv"), rate, rate.copy(), np.full(rate.size, 20.0), t_s=times)
    means = means_of(series_of_table(table))
    shape = {"center_dps": 3.5, "width_dps": width_dps, "form": 1.0, "scatter": 0.0, "seed": 0.0}
    laws = laws_of(means, Surface(np.zeros((4, 3)), 0.0, 36.0, 20.0, 1.0))
    peak = Law("mechanical_resonance", shape, laws.at(CATALOGUE["mechanical_resonance"], shape))
    assert _at_one_size(peak, means) == at_one
    assert not _at_one_size(replace(peak, effect="rate_order"), means)


def test_a_ripple_over_temperature_is_of_a_higher_order_that_it_hardly_resembles() -> None:
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)
    found = naming_of(2e-3 * np.sin(temp / 1.6), 2)
    (law,) = found.named
    assert law.law.effect == "temperature_order"
    assert law.share < 0.5
    assert "temperature" in found.unnamed
    assert not found.fitted.model.holds(law.law)


def test_what_swallows_small_rates_has_one_name() -> None:
    def named(effect: str, gain: float) -> Named:
        return Named(Law(effect, {}, np.zeros((1, 1))), "odd rate", gain, 1.0, {}, 1)

    dead, cut, other = named("dead_zone", 40.0), named("truncation", 50.0), named("shupe", 9.0)
    assert _mechanisms([cut, dead, other]) == [cut, other]
    assert _mechanisms([cut, dead, other, named("dead_zone", 20.0)])[0] is dead
    assert _mechanisms([dead]) == [dead]


def test_orders_of_the_rate_have_a_name_beside_a_law_that_is_worth_less() -> None:
    """They are the misfit of a stronger law; of a weaker one they cannot be."""

    def named(effect: str, gain: float) -> Named:
        return Named(Law(effect, {}, np.zeros((1, 1))), "odd rate", gain, 1.0, {}, 1)

    peak = named("mechanical_resonance", 90.0)
    assert _mechanisms([named("rate_order", 40.0), peak]) == [peak]
    orders = named("rate_order", 200.0)
    assert _mechanisms([orders, peak]) == [orders, peak]
    assert _mechanisms([orders]) == [orders]
    # What differs between left and right bends nothing that is odd in the rate.
    sides = replace(named("scale_asymmetry", 900.0), block="even rate")
    assert _mechanisms([sides, orders]) == [sides, orders]
    assert _mechanisms([replace(sides, block=EACH_RATE), orders]) == [replace(sides, block=EACH_RATE)]
    # A sine about a bias has even orders, too.
    sine = named("sagnac_sine", 900.0)
    assert _mechanisms([sine, replace(orders, block="even rate")]) == [sine]


def test_one_of_two_laws_of_an_effect_needs_no_name_of_its_own() -> None:
    """A bias that settles with two time constants had lost the longer one to a walk, and its file."""

    def named(effect: str, gain: float) -> Named:
        return Named(Law(effect, {}, np.zeros((1, 1))), "warm-up", gain, 1.0, {}, 12)

    first, second, other = named("warm_up", 60.0), named("warm_up", 5.0), named("thermal_lag", 5.0)
    assert _least_worth(second, [first, second]) < 5.0 < _least_worth(other, [first, other])
    assert _least_worth(first, [first, other]) > 5.0


@pytest.mark.slow
def test_the_share_of_an_open_loop_is_near_one_where_the_record_does_not_tell() -> None:
    """Beyond a cubic its phase and its share are traded: 5e-4 of the sine at three radians would do as well."""
    rng = np.random.default_rng(2)
    rate = np.tile(np.linspace(-100.0, 100.0, 21), 8)
    k = 0.45 / 100.0
    error = np.sin(k * rate) / k - rate + 1e-3 * rng.standard_normal(rate.size)
    temp = 25.0 + 0.02 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("open.csv"), rate, rate + error, temp, t_s=20.0 * np.arange(rate.size, dtype=np.float64)
    )
    found = examine(series_of_table(table), 0.01)
    (law,) = [n.law for n in found.naming.named if n.law.effect == "sagnac_sine"]
    assert law.shape["phase_rad_per_dps"] == pytest.approx(k, rel=0.3)
    estimates = of_law(found.naming.fitted, law, found.laws, []).parameters
    low, high = estimates["amplitude"].interval_95
    assert low < 1.0 < high
    low, high = estimates["phase_rad_per_dps"].interval_95
    assert low < k < high


@pytest.mark.slow
def test_what_laws_of_time_and_memory_explain_is_no_shape_in_temperature() -> None:
    """Soaks that come once, beside a slow step and a drift: a hysteresis without corners may be a shape in temperature."""
    rng = np.random.default_rng(2)
    rates = np.array([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0])
    soaks = [-5.0, 6.0, 17.0, 28.0, 39.0, 50.0, 28.0, 6.0]
    state, states, before = 0.0, [], soaks[0]
    for soak in soaks:
        way = np.linspace(before, soak, 50)
        for t, step in zip(way[:-1], np.diff(way), strict=True):
            state += 0.1 * abs(step) * (np.tanh((t - 20.0) / 18.0) - state)
        states.append(state)
        before = soak
    temp, rate = np.repeat(soaks, rates.size), np.tile(rates, len(soaks))
    t_s = 30.0 * np.arange(rate.size, dtype=np.float64)
    error = 0.02 + 3e-5 * rate + 4e-3 * (temp - 20.0) / 30.0 + 3e-3 * np.repeat(states, rates.size)
    error += 4e-4 * rate * t_s / t_s[-1] + 4e-3 / (1.0 + np.exp(-(t_s - 0.45 * t_s[-1]) / 90.0))
    error += 3e-4 * rng.standard_normal(rate.size)
    temp += 0.05 * rng.standard_normal(rate.size)
    found = examine(series_of_table(DataSetTable(Path("soaks.csv"), rate, rate + error, temp, t_s=t_s)), 0.01)
    assert "temperature_order" not in {n.law.effect for n in found.naming.named}
    assert found.naming.unnamed["temperature"] > ALIKE_NATS, "it is modelled all the same"


def test_a_pair_of_laws_leaves_those_of_other_blocks_as_they_are_named() -> None:
    """A law whose shape went on beside a later pair was in the model without its name, and its name without the law."""
    rng = np.random.default_rng(4)
    temp = 25.0 + 12.0 * np.sin(_T_S / 1500.0)
    plays = [played(temp, width_c) for width_c in (1.5, 7.0)]
    added = 2e-3 * plays[0] + 2e-3 * plays[1] + 20e-3 * np.exp(-_T_S / 420.0)
    gyro = 0.01 + added + _NOISE_DPS * rng.standard_normal(_SETS)
    table = DataSetTable(Path("rest.csv"), np.zeros(_SETS), gyro, temp, t_s=_T_S)
    full = full_model(means_of(series_of_table(table)))
    fitted = fit_anyhow(full)
    laws = laws_of(full.means, surface_of(fitted.model, fitted.solve()))
    coarse = {"tau_s": 450.0}
    warm_up = Law("warm_up", coarse, laws.at(CATALOGUE["warm_up"], coarse))
    fitted = fitted.refit(fitted.model.without(["warm-up"]).with_laws(warm_up))
    without = less(fitted, "memory")
    trials = [t for e in effects_of("memory") for t in laws.trials(e) if e.id == "thermal_hysteresis"]
    first = best_law(fitted, without, "memory", trials, laws)
    assert first is not None
    one = Alone(first.fitted, [Named(first.law, "memory", without.nll - first.fitted.nll, 0.0, {}, 1)], {})
    found = _paired(fitted, without, "memory", trials, laws, one)
    assert [n.law.effect for n in found.named] == ["thermal_hysteresis"] * 2
    assert [law.name for law in found.fitted.model.laws] == [warm_up.name, *(n.law.name for n in found.named)]


def played(temp_c: NDArray[np.float64], width_c: float) -> NDArray[np.float64]:
    """Play of a half width."""
    at = np.empty(temp_c.size)
    at[0] = temp_c[0]
    for k in range(1, temp_c.size):
        at[k] = min(max(at[k - 1], temp_c[k] - width_c), temp_c[k] + width_c)
    return at


def test_of_two_blocks_that_hide_each_other_the_stronger_has_what_both_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Odd shapes of 8 mdeg/s and errors of each rate were worth 4 and 3 nats each, and "nothing stood out"."""
    each = {("both", EACH_RATE): (3.0, "odd alone"), ("odd alone", ODD): (230.0, "neither")}
    monkeypatch.setattr(blocks, "evidence", lambda fitted, block, laws: each[fitted, block])
    hidden = {ODD: 4.0, EACH_RATE: 3.0, "warm-up": 20.0}
    assert blocks._of_both(cast(Fitted, "both"), hidden, None) == {**hidden, ODD: 233.0}
    told = {ODD: 80.0, EACH_RATE: 3.0}
    assert blocks._of_both(cast(Fitted, "both"), told, None) == told


def test_of_several_laws_in_place_of_smooth_parts_each_but_one_pays() -> None:
    law = Law("bias_step", {"at_s": 10.0}, np.ones((4, 1)))
    jump = Named(law, "", 20.0, 1.0, {}, 100)
    paid = TOLL_NATS + 0.5 * np.log(100.0)
    assert [may_lose([jump] * n) for n in (1, 3)] == pytest.approx(
        [REPLACED + 1.0, REPLACED + 1.0 - 2.0 * paid]
    )
