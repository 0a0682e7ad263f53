"""Each fault of the wire and of the devices is survived, or ends the run safely; the drivers are those that ship.

What is expected of each fault stands beside it in `FAULTS`.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.bench.devices import ChamberReading, GyroSamples, TableReading
from gyrocal.bench.gyros.stream import StreamLimits
from gyrocal.bench.profile import RetrySpec, profile_from_dict
from gyrocal.bench.virtual.faults import (
    ChangedLine,
    CutLine,
    DisorderlyLine,
    EchoingLine,
    LateLine,
    NoisyLine,
    Span,
    bad_status,
    stuck,
    thermometer_shows,
)
from gyrocal.bench.virtual.server import Line
from gyrocal.bench.wiring import ROLES, read_wire
from gyrocal.errors import DeviceError, GyrocalError, InterlockError, StopNotVerifiedError, exit_code
from gyrocal.records.run import read_run
from tests.bench.onwire.stand import WireStand
from tests.bench.test_runner import events
from tests.bench.tiny import tiny

#: While the first data sets are recorded, s.
MIDDLE = Span(28.0, 31.5)
FOR_GOOD = Span(28.0)


def commands(stand: WireStand) -> list[dict[str, Any]]:
    """What the program said to the table, line by line."""
    return [json.loads(line) for line in stand.ports["table"].sent.splitlines()]


def check_safe(stand: WireStand, *, table_told: bool = True, chamber_told: bool = True) -> None:
    """The last motion command is a stop and was obeyed; the chamber goes to its safe set point."""
    if table_told:
        motions = [c["command"] for c in commands(stand) if c["command"] in ("set_rate", "stop")]
        assert motions[-1] == "stop"
        stand.clock.sleep(3.0)
        assert stand.world.read_table()[0] == 0.0
    if chamber_told:
        assert stand.chamber.read().setpoint_c == 21.0


@dataclass(frozen=True)
class Fault:
    """A fault and what has to come of it: an error with these words, or a summary."""

    expect: str
    lines: dict[str, Callable[[], Line]] = field(default_factory=dict)
    error: type[GyrocalError] | None = None
    says: str = ""
    stand: dict[str, Any] = field(default_factory=dict)
    chamber_told: bool = True
    table_told: bool = True


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def vanishing(role: str, span: Span) -> Callable[[WireStand, float], None]:
    """Pull the plug of a port, and put it back."""

    def at(stand: WireStand, now_s: float) -> None:
        port = stand.ports[role]
        if span.holds(now_s) and not port.gone:
            port.vanish()
        elif port.gone and now_s >= span.end_s:
            port.come_back()

    return at


def restarting(stand: WireStand, now_s: float) -> None:
    """The gyro loses its supply for a second and a half, and with it its mode."""
    if 28.5 <= now_s < 28.55:
        stand.server.gyro.restart()
        stand.line("gyro", CutLine(Span(0.0, 30.5)))


def overshoot(reading: TableReading) -> TableReading:
    """Five per cent too fast at first, which is waited for."""
    return replace(reading, rate_dps=reading.rate_dps * (1.05 if 26.0 < reading.t_s < 29.0 else 1.0))


def lost_place(reading: TableReading) -> TableReading:
    """The encoder has lost a quarter turn."""
    return replace(reading, angle_deg=reading.angle_deg + (90.0 if reading.t_s > 30.0 else 0.0))


def wrapped(reading: TableReading) -> TableReading:
    """A controller that counts from 0 to 360 deg."""
    return replace(reading, angle_deg=(reading.angle_deg + 350.0) % 360.0)


def frozen() -> Callable[[ChamberReading], ChamberReading]:
    """A chamber that shows the same for ever."""
    last: list[ChamberReading] = []

    def reading(now: ChamberReading) -> ChamberReading:
        if now.t_s < 46.0 or not last:
            last[:] = [now]
        return replace(now, temp_c=last[0].temp_c)

    return reading


def in_hundredths(samples: GyroSamples) -> GyroSamples:
    """A thermometer set to whole degrees, read as hundredths."""
    return replace(samples, gyro_temp_c=0.01 * samples.gyro_temp_c)


NAK = b'{"ok": false, "error": "busy"}\n'

#: ``expect``: complete (all recorded, perhaps at a later attempt), marked (recorded, not all settled), failed (the
#: summary says which), ended (an error, the bench safe).
FAULTS: dict[str, Fault] = {
    # the gyro's line
    "0.1 % of frames damaged": Fault("complete", {"gyro": lambda: NoisyLine(rng(), flipped=0.001 / 36)}),
    "1 % of frames damaged": Fault("complete", {"gyro": lambda: NoisyLine(rng(), flipped=0.01 / 36)}),
    "10 % of frames damaged": Fault(
        "failed", {"gyro": lambda: NoisyLine(rng(), flipped=0.1 / 36)}, says="frames were damaged"
    ),
    "bytes dropped": Fault("failed", {"gyro": lambda: NoisyLine(rng(), lost=0.01)}, says="were damaged"),
    "frames lost for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), lost=0.5, span=MIDDLE)}
    ),
    "frames repeated for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), repeated=0.5, span=MIDDLE)}
    ),
    "frames out of sequence for a while": Fault(
        "complete", {"gyro": lambda: DisorderlyLine(rng(), swapped=0.5, span=MIDDLE)}
    ),
    "gyro silent for a while": Fault("complete", {"gyro": lambda: CutLine(MIDDLE)}),
    "gyro silent for good": Fault(
        "ended", {"gyro": lambda: CutLine(FOR_GOOD)}, DeviceError, "no byte came within"
    ),
    "gyro at another baud rate": Fault(
        "ended",
        {"gyro": lambda: ChangedLine(lambda data: bytes(b & 0x5A for b in data))},
        DeviceError,
        "no frame among them. The baud rate is wrong",
    ),
    "gyro port vanishes and returns": Fault("complete", stand={"at": vanishing("gyro", MIDDLE)}),
    "gyro port vanishes for good": Fault(
        "ended", error=DeviceError, says="no such port", stand={"at": vanishing("gyro", FOR_GOOD)}
    ),
    "gyro restarts, mode lost": Fault("complete", stand={"at": restarting, "gyro": "vn100"}),
    # the gyro
    "gyro stuck for a while": Fault(
        "complete", stand={"faulty_gyro": stuck(MIDDLE), "stream__stuck_samples": 20}
    ),
    "gyro stuck for good": Fault(
        "failed", says="it is stuck", stand={"faulty_gyro": stuck(FOR_GOOD), "stream__stuck_samples": 20}
    ),
    "gyro calls its samples bad for a while": Fault("complete", stand={"faulty_gyro": bad_status(MIDDLE)}),
    "gyro calls its samples bad": Fault(
        "ended", error=DeviceError, says="the device calls", stand={"faulty_gyro": bad_status(Span())}
    ),
    "gyro thermometer dead": Fault(
        "ended",
        error=InterlockError,
        says="outside -45 to 80 °C",
        stand={"faulty_gyro": thermometer_shows(FOR_GOOD, -300.0)},
    ),
    "gyro too hot from the start": Fault(
        "ended",
        error=InterlockError,
        says="the gyro is at 90.0 °C",
        stand={"faulty_gyro": thermometer_shows(Span(), 90.0)},
    ),
    "gyro thermometer frozen": Fault(
        "ended",
        error=InterlockError,
        says="thermometer moved by 0.00 °C: it is frozen",
        stand={"faulty_gyro": thermometer_shows(Span(10.0), 20.3), "plan__temperatures_c": [20.0, 26.0]},
    ),
    "gyro thermometer in another unit": Fault(
        "ended",
        error=InterlockError,
        says="or its unit is wrong",
        stand={"faulty_gyro": in_hundredths, "plan__temperatures_c": [20.0, 26.0]},
    ),
    # the table's line
    "table answers late": Fault("complete", {"table": lambda: LateLine(0.4)}),
    "table answers too late for a while": Fault("complete", {"table": lambda: LateLine(5.0, MIDDLE)}),
    "table gives half an answer for a while": Fault(
        "complete", {"table": lambda: ChangedLine(lambda data: data[: len(data) // 2], MIDDLE)}
    ),
    "table gives garbage for a while": Fault(
        "complete", {"table": lambda: ChangedLine(lambda data: b"\xf0\n" * 9, MIDDLE)}
    ),
    "table line echoes for a while": Fault("complete", {"table": lambda: EchoingLine(MIDDLE)}),
    "table refuses for a while": Fault("complete", {"table": lambda: ChangedLine(lambda data: NAK, MIDDLE)}),
    "1 % of the table's bytes damaged": Fault(
        "complete", {"table": lambda: NoisyLine(rng(), flipped=0.0003)}
    ),
    "table silent for good": Fault(
        "ended", {"table": lambda: CutLine(FOR_GOOD)}, StopNotVerifiedError, "MAY STILL BE TURNING"
    ),
    "table port vanishes and returns": Fault("complete", stand={"at": vanishing("table", MIDDLE)}),
    "table port vanishes for good": Fault(
        "ended",
        error=StopNotVerifiedError,
        says="MAY STILL BE TURNING",
        stand={"at": vanishing("table", FOR_GOOD)},
        table_told=False,
    ),
    # the table
    "table never at rate": Fault(
        "marked", says="the table reached", stand={"faulty_table": {"command": lambda t_s, dps: 0.99 * dps}}
    ),
    "table overshoots": Fault("complete", stand={"faulty_table": {"reading": overshoot}}),
    "table stalls": Fault(
        "marked",
        says="the table reached",
        stand={"faulty_table": {"command": lambda t_s, dps: 0.0 if t_s > 26.0 else dps}},
    ),
    "table drifts": Fault(
        "marked",
        says="deg/s",
        stand={"faulty_table": {"reading": lambda r: replace(r, rate_dps=r.rate_dps * (1 + 2e-5 * r.t_s))}},
    ),
    "table loses its place": Fault(
        "marked", says="jumped by 90 deg: it lost its place", stand={"faulty_table": {"reading": lost_place}}
    ),
    "table's angle wraps at 360 deg": Fault("complete", stand={"faulty_table": {"reading": wrapped}}),
    "table reports a fault": Fault(
        "ended",
        error=InterlockError,
        says="the table reports encoder lost",
        stand={"faulty_table": {"fault": lambda t_s: ("encoder lost",) if t_s > 28.0 else ()}},
    ),
    "table runs away": Fault(
        "ended",
        error=InterlockError,
        says="the table turns at",
        stand={"faulty_table": {"command": lambda t_s, dps: 4.5 * dps}},
    ),
    # the chamber's line
    "chamber answers late": Fault("complete", {"chamber": lambda: LateLine(0.3)}),
    "chamber gives garbage for a while": Fault(
        "complete", {"chamber": lambda: ChangedLine(lambda data: b"\xf0\n", MIDDLE)}
    ),
    "chamber port vanishes and returns": Fault("complete", stand={"at": vanishing("chamber", MIDDLE)}),
    "chamber port vanishes for good": Fault(
        "ended",
        error=DeviceError,
        says="no such port",
        stand={"at": vanishing("chamber", FOR_GOOD)},
        chamber_told=False,
    ),
    # the chamber
    "chamber never arrives": Fault(
        "marked", says="the chamber was at", stand={"faulty_chamber": {"heard": lambda c: min(c, 20.6)}}
    ),
    "chamber overshoots": Fault(
        "complete",
        stand={
            "faulty_chamber": {"reading": lambda r: replace(r, temp_c=r.temp_c + 3.0 * np.exp(-r.t_s / 4.0))}
        },
    ),
    "chamber freezes": Fault(
        "marked", says="the chamber was at 20", stand={"faulty_chamber": {"reading": frozen()}}
    ),
    "chamber reports an alarm": Fault(
        "ended",
        error=InterlockError,
        says="the chamber reports loop 1 error",
        stand={
            "faulty_chamber": {"reading": lambda r: replace(r, alarms=("door open",) if r.t_s > 28.0 else ())}
        },
    ),
    "chamber switches itself off": Fault(
        "ended",
        error=InterlockError,
        says="the chamber is not running",
        stand={"faulty_chamber": {"reading": lambda r: replace(r, running=r.t_s < 28.0)}},
    ),
}


#: What runs with every change; the others take the same ways and are tried with the slow tests.
ALWAYS = (
    "1 % of frames damaged",
    "10 % of frames damaged",
    "frames repeated for a while",
    "gyro silent for good",
    "gyro at another baud rate",
    "gyro port vanishes and returns",
    "gyro restarts, mode lost",
    "gyro stuck for a while",
    "gyro thermometer frozen",
    "table gives half an answer for a while",
    "table line echoes for a while",
    "table port vanishes and returns",
    "table port vanishes for good",
    "table drifts",
    "table loses its place",
    "table's angle wraps at 360 deg",
    "table runs away",
    "chamber port vanishes and returns",
    "chamber freezes",
    "chamber reports an alarm",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in ALWAYS else [pytest.mark.slow]) for name in FAULTS]
)
def test_a_fault_is_survived_or_ends_safely(tmp_path: Path, name: str) -> None:
    fault = FAULTS[name]
    stand = WireStand(tmp_path / "r", **fault.stand)
    for role, make in fault.lines.items():
        stand.line(role, make())
    if fault.expect == "ended":
        assert fault.error is not None
        with pytest.raises(fault.error) as caught:
            stand.run()
        assert fault.says in str(caught.value), str(caught.value)
    else:
        summary = stand.run()
        said = " ".join([*summary.failed, *summary.skipped, *stand.watch.said])
        assert fault.says in said, said
        if fault.expect == "complete":
            assert summary.complete, said
            assert summary.unsettled == []
        elif fault.expect == "marked":
            assert summary.complete
            assert summary.unsettled
        else:
            assert not summary.complete
        check_run(stand)
    check_safe(stand, chamber_told=fault.chamber_told, table_told=fault.table_told)


def test_what_always_runs_is_named_rightly() -> None:
    assert set(ALWAYS) <= set(FAULTS)


def check_run(stand: WireStand) -> None:
    """Every sealed segment is whole and there once; the journal tells of every attempt that failed."""
    run = read_run(stand.out)
    ids = [record.id for record in run.segments]
    assert len(ids) == len(set(ids))
    for segment in run:
        assert segment.record.n == segment.t_s.size
    assert [e["event"] for e in events(stand.out, "end")] == ["end"]


def test_what_is_survived_is_told(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", at=vanishing("gyro", Span(29.0, 32.5)))
    summary = stand.run()
    short, silent = events(stand.out, "attempt_failed")
    assert short["reason"].startswith("6 samples came where 29 were due")
    assert short["samples_not_kept"] == 6
    assert "has been silent" in silent["reason"]
    assert (short["attempts_left"], silent["attempts_left"]) == (2, 1)
    assert summary.complete
    assert len(summary.retried) == 2
    assert events(stand.out, "end")[0]["retried"] == summary.retried


def test_what_is_too_little_to_fail_a_segment_is_told(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r").line("gyro", NoisyLine(rng(), flipped=0.01 / 36))
    summary = stand.run()
    assert summary.complete
    told = events(stand.out, "stream")
    assert sum(line["frames_bad"] for line in told) >= 3
    assert all(line["frames_good"] > 0 for line in told)


def test_nothing_moves_when_the_gyro_is_too_hot_from_the_start(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", faulty_gyro=thermometer_shows(Span(), 90.0))
    with pytest.raises(InterlockError, match="the gyro is at 90"):
        stand.run()
    assert "set_rate" not in [c["command"] for c in commands(stand)]


def test_half_a_command_of_a_program_that_died_is_survived(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", chamber="espec")
    stand.server.chamber.responder.feed(b"TEMP, S2")
    assert stand.run().complete


def test_a_table_that_nobody_asks_any_more_stops_by_itself(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r")
    stand.bench.table.start()
    stand.bench.table.set_rate(30.0)
    stand.clock.sleep(9.0)
    assert stand.world.read_table()[0] == pytest.approx(30.0, abs=0.1)
    stand.clock.sleep(3.0)
    assert stand.world.read_table()[0] == 0.0


def test_attempts_are_limited_and_then_skipped(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", retry__attempts=1, retry__wait_s=10.0)

    def refuse_fast(now_s: float, rate_dps: float) -> float:
        if rate_dps > 29.0:
            raise DeviceError("overload")
        return rate_dps

    stand.table._command = refuse_fast
    summary = stand.run()
    assert len(summary.retried) == 2
    assert [text.partition(":")[0] for text in summary.skipped] == [
        "rate at +30 deg/s, 20 °C",
        "rate at +30 deg/s, 21.5 °C",
    ]
    assert not summary.complete
    assert summary.recorded == 10
    check_safe(stand)


def test_attempts_are_limited_and_then_stopped(tmp_path: Path) -> None:
    stand = WireStand(
        tmp_path / "r",
        retry__attempts=1,
        retry__then="stop",
        faulty_gyro=stuck(FOR_GOOD),
        stream__stuck_samples=20,
    )
    with pytest.raises(GyrocalError, match="it is stuck"):
        stand.run()
    check_safe(stand)


@pytest.mark.parametrize(
    ("gyro", "table", "chamber"),
    [
        ("kvh-frame-b", "zaber", "espec"),
        ("vn100", "aerosmith", "watlow-f4"),
        ("kvh-dsp3000", "acutrol", "watlow-f4t-modbus"),
        ("kvh-ecore2000", "json-lines", "weiss"),
        ("ascii-line", "json-lines", "watlow-f4t-scpi"),
    ],
)
def test_every_kind_carries_a_run(tmp_path: Path, gyro: str, table: str, chamber: str) -> None:
    stand = WireStand(
        tmp_path / "r",
        gyro=gyro,
        table=table,
        chamber=chamber,
        virtual__chamber__ripple_c=0.0,
        settle__tolerance_dps=0.05,
    )
    summary = stand.run()
    assert summary.complete, summary
    assert summary.unsettled == [], stand.watch.said
    run = read_run(stand.out)
    for segment in run:
        if segment.record.kind == "rate":
            turned = segment.table_angle_deg[-1] - segment.table_angle_deg[0]
            made_dps = turned / (segment.bench_t_s[-1] - segment.bench_t_s[0])
            assert made_dps == pytest.approx(segment.record.rate_dps, abs=0.2)
            assert np.mean(segment.gyro_dps) == pytest.approx(segment.record.rate_dps, abs=1.0)
    # a chamber without a ramp of its own was led along one
    ramp = run.segment(next(r for r in run.segments if r.kind == "ramp" and r.id > 1))
    assert np.max(np.diff(ramp.chamber_temp_c)) < 0.7


def test_the_table_of_faults_says_what_is_tested() -> None:
    readme = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", readme, flags=re.MULTILINE))
    words = {"complete": "survived", "marked": "recorded and marked", "failed": "segments fail"}
    for name, fault in FAULTS.items():
        expected = (
            words.get(fault.expect)
            or f"ends safely; exit code {exit_code(fault.error('')) if fault.error else ''}"
        )
        assert rows[name].startswith(expected), name


def test_the_profile_of_the_readme_is_one() -> None:
    readme = (Path(__file__).parents[3] / "bench_profiles" / "README.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", readme, flags=re.DOTALL)
    devices = tomllib.loads(text)
    profile = profile_from_dict({**tiny(), **devices}, "README")
    assert [read_wire(profile, role).kind for role in ROLES] == ["kvh-frame-a", "zaber", "espec"]
    assert (profile.retry, profile.stream) == (RetrySpec(), StreamLimits())
