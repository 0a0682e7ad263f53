"""What the runtime must be told about a robot: geometry, gyro, encoders, noise. Every figure has its unit and range.

The fields of these classes are the keys of the robot file (`gyrocal.records.robot`), and their defaults are what a
silent file means, on the robot and in replay alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

from gyrocal.errors import ProfileError
from gyrocal.physics.drive import WANDER_TAU_S
from gyrocal.physics.slip import SLIP_LAWS

#: Default uncertainty of the wheel separation, of its value. That of a skid steer is hardly known beforehand:
#: its wheels slide sideways in every turn.
SEPARATION_RELATIVE_STD = 0.10
#: Default uncertainty of the gyro bias: what a mean at rest leaves, and what there is without one, deg/s. A gyro of
#: little noise has little bias too: deg/s for each deg/sqrt(h) of angle random walk, and at least the Earth's rate.
BIAS_STD_AFTER_REST_DPS, BIAS_STD_DPS, BIAS_STD_BY_WALK, EARTH_DPS = 0.01, 0.2, 1.0, 0.0042
#: Nothing on a robot is known this closely: what is smaller is nothing, whether it is given or found.
_SMALLEST = 1e-12


def figure(default: Any, low: float, high: float) -> Any:
    """A field that must lie in ``[low, high]``."""
    return field(default=default, metadata={"range": (low, high)})


def fault(name: str, value: Any, low: float, high: float) -> str | None:
    """What is wrong with a figure, and what is allowed; None where nothing is."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # Comparisons hold for integers of any length, which `float` does not take.
    if number and low <= value <= high:
        return None
    text, quotes = ("the text ", ", without quotes") if isinstance(value, str) else ("", "")
    return f"{name} is {text}{repr(value)[:40]}; allowed: a number, {low:g} to {high:g}{quotes}."


