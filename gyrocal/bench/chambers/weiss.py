"""Weiss / Vötsch chambers, ASCII-2: ``$01I`` and ``$01E`` lines ended by CR, 9600 or TCP 2049 (protocols.md 3.5).

``I`` answers pairs of nominal and actual value for each control variable, then more fields, then 32 digital digits.
``E`` writes everything at once, so what is there is read first and written back with the one change.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gyrocal.bench.chambers.setpoint import check_setpoint, verify_setpoint
from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import Chamber, ChamberLimits, ChamberReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

NAME = "Weiss chamber"
RESOLUTION_C = 0.1
_DIGITS = 32
_FIELD = re.compile(r"-?\d+\.\d")


@dataclass(frozen=True)
class Options:
    """What ``$01?`` tells of a chamber; read it once and write it here.

    Attributes
    ----------
    address : int
        Two-digit address.
    control_variables, set_values : int
        Numbers of control variables (temperature first) and of plain set values in the answer to ``I``.
    nominal_first : bool
        Order within a pair; one public driver has it the other way round.
    start_bit : int
        Digital output (1..32) that starts the chamber; the second on the documented one.
    fault_bit : int
        Digital digit that tells of a fault; 0: none known.
    answers_e : bool
        Whether ``E`` is answered by a line (empty or ``0``); not verified, and the read-back counts either way.
    blanks_between_digits : bool
        Old firmware separates the 32 digits by blanks.
    min_temp_c, max_temp_c, max_ramp_c_per_min : float
        The chamber's own limits.
    timeout_s : float
        Longest wait for an answer.
    """

    address: int = number(0, 99, "", 1)
    control_variables: int = number(1, 99, "", 2)
    set_values: int = number(0, 99, "", 0)
    nominal_first: bool = True
    start_bit: int = number(1, _DIGITS, "", 2)
    fault_bit: int = number(0, _DIGITS, "", 0)
    answers_e: bool = False
    blanks_between_digits: bool = False
    min_temp_c: float = number(-200.0, 300.0, "deg C", -40.0)
    max_temp_c: float = number(-200.0, 300.0, "deg C", 85.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 2.0)
    timeout_s: float = number(0.01, 60.0, "s", 2.0)


@dataclass(frozen=True)
class State:
    """One answer to ``I``: nominal and actual values, plain set values, digital digits."""

    nominal: tuple[float, ...]
    actual: tuple[float, ...]
    set_values: tuple[float, ...]
    digits: str


def parse_state(text: str, options: Options) -> State:
    """Decode an answer to ``I``.

    Raises
    ------
    DeviceError
        Fields or digits do not fit the options.
    """
    words = text.split()
    numbers = [word for word in words if _FIELD.fullmatch(word)]
    digits = "".join(word for word in words if not _FIELD.fullmatch(word))
    wanted = 2 * options.control_variables + options.set_values
    if len(numbers) < wanted or len(digits) < _DIGITS or set(digits) - {"0", "1"}:
        msg = f"{NAME}: answered {text!r}, which does not fit the options ({wanted} numbers and {_DIGITS} digits). Compare with $01?."
        raise DeviceError(msg)
    pairs = [float(number) for number in numbers[: 2 * options.control_variables]]
    first, second = tuple(pairs[0::2]), tuple(pairs[1::2])
    values = tuple(float(number) for number in numbers[2 * options.control_variables : wanted])
    nominal, actual = (first, second) if options.nominal_first else (second, first)
    return State(nominal, actual, values, digits[:_DIGITS])


def format_number(value: float) -> str:
    """Four digits and one decimal, as the chamber writes them: ``0050.0``, ``-012.3``."""
    return f"{value:06.1f}"


class WeissChamber:
    """Driver of a Weiss or Vötsch chamber; see `gyrocal.bench.devices.Chamber`. Temperatures deg C."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        # One question only: a late answer is no worse than a little old.
        self._talk = Conversation(transport, NAME, ended_by(b"\r"), options.timeout_s)
        self._clock = clock
        self._options = options
        self._prefix = f"${options.address:02d}"

    def limits(self) -> ChamberLimits:
        """Limits of the chamber, from the options."""
        o = self._options
        return ChamberLimits(o.min_temp_c, o.max_temp_c, o.max_ramp_c_per_min)

    def start(self) -> None:
        """Write what is there back with the start bit set."""
        state = self._state()
        self._write(state.nominal, state.set_values, _with_bit(state.digits, self._options.start_bit))

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Refused: ASCII-2 cannot set them; the operator does at the panel."""
        msg = (
            f"{NAME}: its protocol cannot set alarm limits. Set them to {low_c:g} and {high_c:g} deg C at the panel "
            "and say own_alarms_set = true in the profile."
        )
        raise DeviceError(msg)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Set point, with all other values written back as they were, read back."""
        check_setpoint(NAME, temp_c, self.limits())
        state = self._state()
        self._write((temp_c, *state.nominal[1:]), state.set_values, state.digits)
        verify_setpoint(NAME, temp_c, lambda: self._state().nominal[0], RESOLUTION_C)

    def read(self) -> ChamberReading:
        """Actual and nominal temperature, start bit and fault bit."""
        state = self._state()
        running = state.digits[self._options.start_bit - 1] == "1"
        fault = self._options.fault_bit and state.digits[self._options.fault_bit - 1] == "1"
        alarms = (f"fault bit {self._options.fault_bit}",) if fault else ()
        return ChamberReading(self._clock.now_s(), state.actual[0], state.nominal[0], running, alarms)

    def close(self) -> None:
        """Close the port; the chamber keeps its set point."""
        self._talk.transport.close()

    def _state(self) -> State:
        def accept(answer: bytes) -> State | None:
            text = answer.decode("ascii", errors="replace")
            return parse_state(text, self._options) if len(text.split()) > 1 else None

        return self._talk.ask(f"{self._prefix}I\r".encode(), accept)

    def _write(self, nominal: tuple[float, ...], set_values: tuple[float, ...], digits: str) -> None:
        numbers = " ".join(format_number(value) for value in (*nominal, *set_values))
        joined = " ".join(digits) if self._options.blanks_between_digits else digits
        request = f"{self._prefix}E {numbers} {joined}\r".encode()
        # What E answers does not count: the caller reads back.
        if self._options.answers_e:
            self._talk.ask(request, lambda answer: True)
        else:
            self._talk.tell(request)


