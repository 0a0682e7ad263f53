"""A chamber that the operator drives: the program asks, the operator sets it and types what it shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gyrocal.bench.chambers.setpoint import check_setpoint
from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import ChamberLimits, ChamberReading
from gyrocal.bench.schema import number
from gyrocal.errors import InterruptedRunError

NAME = "manual chamber"
#: Farther from the set point than this a typed temperature is asked for once more, deg C.
_FAR_C = 2.0

#: Asks the operator a question and returns the answer; the command line supplies it.
Prompt = Callable[[str], str]


@dataclass(frozen=True)
class Options:
    """The chamber's own limits, deg C and deg C/min."""

    min_temp_c: float = number(-200.0, 300.0, "deg C", -20.0)
    max_temp_c: float = number(-200.0, 300.0, "deg C", 60.0)
    max_ramp_c_per_min: float = number(0.01, 100.0, "deg C/min", 1.0)


class ManualChamber:
    """A chamber without a link. What the operator types is the reading until the next question; then the gyro's own
    temperature is the only witness of the soak. See `gyrocal.bench.devices.Chamber`.
    """

    def __init__(self, prompt: Prompt, clock: Clock, options: Options = Options()) -> None:
        self._prompt = prompt
        self._clock = clock
        self._options = options
        self._temp_c = self._setpoint_c = 20.0
        self._told_c: float | None = None

    def limits(self) -> ChamberLimits:
        """Limits from the options."""
        o = self._options
        return ChamberLimits(o.min_temp_c, o.max_temp_c, o.max_ramp_c_per_min)

    def start(self) -> None:
        """Have the operator switch it on and type its temperature."""
        self._told_c = None
        self._temp_c = self._setpoint_c = self._number(
            "Switch the chamber on, then type the temperature it shows (deg C): "
        )

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Have the operator set the chamber's own alarms."""
        self._ask(f"Set the chamber's own alarms to {low_c:g} and {high_c:g} deg C, then press Enter: ")

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Ask for a set point: with a ramp for the temperature once it is reached, else for no more than to set it."""
        check_setpoint(NAME, temp_c, self.limits())
        if ramp_c_per_min is None:
            self._ask(f"Set the chamber to {temp_c:g} deg C, then press Enter: ")
        elif temp_c != self._told_c:
            question = (
                f"Set the chamber to {temp_c:g} deg C; when it shows that, type the temperature (deg C): "
            )
            shown_c = self._number(question)
            if abs(shown_c - temp_c) > _FAR_C:
                shown_c = self._number(f"{shown_c:g} deg C is not near {temp_c:g}. {question}")
            self._temp_c = shown_c
        self._setpoint_c = self._told_c = temp_c

    def read(self) -> ChamberReading:
        """What the operator typed last."""
        return ChamberReading(self._clock.now_s(), self._temp_c, self._setpoint_c, True)

    def close(self) -> None:
        """Nothing to close."""

    def _number(self, question: str) -> float:
        while True:
            try:
                value = float(self._ask(question))
            except ValueError:
                continue
            if math.isfinite(value):
                return value

    def _ask(self, question: str) -> str:
        try:
            return self._prompt(question).strip()
        except EOFError as error:
            raise InterruptedRunError(
                "The operator's terminal is gone, and a manual chamber needs one."
            ) from error
