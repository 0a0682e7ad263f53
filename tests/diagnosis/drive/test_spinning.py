"""Wheels that spin while the speed grows: the way shows it beside a truth, turns without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.drive import findings
from gyrocal.diagnosis.drive.engine import diagnose_drive, examine
from gyrocal.diagnosis.drive.levels import GAIN
from gyrocal.diagnosis.drive.path_strangers import SPINNING
from gyrocal.diagnosis.drive.search import YawAnswer, _named
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.test_lasting import told_of

PLAN = Plan("random", 6.0, 20.0, tick_m=2e-4, arw_dps_rt_s=0.002, bias_walk=0.0, wheel_noise=2e-4)


def spinning(log: DriveBlock, share_s2_per_m: float, *, braking: bool = False) -> DriveBlock:
    """The log with wheels that go further while the speed grows, or as they brake."""
    dt_s = float(np.median(np.diff(log.t_s)))
    kernel = np.hanning(round(0.6 / dt_s) | 1)
    speed = np.abs(np.convolve(0.5 * (log.left_m + log.right_m), kernel / kernel.sum(), "same")) / dt_s
    grows = np.gradient(speed, dt_s) * (-1.0 if braking else 1.0)
    further = 1.0 + share_s2_per_m * np.maximum(grows, 0.0)
    return replace(log, left_m=log.left_m * further, right_m=log.right_m * further)


#: Share, s²/m, whether as they brake, accuracy of the truth, m.
SPINS = [
    (share, braking, truth_m)
    for truth_m in (0.0, 0.01)
    for share, braking in ((0.1, False), (-0.1, False), (-0.1, True))
]


@pytest.mark.parametrize(
    ("share", "braking", "truth_m"),
    [pytest.param(*spin, marks=[] if spin == SPINS[0] else [pytest.mark.slow]) for spin in SPINS],
)
def test_wheels_that_spin_while_the_speed_grows_are_named(
    resting: Robot, share: float, braking: bool, truth_m: float
) -> None:
    """By the way, where a truth shows it, and by turns that begin as the speed grows."""
    log = drive(replace(PLAN, truth_m=truth_m), 6)
    found = diagnose_drive("log", spinning(log, share, braking=braking), resting)
    named = [e.effect for e in found.diagnosis.effects]
    assert (named == ["start_stop_slip"]) == ("start_stop_slip" in named) == (share > 0.0)
    assert ("start_stop_slip" in found.diagnosis.not_testable) == (share < 0.0)
    # What braking wheels slide has no name, but its place.
    left = [p.coordinate for p in found.diagnosis.located if p.remains]
    assert ("acceleration" in left) == (share < 0.0)
    if share > 0.0:
        amplitude = found.diagnosis.effects[0].parameters["amplitude"]
        assert amplitude.value == pytest.approx(share, abs=max(3.0 * amplitude.std, 0.15 * share))


def in_ticks(log: DriveBlock, tick_m: float) -> DriveBlock:
    """The log of wheels that count whole ticks."""
    left_m, right_m = (
        tick_m * np.diff(np.floor(np.cumsum(w) / tick_m), prepend=0.0) for w in (log.left_m, log.right_m)
    )
    return replace(log, left_m=left_m, right_m=right_m)


def test_whole_ticks_that_come_and_go_are_no_growth_of_the_speed(resting: Robot) -> None:
    """From row to row they rise as often as they fall, and what rises alone would be slip in every turn."""
    log = drive(replace(PLAN, minutes=3.0, hz=50.0, tick_m=0.0), 6)
    fine, coarse = (
        float(np.sum(np.abs(examine("log", one, resting, None).yaw.laws["spinning"].column)))
        for one in (log, in_ticks(log, 1.7e-3))
    )
    assert coarse == pytest.approx(fine, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.0])
def test_coarse_ticks_leave_wheels_that_spin_their_name_and_no_scale(share: float, resting: Robot) -> None:
    plan = replace(PLAN, minutes=5.0, hz=50.0, tick_m=0.0, truth_m=0.003, truth_every_s=0.1)
    found = diagnose_drive("log", in_ticks(spinning(drive(plan, 6), share), 1.7e-3), resting)
    assert [e.effect for e in found.diagnosis.effects] == ["start_stop_slip"] * (share > 0.0)
    for effect in found.diagnosis.effects:
        amplitude = effect.parameters["amplitude"]
        assert amplitude.value == pytest.approx(share, abs=max(3 * amplitude.std, 0.15 * share))


@pytest.mark.slow
def test_turns_and_way_together_show_wheels_that_neither_shows_alone(
    resting: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = drive(replace(PLAN, truth_m=0.01), 6)
    found = examine("log", spinning(log, 0.1), resting, None)
    assert found.truth is not None
    value, std = found.truth.values[SPINNING], found.truth.stds[SPINNING]
    weak = replace(found.truth, values={**found.truth.values, SPINNING: 3.0 * std}, stds={**found.truth.stds})
    least = replace(found.yaw, chosen=tuple(n for n in found.yaw.chosen if n != "spinning"))
    for of_turns, told in ((3.0, True), (1.0, False), (-3.0, False)):
        monkeypatch.setattr(
            YawAnswer, "beyond", lambda *_, k=of_turns: (np.array([k * std]), np.array([[std**2]]))
        )
        assert (findings.spinning(least, weak) is not None) == told
    assert value > 0.0
    # Wheels that both go further by as much turn no robot further.
    monkeypatch.setattr(YawAnswer, "beyond", lambda *_: (np.zeros(1), np.array([[(0.1 * std) ** 2]])))
    alike = findings.spinning(least, found.truth)
    assert alike is not None
    assert alike.value == value


@pytest.mark.slow
@pytest.mark.parametrize("course_s", [0.025, -0.025])
def test_a_way_along_an_earlier_or_later_heading_is_no_slip(resting: Robot, course_s: float) -> None:
    """As a simulator makes it that steps along the last heading: wheels had slipped as the speed grew, beside their noise."""
    plan = replace(PLAN, truth_m=0.003, truth_every_s=0.05, truth_heading_deg=0.1, wheel_noise=4e-3)
    found = diagnose_drive("log", drive(replace(plan, effects={"course_s": course_s}), 3), resting)
    assert found.diagnosis.effects == ()
    (course,) = [e for e in found.estimates if e.name == "truth_course"]
    assert 5e-4 < course.std < 5e-3
    assert course.value == pytest.approx(course_s, abs=3.0 * course.std)


@pytest.mark.slow
def test_one_wheel_that_spins_makes_no_other_law_of_wheels(resting: Robot) -> None:
    """The one that goes further while the speed grows turns the robot then, and has no name by that alone."""
    log = drive(PLAN, 6)
    found = diagnose_drive("log", replace(log, left_m=spinning(log, 0.1).left_m), resting)
    assert "acceleration" in [p.coordinate for p in found.diagnosis.located if p.remains]
    assert not {e.effect for e in found.diagnosis.effects} & {"wheel_asymmetry", "wheel_eccentricity"}


@pytest.mark.parametrize("spins", [0.0, 8.0])
def test_what_the_law_of_a_slip_misses_is_no_spinning(spins: float) -> None:
    """Another shape of slip explains it as well; wheels that spin do what none of them does."""
    rng = np.random.default_rng(4)
    turns, curved, saturates, own = np.linalg.qr(rng.normal(size=(400, 4)))[0].T
    columns = {"track": turns, "slip_curvature": curved, "slip_saturating_0.3": saturates}
    columns["spinning"] = np.sqrt(0.5) * (saturates + own)
    told = told_of(columns, 40.0 * curved + 9.0 * saturates + spins * own)
    chosen = ["track", "slip_curvature", "spinning"]
    assert told.added(chosen[:2], ["spinning"]) > 2.0 * GAIN
    assert ("spinning" in _named(told, chosen, [], 0.0)) == (spins > 0.0)
