"""A truth that was mixed up is found by replay, and a sound one never is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.drive.checks import wrong_gyro, wrong_truth
from gyrocal.diagnosis.drive.series import drive_series
from gyrocal.errors import DataError
from gyrocal.navigation.replay import replay_log
from gyrocal.navigation.sanity import clockwise, gyro_fault, truth_fault, turn_part_fault, way_fault
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import robot_of
from tests.diagnosis.drive.fleet import SHAPES, Plan
from tests.diagnosis.drive.fleet import drive as fleet_drive
from tests.navigation.drives import drive, robot, source


def radians_of_one_speed(b: DriveBlock) -> DriveBlock:
    """The log as of a vehicle that has one speed and a gyro in rad/s."""
    way_m = 0.5 * (b.left_m + b.right_m)
    return replace(b, left_m=way_m, right_m=way_m, speed_only=True, gyro_dps=np.radians(b.gyro_dps))


MIXED: dict[str, tuple[Callable[[DriveBlock], DriveBlock], str]] = {
    "mirrored": (
        lambda b: replace(b, truth_y_m=-b.truth_y_m, truth_heading_deg=-b.truth_heading_deg),
        "in a mirror only",
    ),
    "swapped": (lambda b: replace(b, truth_x_m=b.truth_y_m, truth_y_m=b.truth_x_m), "x and y are swapped"),
    "millimetres": (
        lambda b: replace(b, truth_x_m=1e3 * b.truth_x_m, truth_y_m=1e3 * b.truth_y_m),
        "they are in millimetres",
    ),
    "radians": (
        lambda b: replace(b, truth_heading_deg=np.radians(b.truth_heading_deg)),
        "heading is in radians",
    ),
    "wheels that run backwards": (
        lambda b: replace(b, left_m=-b.right_m, right_m=-b.left_m),
        "the wheels run backwards: .* sign = -1",
    ),
    "a compass": (
        lambda b: replace(b, truth_heading_deg=(90.0 - b.truth_heading_deg) % 360.0),
        "heading turns clockwise",
    ),
    "degrees": (
        lambda b: replace(b, truth_x_m=8.5 + b.truth_x_m / 76_000, truth_y_m=47.0 + b.truth_y_m / 111_000),
        "degrees of longitude and latitude",
    ),
    "degrees of a speed": (
        lambda b: replace(
            radians_of_one_speed(b),
            gyro_dps=b.gyro_dps,
            truth_heading_deg=np.full(b.t_s.size, np.nan),
            truth_x_m=8.5 + b.truth_x_m / 76_000,
            truth_y_m=47.0 + b.truth_y_m / 111_000,
        ),
        "degrees of longitude and latitude",
    ),
    "a heading of another": (
        lambda b: replace(b, truth_heading_deg=np.roll(2.0 * b.truth_heading_deg, b.t_s.size // 3)),
        "nothing to do with the course",
    ),
    "a gyro's cell gone wrong": (
        lambda b: replace(b, gyro_dps=np.where(np.arange(b.t_s.size) == 700, 9999.0, b.gyro_dps)),
        "line 702: gyro_dps is 9,999 deg/s in size",
    ),
    "km/h": (
        lambda b: replace(
            b, left_m=1.8 * (b.left_m + b.right_m), right_m=1.8 * (b.left_m + b.right_m), speed_only=True
        ),
        r"goes 0\.27\d times as far",
    ),
    "gyro in rad/s beside a speed": (
        radians_of_one_speed,
        "gyro_dps is in rad/s",
    ),
    "gyro in rad/s beside a speed and positions": (
        lambda b: replace(radians_of_one_speed(b), truth_heading_deg=np.full(b.t_s.size, np.nan)),
        "gyro_dps is in rad/s",
    ),
}


@pytest.mark.parametrize("name", MIXED)
def test_a_mixed_up_truth_is_refused_with_its_remedy(name: str) -> None:
    spoil, text = MIXED[name]
    with pytest.raises(DataError, match=text):
        replay_log(source(spoil(drive())), robot(), kind="paper")


@pytest.mark.parametrize("off_deg", [90.0, -45.0, 180.0])
def test_a_heading_that_is_turned_all_along_is_turned_back_and_said(off_deg: float) -> None:
    """Paths were laid on the truth by it, and were metres off."""
    log = drive()
    turned = replace(log, truth_heading_deg=log.truth_heading_deg + off_deg)
    plain, found = (replay_log(source(b), robot(), kind="paper") for b in (log, turned))
    assert not any("turned back" in note for note in plain.notes)
    (said,) = [note for note in found.notes if "turned back" in note]
    assert f"{abs(off_deg):.0f} deg" in said or f"{abs(off_deg) - 1:.0f} deg" in said
    errors = [r.track("uncalibrated").errors.rms_m for r in (plain, found)]  # type: ignore[union-attr]
    assert errors[1] == pytest.approx(errors[0], abs=0.05 * plain.survey.distance_m / 100.0 + 0.05)


def test_a_wild_fix_is_set_aside_and_said() -> None:
    log = drive()
    x = np.where(np.arange(log.t_s.size) == 700, log.truth_x_m + 900.0, log.truth_x_m)
    plain, found = (replay_log(source(b), robot(), kind="paper") for b in (log, replace(log, truth_x_m=x)))
    assert sum("set aside" in note for note in found.notes) == 1
    errors = [r.track("uncalibrated").errors.rms_m for r in (plain, found)]  # type: ignore[union-attr]
    assert errors[1] == pytest.approx(errors[0], rel=0.01)


#: Columns that are another unit from the middle of a log on: factor, names, and what is said.
IN_PART: dict[str, tuple[float, tuple[str, ...], str]] = {
    "gyro in rad/s": (
        np.pi / 180,
        ("gyro_dps",),
        r"from t_s = 12\d to 2\d\d gyro_dps turns 0\.017\d* times as far as the encoders \(radians for degrees\)",
    ),
    "gyro of the other sign": (-1.0, ("gyro_dps",), r"gyro_dps turns -1\.?\d* times .* \(the other sign"),
    "wheels in centimetres": (1e2, ("left_m", "right_m"), r"the encoders say .* m/s"),
    "truth in millimetres": (
        1e3,
        ("truth_x_m", "truth_y_m"),
        r"the truth goes 1,?\d* times as far as the wheels \(milli",
    ),
    "truth in radians": (
        np.pi / 180,
        ("truth_heading_deg",),
        r"truth_heading_deg turns 0\.017\d* times as far as the gyro \(radians",
    ),
}


def changed(log: DriveBlock, name: str) -> DriveBlock:
    """The log with columns in another unit from its middle on."""
    times, columns, _ = IN_PART[name]
    late = log.t_s > 0.5 * (log.t_s[0] + log.t_s[-1])
    return replace(log, **{c: np.where(late, times, 1.0) * getattr(log, c) for c in columns})


@pytest.mark.parametrize("name", IN_PART)
def test_a_unit_that_changes_within_a_log_is_refused_with_where(name: str) -> None:
    """Before: a robot that tilts by 177 deg, wheels that slip by -298 %."""
    log = fleet_drive(Plan("random", 4.0, 10.0, truth_m=0.02, truth_heading_deg=0.05), 3)
    standing = robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("robot.toml"))
    replay_log(source(log), standing)
    with pytest.raises(DataError, match=IN_PART[name][2]):
        replay_log(source(changed(log, name)), standing)
    with pytest.raises(DataError, match=IN_PART[name][2]):
        wrong_truth(wrong_gyro(drive_series("log", changed(log, name), standing, None))[0])


@pytest.mark.parametrize("shape", SHAPES)
def test_what_wheels_do_is_no_change_of_unit(shape: str) -> None:
    for seed in range(5):
        log = fleet_drive(Plan(shape, 4.0, 10.0, wheel_noise=6e-3, turn_noise=5e-3), seed)
        slips = np.where(log.t_s > 120.0, 0.65, 1.0)
        turned = np.cumsum(log.right_m - log.left_m) / 0.5 * 180.0 / np.pi
        gyro = np.cumsum(slips * log.gyro_dps * np.diff(log.t_s, prepend=log.t_s[0]))
        assert turn_part_fault(log.t_s, turned, gyro, ("the encoders", "gyro_dps")) is None


def test_a_rough_truth_is_no_mix_up() -> None:
    rng = np.random.default_rng(1)
    for seed in range(40):
        n = 300
        heading = np.cumsum(rng.normal(0.0, 6.0, n))
        step = np.radians(heading)
        path = np.stack([np.cumsum(np.cos(step)), np.cumsum(np.sin(step)), heading], axis=1)
        drift = np.cumsum(rng.normal(0.0, 0.1, (n, 2)), axis=0)
        told = path.copy()
        told[:, :2] += drift + rng.normal(0.0, 1.0, (n, 2))
        told[:, 2] = (told[:, 2] + 180.0) % 360.0 - 180.0
        told[rng.random(n) < 0.3] = np.nan
        assert truth_fault(path, told) is None, seed


def test_no_truth_that_is_rough_is_a_mix_up_of_way_or_heading() -> None:
    """With a gyro that drifts by 30 deg a minute, and a receiver that wanders by metres."""
    for seed in range(60):
        rng = np.random.default_rng([seed, 4])
        plan = Plan(str(rng.choice(SHAPES)), 5.0, 10.0, bias_dps=0.5, truth_m=3.0, truth_wander_m=6.0)
        log = fleet_drive(replace(plan, truth_heading_deg=20.0), seed)
        heading = np.cumsum(np.radians(log.gyro_dps)) / 10.0
        at = np.cumsum(0.5 * (log.left_m + log.right_m) * np.exp(1j * heading))
        path = np.stack([at.real, at.imag, np.degrees(heading)], axis=1)
        truth = np.stack([log.truth_x_m, log.truth_y_m, log.truth_heading_deg], axis=1)
        known = np.isfinite(truth).all(axis=1)
        assert way_fault(path[known, :2], truth[known, :2]) is None, seed
        # Also by its positions alone.
        assert gyro_fault(path[known], truth[known] * np.array([1.0, 1.0, np.nan])) is None, seed
        assert not clockwise(path, truth), seed


def test_a_straight_path_is_its_own_mirror_image() -> None:
    x = np.arange(100.0)
    path = np.stack([x, 0.01 * np.sin(x), np.zeros(100)], axis=1)
    assert truth_fault(path, path * np.array([1.0, -1.0, 1.0])) is None
