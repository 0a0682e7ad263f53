"""Rests of a vehicle whose speed has noise where it stands, and those of one that creeps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.engine import examine
from gyrocal.diagnosis.drive.improved import improved_robot
from gyrocal.diagnosis.drive.rests import moving_rows
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import robot_of

Floats = NDArray[np.float64]
ROW_S, REST_S = 0.1, 20.0
T_S = ROW_S * np.arange(1, 2001, dtype=np.float64)
DRIVES = T_S > REST_S


def logged(
    floor_mps: float = 0.01,
    *,
    creeps_mps: float = 0.0,
    turns_dps: float = 0.0,
    shakes_dps: float = 0.02,
    seed: int = 1,
) -> tuple[Floats, Floats]:
    """Way of each row and rate of a gyro with a bias of -0.4 deg/s: 20 s of rest, or of creeping in bends, then 180 s of bends."""
    rng = np.random.default_rng(seed)
    speed = np.where(DRIVES, 1.5 + 0.3 * np.sin(T_S / 9.0), creeps_mps)
    turn = np.where(DRIVES, 20.0 * np.sin(T_S / 5.0), turns_dps * np.sin(T_S / 3.0))
    noise = np.where(DRIVES, 0.3, shakes_dps) * rng.standard_normal(T_S.size)
    read = np.abs(speed + floor_mps * rng.standard_normal(T_S.size))
    return read * ROW_S, turn - 0.4 + noise


def stands(way_m: Floats, gyro_dps: Floats) -> tuple[NDArray[np.bool_], list[Remark]]:
    moving, said = moving_rows(T_S, np.full(T_S.size, ROW_S), (way_m, way_m), (0.0, 0.0), gyro_dps)
    return ~moving, said


@pytest.mark.parametrize("seed", range(5))
def test_a_speed_that_reads_its_noise_at_rest_has_rests(seed: int) -> None:
    rests, said = stands(*logged(seed=seed))
    # The mean over a second knows the start half a second ahead.
    assert rests[T_S < REST_S - 1.0].all()
    assert not rests[DRIVES].any()
    (remark,) = said
    assert remark.said is Said.STANDS
    assert remark.facts["total_s"] == pytest.approx(REST_S, abs=1.0)


def test_the_speed_that_is_said_is_of_rows_that_last() -> None:
    """The first row of a log has no time before it."""
    way_m, gyro_dps = logged()
    dt_s = np.where(np.arange(T_S.size) == 0, 0.0, ROW_S)
    _, (remark,) = moving_rows(T_S, dt_s, (way_m, way_m), (0.0, 0.0), gyro_dps)
    assert 0.02 < remark.facts["most_mps"] < 0.06


@pytest.mark.parametrize(("creeps_mps", "turns_dps"), [(0.0, 0.1), (0.1, 0.0)])
def test_one_that_creeps_does_not_rest(creeps_mps: float, turns_dps: float) -> None:
    """Slow bends of a tenth of a degree a second, which would have been a bias; and a speed of 6 % of the usual one."""
    rests, said = stands(*logged(creeps_mps=creeps_mps, turns_dps=turns_dps))
    # Single rows read nearly zero.
    assert np.mean(rests[~DRIVES]) < 0.3
    assert not said


def test_of_stretches_alike_in_speed_only_those_count_in_which_the_gyro_is_quiet() -> None:
    way, gyro = logged()
    # From 100 s to 115 s it rolls, evenly, and shakes.
    rolls = (T_S > 100.0) & (T_S < 115.0)
    way[rolls] = 0.01 * ROW_S
    gyro[rolls] = 0.2 * np.random.default_rng(3).standard_normal(np.count_nonzero(rolls)) + 0.6
    rests, _ = stands(way, gyro)
    assert rests[T_S < REST_S - 1.0].all()
    assert not rests[rolls].any()


def test_where_a_speed_reads_zero_at_its_rests_slow_rows_are_no_rest() -> None:
    way, gyro = logged(0.0, creeps_mps=0.01)
    way[(T_S > 150.0) & (T_S < 160.0)] = 0.0
    rests, said = stands(way, gyro)
    assert not rests[~DRIVES].any()
    assert rests[(T_S > 150.1) & (T_S < 159.9)].all()
    assert not said


def test_the_bias_of_such_a_rest_is_told_and_written_though_replay_refuses_it() -> None:
    """`static_s` promises the rest, `replay` refuses it for the wheels' sake, and the file had been without a bias."""
    way, gyro = logged()
    nothing = np.full(T_S.size, np.nan)
    log = DriveBlock(
        2, T_S, way, way, gyro, nothing, nothing, nothing, nothing, nothing, np.zeros(T_S.size, np.int64)
    )
    log = replace(log, speed_only=True)
    robot = robot_of({"static_s": 15.0}, Path("robot.toml"))
    found = examine("log", log, robot, None)
    assert found.figures.bias_dps == pytest.approx(-0.4, abs=0.01)
    assert not found.series.rested
    (refused,) = [n for n in found.notes if n.said is Said.NO_REST]
    assert "the robot moves in its first 15 s" in refused.facts["why"]
    written = improved_robot(found.series, found.yaw, found.truth, found.parts, found.figures)
    assert written is not None
    assert written.parameters.gyro.bias_dps == pytest.approx(-0.4, abs=0.01)


def test_where_it_creeps_in_an_even_bend_there_is_no_rest() -> None:
    """Of a new user: 0.25 deg/s in each of its slow stretches became the bias, and a second drive went from 10.8 to 16.3 m."""
    rng = np.random.default_rng(4)
    t_s = ROW_S * np.arange(1, 4001, dtype=np.float64)
    slow = t_s % 50.0 < 14.0
    speed = np.where(slow, 0.015, 2.5)
    turn_dps = np.where(slow, 0.25, 20.0 * np.sin(t_s / 5.0))
    heading = np.deg2rad(np.cumsum(turn_dps) * ROW_S)
    at = np.cumsum(speed * np.exp(1j * heading)) * ROW_S
    way = np.abs(speed + 0.003 * rng.standard_normal(t_s.size)) * ROW_S
    gyro = turn_dps + 0.05 + 0.02 * rng.standard_normal(t_s.size)
    east, north = (
        np.where(np.arange(t_s.size) % 5 == 0, x + 0.05 * rng.standard_normal(t_s.size), np.nan)
        for x in (at.real, at.imag)
    )
    nothing, segment = np.full(t_s.size, np.nan), np.zeros(t_s.size, np.int64)
    log = DriveBlock(2, t_s, way, way, gyro, nothing, east, north, nothing, nothing, segment)
    robot = robot_of({"static_s": 0.0}, Path("robot.toml"))
    found = examine("log", replace(log, speed_only=True), robot, None)
    said = {n.said for n in (*found.notes, *found.series.notes) if isinstance(n, Remark)}
    assert Said.CREEPS in said
    assert Said.STANDS not in said
    assert found.figures.bias_dps == pytest.approx(0.05, abs=0.02)
