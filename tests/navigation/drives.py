"""What the tests of this room share: a simulated drive, its robot file, and a calibration of its gyro."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion import Coefficients
from gyrocal.navigation.bench import calibrate_unit
from gyrocal.navigation.equip import DriveSource
from gyrocal.navigation.montecarlo import World, simulate_drives, simulated_robot_file, unit_of
from gyrocal.navigation.simulate import CCW, CW
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.robot import Robot

Floats = NDArray[np.float64]

WORLD = World(runs=1)


@cache
def drive(direction: int = CCW, seed: int = 1) -> DriveBlock:
    """One simulated square, unit 1; never change it in place."""
    (run,) = simulate_drives(WORLD, unit_of(WORLD, 1), seed, (direction,))
    return run.log


@cache
def calibration() -> Coefficients:
    """Coefficients of unit 1."""
    return calibrate_unit(unit_of(WORLD, 1), np.random.default_rng(4))


def robot() -> Robot:
    """The robot file of the simulated robot."""
    return simulated_robot_file(WORLD)


def source(log: DriveBlock, chunk_rows: int = 10**9, name: str = "log") -> DriveSource:
    """A log in memory as `replay_log` takes it, in blocks."""

    def blocks() -> Iterator[DriveBlock]:
        for start in range(0, len(log), chunk_rows):
            yield cut(log, slice(start, start + chunk_rows))

    return DriveSource(name, blocks)


def _with(**changes: Callable[[DriveBlock], Floats]) -> Callable[[DriveBlock], DriveBlock]:
    def spoil(log: DriveBlock) -> DriveBlock:
        new: dict[str, Any] = {name: change(log) for name, change in changes.items()}
        return replace(log, **new)

    return spoil


#: What can be wrong with a log: name -> (how it comes about, what must be said of it).
BAD: dict[str, tuple[Callable[[DriveBlock], DriveBlock], str]] = {
    "totals of a robot on the spot": (
        _with(
            left_m=lambda b: -np.cumsum(np.abs(b.gyro_dps)) / 60.0,
            right_m=lambda b: np.cumsum(np.abs(b.gyro_dps)) / 60.0,
        ),
        "distances since the row before, in metres",
    ),
    "gyro stuck": (
        _with(gyro_dps=lambda b: np.full(len(b), 0.25)),
        "gyro_dps is 0.25 in every row while the encoders turn",
    ),
    "kelvin": (
        _with(gyro_temp_c=lambda b: b.gyro_temp_c + 273.15),
        "no gyro works so hot. Convert them if they are in kelvin",
    ),
    "gyro sticks half-way": (
        _with(gyro_dps=lambda b: np.where(b.t_s > 80, 0.25, b.gyro_dps)),
        "gyro_dps does not change for 97 s of 177 s; the gyro is stuck.",
    ),
    "both encoders stuck": (
        _with(left_m=lambda b: np.zeros(len(b)), right_m=lambda b: np.zeros(len(b))),
        "the encoders move 0 m in all: the robot stood, or both are stuck.",
    ),
    "both encoders stick half-way": (
        _with(
            left_m=lambda b: np.where(b.t_s > 80, 0.0, b.left_m),
            right_m=lambda b: np.where(b.t_s > 80, 0.0, b.right_m),
        ),
        "s in which neither encoder moves; both are stuck",
    ),
    "left encoder stuck": (
        _with(left_m=lambda b: np.zeros(len(b))),
        "the left encoder moves 0 m while the other moves",
    ),
    "right encoder stuck": (
        _with(right_m=lambda b: np.zeros(len(b))),
        "the right encoder moves 0 m while the other moves",
    ),
    "gyro empty": (
        _with(gyro_dps=lambda b: np.where(np.arange(len(b)) % 10 == 0, np.nan, b.gyro_dps)),
        "gyro_dps is empty in 178 of 1774 rows; up to 5% can be bridged. Repair the log.",
    ),
    "encoder empty": (
        _with(left_m=lambda b: np.where(np.arange(len(b)) % 10 == 0, np.nan, b.left_m)),
        "left or right distance is empty in 178 of 1774 rows",
    ),
    "gyro saturated": (
        _with(gyro_dps=lambda b: np.clip(b.gyro_dps, -20.0, 20.0)),
        "it is saturated. Drive slower turns",
    ),
    "gyro inverted": (
        _with(gyro_dps=lambda b: -b.gyro_dps),
        "the gyro's sign is inverted, or left and right encoders are swapped. State the signs",
    ),
    "encoders swapped": (
        _with(left_m=lambda b: b.right_m, right_m=lambda b: b.left_m),
        "the gyro's sign is inverted, or left and right encoders are swapped. State the signs",
    ),
    "left inverted": (_with(left_m=lambda b: -b.left_m), "the left encoder's sign is inverted"),
    "right inverted": (_with(right_m=lambda b: -b.right_m), "the right encoder's sign is inverted"),
    "gyro in rad/s": (
        _with(gyro_dps=lambda b: np.radians(b.gyro_dps)),
        "a factor near 0.0175 is rad/s logged as deg/s",
    ),
    "gyro in deg/h": (
        _with(gyro_dps=lambda b: 3600.0 * b.gyro_dps),
        "no robot turns so fast: it is in mdeg/s (1,000 times), in deg/h (3,600 times), or in counts.",
    ),
    "gyro converted twice": (
        _with(gyro_dps=lambda b: np.degrees(b.gyro_dps)),
        "a factor near 57.3 is a rate in deg/s converted twice",
    ),
    "another robot's gyro": (
        _with(gyro_dps=lambda b: np.roll(b.gyro_dps, 250)),
        "encoder and gyro turns have nothing in common",
    ),
    "millimetres": (
        _with(left_m=lambda b: 1e3 * b.left_m, right_m=lambda b: 1e3 * b.right_m),
        "left_m and right_m are distances since the row before, in metres.",
    ),
    "no rest": (
        lambda b: cut(b, slice(150, None)),
        "the robot moves in its first 10 s",
    ),
    "one time": (_with(t_s=lambda b: np.zeros(len(b))), "all rows carry the same time."),
}


def both_ways() -> tuple[DriveBlock, DriveBlock]:
    """The same square clockwise and counter-clockwise."""
    return drive(CW), drive(CCW)
