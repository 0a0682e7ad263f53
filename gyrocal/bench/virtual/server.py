"""The virtual bench on the wire: one physical world, served in real time through the bytes of real devices."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, Chamber, GyroSamples, RateTable, TableLimits, TableReading
from gyrocal.bench.kinds import GyroKind, Responder
from gyrocal.bench.registry import CHAMBERS, GYROS, TABLES
from gyrocal.bench.virtual.endpoints import Endpoint
from gyrocal.bench.virtual.world import World
from gyrocal.errors import DeviceError

#: Pause between two looks at the ports: short against every device's answer time.
_LOOK_S = 0.001


class Line(Protocol):
    """The cable between a device and the program, and what it does to the bytes."""

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """Bytes that reach the program now. Called at every look, also without messages, so that a line can delay."""
        ...


class SoundLine:
    """A cable that does nothing to the bytes."""

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """All of it, at once."""
        return b"".join(messages)


@dataclass
class Port:
    """A device's end of a line: where it is reached, what answers (and looks at its watchdog), and the line."""

    endpoint: Endpoint
    responder: Responder
    line: Line = field(default_factory=SoundLine)

    def serve(self, now_s: float) -> None:
        """Answer what has come; a device keeps silent to what it refuses."""
        request = self.endpoint.read()
        answer = b""
        with contextlib.suppress(DeviceError):
            answer = self.responder.feed(request)
        data = self.line.carry(now_s, [answer] if answer else [], request)
        if data:
            self.endpoint.write(data)


@dataclass
class GyroPort:
    """The gyro's end of a line: every sample of the world becomes a message.

    One whose power-up mode the driver cannot read streams in that until its commands come.
    """

    endpoint: Endpoint
    kind: GyroKind
    options: Any
    line: Line = field(default_factory=SoundLine)
    count: int = 0
    _heard: bytes = b""
    _in_mode: bool = False

    def serve(self, now_s: float, samples: GyroSamples) -> None:
        """Send samples as messages."""
        self._heard = (self._heard + self.endpoint.read())[-256:]
        told = all(command in self._heard for command in self.kind.commands)
        self._in_mode = self._in_mode or self.kind.at_once or told
        messages = []
        columns = (samples.gyro_dps, samples.gyro_temp_c, samples.status)
        for rate_dps, temp_c, status in zip(*(column.tolist() for column in columns), strict=True):
            message = self.kind.encode(rate_dps, temp_c, self.count, self.options, status == 0)
            messages.append(message if self._in_mode else b"~" * (len(message) - 2) + b"\r\n")
            self.count += 1
        data = self.line.carry(now_s, messages, b"")
        if data:
            self.endpoint.write(data)


class LiveTable:
    """The world's table between two samples of the gyro: its angle goes on at its rate up to the clock's time."""

    def __init__(self, table: RateTable, clock: Clock) -> None:
        self._table = table
        self._clock = clock

    def limits(self) -> TableLimits:
        """Limits of the virtual table."""
        return self._table.limits()

    def start(self) -> None:
        """Ready at once."""
        self._table.start()

    def set_rate(self, rate_dps: float) -> float:
        """Command a rate."""
        return self._table.set_rate(rate_dps)

    def read(self) -> TableReading:
        """Rate over the last sample, and the angle now."""
        reading, now_s = self._table.read(), self._clock.now_s()
        ahead_deg = reading.rate_dps * max(now_s - reading.t_s, 0.0)
        return replace(reading, t_s=now_s, angle_deg=reading.angle_deg + ahead_deg)

    def faults(self) -> tuple[str, ...]:
        """Faults of the table."""
        return self._table.faults()

    def send_stop(self) -> None:
        """Bring the table to rest."""
        self._table.send_stop()

    def close(self) -> None:
        """Close the table."""
        self._table.close()


class BenchServer:
    """Three ports before one world. `serve` returns when `stop` is set."""

    def __init__(
        self,
        world: World,
        drain: Callable[[], GyroSamples],
        gyro: GyroPort,
        table: Port,
        chamber: Port,
        clock: Clock,
    ) -> None:
        self.gyro = gyro
        self.table = table
        self.chamber = chamber
        self._world = world
        self._drain = drain
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
        """One look: let the world catch up with the clock, answer requests, send samples."""
        now_s = self._clock.now_s()
        self._world.advance_to(now_s)
        # Answers first: whoever asks for an angle takes the middle of question and answer for its time.
        self.table.serve(now_s)
        self.chamber.serve(now_s)
        self.gyro.serve(now_s, self._drain())


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
    world: World,
    bench: Bench,
    kinds: ServedKinds,
    clock: Clock,
    make_endpoint: Callable[[str], Endpoint],
    *,
    table: RateTable | None = None,
    chamber: Chamber | None = None,
    gyro: Callable[[GyroSamples], GyroSamples] = lambda samples: samples,
) -> BenchServer:
    """A server of the three devices; `make_endpoint` is called with ``gyro``, ``table`` and ``chamber``.

    Parameters
    ----------
    table, chamber : optional
        Stand before those of `bench`: faulty ones, for example.
    gyro : callable, optional
        Changes the samples before they are sent.
    """
    before_table = table or LiveTable(bench.table, clock)
    return BenchServer(
        world,
        lambda: gyro(bench.gyro.drain()),
        GyroPort(make_endpoint("gyro"), GYROS[kinds.gyro], kinds.gyro_options),
        Port(make_endpoint("table"), TABLES[kinds.table].responder(before_table, kinds.table_options)),
        Port(
            make_endpoint("chamber"),
            CHAMBERS[kinds.chamber].responder(chamber or bench.chamber, kinds.chamber_options),
        ),
        clock,
    )
