"""A truth that was mixed up is found by replay, and a sound one never is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import DataError
from gyrocal.navigation.replay import replay_log
from gyrocal.navigation.sanity import clockwise, gyro_fault, truth_fault, way_fault
from gyrocal.records.drive import DriveBlock
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
    "a compass": (
        lambda b: replace(b, truth_heading_deg=(90.0 - b.truth_heading_deg) % 360.0),
        "heading turns clockwise",
    ),
    "degrees": (
        lambda b: replace(b, truth_x_m=8.5 + b.truth_x_m / 76_000, truth_y_m=47.0 + b.truth_y_m / 111_000),
        "degrees of longitude and latitude",
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
