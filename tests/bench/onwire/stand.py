"""A tiny run through the drivers that ship, over lines in memory, on the virtual clock: faults cost no waiting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from gyrocal.bench.clock import VirtualClock
from gyrocal.bench.devices import GyroSamples
from gyrocal.bench.profile import profile_from_dict
from gyrocal.bench.runner import Runner
from gyrocal.bench.safety import StopRequests
from gyrocal.bench.session import plan_of
from gyrocal.bench.virtual.devices import virtual_bench
from gyrocal.bench.virtual.server import Line, LiveTable, make_server
from gyrocal.bench.virtual.serving import served_kinds, snippet_of
from gyrocal.bench.watching import Summary
from gyrocal.bench.wiring import Wire, open_bench
from gyrocal.errors import DeviceError
from gyrocal.records.journal import create_run
from tests.bench.onwire.faulty import FaultyChamber, FaultyTable
from tests.bench.tiny import Silent, tiny

#: Virtual time between two looks of the server, s.
SLICE_S = 0.05
#: Changes to the tiny profile: a quick chamber, failures done again.
QUICK: dict[str, Any] = {
    "plan__temperatures_c": [20.0, 21.5],
    "ramp__rate_c_per_min": 20.0,
    "ramp__deadline_s": 20.0,
    "soak__time_s": 10.0,
    "soak__slope_over_s": 10.0,
    "soak__slope_c_per_min": 3.0,
    "soak__deadline_s": 40.0,
    "retry__attempts": 2,
    "retry__then": "skip",
    "safe__chamber_c": 21.0,
    "virtual__start_temp_c": 20.5,
    "virtual__chamber__air_s": 1.0,
    "virtual__chamber__case_s": 4.0,
    "virtual__chamber__max_ramp_c_per_min": 30.0,
    "virtual__table__max_rate_dps": 140.0,
}


class SlicedClock(VirtualClock):
    """A virtual clock that passes in slices, so that bytes arrive when they should."""

    def sleep(self, duration_s: float) -> None:
        """Pass in slices, and whole: who waits for the rest of a wait, however small, would wait for ever."""
        while duration_s > 0.0:
            super().sleep(min(duration_s, SLICE_S))
            duration_s -= SLICE_S


class Memory:
    """A line in memory: an endpoint for the server, and a transport for the driver."""

    def __init__(self, clock: SlicedClock) -> None:
        self.address = "memory"
        self.gone = False
        self.sent = b""
        self._clock = clock
        self._to_device = self._to_program = b""
        #: A streaming driver takes bytes as they come.
        self.push: Callable[[float, bytes], None] | None = None

    # the device's end

    def read(self) -> bytes:
        data, self._to_device = self._to_device, b""
        return data

    def vanish(self) -> None:
        self.gone = True
        self._to_device = self._to_program = b""

    def come_back(self) -> None:
        self.gone = False

    # both ends; a device's answer and a driver's request are told apart by who calls

    def write(self, data: bytes) -> None:
        if self.gone:
            return
        if self.push is not None:
            self.push(self._clock.now_s(), data)
        else:
            self._to_program += data

    def close(self) -> None:
        self.push = None
        self._to_program = b""


class DriverEnd:
    """The program's end of a `Memory`."""

    def __init__(self, memory: Memory, clock: SlicedClock) -> None:
        if memory.gone:
            raise DeviceError("memory: there is no such port. Check the cable.")
        self._memory, self._clock = memory, clock

    def now_s(self) -> float:
        return self._clock.now_s()

    def write(self, data: bytes) -> None:
        self._check()
        self._memory.sent += data
        self._memory._to_device += data

    def read_available(self, wait_s: float) -> bytes:
        until_s = self._clock.now_s() + wait_s
        while True:
            self._check()
            data, self._memory._to_program = self._memory._to_program, b""
            if data or self._clock.now_s() >= until_s:
                return data
            self._clock.sleep(min(SLICE_S, until_s - self._clock.now_s()))

    def close(self) -> None:
        self._memory.close()

    def _check(self) -> None:
        if self._memory.gone:
            raise DeviceError("memory: the port is gone. Check the cable.")


class WireStand:
    """A tiny run on the wire. Faults are put in before `run`."""

    def __init__(
        self,
        out: Path,
        *,
        gyro: str = "kvh-frame-a",
        table: str = "json-lines",
        chamber: str = "watlow-f4t-scpi",
        faulty_table: dict[str, Any] | None = None,
        faulty_chamber: dict[str, Any] | None = None,
        faulty_gyro: Callable[[GyroSamples], GyroSamples] = lambda samples: samples,
        at: Callable[[WireStand, float], None] = lambda stand, now_s: None,
        **changes: Any,
    ) -> None:
        self.out = out
        profile = profile_from_dict(tiny(**{**QUICK, **changes}), "tiny.toml")
        self.clock = SlicedClock()
        self.ports = {role: Memory(self.clock) for role in ("gyro", "table", "chamber")}
        kinds = served_kinds(profile, {"gyro": gyro, "table": table, "chamber": chamber})
        bench, _, self.world = virtual_bench(profile)
        self.table = FaultyTable(LiveTable(bench.table, self.clock), **(faulty_table or {}))
        self.chamber = FaultyChamber(bench.chamber, **(faulty_chamber or {}))
        self.server = make_server(
            self.world,
            bench,
            kinds,
            self.clock,
            self.ports.__getitem__,
            table=self.table,
            chamber=self.chamber,
            gyro=faulty_gyro,
        )
        snippet = snippet_of(profile, kinds, {role: f"memory://{role}" for role in self.ports})
        self.profile = profile_from_dict({**profile.raw, **snippet}, "tiny.toml")
        opened = open_bench(self.profile, self.clock, lambda question: "", open_port=self._open)
        self.bench = replace(opened, describe="wire")
        self.requests = StopRequests()
        self.watch = Silent()
        self._at = at
        self.clock.subscribe(self._tick)
        self.plan = plan_of(self.profile, self.bench)

    def line(self, role: str, line: Line) -> WireStand:
        """Put a line in the place of a sound one."""
        getattr(self.server, role).line = line
        return self

    @property
    def steps_begun(self) -> int:
        """Number of the step at hand."""
        return self.watch.seen[-1].step.id if self.watch.seen else 0

    def _tick(self, now_s: float) -> None:
        self._at(self, now_s)
        self.server.step()

    def _open(self, role: str, wire: Wire) -> DriverEnd:
        end = DriverEnd(self.ports[role], self.clock)
        if role == "gyro":
            self.ports[role].push = self.bench.gyro.take  # type: ignore[attr-defined]
        return end

    def run(self) -> Summary:
        """Run it."""
        head = {"schema": "gyrocal-run/1", "sensor": {"model": "RD2100"}}
        with create_run(self.out, head) as writer:
            runner = Runner(
                self.bench, self.clock, self.profile, self.plan, writer, self.requests, self.watch
            )
            return runner.run("start")
