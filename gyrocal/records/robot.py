"""The robot file (TOML): geometry, how long it stands at the start, what is known of its errors, its noise."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gyrocal.errors import ProfileError
from gyrocal.records.files import reading

#: Default uncertainty of the wheel separation, of its value. That of a skid steer is hardly known beforehand:
#: its wheels slide sideways in every turn.
SEPARATION_RELATIVE_STD = 0.10
#: Default uncertainty of the gyro bias: what a mean at rest leaves, and what there is without one, deg/s.
BIAS_STD_AFTER_REST_DPS, BIAS_STD_DPS = 0.01, 0.2

#: Standard deviations of the nine error states at the start: key -> what is taken when the file is silent.
INITIAL_STD_DEFAULTS: Mapping[str, float] = {
    "x_m": 0.0,
    "y_m": 0.0,
    "heading_deg": 0.0,
    "right_scale": 0.01,
    "left_scale": 0.01,
    "wheel_separation_m": math.nan,  # SEPARATION_RELATIVE_STD of the file's wheel separation
    "gyro_heading_deg": 0.0,
    "gyro_scale": 0.02,
    "gyro_bias_dps": math.nan,  # BIAS_STD_AFTER_REST_DPS, or BIAS_STD_DPS where the robot does not stand
}
#: Noise figures: key -> what is taken when the file is silent; wide, since a silent file says nothing of the
#: robot. In turns a skid steer's effective track wanders by some 5 % (0.5 deg/sqrt(deg) is 4.7 deg in 90 deg); the
#: heading difference is known no better than the clocks: 0.1 s between encoders and gyro at 20 deg/s is 2 deg.
NOISE_DEFAULTS: Mapping[str, float] = {
    "wheel_slip_m_per_rt_m": 0.003,
    "turn_slip_deg_per_rt_deg": 0.5,
    "angle_random_walk_deg_per_rt_h": 0.2,
    "bias_walk_dps_per_rt_s": 0.0,
    "heading_noise_deg": 2.0,
}
_TOP = ("wheel_separation_m", "metres_per_tick", "wheel_radius_m", "static_s", "initial_std", "noise")
_STATIC_S = 10.0


@dataclass(frozen=True)
class Robot:
    """A robot file.

    Attributes
    ----------
    metres_per_tick : (left, right) or None
        None: the log must be in metres.
    wheel_radius_m : float or None
        Needed only for ROS bags with wheel angles.
    static_s : float
        How long the robot stands at the start; 0: it does not, and no static bias can be taken.
    initial_std, noise : mapping
        Keys of `INITIAL_STD_DEFAULTS` and `NOISE_DEFAULTS`, complete.
    defaulted : tuple of str
        Which figures the file does not give, and a default stands for; whoever prints results says so.
    """

    source: Path
    wheel_separation_m: float
    metres_per_tick: tuple[float, float] | None
    wheel_radius_m: float | None
    static_s: float
    initial_std: Mapping[str, float]
    noise: Mapping[str, float]
    defaulted: tuple[str, ...] = field(default=())


def read_robot(path: Path) -> Robot:
    """Read a robot file.

    Raises
    ------
    InputError
        Missing or unreadable file.
    ProfileError
        Not TOML, an unknown key, a missing wheel separation, a figure that is not a number or out of range.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{path}: is not TOML ({error}).") from error
    _refuse_unknown(path, "", raw, _TOP)
    if "wheel_separation_m" not in raw:
        msg = f"{path}: wheel_separation_m is missing; allowed: the effective distance between left and right wheels, in metres, above 0."
        raise ProfileError(msg)
    separation_m = _number(path, "wheel_separation_m", raw["wheel_separation_m"], positive=True)
    defaulted: list[str] = []
    static_s = _static(path, raw, defaulted)
    defaults = dict(INITIAL_STD_DEFAULTS) | {
        "wheel_separation_m": SEPARATION_RELATIVE_STD * separation_m,
        "gyro_bias_dps": BIAS_STD_AFTER_REST_DPS if static_s > 0 else BIAS_STD_DPS,
    }
    initial = _table(path, "initial_std", raw, defaults, defaulted)
    noise = _table(path, "noise", raw, NOISE_DEFAULTS, defaulted)
    radius = raw.get("wheel_radius_m")
    radius_m = None if radius is None else _number(path, "wheel_radius_m", radius, positive=True)
    ticks = _ticks(path, raw)
    return Robot(path, separation_m, ticks, radius_m, static_s, initial, noise, tuple(defaulted))


def format_robot(
    wheel_separation_m: float,
    metres_per_tick: tuple[float, float] | None,
    static_s: float,
    initial_std: Mapping[str, float],
    noise: Mapping[str, float],
) -> str:
    """Text of a robot file."""
    lines = [f"wheel_separation_m = {wheel_separation_m:.6g}"]
    if metres_per_tick is not None:
        lines.append(f"metres_per_tick = [{metres_per_tick[0]:.9g}, {metres_per_tick[1]:.9g}]  # left, right")
    lines.append(f"static_s = {static_s:.6g}")
    for name, table in (("initial_std", initial_std), ("noise", noise)):
        lines += ["", f"[{name}]", *(f"{key} = {value:.6g}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _static(path: Path, raw: Mapping[str, Any], defaulted: list[str]) -> float:
    if "static_s" not in raw:
        defaulted.append(f"static_s = {_STATIC_S:g}")
        return _STATIC_S
    return _number(path, "static_s", raw["static_s"])


def _ticks(path: Path, raw: Mapping[str, Any]) -> tuple[float, float] | None:
    value = raw.get("metres_per_tick")
    if value is None:
        return None
    pair = value if isinstance(value, list) else [value, value]
    if len(pair) != 2:
        raise ProfileError(
            f"{path}: metres_per_tick is {value!r}; allowed: one number, or [LEFT, RIGHT], above 0."
        )
    left, right = (_number(path, "metres_per_tick", v, positive=True) for v in pair)
    return left, right


def _table(
    path: Path, name: str, raw: Mapping[str, Any], defaults: Mapping[str, float], defaulted: list[str]
) -> dict[str, float]:
    table = raw.get(name, {})
    if not isinstance(table, dict):
        raise ProfileError(f"{path}: {name} is not a table; allowed: [{name}] with {', '.join(defaults)}.")
    _refuse_unknown(path, f"{name}.", table, tuple(defaults))
    defaulted += [f"{name}.{key} = {value:g}" for key, value in defaults.items() if key not in table]
    return {key: _number(path, f"{name}.{key}", table.get(key, default)) for key, default in defaults.items()}


def _refuse_unknown(path: Path, prefix: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ProfileError(f"{path}: unknown key {prefix}{unknown[0]}; allowed: {', '.join(known)}.")


def _number(path: Path, key: str, value: Any, *, positive: bool = False) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or value < 0 or (positive and value == 0):
        bound = "above 0" if positive else "0 or above"
        raise ProfileError(f"{path}: {key} is {value!r}; allowed: a number, {bound}.")
    return float(value)
