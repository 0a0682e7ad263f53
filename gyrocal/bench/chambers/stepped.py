"""What some chambers lack: a ramp of their own, or a command for their own alarm limits."""

from __future__ import annotations

from math import copysign

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Chamber, ChamberLimits, ChamberReading
from gyrocal.units import S_PER_MIN

#: Set points closer than this are not sent: chambers show tenths, and some keep each set point in their EEPROM.
STEP_C = 0.1


class SteppedChamber:
    """A chamber that jumps to its set point, led along a ramp: at each reading the set point goes on by what is due.

    When the program dies on the way, the chamber stays at the set point that it had by then.
    """

    def __init__(self, chamber: Chamber, clock: Clock) -> None:
        self._chamber = chamber
        self._clock = clock
        self._target_c = self._from_c = self._sent_c = 0.0
        self._began_s = 0.0
        self._rate_c_per_s: float | None = None

    def limits(self) -> ChamberLimits:
        """Limits of the chamber itself."""
        return self._chamber.limits()

    def start(self) -> None:
        """Connect and switch on; a ramp that was under way is forgotten."""
        self._rate_c_per_s = None
        self._chamber.start()

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Program the chamber's own alarms."""
        self._chamber.set_alarm_limits(low_c, high_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Command a set point at once, or begin a ramp from the present temperature; read back either way."""
        self._rate_c_per_s = None
        if ramp_c_per_min is None:
            self._chamber.set_setpoint(temp_c)
            return
        limits = self.limits()
        if not limits.min_temp_c <= temp_c <= limits.max_temp_c:
            self._chamber.set_setpoint(temp_c)  # the chamber refuses it in its own words
            return
        self._from_c = min(max(self._chamber.read().temp_c, limits.min_temp_c), limits.max_temp_c)
        self._target_c = temp_c
        self._began_s = self._clock.now_s()
        self._rate_c_per_s = ramp_c_per_min / S_PER_MIN
        self._send(self._due_c())

    def read(self) -> ChamberReading:
        """What the chamber says; during a ramp the set point is led on first."""
        if self._rate_c_per_s is not None:
            due_c = self._due_c()
            if abs(due_c - self._sent_c) >= STEP_C or (due_c == self._target_c != self._sent_c):
                self._send(due_c)
            if due_c == self._target_c:
                self._rate_c_per_s = None
        return self._chamber.read()

    def close(self) -> None:
        """Close; the chamber keeps the set point that it has."""
        self._chamber.close()

    def _due_c(self) -> float:
        way_c = self._target_c - self._from_c
        done_c = (self._rate_c_per_s or 0.0) * (self._clock.now_s() - self._began_s)
        return self._target_c if done_c >= abs(way_c) else self._from_c + copysign(done_c, way_c)

    def _send(self, temp_c: float) -> None:
        self._sent_c = temp_c if temp_c == self._target_c else round(temp_c, 1)
        self._chamber.set_setpoint(self._sent_c)


class AlarmsByHand:
    """A chamber whose own alarm limits the operator has set at its panel, because its protocol cannot."""

    def __init__(self, chamber: Chamber) -> None:
        self._chamber = chamber

    def limits(self) -> ChamberLimits:
        """Limits of the chamber itself."""
        return self._chamber.limits()

    def start(self) -> None:
        """Connect and switch on."""
        self._chamber.start()

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Done already, by hand: the profile says so."""

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Command a set point, verified by read-back."""
        self._chamber.set_setpoint(temp_c, ramp_c_per_min)

    def read(self) -> ChamberReading:
        """What the chamber says."""
        return self._chamber.read()

    def close(self) -> None:
        """Close; the chamber keeps its set point."""
        self._chamber.close()
