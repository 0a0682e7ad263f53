"""Drives whose truth comes from the filter's own model, by code that shares nothing with it."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion import Navigator, RobotParameters

Floats = NDArray[np.float64]

#: The paper's filter, of which this drive is the model.
paper = partial(Navigator, kind="paper")


@dataclass(frozen=True)
class Drive:
    """Log and truth; `errors` are the true nine errors at the end, in the order and units of STATES."""

    t_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    x_m: Floats
    y_m: Floats
    heading_deg: Floats
    constants: Floats
    heading_noise_deg: Floats


def winding(t_s: Floats) -> tuple[Floats, Floats]:
    """Speed and turn rate of a drive with straights and turns both ways, m/s and rad/s."""
    phase = (t_s % 60.0) / 60.0
    turn = np.where((phase > 0.2) & (phase < 0.3), 0.4, 0.0)
    turn = np.where((phase > 0.6) & (phase < 0.75), -0.3, turn)
    return 0.8 + 0.5 * np.sin(t_s / 9.0), turn


def simulate(
    robot: RobotParameters,
    rng: np.random.Generator,
    duration_s: float = 200.0,
    dt_s: float = 0.1,
    scale: bool = True,
) -> Drive:
    """Constants and initial errors from the robot's priors, noise from its figures (paper eqs. 6, 7, 9 to 11)."""
    t = np.arange(0.0, duration_s, dt_s)
    prior = np.array(astuple(robot.initial_std))
    error = rng.normal(size=9) * prior
    if not scale:
        error[7] = 0.0
    _, _, psi0, s_right, s_left, d_width, phi0, d_scale, d_bias = error
    width = robot.wheel_separation_m - d_width
    speed, omega = winding(t)
    speed[0] = omega[0] = 0.0
    right, left = (speed + 0.5 * width * omega) * dt_s, (speed - 0.5 * width * omega) * dt_s
    noise = robot.noise
    slip = noise.wheel_slip_m_per_rt_m
    turn = (
        noise.turn_slip_deg_per_rt_deg * np.sqrt(np.degrees(np.abs(omega)) * dt_s) * rng.normal(size=t.size)
    )
    white = noise.heading_noise_deg * rng.normal(size=t.size)
    white[0] = 0.0
    spin = 0.5 * robot.wheel_separation_m * np.radians(turn + np.diff(white, prepend=0.0))
    measured_right = (1 + s_right) * right + slip * np.sqrt(np.abs(right)) * rng.normal(size=t.size) + spin
    measured_left = (1 + s_left) * left + slip * np.sqrt(np.abs(left)) * rng.normal(size=t.size) - spin
    walk = noise.angle_random_walk_deg_per_rt_h / 60.0 / np.sqrt(dt_s) * rng.normal(size=t.size)
    drift = np.cumsum(noise.bias_walk_dps_per_rt_s * np.sqrt(dt_s) * rng.normal(size=t.size))
    gyro = (np.degrees(omega) + d_bias + drift + walk) / (1.0 - d_scale)
    heading = np.cumsum(omega * dt_s)
    middle = heading - 0.5 * omega * dt_s
    x, y = np.cumsum(np.cos(middle) * speed * dt_s), np.cumsum(np.sin(middle) * speed * dt_s)
    constants = np.array([s_right, s_left, d_width, d_scale, d_bias + drift[-1]])
    # The navigator starts at heading zero with both headings; their initial errors turn the truth instead.
    if psi0 != 0.0 or phi0 != 0.0:
        msg = "initial heading errors are not simulated: set their standard deviations to zero"
        raise ValueError(msg)
    return Drive(t, measured_left, measured_right, gyro, x, y, np.degrees(heading), constants, white)
