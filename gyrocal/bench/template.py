"""A profile to begin from: every key with its default, what is allowed and what it means, from the definitions that check it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, get_type_hints

from gyrocal.bench.profile import Profile, profile_directory
from gyrocal.bench.schema import allowed_values

#: What a template says where there is no default: a small plan that a first run can finish.
_EXAMPLES: dict[str, Any] = {
    "title": "What this run is for",
    "sensor.model": "KVH E-Core RD2100",
    "sensor.sample_rate_hz": 10.0,
    "sensor.rate_range_dps": (-100.0, 100.0),
    "sensor.temp_range_c": (-40.0, 75.0),
    "plan.temperatures_c": (-10.0, 20.0, 50.0),
    "plan.rates_dps": (20.0, 50.0, 100.0),
}


def template() -> str:
    """Text of a commented profile; it loads as it is, on the virtual bench."""
    lines = [
        "# A profile with every key that there is. What is commented out stands at its default.",
        f"# Devices, their options and line speeds: {profile_directory().name}/README.md. Check with: gyrocal acquire FILE --dry-run",
        "",
    ]
    lines += _table(Profile, "")
    return "\n".join(lines) + "\n"


def _table(cls: type, path: str) -> Iterator[str]:
    """Lines of one table: its keys first, then the tables within it."""
    hints = get_type_hints(cls)
    fields = [f for f in dataclasses.fields(cls) if f.init]
    inner = [f for f in fields if dataclasses.is_dataclass(hints[f.name])]
    if path:
        yield ""
        yield f"[{path}]"
        about = (cls.__doc__ or "").strip().split("\n\n")[0]
        if not about.startswith(f"{cls.__name__}("):
            yield from (f"# {line.strip()}" for line in about.replace("`", "").splitlines())
    for field in fields:
        if field not in inner:
            yield _key(field, hints[field.name], f"{path}.{field.name}" if path else field.name)
    for field in inner:
        yield from _table(hints[field.name], f"{path}.{field.name}" if path else field.name)


def _key(field: dataclasses.Field[Any], hint: Any, key: str) -> str:
    default = field.default
    if default is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
        default = field.default_factory()
    value = _EXAMPLES.get(key, default)
    allowed = allowed_values(hint, field.metadata)
    if value is None or value == {}:
        return f"# {field.name} =    # {allowed}; none by default"
    off = "" if key in _EXAMPLES else "# "
    return f"{off}{field.name} = {_toml(value)}    # {allowed}"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
