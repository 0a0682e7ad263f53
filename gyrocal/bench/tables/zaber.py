"""Zaber rotary stages, ASCII protocol: ``/1 1 07 move vel 17476`` at 115200 8N1 (protocols.md 2.3).

Data are microsteps, velocities microsteps/s times 1.6384. Requests are numbered from 1 to 99, and replies ``@DD A II
OK|RJ IDLE|BUSY WF data`` carry the number of theirs, optionally with an LRC checksum behind a colon, which this driver
asks for by sending one. So a reply that comes late is known for what it is.

The flag ``NI`` (movement interrupted) is raised by each movement command that comes while the axis moves, and stays
until one comes on an idle axis: going from rate to rate raises it. Only an ``NI`` that no command of ours explains, or
``NC``, is somebody at the knob.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

VELOCITY_FACTOR = 1.6384
#: Warning flags that spoil a data set beside the faults ``F*``, in words.
FAILING_WARNINGS = {
    "WS": "stalled, with recovery",
    "NC": "somebody turns the knob",
    "NI": "movement interrupted by no command of this program: somebody turns the knob",
    "NT": "value truncated",
}
_INTERRUPTED = "NI"
_NUMBERS = 99

_REPLY = re.compile(
    r"@(?P<device>\d\d) \d (?P<number>\d\d) (?P<flag>OK|RJ) (?P<status>IDLE|BUSY) (?P<warning>--|[A-Z]{2}) "
    r"(?P<data>[^:]*)(?::(?P<check>[0-9A-F]{2}))?"
)


@dataclass(frozen=True)
class Options:
    """What differs between units.

    Attributes
    ----------
    device, axis : int
        Address of the stage.
    microsteps_per_rev : int
        384000 for the X-RSW60C.
    max_rate_dps, max_acceleration_dps2 : float
        The stage's own limits.
    reads_velocity : bool
        Whether the firmware knows ``get vel``, which is not verified; without it the rate is the way from one
        reading of the position to the next, and `settle.tolerance_dps` has to bear the unrest of its times.
    counter_clockwise_positive : bool
        Sign of a positive velocity, seen from above.
    timeout_s : float
        Longest wait for an answer.
    """

    device: int = number(1, 99, "", 1)
    axis: int = number(0, 9, "", 1)
    microsteps_per_rev: int = number(1, 10**9, "", 384_000)
    max_rate_dps: float = number(0.001, 20000.0, "deg/s", 150.0)
    max_acceleration_dps2: float = number(0.001, 1e6, "deg/s^2", 100.0)
    reads_velocity: bool = True
    counter_clockwise_positive: bool = True
    timeout_s: float = number(0.01, 60.0, "s", 1.0)

    @property
    def data_per_dps(self) -> float:
        """Velocity data of 1 deg/s counter-clockwise."""
        scale = self.microsteps_per_rev / 360.0 * VELOCITY_FACTOR
        return scale if self.counter_clockwise_positive else -scale

    @property
    def data_per_deg(self) -> float:
        """Position data of 1 deg counter-clockwise."""
        return self.data_per_dps / VELOCITY_FACTOR


def lrc(text: str) -> str:
    """Checksum of a message without its first character: two's complement of the byte sum, two hex digits."""
    return f"{-sum(text.encode()) & 0xFF:02X}"


