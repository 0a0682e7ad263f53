"""Laws that resemble something else: they have no name where the log itself speaks against them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrocal.diagnosis.drive import yaw
from gyrocal.diagnosis.drive.beside_truth import _wheels_beside_structure
from gyrocal.diagnosis.drive.engine import diagnose_drive, examine
from gyrocal.diagnosis.drive.lasting import outlasts
from gyrocal.diagnosis.drive.laws import SETTLING
from gyrocal.diagnosis.drive.levels import STRANGER_P
from gyrocal.diagnosis.drive.motions import rather_than_wheels, settling_beats, with_settling
from gyrocal.diagnosis.drive.nameless import GainTest
from gyrocal.diagnosis.drive.places import left_out
from gyrocal.diagnosis.drive.weighing import Evidence, Gram
from gyrocal.diagnosis.drive.yaw import usual_flicker_dps
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.drive_source import read_drive
from gyrocal.records.robot import Robot, read_robot, robot_of
from gyrocal.report.drive_words import drive_sentences
from tests.diagnosis.drive.fleet import Plan, drive

Floats = NDArray[np.float64]
SHARED = Path(__file__).parents[3].parent / "shared"
PLAN = Plan("random", 8.0, 20.0, tick_m=2e-4, arw_dps_rt_s=0.003, bias_walk=0.0, wheel_noise=3e-4)


def gyro_path(log: DriveBlock) -> tuple[Floats, Floats]:
    """Heading, rad, and way, m, at the end of each row."""
    heading = np.cumsum(np.radians(log.gyro_dps) * np.diff(log.t_s, prepend=log.t_s[0]))
    return heading, 0.5 * (log.left_m + log.right_m)


def turned(log: DriveBlock, times: Floats) -> DriveBlock:
    """The log with the wheels' turns so many times as large."""
    more_m = 0.5 * (times - 1.0) * (log.right_m - log.left_m)
    return replace(log, left_m=log.left_m - more_m, right_m=log.right_m + more_m)


@pytest.mark.slow
@pytest.mark.parametrize("drifts", [False, True])
def test_a_clock_that_drifts_is_no_delay(drifts: bool, resting: Robot) -> None:
    """A tenth of a millisecond in a second is 0.05 s at the end: its mean of 0.024 s had been named."""
    log = drive(PLAN, 2)
    since_s = log.t_s - log.t_s[0]
    late_s = 1e-4 * since_s if drifts else np.full(since_s.size, 0.024)
    heading = np.interp(since_s - late_s, since_s, gyro_path(log)[0])
    rate_dps = np.degrees(np.diff(heading, prepend=heading[0])) * 20.0
    found = diagnose_drive("log", replace(log, gyro_dps=rate_dps), resting).diagnosis
    assert [e.effect for e in found.effects] == ([] if drifts else ["gyro_delay"])
    assert ("delay" in [p.coordinate for p in found.located if p.remains]) == drifts
    grown = [
        note.facts["change"]
        for note in found.notes
        if isinstance(note, Remark) and note.said is Said.DELAY_GROWS
    ]
    assert grown == ([pytest.approx(0.1 * since_s[-1], rel=0.05)] if drifts else [])


@pytest.mark.slow
@pytest.mark.parametrize("patchy", [False, True])
def test_ground_that_slips_in_places_is_no_slip_of_the_robot(patchy: bool, resting: Robot) -> None:
    """Where a third of the ground slips by 0.3 the turns differ by more than their mean of 0.1."""
    log = drive(PLAN, 4)
    heading, way_m = gyro_path(log)
    at = np.cumsum(way_m * np.exp(1j * heading))
    slips = np.sin(at.real / 2.0) * np.sin(at.imag / 2.0) > 0.2
    log = turned(log, 1.0 + np.where(patchy, 0.3 * slips, 0.1))
    found = diagnose_drive("log", log, resting).diagnosis
    assert [e.effect for e in found.effects] == ([] if patchy else ["skid_slip"])
    assert ("turn_rate" in [p.coordinate for p in found.located if p.remains]) == patchy


@pytest.mark.slow
def test_a_bias_that_rings_after_the_start_did_not_come_with_the_motion(resting: Robot) -> None:
    log = drive(replace(PLAN, rest_s=30.0, truth_m=0.1), 5)
    log = replace(log, gyro_temp_c=np.full(len(log), np.nan))
    rung = np.exp(-(log.t_s - log.t_s[0]) / 40.0)
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + 0.05 * rung), resting)
    assert "gyro_bias" not in [e.effect for e in found.diagnosis.effects]
    assert found.diagnosis.verdict == "unexplained"
    assert [p.coordinate for p in found.diagnosis.located if p.remains]


