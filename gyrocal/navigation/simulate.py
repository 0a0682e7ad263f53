"""A simulated skid-steer robot with the virtual bench's gyro on it. Nothing here is seen by filter or calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.path import Motion, TruePath, drive, square_via_points
from gyrocal.physics.drive import WANDER_TAU_S
from gyrocal.physics.gyro import GyroModel, GyroStream
from gyrocal.records.drive import DriveBlock
from gyrocal.units import DEG_TO_RAD, DPH_TO_DPS, EARTH_RATE_DPH, RAD_TO_DEG, S_PER_MIN

Floats = NDArray[np.float64]

CW, CCW = -1, 1

#: Standard deviation of 1/f noise of instability 1 in a decade of frequency (its density is 1 / (2 pi f)).
_PER_DECADE = (np.log(10.0) / (2.0 * np.pi)) ** 0.5
#: Length of a run, and of a row of its log, s.
_RUN_S, _STEP_S = 180.0, 0.1

#: Names of the random streams of an experiment: what is drawn for one purpose never shifts another.
_STREAM_ROBOT, _STREAM_DAY, _STREAM_RUN = 1, 2, 3


@dataclass(frozen=True)
class Spread:
    """What is known of the robot beforehand: nominal values, and how far a real one may be from them.

    Attributes
    ----------
    wheel_separation_m : float
        Nominal effective separation: a skid steer turns as if its wheels stood wider apart than they do.
    separation_std, separation_run_std : float
        Relative error of the effective separation: of the robot, and from run to run (surface).
    wheel_scale_std : float
        Relative error of each side's wheel radius.
    metres_per_tick : float
    turn_slip_deg_per_rt_deg : float
        Random walk of the wheels' slip in turns: its standard deviation after a turn of one degree.
    bumps_per_m, bump_m : float
        Bumps a metre on each side, and the mean distance that one adds to the count (never takes away).
    """

    wheel_separation_m: float = 0.60
    separation_std: float = 0.03
    separation_run_std: float = 0.005
    wheel_scale_std: float = 0.002
    metres_per_tick: float = 2.6e-5
    turn_slip_deg_per_rt_deg: float = 0.1
    bumps_per_m: float = 1.0
    bump_m: float = 0.0005


@dataclass(frozen=True)
class Day:
    """Where and when the drives happen.

    Attributes
    ----------
    temp_c, temp_run_std_c, drift_std_c_per_min : float
        Gyro temperature of the day, its spread from run to run, and its drift within a run.
    latitude_deg : float
        The gyro senses the vertical part of the Earth's rate (Ann Arbor's, where the paper's robot drove).
    """

    temp_c: float
    temp_run_std_c: float = 1.0
    drift_std_c_per_min: float = 0.2
    latitude_deg: float = 42.3


@dataclass(frozen=True)
class SimulatedRobot:
    """One robot as it really is: the encoders count ``(1 + scale)`` times the true travel (paper eq. 7)."""

    spread: Spread
    scale_left: float
    scale_right: float
    wheel_separation_m: float


@dataclass(frozen=True)
class SimulatedRun:
    """A drive: its log (distances in whole ticks), direction (+1 counter-clockwise), and tick size."""

    name: str
    direction: int
    log: DriveBlock
    metres_per_tick: float


def draw_robot(spread: Spread, seed: int) -> SimulatedRobot:
    """Draw a robot from its spread."""
    rng = np.random.default_rng([seed, _STREAM_ROBOT])
    left, right = rng.normal(0.0, spread.wheel_scale_std, 2)
    separation = spread.wheel_separation_m * (1.0 + rng.normal(0.0, spread.separation_std))
    return SimulatedRobot(spread, float(left), float(right), float(separation))


def draw_day(seed: int, low_c: float = 5.0, high_c: float = 35.0) -> Day:
    """Draw the temperature of a day on which one drives outdoors."""
    return Day(float(np.random.default_rng([seed, _STREAM_DAY]).uniform(low_c, high_c)))


def simulate_experiment(
    model: GyroModel,
    robot: SimulatedRobot,
    day: Day,
    seed: int,
    *,
    runs: int = 5,
    directions: tuple[int, ...] = (CW, CCW),
    static_s: float = 10.0,
) -> list[SimulatedRun]:
    """Drive the square `runs` times in each direction; the same seed gives the same logs.

    Parameters
    ----------
    model : GyroModel
        The gyro on the robot, as it really is.
    seed : int
        Of everything random in the drives; each run has a stream of its own.
    """
    motion = Motion()
    paths = {d: drive(square_via_points(motion, d), motion, _STEP_S, static_s) for d in directions}
    result = []
    for direction in directions:
        for k in range(runs):
            rng = np.random.default_rng([seed, _STREAM_RUN, direction + 1, k])
            log = simulate_log(paths[direction], model, robot, day, rng)
            name = f"{'ccw' if direction == CCW else 'cw'}{k + 1}"
            result.append(SimulatedRun(name, direction, log, robot.spread.metres_per_tick))
    return result


def simulate_log(
    path: TruePath, model: GyroModel, robot: SimulatedRobot, day: Day, rng: np.random.Generator
) -> DriveBlock:
    """What the robot's encoders and gyro write while it drives `path`."""
    left_m, right_m = encoder_steps(path, robot, rng)
    drift_c_per_s = rng.normal(0.0, day.drift_std_c_per_min) / S_PER_MIN
    temp_c = day.temp_c + rng.normal(0.0, day.temp_run_std_c) + drift_c_per_s * path.t_s
    earth_dps = EARTH_RATE_DPH * DPH_TO_DPS * np.sin(day.latitude_deg * DEG_TO_RAD)
    gyro = GyroStream(model, rng)
    gyro_dps = gyro.samples(_STEP_S, path.turn_deg / _STEP_S + earth_dps, temp_c)
    reported_c = gyro.temperatures(temp_c)
    return DriveBlock(
        2, path.t_s, left_m, right_m, gyro_dps, reported_c, path.x_m, path.y_m, path.heading_deg
    )


