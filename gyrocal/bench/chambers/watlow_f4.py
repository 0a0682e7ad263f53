"""Watlow F4 S/D/P: Modbus RTU, 19200 or 9600 8N1, protocol addresses as sent (protocols.md 3.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal.bench.chambers.modbus import ModbusMaster, ModbusSlave, RegisterMap, signed
from gyrocal.bench.chambers.setpoint import alarm_not_taken, check_setpoint, verify_setpoint
from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Chamber, ChamberLimits, ChamberReading
from gyrocal.bench.schema import number
from gyrocal.bench.transport import Transport
from gyrocal.errors import DeviceError

NAME = "Watlow F4"
INPUT, INPUT_ERROR, ALARM_1, ALARM_2, MODE, SETPOINT, DECIMALS, UNITS = 100, 101, 102, 106, 200, 300, 606, 901
ALARM_LOW, ALARM_HIGH = 302, 303
PROFILE_SETPOINT, TERMINATE_PROFILE, EVENT_OUTPUT = 4122, 1217, 2000
_REGISTERS_PER_INPUT = 4
_INPUT_ERRORS = {
    1: "A/D underflow",
    2: "under range",
    3: "over range",
    4: "A/D overflow",
    5: "time-out",
    6: "open loop",
}
_ALARMS = {1: "high", 2: "low"}


@dataclass(frozen=True)
class Options:
    """What differs between chambers.

    Attributes
    ----------
    address : int
        Modbus address.
    condition_event : int
        Event output (1..8) that switches conditioning on, wired by the chamber's maker; 0: none.
    plate_input : int
        Input (2 or 3) of a probe on the plate under the gyro; 0: none.
    alarm_registers : bool
        Whether registers 302 and 303 hold the low and high alarm set points of alarm 1 on this unit; not verified,
        so off by default, and the operator is told to set the chamber's alarms by hand.
    min_temp_c, max_temp_c, max_ramp_c_per_min : float
        The chamber's own limits.
    timeout_s : float
        Longest wait for an answer.
    """

    address: int = number(1, 247, "", 1)
    condition_event: int = number(0, 8, "", 0)
    plate_input: int = number(0, 3, "", 0)
    alarm_registers: bool = False
    min_temp_c: float = number(-200.0, 300.0, "deg C", -40.0)
    max_temp_c: float = number(-200.0, 300.0, "deg C", 85.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 2.0)
    timeout_s: float = number(0.01, 60.0, "s", 1.0)


class WatlowF4Chamber:
    """Driver of a Watlow F4; see `gyrocal.bench.devices.Chamber`. Temperatures deg C."""

    def __init__(self, transport: Transport, clock: Clock, options: Options = Options()) -> None:
        # of all that is asked only the input with its error and alarm has three words
        sync = (INPUT, 3)
        self._master = ModbusMaster(transport, clock, NAME, options.address, options.timeout_s, sync)
        self._transport = transport
        self._clock = clock
        self._options = options
        self._scale = 10

    def limits(self) -> ChamberLimits:
        """Limits of the chamber, from the options."""
        o = self._options
        return ChamberLimits(o.min_temp_c, o.max_temp_c, o.max_ramp_c_per_min)

    def start(self) -> None:
        """Learn decimals and units, end a running profile, and switch conditioning on where it is wired so."""
        self._scale = 10 ** self._master.read(DECIMALS)[0]
        if self._master.read(UNITS)[0] != 1:
            raise DeviceError(f"{NAME}: is set to degrees Fahrenheit. Set it to Celsius at its panel.")
        if self._master.read(MODE)[0] in (2, 3):
            self._master.write(TERMINATE_PROFILE, [1])
        if self._options.condition_event:
            self._master.write(EVENT_OUTPUT + 10 * (self._options.condition_event - 1), [1])

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Program alarm 1 where the option says which registers do; else refuse, so that nobody relies on it."""
        if not self._options.alarm_registers:
            msg = (
                f"{NAME}: its alarm registers are not verified. Set its alarms to {low_c:g} and {high_c:g} deg C at the "
                "panel and say own_alarms_set = true in the profile, or say alarm_registers = true."
            )
            raise DeviceError(msg)
        for register, limit_c in ((ALARM_LOW, low_c), (ALARM_HIGH, high_c)):
            word = round(limit_c * self._scale)
            self._master.write(register, [word])
            shown = signed(self._master.read(register)[0])
            if shown != word:
                raise alarm_not_taken(NAME, limit_c, shown / self._scale)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Set point, rounded to the controller's decimals (never cut), read back. Ramps are stepped by the caller."""
        check_setpoint(NAME, temp_c, self.limits())
        self._master.write(SETPOINT, [round(temp_c * self._scale)])
        verify_setpoint(NAME, temp_c, self._setpoint_c, 1 / self._scale)

    def read(self) -> ChamberReading:
        """Input 1, its error, the effective set point and the alarms."""
        value, error, alarm_1 = self._master.read(INPUT, 3)
        alarm_2 = self._master.read(ALARM_2)[0]
        texts = [f"input 1 {_INPUT_ERRORS.get(error, error)}"] if error else []
        texts += [f"alarm {i} {_ALARMS.get(a, a)}" for i, a in ((1, alarm_1), (2, alarm_2)) if a]
        temp_c, setpoint_c = signed(value) / self._scale, self._setpoint_c()
        plate_c = self._plate_c()
        return ChamberReading(self._clock.now_s(), temp_c, setpoint_c, True, tuple(texts), plate_c)

    def close(self) -> None:
        """Close the port; the chamber keeps its set point."""
        self._transport.close()

    def _plate_c(self) -> float:
        number = self._options.plate_input
        register = INPUT + _REGISTERS_PER_INPUT * (number - 1)
        return signed(self._master.read(register)[0]) / self._scale if number > 1 else math.nan

    def _setpoint_c(self) -> float:
        # While a profile runs or is held, register 300 is not the set point that acts.
        register = PROFILE_SETPOINT if self._master.read(MODE)[0] in (2, 3) else SETPOINT
        return signed(self._master.read(register)[0]) / self._scale