class ZaberTable:
    """Driver of a Zaber rotary stage; see `gyrocal.bench.devices.RateTable`. Rates deg/s, angles deg."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        self._talk = Conversation(transport, "Zaber table", ended_by(b"\n"), options.timeout_s)
        self._clock = clock
        self._options = options
        self._number = 0
        self._warning = "--"
        self._idle = False
        #: Whether an NI would be of our own making, or of a program before us.
        self._explained = True
        self._last: TableReading | None = None

    def limits(self) -> TableLimits:
        """Limits of the stage, from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Ask for the status; does not move."""
        self._last = None
        self._ask("")
        self._explained = self._warning == _INTERRUPTED

    def set_rate(self, rate_dps: float) -> float:
        """``move vel``; returns the rate of the rounded velocity, which is the one the stage can make."""
        limit = self._options.max_rate_dps
        if not abs(rate_dps) <= limit:
            msg = f"Zaber table: {rate_dps:g} deg/s is beyond the limit of {limit:g} deg/s; nothing was sent."
            raise DeviceError(msg)
        data = round(rate_dps * self._options.data_per_dps)
        was_idle = self._moving()
        self._ask("stop" if data == 0 else f"move vel {data}")
        self._explained = not was_idle
        return data / self._options.data_per_dps

    def read(self) -> TableReading:
        """``get vel`` and ``get pos``: measured rate and angle; its time is the middle of question and answer of the angle.

        Without ``get vel`` the first reading has no rate (NaN).
        """
        known = self._options.reads_velocity
        rate_dps = self._data("get vel") / self._options.data_per_dps if known else math.nan
        asked_s = self._clock.now_s()
        angle_deg = self._data("get pos") / self._options.data_per_deg
        reading = TableReading.between(asked_s, self._clock.now_s(), rate_dps, angle_deg)
        last = self._last
        if not known and last is not None and reading.t_s > last.t_s:
            reading = replace(reading, rate_dps=(angle_deg - last.angle_deg) / (reading.t_s - last.t_s))
        self._last = reading
        return reading

    def faults(self) -> tuple[str, ...]:
        """The warning flag, when it is a fault or would spoil a data set."""
        self._ask("")
        flag = self._warning
        if flag == _INTERRUPTED and self._explained:
            return ()
        if flag in FAILING_WARNINGS:
            return (f"Zaber warning flag {flag} ({FAILING_WARNINGS[flag]})",)
        return (f"Zaber warning flag {flag}",) if flag.startswith("F") else ()

    def send_stop(self) -> None:
        """``stop``, complete with its terminator, without waiting."""
        was_idle = self._moving()
        self._talk.send(self._message("stop"))
        self._explained = not was_idle

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _moving(self) -> bool:
        """A movement command is about to be sent: until it is known to have come, an NI is ours. Whether all was idle."""
        was_idle, self._idle, self._explained = self._idle, False, True
        return was_idle

    def _message(self, command: str) -> bytes:
        self._number = self._number % _NUMBERS + 1
        body = f"{self._options.device} {self._options.axis} {self._number:02d} {command}".strip()
        return f"/{body}:{lrc(body)}\r\n".encode()

    def _ask(self, command: str) -> str:
        reply = self._talk.ask(self._message(command), self._reply)
        self._warning, self._idle = reply["warning"], reply["status"] == "IDLE"
        if reply["flag"] == "RJ":
            raise DeviceError(f"Zaber table: rejected {command!r} ({reply['data'].strip()}). See its manual.")
        return str(reply["data"].strip())

    def _reply(self, answer: bytes) -> re.Match[str] | None:
        """The reply to the last request; None for those to others, damaged ones, information and alerts."""
        text = answer.decode("ascii", errors="replace").strip()
        reply = _REPLY.fullmatch(text)
        if reply is None or int(reply["number"]) != self._number:
            return None
        if reply["check"] is not None and reply["check"] != lrc(text[1:].rsplit(":", 1)[0]):
            return None
        return reply if int(reply["device"]) == self._options.device else None

    def _data(self, command: str) -> float:
        text = self._ask(command)
        try:
            return float(text)
        except ValueError as error:
            msg = f"Zaber table: answered {text!r} to {command!r}, and a number is wanted."
            raise DeviceError(msg) from error


class ZaberResponder(LineResponder):
    """The stage's side: commands to `table`."""

    terminator = b"\n"

    def __init__(self, table: RateTable, options: Options = Options()) -> None:
        super().__init__()
        self._table = table
        self._options = options
        self._interrupted = False

    def answer(self, line: str) -> bytes:
        """Answer of the stage; silent to other devices and to damaged messages."""
        body, _, check = line.removeprefix("/").partition(":")
        parts = body.split()
        if not line.startswith("/") or len(parts) < 2 or (check and check != lrc(body)):
            return b""
        if parts[:2] != [str(self._options.device), str(self._options.axis)]:
            return b""
        numbered = parts[2:3] if len(parts) > 2 and parts[2].isdigit() else []
        busy = self._busy()
        flag, data = self._perform(parts[2 + len(numbered) :], busy)
        status = "BUSY" if busy or self._busy() else "IDLE"
        warning = "FD" if self._table.faults() else "NI" if self._interrupted else "--"
        head = " ".join([f"{self._options.device:02d} {self._options.axis}", *numbered])
        reply = f"{head} {flag} {status} {warning} {data}"
        return f"@{reply}:{lrc(reply)}\r\n".encode()

    def _busy(self) -> bool:
        return abs(self._table.read().rate_dps) > 1e-3

    def _perform(self, words: list[str], busy: bool) -> tuple[str, str]:
        reading = self._table.read()
        if words[:1] in (["stop"], ["move"]):
            self._interrupted = busy
        match words:
            case [] | ["home"]:
                return "OK", "0"
            case ["stop"]:
                self._table.set_rate(0.0)
                return "OK", "0"
            case ["move", "vel", number] if re.fullmatch(r"-?\d+", number):
                self._table.set_rate(int(number) / self._options.data_per_dps)
                return "OK", "0"
            case ["get", "pos"]:
                return "OK", str(round(reading.angle_deg * self._options.data_per_deg))
            case ["get", "vel"]:
                return "OK", str(round(reading.rate_dps * self._options.data_per_dps))
        return "RJ", "BADCOMMAND"
