"""What the filter must be told about a robot: geometry, initial uncertainty, noise. Every figure has its unit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from gyrocal.errors import ProfileError


@dataclass(frozen=True)
class InitialStd:
    """Initial standard deviations of the nine error states, in the paper's order (eq. 12).

    Position and encoder heading against gyro heading are zero where the frame is defined by the start. A zero
    keeps a state out of the filter: it is never estimated.
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
    """Process and measurement noise.

    Attributes
    ----------
    wheel_slip_m_per_rt_m : float
        Random error of a wheel's distance after one metre; grows with the square root of the distance.
    turn_slip_deg_per_rt_deg : float
        Random error of the encoder heading after a turn of one degree (skid steer); same growth.
    angle_random_walk_deg_per_rt_h : float
        Of the gyro (IEEE 952).
    bias_walk_dps_per_rt_s : float
        Growth of the gyro bias; zero is the paper's random constant (eq. 11).
    heading_noise_deg : float
        White error v of the measured heading difference (eq. 13): encoder ticks, time stamps. Positive.
    """

    wheel_slip_m_per_rt_m: float = 0.01
    turn_slip_deg_per_rt_deg: float = 0.0
    angle_random_walk_deg_per_rt_h: float = 0.08
    bias_walk_dps_per_rt_s: float = 0.0
    heading_noise_deg: float = 0.1


@dataclass(frozen=True)
class RobotParameters:
    """A robot as the filter sees it.

    Attributes
    ----------
    gate_sigma : float
        An innovation beyond this many of its standard deviations is counted as a slip of the wheels. 5 has a
        false-alarm rate of 5.7e-7 a step (chi-square, one degree of freedom).
    gap_factor : float
        A time step above this multiple of the running median step is a gap: the gyro is not integrated over it.

    Raises
    ------
    ProfileError
        A figure is not finite, negative, or zero where it must be positive.
    """

    wheel_separation_m: float
    initial_std: InitialStd = field(default_factory=InitialStd)
    noise: FilterNoise = field(default_factory=FilterNoise)
    gate_sigma: float = 5.0
    gap_factor: float = 5.0

    def __post_init__(self) -> None:
        figures = {"wheel_separation_m": self.wheel_separation_m, "gate_sigma": self.gate_sigma}
        figures |= {"gap_factor": self.gap_factor}
        for group in (self.initial_std, self.noise):
            figures |= {f.name: getattr(group, f.name) for f in fields(group)}
        for name, value in figures.items():
            if not (math.isfinite(value) and value >= 0.0):
                raise ProfileError(f"robot: {name} = {value}; give a finite figure that is not negative.")
        positive = {"wheel_separation_m", "gate_sigma", "heading_noise_deg"}
        for name in sorted(positive):
            if figures[name] == 0.0:
                raise ProfileError(f"robot: {name} = 0; give a positive figure.")
        if self.gap_factor <= 1.0:
            raise ProfileError(f"robot: gap_factor = {self.gap_factor}; a gap is longer than a usual step: above 1.")
