"""The robot file (TOML): geometry, gyro, encoders, slip, what is known of their errors, noise. See `SCHEMA`.

Its keys are the fields of `gyrocal.fusion.robot`, which holds units, ranges and defaults; each may be left out but, for a log
that tells left from right, the wheel separation. `README.md` in bench_profiles lists them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from gyrocal.errors import ProfileError
from gyrocal.fusion.robot import (
    EncoderFigures,
    FilterNoise,
    GyroFigures,
    InitialStd,
    RobotParameters,
    SlipFigures,
    fault,
)
from gyrocal.records.files import parse_toml, read_text

#: A file that names no schema is of the first, which has the same keys and fewer of them.
SCHEMA = "gyrocal-robot/2"
SECTIONS: Mapping[str, Any] = {
    "initial_std": InitialStd,
    "noise": FilterNoise,
    "gyro": GyroFigures,
    "encoders": EncoderFigures,
    "slip": SlipFigures,
}
#: Stands for the track of a vehicle whose log has one speed: nothing reads it.
_ONE_TRACK_M = 1.0
_TICK_RANGE, _RADIUS_RANGE = (1e-9, 10.0), (1e-4, 100.0)
_TOP = ("schema", "wheel_separation_m", "metres_per_tick", "wheel_radius_m", "static_s", *SECTIONS)


@dataclass(frozen=True)
class Robot:
    """A robot file.

    Attributes
    ----------
    parameters : RobotParameters
        What the runtime takes, complete.
    metres_per_tick : (left, right) or None
        None: the log must be in metres.
    wheel_radius_m : float or None
        Needed only for ROS bags with wheel angles.
    given : frozenset of str
        Keys that the file gives, such as ``static_s`` and ``noise.tick_m``; for the others a default stands.
    noise_std : mapping
        Standard deviations of noise figures, as far as the file gives them.
    """

    source: Path
    parameters: RobotParameters
    metres_per_tick: tuple[float, float] | None = None
    wheel_radius_m: float | None = None
    given: frozenset[str] = frozenset()
    noise_std: Mapping[str, float] = field(default_factory=dict)

    @property
    def wheel_separation_m(self) -> float:
        """Effective distance between left and right wheels."""
        return self.parameters.wheel_separation_m

    def check_sides(self) -> None:
        """Refuse a file without the wheel separation, for whatever compares left and right.

        Raises
        ------
        ProfileError
        """
        if "wheel_separation_m" not in self.given:
            msg = f"{self.source}: wheel_separation_m is missing, which all but a log of one speed needs; allowed: the effective distance between left and right wheels, in metres, above 0."
            raise ProfileError(msg)

    @property
    def static_s(self) -> float:
        """How long the robot stands at the start; 0: it does not, and no static bias can be taken."""
        return self.parameters.static_s

    @property
    def initial_std(self) -> Mapping[str, float]:
        """Standard deviations of the nine error states, complete."""
        return asdict(self.parameters.initial_std)

    @property
    def noise(self) -> Mapping[str, float]:
        """Noise figures, complete."""
        return asdict(self.parameters.noise)

    @property
    def defaulted(self) -> tuple[str, ...]:
        """Which figures of the first schema a default stands for, in words; whoever prints results says so."""
        values: dict[str, float] = {"static_s": self.static_s}
        values |= {f"initial_std.{key}": value for key, value in self.initial_std.items()}
        values |= {f"noise.{key}": value for key, value in self.noise.items()}
        return tuple(f"{key} = {value:g}" for key, value in values.items() if key not in self.given)

    def with_figures(self, figures: Mapping[str, Any]) -> Robot:
        """The same with some keys given anew, by name: ``{"gyro.delay_s": 0.12, "wheel_separation_m": 0.61}``.

        Raises
        ------
        ProfileError
            An unknown key or a figure out of its range.
        """
        top = {"schema": SCHEMA, **_tables(self)}
        for key, value in figures.items():
            section, _, name = key.rpartition(".")
            (top.setdefault(section, {}) if section else top)[name] = value
        return robot_of(top, self.source)


def read_robot(path: Path) -> Robot:
    """Read a robot file.

    Raises
    ------
    InputError
        Missing or unreadable file.
    ProfileError
        Not TOML, an unknown schema or key, a missing wheel separation, a figure that is not a number or out of range.
    """
    raw = parse_toml(read_text(path), str(path), ProfileError)
    return robot_of(raw, path)


def robot_of(raw: Mapping[str, Any], path: Path) -> Robot:
    """The robot of a file's keys; raises as `read_robot`."""
    if raw.get("schema", SCHEMA) != SCHEMA:
        raise ProfileError(f"{path}: schema is {raw['schema']!r:.80}; allowed: {SCHEMA}, or none.")
    _refuse_unknown(path, "", raw, _TOP)
    ranges = _ranges(RobotParameters)
    top: dict[str, Any] = {
        key: _number(path, key, raw[key], ranges[key])
        for key in ("wheel_separation_m", "static_s")
        if key in raw
    }
    given = set(top)
    top.setdefault("wheel_separation_m", _ONE_TRACK_M)
    sections, noise_std = {}, {}
    for name, kind in SECTIONS.items():
        table = dict(_table(path, name, raw, kind))
        if name == "noise":
            noise_std = {key[:-4]: table.pop(key) for key in list(table) if key.endswith("_std")}
        try:
            sections[name] = kind(**table)
        except ProfileError as error:
            raise ProfileError(f"{path}: {name}.{str(error).removeprefix('robot: ')}") from None
        given |= {f"{name}.{key}" for key in table}
    parameters = RobotParameters(**top, **sections)
    radius = raw.get("wheel_radius_m")
    radius_m = None if radius is None else _number(path, "wheel_radius_m", radius, _RADIUS_RANGE)
    return Robot(path, parameters, _ticks(path, raw), radius_m, frozenset(given), noise_std)


