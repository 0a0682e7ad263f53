"""Effects on the robot: what a drive log holds besides the motion. Conventions of REP 103, increments row by row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np

from gyrocal.errors import DataError
from gyrocal.physics.conditions import Memory
from gyrocal.physics.effect import Described, Floats, Parameter, amplitude, shape
from gyrocal.physics.kernels import normal, uniform
from gyrocal.physics.slip import SLIP_LAWS, slip_shape
from gyrocal.units import DEG_TO_RAD, MDPS, PPM

_PERCENT = 1e-2
_SAME_TIME_S = 1e-6
#: Memories of the gyro's 1/f noise on the robot, equally strong, and the usual one of what wanders in track and wheels, s:
#: the state space of diagnosis and filter alike.
FLICKER_TAUS_S = (6.0, 60.0, 600.0)
WANDER_TAU_S = 4.0
#: A robot that comes to rest, or leaves it, passes its last tick at no less than this, m/s^2: the wait for a tick of 0.2 mm
#: is 0.14 s. Wheels brake and start 10 times as hard; of short stops nothing else is left (0.6 s before and after takes a
#: stop of 2 s down to 0.8 s).
_LEAST_BRAKING = 0.02
#: Least and longest wait for a tick, s: after the longest, wheels stand, or creep by less than a tick.
TICK_WAITS_S = (0.15, 0.6)


def tick_wait_s(tick_m: float) -> float:
    """How long a wheel may turn unseen before it stands, or after it has begun to move, s."""
    return float(np.clip(np.sqrt(2.0 * tick_m / _LEAST_BRAKING), *TICK_WAITS_S))


@dataclass(frozen=True)
class DriveConditions:
    """Rows of a drive as they would be without the effect, in time order; arrays of shape (n,).

    Attributes
    ----------
    t_s, dt_s : time of the row, and since the row before, s
    left_m, right_m : distances of the wheels since the row before, m
    gyro_dps : gyro output, deg/s
    wheel_separation_m : nominal, m
    temp_c : gyro temperature, deg C; None: not known
    """

    t_s: Floats
    dt_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    wheel_separation_m: float
    temp_c: Floats | None = None

    def __len__(self) -> int:
        return int(self.t_s.size)

    def cut(self, rows: slice) -> DriveConditions:
        """The same, for some of the rows."""
        arrays: dict[str, Any] = {
            f.name: v[rows] for f in fields(self) if isinstance(v := getattr(self, f.name), np.ndarray)
        }
        return replace(self, **arrays)

    @property
    def distance_m(self) -> Floats:
        """Distance of the robot's centre in each row (paper eq. 6)."""
        return 0.5 * (self.right_m + self.left_m)

    @property
    def encoder_yaw_rad(self) -> Floats:
        """Change of heading by the encoders in each row (paper eq. 6)."""
        return (self.right_m - self.left_m) / self.wheel_separation_m

    @property
    def gyro_yaw_rad(self) -> Floats:
        """Change of heading by the gyro in each row (paper eq. 10)."""
        return DEG_TO_RAD * self.gyro_dps * self.dt_s

    def wheels(self, left_m: Floats, right_m: Floats) -> DriveChange:
        """The change that these changes of the wheels' distances make."""
        yaw = (right_m - left_m) / self.wheel_separation_m
        return DriveChange(yaw, np.zeros(len(self)), 0.5 * (right_m + left_m))

    def turned(self, gyro_yaw_rad: Floats) -> DriveChange:
        """A change of the gyro's yaw alone."""
        zero = np.zeros(len(self))
        return DriveChange(zero, gyro_yaw_rad, zero)


@dataclass(frozen=True)
class DriveChange:
    """What an effect adds to the logged increments of each row; arrays of shape (n,)."""

    encoder_yaw_rad: Floats
    gyro_yaw_rad: Floats
    distance_m: Floats


class DriveResponse(Protocol):
    """The law of an effect over a block of rows; any split of a log gives the same numbers."""

    def __call__(
        self, c: DriveConditions, p: Mapping[str, float], memory: Memory
    ) -> tuple[DriveChange, Memory]: ...


@dataclass(frozen=True)
class DriveEffect(Described):
    """An effect on the robot; ``change(conditions, parameters, memory)`` is its law."""

    change: DriveResponse = field(repr=False)


