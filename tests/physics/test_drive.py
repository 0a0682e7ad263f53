"""Effects on the robot: metadata, laws worked out by hand, any split alike."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal.errors import DataError, InputError
from gyrocal.physics.drive import (
    DRIVE_CATALOGUE,
    DriveChange,
    DriveConditions,
    DriveEffect,
)
from gyrocal.physics.effect import Floats
from gyrocal.physics.slip import slip_shape

SHARED = Path(__file__).parents[2].parent / "shared"
COORDINATES = {"turn_rate", "curvature", "speed", "acceleration", "heading", "wheel_angle", "delay", "time"}
FAMILIES = {"wheel slip", "wheel geometry", "gyro", "timing", "encoding"}
SEPARATION_M = 0.5


def drive(n: int = 400, seed: int = 0) -> DriveConditions:
    rng = np.random.default_rng(seed)
    dt = rng.choice([0.0, 0.05, 0.1, 0.3], n)
    gyro = 40 * np.sin(np.cumsum(dt))
    speed = np.maximum(np.cumsum(rng.normal(0, 0.3, n)), 0)
    half = 0.5 * SEPARATION_M * np.deg2rad(gyro) * dt
    temp = 20 + np.cumsum(rng.normal(0, 0.05, n))
    temp[::7] = np.nan
    return DriveConditions(
        np.cumsum(dt), dt, speed * dt - half, speed * dt + half, gyro, SEPARATION_M, temp_c=temp
    )


def arrays(change: DriveChange) -> Floats:
    return np.stack([change.encoder_yaw_rad, change.gyro_yaw_rad, change.distance_m])


def whole(effect: DriveEffect, c: DriveConditions, **p: float) -> DriveChange:
    return effect.change(c, effect.complete(p), None)[0]


def wheels_m(change: DriveChange, wheel_separation_m: float) -> tuple[Floats, Floats]:
    """A change as those of the left and right wheel's distance, m."""
    half = 0.5 * wheel_separation_m * change.encoder_yaw_rad
    return change.distance_m - half, change.distance_m + half


@pytest.mark.parametrize("effect", DRIVE_CATALOGUE.values(), ids=list(DRIVE_CATALOGUE))
@settings(max_examples=15)
@given(cuts=st.lists(st.integers(0, 60), max_size=10), seed=st.integers(0, 1000))
def test_any_split_gives_the_same_numbers(effect: DriveEffect, cuts: list[int], seed: int) -> None:
    c = drive(60, seed)
    parts, memory = [], None
    for start, stop in pairwise([0, *sorted(cuts), len(c)]):
        change, memory = effect.change(c.cut(slice(start, stop)), effect.typical(), memory)
        parts.append(arrays(change))
    np.testing.assert_allclose(
        np.concatenate(parts, axis=1), arrays(whole(effect, c)), rtol=1e-10, atol=1e-14
    )


@pytest.mark.parametrize("effect", DRIVE_CATALOGUE.values(), ids=list(DRIVE_CATALOGUE))
def test_every_effect_is_described_and_does_something(effect: DriveEffect) -> None:
    assert effect.family in FAMILIES
    assert effect.seen_in in COORDINATES
    assert set(effect.looks_like) <= set(DRIVE_CATALOGUE) - {effect.id}
    assert set(effect.needs) <= set(DriveConditions.__dataclass_fields__)
    assert effect.statement.endswith(".")
    assert effect.parameters[0].name == "amplitude"
    assert all(p.low <= p.typical <= p.high for p in effect.parameters)
    assert np.nanmax(np.abs(arrays(whole(effect, drive(4000))))) > 1e-6
    if effect.parameters[0].linear:
        one, two = (arrays(whole(effect, drive(), amplitude=a)) for a in (0.4, 0.8))
        np.testing.assert_allclose(two, 2 * one, rtol=1e-12)


