"""The room that the strange devices stand in: one loop in a thread, lines that are ports, and the physics they share."""

from __future__ import annotations

import heapq
import itertools
import os
import random
import select
import socket
import threading
import time
import tty
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType

#: Physics advances by this much at a time.
TICK_S = 0.005


@dataclass
class Faults:
    """What is wrong with a line or its device; tests change it while the run goes on.

    Attributes
    ----------
    late_s : (float, float), s
        Answers come so late, drawn evenly between both.
    babble : bytes
        Sent every `babble_period_s`, asked or not.
    ignores_stop : bool
        The table answers a stop as ever, and turns on.
    mute : bool
        Nothing is sent at all.
    """

    late_s: tuple[float, float] = (0.0, 0.0)
    babble: bytes = b""
    babble_period_s: float = 0.005
    ignores_stop: bool = False
    mute: bool = False


class Line:
    """The device's end of a port: a pseudo-terminal, or a TCP socket that one client may have."""

    def __init__(self, lab: Lab, *, tcp: bool = False) -> None:
        self.lab = lab
        self.faults = Faults()
        self.receive: Callable[[bytes], None] = lambda data: None
        self.heard: list[tuple[float, bytes]] = []
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._busy_until_s = 0.0
        if tcp:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
            self._fds: list[int] = []
        else:
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self.url = os.ttyname(slave)
            self._fds = [master, slave]
        lab.lines.append(self)

    @property
    def watched(self) -> list[int]:
        """Descriptors to wait on."""
        if self._listener is None:
            return self._fds[:1]
        return [self._listener.fileno()] + ([self._peer.fileno()] if self._peer else [])

    def ready(self, fd: int) -> None:
        """Take what came on `fd`."""
        if self._listener is not None and fd == self._listener.fileno():
            self._hang_up()
            self._peer, _ = self._listener.accept()
            self._peer.setblocking(False)
            return
        try:
            data = os.read(fd, 4096)
        except OSError:
            data = b""
        if not data:
            self._hang_up()
            return
        self.heard.append((self.lab.now(), data))
        self.receive(data)

    def send(self, data: bytes) -> None:
        """Answer, as late as the line's fault says; answers stay in order."""
        low, high = self.faults.late_s
        if high == 0.0:
            self.put(data)
            return
        self._busy_until_s = max(self._busy_until_s, self.lab.now() + self.lab.random.uniform(low, high))
        self.lab.at(self._busy_until_s, lambda: self.put(data))

    def put(self, data: bytes) -> None:
        """Bytes on the wire, now; what nobody takes is lost, as on a real line."""
        fd = self._peer.fileno() if self._peer else self._fds[0] if self._fds else -1
        if self.faults.mute or fd < 0:
            return
        try:
            os.write(fd, data)
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up()

    def babble(self) -> None:
        """Keep talking for as long as the fault says so."""
        if self.faults.babble:
            self.put(self.faults.babble)
        self.lab.after(self.faults.babble_period_s, self.babble)

    def close(self) -> None:
        """Give the descriptors back."""
        self._hang_up()
        if self._listener:
            self._listener.close()
        for fd in self._fds:
            os.close(fd)
        self._fds = []

    def _hang_up(self) -> None:
        if self._peer:
            self._peer.close()
            self._peer = None


