"""A counter that stands for a stretch while its robot drives on; a pivot about a standing wheel is none."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.errors import DataError
from gyrocal.navigation.channels import check
from gyrocal.navigation.stuck_wheel import stuck_wheels
from gyrocal.navigation.survey import survey
from gyrocal.records.drive import DriveBlock

WIDTH, DT = 0.5, 0.1


def log(bias_dps: float = 0.0, delay: int = 0, slip: float = 1.0) -> DriveBlock:
    """Straight on, a curve, and a pivot of 20 s about the left wheel, over and over."""
    t = np.arange(0.0, 240.0, DT)
    part = t % 60.0
    turn = np.where(part < 20.0, 0.0, np.where(part < 40.0, 0.2, 0.4))
    speed = np.where(part < 40.0, 0.5, 0.5 * WIDTH * 0.4)
    speed[0] = turn[0] = 0.0
    left, right = (speed - 0.5 * WIDTH * turn) * DT, (speed + 0.5 * WIDTH * turn) * DT
    left[part >= 40.0] = 0.0
    gyro = np.roll(np.degrees(turn) * slip, delay) + bias_dps + 0.1 * np.sin(37.0 * t)
    nothing = np.full(t.size, np.nan)
    return DriveBlock(2, t, left, right, gyro, nothing, nothing, nothing, nothing)


def stuck(block: DriveBlock, side: str, since_s: float, until_s: float) -> DriveBlock:
    within = (block.t_s > since_s) & (block.t_s <= until_s)
    changed = {side: np.where(within, 0.0, getattr(block, side))}
    return DriveBlock(
        2, block.t_s, changed.get("left_m", block.left_m), changed.get("right_m", block.right_m), block.gyro_dps,
        block.gyro_temp_c, block.truth_x_m, block.truth_y_m, block.truth_heading_deg,
    )  # fmt: skip


@pytest.mark.parametrize("side", ["left_m", "right_m"])
def test_a_counter_that_stands_for_a_stretch_is_said_with_its_times(side: str) -> None:
    found = survey("log", [stuck(log(), side, 65.0, 75.0)])
    (note,) = [n for n in check(found, WIDTH) if "stands from" in n]
    assert f"the {side[:-2]} encoder stands from t_s = 65 to 75 while the other wheel goes " in note


@pytest.mark.parametrize(
    ("bias_dps", "delay", "slip"), [(0.0, 0, 1.0), (5.0, 0, 1.0), (0.0, 8, 1.0), (0.0, 0, 0.6)]
)
def test_a_pivot_about_a_standing_wheel_is_none(bias_dps: float, delay: int, slip: float) -> None:
    block = log(bias_dps, delay, slip)
    found = survey("log", [block])
    rows = (block.t_s, block.left_m, block.right_m, block.gyro_dps * DT)
    bins = (found.bin_s, found.left_m, found.right_m, found.gyro_deg)
    assert stuck_wheels(*rows, WIDTH) == stuck_wheels(*bins, WIDTH) == []


def test_a_counter_that_stands_for_long_is_refused() -> None:
    found = survey("log", [stuck(log(), "left_m", 60.5, 140.0)])
    with pytest.raises(DataError, match=r"left encoder stands from .* more than a quarter of the drive"):
        check(found, WIDTH)
