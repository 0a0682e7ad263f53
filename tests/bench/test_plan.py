"""The plan: orders, durations, turns, and limits that are checked before anything moves."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.devices import ChamberLimits, TableLimits
from gyrocal.bench.plan import Plan, make_plan, narrowest, rates_at_visit, temperature_visits
from gyrocal.bench.profile import PlanSpec
from gyrocal.errors import LimitError
from tests.bench.tiny import tiny_profile

TABLE = TableLimits(400.0, 50.0)
CHAMBER = ChamberLimits(-70.0, 180.0, 5.0)


def plan(table: TableLimits = TABLE, chamber: ChamberLimits = CHAMBER, **changes: Any) -> Plan:
    """Plan of the tiny profile with these changes."""
    profile = tiny_profile(**changes)
    return make_plan(profile, narrowest(profile, table, chamber), 21.0)


@pytest.mark.parametrize(
    ("order", "visits"),
    [
        ("up", [1, 2, 3, 4]),
        ("down", [4, 3, 2, 1]),
        ("up_down", [1, 2, 3, 4, 3, 2, 1]),
        ("interleaved", [1, 3, 4, 2]),
        ("listed", [3, 1, 4, 2]),
    ],
)
def test_temperature_orders(order: str, visits: list[float]) -> None:
    spec = PlanSpec(temperatures_c=(3.0, 1.0, 4.0, 2.0), temperature_order=order)
    assert temperature_visits(spec) == visits


@pytest.mark.parametrize(
    ("order", "rates"),
    [
        ("up", [-5, -1, 1, 5]),
        ("down", [5, 1, -1, -5]),
        ("up_down", [-5, -1, 1, 5, 1, -1, -5]),
        ("listed", [-5, -1, 1, 5]),
    ],
)
def test_rate_orders_and_signs(order: str, rates: list[float]) -> None:
    spec = PlanSpec(temperatures_c=(20.0,), rates_dps=(1.0, 5.0), zero_first_and_last=False, rate_order=order)
    assert rates_at_visit(spec, 0) == rates
    spec = PlanSpec(temperatures_c=(20.0,), rates_dps=(0.0, 1.0, 5.0), rate_order=order)
    assert rates_at_visit(spec, 0) == [0, *rates, 0]


def test_shuffling_differs_between_visits_and_repeats_with_its_seed() -> None:
    spec = PlanSpec(temperatures_c=(20.0,), rates_dps=tuple(float(r) for r in range(1, 11)), seed=3)
    first, second = rates_at_visit(spec, 0), rates_at_visit(spec, 1)
    assert first != second
    assert sorted(first) == sorted(second)
    assert first == rates_at_visit(spec, 0)
    assert first[0] == first[-1] == 0.0


@given(
    st.lists(st.integers(-50, 70), min_size=1, max_size=9, unique=True),
    st.sampled_from(["up", "down", "up_down", "interleaved", "listed"]),
)
def test_every_temperature_is_visited(temperatures: list[int], order: str) -> None:
    spec = PlanSpec(temperatures_c=tuple(map(float, temperatures)), temperature_order=order)
    visits = temperature_visits(spec)
    assert set(visits) == set(map(float, temperatures))
    assert all(a != b for a, b in pairwise(visits))


def test_steps_of_the_tiny_plan() -> None:
    steps = [
        (s.id, s.kind, abs(s.rate_dps), s.chamber_c)
        for s in plan(plan__static_s=9.0, plan__static_at_c=[24.0]).steps
    ]
    assert steps == [
        (1, "ramp", 0, 20),
        (2, "soak", 0, 20),
        (3, "rate", 0, 20),
        (4, "rate", 30, 20),
        (5, "rate", 30, 20),
        (6, "rate", 0, 20),
        (7, "ramp", 0, 24),
        (8, "soak", 0, 24),
        (9, "static", 0, 24),
        (10, "rate", 0, 24),
        (11, "rate", 30, 24),
        (12, "rate", 30, 24),
        (13, "rate", 0, 24),
    ]  # fmt: skip


def test_durations_count_spin_hold_and_deadlines() -> None:
    steps = plan().steps
    # ramp of 1 degC at 5 degC/min, then 60 s of grace; hold 1 s, settle deadline 10 s
    assert steps[0].expected_s == pytest.approx(1.0 + 12.0)
    assert steps[0].latest_s == pytest.approx(10.0 + 12.0 + 60.0)
    assert steps[1].expected_s == pytest.approx(1.0 + 20.0)
    # from 0 to 30 deg/s at 50 deg/s^2
    assert steps[3].expected_s == pytest.approx(0.6 + 1.0 + 3.0)
    assert plan(soak__expected_s=50.0).steps[1].expected_s == pytest.approx(51.0)


def test_turns_in_each_direction() -> None:
    p = plan(plan__rate_order="up")
    one_way = 30.0 * 4.6 / 360.0
    ccw, cw = p.turns
    assert ccw == pytest.approx(2 * (30.0 * (1.2 + 4.0) / 360.0))
    assert cw == pytest.approx(2 * one_way)
    assert p.winding_turns == pytest.approx(one_way, rel=0.2)


def test_ramps_at_rates_cycle_and_their_soaks_keep_the_rate() -> None:
    p = plan(plan__ramp_rates_dps=[0.0, 60.0])
    assert [(s.kind, s.rate_dps) for s in p.steps if s.kind in ("ramp", "soak")] == [
        ("ramp", 0.0),
        ("soak", 0.0),
        ("ramp", 60.0),
        ("soak", 60.0),
    ]


LIMITS = [
    (
        {"plan__rates_dps": [120.0], "plan__rate_order": "up"},
        "The rate of -120 deg/s (step 4, rate at -120 deg/s, 20 °C) is below -100 deg/s, the limit of the gyro "
        "(sensor.rate_range_dps). Nothing has moved; change the plan or the limit.",
    ),
    (
        {"limits__max_rate_dps": 20.0, "plan__rate_order": "down"},
        "The rate of 30 deg/s (step 4, rate at +30 deg/s, 20 °C) is above 20 deg/s, the limit of the user "
        "(limits.max_rate_dps). Nothing has moved; change the plan or the limit.",
    ),
    (
        {"limits__min_temp_c": 21.0},
        "The temperature of 20 °C (step 1, ramp 21 to 20 °C) is below 21 °C, the limit of the user "
        "(limits.min_temp_c). Nothing has moved; change the plan or the limit.",
    ),
    (
        {"sensor__temp_range_c": [0.0, 22.0]},
        "The temperature of 24 °C (step 7, ramp 20 to 24 °C) is above 22 °C, the limit of the gyro "
        "(sensor.temp_range_c). Nothing has moved; change the plan or the limit.",
    ),
    (
        {"safe__chamber_c": 80.0},
        "The temperature of 80 °C (safe.chamber_c) is above 75 °C, the limit of the gyro (sensor.temp_range_c). "
        "Nothing has moved; change the plan or the limit.",
    ),
    (
        {"ramp__rate_c_per_min": 6.0},
        "The ramp of 6 °C/min (ramp.rate_c_per_min) is above 5 °C/min, the limit of the chamber. Nothing has moved; "
        "change the plan or the limit.",
    ),
    (
        {"limits__max_turns": 0.2},
        "The winding of 0.383333 turns (all steps) is above 0.2 turns, the limit of the user (limits.max_turns). "
        "Nothing has moved; change the plan or the limit.",
    ),
]


def test_all_limits_that_a_plan_exceeds_are_told_at_once() -> None:
    with pytest.raises(LimitError) as caught:
        plan(plan__rates_dps=[120.0], plan__temperatures_c=[20.0, 90.0], ramp__rate_c_per_min=6.0)
    lines = str(caught.value).splitlines()
    assert [line.split(" of ")[0] for line in lines] == ["The rate", "The temperature", "The ramp"]
    assert str(caught.value).count("Nothing has moved") == 1


@pytest.mark.parametrize(("changes", "sentence"), LIMITS)
def test_limits_name_the_value_the_limit_and_whose_it_is(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(LimitError) as caught:
        plan(**{"plan__rate_order": "up", **changes})
    assert str(caught.value) == sentence


def test_the_narrowest_limit_wins() -> None:
    with pytest.raises(LimitError, match=r"is below -25 deg/s, the limit of the table\."):
        plan(table=TableLimits(25.0, 50.0), limits__max_rate_dps=28.0, plan__rate_order="up")
    with pytest.raises(LimitError, match=r"is below 22 °C, the limit of the chamber\."):
        plan(chamber=ChamberLimits(22.0, 100.0, 5.0))


def test_plan_is_plain_data() -> None:
    data = plan().to_json()
    assert len(data["steps"]) == 12
    assert data["limits"]["max_turns"] is None
    assert data["limits"]["max_acceleration_dps2"] == {"value": 50.0, "whose": "the table"}
    assert data["expected_s"] == pytest.approx(sum(s["expected_s"] for s in data["steps"]))
