"""The faults of a bench, made to order, and what has to come of each: the README's table is read against this one."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gyrocal.bench.devices import ChamberReading, GyroSamples, TableReading
from gyrocal.bench.tables import zaber
from gyrocal.bench.virtual.server import GyroPort, Line
from gyrocal.errors import DeviceError, GyrocalError, InterlockError, StopNotVerifiedError
from tests.bench.onwire.faulty import (
    ChangedLine,
    CutLine,
    DisorderlyLine,
    EchoingLine,
    LateLine,
    NoisyLine,
    Span,
    bad_status,
    stuck,
    thermometer_shows,
)
from tests.bench.onwire.stand import WireStand

#: While the first data sets are recorded, s.
MIDDLE = Span(28.0, 31.5)
FOR_GOOD = Span(28.0)

TABLES = ("json-lines", "zaber", "aerosmith", "acutrol")
CHAMBERS = ("watlow-f4t-scpi", "espec", "watlow-f4", "watlow-f4t-modbus", "weiss")
#: Every kind of table and of chamber at least once, in pairs.
PAIRS = [(TABLES[k % len(TABLES)], chamber) for k, chamber in enumerate(CHAMBERS)]

#: Commands that move a table, and those among them that stop it.
_MOTIONS = re.compile(rb'"command": "(?:set_rate|stop)"|move vel|stop|JOG|STO|:Demand:Rate|:Mode:Off')
_STOPS = (b'"command": "stop"', b"stop", b"STO", b":Mode:Off")


def motions(stand: WireStand) -> list[bytes]:
    """Commands that the program gave the table to move or to stop."""
    return _MOTIONS.findall(stand.ports["table"].sent)


def check_safe(stand: WireStand, *, table_told: bool = True, chamber_told: bool = True) -> None:
    """The last motion command is a stop and was obeyed; the chamber goes to its safe set point."""
    if table_told:
        assert motions(stand)[-1] in _STOPS
        stand.clock.sleep(3.0)
        assert stand.world.read_table()[0] == 0.0
    if chamber_told:
        assert stand.chamber.read().setpoint_c == 21.0


def refusing(data: bytes) -> bytes:
    """The answers of a table that refuses, in the place of good ones, in its own words."""
    if data.endswith(b">"):
        return b"?\r\n>" * data.count(b">")
    return b"".join(map(_refusal, data.splitlines(keepends=True)))


def _refusal(data: bytes) -> bytes:
    if data.startswith(b"{"):
        return json.dumps({"ok": False, "error": "busy", "id": json.loads(data).get("id")}).encode() + b"\n"
    if data.startswith(b"@"):
        body = (
            data[1:].decode().partition(":")[0].replace(" OK ", " RJ ", 1).rsplit(" ", 1)[0] + " STATUSBUSY"
        )
        return f"@{body}:{zaber.lrc(body)}\r\n".encode()
    return b"01130004busy\r\n"


def bench_of(table: str, chamber: str) -> dict[str, Any]:
    """A bench of these kinds, for `WireStand`: with what their protocols need to tell of a fault."""
    bench: dict[str, Any] = {
        "table": table,
        "chamber": chamber,
        "virtual__chamber__ripple_c": 0.0,
        "settle__tolerance_dps": 0.05,
    }
    if chamber == "weiss":
        bench |= {"chamber__device": "weiss:here", "chamber__options": {"fault_bit": 3}}
    return bench


#: Rows that a kind cannot tell of, and what comes of them there.
UNSEEN = {
    ("table reports a fault", "aerosmith"): "complete",  # the bits of its status word are documented nowhere
    ("chamber switches itself off", "watlow-f4"): "complete",  # it has no register for it
}


@dataclass(frozen=True)
class Fault:
    """A fault and what has to come of it: an error with these words, or a summary."""

    expect: str
    lines: dict[str, Callable[[], Line]] = field(default_factory=dict)
    error: type[GyrocalError] | None = None
    says: str = ""
    stand: dict[str, Any] = field(default_factory=dict)
    chamber_told: bool = True
    table_told: bool = True


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def vanishing(role: str, span: Span) -> Callable[[WireStand, float], None]:
    """Pull the plug of a port, and put it back."""

    def at(stand: WireStand, now_s: float) -> None:
        port = stand.ports[role]
        if span.holds(now_s) and not port.gone:
            port.vanish()
        elif port.gone and now_s >= span.end_s:
            port.come_back()

    return at


def restarting(stand: WireStand, now_s: float) -> None:
    """The gyro loses its supply for a second and a half, and with it its mode."""
    if 28.5 <= now_s < 28.55:
        before = stand.server.gyro
        stand.server.gyro = GyroPort(before.endpoint, before.kind, before.options)
        stand.line("gyro", CutLine(Span(0.0, 30.5)))


def overshooting() -> dict[str, Any]:
    """A table that is five per cent too fast for three seconds after each command, which is waited for."""
    commanded_s = [0.0]

    def command(now_s: float, rate_dps: float) -> float:
        commanded_s[0] = now_s
        return rate_dps

    def reading(now: TableReading) -> TableReading:
        return replace(now, rate_dps=now.rate_dps * (1.05 if now.t_s - commanded_s[0] < 3.0 else 1.0))

    return {"command": command, "reading": reading}


def lost_place(reading: TableReading) -> TableReading:
    """The encoder has lost a quarter turn."""
    return replace(reading, angle_deg=reading.angle_deg + (90.0 if reading.t_s > 30.0 else 0.0))


def wrapped(reading: TableReading) -> TableReading:
    """A controller that counts from 0 to 360 deg."""
    return replace(reading, angle_deg=(reading.angle_deg + 350.0) % 360.0)


def frozen() -> Callable[[ChamberReading], ChamberReading]:
    """A chamber that shows the same for ever."""
    last: list[ChamberReading] = []

    def reading(now: ChamberReading) -> ChamberReading:
        if now.t_s < 46.0 or not last:
            last[:] = [now]
        return replace(now, temp_c=last[0].temp_c)

    return reading


def in_hundredths(samples: GyroSamples) -> GyroSamples:
    """A thermometer set to whole degrees, read as hundredths."""
    return replace(samples, gyro_temp_c=0.01 * samples.gyro_temp_c)


#: ``expect``: complete (all recorded, perhaps at a later attempt), marked (recorded, not all settled), failed (the
#: summary says which), ended (an error, the bench safe).
FAULTS: dict[str, Fault] = {
    # the gyro's line
    "0.1 % of frames damaged": Fault("complete", {"gyro": lambda: NoisyLine(rng(), flipped=0.001 / 36)}),
    # so long that more than two per cent in three attempts is no chance
    "1 % of frames damaged": Fault(
        "complete", {"gyro": lambda: NoisyLine(rng(), flipped=0.01 / 36)}, stand={"plan__dwell_s": 15.0}
    ),
    "10 % of frames damaged": Fault(
        "failed", {"gyro": lambda: NoisyLine(rng(), flipped=0.1 / 36)}, says="frames were damaged"
    ),
    "bytes dropped": Fault("failed", {"gyro": lambda: NoisyLine(rng(), lost=0.01)}, says="were damaged"),
    "frames lost for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), lost=0.5, span=MIDDLE)}
    ),
    "frames repeated for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), repeated=0.5, span=MIDDLE)}
    ),
    "frames out of sequence for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), swapped=0.5, span=MIDDLE)}
    ),
    "gyro silent for a while": Fault("complete", {"gyro": lambda: CutLine(MIDDLE)}),
    "gyro silent for good": Fault(
        "ended", {"gyro": lambda: CutLine(FOR_GOOD)}, DeviceError, "no byte came within"
    ),
    "gyro at another baud rate": Fault(
        "ended",
        {"gyro": lambda: ChangedLine(lambda data: bytes(b & 0x5A for b in data))},
        DeviceError,
        "no frame among them. The baud rate is wrong",
    ),
    "gyro port vanishes and returns": Fault("complete", stand={"at": vanishing("gyro", MIDDLE)}),
    "gyro port vanishes for good": Fault(
        "ended", error=DeviceError, says="no such port", stand={"at": vanishing("gyro", FOR_GOOD)}
    ),
    "gyro restarts, mode lost": Fault("complete", stand={"at": restarting, "gyro": "vn100"}),
    # the gyro
    "gyro stuck for a while": Fault(
        "complete", stand={"faulty_gyro": stuck(MIDDLE), "stream__stuck_samples": 20}
    ),
    "gyro stuck for good": Fault(
        "failed", says="it is stuck", stand={"faulty_gyro": stuck(FOR_GOOD), "stream__stuck_samples": 20}
    ),
    "gyro calls its samples bad for a while": Fault("complete", stand={"faulty_gyro": bad_status(MIDDLE)}),
    "gyro calls its samples bad": Fault(
        "ended", error=DeviceError, says="the device calls", stand={"faulty_gyro": bad_status(Span())}
    ),
    "gyro thermometer dead": Fault(
        "ended",
        error=InterlockError,
        says="outside -45 to 80 °C",
        stand={"faulty_gyro": thermometer_shows(FOR_GOOD, -300.0)},
    ),
    "gyro too hot from the start": Fault(
        "ended",
        error=InterlockError,
        says="the gyro is at 90.0 °C",
        stand={"faulty_gyro": thermometer_shows(Span(), 90.0)},
    ),
    "gyro thermometer frozen": Fault(
        "ended",
        error=InterlockError,
        says="thermometer moved by 0.00 °C: it is frozen",
        stand={"faulty_gyro": thermometer_shows(Span(10.0), 20.3), "plan__temperatures_c": [20.0, 26.0]},
    ),
    "gyro thermometer in another unit": Fault(
        "ended",
        error=InterlockError,
        says="or its unit is wrong",
        stand={"faulty_gyro": in_hundredths, "plan__temperatures_c": [20.0, 26.0]},
    ),
    # the table's line
    "table answers late": Fault("complete", {"table": lambda: LateLine(0.4)}),
    "table answers too late for a while": Fault("complete", {"table": lambda: LateLine(5.0, MIDDLE)}),
    "table gives half an answer for a while": Fault(
        "complete", {"table": lambda: ChangedLine(lambda data: data[: len(data) // 2], MIDDLE)}
    ),
    "table gives garbage for a while": Fault(
        "complete", {"table": lambda: ChangedLine(lambda data: b"\xf0\n" * 9, MIDDLE)}
    ),
    "table line echoes for a while": Fault("complete", {"table": lambda: EchoingLine(MIDDLE)}),
    "table refuses for a while": Fault("complete", {"table": lambda: ChangedLine(refusing, MIDDLE)}),
    "1 % of the table's bytes damaged": Fault(
        "complete", {"table": lambda: NoisyLine(rng(), flipped=0.0003)}
    ),
    "table silent for good": Fault(
        "ended", {"table": lambda: CutLine(FOR_GOOD)}, StopNotVerifiedError, "MAY STILL BE TURNING"
    ),
    "table port vanishes and returns": Fault("complete", stand={"at": vanishing("table", MIDDLE)}),
    "table port vanishes for good": Fault(
        "ended",
        error=StopNotVerifiedError,
        says="MAY STILL BE TURNING",
        stand={"at": vanishing("table", FOR_GOOD)},
        table_told=False,
    ),
    # the table
    "table never at rate": Fault(
        "marked", says="the table reached", stand={"faulty_table": {"command": lambda t_s, dps: 0.99 * dps}}
    ),
    "table overshoots": Fault("complete", stand={"faulty_table": overshooting()}),
    "table stalls": Fault(
        "marked",
        says="the table reached",
        stand={"faulty_table": {"command": lambda t_s, dps: 0.0 if t_s > 26.0 else dps}},
    ),
    "table drifts": Fault(
        "marked",
        says="deg/s",
        stand={"faulty_table": {"reading": lambda r: replace(r, rate_dps=r.rate_dps * (1 + 1e-4 * r.t_s))}},
    ),
    "table loses its place": Fault(
        "marked", says="it lost its place", stand={"faulty_table": {"reading": lost_place}}
    ),
    "table's angle wraps at 360 deg": Fault("complete", stand={"faulty_table": {"reading": wrapped}}),
    "table reports a fault": Fault(
        "ended",
        error=InterlockError,
        says="the table reports",
        stand={"faulty_table": {"fault": lambda t_s: ("encoder lost",) if t_s > 28.0 else ()}},
    ),
    "table runs away": Fault(
        "ended",
        error=InterlockError,
        says="the table turns at",
        stand={"faulty_table": {"command": lambda t_s, dps: 4.5 * dps}},
    ),
    # the chamber's line
    "chamber answers late": Fault("complete", {"chamber": lambda: LateLine(0.3)}),
    "chamber gives garbage for a while": Fault(
        "complete", {"chamber": lambda: ChangedLine(lambda data: b"\xf0\n", MIDDLE)}
    ),
    "chamber port vanishes and returns": Fault("complete", stand={"at": vanishing("chamber", MIDDLE)}),
    "chamber port vanishes for good": Fault(
        "ended",
        error=DeviceError,
        says="no such port",
        stand={"at": vanishing("chamber", FOR_GOOD)},
        chamber_told=False,
    ),
    # the chamber
    "chamber never arrives": Fault(
        "marked", says="the chamber was at", stand={"faulty_chamber": {"heard": lambda c: min(c, 20.6)}}
    ),
    "chamber overshoots": Fault(
        "complete",
        stand={
            "faulty_chamber": {"reading": lambda r: replace(r, temp_c=r.temp_c + 3.0 * np.exp(-r.t_s / 4.0))}
        },
    ),
    "chamber freezes": Fault(
        "marked", says="the chamber was at", stand={"faulty_chamber": {"reading": frozen()}}
    ),
    "chamber reports an alarm": Fault(
        "ended",
        error=InterlockError,
        says="the chamber reports",
        stand={
            "faulty_chamber": {"reading": lambda r: replace(r, alarms=("door open",) if r.t_s > 28.0 else ())}
        },
    ),
    "chamber switches itself off": Fault(
        "ended",
        error=InterlockError,
        says="the chamber is not running",
        stand={"faulty_chamber": {"reading": lambda r: replace(r, running=r.t_s < 28.0)}},
    ),
}
