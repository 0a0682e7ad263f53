"""How the columns of a foreign log map on ours: units and signs are stated in a small TOML, never guessed.

Each table ``[columns.NAME]`` gives, for one column of the drive log, ``from`` (the foreign column), ``unit``, and
optionally ``sign`` (1 or -1), ``offset`` (added last, in our unit) and, for counters, ``wrap`` (their modulus)::

    [columns.gyro_dps]
    from = "yaw_rate"
    unit = "rad/s"
    sign = -1

Columns that are not mapped are ignored. A vehicle that logs one speed has ``speed_m`` in the place of ``left_m`` and
``right_m``. ``truth_heading_deg`` may come from a quaternion: four columns x, y, z, w and the unit ``quaternion``.
What another logger wrote to a file of its own is named by ``file``, a path beside the log; its time is the column
``time`` there, in the unit of ``t_s``::

    [columns.speed_m]
    from = "v"
    unit = "m/s"
    file = "wheels.csv"
    time = "stamp"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.errors import InputError
from gyrocal.records.csvio import Floats, read_header
from gyrocal.records.files import parse_toml, read_text
from gyrocal.units import DPH_TO_DPS, MDPS, RAD_TO_DEG


@dataclass(frozen=True)
class Unit:
    """Factor and shift to our unit; what a distance counts: steps, a running total, or a speed."""

    factor: float
    shift: float = 0.0
    ticks: bool = False
    total: bool = False
    speed: bool = False


_TIME = {"s": Unit(1.0), "ms": Unit(1e-3), "us": Unit(1e-6), "ns": Unit(1e-9)}
_DISTANCE = {
    "m": Unit(1.0),
    "mm": Unit(1e-3),
    "m_total": Unit(1.0, total=True),
    "mm_total": Unit(1e-3, total=True),
    "ticks": Unit(1.0, ticks=True),
    "ticks_total": Unit(1.0, ticks=True, total=True),
    "m/s": Unit(1.0, speed=True),
    "km/h": Unit(1.0 / 3.6, speed=True),
}
_RATE = {"deg/s": Unit(1.0), "rad/s": Unit(RAD_TO_DEG), "mdeg/s": Unit(MDPS), "deg/h": Unit(DPH_TO_DPS)}
_TEMPERATURE = {"C": Unit(1.0), "K": Unit(1.0, shift=-273.15), "F": Unit(5.0 / 9.0, shift=-160.0 / 9.0)}
_POSITION = {"m": Unit(1.0), "mm": Unit(1e-3)}
_ANGLE = {"deg": Unit(1.0), "rad": Unit(RAD_TO_DEG)}
#: Four columns x, y, z, w; what is read from them is the heading in degrees.
_QUATERNION = {"quaternion": Unit(1.0)}

#: Column of the drive log -> units that a foreign log may have it in.
UNITS: Mapping[str, Mapping[str, Unit]] = {
    "t_s": _TIME,
    "left_m": _DISTANCE,
    "right_m": _DISTANCE,
    "speed_m": _DISTANCE,
    "steering_deg": _ANGLE,
    "gyro_dps": _RATE,
    "gyro_temp_c": _TEMPERATURE,
    "truth_x_m": _POSITION,
    "truth_y_m": _POSITION,
    "truth_heading_deg": _ANGLE | _QUATERNION,
}
#: What a drive log has at least: time, gyro, and the way of both sides or of the vehicle.
REQUIRED = ("t_s", "gyro_dps")
SIDES, SPEED = ("left_m", "right_m"), ("speed_m",)
_KEYS = ("from", "unit", "sign", "offset", "wrap", "file", "time")


@dataclass(frozen=True)
class ColumnRule:
    """Where a column comes from and how it becomes ours: ``sign * factor * value + shift + offset``.

    `source` is its column, or four of a quaternion; `file` the log that has it (None: the log itself), and `time`
    the column of time there (None: that of ``t_s``).
    """

    source: str
    unit: Unit
    sign: float = 1.0
    offset: float = 0.0
    wrap: float | None = None
    quaternion: tuple[str, ...] = ()
    file: str | None = None
    time: str | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Every foreign column that it needs."""
        return self.quaternion or (self.source,)


#: Larger numbers have no meaning in a log; it also keeps infinity and integers that no float holds out.
_LARGEST = 1e15

#: Behind a refusal of columns of others.
MAP_THEM = " Columns of other names and units are mapped with --columns."
#: The length of a quaternion is 1; logged in few digits it is a little beside it.
_QUATERNION_LENGTH = (0.9, 1.1)

ColumnMap = Mapping[str, ColumnRule]