@pytest.mark.slow
def test_wheels_hold_beside_what_the_truth_shows_of_the_gyro(resting: Robot) -> None:
    """A gyro that errs one way, which the truth shows, looks like wheels that differ where the robot turns mostly that way."""
    found = examine("log", drive(replace(PLAN, truth_m=0.01, minutes=5.0), 6), resting, None)
    assert found.truth is not None
    claimed = replace(found.yaw, named={"asymmetry": 100.0})
    one_sided = replace(found.truth, odd={"turn_rate": 1e-9, "speed": 0.1})
    assert not _wheels_beside_structure(claimed, one_sided).named
    assert _wheels_beside_structure(claimed, replace(found.truth, odd={"turn_rate": 0.1})).named


@pytest.mark.slow
def test_a_track_that_wanders_is_seen_beneath_the_slip_in_turns(resting: Robot) -> None:
    """From a level that is lost beneath it the search saw no slope: the places of such a track were found odd."""
    log = drive(replace(PLAN, turn_noise=0.003), 7)
    white = np.random.default_rng(3).normal(size=len(log))
    keep = np.exp(-0.05 / 4.0)
    wander = 0.06 * np.sqrt(1.0 - keep**2) * lfilter([1.0], [1.0, -keep], white)
    found = examine("log", turned(log, 1.0 + wander), resting, None).yaw
    assert 0.04 < found.model.noise.track_wander < 0.09
    assert not found.odd


@pytest.mark.slow
def test_wheels_that_err_by_heading_make_no_gyro_noisy(resting: Robot) -> None:
    """As of a slope that loads one side: what lives over the heading is in the mean, not in the noise of the gyro."""
    log = drive(replace(PLAN, rest_s=0.0), 8)
    heading, way_m = gyro_path(log)
    loaded = 0.003 * np.sin(heading) * way_m
    restless = replace(resting, parameters=replace(resting.parameters, static_s=0.0))
    odd = replace(log, left_m=log.left_m - 0.5 * loaded, right_m=log.right_m + 0.5 * loaded)
    found = diagnose_drive("log", odd, restless)
    noise = found.yaw.model.noise
    assert "heading" in found.yaw.odd
    assert noise.flicker_dps < 4.0 * usual_flicker_dps(noise.arw_dps_per_rt_hz)
    assert found.robot is not None
    assert found.robot.noise_std["flicker_dps"] > 0.0
    # The next drive heads elsewhere, by which its wheels differ as this one's do about their mean: 0.003 / sqrt(2).
    assert 0.001 < found.robot.initial_std["left_scale"] < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("settles", [False, True])
def test_a_gyro_that_warms_up_by_itself_does_not_follow_the_temperature(settles: bool) -> None:
    """Both rise all the time, the one within half a minute and the other within minutes."""
    log = drive(replace(PLAN, rest_s=0.0, bias_dps=0.0), 4)
    since_s = log.t_s - log.t_s[0]
    by_dps = 0.3 * (1.0 - np.exp(-since_s / 40.0)) if settles else 0.02 * (log.gyro_temp_c - 20.0)
    robot = robot_of({"wheel_separation_m": 0.5, "static_s": 0.0}, Path("robot.toml"))
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + by_dps), robot)
    assert ("bias_temperature" in [e.effect for e in found.diagnosis.effects]) != settles
    assert ("time" in [p.coordinate for p in found.diagnosis.located if p.remains]) == settles
    assert found.robot is not None
    assert (found.robot.parameters.gyro.bias_slope_dps_per_c != 0.0) != settles
    said = [n.facts for n in found.diagnosis.notes if isinstance(n, Remark) and n.said is Said.BIAS_SETTLES]
    assert len(said) == settles
    for facts in said:
        assert facts["least"] < 0.3 < facts["most"]
        assert facts["quickest_s"] <= 40.0 <= facts["slowest_s"]
        assert facts["quickest_s"] <= facts["settling_s"] <= facts["slowest_s"]
        assert facts["least"] <= facts["change"] <= facts["most"]
        (figure,) = [e for e in found.estimates if e.name == "gyro_bias_settling"]
        # It has settled at the end, and the next drive begins anew.
        assert figure.value == pytest.approx(-0.3, abs=4.0 * figure.std)


