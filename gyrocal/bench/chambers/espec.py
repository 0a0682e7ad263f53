"""ESPEC chambers (SCP-220, P300, SH-641): ASCII lines, CR LF, 9600 or 19200 8N1 or TCP 10001 (protocols.md 3.1).

A query is answered by a data line, a set command by ``OK:`` and its echo, a refusal by ``NA:`` and the reason.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from gyrocal.bench.chambers.setpoint import alarm_not_taken, check_setpoint, verify_setpoint
from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import Chamber, ChamberLimits, ChamberReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

NAME = "ESPEC chamber"
RESOLUTION_C = 0.1
_RUNNING_MODES = ("CONSTANT", "RUN")
#: Forms of the answers: no two commands have the same.
_TYPE = re.compile(rb" *[A-Z]\w* *(,[^,]*){2,3}")
_TEMPERATURES = re.compile(rb" *[-+]?\d+(\.\d+)?( *, *[-+]?\d+(\.\d+)?){3} *")
_MODE = re.compile(rb" *[A-Z]+ *(, *[A-Z ]+)?")
_ALARMS = re.compile(rb" *\d+( *, *\d+ *)*")
_DONE = re.compile(rb" *OK:.*")


@dataclass(frozen=True)
class Options:
    """What differs between units.

    Attributes
    ----------
    address : int or None
        RS-485 address prefix; None on RS-232 and TCP.
    min_temp_c, max_temp_c, max_ramp_c_per_min : float
        The chamber's own limits.
    timeout_s : float
        Longest wait for an answer.
    """

    address: int | None = number(0, 99, "", None)
    min_temp_c: float = number(-200.0, 300.0, "deg C", -40.0)
    max_temp_c: float = number(-200.0, 300.0, "deg C", 85.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 2.0)
    timeout_s: float = number(0.01, 60.0, "s", 3.0)


class EspecChamber:
    """Driver of an ESPEC chamber; see `gyrocal.bench.devices.Chamber`. Temperatures deg C."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        self._prefix = "" if options.address is None else f"{options.address},"
        sync = (f"{self._prefix}TYPE?\r\n".encode(), lambda answer: True if _TYPE.fullmatch(answer) else None)
        self._talk = Conversation(transport, NAME, ended_by(b"\r\n"), options.timeout_s, sync)
        self._clock = clock
        self._options = options

    def limits(self) -> ChamberLimits:
        """Limits of the chamber, from the options."""
        o = self._options
        return ChamberLimits(o.min_temp_c, o.max_temp_c, o.max_ramp_c_per_min)

    def start(self) -> None:
        """Ask who it is and switch it to constant mode."""
        self._ask("TYPE?", _TYPE)
        self._set("MODE,CONSTANT")

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Program the chamber's own alarms around the present set point, so that they hold with the PC dead; read back."""
        setpoint_c = self._temperatures()[1]
        self._set(f"TEMP, S{setpoint_c:.1f} H{high_c:.1f} L{low_c:.1f}")
        shown = self._temperatures()[2:]
        for wanted_c, shown_c in zip((high_c, low_c), shown, strict=True):
            if not abs(shown_c - wanted_c) <= RESOLUTION_C:
                raise alarm_not_taken(NAME, wanted_c, shown_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Set point, read back. The chamber has no ramp in constant mode: the caller steps the set point."""
        check_setpoint(NAME, temp_c, self.limits())
        self._set(f"TEMP, S{temp_c:.1f}")
        verify_setpoint(NAME, temp_c, lambda: self._temperatures()[1], RESOLUTION_C)

    def read(self) -> ChamberReading:
        """``TEMP?``, ``MODE?`` and ``ALARM?``."""
        temp_c, setpoint_c, _, _ = self._temperatures()
        mode = self._ask("MODE?", _MODE).partition(",")[0]
        alarms = [code for code in self._ask("ALARM?", _ALARMS).split(",")[1:] if code]
        texts = tuple(f"ESPEC alarm {code}" for code in alarms)
        return ChamberReading(self._clock.now_s(), temp_c, setpoint_c, mode in _RUNNING_MODES, texts)

    def close(self) -> None:
        """Close the port; the chamber keeps its set point."""
        self._talk.transport.close()

    def _temperatures(self) -> tuple[float, float, float, float]:
        """Air, set point, high and low alarm limit."""
        air_c, setpoint_c, high_c, low_c = map(float, self._ask("TEMP?", _TEMPERATURES).split(","))
        return air_c, setpoint_c, high_c, low_c

    def _ask(self, command: str, form: re.Pattern[bytes]) -> str:
        """Send a command; returns its answer, which has this form, as those to other commands have not."""

        def accept(answer: bytes) -> str | None:
            text = answer.decode("ascii", errors="replace").strip()
            if text.startswith("NA:"):
                raise DeviceError(f"{NAME}: refused {command!r} ({text[3:].strip()}). See its panel.")
            return text if form.fullmatch(answer) else None

        return self._talk.ask(f"{self._prefix}{command}\r\n".encode(), accept)

    def _set(self, command: str) -> None:
        self._ask(command, _DONE)


class EspecResponder(LineResponder):
    """The chamber's side: commands to `chamber`."""

    terminator = b"\r\n"

    def __init__(self, chamber: Chamber, options: Options = Options()) -> None:
        super().__init__()
        self._chamber = chamber
        self._options = options
        self._alarm_low_c, self._alarm_high_c = options.min_temp_c, options.max_temp_c

    def answer(self, line: str) -> bytes:
        """Answer of the chamber."""
        if self._options.address is not None:
            line = line.removeprefix(f"{self._options.address},")
        reading = self._chamber.read()
        query = {
            "TYPE?": "T,T,S2,160.0",
            "TEMP?": f"{reading.temp_c:.1f},{reading.setpoint_c:.1f},{self._alarm_high_c:.1f},{self._alarm_low_c:.1f}",
            "MODE?": "CONSTANT" if reading.running else "STANDBY",
            "ALARM?": ",".join([str(len(reading.alarms)), *(str(i + 1) for i in range(len(reading.alarms)))]),
        }
        text = query.get(line.upper())
        if text is None:
            text = self._set(line)
        return f"{text}\r\n".encode()

    def _set(self, line: str) -> str:
        if line.upper() == "MODE,CONSTANT":
            self._chamber.start()
            return f"OK:{line}"
        match = re.fullmatch(r"TEMP,\s*S(-?\d+\.\d)(?:\s*H(-?\d+\.\d)\s*L(-?\d+\.\d))?", line, re.IGNORECASE)
        if match is None:
            return "NA:CMD ERR"
        temp_c = float(match[1])
        if not self._options.min_temp_c <= temp_c <= self._options.max_temp_c:
            return "NA:DATA OUT OF RANGE"
        self._chamber.set_setpoint(temp_c)
        if match[2] is not None:
            self._alarm_high_c, self._alarm_low_c = float(match[2]), float(match[3])
            self._chamber.set_alarm_limits(self._alarm_low_c, self._alarm_high_c)
        return f"OK:{line}"
