"""Noise by the filter's own likelihood, and whether the filter describes a log at all."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import DataError
from gyrocal.fusion import Aligner, Navigator, RobotParameters, Rows
from gyrocal.navigation import levels
from gyrocal.navigation.equip import equip
from gyrocal.navigation.judge import ERRS, judge
from gyrocal.navigation.levels import LAG1_LIMIT, NIS_RANGE, Whiteness, rest_walk, whiteness
from gyrocal.navigation.replay import LogReplay, replay_log
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot, read_robot, robot_of
from gyrocal.report.navigation import filter_sentence
from tests.diagnosis.drive.fleet import Plan, drive
from tests.fusion.test_model import NOISE, ROBOT, Drive, draw
from tests.navigation.drives import source

SILENT = Robot(Path("robot.toml"), ROBOT)


def log_of(drive: Drive) -> DriveBlock:
    nothing = np.full(drive.t_s.size, np.nan)
    truth = (drive.x_m, drive.y_m, drive.heading_deg)
    return DriveBlock(2, drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps, nothing, *truth)


def rows_of(log: DriveBlock) -> Rows:
    return Aligner(ROBOT).push(log.t_s, log.left_m, log.right_m, log.gyro_dps, log.gyro_temp_c)


def test_the_walk_of_the_gyro_is_that_of_its_rests() -> None:
    found = [rest_walk(rows_of(log_of(draw(np.random.default_rng(s), rest_s=40.0)))) for s in range(5)]
    known = [walk for walk in found if walk is not None]
    assert len(known) == 5
    assert np.mean(known) == pytest.approx(NOISE.angle_random_walk_deg_per_rt_h, rel=0.1)
    moving = log_of(draw(np.random.default_rng(0), rest_s=0.0))
    assert rest_walk(rows_of(replace(moving, left_m=moving.left_m + 1e-3))) is None


def test_innovations_that_are_all_nothing_are_not_those_of_a_filter() -> None:
    assert not whiteness(np.zeros(50)).describes


@pytest.mark.parametrize("given", [{}, {"angle_random_walk_deg_per_rt_h": 0.0}])
def test_a_gyro_without_noise_at_rest_tells_no_walk(given: dict[str, float]) -> None:
    log = log_of(draw(np.random.default_rng(0), rest_s=20.0, duration_s=120.0))
    still = replace(log, gyro_dps=np.where(log.left_m == 0.0, 0.0, log.gyro_dps))
    assert rest_walk(rows_of(still)) is None
    robot = robot_of({"wheel_separation_m": 0.5, "static_s": 0.0, "noise": given}, Path("robot.toml"))
    assert equip(source(still), robot, "model", None, None).robot.noise.flicker_dps > 0.0


def test_levels_that_the_file_leaves_open_are_found() -> None:
    found = [
        equip(source(log_of(draw(np.random.default_rng(s)))), SILENT, "model", None, None).robot.noise
        for s in range(3)
    ]
    for name, spread in (("wheel_slip_m_per_rt_m", 0.5), ("turn_slip_deg_per_rt_deg", 0.4), ("tick_m", 0.7)):
        size = np.exp(np.mean([np.log(getattr(noise, name)) for noise in found]))
        assert abs(np.log(size / getattr(NOISE, name))) < spread, name


@pytest.mark.parametrize("walk", [0.05, 0.2])
def test_a_walk_that_neither_file_nor_rest_tells_is_asked_of_the_drive(walk: float) -> None:
    plan = Plan("random", 6.0, 20.0, rest_s=0.0, arw_dps_rt_s=walk / 60.0, tick_m=4e-4)
    silent = robot_of({"wheel_separation_m": plan.separation_m, "static_s": 0.0}, Path("robot.toml"))
    found = equip(source(drive(plan, 3)), silent, "model", None, None).robot.noise
    assert abs(np.log(found.angle_random_walk_deg_per_rt_h / walk)) < 1.0
    known = silent.with_figures({"noise.angle_random_walk_deg_per_rt_h": walk})
    told = equip(source(drive(plan, 3)), known, "model", None, None).robot.noise
    assert told.angle_random_walk_deg_per_rt_h == walk


def test_levels_of_the_file_with_their_deviations_hold() -> None:
    given = SILENT.with_figures(
        {"noise.wheel_slip_m_per_rt_m": 0.02, "noise.wheel_slip_m_per_rt_m_std": 0.0001}
    )
    noise = equip(source(log_of(draw(np.random.default_rng(1)))), given, "model", None, None).robot.noise
    assert noise.wheel_slip_m_per_rt_m > 0.015


@pytest.mark.parametrize(("bias_dps", "low", "high"), [(0.0, 0.0, 0.05), (0.8, 0.7, 0.9)])
def test_the_rests_of_a_log_say_how_large_a_bias_is_likely(bias_dps: float, low: float, high: float) -> None:
    drive = draw(np.random.default_rng(4), rest_s=20.0)
    biased = log_of(replace(drive, gyro_dps=drive.gyro_dps + bias_dps))
    std = replace(ROBOT.initial_std, gyro_bias_dps=0.2)
    silent = Robot(Path("robot.toml"), replace(ROBOT, initial_std=std))
    found = equip(source(biased), silent, "model", None, None).robot.initial_std.gyro_bias_dps
    assert low < (found or 0.0) < high


@pytest.mark.parametrize("sure", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_file_that_is_too_sure_of_its_bias_does_not_bend_the_way_before_the_first_rest(sure: bool) -> None:
    """The first rest had been beyond the gate, and the way before it had stayed as the file's bias had it."""
    plan = Plan(
        "rests", 6.0, 20.0, rest_s=0.0, bias_dps=0.3, tick_m=2e-4, truth_m=0.01, truth_heading_deg=0.05
    )
    figures = {
        "wheel_separation_m": 0.5,
        "static_s": 0.0,
        "initial_std": {"gyro_bias_dps": 0.01 if sure else 0.3},
    }
    replay = replay_log(source(drive(plan, 1)), robot_of(figures, Path("robot.toml")))
    alone = replay.track("uncalibrated")
    assert alone is not None
    assert alone.heading_errors is not None
    assert alone.heading_errors.rms_deg < 2.0