def at_any_level(gram: Gram) -> Evidence:
    """The same whatever the level of 1/f noise."""
    levels = Gram(gram.names, np.tile(gram.matrix, (9, 1, 1)), np.tile(gram.right, (9, 1)))
    return Evidence(gram, levels, np.zeros(9))


def told_of(columns: Mapping[str, Floats], y: Floats) -> Evidence:
    """What columns of any names tell of values in unit noise."""
    x = np.stack([*columns.values()], axis=1)
    return at_any_level(Gram(tuple(columns), x.T @ x, x.T @ y))


@pytest.mark.parametrize("settles", [True, False])
def test_a_slope_and_a_jump_are_no_bias_that_settles_unless_that_does_as_well(*, settles: bool) -> None:
    t_s = np.arange(1200.0)
    columns = {n: np.exp(-t_s / SETTLING[n]) for n in SETTLING}
    columns |= {"bias": np.ones(t_s.size), "slope": 1.0 - np.exp(-t_s / 700.0), "jump": 1.0 * (t_s < 600.0)}
    y = 1.5 * columns["settling_200"] if settles else 3.0 * columns["slope"] + 3.0 * columns["jump"]
    y = y + np.random.default_rng(1).normal(size=t_s.size)
    found = with_settling(told_of(columns, y), ["bias", "slope", "jump"])
    assert ("jump" in found) != settles
    assert any(n in SETTLING for n in found) == settles


@pytest.mark.parametrize(
    ("gain", "settling", "least", "rather"),
    [
        (283.0, [62.0] * 17 + [293.0], 0.0, False),
        (283.0, [62.0] * 17 + [296.0], 0.0, True),
        (283.0, [290.0] * 18, 0.0, True),
        (0.1, [5.0] * 17 + [7.5], 0.0, False),
        (0.1, [7.0] * 17 + [7.5], 0.0, True),
        (0.1, [7.0] * 17 + [7.5], 15.0, False),
    ],
)
def test_a_bias_that_settles_has_to_be_there_and_to_be_likelier_at_any_time_constant(
    gain: float, settling: list[float], least: float, *, rather: bool
) -> None:
    """Odds of 20 to 1 are a gain of 6.0; of the likeliest of 18 time constants alone it is 5.8 more."""
    names = ("slope", *SETTLING)
    gram = Gram(names, np.eye(len(names)), np.sqrt([gain, *settling]))
    told = at_any_level(gram)
    assert settling_beats(told, [], "slope", least) is rather


@pytest.mark.parametrize(
    ("moving", "wheels", "rather"), [(216.0, 205.0, True), (210.0, 205.0, False), (150.0, 205.0, False)]
)
def test_a_bias_stands_for_wheels_that_differ_where_it_is_20_times_as_likely(
    moving: float, wheels: float, *, rather: bool
) -> None:
    """The two columns are nearly one, as on a drive of one speed or as a robot warms up: each by itself explains nearly all."""
    for law, others in (("moving_0", ["step"]), ("slope", [])):
        names = ("bias", "asymmetry", *others, law)
        alike = 0.99
        precision = np.eye(len(names))
        precision[1, -1] = precision[-1, 1] = alike
        score = np.array([0.0, np.sqrt(wheels), *(1.0 for _ in others), np.sqrt(moving)])
        told = at_any_level(Gram(names, precision, score))
        kind = [*others, law]
        assert rather_than_wheels(told, ["bias", "asymmetry"], names, 15.0) == (kind if rather else [])
        assert not rather_than_wheels(told, ["bias"], names, 15.0)
        assert not rather_than_wheels(told, ["bias", "asymmetry", kind[0]], names, 15.0)
        assert not rather_than_wheels(told, ["bias", "asymmetry"], [], 15.0)
        assert not rather_than_wheels(told, ["bias", "asymmetry"], names, 300.0)


def slipping(log: DriveBlock, at_s: list[float], more_m: list[float]) -> DriveBlock:
    """The log with a right wheel that counts more way in some rows."""
    right = log.right_m.copy()
    right[np.searchsorted(log.t_s, at_s)] += more_m
    return replace(log, right_m=right)


