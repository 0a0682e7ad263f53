"""A table that the operator drives: the program asks, the operator sets the rate and confirms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import TableLimits, TableReading
from gyrocal.bench.schema import number
from gyrocal.errors import DeviceError, InterruptedRunError

#: Asks the operator a question and returns the answer; the command line supplies it.
Prompt = Callable[[str], str]


@dataclass(frozen=True)
class Options:
    """The table's own limits, deg/s and deg/s^2."""

    max_rate_dps: float = number(0.001, 20000.0, "deg/s", 100.0)
    max_acceleration_dps2: float = number(0.001, 1e6, "deg/s^2", 20.0)


class ManualTable:
    """A table without a link. The rate is what the operator reads off it; see `gyrocal.bench.devices.RateTable`."""

    def __init__(self, prompt: Prompt, clock: Clock, options: Options = Options()) -> None:
        self._prompt = prompt
        self._clock = clock
        self._options = options
        # nobody has said yet what the table does
        self._rate_dps = math.nan
        self._angle_deg = 0.0
        self._stopped = False
        self._asked_dps: float | None = None
        self._since_s = clock.now_s()

    def limits(self) -> TableLimits:
        """Limits from the options."""
        return TableLimits(self._options.max_rate_dps, self._options.max_acceleration_dps2)

    def start(self) -> None:
        """Have the operator confirm that the table stands."""
        self._stopped, self._asked_dps = False, None
        self._confirm_rate("Make sure that the table stands, then type its rate in deg/s (0): ")

    def set_rate(self, rate_dps: float) -> float:
        """Ask for a rate, unless it was the last one; returns the one that the operator reads off the table, deg/s."""
        if not abs(rate_dps) <= self._options.max_rate_dps:
            msg = f"manual table: {rate_dps:g} deg/s is beyond the limit of {self._options.max_rate_dps:g} deg/s."
            raise DeviceError(msg)
        if rate_dps == self._asked_dps:
            return self._rate_dps
        self._stopped, self._asked_dps = False, rate_dps
        self._confirm_rate(
            f"Set the table to {rate_dps:+.6g} deg/s (counter-clockwise is +), then type the rate it shows: "
        )
        return self._rate_dps

    def read(self) -> TableReading:
        """The rate last confirmed, and the angle that it makes since then."""
        now_s = self._clock.now_s()
        return TableReading(now_s, self._rate_dps, self._angle_deg + self._rate_dps * (now_s - self._since_s))

    def faults(self) -> tuple[str, ...]:
        """None: the operator watches."""
        return ()

    def send_stop(self) -> None:
        """Tell the operator to stop the table, until the answer, which is the read-back, is that it stands."""
        self._asked_dps = None
        if not self._stopped:
            self._confirm_rate("STOP THE TABLE NOW, then type the rate it shows (0): ")
            self._stopped = self._rate_dps == 0.0

    def close(self) -> None:
        """Nothing to close."""

    def _confirm_rate(self, question: str) -> None:
        while True:
            try:
                answer = self._prompt(question).strip()
            except EOFError as error:
                raise InterruptedRunError(
                    "The operator's terminal is gone, and a manual table needs one."
                ) from error
            try:
                rate_dps = float(answer)
            except ValueError:
                continue
            if not math.isfinite(rate_dps):
                continue
            now_s = self._clock.now_s()
            if math.isfinite(self._rate_dps):
                self._angle_deg += self._rate_dps * (now_s - self._since_s)
            self._rate_dps, self._since_s = rate_dps, now_s
            return