def _memoryless(law: Callable[[DriveConditions, Mapping[str, float]], DriveChange]) -> DriveResponse:
    def response(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
        return law(c, p), None

    return response


def _before(values: Floats, memory: float | None) -> Floats:
    """Each value's predecessor; the very first is its own."""
    if not values.size:
        return values
    return np.concatenate([[values[0] if memory is None else memory], values[:-1]])


def _last(values: Floats, memory: Any) -> Any:
    return float(values[-1]) if values.size else memory


def _skid_slip(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    speed = np.divide(c.distance_m, c.dt_s, out=np.zeros(len(c)), where=c.dt_s > 0)
    law = SLIP_LAWS[int(p["law"])]
    share = slip_shape(law, c.gyro_dps, speed, c.wheel_separation_m, p["shape"])
    wider = _PERCENT * p["amplitude"] * share
    zero = np.zeros(len(c))
    return DriveChange(wider * c.encoder_yaw_rad, zero, zero)


def _wheel_scale(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    s = _PERCENT * p["amplitude"]
    return c.wheels(s * c.left_m, s * c.right_m)


def _wheel_asymmetry(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    half = 0.5 * _PERCENT * p["amplitude"]
    return c.wheels(-half * c.left_m, half * c.right_m)


def _overcount(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    keys = c.t_s / _SAME_TIME_S
    left, right = (-np.log(uniform(p["seed"], stream, keys)) for stream in (201, 202))
    share = _PERCENT * p["amplitude"]
    return c.wheels(share * left * np.abs(c.left_m), share * right * np.abs(c.right_m))


def _eccentricity(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
    wheel_m = c.right_m if p["side"] > 0 else c.left_m
    start = 0.0 if memory is None else memory
    travelled = np.concatenate([[start], start + np.cumsum(wheel_m)])
    # The integral over the row, so that the size of a row does not matter.
    angle = travelled / p["wheel_radius_m"] + p["phase_rad"]
    change = _PERCENT * p["amplitude"] * p["wheel_radius_m"] * np.diff(np.sin(angle))
    zero = np.zeros(len(c))
    return c.wheels(*((zero, change) if p["side"] > 0 else (change, zero))), float(travelled[-1])


def _start_stop(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
    moving = c.dt_s > 0
    speed = np.abs(np.divide(c.distance_m, c.dt_s, out=np.zeros(len(c)), where=moving))
    gained = np.maximum(speed - _before(speed, memory), 0.0)
    share = p["amplitude"] * np.divide(gained, c.dt_s, out=np.zeros(len(c)), where=moving)
    return c.wheels(share * c.left_m, share * c.right_m), _last(speed, memory)


def _gyro_delay(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
    if not len(c):
        return c.turned(np.zeros(0)), memory
    past_t, past_rate = (np.empty(0), np.empty(0)) if memory is None else memory
    t, rate = np.concatenate([past_t, c.t_s]), np.concatenate([past_rate, c.gyro_dps])
    late = np.interp(c.t_s - p["amplitude"], t, rate)
    keep = max(int(np.searchsorted(t, c.t_s[-1] - p["amplitude"], side="right")) - 1, 0)
    return c.turned(DEG_TO_RAD * (late - c.gyro_dps) * c.dt_s), (t[keep:], rate[keep:])


def _gyro_scale(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    return c.turned(PPM * p["amplitude"] * c.gyro_yaw_rad)


def _constant_rate(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    return c.turned(DEG_TO_RAD * MDPS * p["amplitude"] * c.dt_s)


def _bias_temperature(
    c: DriveConditions, p: Mapping[str, float], memory: Memory
) -> tuple[DriveChange, Memory]:
    if c.temp_c is None:
        raise DataError("bias_temperature depends on temp_c, and this log does not have it.")
    known = np.flatnonzero(np.isfinite(c.temp_c))
    start = float(c.temp_c[known[0]]) if memory is None and known.size else memory
    if start is None:
        return c.turned(np.full(len(c), np.nan)), None
    bias_dps = MDPS * p["amplitude"] * (c.temp_c - start)
    return c.turned(DEG_TO_RAD * bias_dps * c.dt_s), start


def _tilt(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    return c.turned((np.cos(DEG_TO_RAD * p["amplitude"]) - 1.0) * c.gyro_yaw_rad)


def _ticks(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
    tick_m = 1e-3 * p["amplitude"]
    changes, totals = [], []
    for wheel, start in zip((c.left_m, c.right_m), memory or (0.0, 0.0), strict=True):
        total = np.concatenate([[start], start + np.cumsum(wheel)])
        counted = tick_m * np.floor(total / tick_m) if tick_m > 0 else total
        changes.append(np.diff(counted) - wheel)
        totals.append(float(total[-1]))
    return c.wheels(*changes), tuple(totals)


def _dropped(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    lost = uniform(p["seed"], 203, c.t_s / _SAME_TIME_S) < _PERCENT * p["amplitude"]
    return c.turned(np.where(lost, -c.gyro_yaw_rad, 0.0))


def _jitter(c: DriveConditions, p: Mapping[str, float], memory: Memory) -> tuple[DriveChange, Memory]:
    off_s = 1e-3 * p["amplitude"] * normal(p["seed"], 102, c.t_s / _SAME_TIME_S)
    change = DEG_TO_RAD * c.gyro_dps * (off_s - _before(off_s, memory))
    return c.turned(change), _last(off_s, memory)


def _unit(c: DriveConditions, p: Mapping[str, float]) -> DriveChange:
    return c.turned((p["amplitude"] - 1.0) * c.gyro_yaw_rad)


_SEED = shape("seed", "1", 0.0, 2.0**52, 1.0, "which draw")
_YAW = ("left_m", "right_m", "gyro_dps")

SKID_SLIP = DriveEffect(
    "skid_slip",
    "wheel slip",
    "D_eff = D (1 + k f), f = (|w|/30 deg/s)^n, or q, or q/(q + q0), with q = |w| D/(2 |v|)",
    "In turns the wheels skid, so that the robot turns as if they stood wider apart; what is alike in all turns may be a "
    "wrong wheel separation as well.",
    (
        amplitude("%", 300.0, 5.0, "widening at f = 1"),
        shape("law", "1", 0.0, 2.0, 0.0, "0 by turn rate, 1 by curvature, 2 by curvature that saturates"),
        shape("shape", "1", 0.0, 10.0, 1.0, "power n of the turn rate, or curvature q0 of half saturation"),
    ),
    _YAW,
    "turn_rate",
    ("gyro_scale",),
    "Wang et al., Sensors 15, 9681 (2015)",
    False,
    _memoryless(_skid_slip),
)
WHEEL_SCALE = DriveEffect(
    "wheel_scale",
    "wheel geometry",
    "U_R, U_L times (1 + S)",
    "Both wheels are larger or smaller than nominal: distances are off by a factor.",
    (amplitude("%", 50.0, 0.5, "distance too long by"),),
    ("left_m", "right_m"),
    "speed",
    ("encoder_overcount", "start_stop_slip"),
    "paper eq. 7",
    False,
    _memoryless(_wheel_scale),
)
WHEEL_ASYMMETRY = DriveEffect(
    "wheel_asymmetry",
    "wheel geometry",
    "U_R times (1 + S/2), U_L times (1 - S/2)",
    "The wheels of the two sides differ, so that the encoders see a turn on a straight.",
    (amplitude("%", 50.0, 0.5, "right larger than left by"),),
    _YAW,
    "speed",
    ("gyro_bias",),
    "paper eq. 7; Borenstein and Feng, UMBmark (1996)",
    False,
    _memoryless(_wheel_asymmetry),
)
ENCODER_OVERCOUNT = DriveEffect(
    "encoder_overcount",
    "wheel slip",
    "U plus k |U| x, x exponentially distributed with mean 1",
    "Bumps and slip add counts and never take any away.",
    (
        Parameter("amplitude", "%", 0.0, 100.0, 1.0, True, "mean overcount"),
        _SEED,
    ),
    ("left_m", "right_m"),
    "time",
    ("wheel_scale",),
    "paper section 3.1",
    False,
    _memoryless(_overcount),
)
WHEEL_ECCENTRICITY = DriveEffect(
    "wheel_eccentricity",
    "wheel geometry",
    "dU = k cos(s/r + phi) ds on one side",
    "A wheel runs out of true: its distance is modulated once a turn of the wheel.",
    (
        amplitude("%", 20.0, 0.5, "modulation"),
        shape("wheel_radius_m", "m", 0.01, 2.0, 0.1, "radius r"),
        shape("phase_rad", "rad", -2 * np.pi, 2 * np.pi, 0.0, "phase phi"),
        shape("side", "1", -1.0, 1.0, 1.0, "positive: right, otherwise left"),
    ),
    _YAW,
    "wheel_angle",
    (),
    "kinematics of a wheel off its centre",
    False,
    _eccentricity,
)
START_STOP_SLIP = DriveEffect(
    "start_stop_slip",
    "wheel slip",
    "dU = k a U while the speed grows, a = d|v|/dt",
    "A wheel that drives slips in proportion to its force: while the speed grows it goes further than the robot.",
    (amplitude("s^2/m", 1.0, 0.05, "share of the way for each m/s^2"),),
    _YAW,
    "acceleration",
    ("wheel_scale",),
    "Gustafsson, Automatica 33, 1087 (1997): slip in proportion to force",
    False,
    _start_stop,
)
GYRO_DELAY = DriveEffect(
    "gyro_delay",
    "timing",
    "w_g(t) = w(t - d)",
    "The gyro's rate arrives later than the encoders' counts.",
    (Parameter("amplitude", "s", 0.0, 2.0, 0.05, False, "delay d"),),
    _YAW,
    "delay",
    (),
    "two clocks",
    False,
    _gyro_delay,
)
GYRO_SCALE = DriveEffect(
    "gyro_scale",
    "gyro",
    "w_g = w (1 + k)",
    "The gyro's scale factor is off.",
    (amplitude("ppm", 500000.0, 5000.0, "scale too large by"),),
    _YAW,
    "turn_rate",
    ("skid_slip", "robot_tilt"),
    "paper eqs. 10 and 11, B_s",
    True,
    _memoryless(_gyro_scale),
)
GYRO_BIAS = DriveEffect(
    "gyro_bias",
    "gyro",
    "w_g = w + b",
    "The gyro has a bias that the rest at the start did not remove.",
    (amplitude("mdeg/s", 10000.0, 5.0, "bias b"),),
    _YAW,
    "time",
    ("earth_rate", "wheel_asymmetry", "bias_temperature"),
    "paper eqs. 10 and 11, B_rb",
    True,
    _memoryless(_constant_rate),
)
BIAS_TEMPERATURE = DriveEffect(
    "bias_temperature",
    "gyro",
    "w_g = w + k (T - T(0))",
    "The gyro's bias follows its temperature during the drive.",
    (amplitude("mdeg/s per degC", 1000.0, 3.0, "bias per degree"),),
    (*_YAW, "temp_c"),
    "time",
    ("gyro_bias",),
    "paper eq. 3",
    True,
    _bias_temperature,
)
EARTH_RATE = DriveEffect(
    "earth_rate",
    "gyro",
    "w_g = w + Omega_E sin(latitude)",
    "The gyro sees the Earth turn.",
    (Parameter("amplitude", "mdeg/s", -4.2, 4.2, 2.8, True, "vertical Earth rate"),),
    _YAW,
    "time",
    ("gyro_bias",),
    "Earth rate about the sensing axis",
    True,
    _memoryless(_constant_rate),
)
ROBOT_TILT = DriveEffect(
    "robot_tilt",
    "gyro",
    "w_g = w cos(tilt)",
    "On a slope the gyro's axis is not vertical and sees only a part of the turn.",
    (Parameter("amplitude", "deg", 0.0, 60.0, 3.0, False, "tilt"),),
    _YAW,
    "turn_rate",
    ("gyro_scale",),
    "projection of the turn rate on a tilted axis",
    False,
    _memoryless(_tilt),
)
ENCODER_QUANTISATION = DriveEffect(
    "encoder_quantisation",
    "encoding",
    "distances in whole ticks, the rest carried on",
    "The encoders count whole ticks.",
    (Parameter("amplitude", "mm", 0.0, 1000.0, 1.0, False, "distance of a tick"),),
    ("left_m", "right_m"),
    "speed",
    (),
    "sampling and time stamps of a log",
    False,
    _ticks,
)
DROPPED_SAMPLES = DriveEffect(
    "dropped_samples",
    "timing",
    "the gyro's yaw of a share of the rows is lost",
    "Samples of the gyro are lost on the way.",
    (Parameter("amplitude", "%", 0.0, 100.0, 0.5, False, "share of rows"), _SEED),
    _YAW,
    "time",
    (),
    "sampling and time stamps of a log",
    False,
    _memoryless(_dropped),
)
TIMESTAMP_JITTER = DriveEffect(
    "timestamp_jitter",
    "timing",
    "t = t_true + s n, n normal",
    "The rows' times are noisy, and with them the angle that a rate makes.",
    (Parameter("amplitude", "ms", 0.0, 1000.0, 2.0, True, "standard deviation of a time"), _SEED),
    _YAW,
    "turn_rate",
    (),
    "sampling and time stamps of a log",
    False,
    _jitter,
)
UNIT_OR_SIGN = DriveEffect(
    "unit_or_sign",
    "encoding",
    "w_g = f w, f = 57.3, 1/57.3, -1, 2, ...",
    "A unit or a sign is wrong: rad/s taken for deg/s, an inverted axis, half the track width.",
    (Parameter("amplitude", "1", -100.0, 100.0, -1.0, False, "factor f"),),
    _YAW,
    "turn_rate",
    ("gyro_scale",),
    "mix-ups of rad/s and deg/s, of left and right",
    False,
    _memoryless(_unit),
)

DRIVE_EFFECTS = (
    SKID_SLIP,
    WHEEL_SCALE,
    WHEEL_ASYMMETRY,
    ENCODER_OVERCOUNT,
    WHEEL_ECCENTRICITY,
    START_STOP_SLIP,
    GYRO_DELAY,
    GYRO_SCALE,
    GYRO_BIAS,
    BIAS_TEMPERATURE,
    EARTH_RATE,
    ROBOT_TILT,
    ENCODER_QUANTISATION,
    DROPPED_SAMPLES,
    TIMESTAMP_JITTER,
    UNIT_OR_SIGN,
)
DRIVE_CATALOGUE: dict[str, DriveEffect] = {effect.id: effect for effect in DRIVE_EFFECTS}
