"""Squares driven by a robot whose wheels and track are not what it believes, integrated step by step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.errors import DataError
from gyrocal.fusion.robot import EncoderFigures, RobotParameters
from gyrocal.navigation.umbmark import umbmark

SIDE_M, SEPARATION_M = 4.0, 0.34
ROBOT = RobotParameters(wheel_separation_m=SEPARATION_M)


def return_error(direction: int, ratio: float, track: float) -> NDArray[np.float64]:
    """True return position of a robot that believes that it comes home; x forward, y left."""
    left, right = 2.0 / (ratio + 1.0), 2.0 / (1.0 / ratio + 1.0)
    x = y = heading = 0.0
    step = SIDE_M / 500
    for _ in range(4):
        for _ in range(500):
            turn = step * (right - left) / (SEPARATION_M * track)
            heading += 0.5 * turn
            x += step * 0.5 * (left + right) * math.cos(heading)
            y += step * 0.5 * (left + right) * math.sin(heading)
            heading += 0.5 * turn
        heading += direction * 0.25 * math.pi * (left + right) / track
    return np.array([x, y])


@pytest.mark.parametrize(("ratio", "track"), [(1.002, 1.0), (1.0, 1.01), (0.998, 1.004), (1.001, 0.992)])
def test_it_finds_wheels_and_track(ratio: float, track: float) -> None:
    scatter = np.array([[0.001, 0.0], [-0.001, 0.001], [0.0, -0.001]])
    found = umbmark(
        return_error(-1, ratio, track) + scatter,
        return_error(1, ratio, track) + scatter,
        SIDE_M,
        ROBOT,
    )
    assert found.wheel_ratio.value == pytest.approx(ratio, abs=2e-6)
    assert found.track_ratio.value == pytest.approx(track, abs=2e-6)
    assert found.wheel_separation_m.value == pytest.approx(SEPARATION_M * found.track_ratio.value)
    assert (1 + found.left_scale.value) / (1 + found.right_scale.value) == pytest.approx(
        found.wheel_ratio.value
    )


@pytest.mark.parametrize(("left", "right"), [(0.013, -0.003), (0.012, 0.004)])
def test_figures_go_in_the_place_of_those_in_use(left: float, right: float) -> None:
    """They were relative to the file in use, and written into it they made a robot worse (0.45 to 0.7 m of a square)."""
    in_use = EncoderFigures(left_scale=0.01, right_scale=0.5 * (left + right) - 0.005)
    # What the wheels truly do of what the odometry believes.
    each = (1.0 + in_use.left_scale) / (1.0 + left), (1.0 + in_use.right_scale) / (1.0 + right)
    ratio, mean = each[1] / each[0], 0.5 * sum(each)
    scatter = np.array([[0.001, 0.0], [-0.001, 0.001], [0.0, -0.001]])
    cw, ccw = (return_error(way, ratio, 1.004) + scatter for way in (-1, 1))
    found = umbmark(cw, ccw, SIDE_M, replace(ROBOT, encoders=in_use))
    # Longer by a mean that squares do not tell.
    assert (1.0 + found.left_scale.value) / mean == pytest.approx(1.0 + left, abs=2e-5)
    assert (1.0 + found.right_scale.value) / mean == pytest.approx(1.0 + right, abs=2e-5)


@pytest.mark.slow
def test_intervals_cover() -> None:
    rng = np.random.default_rng(5)
    truth_cw, truth_ccw = return_error(-1, 1.0005, 1.02), return_error(1, 1.0005, 1.02)
    inside = 0
    for _ in range(120):
        cw, ccw = (truth + 0.02 * rng.normal(size=(5, 2)) for truth in (truth_cw, truth_ccw))
        found = umbmark(cw, ccw, SIDE_M, ROBOT)
        inside += found.track_ratio.low <= 1.02 <= found.track_ratio.high
    # A wider interval than 95 % comes of adding four t variables of 4 degrees of freedom; 1e-4 of a binomial below.
    assert inside >= 104


def test_an_interval_of_one_scattering_coordinate_is_students() -> None:
    """Three runs have two degrees of freedom: 4.3 standard errors of their mean, where a normal law has 2."""
    scatter = np.array([[-0.01, 0.0], [0.0, 0.0], [0.01, 0.0]])
    found = umbmark(scatter, np.zeros((3, 2)), SIDE_M, ROBOT).track_ratio
    per_metre = 0.5 / (4.0 * SIDE_M) / (0.5 * math.pi)
    half = stats.t.ppf(0.975, 2) * 0.01 / math.sqrt(3) * per_metre
    assert 0.5 * (found.high - found.low) == pytest.approx(half, rel=0.05)


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(DataError, match="2 clockwise runs are given, and 3 are wanted in each direction"):
        umbmark(np.zeros((2, 2)), np.zeros((5, 2)), SIDE_M, ROBOT)


def test_gross_errors_are_refused() -> None:
    with pytest.raises(DataError, match="too much for small angles"):
        umbmark(np.full((3, 2), 3.0), np.zeros((3, 2)), SIDE_M, ROBOT)
