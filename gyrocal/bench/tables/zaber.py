"""Zaber rotary stages, ASCII protocol: ``/1 1 move vel 17476`` at 115200 8N1 (protocols.md 2.3).

Data are microsteps, velocities microsteps/s times 1.6384. Replies ``@DD A OK|RJ IDLE|BUSY WF data``, optionally with
an LRC checksum behind a colon, which this driver asks for by sending one.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Conversation, Transport
from gyrocal.errors import DeviceError

VELOCITY_FACTOR = 1.6384
#: Warning flags that fail a data set: every fault, a stall with recovery, somebody's hand on the knob, truncation.
FAILING_WARNINGS = ("WS", "NC", "NI", "NT")

_REPLY = re.compile(r"@(\d\d) (\d) (OK|RJ) (IDLE|BUSY) (--|[A-Z]{2}) ([^:]*)(?::([0-9A-F]{2}))?")


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
        self._talk = Conversation(transport, "Zaber table", b"\n", options.timeout_s)
        self._clock = clock
        self._options = options
        self._warning = "--"
        self._last: TableReading | None = None

    def limits(self) -> TableLimits:
        """Limits of the stage, from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Ask for the status; does not move."""
        self._last = None
        self._ask("")

    def set_rate(self, rate_dps: float) -> float:
        """``move vel``; returns the rate of the rounded velocity, which is the one the stage can make."""
        limit = self._options.max_rate_dps
        if not abs(rate_dps) <= limit:
            msg = f"Zaber table: {rate_dps:g} deg/s is beyond the limit of {limit:g} deg/s; nothing was sent."
            raise DeviceError(msg)
        data = round(rate_dps * self._options.data_per_dps)
        self._ask("stop" if data == 0 else f"move vel {data}")
        return data / self._options.data_per_dps

    def read(self) -> TableReading:
        """``get vel`` and ``get pos``: measured rate and angle; its time is the middle of question and answer of the angle.

        Without ``get vel`` the first reading has no rate (NaN).
        """
        known = self._options.reads_velocity
        rate_dps = self._number("get vel") / self._options.data_per_dps if known else math.nan
        asked_s = self._clock.now_s()
        angle_deg = self._number("get pos") / self._options.data_per_deg
        t_s = 0.5 * (asked_s + self._clock.now_s())
        last = self._last
        if not known and last is not None and t_s > last.t_s:
            rate_dps = (angle_deg - last.angle_deg) / (t_s - last.t_s)
        self._last = TableReading(t_s, rate_dps, angle_deg)
        return self._last

    def faults(self) -> tuple[str, ...]:
        """The warning flag, when it is a fault or would spoil a data set."""
        self._ask("")
        bad = self._warning.startswith("F") or self._warning in FAILING_WARNINGS
        return (f"Zaber warning flag {self._warning}",) if bad else ()

    def send_stop(self) -> None:
        """``stop``, complete with its terminator, without waiting."""
        self._talk.send(self._message("stop"))

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _message(self, command: str) -> bytes:
        body = f"{self._options.device} {self._options.axis} {command}".strip()
        return f"/{body}:{lrc(body)}\r\n".encode()

    def _ask(self, command: str) -> str:
        answer = self._talk.ask(self._message(command)).decode("ascii", errors="replace").strip()
        while answer.startswith(("#", "!")):
            # Information and alerts may come between request and reply.
            answer = self._talk.receive(command.encode()).decode("ascii", errors="replace").strip()
        match = _REPLY.fullmatch(answer)
        if match is None or (match[7] is not None and match[7] != lrc(answer[1:].rsplit(":", 1)[0])):
            raise DeviceError(
                f"Zaber table: damaged answer {answer!r} to {command!r}. Check cable and baud rate."
            )
        if int(match[1]) != self._options.device:
            raise DeviceError(
                f"Zaber table: device {match[1]} answered, and {self._options.device} was asked."
            )
        self._warning = match[5]
        if match[3] == "RJ":
            raise DeviceError(f"Zaber table: rejected {command!r} ({match[6].strip()}). See its manual.")
        return match[6].strip()

    def _number(self, command: str) -> float:
        return self._talk.number(self._ask(command), command)


class ZaberResponder(LineResponder):
    """The stage's side: commands to `table`."""

    terminator = b"\n"

    def __init__(self, table: RateTable, options: Options = Options()) -> None:
        super().__init__()
        self._table = table
        self._options = options

    def answer(self, line: str) -> bytes:
        """Answer of the stage; silent to other devices and to damaged messages."""
        body, _, check = line.removeprefix("/").partition(":")
        parts = body.split()
        if not line.startswith("/") or len(parts) < 2 or (check and check != lrc(body)):
            return b""
        if parts[:2] != [str(self._options.device), str(self._options.axis)]:
            return b""
        reading = self._table.read()
        status = "BUSY" if abs(reading.rate_dps) > 1e-3 else "IDLE"
        flag, data = self._perform(parts[2:])
        reply = f"{self._options.device:02d} {self._options.axis} {flag} {status} -- {data}"
        return f"@{reply}:{lrc(reply)}\r\n".encode()

    def _perform(self, words: list[str]) -> tuple[str, str]:
        reading = self._table.read()
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