@dataclass
class Table:
    """A table that accelerates: its rate goes to the demanded one at `acceleration_dps2`. Counter-clockwise positive."""

    acceleration_dps2: float = 200.0
    rate_dps: float = 0.0
    angle_deg: float = 12.5
    demand_dps: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether it turns, or is about to."""
        return self.rate_dps != 0.0 or self.demand_dps != 0.0

    def advance(self, dt_s: float) -> None:
        """`dt_s` later; exact for a constant acceleration."""
        need = self.demand_dps - self.rate_dps
        ramp_s = min(abs(need) / self.acceleration_dps2, dt_s)
        before = self.rate_dps
        self.rate_dps += max(-self.acceleration_dps2 * dt_s, min(self.acceleration_dps2 * dt_s, need))
        self.angle_deg += 0.5 * (before + self.rate_dps) * ramp_s + self.rate_dps * (dt_s - ramp_s)


@dataclass
class Chamber:
    """Air that lags behind the set point, and a gyro that lags behind the air."""

    air_c: float = 23.0
    gyro_c: float = 23.0
    setpoint_c: float = 23.0
    running: bool = False
    ambient_c: float = 23.0
    ambient_lag_s: float = 60.0
    air_lag_s: float = 0.8
    gyro_lag_s: float = 0.5
    ramp_c_per_s: float = 3.0

    def advance(self, dt_s: float) -> None:
        """`dt_s` later."""
        target, lag_s = (
            (self.setpoint_c, self.air_lag_s) if self.running else (self.ambient_c, self.ambient_lag_s)
        )
        slope = max(-self.ramp_c_per_s, min(self.ramp_c_per_s, (target - self.air_c) / lag_s))
        self.air_c += slope * dt_s
        self.gyro_c += (self.air_c - self.gyro_c) / self.gyro_lag_s * dt_s


@dataclass(frozen=True)
class Moment:
    """What was true at `t_s`."""

    t_s: float
    rate_dps: float
    angle_deg: float
    demand_dps: float
    air_c: float
    gyro_c: float


@dataclass
class Emission:
    """A sample as the gyro sent it, in deg/s counter-clockwise and as coarse as its wire; its temperature, deg C."""

    t_s: float
    gyro_dps: float
    temp_c: float


class Lab:
    """The loop: hold it in a ``with`` statement. Times are of the monotonic clock, as gyrocal's own."""

    def __init__(self, seed: int = 1) -> None:
        self.random = random.Random(seed)
        self.table = Table()
        self.chamber = Chamber()
        self.lines: list[Line] = []
        self.moments: list[Moment] = []
        self.emissions: list[Emission] = []
        self.commands: list[tuple[float, str]] = []
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._stopping = threading.Event()
        self._wake = os.pipe()
        self._advanced_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def now(self) -> float:
        """Seconds of the host's monotonic clock."""
        return time.monotonic()

    def at(self, t_s: float, what: Callable[[], None]) -> None:
        """Do `what` at a time; from any thread."""
        heapq.heappush(self._timers, (t_s, next(self._count), what))
        os.write(self._wake[1], b"x")

    def after(self, delay_s: float, what: Callable[[], None]) -> None:
        """Do `what` in a while."""
        self.at(self.now() + delay_s, what)

    def command(self, text: str) -> None:
        """Keep a motion or chamber command that was obeyed."""
        self.commands.append((self.now(), text))

    def true(self, t_s: float) -> Moment:
        """What was true at a time, of the last tick before it."""
        index = bisect_left(self.moments, t_s, key=lambda m: m.t_s)
        return self.moments[min(max(index - 1, 0), len(self.moments) - 1)]

    def advance(self) -> None:
        """Let physics come up to now."""
        now = self.now()
        while self._advanced_s + TICK_S <= now:
            self.table.advance(TICK_S)
            self.chamber.advance(TICK_S)
            self._advanced_s += TICK_S
            t, c = self.table, self.chamber
            self.moments.append(
                Moment(self._advanced_s, t.rate_dps, t.angle_deg, t.demand_dps, c.air_c, c.gyro_c)
            )

    def __enter__(self) -> Lab:
        self.advance()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        os.write(self._wake[1], b"x")
        self._thread.join(5.0)
        for line in self.lines:
            line.close()
        for fd in self._wake:
            os.close(fd)

    def _run(self) -> None:
        while not self._stopping.is_set():
            self.advance()
            now = self.now()
            while self._timers and self._timers[0][0] <= now:
                heapq.heappop(self._timers)[2]()
            wait_s = TICK_S
            if self._timers:
                wait_s = min(max(self._timers[0][0] - self.now(), 0.0), TICK_S)
            by_fd = {fd: line for line in self.lines for fd in line.watched}
            ready, _, _ = select.select([*by_fd, self._wake[0]], [], [], wait_s)
            self.advance()
            for fd in ready:
                if fd == self._wake[0]:
                    os.read(fd, 4096)
                elif fd in by_fd:
                    by_fd[fd].ready(fd)


@dataclass
class Lines:
    """Bytes to lines at a terminator; the rest waits."""

    end: bytes = b"\r"
    held: bytes = field(default=b"")

    def feed(self, data: bytes) -> list[str]:
        """Whole lines, without blanks at their ends."""
        *whole, self.held = (self.held + data).split(self.end)
        return [line.decode("latin-1").strip() for line in whole]
