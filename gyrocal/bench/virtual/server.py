"""The virtual bench on the wire: one physical world, served in real time through the bytes of real devices."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench
from gyrocal.bench.registry import CHAMBERS, GYROS, TABLES, GyroKind, Responder
from gyrocal.bench.virtual.endpoints import Endpoint
from gyrocal.bench.virtual.world import World

#: Pause between two looks at the ports: short against every device's answer time.
_LOOK_S = 0.002

#: What a faulty line does to the bytes of a device on their way to the program; see `gyrocal.bench.virtual.faults`.
LineFault = Callable[[bytes], bytes]


def _sound(data: bytes) -> bytes:
    return data


@dataclass
class Port:
    """A device's end of a line: where it is reached, what answers, and what the line does to the answers."""

    endpoint: Endpoint
    responder: Responder
    fault: LineFault = _sound

    def serve(self) -> None:
        """Answer what has come."""
        data = self.endpoint.read()
        if data and (answer := self.fault(self.responder.feed(data))):
            self.endpoint.write(answer)


@dataclass
class GyroPort:
    """The gyro's end of a line: every sample of the world becomes a message."""

    endpoint: Endpoint
    kind: GyroKind
    options: Any
    fault: LineFault = _sound
    count: int = 0

    def send(self, gyro_dps: list[float], temp_c: list[float]) -> None:
        """Send samples as messages."""
        messages = []
        for rate, temperature in zip(gyro_dps, temp_c, strict=True):
            messages.append(self.kind.encode(rate, temperature, self.count, self.options))
            self.count += 1
        if data := self.fault(b"".join(messages)):
            self.endpoint.write(data)


class BenchServer:
    """Three ports before one world. `serve` returns when `stop` is set."""

    def __init__(
        self, world: World, bench: Bench, gyro: GyroPort, table: Port, chamber: Port, clock: Clock
    ) -> None:
        self.gyro = gyro
        self.table = table
        self.chamber = chamber
        self._world = world
        self._bench = bench
        self._clock = clock

    def serve(self, stop: threading.Event) -> None:
        """Let the world run at the pace of the clock until `stop`; then close the ports."""
        try:
            while not stop.is_set():
                self.step()
                self._clock.sleep(_LOOK_S)
        finally:
            for port in (self.gyro, self.table, self.chamber):
                port.endpoint.close()

    def step(self) -> None:
        """One look: let the world catch up with the clock, send samples, answer requests."""
        self._world.advance_to(self._clock.now_s())
        samples = self._bench.gyro.drain()
        # A gyro port takes no requests in the kinds that are served, but its input must not fill up.
        self.gyro.endpoint.read()
        if samples.t_s.size:
            self.gyro.send(samples.gyro_dps.tolist(), samples.gyro_temp_c.tolist())
        self.table.serve()
        self.chamber.serve()


@dataclass(frozen=True)
class ServedKinds:
    """Which devices the virtual bench pretends to be, with their options."""

    gyro: str
    table: str
    chamber: str
    gyro_options: Any
    table_options: Any
    chamber_options: Any


def make_server(
    world: World, bench: Bench, kinds: ServedKinds, clock: Clock, make_endpoint: Callable[[str], Endpoint]
) -> BenchServer:
    """A server of the three devices; `make_endpoint` is called with ``gyro``, ``table`` and ``chamber``."""
    gyro = GYROS[kinds.gyro]
    table = TABLES[kinds.table].responder(bench.table, kinds.table_options)
    chamber = CHAMBERS[kinds.chamber].responder(bench.chamber, kinds.chamber_options)
    return BenchServer(
        world,
        bench,
        GyroPort(make_endpoint("gyro"), gyro, kinds.gyro_options),
        Port(make_endpoint("table"), table),
        Port(make_endpoint("chamber"), chamber),
        clock,
    )
