"""Gaps in time and empty cells of the wheels: a robot goes on meanwhile, and nothing is compared there."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from gyrocal.diagnosis.drive.engine import examine
from gyrocal.diagnosis.drive.findings import named_effects, unexpected_bias
from gyrocal.diagnosis.drive.path_gaps import after_gaps, first_turns
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.series import drive_series, nodes_of
from gyrocal.diagnosis.drive.yaw import usual_noise
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.fusion.robot import SlipFigures
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot
from gyrocal.units import NORMAL_95
from tests.diagnosis.drive.fleet import drive
from tests.diagnosis.drive.test_lasting import PLAN, turned


def without(log: DriveBlock, from_s: float, to_s: float, *, counted: bool = True) -> DriveBlock:
    """The log less some rows, whose way the wheels count in the row after them, or it is lost with them."""
    keep = (log.t_s <= from_s) | (log.t_s >= to_s)
    changed: dict[str, Any] = {}
    for one in fields(log):
        channel = getattr(log, one.name)
        if isinstance(channel, np.ndarray):
            wheel = counted and one.name in ("left_m", "right_m")
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


@pytest.mark.slow
def test_a_gap_leaves_a_scale_of_the_gyro_its_name(resting: Robot) -> None:
    """Everything beside a truth was structure without a name after it, and the scale was the track's."""
    log = drive(replace(PLAN, truth_m=0.01, minutes=5.0), 6)
    turning_s = log.t_s[np.argmax(np.abs(np.convolve(log.gyro_dps, np.ones(60), "same")))]
    log = without(log, turning_s - 1.0, turning_s + 1.0)
    found = examine("log", replace(log, gyro_dps=1.03 * log.gyro_dps), resting, None)
    assert found.truth is not None
    assert min(found.truth.odd.values()) > 1e-3
    assert found.parts["gyro_scale"].value == pytest.approx(0.03, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("counted", [True, False])
def test_after_a_gap_the_path_begins_anew(counted: bool, resting: Robot) -> None:
    """The scale had been 0.0095 +- 0.0039 where ticks count on and -0.04 +- 0.14 where they are lost, beside structure everywhere."""
    log = drive(replace(PLAN, truth_m=0.02, truth_every_s=0.1, minutes=4.0, hz=10.0), 7)
    log = replace(log, gyro_dps=1.004 * log.gyro_dps)
    holed = log
    for from_s in (62.0, 132.0, 202.0):
        holed = without(holed, from_s, from_s + 8.0, counted=counted)
    for one in (log, holed):
        found = examine("log", one, resting, None)
        assert found.truth is not None
        scale = found.parts["gyro_scale"]
        assert abs(scale.value - 0.004) < NORMAL_95 * scale.std < 1e-3
        assert min(found.truth.odd.values()) > 1e-3
        effects = named_effects(found.series, found.yaw, found.truth, found.parts, found.checks)
        assert {e.effect for e in effects} - {"dropped_samples"} == {"gyro_scale"}


def test_a_turn_and_a_way_in_a_gap_move_what_follows(resting: Robot) -> None:
    """Against paths that are turned and shifted at the gap, of which a knot holds a part."""
    log = without(drive(PLAN, 4), 100.0, 103.0)
    path = reckon(drive_series("d", log, resting, None), Figures())
    rows = np.arange(0, path.t_s.size, 3)
    at = np.floor(path.t_s[rows] / 7.0).astype(np.int64)
    count = np.bincount(at).astype(np.float64)
    share, turned = after_gaps(path, rows, count)
    later, still = np.cumsum(path.gap).astype(np.float64), np.zeros(path.t_s.size)
    for found, each in ((share, later), (turned, path.moved_by(later, still))):
        mean = np.bincount(at, each[rows].real) + 1j * np.bincount(at, each[rows].imag)
        np.testing.assert_allclose(found[:, 0], mean / count, atol=1e-9)
    assert np.any((share > 0.0) & (share < 1.0))


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize(("from_s", "to_s"), [(100.0, 103.0), (60.0, 60.4)])
def test_wheels_that_count_on_are_told_from_lost_ones(
    counted: bool, from_s: float, to_s: float, resting: Robot
) -> None:
    log = without(drive(PLAN, 4), from_s, to_s, counted=counted)
    assert drive_series("d", log, resting, None).counts_on == counted


def test_parts_that_lie_askew_are_laid_on_the_truth(resting: Robot) -> None:
    """However far a robot has turned in a gap; one that has not moved after it is not known to have turned."""
    log = without(without(drive(PLAN, 4), 100.0, 103.0, counted=False), 200.0, 203.0, counted=False)
    series = drive_series("d", log, resting, None)
    path, noise = reckon(series, Figures()), usual_noise(series)
    truth = np.cumsum(path.steps_m * np.exp(1j * (0.3 + 2.9 * (np.cumsum(path.gap) == 1))))
    rows, count = np.arange(path.t_s.size), np.ones(path.t_s.size)
    found = first_turns(path, rows, count, (path.at_m, truth), 0.3, 1e-4, noise)
    np.testing.assert_allclose(found, [2.9, -2.9], atol=1e-3)
    standing = replace(path, steps_m=np.where(np.cumsum(path.gap) > 0, 0.0, path.steps_m))
    found = first_turns(standing, rows, count, (standing.at_m, truth), 0.3, 1e-4, noise)
    np.testing.assert_allclose(found, 0.0, atol=1e-6)


def test_a_rest_that_the_file_promises_and_the_log_lacks_is_said(resting: Robot) -> None:
    """The rest at the start "takes off" the bias, it had said, and `replay` refused the file that was written."""
    log = drive(PLAN, 4)
    assert not [
        n
        for n in examine("log", log, resting, None).notes
        if isinstance(n, Remark) and n.said is Said.NO_REST
    ]
    moved = np.flatnonzero(np.abs(log.left_m) > 0.0)[0]
    driven = without(log, -1.0, float(log.t_s[moved]))
    (said,) = (
        n
        for n in examine("log", driven, resting, None).notes
        if isinstance(n, Remark) and n.said is Said.NO_REST
    )
    assert "the robot moves in its first 7 s" in said.facts["why"]


@pytest.mark.parametrize(("bias_dps", "is_named"), [(2.0, True), (0.1, False)])
def test_a_bias_that_a_promised_rest_does_not_take_off_is_named(
    bias_dps: float, is_named: bool, resting: Robot
) -> None:
    """A gyro may have a fifth of a degree per second: what the file grants is of what a rest leaves."""
    log = drive(PLAN, 4)
    moved = np.flatnonzero(np.abs(log.left_m) > 0.0)[0]
    driven = without(log, -1.0, float(log.t_s[moved]))
    biased = replace(driven, gyro_dps=driven.gyro_dps + bias_dps)
    found = examine("log", biased, resting, None)
    named = unexpected_bias(found.series, found.yaw, None)
    assert (named is not None) == is_named
    if named is not None:
        (bias,) = named[1].parameters.values()
        low, high = bias.interval_95
        assert bias.unit == "mdeg/s"
        assert low < 1e3 * bias_dps < high
