"""A package outside of the tree: one effect, one gyro, one table, one chamber. Installed by `test_extension`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrocal.bench.clock import Clock
from gyrocal.bench.conversation import Conversation, ended_by
from gyrocal.bench.devices import (
    Chamber,
    ChamberLimits,
    ChamberReading,
    RateTable,
    TableLimits,
    TableReading,
)
from gyrocal.bench.gyros.codec import Frame, LineDecoder
from gyrocal.bench.kinds import ChamberKind, GyroKind, TableKind
from gyrocal.bench.responder import LineResponder
from gyrocal.bench.transport import Transport
from gyrocal.physics.c_text import CMemory, CText, Number
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect, Floats, amplitude, memoryless, shape
from gyrocal.physics.fold import FoldAxis, plain
from gyrocal.physics.hiding import Hiding
from gyrocal.physics.offer import Offer, many_rates
from gyrocal.physics.search import Search
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS


def _ripple(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * (1 - np.cos(2 * np.pi * c.rate_dps / p["period_dps"])))


def _periods(offer: Offer) -> list[dict[str, float]]:
    return [{"period_dps": float(x) * offer.largest_rate_dps} for x in np.geomspace(0.3, 0.8, 21)]


def _draw(usual: Mapping[str, float], offer: Offer, rng: np.random.Generator) -> dict[str, float]:
    return dict(usual) | {"period_dps": float(rng.uniform(0.3, 0.8)) * offer.largest_rate_dps}


def _within_period(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    return plain("Rate within a ripple, deg/s", c.rate_dps % p["period_dps"])


def _ripple_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(MDPS * p['amplitude'])} * PREFIX_ripple@f@({n(np.pi / p['period_dps'])} * w)"


_RIPPLE = """\
/* 1 - cos(2 x) = 2 sin(x)^2: to the nearest half turn, then the series of the sine */
static inline @real@ PREFIX_ripple@f@(@real@ x)
{
    const @real@ pi = (@real@)3.141592653589793, halves = x / pi;
    @real@ sum = 0;
    int k;
    x -= pi * (@real@)(long)(halves < 0 ? halves - (@real@)0.5 : halves + (@real@)0.5);
    for (k = 9; k > 0; k--) {
        sum = -x * x / (@real@)(2 * k * (2 * k + 1)) * (1 + sum);
    }
    return 2 * x * x * (1 + sum) * (1 + sum);
}
"""

RIPPLE = Effect(
    id="toy_ripple",
    family="rate shape",
    equation="e = k (1 - cos(2 pi w / p))",
    statement="The error ripples with the rate.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 20.0, "size"),
        shape("period_dps", "deg/s", 0.1, 1000.0, 50.0, "period p"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("sagnac_sine",),
    reference="A. Toy, Ripples on the rate axis (2026)",
    runtime=True,
    error_dps=memoryless(_ripple),
    search=Search(grid=_periods, refined=("period_dps",), requires=(many_rates,)),
    hiding=Hiding(_draw),
    fold=_within_period,
    c_text=CText(_ripple_c, (_RIPPLE,)),
)


@dataclass(frozen=True)
class NoOptions:
    """A toy has none."""


class ToyDecoder(LineDecoder):
    """Lines of ``rate,temperature``."""

    def __init__(self, options: NoOptions) -> None:
        super().__init__()

    def _parse(self, line: bytes) -> Frame | None:
        try:
            rate, temp = map(float, line.split(b","))
        except ValueError:
            return None
        return Frame(rate, temp, raw=line)


def encode(rate_dps: float, temp_c: float, count: int, options: NoOptions, good: bool = True) -> bytes:
    """What the toy gyro sends."""
    return f"{rate_dps:.9g},{temp_c:.6g}\r\n".encode()


def _ask(talk: Conversation, question: str) -> list[float]:
    """Ask for numbers; the answer repeats the question's first word."""
    word = question.split()[0]

    def accept(answer: bytes) -> list[float] | None:
        said, *numbers = answer.decode("ascii").split()
        return [float(x) for x in numbers] if said == word else None

    return talk.ask(f"{question}\n".encode(), accept)


class ToyTable:
    """``rate X`` and ``read``."""

    def __init__(self, transport: Transport, clock: Clock, options: NoOptions) -> None:
        self._talk, self._clock = Conversation(transport, "toy table", ended_by(b"\n"), 1.0), clock

    def limits(self) -> TableLimits:
        """Fixed."""
        return TableLimits(140.0, 100.0)

    def start(self) -> None:
        """Ask something."""
        self.read()

    def set_rate(self, rate_dps: float) -> float:
        """The rate that it makes."""
        return _ask(self._talk, f"rate {rate_dps!r}")[0]

    def read(self) -> TableReading:
        """Rate and angle."""
        asked_s = self._clock.now_s()
        rate_dps, angle_deg = _ask(self._talk, "read")
        return TableReading.between(asked_s, self._clock.now_s(), rate_dps, angle_deg)

    def faults(self) -> tuple[str, ...]:
        """It has none."""
        return ()

    def send_stop(self) -> None:
        """Rate zero, without waiting."""
        self._talk.send(b"rate 0\n")

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()


class ToyTableResponder(LineResponder):
    """The table's side."""

    terminator = b"\n"

    def __init__(self, table: RateTable, options: NoOptions) -> None:
        super().__init__()
        self._table = table

    def answer(self, line: str) -> bytes:
        """To either command."""
        word, *numbers = line.split()
        if word == "rate":
            return f"rate {self._table.set_rate(float(numbers[0]))!r}\n".encode()
        reading = self._table.read()
        return f"read {reading.rate_dps!r} {reading.angle_deg!r}\n".encode()


class ToyChamber:
    """``set X``, ``alarm LOW HIGH`` and ``air``."""

    def __init__(self, transport: Transport, clock: Clock, options: NoOptions) -> None:
        self._talk, self._clock = Conversation(transport, "toy chamber", ended_by(b"\n"), 1.0), clock

    def limits(self) -> ChamberLimits:
        """Fixed."""
        return ChamberLimits(-40.0, 85.0, 30.0)

    def start(self) -> None:
        """Ask something."""
        self.read()

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Its own alarms."""
        _ask(self._talk, f"alarm {low_c!r} {high_c!r}")

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """It steps; the ramp is the caller's."""
        _ask(self._talk, f"set {temp_c!r}")

    def read(self) -> ChamberReading:
        """Air and set point."""
        temp_c, setpoint_c = _ask(self._talk, "air")
        return ChamberReading(self._clock.now_s(), temp_c, setpoint_c, True)

    def close(self) -> None:
        """Close the port."""
        self._talk.transport.close()


class ToyChamberResponder(LineResponder):
    """The chamber's side."""

    terminator = b"\n"

    def __init__(self, chamber: Chamber, options: NoOptions) -> None:
        super().__init__()
        self._chamber = chamber

    def answer(self, line: str) -> bytes:
        """To any of the commands."""
        word, *numbers = line.split()
        if word == "set":
            self._chamber.set_setpoint(float(numbers[0]))
        elif word == "alarm":
            self._chamber.set_alarm_limits(*map(float, numbers))
        else:
            reading = self._chamber.read()
            return f"air {reading.temp_c!r} {reading.setpoint_c!r}\n".encode()
        return f"{word}\n".encode()


GYRO = GyroKind(NoOptions, ToyDecoder, encode, 115200, True)
TABLE = TableKind(NoOptions, ToyTable, ToyTableResponder, 115200)
CHAMBER = ChamberKind(NoOptions, ToyChamber, ToyChamberResponder, 115200, sets_alarms=True)
