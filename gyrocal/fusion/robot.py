"""What the filter must be told about a robot: geometry, initial uncertainty, noise. Every figure has its unit."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

from gyrocal.errors import ProfileError


@dataclass(frozen=True)
class InitialStd:
    """Initial standard deviations of the nine error states, in the paper's order (eq. 12).

    Zero for the pose where the start defines the frame. A constant of zero is never estimated.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    heading_deg: float = 0.0
    right_scale: float = 0.01
    left_scale: float = 0.01
    wheel_separation_m: float = 0.02
    gyro_heading_deg: float = 0.0
    gyro_scale: float = 0.01
    gyro_bias_dps: float = 0.002


@dataclass(frozen=True)
class FilterNoise:
    """Process and measurement noise; that of the processes grows with the square root of distance, turn or time."""

    wheel_slip_m_per_rt_m: float = 0.01  # a wheel's distance after one metre
    turn_slip_deg_per_rt_deg: float = 0.0  # encoder heading after a turn of one degree (skid steer)
    angle_random_walk_deg_per_rt_h: float = 0.08  # of the gyro (IEEE 952)
    bias_walk_dps_per_rt_s: float = 0.0  # of the gyro; zero is the paper's random constant (eq. 11)
    heading_noise_deg: float = 0.1  # white error v of the heading difference (eq. 13): ticks, time stamps


@dataclass(frozen=True)
class RobotParameters:
    """A robot as the filter sees it; ProfileError where a figure is not finite, negative, or a wrong zero.

    An innovation beyond `gate_sigma` of its standard deviations counts as a slip of the wheels: 5 has a false-alarm
    rate of 5.7e-7 a step (chi-square, one degree of freedom). A time step above `gap_factor` times the running median
    is a gap: the gyro is not integrated over it.
    """

    wheel_separation_m: float
    initial_std: InitialStd = field(default_factory=InitialStd)
    noise: FilterNoise = field(default_factory=FilterNoise)
    gate_sigma: float = 5.0
    gap_factor: float = 5.0

    def __post_init__(self) -> None:
        limits = {"wheel_separation_m": 0.0, "gate_sigma": 0.0, "heading_noise_deg": 0.0, "gap_factor": 1.0}
        figures = {k: v for k, v in vars(self).items() if k in limits}
        for name, value in (asdict(self.initial_std) | asdict(self.noise)).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise ProfileError(f"robot: {name} = {value}; give a finite figure that is not negative.")
        for name, value in (figures | {"heading_noise_deg": self.noise.heading_noise_deg}).items():
            if not (math.isfinite(value) and value > limits[name]):
                raise ProfileError(f"robot: {name} = {value}; give a finite figure above {limits[name]:g}.")
