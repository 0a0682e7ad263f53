"""Acutronic ACUTROL3000, ACL language over TCP port 9878 (protocols.md 2.2).

Every command is answered by a fixed-length prefix (error code and message length) and data. Faults latch: after one,
only an explicit reset at the controller lets the table move again, so this driver never resets by itself. Answers carry
no number, and a rate looks like an angle: where one may be owed, the interlock is asked first, which answers by a word.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

T = TypeVar("T")

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


@dataclass(frozen=True)
class Options:
    """What differs between units.

    Attributes
    ----------
    axis : int
        Axis of the table.
    prefix_characters : int
        Length of the answer's prefix on TCP, 8 by one public driver.
    code_characters : int
        How many of them, from the first, are the error code; the split is not documented.
    max_rate_dps, max_acceleration_dps2 : float
        The table's own limits.
    trip_margin : float
        The controller's independent over-rate trip is set to this times `max_rate_dps`.
    counter_clockwise_positive : bool
        Sign of a positive rate, seen from above.
    timeout_s : float
        Longest wait for an answer.
    """

    axis: int = number(1, 9, "", 1)
    prefix_characters: int = number(1, 64, "", 8)
    code_characters: int = number(1, 64, "", 4)
    max_rate_dps: float = number(0.001, 20000.0, "deg/s", 400.0)
    max_acceleration_dps2: float = number(0.001, 1e6, "deg/s^2", 200.0)
    trip_margin: float = number(1.0, 10.0, "", 1.1)
    counter_clockwise_positive: bool = True
    timeout_s: float = number(0.01, 60.0, "s", 2.0)


class AcutrolTable:
    """Driver of an ACUTROL3000 axis; see `gyrocal.bench.devices.RateTable`. Rates deg/s, angles deg."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        sync = (f":Interlock? {options.axis}\r\n".encode(), self._a_word)
        self._talk = Conversation(transport, "ACUTROL table", ended_by(b"\r\n"), options.timeout_s, sync)
        self._clock = clock
        self._options = options
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0
        self._in_rate_mode = False

    def limits(self) -> TableLimits:
        """Limits of the table, from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Lock the panel, set the independent over-rate trip, close the interlock at rate zero; does not move."""
        axis = self._options.axis
        self._in_rate_mode = False
        self._command(":Utility:Lockout ON")
        trip_dps = self._options.max_rate_dps * self._options.trip_margin
        self._command(f":Limit:Vtrip R,{axis},{trip_dps:.3f}")
        faults = self.faults()
        if faults:
            msg = f"ACUTROL table: {faults[0]} is latched. Find its cause, reset it at the controller, and start again."
            raise DeviceError(msg)
        self._command(f":Interlock:Close {axis}")

    def set_rate(self, rate_dps: float) -> float:
        """``:Demand:Rate`` in rate mode; returns the rate as sent."""
        limit = self._options.max_rate_dps
        if not abs(rate_dps) <= limit:
            msg = (
                f"ACUTROL table: {rate_dps:g} deg/s is beyond the limit of {limit:g} deg/s; nothing was sent."
            )
            raise DeviceError(msg)
        if not self._in_rate_mode:
            self._command(f":Mode:Rate {self._options.axis}")
            self._in_rate_mode = True
        text = f"{self._sign * rate_dps:.6f}"
        self._command(f":Demand:Rate {self._options.axis},{text}")
        return self._sign * float(text)

    def read(self) -> TableReading:
        """``:Read:Rate?`` and ``:Read:Position?``; its time is the middle of question and answer of the angle."""
        rate_dps = self._sign * self._data(f":Read:Rate? {self._options.axis}")
        asked_s = self._clock.now_s()
        angle_deg = self._sign * self._data(f":Read:Position? {self._options.axis}")
        return TableReading.between(asked_s, self._clock.now_s(), rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """The interlock's own word, when it is a fault."""
        state = self._command(f":Interlock? {self._options.axis}")
        return (f"interlock {state}",) if "fault" in state.lower() else ()

    def send_stop(self) -> None:
        """``:Mode:Off``: closed-loop deceleration to zero, sent without waiting."""
        self._in_rate_mode = False
        self._talk.send(f":Mode:Off {self._options.axis}\r\n".encode())

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _command(self, command: str) -> str:
        """Send a command; returns its answer, which is a word."""
        return self._ask(command, lambda data: data if _as_number(data) is None else None)

    def _data(self, command: str) -> float:
        """Send a question; returns its answer, which is a number."""
        return self._ask(command, _as_number)

    def _ask(self, command: str, accept: Callable[[str], T | None]) -> T:
        def accept_answer(answer: bytes) -> T | None:
            parsed = self._parsed(answer)
            if parsed is None:
                return None
            code, data = parsed
            if code != 0:
                msg = f"ACUTROL table: error {code} to {command!r} ({data}). See :Query:Error? {code}."
                raise DeviceError(msg)
            return accept(data)

        return self._talk.ask(f"{command}\r\n".encode(), accept_answer)

    def _a_word(self, answer: bytes) -> bool | None:
        """Whether an answer can be that of the interlock: no number. An interlock that cannot be asked answers too."""
        parsed = self._parsed(answer)
        return None if parsed is None or _as_number(parsed[1]) is not None else True

    def _parsed(self, answer: bytes) -> tuple[int, str] | None:
        """Error code and data; None for an answer without a prefix."""
        text = answer.decode("ascii", errors="replace")
        length = self._options.prefix_characters
        code = text[: min(length, self._options.code_characters)].strip()
        if len(text) < length or not code.lstrip("-").isdigit():
            return None
        return int(code), text[length:].strip()


def _as_number(text: str) -> float | None:
    """The number that a text is; None where it is none."""
    return float(text) if _NUMBER.fullmatch(text) else None


class AcutrolResponder(LineResponder):
    """The controller's side: commands to `table`."""

    terminator = b"\n"

    def __init__(self, table: RateTable, options: Options = Options()) -> None:
        super().__init__()
        self._table = table
        self._options = options
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0
        self._rate_mode = False
        self._closed = False

    def answer(self, line: str) -> bytes:
        """Answer of the controller: code and length in the prefix, then data."""
        code, data = self._perform(line)
        rest = self._options.prefix_characters - self._options.code_characters
        length = f"{len(data):0{rest}d}" if rest > 0 else ""
        return f"{code:0{self._options.code_characters}d}{length}{data}\r\n".encode()

    def _perform(self, line: str) -> tuple[int, str]:
        word, _, argument = line.lower().partition(" ")
        reading = self._table.read()
        match word:
            case ":utility:lockout" | ":limit:vtrip":
                return 0, "OK"
            case ":interlock:close":
                self._closed = True
                return 0, "OK"
            case ":interlock?":
                return 0, "Fault" if self._table.faults() else ("Closed" if self._closed else "Open")
            case ":mode:rate" if self._closed:
                self._rate_mode = True
                return 0, "OK"
            case ":mode:off":
                self._rate_mode = False
                self._table.set_rate(0.0)
                return 0, "OK"
            case ":demand:rate" if self._rate_mode:
                return self._demand(argument)
            case ":read:position?":
                return 0, f"{self._sign * reading.angle_deg:.6f}"
            case ":read:rate?":
                return 0, f"{self._sign * reading.rate_dps:.6f}"
        return 113, "command not recognised"

    def _demand(self, argument: str) -> tuple[int, str]:
        try:
            self._table.set_rate(self._sign * float(argument.partition(",")[2]))
        except ValueError:
            return 104, "number expected"
        return 0, "OK"
