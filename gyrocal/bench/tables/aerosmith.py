"""Ideal Aerosmith rate tables (1270VS, AERO language): three letters, a number, CR; 9600 8N1 (protocols.md 2.1).

An answer is a line (a value or nothing) and the prompt ``>``; a ``?`` in it means "not understood". ``JOG`` answers
only when the motion ends or the next command comes. Answers carry no number and no name, and a rate looks like an
angle: where one may be owed, a command whose answer is no number comes before the next question.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import RateTable, TableLimits, TableReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

PROMPT = b">"
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
#: The answer to a question; some firmware repeats the question before it.
_VALUE = re.compile(rf"(?:PVE|PPO)?\s*{_NUMBER.pattern}")


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
        #: Sets what is set already.
        self._acceleration = f"ACL{options.max_acceleration_dps2:.0f}"
        sync = (f"{self._acceleration}\r".encode(), _no_number)
        self._talk = Conversation(transport, "Aerosmith table", ended_by(PROMPT), options.timeout_s, sync)
        self._clock = clock
        self._options = options
        self._sign = 1.0 if options.counter_clockwise_positive else -1.0

    def limits(self) -> TableLimits:
        """Limits of the table, from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Check that the controller answers, and set the acceleration; does not move."""
        self._data("PVE")
        self._command(self._acceleration)

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
            self._command("STO")
            return 0.0
        self._talk.send(f"JOG{wire:.{self._options.decimals}f}\r".encode())
        return self._sign * wire

    def read(self) -> TableReading:
        """``PVE`` and ``PPO``: measured rate and angle; its time is the middle of question and answer of the angle."""
        rate_dps = self._sign * self._data("PVE")
        asked_s = self._clock.now_s()
        angle_deg = self._sign * self._data("PPO")
        return TableReading.between(asked_s, self._clock.now_s(), rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """Empty: the bits of ``STA`` are documented nowhere; a fault shows as a rate that is not reached."""
        return ()

    def send_stop(self) -> None:
        """``STO``, with its terminator, without waiting."""
        self._talk.send(b"STO\r")

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()

    def _command(self, command: str) -> None:
        """Send a command, which is answered by a blank line."""

        def accept(answer: bytes) -> bool | None:
            _check_understood(answer, command)
            return _no_number(answer)

        self._talk.ask(f"{command}\r".encode(), accept)

    def _data(self, command: str) -> float:
        """Send a question; returns its answer, which is a number."""

        def accept(answer: bytes) -> float | None:
            _check_understood(answer, command)
            # Some firmware, and a line with local echo, repeat the command before the value.
            text = _text(answer).removeprefix(command).strip()
            return float(text) if _NUMBER.fullmatch(text) else None

        return self._talk.ask(f"{command}\r".encode(), accept)


def _text(answer: bytes) -> str:
    return answer.decode("ascii", errors="replace").strip()


def _check_understood(answer: bytes, command: str) -> None:
    if b"?" in answer:
        msg = f"Aerosmith table: did not understand {command!r} (answered {_text(answer)!r}). Check its firmware."
        raise DeviceError(msg)


def _no_number(answer: bytes) -> bool | None:
    """Whether an answer is that of a command: blank, its echo, or a refusal; those to questions are numbers."""
    return None if _VALUE.fullmatch(_text(answer)) else True


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
