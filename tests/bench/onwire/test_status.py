"""`gyrocal status`: a run as it goes, after its end, after a crash; nothing in it is touched."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrocal.bench.status import Status, read_status
from gyrocal.cli import gyrocal_command
from gyrocal.errors import DeviceError, InputError
from gyrocal.records.journal import RunWriter, create_run
from tests.bench.tiny import Stand, tiny_profile


def start(stand: Stand) -> RunWriter:
    """A run directory with the whole profile in its head."""
    head = {"schema": "gyrocal-run/1", "sensor": {"model": "RD2100"}, "profile": tiny_profile().raw}
    return create_run(stand.out, head)


def run(stand: Stand) -> None:
    """Run it in a directory whose head holds the profile."""
    from gyrocal.bench.runner import Runner

    with start(stand) as writer:
        runner = Runner(
            stand.bench, stand.clock, stand.profile, stand.plan, writer, stand.requests, stand.watch
        )
        runner.run("start", steps=len(stand.plan.steps), expected_s=stand.plan.expected_s)


def files(out: Path) -> dict[str, tuple[bytes, int]]:
    """Contents and times of everything in a run directory."""
    return {str(p): (p.read_bytes(), p.stat().st_mtime_ns) for p in out.rglob("*") if p.is_file()}


def test_a_running_run(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    seen: list[Status] = []

    def look(call: str) -> None:
        if call == "gyro.drain" and stand.watch.seen and stand.watch.seen[-1].step.id == 5:
            before = files(stand.out)
            seen.append(read_status(stand.out))
            assert files(stand.out) == before

    stand.bench.gyro.before = look  # type: ignore[attr-defined]
    run(stand)
    status = seen[-1]
    assert status.state == "running"
    assert (status.steps, status.recorded, status.unsettled, status.failed) == (12, 4, 0, 0)
    left_s = sum(step.expected_s for step in stand.plan.steps[4:])
    assert status.left_s == pytest.approx(left_s, rel=0.02)
    assert status.now is not None
    assert status.now.startswith("0005_rate_")
    assert status.quiet_s < 60.0
    assert status.events[-1]["event"] == "at_rate"


def test_a_run_that_is_over(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    run(stand)
    status = read_status(tmp_path / "r")
    assert (status.state, status.recorded, status.left_s, status.now) == ("complete", 12, 0.0, None)
    assert status.chamber_c == pytest.approx(24.0, abs=0.6)
    assert status.gyro_c == pytest.approx(24.0, abs=0.6)
    result = CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r")])
    assert result.exit_code == 0
    assert f"{tmp_path / 'r'} is complete.\n12 segments sealed, 12 steps planned: 12 ok" in result.output
    report = json.loads(CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r"), "--json"]).output)
    assert report["state"] == "complete"
    assert report["events"][-1]["event"] == "end"


def test_a_run_that_was_ended(tmp_path: Path) -> None:
    def fail(call: str) -> None:
        if call == "table.read" and stand.watch.seen and stand.watch.seen[-1].step.id == 4 and left:
            left.pop()
            raise DeviceError("the cable fell out")

    left = [1, 2, 3]
    stand = Stand(tmp_path / "r", fail)
    with pytest.raises(DeviceError):
        run(stand)
    status = read_status(tmp_path / "r")
    assert (status.state, status.reason, status.retried) == ("stopped", "the cable fell out", 1)
    assert status.left_s > 0.0
    text = CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r")]).output
    assert "was ended early: the cable fell out; --resume carries on.\n" in text
    # What the table did last was to stop, whatever the segment that was left behind had recorded.
    assert abs(status.table_dps) < 0.02
    assert "\nThe table stands. The chamber is set to 22 °C.\nLast recorded: " in text
    assert "table 0.00 deg/s" in text


def test_a_chamber_that_could_not_be_made_safe_is_told(tmp_path: Path) -> None:
    def fail(call: str) -> None:
        if call.startswith("chamber") and stand.watch.seen and stand.watch.seen[-1].step.id == 4:
            raise DeviceError("the cable fell out")

    stand = Stand(tmp_path / "r", fail)
    with pytest.raises(DeviceError):
        run(stand)
    text = CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r")]).output
    assert (
        "The table stands. THE CHAMBER MAY NOT BE SAFE: it did not take its safe set point (the cable" in text
    )


def test_a_run_that_was_killed_as_a_segment_began_tells_what_was_sealed_before(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    with start(stand) as writer:
        writer.event("start", 0.0, steps=12, expected_s=100.0)
        whole = writer.begin_segment(1, "rate", 30.0, 20.0)
        whole.append("1.0,30.0,20.5,0,30.0,1.0,20.25,\n")
        whole.seal(t_start_s=1.0, t_end_s=1.0, n=1, averaging_s=None, outcome="ok")
        writer.begin_segment(2, "rate", -30.0, 20.0).abandon()
    status = read_status(tmp_path / "r")
    assert (status.chamber_c, status.gyro_c, status.table_dps) == (20.25, 20.5, 30.0)


def test_what_a_reason_says_is_not_said_twice(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    with start(stand) as writer:
        writer.event("start", 0.0, steps=12, expected_s=100.0)
        writer.event(
            "aborted", 1.0, reason="Ended by Ctrl-C; what was sealed is kept, and --resume carries on."
        )
    text = CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r")]).output
    assert "was ended early: Ended by Ctrl-C; what was sealed is kept, and --resume carries on.\n" in text


def test_a_run_that_died(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    with start(stand) as writer:
        writer.event("start", 0.0, steps=12, expected_s=100.0)
        writer.begin_segment(1, "ramp", 0.0, 20.0).abandon()
        running = read_status(tmp_path / "r").state
    with (tmp_path / "r" / "journal.jsonl").open("a") as f:
        f.write('{"event": "torn')
    status = read_status(tmp_path / "r")
    assert running == "running"
    assert status.state == "dead"
    assert status.now is None
    assert [e["event"] for e in status.events] == ["start"]
    text = CliRunner().invoke(gyrocal_command, ["status", str(tmp_path / "r")]).output
    assert "died without a word; make sure that the table stands, then carry on with --resume" in text


def test_a_run_of_another_logger(tmp_path: Path) -> None:
    out = tmp_path / "r"
    with create_run(out, {"schema": "gyrocal-run/1", "sensor": {"model": "X"}}) as writer:
        writer.event("note", 0.0)
    status = read_status(out)
    assert status.steps == 0
    assert status.left_s != status.left_s


@pytest.mark.parametrize("name", ["nothing", "empty"])
def test_no_run(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError):
        read_status(tmp_path / name)


def test_readings_come_from_the_end_of_a_long_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gyrocal.bench import status as module

    monkeypatch.setattr(module, "_TAIL_BYTES", 200)
    segment = tmp_path / "0001_rate.csv.part"
    rows = "".join(f"{i}.0,{i}.5,20.0,0,,,,\n" for i in range(1000))
    segment.write_text(
        "t_s,gyro_dps,gyro_temp_c,status,table_rate_dps,table_angle_deg,chamber_temp_c,supply_v\n"
    )
    with segment.open("a") as f:
        f.write(rows + "1000.0,,,,5.0,6.0,7.0,12.0\n1001.0,99")
    readings: dict[str, Any] = module._last_readings(segment)
    assert readings["gyro_dps"] == 999.5
    assert readings["chamber_temp_c"] == 7.0
    assert readings["t_s"] == 1000.0
