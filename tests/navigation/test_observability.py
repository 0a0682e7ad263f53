"""What a log can tell of the filter's constants."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.fusion import FilterNoise, InitialStd, Navigator, RobotParameters
from gyrocal.navigation.observability import Observability, observability
from tests.fusion.drive import paper

Floats = NDArray[np.float64]
WIDTH_M, DT_S = 0.5, 0.1
PRIOR = InitialStd(gyro_bias_dps=0.05)
ROBOT = RobotParameters(WIDTH_M, PRIOR, FilterNoise(1e-3, 0.0, 0.08, 0.0, 0.05))
T = np.arange(0.0, 300.0, DT_S)


def report(speed: Floats, turn_dps: Floats, *, estimate_scale: bool = True) -> Observability:
    """Drive without errors: the information depends on the path alone."""
    half = 0.5 * WIDTH_M * np.radians(turn_dps)
    navigator = paper(ROBOT, estimate_scale=estimate_scale)
    before = navigator.covariance
    out = navigator.run(T, (speed - half) * DT_S, (speed + half) * DT_S, turn_dps)
    return observability(before, navigator.covariance, out.heading_deg)


def steady(value: float) -> Floats:
    return np.full(T.size, value)


def both_ways() -> Floats:
    return np.where(T % 40.0 < 8.0, 20.0, np.where((T % 40.0 > 20.0) & (T % 40.0 < 28.0), -20.0, 0.0))


def test_straight_road_tells_nothing_of_turning() -> None:
    found = report(steady(1.0), steady(0.0))
    ratio = found.ratio
    assert ratio["wheel separation"] > 0.99
    assert ratio["gyro scale"] > 0.99
    assert found.seen == 1
    assert "straights and turns both ways are needed" in found.sentences()[-1]
    assert "At their prior: wheel separation, gyro scale, gyro bias." in found.sentences()


def test_turns_both_ways_and_changes_of_speed_see_three_of_five() -> None:
    found = report(1.0 + 0.5 * np.sin(T / 13.0), both_ways())
    assert len(found.directions) == 5
    assert found.seen == 3
    assert not any("needed" in sentence for sentence in found.sentences())
    unseen = [d for d in found.directions if d.ratio > 0.9]
    assert len(unseen) == 2


def test_a_calibrated_gyro_gives_the_wheel_separation() -> None:
    speed = 1.0 + 0.5 * np.sin(T / 13.0)
    alone = report(speed, both_ways()).ratio["wheel separation"]
    calibrated = report(speed, both_ways(), estimate_scale=False)
    assert "gyro scale" not in calibrated.ratio
    assert calibrated.ratio["wheel separation"] < 0.7 * alone


def test_one_turning_direction_is_named() -> None:
    found = report(steady(1.0), np.maximum(both_ways(), 0.0))
    assert found.turned_right_deg < 1.0
    assert "hardly turned to the right" in found.sentences()[-1]


def test_at_rest_only_the_bias_is_seen() -> None:
    found = report(steady(0.0), steady(0.0))
    assert found.ratio["gyro bias"] < 0.1
    assert all(r > 0.999 for name, r in found.ratio.items() if name != "gyro bias")
    assert found.to_json()["seen"] == 1


def test_a_log_that_says_nothing_of_the_bias_leaves_it_at_what_the_filter_began_with() -> None:
    robot = RobotParameters(WIDTH_M, noise=FilterNoise(flicker_dps=0.02), static_s=0.0)
    navigator = Navigator(robot, static_bias_dps=0.1)
    before = navigator.covariance
    nothing = np.full(20, np.nan)
    out = navigator.run(T[:20], nothing, nothing, np.zeros(20))
    found = observability(before, navigator.covariance, out.heading_deg)
    assert found.prior_std["gyro bias"] == pytest.approx(np.hypot(0.05, 0.02 * np.sqrt(3.0)))
    assert found.ratio["gyro bias"] == pytest.approx(1.0, rel=1e-3)
