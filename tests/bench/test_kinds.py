"""What every kind of device promises, read off the registry: limits, docstrings, units, a simulator, tests."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest

from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.devices import ChamberLimits, TableLimits
from gyrocal.bench.kinds import ChamberKind, GyroKind, TableKind
from gyrocal.bench.profile import profile_from_dict
from gyrocal.bench.registry import CHAMBERS, GYROS, MANUAL_CHAMBER, MANUAL_TABLE, TABLES
from gyrocal.bench.virtual.serving import served_kinds, snippet_of
from gyrocal.bench.wiring import ROLES, read_wire
from gyrocal.errors import DeviceError, ProfileError
from tests.bench.tiny import tiny
from tests.bench.wire import IdealChamber, IdealTable, LoopTransport

ROOM = Path(__file__).parent
KINDS: dict[str, GyroKind | TableKind | ChamberKind] = {**GYROS, **TABLES, **CHAMBERS}
#: Numbers that are plain counts or addresses, and need no unit in their name.
COUNTS = {
    "address", "axis", "code_characters", "condition_event", "control_variables", "decimals", "device", "fault_bit", "loop",
    "microsteps_per_rev", "output", "plate_input", "plate_loop", "prefix_characters", "rate_scale", "sequence_modulus", "set_values", "start_bit",
    "status_good", "temperature_byte", "trip_margin",
}  # fmt: skip
UNITS = re.compile(r"_(dps|dps2|c|c_per_min|s|hz|deg)$")


def options_of(kind: str) -> Any:
    """Options of a kind, as the simulator serves it."""
    role = "gyro" if kind in GYROS else "table" if kind in TABLES else "chamber"
    return getattr(served_kinds(profile_from_dict(tiny(), "tiny"), {role: kind}), f"{role}_options")


@pytest.mark.parametrize("kind", KINDS)
def test_options_are_described_with_their_units(kind: str) -> None:
    cls = KINDS[kind].options
    text = inspect.getdoc(cls) or ""
    assert len(text) > 20, f"{kind}: Options has no docstring"
    for option in fields(cls):
        numeric = any(word in str(option.type) for word in ("float", "int"))
        assert not numeric or option.name in COUNTS or UNITS.search(option.name), (
            f"{kind}: {option.name} needs its unit in its name"
        )
        if option.default is MISSING:
            assert option.name in text, f"{kind}: {option.name} has no default and is not described"


@pytest.mark.parametrize("kind", KINDS)
def test_every_option_is_held_to_its_range(kind: str) -> None:
    role = "gyro" if kind in GYROS else "table" if kind in TABLES else "chamber"
    usual = snippet_of(
        profile := profile_from_dict(tiny(), "tiny.toml"),
        served_kinds(profile, {role: kind}),
        dict.fromkeys(ROLES, "x"),
    )
    for option in fields(KINDS[kind].options):
        if "str" in str(option.type):
            values: tuple[Any, ...] = ("?",) if "choices" in option.metadata else ()
        elif "bool" in str(option.type) or option.name in ("rate_scale", "status_good"):
            values = ()
        else:
            values = (-(10**12), 10**15)
        for value in values:
            section = usual[role] | {"options": usual[role].get("options", {}) | {option.name: value}}
            with pytest.raises(
                ProfileError, match=rf"tiny.toml: {role}.options.{option.name} is .*, and allowed is "
            ):
                read_wire(profile_from_dict({**tiny(), **usual, role: section}, "tiny.toml"), role)


def test_every_option_stands_in_the_readme_with_its_default() -> None:
    text = (ROOM.parents[1] / "bench_profiles" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \| [^|]+ \|$", text, flags=re.MULTILINE)
    told = {(kind, option, default) for option, kinds, default in rows for kind in kinds.split(", ")}
    classes = {kind: cls.options for kind, cls in KINDS.items()}
    classes |= {"manual table": MANUAL_TABLE[0], "manual chamber": MANUAL_CHAMBER[0]}
    assert told == {(kind, f.name, in_toml(f.default)) for kind, cls in classes.items() for f in fields(cls)}


def test_usual_line_speeds_stand_in_the_readme() -> None:
    text = (ROOM.parents[1] / "bench_profiles" / "README.md").read_text(encoding="utf-8").replace("\n", " ")
    (told,) = re.findall(r"usual line speeds, where `baud` is not given: (.*?)\.", text)
    speeds = {
        kind: int(speed)
        for kinds, speed in re.findall(r"([a-z][a-z0-9 -]*[a-z0-9]) (\d+)[,;]?", told)
        for kind in kinds.split(" and ")
    }
    assert speeds == {kind: cls.baud for kind, cls in KINDS.items()}


def in_toml(default: Any) -> str:
    """A default as the README shows it; numbers, texts and lists read alike in JSON."""
    if default is MISSING or default is None:
        return "required" if default is MISSING else "none"
    return f"`{json.dumps(default)}`"


@pytest.mark.parametrize("kind", KINDS)
def test_modules_say_what_they_speak(kind: str) -> None:
    module = inspect.getmodule(KINDS[kind].options)
    assert module is not None
    text = module.__doc__ or ""
    assert "protocols.md" in text or "gyrocal's own" in text or "RFC" in text or kind == "ascii-line", (
        f"{kind}: its module cites no source"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_tested_by_name(kind: str) -> None:
    module = inspect.getmodule(KINDS[kind].options)
    assert module is not None
    name = module.__name__.rpartition(".")[2]
    texts = [path.read_text() for path in ROOM.rglob("test_*.py") if path.name != Path(__file__).name]
    assert any(re.search(rf"\b{name}\b|\"{kind}\"", text) for text in texts), f"{kind}: no test names it"


@pytest.mark.parametrize("kind", GYROS)
def test_a_gyro_hears_what_its_simulator_says(kind: str) -> None:
    gyro, options = GYROS[kind], options_of(kind)
    decoder = gyro.decoder(options)
    data = b"\r\n" + b"".join(gyro.encode(-12.5 + 0.5 * i, 31.25, i, options) for i in range(50))
    frames = decoder.feed(data)
    assert len(frames) >= 49
    assert [f.rate_dps for f in frames] == pytest.approx(
        [0.5 * i - 12.5 for i in range(50 - len(frames), 50)], abs=2e-3
    )
    if gyro.has_temperature:
        assert frames[-1].temp_c == pytest.approx(31.25, abs=0.51)
    assert all(f.status == 0 for f in frames)


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_keeps_its_limits_and_stops_without_an_answer(kind: str) -> None:
    table, options = TABLES[kind], options_of(kind)
    line = LoopTransport(table.responder(IdealTable(), options))
    driver = table.driver(line, VirtualClock(), options)
    limits = driver.limits()
    assert isinstance(limits, TableLimits)
    assert limits.max_rate_dps > 0.0
    assert limits.max_acceleration_dps2 > 0.0
    driver.start()
    before = len(line.sent)
    with pytest.raises(DeviceError, match=r"beyond the limit of [\d.]+ deg/s.*nothing was sent"):
        driver.set_rate(1.01 * limits.max_rate_dps)
    with pytest.raises(DeviceError):
        driver.set_rate(float("nan"))
    assert len(line.sent) == before
    driver.set_rate(10.0)
    assert driver.read().rate_dps == pytest.approx(10.0, abs=1e-3)
    line.read_available = _nobody_answers  # type: ignore[method-assign]
    driver.send_stop()
    assert line.sent[-1].endswith((b"\r", b"\n")), "a stop without its terminator is not obeyed"


def _nobody_answers(wait_s: float) -> bytes:
    raise AssertionError("send_stop waits for an answer")


@pytest.mark.parametrize("kind", CHAMBERS)
def test_a_chamber_keeps_its_limits_and_reads_back(kind: str) -> None:
    chamber, options = CHAMBERS[kind], options_of(kind)
    line = LoopTransport(chamber.responder(IdealChamber(), options))
    driver = chamber.driver(line, VirtualClock(), options)
    limits = driver.limits()
    assert isinstance(limits, ChamberLimits)
    driver.start()
    before = len(line.sent)
    with pytest.raises(DeviceError, match="nothing was sent"):
        driver.set_setpoint(limits.max_temp_c + 1.0)
    assert len(line.sent) == before
    driver.set_setpoint(-12.5)
    assert driver.read().setpoint_c == pytest.approx(-12.5, abs=0.06)
    if chamber.sets_alarms:
        driver.set_alarm_limits(-45.0, 80.0)
    else:
        with pytest.raises(DeviceError, match="own_alarms_set = true"):
            driver.set_alarm_limits(-45.0, 80.0)


def test_manual_devices_have_limits_too() -> None:
    table = MANUAL_TABLE[1](lambda question: "0", VirtualClock(), MANUAL_TABLE[0]())
    chamber = MANUAL_CHAMBER[1](lambda question: "20", VirtualClock(), MANUAL_CHAMBER[0]())
    assert table.limits().max_rate_dps > 0
    assert chamber.limits().max_temp_c > chamber.limits().min_temp_c


@pytest.mark.parametrize("kind", KINDS)
def test_drivers_are_documented(kind: str) -> None:
    parts = [getattr(KINDS[kind], name, None) for name in ("driver", "responder", "decoder")]
    for part in parts:
        if part is not None and getattr(part, "__name__", "<lambda>") != "<lambda>":
            assert inspect.getdoc(part), f"{kind}: {part} has no docstring"
