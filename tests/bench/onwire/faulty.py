"""What goes wrong on a bench, made to order: faulty cables, tables, chambers and gyros, on the wire.

Cables are lines of `gyrocal.bench.virtual.server`; tables and chambers stand between the world and a responder. Where
a fault lasts, it does so from `begin_s` to `end_s` of the world's time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrocal.bench.devices import (
    Chamber,
    ChamberLimits,
    ChamberReading,
    GyroSamples,
    RateTable,
    TableLimits,
    TableReading,
)

_NEVER_S = float("inf")


@dataclass(frozen=True)
class Span:
    """From when to when a fault lasts, s."""

    begin_s: float = 0.0
    end_s: float = _NEVER_S

    def holds(self, now_s: float) -> bool:
        """Whether it lasts now."""
        return self.begin_s <= now_s < self.end_s


# cables


@dataclass
class NoisyLine:
    """Loses bytes, and flips a bit in bytes, each with a probability by byte."""

    rng: np.random.Generator
    lost: float = 0.0
    flipped: float = 0.0
    span: Span = Span()

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """What is left of the messages."""
        data = np.frombuffer(b"".join(messages), dtype=np.uint8)
        if data.size == 0 or not self.span.holds(now_s):
            return data.tobytes()
        bits = (1 << self.rng.integers(0, 8, data.size)).astype(np.uint8)
        data = np.where(self.rng.random(data.size) < self.flipped, data ^ bits, data)
        return data[self.rng.random(data.size) >= self.lost].tobytes()


@dataclass
class DisorderlyLine:
    """Loses, repeats and swaps whole messages, each with a probability by message."""

    rng: np.random.Generator
    lost: float = 0.0
    repeated: float = 0.0
    swapped: float = 0.0
    span: Span = Span()
    _held: bytes = b""

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """The messages that come, in the order in which they come."""
        if not self.span.holds(now_s):
            return b"".join(messages)
        out = b""
        for message in messages:
            draw = self.rng.random(3)
            if draw[0] < self.lost:
                continue
            if not self._held and draw[2] < self.swapped:
                self._held = message
                continue
            out += message + self._held + (message if draw[1] < self.repeated else b"")
            self._held = b""
        return out


@dataclass
class CutLine:
    """Carries nothing."""

    span: Span = Span()

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """Nothing while it is cut."""
        return b"" if self.span.holds(now_s) else b"".join(messages)


@dataclass
class LateLine:
    """Delivers everything `delay_s` late."""

    delay_s: float
    span: Span = Span()
    _waiting: list[tuple[float, bytes]] = field(default_factory=list)

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """What is due."""
        delay_s = self.delay_s if self.span.holds(now_s) else 0.0
        self._waiting += [(now_s + delay_s, message) for message in messages]
        due = b"".join(message for due_s, message in self._waiting if due_s <= now_s)
        self._waiting = [(due_s, message) for due_s, message in self._waiting if due_s > now_s]
        return due


@dataclass
class ChangedLine:
    """Changes each message: half of it, garbage, another device's words."""

    change: Callable[[bytes], bytes]
    span: Span = Span()

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """The changed messages."""
        if not self.span.holds(now_s):
            return b"".join(messages)
        return b"".join(map(self.change, messages))


@dataclass
class EchoingLine:
    """Sends every request back before its answer, as a line with local echo does."""

    span: Span = Span()

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """Echo, then answer."""
        return (request if self.span.holds(now_s) else b"") + b"".join(messages)


# tables


class FaultyTable:
    """A table whose readings, commands and faults are changed.

    Parameters
    ----------
    reading : callable, optional
        Takes the true reading and returns the shown one.
    command : callable, optional
        Takes time and commanded rate and returns the rate that the motor is given.
    fault : callable, optional
        Takes the time and returns the faults that the controller reports.
    """

    def __init__(
        self,
        table: RateTable,
        *,
        reading: Callable[[TableReading], TableReading] = lambda reading: reading,
        command: Callable[[float, float], float] = lambda now_s, rate_dps: rate_dps,
        fault: Callable[[float], tuple[str, ...]] = lambda now_s: (),
    ) -> None:
        self._table = table
        self._reading, self._command, self._fault = reading, command, fault

    def limits(self) -> TableLimits:
        """Limits of the table."""
        return self._table.limits()

    def start(self) -> None:
        """Ready."""
        self._table.start()

    def set_rate(self, rate_dps: float) -> float:
        """Give the motor another rate; say the one that was asked."""
        now_s = self._table.read().t_s
        self._table.set_rate(self._command(now_s, rate_dps))
        return rate_dps

    def read(self) -> TableReading:
        """The shown reading."""
        return self._reading(self._table.read())

    def faults(self) -> tuple[str, ...]:
        """The reported faults."""
        return self._fault(self._table.read().t_s)

    def send_stop(self) -> None:
        """Stop."""
        self._table.send_stop()

    def close(self) -> None:
        """Close."""
        self._table.close()


# chambers


class FaultyChamber:
    """A chamber whose readings are changed, and which controls to what it `heard` while it shows what it was told."""

    def __init__(
        self,
        chamber: Chamber,
        *,
        reading: Callable[[ChamberReading], ChamberReading] = lambda reading: reading,
        heard: Callable[[float], float] = lambda setpoint_c: setpoint_c,
    ) -> None:
        self._chamber = chamber
        self._reading, self._heard = reading, heard
        self._said_c: float | None = None

    def limits(self) -> ChamberLimits:
        """Limits of the chamber."""
        return self._chamber.limits()

    def start(self) -> None:
        """Ready."""
        self._chamber.start()

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Own alarms."""
        self._chamber.set_alarm_limits(low_c, high_c)

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Control to what was heard, show what was said."""
        self._said_c = temp_c
        self._chamber.set_setpoint(self._heard(temp_c), ramp_c_per_min)

    def read(self) -> ChamberReading:
        """The shown reading."""
        reading = self._chamber.read()
        shown_c = reading.setpoint_c if self._said_c is None else self._said_c
        return self._reading(replace(reading, setpoint_c=shown_c))

    def close(self) -> None:
        """Close."""
        self._chamber.close()


# gyros: what changes the samples before they are sent


def stuck(span: Span) -> Callable[[GyroSamples], GyroSamples]:
    """A gyro that keeps its last value while it lasts."""
    last_dps = [0.0]

    def change(samples: GyroSamples) -> GyroSamples:
        shown = samples.gyro_dps.copy()
        for k, t_s in enumerate(samples.t_s):
            if span.holds(t_s):
                shown[k] = last_dps[0]
            last_dps[0] = shown[k]
        return replace(samples, gyro_dps=shown)

    return change


def bad_status(span: Span) -> Callable[[GyroSamples], GyroSamples]:
    """A gyro that calls its samples bad while it lasts."""
    return lambda samples: replace(
        samples, status=np.where([span.holds(t_s) for t_s in samples.t_s], 1.0, samples.status)
    )


def thermometer_shows(span: Span, temp_c: float) -> Callable[[GyroSamples], GyroSamples]:
    """A gyro whose thermometer shows one value while it lasts: a broken wire, or a frozen register."""
    return lambda samples: replace(
        samples, gyro_temp_c=np.where([span.holds(t_s) for t_s in samples.t_s], temp_c, samples.gyro_temp_c)
    )
