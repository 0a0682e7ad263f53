"""How the columns of a foreign drive log map on ours: units and signs are stated in a small TOML, never guessed.

Each table ``[columns.NAME]`` gives, for one column of the drive log, ``from`` (the foreign column), ``unit``, and
optionally ``sign`` (1 or -1), ``offset`` (added last, in our unit) and, for counters, ``wrap`` (their modulus)::

    [columns.gyro_dps]
    from = "yaw_rate"
    unit = "rad/s"
    sign = -1

Columns that are not mapped are ignored.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrocal.errors import InputError
from gyrocal.records.files import reading
from gyrocal.units import RAD_TO_DEG


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
}
_RATE = {"deg/s": Unit(1.0), "rad/s": Unit(RAD_TO_DEG), "mdeg/s": Unit(1e-3), "deg/h": Unit(1.0 / 3600.0)}
_TEMPERATURE = {"C": Unit(1.0), "K": Unit(1.0, shift=-273.15), "F": Unit(5.0 / 9.0, shift=-160.0 / 9.0)}
_POSITION = {"m": Unit(1.0), "mm": Unit(1e-3)}
_ANGLE = {"deg": Unit(1.0), "rad": Unit(RAD_TO_DEG)}

#: Column of the drive log -> units that a foreign log may have it in.
UNITS: Mapping[str, Mapping[str, Unit]] = {
    "t_s": _TIME,
    "left_m": _DISTANCE,
    "right_m": _DISTANCE,
    "gyro_dps": _RATE,
    "gyro_temp_c": _TEMPERATURE,
    "truth_x_m": _POSITION,
    "truth_y_m": _POSITION,
    "truth_heading_deg": _ANGLE,
}
REQUIRED = ("t_s", "left_m", "right_m", "gyro_dps")
_KEYS = ("from", "unit", "sign", "offset", "wrap")


@dataclass(frozen=True)
class ColumnRule:
    """Where a column comes from and how it becomes ours: ``sign * factor * value + shift + offset``."""

    source: str
    unit: Unit
    sign: float = 1.0
    offset: float = 0.0
    wrap: float | None = None


ColumnMap = Mapping[str, ColumnRule]


def read_column_map(path: Path) -> ColumnMap:
    """Read a column mapping.

    Raises
    ------
    InputError
        Not TOML; an unknown column, key or unit; a required column without a rule.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not TOML ({error}).") from error
    unknown = sorted(set(raw) - {"columns"})
    if unknown:
        raise InputError(
            f"{path}: unknown key {unknown[0]!r}; allowed: columns, with a table [columns.NAME] for each column."
        )
    columns = raw.get("columns", {})
    if not isinstance(columns, dict):
        raise InputError(f"{path}: columns must be tables [columns.NAME].")
    rules = {name: _rule(path, name, entry) for name, entry in columns.items()}
    for name in REQUIRED:
        if name not in rules:
            raise InputError(f"{path}: [columns.{name}] is missing; required: {', '.join(REQUIRED)}.")
    return rules


def _rule(path: Path, name: str, entry: Any) -> ColumnRule:
    where = f"{path}, [columns.{name}]"
    if name not in UNITS:
        raise InputError(f"{where}: no such column in a drive log; allowed: {', '.join(UNITS)}.")
    if not isinstance(entry, dict):
        raise InputError(f"{where}: is not a table with {', '.join(_KEYS)}.")
    unknown = sorted(set(entry) - set(_KEYS))
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]!r}; allowed: {', '.join(_KEYS)}.")
    if not isinstance(entry.get("from"), str) or not entry["from"]:
        raise InputError(f"{where}: from is missing; it names the column of the foreign log.")
    units = UNITS[name]
    if entry.get("unit") not in units:
        raise InputError(f"{where}: unit is {entry.get('unit')!r}; allowed: {', '.join(units)}.")
    unit = units[entry["unit"]]
    sign = entry.get("sign", 1)
    if sign not in (1, -1) or isinstance(sign, bool):
        raise InputError(f"{where}: sign is {sign!r}; allowed: 1, -1.")
    wrap = _number(where, "wrap", entry.get("wrap"))
    if wrap is not None and not (unit.total and wrap > 0):
        raise InputError(f"{where}: wrap is the positive modulus of a counter (unit m_total or ticks_total).")
    offset = _number(where, "offset", entry.get("offset"))
    return ColumnRule(entry["from"], unit, float(sign), offset or 0.0, wrap)


def _number(where: str, key: str, value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value!r}, and a finite number is wanted.")
    return float(value)