def test_ids_are_those_of_the_robot_table() -> None:
    source = SHARED / "physics.md"
    if not source.exists():
        pytest.skip("../shared is absent")
    robot = source.read_text(encoding="utf-8").split("## On the robot")[1].split("**Families**")[0]
    rows = [line.split("|")[1] for line in robot.splitlines() if line.startswith("| `")]
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} == set(DRIVE_CATALOGUE)


def test_laws_by_hand() -> None:
    # 1 m/s straight on and 30 deg/s: one second a row.
    turn = np.deg2rad(30.0)
    c = DriveConditions(
        np.array([1.0]), np.array([1.0]), np.array([1 - turn / 4]), np.array([1 + turn / 4]), np.array([30.0]), 0.5
    )  # fmt: skip

    def change(effect_id: str, **p: float) -> list[float]:
        return [float(x) for x in arrays(whole(DRIVE_CATALOGUE[effect_id], c, **p))[:, 0]]

    assert c.encoder_yaw_rad[0] == pytest.approx(turn)
    assert c.gyro_yaw_rad[0] == pytest.approx(turn)
    assert change("skid_slip", amplitude=10.0) == pytest.approx([0.1 * turn, 0, 0])
    assert change("wheel_scale", amplitude=1.0) == pytest.approx([0.01 * turn, 0, 0.01])
    assert change("wheel_asymmetry", amplitude=1.0) == pytest.approx([0.01 * 1.0 / 0.5, 0, 0.0025 * turn / 2])
    assert change("gyro_scale", amplitude=1e4) == pytest.approx([0, 0.01 * turn, 0])
    assert change("gyro_bias", amplitude=3.0) == pytest.approx([0, np.deg2rad(3e-3), 0])
    assert change("robot_tilt", amplitude=60.0) == pytest.approx([0, -0.5 * turn, 0])
    assert change("unit_or_sign", amplitude=-1.0) == pytest.approx([0, -2 * turn, 0])
    assert change("dropped_samples", amplitude=100.0) == pytest.approx([0, -turn, 0])


@pytest.mark.parametrize(
    ("law", "shape", "expected"),
    [
        ("turn_rate", 1.0, [2.0, 0.5, 0.0]),
        ("turn_rate", 0.0, [1.0, 1.0, 1.0]),
        # Half the separation over the radius: 0.25 m over 0.9549 m, on the spot (cut off at 3), at rest.
        ("curvature", 0.0, [0.2617994, 3.0, 0.0]),
        ("curvature_saturating", 0.2617994, [0.5, 1.0, 0.0]),
    ],
)
def test_slip_laws_by_hand(law: str, shape: float, expected: list[float]) -> None:
    turn_dps, speed_mps = np.array([-60.0, 15.0, 0.0]), np.array([1.0, 0.0, 0.0])
    assert slip_shape(law, turn_dps, speed_mps, 0.5, shape) == pytest.approx(expected, rel=1e-6)


def test_unknown_slip_laws_are_refused() -> None:
    with pytest.raises(InputError, match="turn_rate, curvature, curvature_saturating"):
        slip_shape("ice", np.ones(1), np.ones(1), 0.5, 1.0)


def test_wheels_and_yaw_are_the_same_change() -> None:
    c = drive(50)
    change = whole(DRIVE_CATALOGUE["wheel_asymmetry"], c, amplitude=2.0)
    left, right = wheels_m(change, SEPARATION_M)
    np.testing.assert_allclose(left, -0.01 * c.left_m, atol=1e-15)
    np.testing.assert_allclose(right, 0.01 * c.right_m, atol=1e-15)


def test_delay_shifts_the_rate() -> None:
    t = 0.05 * np.arange(400, dtype=np.float64)
    rate = 30 * np.sin(t)
    c = DriveConditions(t, np.full(t.size, 0.05), np.zeros(t.size), np.zeros(t.size), rate, 0.5)
    change = whole(DRIVE_CATALOGUE["gyro_delay"], c, amplitude=0.1)
    logged = rate + np.rad2deg(change.gyro_yaw_rad) / 0.05
    np.testing.assert_allclose(logged[2:], rate[:-2], atol=1e-10)


