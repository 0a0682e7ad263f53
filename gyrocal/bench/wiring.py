"""From a profile to a bench of real devices: kinds and ports by name, options read strictly, every port captured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, NoReturn

from gyrocal.bench.capture import RawCapture
from gyrocal.bench.chambers.stepped import AlarmsByHand, SteppedChamber
from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, Chamber, RateTable
from gyrocal.bench.gyros.stream import StreamSpec, WireGyro
from gyrocal.bench.kinds import ChamberKind, GyroKind, TableKind
from gyrocal.bench.profile import DeviceSpec, Profile
from gyrocal.bench.registry import CHAMBERS, GYROS, MANUAL_CHAMBER, MANUAL_TABLE, TABLES
from gyrocal.bench.schema import read_table, refuse
from gyrocal.bench.transport import (
    Attend,
    ReopeningTransport,
    SerialTransport,
    Transport,
    nobody_asks,
    opened_within,
)
from gyrocal.errors import ProfileError

#: Asks the operator of a manual table or chamber; the command line supplies it.
Prompt = Callable[[str], str]
#: Opens the port of a role's device.
OpenPort = Callable[[str, "Wire"], Transport]

ROLES = ("gyro", "table", "chamber")
VIRTUAL, MANUAL = "virtual", "manual"
#: Without a sample for so long, or for so many sample intervals, a gyro is silent.
_SILENCE_S, _SILENT_SAMPLES = 3.0, 20.0
_BITS_PER_BYTE = 10
#: Longest pause between two questions to a table with a watchdog, of its time.
_WATCHDOG_SHARE = 0.5


@dataclass(frozen=True)
class Wire:
    """A device of a profile, checked: its kind, where it is, and the kind's options."""

    kind: str
    url: str
    baud: int
    options: Any

    @property
    def plain_options(self) -> dict[str, Any]:
        """Options as they may stand in TOML or JSON."""
        return {name: value for name, value in asdict(self.options).items() if value is not None}


def kinds_of(role: str) -> Mapping[str, GyroKind | TableKind | ChamberKind]:
    """Kinds that a device of this role can be."""
    registries: dict[str, Mapping[str, GyroKind | TableKind | ChamberKind]] = {
        "gyro": GYROS,
        "table": TABLES,
        "chamber": CHAMBERS,
    }
    return registries[role]


def is_virtual(profile: Profile) -> bool:
    """Whether all three devices are virtual.

    Raises
    ------
    ProfileError
        Some are and some are not: a virtual device knows nothing of a real one.
    """
    names = {role: getattr(profile, role).device for role in ROLES}
    virtual = [role for role, device in names.items() if device == VIRTUAL]
    if virtual and len(virtual) < len(ROLES):
        real = next(role for role in ROLES if role not in virtual)
        msg = (
            f'{profile.source}: {virtual[0]}.device is "virtual" and {real}.device is "{names[real]}". Make all three '
            "virtual or none; gyrocal sim serves virtual devices on ports."
        )
        raise ProfileError(msg)
    return bool(virtual)


def read_wire(profile: Profile, role: str) -> Wire:
    """Kind, port and options of a device.

    Raises
    ------
    ProfileError
        No such kind, a bad option, or a gyro that sends more than its line can carry.
    """
    spec: DeviceSpec = getattr(profile, role)
    kinds = kinds_of(role)
    name, _, url = spec.device.partition(":")
    if spec.device == MANUAL and role != "gyro":
        options_class = (MANUAL_TABLE if role == "table" else MANUAL_CHAMBER)[0]
        return Wire(MANUAL, "", 0, _options(profile, role, options_class))
    if name not in kinds or not url:
        _refuse_device(profile, role, spec.device)
    kind = kinds[name]
    wire = Wire(name, url, spec.baud or kind.baud, _options(profile, role, kind.options))
    if isinstance(kind, GyroKind):
        _check_line(profile, wire, kind)
    return wire


