"""A bench run that takes three minutes of virtual time, and hands to break it with."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from gyrocal.bench.devices import Bench, ChamberReading, GyroSamples, TableReading
from gyrocal.bench.plan import Plan
from gyrocal.bench.profile import Profile, profile_from_dict
from gyrocal.bench.runner import Runner
from gyrocal.bench.safety import StopRequests
from gyrocal.bench.session import plan_of
from gyrocal.bench.virtual.devices import virtual_bench
from gyrocal.bench.watching import Progress, Summary
from gyrocal.records.journal import create_run

TINY: dict[str, Any] = {
    "title": "tiny",
    "sensor": {
        "model": "RD2100",
        "sample_rate_hz": 10.0,
        "rate_range_dps": [-100.0, 100.0],
        "temp_range_c": [-40.0, 75.0],
    },
    "plan": {"temperatures_c": [20.0, 24.0], "temperature_order": "up", "rates_dps": [30.0], "dwell_s": 3.0},
    "settle": {"tolerance_dps": 0.02, "hold_s": 1.0, "deadline_s": 10.0},
    "ramp": {"rate_c_per_min": 5.0, "deadline_s": 60.0},
    "soak": {
        "window_c": 0.5,
        "time_s": 20.0,
        "slope_c_per_min": 1.0,
        "slope_over_s": 20.0,
        "deadline_s": 120.0,
    },
    "retry": {"attempts": 0, "then": "stop"},
    "safe": {"chamber_c": 22.0},
    "virtual": {"start_temp_c": 21.0, "chamber": {"air_s": 2.0, "case_s": 10.0}},
}


def tiny(**changes: Any) -> dict[str, Any]:
    """The tiny profile's table; ``soak__time_s=5`` sets ``soak.time_s``, None takes a key away."""
    table = copy.deepcopy(TINY)
    for dotted, value in changes.items():
        *path, name = dotted.split("__")
        place = table
        for key in path:
            place = place.setdefault(key, {})
        if value is None:
            place.pop(name, None)
        else:
            place[name] = value
    return table


def tiny_profile(**changes: Any) -> Profile:
    """The tiny profile, checked."""
    return profile_from_dict(tiny(**changes), "tiny.toml")


class Silent:
    """A watch that keeps what it was told."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.seen: list[Progress] = []

    def progress(self, progress: Progress) -> None:
        """Keep it."""
        self.seen.append(progress)

    def say(self, text: str) -> None:
        """Keep it."""
        self.said.append(text)


class SpyGyro:
    """A gyro that reports each call before it is made."""

    def __init__(self, inner: Any, before: Callable[[str], None]) -> None:
        self.inner, self.before = inner, before

    def start(self) -> None:
        """Start."""
        self.before("gyro.start")
        self.inner.start()

    def drain(self) -> GyroSamples:
        """Drain."""
        self.before("gyro.drain")
        samples: GyroSamples = self.inner.drain()
        return samples

    def health(self) -> Any:
        """Health."""
        return self.inner.health()

    def close(self) -> None:
        """Close."""
        self.inner.close()


class SpyTable:
    """A table that reports each call before it is made, keeps the motion commands, and may falsify its readings."""

    def __init__(self, inner: Any, before: Callable[[str], None]) -> None:
        self.inner, self.before = inner, before
        self.motions: list[str] = []
        self.falsify: Callable[[TableReading], TableReading] = lambda reading: reading
        self.fault: tuple[str, ...] = ()

    def limits(self) -> Any:
        """Limits."""
        return self.inner.limits()

    def start(self) -> None:
        """Start."""
        self.before("table.start")

    def set_rate(self, rate_dps: float) -> float:
        """Command."""
        self.motions.append(f"rate {rate_dps:g}")
        self.before("table.set_rate")
        made: float = self.inner.set_rate(rate_dps)
        return made

    def read(self) -> TableReading:
        """Read."""
        self.before("table.read")
        return self.falsify(self.inner.read())

    def faults(self) -> tuple[str, ...]:
        """Faults."""
        return self.fault

    def send_stop(self) -> None:
        """Stop."""
        self.motions.append("stop")
        self.inner.send_stop()

    def close(self) -> None:
        """Close."""


class SpyChamber:
    """A chamber that reports each call before it is made and may falsify its readings."""

    def __init__(self, inner: Any, before: Callable[[str], None]) -> None:
        self.inner, self.before = inner, before
        self.setpoints: list[float] = []
        self.falsify: Callable[[ChamberReading], ChamberReading] = lambda reading: reading

    def limits(self) -> Any:
        """Limits."""
        return self.inner.limits()

    def start(self) -> None:
        """Start."""
        self.before("chamber.start")

    def set_alarm_limits(self, low_c: float, high_c: float) -> None:
        """Alarms."""
        self.before("chamber.set_alarm_limits")

    def set_setpoint(self, temp_c: float, ramp_c_per_min: float | None = None) -> None:
        """Command."""
        self.setpoints.append(temp_c)
        self.before("chamber.set_setpoint")
        self.inner.set_setpoint(temp_c, ramp_c_per_min)

    def read(self) -> ChamberReading:
        """Read."""
        self.before("chamber.read")
        return self.falsify(self.inner.read())

    def close(self) -> None:
        """Close."""


class Stand:
    """A tiny run on spied devices."""

    def __init__(self, out: Path, before: Callable[[str], None] = lambda call: None, **changes: Any) -> None:
        self.out = out
        self.profile = tiny_profile(**changes)
        bench, self.clock, self.world = virtual_bench(self.profile)
        self.plan: Plan = plan_of(self.profile, bench)
        self.table = SpyTable(bench.table, before)
        self.chamber = SpyChamber(bench.chamber, before)
        self.bench: Bench = replace(
            bench, gyro=SpyGyro(bench.gyro, before), table=self.table, chamber=self.chamber
        )
        self.requests = StopRequests()
        self.watch = Silent()

    def run(self) -> Summary:
        """Run it."""
        head = {"schema": "gyrocal-run/1", "sensor": {"model": "RD2100"}}
        with create_run(self.out, head) as writer:
            runner = Runner(
                self.bench, self.clock, self.profile, self.plan, writer, self.requests, self.watch
            )
            return runner.run("start")