def test_overcount_never_takes_away_and_has_the_stated_mean() -> None:
    n = 20_000
    step = np.full(n, 0.01)
    c = DriveConditions(0.1 * np.arange(n, dtype=np.float64), np.full(n, 0.1), step, -step, np.zeros(n), 0.5)
    left, right = wheels_m(whole(DRIVE_CATALOGUE["encoder_overcount"], c, amplitude=2.0), 0.5)
    # An exponential draw has its mean as standard deviation; 4.9 sigma is a false-alarm rate of 1e-6.
    for wheel in (left, right):
        assert wheel.min() >= 0
        assert abs(wheel.mean() / 2e-4 - 1) < 4.9 / np.sqrt(n)


def test_ticks_lose_nothing_in_the_long_run() -> None:
    c = drive(400)
    left, right = wheels_m(whole(DRIVE_CATALOGUE["encoder_quantisation"], c, amplitude=7.0), SEPARATION_M)
    for change, wheel in ((left, c.left_m), (right, c.right_m)):
        counted = np.cumsum(wheel + change)
        np.testing.assert_allclose(counted / 7e-3, np.rint(counted / 7e-3), atol=1e-8)
        assert np.all(np.abs(counted - np.cumsum(wheel)) <= 7e-3 + 1e-12)


def test_eccentric_wheel_comes_back_after_a_turn() -> None:
    turn_m = 2 * np.pi * 0.1
    step = np.full(100, turn_m / 100)
    c = DriveConditions(np.arange(100, dtype=np.float64), np.ones(100), step, step, np.zeros(100), 0.5)
    left, right = wheels_m(whole(DRIVE_CATALOGUE["wheel_eccentricity"], c, amplitude=1.0), 0.5)
    assert np.abs(left).max() < 1e-15
    assert right[0] == pytest.approx(0.01 * step[0], rel=1e-2)
    assert abs(right.sum()) < 1e-12


def test_wheels_spin_in_proportion_to_how_the_speed_grows_and_not_as_they_brake() -> None:
    speed = np.array([0.0, 0.05, 0.5, 0.5, 0.0, -0.5])
    step = 0.1 * speed
    t = 0.1 * np.arange(6, dtype=np.float64)
    c = DriveConditions(t, np.full(6, 0.1), 0.9 * step, 1.1 * step, np.zeros(6), 0.5)
    change = whole(DRIVE_CATALOGUE["start_stop_slip"], c, amplitude=0.1)
    np.testing.assert_allclose(change.distance_m, step * [0, 0.05, 0.45, 0, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(change.encoder_yaw_rad, 0.4 * change.distance_m, atol=1e-12)


def test_jitter_cancels_over_the_log() -> None:
    n = 5000
    c = DriveConditions(
        0.1 * np.arange(n, dtype=np.float64), np.full(n, 0.1), np.zeros(n), np.zeros(n), np.full(n, 50.0), 0.5
    )
    change = whole(DRIVE_CATALOGUE["timestamp_jitter"], c, amplitude=2.0).gyro_yaw_rad
    assert abs(change.sum()) < 6 * 2e-3 * np.deg2rad(50)
    sigma = np.sqrt(2) * 2e-3 * np.deg2rad(50)
    # Neighbours share a draw, which doubles the variance of the variance's estimate at most.
    assert abs(change.std() / sigma - 1) < 4.9 * np.sqrt(2 / (2 * n))


def test_refusals() -> None:
    c = drive(5)
    bare = DriveConditions(c.t_s, c.dt_s, c.left_m, c.right_m, c.gyro_dps, 0.5)
    with pytest.raises(DataError, match="bias_temperature depends on temp_c"):
        whole(DRIVE_CATALOGUE["bias_temperature"], bare)