def _refuse_device(profile: Profile, role: str, device: str) -> NoReturn:
    words = ['"virtual"', *(['"manual"'] if role != "gyro" else [])]
    kinds = ", ".join(kinds_of(role))
    allowed = f'{", ".join(words)} or "kind:port" with one of the kinds {kinds}'
    refuse(profile.source, f"{role}.device", device, allowed)


def _options(profile: Profile, role: str, options_class: type[Any]) -> Any:
    """Options of a kind; where the device has to send at the sensor's rate, that is its default."""
    given = dict(getattr(profile, role).options)
    rate_hz = profile.sensor.sample_rate_hz
    if "data_rate_hz" in {f.name for f in fields(options_class)}:
        stated = given.setdefault("data_rate_hz", rate_hz)
        if stated != rate_hz:
            # A delta angle times the wrong rate is a wrong scale factor that no later check can see.
            refuse(
                profile.source,
                f"{role}.options.data_rate_hz",
                stated,
                f"sensor.sample_rate_hz ({rate_hz:g} Hz)",
            )
    return read_table(options_class, given, profile.source, f"{role}.options")


def _check_line(profile: Profile, wire: Wire, kind: GyroKind) -> None:
    try:
        kind.decoder(wire.options)  # refuses what no single option can show
    except ProfileError as error:
        raise ProfileError(f"{profile.source}: {error}") from error
    needed = len(kind.encode(0.0, 20.0, 0, wire.options)) * _BITS_PER_BYTE * profile.sensor.sample_rate_hz
    if "://" not in wire.url and needed > wire.baud:
        msg = (
            f"{profile.source}: {wire.kind} at {profile.sensor.sample_rate_hz:g} Hz needs {needed:.0f} baud, and gyro.baud is "
            f"{wire.baud}. Raise the baud rate on both sides, or lower the data rate."
        )
        raise ProfileError(msg)


def _check_together(profile: Profile, wires: Mapping[str, Wire]) -> None:
    """Refuse what no device by itself can show: a port named twice, a chamber without alarms, a table not asked for too long."""
    ports = [(role, wire.url) for role, wire in wires.items() if wire.url]
    for i, (role, url) in enumerate(ports):
        for other, its_url in ports[:i]:
            if url == its_url:
                refuse(
                    profile.source,
                    f"{role}.device",
                    f"{wires[role].kind}:{url}",
                    f"a port other than that of {other}",
                )
    chamber = wires["chamber"]
    if chamber.kind != MANUAL and not (
        CHAMBERS[chamber.kind].sets_alarms
        or profile.chamber.own_alarms_set
        or getattr(chamber.options, "alarm_registers", False)
    ):
        (low_c, high_c), margin_c = profile.sensor.temp_range_c, profile.safe.gyro_margin_c
        msg = (
            f"{profile.source}: nothing sets the own alarms of a {chamber.kind} chamber, which protect the gyro when this computer "
            f"is dead. Set them to {low_c - margin_c:g} and {high_c + margin_c:g} °C at its panel and say own_alarms_set = true in [chamber]."
        )
        raise ProfileError(msg)
    if chamber.kind == MANUAL and not (_sends_temperature(wires["gyro"]) or profile.safe.no_thermometer):
        msg = (
            f"{profile.source}: a {wires['gyro'].kind} sends no temperature and a manual chamber has no thermometer that this "
            "program reads, so that no interlock keeps the gyro from harm. Watch its temperature yourself and say "
            "no_thermometer = true in [safe], or use a chamber with a link."
        )
        raise ProfileError(msg)
    watchdog_s = getattr(wires["table"].options, "watchdog_s", math.inf)
    period_s = profile.record.bench_period_s
    if period_s > _WATCHDOG_SHARE * watchdog_s:
        msg = (
            f"{profile.source}: record.bench_period_s is {period_s:g} s, and the table stops by itself when it is not "
            f"asked for {watchdog_s:g} s. Give at most {_WATCHDOG_SHARE * watchdog_s:g} s, or raise watchdog_s in [table.options]."
        )
        raise ProfileError(msg)


