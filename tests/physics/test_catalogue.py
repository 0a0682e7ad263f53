"""The catalogue against physics.md, and the law that every split of a record gives the same numbers."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal.errors import DataError, InputError
from gyrocal.physics.catalogue import CATALOGUE, find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import FAMILIES, Effect, Floats
from gyrocal.physics.surface import Surface

SHARED = Path(__file__).parents[2].parent / "shared"
COORDINATES = {
    "rate", "temperature", "temperature_rate", "temperature_branch", "time", "time_since_power_on", "table_angle",
    "time_since_step", "supply", "acceleration", "data_set_index",
}  # fmt: skip
SURFACE = Surface(
    np.array(
        [[0.05, -0.02, 0.01], [0.4, 0.3, -0.1], [0.02, 0.01, 0.0], [-0.3, 0.05, 0.02]],
    ),
    0.0,
    100.0,
    20.0,
    30.0,
)


def conditions(n: int = 60, seed: int = 1) -> Conditions:
    rng = np.random.default_rng(seed)
    t_s = 100.0 + np.cumsum(rng.choice([0.0, 0.1, 1.0, 90.0], n))
    rate = rng.choice([-100.0, -40.0, -0.004, 0.0, 0.02, 60.0, 100.0], n)
    temp = 20.0 + np.cumsum(rng.normal(0.0, 2.0, n))
    temp[rng.random(n) < 0.1] = np.nan
    return Conditions(
        t_s=t_s,
        rate_dps=rate,
        temp_c=temp,
        dt_s=0.1,
        angle_deg=np.cumsum(rate),
        supply_v=12.0 + rng.normal(0, 0.1, n),
        since_power_on_s=t_s - 40.0,
        since_step_s=rng.uniform(0, 20.0, n),
        step_dps=rng.normal(0, 30.0, n),
        gyro_dps=rate + rng.normal(0, 0.01, n),
        data_set_index=np.floor(np.arange(n) / 10.0),
    )


def whole(effect: Effect, c: Conditions, **given_p: float) -> Floats:
    return effect.error_dps(c, effect.complete(given_p), SURFACE, None)[0]


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
@settings(max_examples=15)
@given(cuts=st.lists(st.integers(0, 60), max_size=12), seed=st.integers(0, 1000))
def test_any_split_gives_the_same_numbers(effect: Effect, cuts: list[int], seed: int) -> None:
    c = conditions(seed=seed)
    parts, memory = [], None
    for start, stop in pairwise([0, *sorted(cuts), len(c)]):
        error, memory = effect.error_dps(c.cut(slice(start, stop)), effect.typical(), SURFACE, memory)
        parts.append(error)
    np.testing.assert_allclose(np.concatenate(parts), whole(effect, c), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_every_effect_is_described_and_does_something(effect: Effect) -> None:
    assert effect.family in FAMILIES
    assert effect.seen_in in COORDINATES
    assert set(effect.looks_like) <= set(CATALOGUE) - {effect.id}
    assert set(effect.needs) <= set(Conditions.__dataclass_fields__)
    assert effect.statement.endswith(".")
    assert effect.equation
    assert effect.reference
    names = [p.name for p in effect.parameters]
    assert names[0] == "amplitude"
    assert len(set(names)) == len(names)
    for p in effect.parameters:
        assert p.low <= p.typical <= p.high, p
        assert p.linear == (p.name == "amplitude" and effect.id != "quantisation")
    error = whole(effect, conditions(600), **({"share": 0.5} if effect.id == "bursts" else {}))
    assert np.nanmax(np.abs(error)) > 1e-6


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_the_error_is_proportional_to_its_linear_parameter(effect: Effect) -> None:
    if not effect.parameters[0].linear:
        pytest.skip("rounding is not proportional to its step")
    c = conditions()
    c = Conditions(**{**vars(c), "gyro_dps": None})
    one, two = (whole(effect, c, amplitude=a) for a in (0.4, 0.8))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-12)
    assert np.nanmax(np.abs(whole(effect, c, amplitude=0.0))) == 0.0


def test_missing_channels_and_surface_are_named() -> None:
    bare = Conditions(np.zeros(2), np.zeros(2), np.full(2, 20.0))
    for effect in CATALOGUE.values():
        # A supply that nobody reads is the usual one.
        optional = [n for n in effect.needs if n not in ("t_s", "rate_dps", "temp_c", "supply_v")]
        if optional:
            with pytest.raises(DataError, match=optional[0]):
                effect.error_dps(bare, effect.typical(), SURFACE, None)
    for effect_id in ("thermal_lag", "fit_direction"):
        with pytest.raises(DataError, match="acts through the error surface"):
            find_effect(effect_id).error_dps(bare, find_effect(effect_id).typical(), None, None)


def test_unknown_id_name_and_value_are_refused() -> None:
    with pytest.raises(InputError, match=r"no effect 'shup' .*Known: .*shupe_gradient"):
        find_effect("shup")
    with pytest.raises(InputError, match=r"warm_up has no parameter 'tau'; it has amplitude, tau_s"):
        find_effect("warm_up").complete({"tau": 3.0})
    with pytest.raises(InputError, match=r"warm_up: tau_s is 1 s; allowed is 60 to 7200"):
        find_effect("warm_up").complete({"tau_s": 1.0})
    with pytest.raises(InputError, match="nan"):
        find_effect("warm_up").complete({"tau_s": float("nan")})


def test_ids_are_those_of_the_bench_table() -> None:
    source = SHARED / "physics.md"
    if not source.exists():
        pytest.skip("../shared is absent")
    bench = source.read_text(encoding="utf-8").split("## On the bench")[1].split("## On the robot")[0]
    rows = [line.split("|")[1] for line in bench.splitlines() if line.startswith("| `")]
    ids = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    # Heat of past turns has a name beyond that table.
    assert ids | {"rate_heating"} == set(CATALOGUE)


@pytest.mark.parametrize("effect", ["table_eccentricity", "rate_order", "temperature_order"])
def test_what_is_counted_is_a_whole_number(effect: str) -> None:
    name = "harmonic" if effect == "table_eccentricity" else "order"
    assert find_effect(effect).complete({name: 5.0})[name] == 5.0
    with pytest.raises(InputError, match=rf"{effect}: {name} is 4.5; a whole number is wanted"):
        find_effect(effect).complete({name: 4.5})