@pytest.mark.slow
def test_slips_of_a_wheel_are_left_out_and_said(resting: Robot) -> None:
    """The right wheel counts 2 cm too much, twice, and 1 cm too little."""
    at_s, more_m = [100.0, 200.0, 300.0], [0.02, -0.01, 0.02]
    log = drive(PLAN, 6)
    found = diagnose_drive("log", slipping(log, at_s, more_m), resting)
    told = (found.diagnosis.drive or {})["left_out"]
    assert len(told) == 3
    since_s = log.t_s[np.searchsorted(log.t_s, at_s)] - log.t_s[0]
    assert all(x["from_s"] < t <= x["to_s"] + 1e-9 for x, t in zip(told, since_s, strict=True))
    turned_deg = np.degrees(more_m) / resting.wheel_separation_m
    assert [x["turn_deg"] for x in told] == pytest.approx(turned_deg, abs=0.2)
    (said,) = [line for line in drive_sentences(found) if "are left out of all fits" in line]
    assert said.count("deg at") == 3


@pytest.mark.parametrize("intervals", [10, 14, 60])
def test_few_intervals_at_rest_do_not_stand_out_by_chance(intervals: int) -> None:
    """Of ten, one in seven logs had a hand that turned the robot, by thousandths of a degree: their median is no scale."""
    rng = np.random.default_rng(intervals)
    nodes = SimpleNamespace(resting=np.ones(intervals, dtype=bool))
    model = cast(Any, SimpleNamespace(frame=SimpleNamespace(nodes=nodes), left_out=np.zeros(intervals)))
    drawn = np.abs(rng.standard_normal((2000, intervals)))
    assert sum(yaw._turned_by_hand(model, score).size > 0 for score in drawn) <= 4
    turned = drawn[0].copy()
    turned[3] = 1000.0
    assert yaw._turned_by_hand(model, turned).tolist() == [3]


def circle(slip_deg: float) -> DriveBlock:
    """Seven minutes on a circle of 20 deg/s; as the robot stops, the wheels turn it by something that the gyro does not see."""
    rng = np.random.default_rng(8)
    t_s = 0.2 * np.arange(2400, dtype=np.float64)
    moving = np.clip(t_s - 40.0, 0.0, 1.0) * np.clip(470.0 - t_s, 0.0, 1.0)
    turn_rad, way_m = np.radians(4.0) * moving, 0.2 * moving
    gyro_dps = 20.0 * moving + 0.02 * rng.standard_normal(t_s.size)
    half_m = 0.25 * turn_rad + 1e-3 * np.sqrt(way_m) * rng.standard_normal(t_s.size)
    half_m[(t_s > 469.7) & (t_s < 470.3)] += 0.25 * np.radians(slip_deg) / 3.0
    at = np.cumsum(way_m * np.exp(1j * np.cumsum(turn_rad)))
    at += 0.02 * (rng.standard_normal(t_s.size) + 1j * rng.standard_normal(t_s.size))
    at[np.arange(t_s.size) % 5 > 0] = np.nan
    nothing = np.full(t_s.size, np.nan)
    return DriveBlock(1, t_s, way_m - half_m, way_m + half_m, gyro_dps, nothing, at.real, at.imag, nothing)


@pytest.mark.slow
@pytest.mark.parametrize("slip_deg", [0.0, 2.0, -5.0])
def test_what_happened_once_is_no_law(slip_deg: float, resting: Robot) -> None:
    """On a circle bias, scale and wheels differ by the stop alone: a slip there had been all three, a bias of 112 in place of 15."""
    found = examine("log", circle(slip_deg), resting, None)
    assert not found.yaw.named
    assert not found.parts
    assert any(468.0 < x.from_s < x.to_s < 476.0 for x in left_out(found.yaw)) == bool(slip_deg)


def test_the_noise_is_looked_for_once_for_each_choice_of_intervals(
    monkeypatch: pytest.MonkeyPatch, resting: Robot
) -> None:
    """The search begins again for each interval that is left out: each time all levels had been, too."""
    looked, levels = list[bytes](), yaw._levels

    def noted(*given: Any) -> Any:
        *_, columns, _, left_out = given
        looked.append(columns.tobytes() + left_out.tobytes())
        return levels(*given)

    monkeypatch.setattr(yaw, "_levels", noted)
    assert left_out(examine("log", circle(2.0), resting, None).yaw)
    assert len(set(looked)) == len(looked) > 1