def _with_bit(digits: str, bit: int) -> str:
    return digits[: bit - 1] + "1" + digits[bit:]


class WeissResponder(LineResponder):
    """The chamber's side: commands to `chamber`."""

    def __init__(self, chamber: Chamber, options: Options = Options()) -> None:
        super().__init__()
        self._chamber = chamber
        self._options = options
        self._others = (0.0,) * (options.control_variables - 1)
        self._set_values = (0.0,) * options.set_values
        self._digits = "0" * _DIGITS

    def answer(self, line: str) -> bytes:
        """Answer of the chamber; silent to other addresses, and to ``E`` unless it answers that."""
        prefix = f"${self._options.address:02d}"
        if not line.startswith(prefix):
            return b""
        command = line.removeprefix(prefix)
        if command == "I":
            return self._state()
        if command.startswith("E "):
            self._write(command[2:].split())
            return b"0\r" if self._options.answers_e else b""
        return b""

    def _state(self) -> bytes:
        reading = self._chamber.read()
        pairs = [(reading.setpoint_c, reading.temp_c), *((other, other) for other in self._others)]
        if not self._options.nominal_first:
            pairs = [(actual, nominal) for nominal, actual in pairs]
        numbers = [*(value for pair in pairs for value in pair), *self._set_values]
        digits = list(self._digits)
        digits[self._options.start_bit - 1] = str(int(reading.running))
        if self._options.fault_bit:
            digits[self._options.fault_bit - 1] = str(int(bool(reading.alarms)))
        joined = (" " if self._options.blanks_between_digits else "").join(digits)
        return (" ".join(format_number(value) for value in numbers) + f" {joined}\r").encode()

    def _write(self, words: list[str]) -> None:
        numbers = [float(word) for word in words if _FIELD.fullmatch(word)]
        digits = "".join(word for word in words if not _FIELD.fullmatch(word))
        wanted = self._options.control_variables + self._options.set_values
        if len(numbers) != wanted or len(digits) != _DIGITS or set(digits) - {"0", "1"}:
            return
        self._others = tuple(numbers[1 : self._options.control_variables])
        self._set_values = tuple(numbers[self._options.control_variables :])
        self._digits = digits
        if digits[self._options.start_bit - 1] == "1":
            self._chamber.start()
        if self._options.min_temp_c <= numbers[0] <= self._options.max_temp_c:
            self._chamber.set_setpoint(numbers[0])
