"""Watlow F4T: SCPI over TCP 5025, or Modbus RTU 38400 / TCP (protocols.md 3.3)."""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass

from gyrocal.bench.chambers.modbus import ModbusMaster, ModbusSlave, RegisterMap
from gyrocal.bench.chambers.setpoint import check_setpoint, verify_setpoint
from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import Chamber, ChamberLimits, ChamberReading
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

NAME = "Watlow F4T"
SETPOINT_LIMITS = 2774
_REGISTERS_PER_LOOP = 160
PROCESS_VALUE, SETPOINT, CONTROL_MODE, ALARM = 2820, 2782, 2730, 1356
TERMINATE_PROFILE = 16566
MODE_OFF, MODE_AUTO = 62, 10
ALARM_FINE = (88, 61, 12)
_NUMBER = r"[-+]?(\d+\.?\d*|\.\d+)(E[-+]?\d+)?"
#: A set point is read back as a float32: closer than this it is the same.
RESOLUTION_C = 0.01


@dataclass(frozen=True)
class Options:
    """What differs between chambers.

    Attributes
    ----------
    address : int
        Modbus address (Modbus only).
    low_word_first : bool
        Order of the two words of a float (Modbus only).
    loop : int
        Control loop of the air temperature.
    plate_loop : int
        Control loop whose process value is that of a probe on the plate under the gyro; 0: none.
    output : int
        SCPI output that switches conditioning on; 0: none.
    min_temp_c, max_temp_c, max_ramp_c_per_min : float
        The chamber's own limits.
    timeout_s : float
        Longest wait for an answer.
    """

    address: int = number(1, 247, "", 1)
    low_word_first: bool = True
    loop: int = number(1, 9, "", 1)
    plate_loop: int = number(0, 9, "", 0)
    output: int = number(0, 99, "", 1)
    min_temp_c: float = number(-200.0, 300.0, "deg C", -40.0)
    max_temp_c: float = number(-200.0, 300.0, "deg C", 85.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 2.0)
    timeout_s: float = number(0.01, 60.0, "s", 2.0)


def _limits(o: Options) -> ChamberLimits:
    return ChamberLimits(o.min_temp_c, o.max_temp_c, o.max_ramp_c_per_min)


def float_to_words(value: float, low_word_first: bool) -> list[int]:
    """Two 16-bit words of a float32."""
    high, low = struct.unpack(">HH", struct.pack(">f", value))
    return [low, high] if low_word_first else [high, low]


def words_to_float(words: list[int], low_word_first: bool) -> float:
    """Float32 of two 16-bit words."""
    pair = words[::-1] if low_word_first else words
    value: float = struct.unpack(">f", struct.pack(">HH", *pair))[0]
    return value


def _own_alarms_by_hand(low_c: float, high_c: float) -> DeviceError:
    return DeviceError(
        f"{NAME}: no verified command sets its alarm limits. Set its alarms to {low_c:g} and {high_c:g} deg C at the panel "
        "and say own_alarms_set = true in the profile."
    )