@pytest.mark.slow
def test_a_robot_that_a_hand_turns_has_no_other_bias(resting: Robot) -> None:
    """Turned by 30 deg within 2 s while its wheels stand: the bias had jumped by some deg/s, and stayed there."""
    log = drive(replace(PLAN, shape="rests", minutes=6.0), 3)
    still = (log.left_m == 0.0) & (log.right_m == 0.0) & (log.t_s > log.t_s[0] + 60.0)
    start = next(t for t in log.t_s[still] if np.all(still[(log.t_s >= t - 1.0) & (log.t_s < t + 4.0)]))
    turning = (log.t_s >= start) & (log.t_s < start + 2.0)
    plain, turned = (
        examine("log", replace(log, gyro_dps=log.gyro_dps + dps * turning), resting, None)
        for dps in (0.0, 15.0)
    )
    assert not {*turned.yaw.chosen} & {"jump"}
    assert turned.yaw.estimate("bias")[0] == pytest.approx(plain.yaw.estimate("bias")[0], abs=2e-3)
    since_s = start - log.t_s[0]
    assert any(x.from_s < since_s + 2.0 and x.to_s > since_s for x in left_out(turned.yaw))


def test_a_slip_in_the_last_row_is_left_out_too(resting: Robot) -> None:
    log = drive(replace(PLAN, minutes=4.0), 6)
    found = examine("log", slipping(log, [log.t_s[-1]], [0.02]), resting, None)
    last = left_out(found.yaw)[-1]
    assert last.to_s == pytest.approx(log.t_s[-1] - log.t_s[0], abs=0.1)
    assert last.turn_deg == pytest.approx(np.degrees(0.02) / resting.wheel_separation_m, abs=0.2)


@pytest.mark.slow
def test_wheels_that_differ_now_and_then_have_no_name(resting: Robot) -> None:
    """The mean of what comes and goes is another one on the next drive: it is noise, of that size and with its memory."""
    log = drive(PLAN, 6)
    on = np.random.default_rng(3).normal(size=60)[((log.t_s - log.t_s[0]) / 8.01).astype(np.int64)] > 0.0
    for mean, amplitude in ((0.004, 0.0), (0.002, 0.006)):
        half = 0.5 * (mean + amplitude * np.where(on, 1.0, -1.0))
        unlike = replace(log, left_m=log.left_m * (1.0 - half), right_m=log.right_m * (1.0 + half))
        found = examine("log", unlike, resting, None).yaw
        assert ("asymmetry" in found.named) == (amplitude == 0.0)
        assert found.model.noise.wheel_wander == pytest.approx(amplitude, rel=0.2, abs=2e-4)


def test_the_mean_of_a_law_is_weighed_by_what_its_parts_differ() -> None:
    """F of 1 and 23 is beyond 14.2 once in 1000: the mean gains what one of 23 parts does, times that."""
    assert not outlasts(14.0, GainTest(23.0, 23, 1e-4))
    assert outlasts(15.0, GainTest(23.0, 23, 1e-4))
    assert not outlasts(15.0, GainTest(46.0, 23, 1e-4))


@pytest.mark.slow
@pytest.mark.parametrize("one_way", [False, True])
def test_a_scale_of_the_turns_one_way_is_none_of_all_turns(one_way: bool, resting: Robot) -> None:
    """On figures of eight it looks like half of it and a bias in motion."""
    log = drive(replace(PLAN, shape="eights", truth_m=0.02), 5)
    more = np.where(log.gyro_dps > 0.5, 0.003, 0.0 if one_way else 0.003)
    found = examine("log", replace(log, gyro_dps=log.gyro_dps * (1.0 + more)), resting, None)
    assert found.truth is not None
    assert (found.truth.one_way[""] > 0.0) == one_way
    assert [*found.parts] == ([] if one_way else ["gyro_scale"])
    assert ("turn_rate" in [c for c, p in found.truth.odd.items() if p < STRANGER_P]) == one_way


def test_a_bias_is_not_lost_in_columns_without_a_name() -> None:
    """Beside six columns of the heading the bias of this log, which a rest of 57 s tells, had been -11 deg/s and its scale lost."""
    practice = SHARED / "concealed-drives" / "drive-13"
    if not practice.is_dir():
        pytest.skip("the practice drives in ../shared are not here")
    robot = read_robot(practice / "robot.toml")
    log = read_drive(practice / "log.csv", robot)
    log = cut(log, slice(0, int(np.searchsorted(log.t_s, 184.7))))
    found = examine("log", log, robot, None)
    assert abs(found.yaw.estimate("bias")[0]) < 0.1
    assert found.parts["gyro_scale"].value == pytest.approx(-0.0076, abs=0.0015)
