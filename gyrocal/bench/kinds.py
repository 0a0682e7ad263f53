"""What a kind of device is: options, driver or codec, and the same wire seen from the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Chamber, RateTable
from gyrocal.bench.gyros.codec import Decoder
from gyrocal.bench.transport import Transport


class Responder(Protocol):
    """The device's side of a request-and-answer wire."""

    def feed(self, data: bytes) -> bytes:
        """Answers to the requests completed by `data`; called without data as time passes."""
        ...


class Encode(Protocol):
    """The gyro's side of its wire."""

    def __call__(self, rate_dps: float, temp_c: float, count: int, options: Any, good: bool = True) -> bytes:
        """What it sends for its sample number `count`; not `good` where its protocol can say so."""
        ...


@dataclass(frozen=True)
class GyroKind:
    """A gyro: options, codec, and what it sends; `at_once`: after power-up already, without the commands."""

    options: type[Any]
    decoder: Callable[[Any], Decoder]
    encode: Encode
    baud: int
    has_temperature: bool
    commands: tuple[bytes, ...] = ()
    at_once: bool = True


@dataclass(frozen=True)
class TableKind:
    """A rate table: driver on a transport, and its responder before another table (None: has no wire)."""

    options: type[Any]
    driver: Callable[[Transport, Clock, Any], RateTable]
    responder: Callable[[RateTable, Any], Responder]
    baud: int


@dataclass(frozen=True)
class ChamberKind:
    """A chamber: driver on a transport, and its responder before another chamber; `ramps`: it has a ramp of its own.

    `sets_alarms`: its protocol can set its own alarm limits; else the operator does, at its panel.
    """

    options: type[Any]
    driver: Callable[[Transport, Clock, Any], Chamber]
    responder: Callable[[Chamber, Any], Responder]
    baud: int
    ramps: bool = False
    sets_alarms: bool = False