def format_robot(robot: Robot) -> str:
    """Text of a robot file: the keys that are `given`, and no default."""
    lines = [f'schema = "{SCHEMA}"']
    tables = _tables(robot)
    lines += [f"{key} = {_text(value)}" for key, value in tables.items() if not isinstance(value, dict)]
    for name, table in tables.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(f"{key} = {_text(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _tables(robot: Robot) -> dict[str, Any]:
    """The keys of a robot file that are given, as TOML would read them."""
    top: dict[str, Any] = {
        key: getattr(robot, key) for key in ("wheel_separation_m", "static_s") if key in robot.given
    }
    if robot.metres_per_tick is not None:
        top["metres_per_tick"] = list(robot.metres_per_tick)  # left, right
    if robot.wheel_radius_m is not None:
        top["wheel_radius_m"] = robot.wheel_radius_m
    for name in SECTIONS:
        values = asdict(getattr(robot.parameters, name))
        table = {key: value for key, value in values.items() if f"{name}.{key}" in robot.given}
        if name == "noise":
            table |= {f"{key}_std": value for key, value in robot.noise_std.items()}
        if table:
            top[name] = table
    return top


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_text(v) for v in value)}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:.9g}"


def _ranges(kind: Any) -> dict[str, tuple[float, float]]:
    return {f.name: f.metadata["range"] for f in fields(kind) if "range" in f.metadata}


def _table(path: Path, name: str, raw: Mapping[str, Any], kind: Any) -> Mapping[str, Any]:
    table, ranges = raw.get(name, {}), _ranges(kind)
    known = [f.name for f in fields(kind)]
    if not isinstance(table, dict):
        raise ProfileError(f"{path}: {name} is not a table; allowed: [{name}] with {', '.join(known)}.")
    stds = [f"{key}_std" for key in known] if name == "noise" else []
    _refuse_unknown(path, f"{name}.", table, (*known, *stds))
    if isinstance(table.get("law", ""), str):
        texts = {"law": table["law"]} if "law" in table else {}
    else:
        raise ProfileError(f"{path}: {name}.law is {str(table['law'])[:40]}; allowed: a name in quotes.")
    numbers = {
        key: _number(path, f"{name}.{key}", value, ranges[key.removesuffix("_std") if key in stds else key])
        for key, value in table.items()
        if key not in texts
    }
    return texts | numbers


def _ticks(path: Path, raw: Mapping[str, Any]) -> tuple[float, float] | None:
    value = raw.get("metres_per_tick")
    if value is None:
        return None
    pair = value if isinstance(value, list) else [value, value]
    if len(pair) != 2:
        raise ProfileError(
            f"{path}: metres_per_tick is {str(value)[:40]}; allowed: one number, or [LEFT, RIGHT], above 0."
        )
    left, right = (_number(path, "metres_per_tick", v, _TICK_RANGE) for v in pair)
    return left, right


def _refuse_unknown(path: Path, prefix: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ProfileError(f"{path}: unknown key {prefix}{unknown[0]}; allowed: {', '.join(known)}.")


def _number(path: Path, key: str, value: Any, bounds: tuple[float, float]) -> float:
    wrong = fault(key, value, *bounds)
    if wrong:
        raise ProfileError(f"{path}: {wrong}")
    return float(value)