def _sends_temperature(wire: Wire) -> bool:
    """Whether a gyro's frames carry a temperature with these options: by what its own codec makes of some."""
    kind = GYROS[wire.kind]
    data = b"".join(kind.encode(0.0, 20.0, number, wire.options) for number in range(3))
    frames = kind.decoder(wire.options).feed(data)
    return any(math.isfinite(frame.temp_c) for frame in frames) if frames else kind.has_temperature


def open_bench(
    profile: Profile,
    clock: Clock,
    prompt: Prompt,
    capture: RawCapture | None = None,
    open_port: OpenPort | None = None,
    attend: Attend = nobody_asks,
) -> Bench:
    """The devices that a profile names. Ports are opened at their first use.

    Parameters
    ----------
    attend : callable
        Called while a port is waited for; may end the wait.
    prompt : callable
        Asks the operator of a manual table or chamber.
    capture : RawCapture, optional
        Takes a copy of every port's bytes.
    open_port : callable, optional
        Opens a port in place of pyserial, and hands the gyro's bytes to its `take`.

    Raises
    ------
    ProfileError
        A device that does not exist or a bad option.
    """
    wires = {role: read_wire(profile, role) for role in ROLES}
    _check_together(profile, wires)
    taps = {
        role: capture.tap(role, w.kind, w.plain_options) for role, w in wires.items() if capture and w.url
    }

    def serial_port(role: str, wire: Wire) -> Transport:
        # The gyro is read by a thread of its own, which nobody has to end.
        ends = nobody_asks if role == "gyro" else attend
        tap = taps.get(role)
        return opened_within(
            wire.url, lambda: SerialTransport(wire.url, wire.baud, tap=tap, attend=ends), attend
        )

    opening = open_port or serial_port

    def transport(role: str) -> Transport:
        return ReopeningTransport(lambda: opening(role, wires[role]))

    return Bench(
        _gyro(profile, wires["gyro"], clock, lambda: opening("gyro", wires["gyro"]), open_port is None),
        _table(wires["table"], clock, prompt, transport),
        _chamber(profile, wires["chamber"], clock, prompt, transport),
        describe=", ".join(f"{role} {wire.kind}" for role, wire in wires.items()),
    )


def _gyro(
    profile: Profile, wire: Wire, clock: Clock, opening: Callable[[], Transport], threaded: bool
) -> WireGyro:
    kind = GYROS[wire.kind]
    rate_hz = profile.sensor.sample_rate_hz
    spec = StreamSpec(
        f"{wire.kind} on {wire.url}",
        rate_hz,
        wire.baud,
        max(_SILENCE_S, _SILENT_SAMPLES / rate_hz),
        kind.commands,
        max(0.5, _SILENT_SAMPLES / rate_hz),
    )
    return WireGyro(spec, opening, lambda: kind.decoder(wire.options), clock, threaded=threaded)


def _table(wire: Wire, clock: Clock, prompt: Prompt, transport: Callable[[str], Transport]) -> RateTable:
    if wire.kind == MANUAL:
        return MANUAL_TABLE[1](prompt, clock, wire.options)
    return TABLES[wire.kind].driver(transport("table"), clock, wire.options)


def _chamber(
    profile: Profile, wire: Wire, clock: Clock, prompt: Prompt, transport: Callable[[str], Transport]
) -> Chamber:
    if wire.kind == MANUAL:
        return MANUAL_CHAMBER[1](prompt, clock, wire.options)
    kind = CHAMBERS[wire.kind]
    chamber: Chamber = kind.driver(transport("chamber"), clock, wire.options)
    if not kind.ramps:
        chamber = SteppedChamber(chamber, clock)
    return AlarmsByHand(chamber) if profile.chamber.own_alarms_set else chamber
