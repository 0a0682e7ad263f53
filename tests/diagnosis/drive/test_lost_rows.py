"""Gaps in time and empty cells of the wheels: a robot goes on meanwhile, and nothing is compared there."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from gyrocal.diagnosis.drive.engine import examine
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.series import drive_series, nodes_of
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.fusion.robot import SlipFigures
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot
from tests.diagnosis.drive.fleet import drive
from tests.diagnosis.drive.test_lasting import PLAN, turned


def without(log: DriveBlock, from_s: float, to_s: float) -> DriveBlock:
    """The log less some rows, whose way the wheels count in the row after them."""
    keep = (log.t_s <= from_s) | (log.t_s >= to_s)
    changed: dict[str, Any] = {}
    for one in fields(log):
        channel = getattr(log, one.name)
        if isinstance(channel, np.ndarray):
            wheel = one.name in ("left_m", "right_m")
            changed[one.name] = np.diff(np.cumsum(channel)[keep], prepend=0.0) if wheel else channel[keep]
    return replace(log, **changed)


def test_a_wheel_goes_on_where_its_cell_is_empty(resting: Robot) -> None:
    """As no motion, three empty rows in a hundred were a wheel scale of -2.8 %, and the file had it."""
    log = drive(PLAN, 4)
    empty = np.random.default_rng(1).random(len(log)) < 0.03
    lost = replace(log, left_m=np.where(empty, np.nan, log.left_m))
    whole, holed = (drive_series("d", x, resting, None) for x in (log, lost))
    count = int(np.count_nonzero(empty))
    assert Remark(Said.EMPTY_WHEEL, {"count": count, "wheel": "left"}) in holed.notes
    assert np.sum(holed.left_m) == pytest.approx(np.sum(whole.left_m), rel=1e-3)
    assert holed.tick_m == pytest.approx(whole.tick_m)
    nodes = nodes_of(holed)
    inside = np.add.reduceat(empty.astype(int), nodes.rows[:-1] + 1) > 0
    np.testing.assert_array_equal(nodes.broken, inside)


def test_over_a_gap_the_wheels_turn_the_robot(resting: Robot) -> None:
    """The rate of the row after it had been taken over the whole gap."""
    log = drive(replace(PLAN, bias_dps=0.5), 4)
    log = turned(log, 1.2 + 0.36 * np.abs(log.gyro_dps - 0.5) / 30.0)
    turning_s = log.t_s[np.argmax(np.abs(np.convolve(log.gyro_dps, np.ones(60), "same")))]
    rows = (log, without(log, turning_s - 0.25, turning_s + 0.25))
    figures = Figures(bias_dps=0.5, track=0.2, slip=SlipFigures(amplitude=0.3), bias_from_rest=False)
    whole, holed = (reckon(drive_series("d", x, resting, None), figures) for x in rows)
    assert np.count_nonzero(holed.gap) == 1
    assert np.abs(np.diff(holed.heading_rad)[holed.gap[1:]]) > 0.2
    assert abs(holed.heading_rad[-1] - whole.heading_rad[-1]) < 0.02
    assert abs(holed.at_m[-1] - whole.at_m[-1]) < 0.02 * np.sum(np.abs(whole.way_m))


def test_a_gap_leaves_a_scale_of_the_gyro_its_name(resting: Robot) -> None:
    """Everything beside a truth was structure without a name after it, and the scale was the track's."""
    log = drive(replace(PLAN, truth_m=0.01, minutes=5.0), 6)
    turning_s = log.t_s[np.argmax(np.abs(np.convolve(log.gyro_dps, np.ones(60), "same")))]
    log = without(log, turning_s - 1.0, turning_s + 1.0)
    found = examine("log", replace(log, gyro_dps=1.03 * log.gyro_dps), resting, None)
    assert found.truth is not None
    assert min(found.truth.odd.values()) > 1e-3
    assert found.parts["gyro_scale"].value == pytest.approx(0.03, abs=2e-3)
