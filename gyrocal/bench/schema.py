"""A TOML table read strictly into a frozen dataclass: every key known, every value of its type and in its range."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from gyrocal.errors import ProfileError

T = TypeVar("T")

_MISSING: Any = dataclasses.MISSING
_WORDS: dict[type, str] = {str: "a text", bool: "true or false", int: "a whole number", float: "a number"}
_PLURALS: dict[type, str] = {str: "texts", int: "whole numbers", float: "numbers"}

#: Larger numbers have no meaning in a profile, and a float may not hold them.
_LARGEST = 1e300


def number(low: float, high: float, unit: str = "", default: Any = _MISSING) -> Any:
    """Field for a number, or for a list of numbers each from `low` to `high`."""
    return dataclasses.field(default=default, metadata={"low": low, "high": high, "unit": unit})


def choice(*allowed: str, default: Any = _MISSING) -> Any:
    """Field for one of a few words."""
    return dataclasses.field(default=default, metadata={"choices": allowed})


def refusal(source: str, key: str, value: Any, allowed: str) -> str:
    """The one sentence of every bad value: file, key, value and what is allowed."""
    return f"{source}: {key} is {_shown(value)}, and allowed is {allowed}."


def refuse(source: str, key: str, value: Any, allowed: str) -> NoReturn:
    """Raise that sentence."""
    raise ProfileError(refusal(source, key, value, allowed))


def raise_all(sentences: list[str]) -> None:
    """Raise everything that is wrong at once, a line each; nothing where nothing is."""
    if sentences:
        raise ProfileError("\n".join(sentences))


def refuse_key(source: str, key: str, allowed: list[str]) -> NoReturn:
    """Raise for a key that nobody knows, with the nearest one that there is."""
    where, _, name = key.rpartition(".")
    near = difflib.get_close_matches(name, allowed, n=1)
    hint = f" Did you mean {near[0]}?" if near else ""
    place = f"[{where}]" if where else "the top level"
    raise ProfileError(f"{source}: {key} is an unknown key.{hint} Known in {place}: {', '.join(allowed)}.")


def read_table(cls: type[T], table: Any, source: str, path: str = "") -> T:
    """Build the dataclass `cls` from a TOML table; `path` is the dotted name of the table.

    Raises
    ------
    ProfileError
        Unknown or missing keys, wrong types, empty texts, values out of their ranges: all that is wrong, a line each.
    """
    if not isinstance(table, Mapping):
        refuse(source, path, table, "a table of keys")
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}  # type: ignore[arg-type]
    prefix = f"{path}." if path else ""
    hints = get_type_hints(cls)
    values: dict[str, Any] = {}
    wrong: list[str] = []
    for name in [*table, *(name for name in fields if name not in table)]:
        try:
            if name not in fields:
                refuse_key(source, prefix + name, sorted(fields))
            if name in table:
                values[name] = _given(hints[name], table[name], fields[name], source, prefix + name)
            elif _is_required(fields[name]):
                allowed = allowed_values(hints[name], fields[name].metadata)
                raise ProfileError(f"{source}: {prefix}{name} is missing; it wants {allowed}.")
        except ProfileError as error:
            wrong += str(error).splitlines()
    raise_all(wrong)
    return cls(**values)


def _given(hint: Any, value: Any, field: dataclasses.Field[Any], source: str, key: str) -> Any:
    checked = _value(hint, value, field.metadata, source, key)
    if checked == "" and field.default != "":
        refuse(source, key, "", "a text that is not empty")
    return checked


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is _MISSING and field.default_factory is _MISSING


def _value(hint: Any, value: Any, meta: Mapping[str, Any], source: str, key: str) -> Any:
    kind = _bare(hint)
    allowed = allowed_values(hint, meta)
    if dataclasses.is_dataclass(kind):
        return read_table(kind, value, source, key)  # type: ignore[arg-type]
    if get_origin(kind) is tuple:
        if not isinstance(value, list):
            refuse(source, key, value, allowed)
        inner = get_args(kind)
        if inner[-1] is not Ellipsis and len(value) != len(inner):
            refuse(source, key, value, allowed)
        for item in value:
            if not _fits(inner[0], item, meta):
                refuse(source, key, item, f"{allowed} (in the list)")
        return tuple(inner[0](item) for item in value)
    if get_origin(kind) in (dict, Mapping):
        if not isinstance(value, Mapping):
            refuse(source, key, value, allowed)
        return value
    if not _fits(kind, value, meta):
        refuse(source, key, value, allowed)
    return float(value) if kind is float else value


def _bare(hint: Any) -> Any:
    """``X | None`` without its None."""
    if get_origin(hint) in (Union, types.UnionType):
        return next(a for a in get_args(hint) if a is not type(None))
    return hint


def _fits(kind: Any, value: Any, meta: Mapping[str, Any]) -> bool:
    if kind in (int, float):
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not (whole or (kind is float and isinstance(value, float))) or not abs(value) < _LARGEST:
            return False
        return bool(meta.get("low", -math.inf) <= value <= meta.get("high", math.inf))
    return isinstance(value, kind) and value in meta.get("choices", (value,))


def allowed_values(hint: Any, meta: Mapping[str, Any]) -> str:
    """What a key may hold, in words."""
    kind = _bare(hint)
    if "choices" in meta:
        return "one of " + ", ".join(f'"{word}"' for word in meta["choices"])
    if dataclasses.is_dataclass(kind) or get_origin(kind) in (dict, Mapping):
        return "a table of keys"
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        many = "a list of" if inner[-1] is Ellipsis else f"a list of {len(inner)}"
        return f"{many} {_PLURALS[inner[0]]}{_range(meta)}"
    return _WORDS[kind] + _range(meta)


def _range(meta: Mapping[str, Any]) -> str:
    if "low" not in meta:
        return ""
    unit = f" {meta['unit']}" if meta["unit"] else ""
    return f" from {meta['low']:g} to {meta['high']:g}{unit}"


def _shown(value: Any) -> str:
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    text = text.lower() if isinstance(value, bool) else text
    return text if len(text) <= 60 else text[:57] + "..."
