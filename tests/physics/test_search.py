"""What an effect's object says of itself: shapes, columns, needs, twins, draws, folds, C."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.physics.c_text import CMemory
from gyrocal.physics.catalogue import CATALOGUE, find_effect, law_of, twins_of
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect
from gyrocal.physics.fold import BY_COORDINATE
from gyrocal.physics.lacking import Lack, Why
from gyrocal.physics.offer import Offer, turned_back_c
from tests.physics.test_catalogue import SURFACE, conditions

EFFECTS = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))

#: A run of a day at eleven rates through sixty degrees, of which everything is logged.
WHOLE = Offer(
    t_s=(0.0, 86400.0),
    rates_dps=np.linspace(-100.0, 100.0, 11),
    largest_rate_dps=100.0,
    temp_c=(-10.0, 50.0),
    temp_span_c=61.0,
    temp_back_c=61.0,
    turn_starts_s=np.arange(1000.0, 80000.0, 1000.0),
    since_power_on_s=30.0,
    channels=frozenset(Conditions.__dataclass_fields__),
    lacking={},
)
#: The same at rest and at one temperature.
STILL = replace(
    WHOLE, rates_dps=np.zeros(1), largest_rate_dps=0.0, temp_c=(20.0, 20.0), temp_span_c=0.0, temp_back_c=0.0, turn_starts_s=np.empty(0),
)  # fmt: skip


def known() -> Conditions:
    """Rows with everything a law may depend on, and no gaps."""
    c = conditions(200)
    return replace(c, temp_c=np.nan_to_num(c.temp_c, nan=20.0), gyro_dps=None)


@EFFECTS
def test_every_shape_of_a_grid_is_one_that_the_law_allows(effect: Effect) -> None:
    shapes = effect.search.grid(WHOLE)
    assert shapes
    known_names = {p.name for p in effect.parameters}
    for shape in shapes:
        effect.complete({name: value for name, value in shape.items() if name in known_names})
        assert np.isfinite(effect.columns(known(), shape, SURFACE)).all()


@EFFECTS
def test_an_effect_is_linear_in_its_columns(effect: Effect) -> None:
    if effect.search.draws or not effect.search.by_columns:
        pytest.skip("found by its draws, or by a test of its own")
    c = known()
    shape = effect.search.grid(WHOLE)[-1]
    columns = effect.columns(c, shape, SURFACE)
    if "order_2" in shape:
        amplitudes, whole = np.ones(2), sum(
            effect.unit_dps(c, {**shape, "order": shape[name]}, SURFACE) for name in ("order", "order_2")
        )  # fmt: skip
    elif "rate_scale_dps" in shape:
        # On the bias, and on the scale factor beside it.
        amplitudes = np.array([1.0, 0.5])
        whole = effect.unit_dps(c, shape, SURFACE) * (1.0 + 0.5 * c.rate_dps / shape["rate_scale_dps"])
    elif columns.shape[1] == 2:
        # Cosine and sine of half a radian turn the phase by as much.
        amplitudes = np.array([np.cos(0.5), -np.sin(0.5)])
        whole = effect.unit_dps(c, {**shape, "phase_rad": 0.5}, SURFACE)
    else:
        amplitudes, whole = np.ones(1), effect.unit_dps(c, shape, SURFACE)
    np.testing.assert_allclose(columns @ amplitudes, whole, atol=1e-12)


@EFFECTS
def test_a_whole_record_shows_every_effect_and_a_still_one_few(effect: Effect) -> None:
    assert effect.why_not(WHOLE) is None
    seen = effect.why_not(STILL) is None
    in_rate_or_temperature = effect.family in ("rate shape", "thermal transient", "angle, constant")
    if in_rate_or_temperature and not effect.search.draws:
        assert not seen
    without = replace(WHOLE, channels=WHOLE.channels - set(effect.needs))
    assert effect.why_not(without) is not None


def test_a_lacking_coordinate_says_why() -> None:
    dark = replace(WHOLE, lacking={"table_angle": "nobody looked", "time_since_power_on": "nobody knows"})
    assert find_effect("magnetic").why_not(dark) == "nobody looked"
    assert find_effect("warm_up").why_not(dark) is None
    late = find_effect("warm_up").why_not(replace(WHOLE, since_power_on_s=6000.0))
    assert late == Lack(Why.LATE, {"hours": 1.5})


def test_twins_are_looked_for_as_the_first_of_them() -> None:
    assert twins_of("earth_rate_tilt") == ("magnetic", "g_sensitivity")
    assert {law_of(e) for e in ("earth_rate_tilt", *twins_of("earth_rate_tilt"))} == {"earth_rate_tilt"}
    for effect in CATALOGUE.values():
        first = CATALOGUE[law_of(effect.id)]
        assert not first.search.twin_of
        shape = effect.search.grid(WHOLE)[0]
        np.testing.assert_array_equal(
            effect.columns(known(), shape, SURFACE), first.columns(known(), shape, SURFACE)
        )


@EFFECTS
def test_relations_name_effects_of_the_catalogue(effect: Effect) -> None:
    search = effect.search
    others = {*search.accounts_for, *search.told_apart}
    assert others <= set(CATALOGUE) - {effect.id}
    assert set(search.refined) <= {p.name for p in effect.parameters}


@EFFECTS
def test_a_draw_is_within_the_bounds(effect: Effect) -> None:
    drawn = [effect.hiding.draw(effect.typical(), WHOLE, np.random.default_rng(k)) for k in range(20)]
    for p in drawn:
        assert effect.complete(p) == p
    free = [p for p in effect.parameters if p.name in ("tau_s", "at_s", "phase_rad", "seed", "knee_dps")]
    for parameter in free:
        assert len({p[parameter.name] for p in drawn}) > 1


@EFFECTS
def test_rows_have_a_place_on_the_coordinate_of_an_effect(effect: Effect) -> None:
    assert effect.fold is not None or effect.seen_in in BY_COORDINATE
    c = replace(known(), temp_rate_c_per_s=np.linspace(-0.01, 0.01, 200))
    p = {**effect.typical(), **effect.hiding.draw(effect.typical(), WHOLE, np.random.default_rng(1))}
    axis = effect.fold_axis(c, p, effect.unit_dps(c, p, SURFACE))
    assert axis.x.shape == axis.gain.shape == (200,)
    assert np.isfinite(axis.x).sum() > 20


@EFFECTS
def test_what_a_robot_evaluates_has_its_law_as_c(effect: Effect) -> None:
    assert (effect.c_text is not None) == effect.runtime
    if effect.c_text is not None:
        law = effect.c_text.law(effect.typical(), repr, CMemory())
        assert all(f"PREFIX_{name.split('@')[0]}" in "".join(effect.c_text.helpers) for name in law.split("PREFIX_")[1:])  # fmt: skip


def test_an_unusual_shape_starts_with_less_evidence() -> None:
    search = find_effect("thermal_lag").search
    assert search.nats_before({"tau_s": np.sqrt(60.0 * 600.0)}) == pytest.approx(0.0)
    # At an end of what 95 % have, a normal density is exp(-1.96^2/2) of its middle.
    for end in (60.0, 600.0):
        assert search.nats_before({"tau_s": end}) == pytest.approx(-0.5 * 1.96**2, rel=1e-3)
    assert find_effect("shupe").search.nats_before({}) == 0.0


def test_an_output_that_is_cut_shows_its_steps_in_the_samples() -> None:
    assert find_effect("truncation").why_not(WHOLE) is None
    slow = replace(WHOLE, rates_dps=np.union1d(WHOLE.rates_dps, [-2.0, 2.0]), continuous=True)
    lack = find_effect("truncation").why_not(slow)
    assert isinstance(lack, Lack)
    assert lack.why is Why.CONTINUOUS
    assert find_effect("dead_zone").why_not(slow) is None


def test_without_slow_rates_a_dead_band_and_an_output_that_is_cut_are_the_same() -> None:
    fast = replace(WHOLE, continuous=True)
    assert find_effect("truncation").why_not(fast) is None
    band = [s for s in find_effect("dead_zone").search.grid(fast) if s["form"] == 3.0]
    rows = Conditions(t_s=np.arange(3.0), rate_dps=np.array([-20.0, 0.0, 100.0]), temp_c=np.full(3, 20.0))
    steps = [
        find_effect(e).unit_dps(rows, s, None)
        for e, s in [("dead_zone", band[0]), ("truncation", {"of_output": 0.0})]
    ]
    np.testing.assert_allclose(steps[0], steps[1])


def test_a_dead_zone_takes_of_what_moves_and_gives_none() -> None:
    """What is lost at rest has the sign of what stood at the input."""
    zone = find_effect("dead_zone")
    assert [zone.positive({"width_dps": 0.1, "form": form}) for form in (0.0, 1.0, 2.0, 3.0)] == [False] + [
        True
    ] * 3
    assert not find_effect("truncation").positive({"of_output": 0.0})
    assert find_effect("sagnac_sine").positive({"phase_rad_per_dps": 0.004})


def test_a_cubic_leaves_over_what_no_slope_bias_square_or_cubic_can_take() -> None:
    assert WHOLE.left_by_cubic == (3, 4)
    assert replace(WHOLE, rates_dps=np.array([-50.0, 50.0])).left_by_cubic == (0, 0)


@pytest.mark.parametrize("name", ["saturation", "rate_order", "truncation", "sagnac_sine"])
def test_three_sizes_of_rate_have_nothing_left_to_check_an_odd_law_by(name: str) -> None:
    """Slope, cubic and any such law go through all three of them, and apart between them."""
    assert find_effect(name).why_not(WHOLE) is None
    three = replace(WHOLE, rates_dps=np.array([-100.0, -70.0, -40.0, 0.0, 40.0, 70.0, 100.0]))
    lack = find_effect(name).why_not(three)
    assert isinstance(lack, Lack)
    assert lack.why is Why.FEW_SIZES


def test_three_sizes_with_rest_have_nothing_left_to_check_an_even_law_by() -> None:
    """Bias, square and an asymmetry go through all three of them: errors of single rates would make one of any size."""
    assert find_effect("scale_asymmetry").why_not(WHOLE) is None
    three = replace(WHOLE, rates_dps=np.array([-100.0, -70.0, -30.0, 30.0, 70.0, 100.0]))
    lack = find_effect("scale_asymmetry").why_not(three)
    assert isinstance(lack, Lack)
    assert lack.why is Why.FEW_FOR_EVEN
    with_rest = replace(three, rates_dps=np.append(three.rates_dps, 0.0))
    assert find_effect("scale_asymmetry").why_not(with_rest) is None


def test_a_temperature_turns_back_by_what_it_both_rose_and_fell() -> None:
    assert turned_back_c(np.array([10.0, 20.0, 30.0])) == 0.0
    assert turned_back_c(np.array([30.0, 10.0])) == 0.0
    assert turned_back_c(np.array([20.0, 50.0, 5.0, 25.0])) == 30.0
    assert turned_back_c(np.array([20.0, 0.0, 15.0])) == 15.0


def test_a_hysteresis_needs_heating_and_cooling() -> None:
    one_way = replace(WHOLE, temp_back_c=0.3)
    lacks = [need(one_way) for need in CATALOGUE["thermal_hysteresis"].search.requires]
    assert [lack.why for lack in lacks if isinstance(lack, Lack)] == [Why.ONE_BRANCH]
    part = replace(WHOLE, temp_back_c=8.0)
    widths = [shape["width_c"] for shape in CATALOGUE["thermal_hysteresis"].search.grid(part)]
    assert 4.0 < max(widths) <= 8.0


def test_a_corner_that_is_soft_starts_as_low_as_an_order_of_the_rate() -> None:
    sides, orders = find_effect("scale_asymmetry").search, find_effect("rate_order").search
    assert sides.nats_before({"softness_dps": 0.0}) == 0.0
    assert sides.nats_before({"softness_dps": 5.0}) == orders.nats_before({"order": 4.0, "scale_dps": 100.0})