def test_whiteness_of_white_and_of_smoothed_noise() -> None:
    white = np.random.default_rng(2).normal(size=100_000)
    seen, smooth, none = whiteness(white), whiteness(np.convolve(white, [0.5, 0.5])), whiteness(np.empty(0))
    assert (seen.nis, seen.lag1) == pytest.approx((1.0, 0.0), abs=0.02)
    # Of 1000 sums: four standard deviations of their mean square.
    assert seen.slow == pytest.approx(1.0, abs=0.18)
    assert seen.describes
    assert (smooth.nis, smooth.lag1) == pytest.approx((0.5, 0.5), abs=0.02)
    assert not smooth.describes
    assert np.isnan([none.nis, none.lag1, none.slow]).all()


def test_what_hides_in_each_innovation_shows_in_their_sums() -> None:
    """A tenth of a standard deviation that comes and goes with the heading."""
    white = np.random.default_rng(2).normal(size=5000)
    seen = whiteness(white + 0.2 * np.sin(np.arange(5000) / 100.0))
    assert NIS_RANGE[0] < seen.nis < NIS_RANGE[1]
    assert abs(seen.lag1) < LAG1_LIMIT
    assert not seen.describes


def replayed(drive: Drive) -> LogReplay:
    return replay_log(source(log_of(drive)), SILENT, method="start")


def test_a_filter_that_holds_is_said_to_hold_and_by_what_it_beats_the_gyro() -> None:
    found = replayed(draw(np.random.default_rng(3), rest_s=1.0))
    judged = found.judgements["uncalibrated_filter"]
    assert judged.consistent
    text = filter_sentence([found])
    assert text.startswith("The filter is consistent (NIS ")
    assert "the gyro" in text


@pytest.mark.slow
def test_encoders_that_are_smoothed_leave_the_heading_to_the_gyro() -> None:
    drive = draw(np.random.default_rng(4))
    box = np.full(15, 1.0 / 15.0)
    late = replace(
        drive,
        left_m=np.convolve(drive.left_m, box)[: drive.t_s.size],
        right_m=np.convolve(drive.right_m, box)[: drive.t_s.size],
    )
    found = replayed(late)
    judged = found.judgements["uncalibrated_filter"]
    assert not judged.consistent
    assert judged.left_to_gyro
    alone, filtered = found.tracks
    np.testing.assert_array_equal(filtered.x_m, alone.x_m)
    assert filter_sentence([found]).endswith("is left to the gyro.")


