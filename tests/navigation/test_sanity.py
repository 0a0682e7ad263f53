"""A truth that was mixed up is found by replay, and a sound one never is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import DataError
from gyrocal.navigation.replay import replay_log
from gyrocal.navigation.sanity import truth_fault
from gyrocal.records.drive import DriveBlock
from tests.navigation.drives import drive, robot, source

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
    "gyro in rad/s beside a speed": (
        lambda b: replace(
            b,
            left_m=0.5 * (b.left_m + b.right_m),
            right_m=0.5 * (b.left_m + b.right_m),
            speed_only=True,
            gyro_dps=np.radians(b.gyro_dps),
        ),
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


def test_a_straight_path_is_its_own_mirror_image() -> None:
    x = np.arange(100.0)
    path = np.stack([x, 0.01 * np.sin(x), np.zeros(100)], axis=1)
    assert truth_fault(path, path * np.array([1.0, -1.0, 1.0])) is None