class WatlowF4tScpiChamber:
    """Driver of a Watlow F4T by SCPI; see `gyrocal.bench.devices.Chamber`. Temperatures deg C."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        sync = (b"*IDN?\n", lambda answer: True if b"," in answer else None)
        self._talk = Conversation(transport, NAME, ended_by(b"\n"), options.timeout_s, sync)
        self._clock = clock
        self._options = options
        self._loop = f":SOURCE:CLOOP{options.loop}"

    def limits(self) -> ChamberLimits:
        """Limits of the chamber, from the options."""
        return _limits(self._options)

    def start(self) -> None:
        """Ask who it is, agree on Celsius for the link, and switch conditioning on."""
        self._ask("*IDN?", ".*,.*")
        self._send(":UNIT:TEMPERATURE C")
        if not self._ask(":UNIT:TEMPERATURE?", "[CFK].*").startswith("C"):
            raise DeviceError(f"{NAME}: does not talk in Celsius. Set the communication unit at its panel.")
        if self._options.output:
            self._send(f":OUTPUT{self._options.output}:STATE ON")

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Refused: no verified command; the operator sets them at the panel."""
        raise _own_alarms_by_hand(low_c, high_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Set point, with the controller's own ramp where one is asked, read back."""
        check_setpoint(NAME, temp_c, self.limits())
        if ramp_c_per_min is not None:
            self._send(f"{self._loop}:RSCALE MINUTES")
            self._send(f"{self._loop}:RRATE {ramp_c_per_min:.3f}")
            self._send(f"{self._loop}:RACTION SETPOINT")
        else:
            self._send(f"{self._loop}:RACTION OFF")
        self._send(f"{self._loop}:SPOINT {temp_c:.2f}")
        verify_setpoint(NAME, temp_c, lambda: self._number(f"{self._loop}:SPOINT?"), RESOLUTION_C)

    def read(self) -> ChamberReading:
        """Process value, set point, error and output state."""
        temp_c, setpoint_c = self._number(f"{self._loop}:PVALUE?"), self._number(f"{self._loop}:SPOINT?")
        error = self._ask(f"{self._loop}:ERROR?", "(?!ON$|OFF$)[A-Z].*")
        output = self._options.output
        running = not output or self._ask(f":OUTPUT{output}:STATE?", "ON|OFF|0|1") in ("ON", "1")
        alarms = () if error == "NONE" else (f"loop {self._options.loop} {error.lower()}",)
        plate = self._options.plate_loop
        plate_c = self._number(f":SOURCE:CLOOP{plate}:PVALUE?") if plate else math.nan
        return ChamberReading(self._clock.now_s(), temp_c, setpoint_c, running, alarms, plate_c)

    def close(self) -> None:
        """Close the port; the chamber keeps its set point."""
        self._talk.transport.close()

    def _send(self, command: str) -> None:
        self._talk.tell(f"{command}\n".encode())

    def _ask(self, command: str, pattern: str) -> str:
        """Send a question; returns its answer, which `pattern` fits and none that comes late for another."""

        def accept(answer: bytes) -> str | None:
            text = answer.decode("ascii", errors="replace").strip()
            return text.upper() if re.fullmatch(pattern, text, re.IGNORECASE) else None

        return self._talk.ask(f"{command}\n".encode(), accept)

    def _number(self, command: str) -> float:
        return float(self._ask(command, _NUMBER))


class WatlowF4tScpiResponder(LineResponder):
    """The controller's side of SCPI before `chamber`; set commands are not answered."""

    terminator = b"\n"

    def __init__(self, chamber: Chamber, options: Options = Options()) -> None:
        super().__init__()
        self._chamber = chamber
        self._loop = f":SOURCE:CLOOP{options.loop}"
        self._output = f":OUTPUT{options.output}:STATE"
        self._ramp_c_per_min: float | None = None
        self._ramping = False

    def answer(self, line: str) -> bytes:
        """Answer of the controller; empty to a set command or a word it does not know."""
        word, _, value = line.partition(" ")
        if not word.endswith("?"):
            self._set(word.upper(), value.strip())
            return b""
        reading = self._chamber.read()
        texts = {
            "*IDN?": "WATLOW ELECTRIC,F4T,virtual,1.0",
            ":UNIT:TEMPERATURE?": "C",
            f"{self._loop}:PVALUE?": f"{reading.temp_c:.4f}",
            f"{self._loop}:SPOINT?": f"{reading.setpoint_c:.4f}",
            f"{self._loop}:ERROR?": "ERROR" if reading.alarms else "NONE",
            f"{self._output}?": "ON" if reading.running else "OFF",
        }
        text = texts.get(word.upper())
        return b"" if text is None else f"{text}\n".encode()

    def _set(self, word: str, value: str) -> None:
        try:
            if word == f"{self._loop}:SPOINT":
                self._chamber.set_setpoint(float(value), self._ramp_c_per_min if self._ramping else None)
            elif word == f"{self._loop}:RRATE":
                self._ramp_c_per_min = float(value)
        except ValueError:
            return
        if word == f"{self._loop}:RACTION":
            self._ramping = value.upper() in ("SETPOINT", "BOTH")
        if word == self._output and value.upper() == "ON":
            self._chamber.start()


class WatlowF4tModbusChamber:
    """Driver of a Watlow F4T by Modbus; see `gyrocal.bench.devices.Chamber`. Temperatures deg C."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        # set point limits: four words, as nothing else that is asked
        sync = (SETPOINT_LIMITS + _REGISTERS_PER_LOOP * (options.loop - 1), 4)
        self._master = ModbusMaster(transport, clock, NAME, options.address, options.timeout_s, sync)
        self._transport = transport
        self._clock = clock
        self._options = options
        self._shift = _REGISTERS_PER_LOOP * (options.loop - 1)

    def limits(self) -> ChamberLimits:
        """Limits of the chamber, from the options."""
        return _limits(self._options)

    def start(self) -> None:
        """Switch the loop to automatic control."""
        self._master.write(CONTROL_MODE + self._shift, [MODE_AUTO])

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Refused: no verified register; the operator sets them at the panel."""
        raise _own_alarms_by_hand(low_c, high_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Set point, read back. Ramps are stepped by the caller."""
        check_setpoint(NAME, temp_c, self.limits())
        self._master.write(SETPOINT + self._shift, float_to_words(temp_c, self._options.low_word_first))
        verify_setpoint(NAME, temp_c, lambda: self._float(SETPOINT), RESOLUTION_C)

    def read(self) -> ChamberReading:
        """Process value, set point, mode and the first alarm."""
        alarm = self._master.read(ALARM)[0]
        running = self._master.read(CONTROL_MODE + self._shift)[0] != MODE_OFF
        alarms = () if alarm in ALARM_FINE else (f"alarm 1 state {alarm}",)
        temp_c, setpoint_c = self._float(PROCESS_VALUE), self._float(SETPOINT)
        plate = self._options.plate_loop
        plate_c = self._float_at(PROCESS_VALUE + _REGISTERS_PER_LOOP * (plate - 1)) if plate else math.nan
        return ChamberReading(self._clock.now_s(), temp_c, setpoint_c, running, alarms, plate_c)

    def close(self) -> None:
        """Close the port; the chamber keeps its set point."""
        self._transport.close()

    def _float(self, register: int) -> float:
        return self._float_at(register + self._shift)

    def _float_at(self, register: int) -> float:
        return words_to_float(self._master.read(register, 2), self._options.low_word_first)


class WatlowF4tRegisters(RegisterMap):
    """Registers of a virtual F4T before `chamber`."""

    def __init__(self, chamber: Chamber, options: Options) -> None:
        self._chamber = chamber
        self._options = options

    def get(self, register: int) -> int:
        """Word of a register."""
        reading = self._chamber.read()
        first = self._options.low_word_first
        low_c, high_c = self._options.min_temp_c, self._options.max_temp_c
        floats = {
            PROCESS_VALUE: reading.temp_c,
            SETPOINT: reading.setpoint_c,
            SETPOINT_LIMITS: low_c,
            SETPOINT_LIMITS + 2: high_c,
        }
        for base, value in floats.items():
            if register in (base, base + 1):
                return float_to_words(value, first)[register - base]
        words = {
            ALARM: 0 if reading.alarms else ALARM_FINE[0],
            CONTROL_MODE: MODE_AUTO if reading.running else MODE_OFF,
        }
        return words[register]

    def put(self, register: int, words: list[int]) -> None:
        """Write a set point or the control mode."""
        if register == SETPOINT and len(words) == 2:
            self._chamber.set_setpoint(words_to_float(words, self._options.low_word_first))
        elif register == CONTROL_MODE and words == [MODE_AUTO]:
            self._chamber.start()
        else:
            raise KeyError(register)


def watlow_f4t_modbus_responder(chamber: Chamber, options: Options = Options()) -> ModbusSlave:
    """The controller's side of Modbus before `chamber`."""
    return ModbusSlave(options.address, WatlowF4tRegisters(chamber, options))