def test_of_one_speed_no_turns_of_the_wheels_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but its rests tells of noise: fitted to wheels that never turn, levels ran away, and the replay with them."""
    one = log_of(draw(np.random.default_rng(5)))
    middle = 0.5 * (one.left_m + one.right_m)
    one = replace(one, left_m=middle, right_m=middle, speed_only=True)
    usual = levels.misfit

    def at_rest(rows: Rows, navigator: Navigator) -> float:
        assert not navigator.filtering
        return usual(rows, navigator)

    monkeypatch.setattr(levels, "misfit", at_rest)
    found = replay_log(source(one), SILENT, method="start")
    (track,) = found.tracks
    assert np.isfinite(track.x_m).all()


def test_levels_with_which_the_filter_runs_away_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, calls = levels.misfit, []

    def sometimes(rows: Rows, navigator: Navigator) -> float:
        calls.append(navigator.filtering)
        if navigator.filtering and len(calls) % 2 == 0:
            raise DataError("position or heading is no longer finite")
        return usual(rows, navigator)

    monkeypatch.setattr(levels, "misfit", sometimes)
    found = replayed(draw(np.random.default_rng(3), duration_s=60.0))
    assert len(calls) > 2
    assert np.isfinite(found.tracks[1].x_m).all()


def test_robot_and_replay_share_their_defaults(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text("wheel_separation_m = 0.5\nstatic_s = 0\n")
    drive = draw(np.random.default_rng(6), duration_s=60.0)
    for kind in ("paper", "model"):
        on_robot = Navigator(RobotParameters(0.5, static_s=0.0), kind=kind)
        in_replay = equip(source(log_of(drive)), read_robot(path), "paper", None, None)
        assert in_replay.robot == on_robot.robot
        paths = [
            n.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)
            for n in (on_robot, Navigator(in_replay.robot, kind=kind))
        ]
        np.testing.assert_array_equal(paths[0].std, paths[1].std)


def test_a_filter_is_followed_where_it_moves_the_path_by_more_than_it_is_unsure_of() -> None:
    found = replayed(draw(np.random.default_rng(3), rest_s=1.0))
    alone, filtered = found.tracks
    sure = replace(
        filtered, whiteness=Whiteness(1.0, 0.0, 1.0, 10), drift_m=3.0, x_m=alone.x_m, y_m=alone.y_m
    )
    alone = replace(alone, drift_m=5.0)
    # What either path errs by, drawn: both by what the filter promises, the gyro by what the filter took off it as well, and the
    # filter by what it does not know of itself.
    rng, n = np.random.default_rng(4), 4_000_000
    taken_m, own_m = 4.0 * rng.normal(size=n), 3.0 * math.sqrt(ERRS**2 - 1.0) * rng.normal(size=n)
    for apart_m, left in ((0.0, True), (1.0, True), (4.0, False)):
        seen = np.abs(taken_m - own_m - apart_m) < 0.1
        filter_m, gyro_m = (math.sqrt(9.0 + np.mean(x[seen] ** 2)) for x in (own_m, taken_m))
        judged = judge(alone, replace(sure, y_m=alone.y_m + apart_m))
        assert judged.gain == pytest.approx(filter_m / gyro_m, abs=3e-3)
        assert judged.left_to_gyro == left


def test_a_filter_that_hardly_betters_the_gyro_is_not_followed_however_far_it_moves_the_path() -> None:
    """As where slip lasts for a turn, which no innovation shows: what it moves is then its own error as likely as the gyro's."""
    found = replayed(draw(np.random.default_rng(3), rest_s=1.0))
    alone, filtered = found.tracks
    sure = replace(filtered, whiteness=Whiteness(1.0, 0.0, 1.0, 10), drift_m=1.7, x_m=alone.x_m)
    judged = judge(replace(alone, drift_m=2.0), replace(sure, y_m=alone.y_m + 2.0))
    assert judged.consistent
    assert judged.left_to_gyro


def test_a_filter_that_moves_the_path_by_more_than_both_deviations_allow_is_not_followed() -> None:
    """As on a slope, where the wheels are loaded on one side and no innovation shows it."""
    found = replayed(draw(np.random.default_rng(3), rest_s=1.0))
    alone, filtered = found.tracks
    alone = replace(alone, drift_m=5.0)
    sure = replace(filtered, whiteness=Whiteness(1.0, 0.0, 1.0, 10), drift_m=3.0, x_m=alone.x_m)
    for apart_m, times, kept in ((8.0, 2.0, True), (12.0, 3.0, False)):
        judged = judge(alone, replace(sure, y_m=alone.y_m + apart_m))
        assert judged.apart == pytest.approx(times)
        assert judged.consistent == kept
        assert judged.left_to_gyro != kept
    unsaid = replace(sure, y_m=alone.y_m + 12.0, drift_m=math.nan)
    assert judge(alone, unsaid).consistent