class WatlowF4Registers(RegisterMap):
    """Registers of a virtual F4 before `chamber`, one decimal, Celsius."""

    def __init__(self, chamber: Chamber) -> None:
        self._chamber = chamber
        self._plain = {MODE: 0, DECIMALS: 1, UNITS: 1, ALARM_LOW: -400, ALARM_HIGH: 850}

    def get(self, register: int) -> int:
        """Word of a register."""
        if register in self._plain:
            return self._plain[register]
        reading = self._chamber.read()
        words = {
            INPUT: round(reading.temp_c * 10),
            INPUT_ERROR: 0,
            ALARM_1: int(bool(reading.alarms)),
            ALARM_2: 0,
            INPUT + _REGISTERS_PER_INPUT: round(reading.temp_c * 10),
            SETPOINT: round(reading.setpoint_c * 10),
        }
        return words[register]

    def put(self, register: int, words: list[int]) -> None:
        """Write a set point, an alarm limit, an event output or the end of a profile."""
        if register == SETPOINT:
            self._chamber.set_setpoint(signed(words[0]) / 10)
        elif register in (ALARM_LOW, ALARM_HIGH):
            self._plain[register] = words[0]
            self._chamber.set_alarm_limits(
                signed(self._plain[ALARM_LOW]) / 10, signed(self._plain[ALARM_HIGH]) / 10
            )
        elif register == TERMINATE_PROFILE:
            self._plain[MODE] = 0
        elif not EVENT_OUTPUT <= register <= EVENT_OUTPUT + 70:
            raise KeyError(register)


def watlow_f4_responder(chamber: Chamber, options: Options = Options()) -> ModbusSlave:
    """The controller's side of the wire before `chamber`."""
    return ModbusSlave(options.address, WatlowF4Registers(chamber))