@dataclass(frozen=True)
class _Figures:
    """Checks each field against its range; what is nothing but rounding is zero."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if "range" in f.metadata and value is not None:
                wrong = fault(f.name, value, *f.metadata["range"])
                if wrong:
                    raise ProfileError(f"robot: {wrong}")
                object.__setattr__(self, f.name, 0.0 if abs(value) < _SMALLEST else value)


@dataclass(frozen=True)
class InitialStd(_Figures):
    """Initial standard deviations of the nine error states, in the paper's order (eq. 12).

    Zero for the pose where the start defines the frame. A constant of zero is never estimated. None stands for what
    `RobotParameters` knows better: `SEPARATION_RELATIVE_STD` of the separation, and the bias by whether there is a
    rest at the start.
    """

    x_m: float = figure(0.0, 0.0, 1e4)
    y_m: float = figure(0.0, 0.0, 1e4)
    heading_deg: float = figure(0.0, 0.0, 360.0)
    right_scale: float = figure(0.01, 0.0, 1.0)
    left_scale: float = figure(0.01, 0.0, 1.0)
    wheel_separation_m: float | None = figure(None, 0.0, 100.0)
    gyro_heading_deg: float = figure(0.0, 0.0, 360.0)
    gyro_scale: float = figure(0.02, 0.0, 1.0)
    gyro_bias_dps: float | None = figure(None, 0.0, 100.0)


@dataclass(frozen=True)
class FilterNoise(_Figures):
    """Process and measurement noise; that of the processes grows with the square root of distance, turn or time.

    The defaults are wide, since a silent file says nothing of the robot: in turns a skid steer's effective track
    wanders by some 5 % (0.5 deg/sqrt(deg) is 4.7 deg in 90 deg).
    """

    wheel_slip_m_per_rt_m: float = figure(0.003, 0.0, 1.0)  # a wheel's distance after one metre
    turn_slip_deg_per_rt_deg: float = figure(0.5, 0.0, 100.0)  # encoder heading after a turn of one degree
    angle_random_walk_deg_per_rt_h: float = figure(0.2, 0.0, 1e3)  # of the gyro (IEEE 952)
    bias_walk_dps_per_rt_s: float = figure(0.0, 0.0, 10.0)  # of the gyro; zero is the paper's eq. 11
    #: White error v of the heading difference (eq. 13), in the paper's filter only: ticks and clocks; 0.1 s
    #: between encoders and gyro at 20 deg/s is 2 deg.
    heading_noise_deg: float = figure(2.0, 1e-9, 360.0)
    tick_m: float = figure(0.001, 0.0, 1.0)  # a wheel's step, whose rounding does not accumulate
    jitter_s: float = figure(0.002, 0.0, 10.0)  # time error between encoders and gyro, white
    flicker_dps: float = figure(0.001, 0.0, 100.0)  # of the gyro's bias, for each of FLICKER_TAUS_S
    track_wander: float = figure(0.02, 0.0, 1.0)  # of the effective track, of its value
    track_wander_s: float = figure(WANDER_TAU_S, 0.01, 1e5)  # its memory
    wheel_wander: float = figure(0.0, 0.0, 1.0)  # of one wheel's way against the other's: slip that lasts
    wheel_wander_s: float = figure(WANDER_TAU_S, 0.01, 1e5)


@dataclass(frozen=True)
class GyroFigures(_Figures):
    """The gyro of this robot: output = (1 + scale ± asymmetry / 2) true + bias, plus to the left; late by `delay_s`.

    Where a log has a rest at its start the mean there replaces `bias_dps`; what motion adds and the slope (from the
    temperature at that rest, or from `temp_c`) hold all the same. A delay below zero: the encoders are late.
    """

    bias_dps: float = figure(0.0, -1e3, 1e3)
    bias_dps_std: float = figure(0.0, 0.0, 1e3)
    bias_motion_dps: float = figure(0.0, -100.0, 100.0)  # added once the robot has moved; rests may lack it
    bias_motion_dps_std: float = figure(0.0, 0.0, 100.0)
    bias_moving_dps: float = figure(0.0, -100.0, 100.0)  # added while it moves, of a gyro that is shaken
    bias_moving_dps_std: float = figure(0.0, 0.0, 100.0)
    bias_moving_s: float = figure(0.0, 0.0, 100.0)  # time constant with which it follows the motion
    bias_moving_s_std: float = figure(0.0, 0.0, 100.0)
    bias_slope_dps_per_c: float = figure(0.0, -10.0, 10.0)
    bias_slope_dps_per_c_std: float = figure(0.0, 0.0, 10.0)
    temp_c: float = figure(25.0, -100.0, 200.0)  # where `bias_dps` holds
    repeatability_dps: float = figure(0.0, 0.0, 100.0)  # of the bias at the next switch-on, but for flicker
    scale: float = figure(0.0, -0.9, 9.0)
    scale_std: float = figure(0.0, 0.0, 1.0)
    asymmetry: float = figure(0.0, -0.15, 0.15)  # of the scale: turns to the left less those to the right
    asymmetry_std: float = figure(0.0, 0.0, 0.15)
    delay_s: float = figure(0.0, -10.0, 10.0)
    delay_s_std: float = figure(0.0, 0.0, 10.0)


@dataclass(frozen=True)
class EncoderFigures(_Figures):
    """The wheels: measured distance = (1 + scale) true (paper eq. 7), smoothed by a centred box of `window_s`."""

    left_scale: float = figure(0.0, -0.9, 9.0)
    left_scale_std: float = figure(0.0, 0.0, 1.0)
    right_scale: float = figure(0.0, -0.9, 9.0)
    right_scale_std: float = figure(0.0, 0.0, 1.0)
    window_s: float = figure(0.0, 0.0, 10.0)
    window_s_std: float = figure(0.0, 0.0, 10.0)


@dataclass(frozen=True)
class SlipFigures(_Figures):
    """How far the effective wheel separation widens in turns, as `gyrocal.physics.drive` knows it.

    `shape` is the power of the turn rate over 30 deg/s, or the curvature at which half of the saturation is reached.
    """

    law: str = "turn_rate"
    amplitude: float = figure(0.0, -0.9, 100.0)
    amplitude_std: float = figure(0.0, 0.0, 100.0)
    shape: float = figure(1.0, 0.0, 10.0)
    shape_std: float = figure(0.0, 0.0, 10.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law not in SLIP_LAWS:
            raise ProfileError(f"robot: law is {self.law!r}; allowed: {', '.join(SLIP_LAWS)}.")


@dataclass(frozen=True)
class RobotParameters(_Figures):
    """A robot as the runtime sees it; ProfileError where a figure is not finite or out of its range.

    An innovation beyond `gate_sigma` of its standard deviations counts as a slip of the wheels: 5 has a false-alarm
    rate of 5.7e-7 a step (chi-square, one degree of freedom). A time step above `gap_factor` times the running median
    is a gap: the gyro is not integrated over it. `static_s`: how long the robot stands at the start; 0: it does not.
    """

    wheel_separation_m: float = figure(math.nan, 1e-3, 10.0)
    initial_std: InitialStd = field(default_factory=InitialStd)
    noise: FilterNoise = field(default_factory=FilterNoise)
    gyro: GyroFigures = field(default_factory=GyroFigures)
    encoders: EncoderFigures = field(default_factory=EncoderFigures)
    slip: SlipFigures = field(default_factory=SlipFigures)
    static_s: float = figure(10.0, 0.0, 86400.0)
    gate_sigma: float = figure(5.0, 1e-3, 1e3)
    gap_factor: float = figure(5.0, 1.0 + 1e-6, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        known: dict[str, float] = {}
        if self.initial_std.wheel_separation_m is None:
            known["wheel_separation_m"] = SEPARATION_RELATIVE_STD * self.wheel_separation_m
        if self.initial_std.gyro_bias_dps is None:
            by_walk = math.hypot(EARTH_DPS, BIAS_STD_BY_WALK * self.noise.angle_random_walk_deg_per_rt_h)
            unknown = min(BIAS_STD_DPS, by_walk)
            known["gyro_bias_dps"] = BIAS_STD_AFTER_REST_DPS if self.static_s > 0.0 else unknown
        object.__setattr__(self, "initial_std", replace(self.initial_std, **known))

    @property
    def gyro_scale_std(self) -> float:
        """What the gyro's scale may be off by."""
        return self.gyro.scale_std if self.gyro.scale_std > 0.0 else self.initial_std.gyro_scale

    @property
    def way_std(self) -> float:
        """What the scales of both wheels may be off by alike, beyond what `initial_std` gives each of them."""
        wheels, each = self.encoders, self.initial_std
        whole = wheels.left_scale_std**2 + wheels.right_scale_std**2
        return math.sqrt(max(0.5 * (whole - each.left_scale**2 - each.right_scale**2), 0.0))