def encoder_steps(path: TruePath, robot: SimulatedRobot, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Distance since the row before of the left and right side, in whole ticks."""
    spread = robot.spread
    run_factor = 1.0 + rng.normal(0.0, spread.separation_run_std)
    slip_deg = spread.turn_slip_deg_per_rt_deg * np.sqrt(np.abs(path.turn_deg))
    turn_deg = run_factor * path.turn_deg + slip_deg * rng.standard_normal(path.t_s.size)
    half_m = 0.5 * robot.wheel_separation_m * turn_deg * DEG_TO_RAD
    sides = []
    for travel_m, scale in (
        (path.distance_m - half_m, robot.scale_left),
        (path.distance_m + half_m, robot.scale_right),
    ):
        bumps = rng.poisson(spread.bumps_per_m * np.abs(travel_m))
        # The sum of k exponentials is a gamma of shape k; zero bumps add nothing.
        added_m = spread.bump_m * rng.gamma(np.maximum(bumps, 1)) * (bumps > 0)
        counted_m = travel_m * (1.0 + scale) + added_m
        ticks = np.floor(np.cumsum(counted_m) / spread.metres_per_tick)
        sides.append(np.diff(ticks, prepend=0.0) * spread.metres_per_tick)
    return sides[0], sides[1]


def robot_figures(
    spread: Spread, static_s: float, gyro_scale: float = 0.02, bias_instability_deg_per_h: float = 1.8
) -> dict[str, Any]:
    """Keys of a robot file for a robot of this spread.

    One set of figures for every condition: what the builder of the robot knows (`Spread`), the gyro's data sheet
    (angle random walk, bias stability, and `gyro_scale`: a cubic of 0.5 % rms of full scale about its best line
    has a slope of 2 % at small rates), and one tick of rounding. The filter knows no 1/f noise: its random walk of
    the bias departs from the mean at rest, in the mean of a run, by as much as 1/f noise does (Allan floor 0.664 B).
    """
    walk = 2.0**0.5 * 0.664 * bias_instability_deg_per_h * DPH_TO_DPS / (_RUN_S / 3.0) ** 0.5
    tick_deg = spread.metres_per_tick / spread.wheel_separation_m * RAD_TO_DEG
    return {
        "wheel_separation_m": spread.wheel_separation_m,
        "metres_per_tick": spread.metres_per_tick,
        "static_s": static_s,
        "initial_std": {
            "x_m": 0.0,
            "y_m": 0.0,
            "heading_deg": 0.0,
            "right_scale": spread.wheel_scale_std,
            "left_scale": spread.wheel_scale_std,
            "wheel_separation_m": spread.separation_std * spread.wheel_separation_m,
            "gyro_heading_deg": 0.0,
            "gyro_scale": gyro_scale,
            "gyro_bias_dps": 0.002,
        },
        "noise": {
            # Bumps come as a compound Poisson process: variance a metre = rate times the mean square of a bump.
            "wheel_slip_m_per_rt_m": (2.0 * spread.bumps_per_m) ** 0.5 * spread.bump_m,
            "turn_slip_deg_per_rt_deg": spread.turn_slip_deg_per_rt_deg,
            "angle_random_walk_deg_per_rt_h": 5.0 / 60.0,
            "bias_walk_dps_per_rt_s": walk,
            "heading_noise_deg": tick_deg,
            "tick_m": spread.metres_per_tick,
            "jitter_s": 0.0,
            "flicker_dps": _PER_DECADE * bias_instability_deg_per_h * DPH_TO_DPS,
            "track_wander": 0.0,
            "track_wander_s": WANDER_TAU_S,
            "wheel_wander": 0.0,
            "wheel_wander_s": WANDER_TAU_S,
        },
    }