def read_column_map(path: Path, way: bool = True) -> ColumnMap:
    """Read a column mapping: of a drive, or without `way` of a gyro alone.

    Raises
    ------
    InputError
        Not TOML; an unknown column, key or unit; a required column without a rule.
    """
    raw = parse_toml(read_text(path), str(path))
    unknown = sorted(set(raw) - {"columns"})
    if unknown:
        raise InputError(
            f"{path}: unknown key {unknown[0]!r:.80}; allowed: columns, with a table [columns.NAME] for each column."
        )
    columns = raw.get("columns", {})
    if not isinstance(columns, dict):
        raise InputError(f"{path}: columns must be tables [columns.NAME].")
    rules = {name: _rule(path, name, entry) for name, entry in columns.items()}
    required = REQUIRED + ((SPEED if "speed_m" in rules else SIDES) if way else ())
    for name in required:
        if name not in rules:
            also = ", and left_m and right_m, or speed_m" if way else ""
            raise InputError(f"{path}: [columns.{name}] is missing; required: t_s, gyro_dps{also}.")
    if "speed_m" in rules and not rules.keys().isdisjoint(SIDES):
        raise InputError(f"{path}: has both speed_m and a side. Map left_m and right_m, or speed_m.")
    for name in REQUIRED:
        if rules[name].file is not None:
            raise InputError(f"{path}, [columns.{name}]: file is for what is not in the log itself.")
    return rules


def _rule(path: Path, name: str, entry: Any) -> ColumnRule:
    where = f"{path}, [columns.{name}]"
    if name not in UNITS:
        raise InputError(f"{where}: no such column in a drive log; allowed: {', '.join(UNITS)}.")
    if not isinstance(entry, dict):
        raise InputError(f"{where}: is not a table with {', '.join(_KEYS)}.")
    unknown = sorted(set(entry) - set(_KEYS))
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]!r:.80}; allowed: {', '.join(_KEYS)}.")
    units = UNITS[name]
    if not isinstance(entry.get("unit"), str) or entry["unit"] not in units:
        raise InputError(f"{where}: unit is {entry.get('unit')!r:.80}; allowed: {', '.join(units)}.")
    unit = units[entry["unit"]]
    source, quaternion = _source(where, entry)
    sign = entry.get("sign", 1)
    if isinstance(sign, bool) or not isinstance(sign, int | float) or sign not in (1, -1):
        raise InputError(f"{where}: sign is {sign!r:.80}; allowed: 1, -1.")
    wrap = _number(where, "wrap", entry.get("wrap"))
    if wrap is not None and not (unit.total and wrap > 0):
        raise InputError(f"{where}: wrap is the positive modulus of a counter (unit m_total or ticks_total).")
    offset = _number(where, "offset", entry.get("offset"))
    file, time = (_text(where, key, entry.get(key)) for key in ("file", "time"))
    if time is not None and file is None:
        raise InputError(f"{where}: time is the column of time in another file, and no file is named.")
    return ColumnRule(source, unit, float(sign), offset or 0.0, wrap, quaternion, file, time)


def _source(where: str, entry: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """The foreign column, or the four of a quaternion."""
    source = entry.get("from")
    if entry["unit"] != "quaternion":
        if not isinstance(source, str) or not source:
            raise InputError(f"{where}: from is missing; it names the column of the foreign log.")
        return source, ()
    if not (isinstance(source, list) and len(source) == 4 and all(isinstance(s, str) and s for s in source)):
        raise InputError(f"{where}: from is a list of four columns x, y, z, w for a quaternion.")
    return source[0], tuple(source)


def _text(where: str, key: str, value: Any) -> str | None:
    if value is None or (isinstance(value, str) and value and "\0" not in value):
        return value
    raise InputError(f"{where}: {key} is {value!r:.80}, and a name is wanted.")


def _number(where: str, key: str, value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise InputError(f"{where}: {key} is {repr(value)[:40]}, and a finite number is wanted.")
    return float(value)


def mapped_header(file: Path, rules: ColumnMap) -> list[str]:
    """Header of a file that has every column of its rules."""
    header = read_header(file)
    for name, rule in rules.items():
        for source in rule.sources:
            if source not in header:
                found = ", ".join(header)[:200]
                msg = f"{file}, line 1: column {source!r:.80}, mapped to {name}, is missing (found: {found})."
                raise InputError(msg)
            if header.count(source) > 1:
                raise InputError(f"{file}, line 1: column {source!r:.80} stands twice. Remove one.")
    return header


def scaled(path: Path, first_line: int, rule: ColumnRule, raw: Mapping[str, Floats]) -> Floats:
    """The column of `rule` in our unit, from the foreign ones of a block; an infinite cell is refused by its line."""
    for source in rule.sources:
        infinite = np.flatnonzero(np.isinf(raw[source]))
        if infinite.size:
            raise InputError(
                f"{path}, line {first_line + infinite[0]}: {source} is infinite. Repair the log."
            )
    values = raw[rule.source]
    if rule.quaternion:
        values = _heading_deg(path, first_line, rule.quaternion, raw)
    return rule.sign * (rule.unit.factor * values + rule.unit.shift) + rule.offset


def _heading_deg(path: Path, first_line: int, names: tuple[str, ...], raw: Mapping[str, Floats]) -> Floats:
    x, y, z, w = (raw[name] for name in names)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    low, high = _QUATERNION_LENGTH
    bad = np.flatnonzero((length < low) | (length > high))
    if bad.size:
        msg = f"{path}, line {first_line + bad[0]}: the quaternion {', '.join(names)} has the length {length[bad[0]]:.3g}, and 1 is wanted. Repair the log or leave the row's cells empty."
        raise InputError(msg)
    return np.degrees(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))
