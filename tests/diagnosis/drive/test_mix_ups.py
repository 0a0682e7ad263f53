"""Columns that a new user mixes up are told, not explained by physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.errors import DataError
from gyrocal.records.robot import Robot, robot_of
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.world import SEPARATION_M, Hidden, simulate

Floats = NDArray[np.float64]


@pytest.fixture
def robot() -> Robot:
    return robot_of({"wheel_separation_m": SEPARATION_M, "static_s": 0.0}, Path("robot.toml"))


@pytest.mark.parametrize(
    "as_logged", [lambda way_m: np.cumsum(way_m), lambda way_m: 1e3 * way_m], ids=["totals", "millimetres"]
)
def test_a_way_that_no_robot_goes_is_refused(robot: Robot, as_logged: Callable[[Floats], Floats]) -> None:
    """Before: totals took ten gigabytes and came to no end."""
    log = simulate(Hidden(), 1)
    odd = replace(log, left_m=as_logged(log.left_m), right_m=as_logged(log.right_m))
    with pytest.raises(DataError, match="distances since the row before, in metres"):
        diagnose_drive("odd", odd, robot)


def test_a_speed_in_another_unit_is_no_wheel_twice_as_large(robot: Robot) -> None:
    """Before: km/h for m/s was a wheel scale of 108.33 ± 0.01 %, and the log explained."""
    log = simulate(Hidden(gps_m=0.3), 1)
    way_m = 3.6 * 0.5 * (log.left_m + log.right_m)
    odd = replace(log, left_m=way_m, right_m=way_m, speed_only=True)
    with pytest.raises(DataError, match=r"goes 0\.27\d times as far"):
        diagnose_drive("odd", odd, robot)


@pytest.mark.slow
def test_a_compass_is_no_scale_of_the_gyro() -> None:
    """Before: the gyro's scale was said to be 300.0 ± 0.1 % off."""
    log = drive(Plan("random", 4.0, 10.0, truth_m=0.02, truth_heading_deg=0.05), 3)
    standing = robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("robot.toml"))
    found = diagnose_drive("compass", replace(log, truth_heading_deg=90.0 - log.truth_heading_deg), standing)
    assert Remark(Said.TRUTH_CLOCKWISE) in found.diagnosis.notes
    assert found.truth is not None
    assert abs(found.truth.values["gyro_scale"]) < 0.01
    assert not found.diagnosis.effects


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_wheel_that_counts_backwards_is_told_and_turned_round(robot: Robot, side: str) -> None:
    """Before: "no effect of the catalogue explains it"."""
    log = simulate(Hidden(delay_s=0.1), 1)
    odd = replace(log, **{f"{side}_m": -getattr(log, f"{side}_m")})
    effects = diagnose_drive("odd", odd, robot).diagnosis.effects
    assert [e.effect for e in effects] == ["unit_or_sign", "gyro_delay"]
    assert effects[0].seen == Remark(Said.WHEEL_SIGN, {"side": side})


@pytest.mark.slow
def test_a_truth_that_was_left_aside_leaves_no_structure() -> None:
    log = drive(Plan("random", 4.0, 10.0, truth_m=0.02, truth_heading_deg=0.05), 3)
    standing = robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("robot.toml"))
    mirrored = replace(log, truth_y_m=-log.truth_y_m, truth_heading_deg=-log.truth_heading_deg)
    found = diagnose_drive("mirrored", mirrored, standing).diagnosis
    assert Remark(Said.TRUTH_MIRRORED) in found.notes
    assert not [place for place in found.located if place.remains]


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [True, False])
def test_a_truth_tells_swapped_wheels_from_an_inverted_gyro(swapped: bool) -> None:
    """Before: swapped wheels were bridged by an inverted gyro, and the truth called mirrored."""
    log = drive(Plan("random", 4.0, 10.0, truth_m=0.02), 3)
    standing = robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("robot.toml"))
    odd = (
        replace(log, left_m=log.right_m, right_m=log.left_m)
        if swapped
        else replace(log, gyro_dps=-log.gyro_dps)
    )
    found = diagnose_drive("odd", odd, standing).diagnosis
    assert [e.effect for e in found.effects] == ["unit_or_sign"]
    assert (found.effects[0].seen == Remark(Said.WHEELS_SWAPPED)) == swapped
    assert not found.notes


@pytest.mark.parametrize(
    ("told", "said"),
    [(np.radians, Said.TRUTH_RADIANS), (np.negative, Said.TRUTH_CLOCKWISE), (lambda deg: deg, None)],
)
def test_a_truth_of_headings_alone_is_taken_in_its_unit_and_sign(
    told: Callable[[Floats], Floats], said: Said | None
) -> None:
    """Before: a gyro scale of +147 %, or of +300 %."""
    log = drive(Plan("random", 2.5, 10.0, truth_m=0.02, truth_heading_deg=0.05), 3)
    standing = robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("robot.toml"))
    nothing = np.full(len(log), np.nan)
    headings = replace(
        log, truth_x_m=nothing, truth_y_m=nothing, truth_heading_deg=told(log.truth_heading_deg)
    )
    found = diagnose_drive("headings", headings, standing)
    assert (said is None) or Remark(said) in found.diagnosis.notes
    assert found.truth is not None
    assert abs(found.truth.values["gyro_scale"]) < 0.01
    way_m = 0.5 * (log.left_m + log.right_m)
    vehicle = replace(headings, left_m=way_m, right_m=way_m, speed_only=True)
    if said is Said.TRUTH_CLOCKWISE:
        with pytest.raises(DataError, match="turn against each other"):
            diagnose_drive("headings", vehicle, standing)
