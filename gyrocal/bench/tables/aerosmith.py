"""Ideal Aerosmith rate tables (1270VS, AERO language): three letters, a number, CR; 9600 8N1 (protocols.md 2.1).

An answer is a line (a value or nothing) and the prompt ``>``; a ``?`` in it means "not understood". ``JOG`` answers
only when the motion ends or the next command comes, so answers are matched by counting prompts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Conversation, Transport
from gyrocal.errors import DeviceError

PROMPT = b">"
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Options:
    """What differs between units.

    Attributes
    ----------
    max_rate_dps, max_acceleration_dps2 : float
        The table's own limits; the controller cannot be asked for them.
    decimals : int
        Digits of a commanded rate; whether fractions are taken is not verified, 0 is what public drivers send.
    counter_clockwise_positive : bool
        False by the public drivers: a negative ``JOG`` turns counter-clockwise.
    timeout_s : float
        Longest wait for an answer.
    """

    max_rate_dps: float = number(0.001, 20000.0, "deg/s", 360.0)
    max_acceleration_dps2: float = number(0.001, 1e6, "deg/s^2", 100.0)
    decimals: int = number(0, 9, "", 0)
    counter_clockwise_positive: bool = False
    timeout_s: float = number(0.01, 60.0, "s", 2.0)


class AerosmithTable:
    """Driver of an Ideal Aerosmith table; see `gyrocal.bench.devices.RateTable`. Rates deg/s, angles deg."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        self._talk = Conversation(transport, "Aerosmith table", PROMPT, options.timeout_s)
        self._clock = clock
        self._options = options
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0
        self._owed = 0

    def limits(self) -> TableLimits:
        """Limits of the table, from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Check that the controller answers, and set the acceleration; does not move."""
        self._owed = 0
        self._ask("PVE")
        self._ask(f"ACL{self._options.max_acceleration_dps2:.0f}")

    def set_rate(self, rate_dps: float) -> float:
        """``JOG`` at `rate_dps`; returns the rate as sent, rounded to the controller's decimals."""
        limit = self._options.max_rate_dps
        if not abs(rate_dps) <= limit:
            msg = f"Aerosmith table: {rate_dps:g} deg/s is beyond the limit of {limit:g} deg/s; nothing was sent."
            raise DeviceError(msg)
        wire = round(self._sign * rate_dps, self._options.decimals)
        if wire == 0.0 != rate_dps:
            msg = f"Aerosmith table: {rate_dps:g} deg/s is 0 with {self._options.decimals} decimals; nothing was sent. See decimals in [table.options]."
            raise DeviceError(msg)
        if wire == 0.0:
            # JOG0 is not verified to stop on all firmware; STO is.
            self._ask("STO")
            return 0.0
        self._talk.send(f"JOG{wire:.{self._options.decimals}f}\r".encode())
        self._owed += 1
        return self._sign * wire

    def read(self) -> TableReading:
        """``PVE`` and ``PPO``: measured rate and angle; its time is the middle of question and answer of the angle."""
        rate_dps = self._sign * self._number("PVE")
        asked_s = self._clock.now_s()
        angle_deg = self._sign * self._number("PPO")
        return TableReading(0.5 * (asked_s + self._clock.now_s()), rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """Empty: the bits of ``STA`` are documented nowhere; a fault shows as a rate that is not reached."""
        return ()

    def send_stop(self) -> None:
        """``STO``, with its terminator, without waiting."""
        self._talk.send(b"STO\r")
        self._owed += 1

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _ask(self, command: str) -> str:
        answer = self._talk.ask(f"{command}\r".encode())
        while self._owed and not _says_something(answer, command):
            # An owed JOG or STO answer has come first; the answer to this command is behind it.
            self._owed -= 1
            answer = self._talk.receive(command.encode())
        self._owed = 0
        text = answer.decode("ascii", errors="replace").strip()
        if "?" in text:
            raise DeviceError(
                f"Aerosmith table: did not understand {command!r} (answered {text!r}). Check its firmware."
            )
        return text

    def _number(self, command: str) -> float:
        text = self._ask(command).removeprefix(command).strip()
        if not _NUMBER.fullmatch(text):
            raise DeviceError(f"Aerosmith table: answered {text!r} to {command}, and a number is wanted.")
        return float(text)


def _says_something(answer: bytes, command: str) -> bool:
    """Whether an answer can be that of a query; those to motions are blank."""
    return bool(answer.strip()) or command[:3] not in ("PVE", "PPO")


class AerosmithResponder(LineResponder):
    """The controller's side: commands to `table`, which it holds to its own limits."""

    def __init__(self, table: RateTable, options: Options = Options()) -> None:
        super().__init__()
        self._table = table
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0
        self._jogging = False

    def answer(self, line: str) -> bytes:
        """Answer of the controller."""
        word, value = line[:3].upper(), line[3:].strip()
        owed = b"\r\n>" if self._jogging else b""
        if word == "JOG" and _NUMBER.fullmatch(value):
            self._table.set_rate(self._sign * float(value))
            self._jogging = True
            return owed
        self._jogging = False
        if word == "STO":
            self._table.set_rate(0.0)
            return owed + b"\r\n>"
        if word in ("PVE", "PPO"):
            reading = self._table.read()
            number = self._sign * (reading.rate_dps if word == "PVE" else reading.angle_deg)
            return owed + f"{number:.5f}\r\n>".encode()
        if word == "ACL" and _NUMBER.fullmatch(value):
            return owed + b"\r\n>"
        return owed + b"?\r\n>"
