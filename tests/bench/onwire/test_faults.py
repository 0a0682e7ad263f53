"""Each fault of the wire and of the devices is survived, or ends the run safely, on every kind of table and chamber.

The drivers are those that ship. What is expected of each fault stands beside it in `tests.bench.onwire.faults`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from gyrocal.bench.gyros.stream import StreamLimits
from gyrocal.bench.profile import RetrySpec, profile_from_dict
from gyrocal.bench.wiring import ROLES, read_wire
from gyrocal.errors import DeviceError, GyrocalError, InterlockError, exit_code
from gyrocal.records.run import read_run
from tests.bench.onwire.faults import (
    FAULTS,
    FOR_GOOD,
    PAIRS,
    UNSEEN,
    bench_of,
    check_safe,
    motions,
    rng,
    vanishing,
)
from tests.bench.onwire.faulty import NoisyLine, Span, stuck, thermometer_shows
from tests.bench.onwire.stand import WireStand
from tests.bench.test_runner import events
from tests.bench.tiny import tiny

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


#: A row on one pair of kinds is tried always, on the others with the slow tests.
CASES = [
    pytest.param(
        name,
        pair,
        marks=[] if name in ALWAYS and row % len(PAIRS) == turn else [pytest.mark.slow],
        id=f"{name}-{pair}",
    )
    for row, name in enumerate(FAULTS)
    for turn, pair in enumerate(PAIRS)
]


@pytest.mark.parametrize(("name", "pair"), CASES)
def test_a_fault_is_survived_or_ends_safely(tmp_path: Path, name: str, pair: tuple[str, str]) -> None:
    fault = FAULTS[name]
    expect = next((UNSEEN[name, kind] for kind in pair if (name, kind) in UNSEEN), fault.expect)
    stand = WireStand(tmp_path / "r", **{**bench_of(*pair), **fault.stand})
    for role, make in fault.lines.items():
        stand.line(role, make())
    if expect == "ended":
        assert fault.error is not None
        with pytest.raises(fault.error) as caught:
            stand.run()
        assert fault.says in str(caught.value), str(caught.value)
    else:
        summary = stand.run()
        said = " ".join([*summary.failed, *summary.skipped, *stand.watch.said])
        if expect == fault.expect:
            assert fault.says in said, said
        if expect == "complete":
            assert summary.complete, said
            assert summary.unsettled == []
        elif expect == "marked":
            assert summary.complete
            assert summary.unsettled
        else:
            assert not summary.complete
        check_run(stand)
    check_safe(stand, chamber_told=fault.chamber_told, table_told=fault.table_told)


def test_every_row_meets_every_kind() -> None:
    from gyrocal.bench.registry import CHAMBERS, TABLES

    assert {table for table, _ in PAIRS} == set(TABLES)
    assert {chamber for _, chamber in PAIRS} == set(CHAMBERS)


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
    assert sum(line["frames_bad"] for line in told) > 0
    assert all(line["frames_good"] > 0 for line in told)


@dataclass
class ClumpingLine:
    """Hands its messages over in pieces of 0.4 s, as a computer does that has other work."""

    _waiting: bytes = b""
    _handed_s: float = 0.0

    def carry(self, now_s: float, messages: Sequence[bytes], request: bytes) -> bytes:
        """What came since the last piece."""
        self._waiting += b"".join(messages)
        if now_s - self._handed_s < 0.4:
            return b""
        due, self._waiting, self._handed_s = self._waiting, b"", now_s
        return due


def test_clumps_fail_no_segment_where_a_counter_shows_that_all_is_there(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", gyro="kvh-frame-a").line("gyro", ClumpingLine())
    summary = stand.run()
    assert summary.complete, summary
    assert summary.retried == []
    told = events(stand.out, "stream")
    assert len(told) == summary.recorded
    assert all("of the samples arrived in clumps" in line["clumps"] for line in told)
    assert all(line["in_sequence"] == line["frames_good"] for line in told)
    assert any(text.startswith("late: rate at") and "latency_timer" in text for text in stand.watch.said)


def test_clumps_fail_a_segment_where_nothing_shows_that_all_is_there(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", gyro="vn100", retry__attempts=0).line("gyro", ClumpingLine())
    summary = stand.run()
    assert summary.recorded == 0
    assert all("arrived in clumps" in text for text in summary.failed)


def test_nothing_moves_when_the_gyro_is_too_hot_from_the_start(tmp_path: Path) -> None:
    stand = WireStand(tmp_path / "r", faulty_gyro=thermometer_shows(Span(), 90.0))
    with pytest.raises(InterlockError, match="the gyro is at 90"):
        stand.run()
    assert not any(b"set_rate" in motion for motion in motions(stand))


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
