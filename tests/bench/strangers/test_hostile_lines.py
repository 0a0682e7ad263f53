"""Lines that are late, talk by themselves or belong to another device, and tables that do not obey."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from tests.bench.strangers.gyros import Dsp3000
from tests.bench.strangers.runs import (
    Bench,
    Outcome,
    acquire,
    bench,
    differences,
    finish,
    journal,
    profile,
    start,
    until,
)
from tests.bench.strangers.tables import TABLES, Acutrol

#: In real time, minutes in all: deadlines are missed where other tests take the cores.
pytestmark = pytest.mark.slow

#: A signal is served within this, whatever a line does; the rest is what a loaded machine takes.
SERVED_S = 0.5 + 1.0


def turning(b: Bench) -> bool:
    """The table is at its first rate."""
    return abs(b.lab.table.rate_dps) > 39.0


def said_to_stand(outcome: Outcome) -> bool:
    """Whether the journal claims that the table stands."""
    return any(e.get("table_stopped") is True for e in journal(outcome.run))


def stops_after(b: Bench, t_s: float) -> list[float]:
    """Times of the commands after `t_s` that end the motion."""
    words = ("stop", "STO", "Mode:Off", "Interlock:Open", "JOG0", "vel 0", "Rate 1,0")
    return [t for t, text in b.lab.commands if t >= t_s and any(word in text for word in words)]


#: Time that an answer takes beside the usual, from and to, s.
LATE_S = (0.6, 0.9)


@pytest.mark.parametrize("late_s", [(0.0, 0.0), LATE_S], ids=["prompt", "late"])
@pytest.mark.parametrize("table", TABLES)
def test_a_table_that_ignores_stops_is_never_called_standing(
    tmp_path: Path, table: str, late_s: tuple[float, float]
) -> None:
    with bench("vn100", table, "espec") as b:
        process, run = start(tmp_path, profile(b, dwell_s=30.0, rests=False))
        until(lambda: turning(b))
        b.table.line.faults.late_s = late_s
        b.table.line.faults.ignores_stop = True
        process.send_signal(signal.SIGTERM)
        outcome = finish(process, run, within_s=90.0)
        assert turning(b)
        assert outcome.code == 11
        assert not said_to_stand(outcome)


@pytest.mark.parametrize("table", TABLES)
def test_a_table_with_late_answers_is_stopped_and_seen_to_stand(tmp_path: Path, table: str) -> None:
    with bench("vn100", table, "espec") as b:
        process, run = start(tmp_path, profile(b, dwell_s=30.0, rests=False))
        until(lambda: turning(b))
        b.table.line.faults.late_s = LATE_S
        asked_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        outcome = finish(process, run, within_s=90.0)
        assert not b.lab.table.moving
        assert outcome.code == 130
        # The answer that was waited for when the signal came may take its time first.
        assert stops_after(b, asked_s)[0] - asked_s < SERVED_S + LATE_S[1]


@pytest.mark.parametrize("which", ["gyro", "chamber", "table"])
def test_a_line_that_talks_all_the_time_keeps_no_signal_waiting(tmp_path: Path, which: str) -> None:
    with bench("ascii-line", "json-lines", "espec") as b:
        process, run = start(tmp_path, profile(b, dwell_s=30.0, rests=False))
        until(lambda: turning(b))
        line = {"gyro": b.gyro.line, "chamber": b.chamber.line, "table": b.table.line}[which]
        line.faults.babble = b"\x55\xaa"
        b.lab.after(0.0, line.babble)
        time.sleep(1.0)
        asked_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        outcome = finish(process, run, within_s=60.0)
        ended = stops_after(b, 0.0)
        assert ended, "nobody stopped the table"
        assert ended[0] - asked_s < SERVED_S
        assert not b.lab.table.moving
        assert outcome.code not in (0, 1)


@pytest.mark.parametrize(
    ("gyro", "table"),
    [
        ("kvh-frame-a", "zaber"),
        ("kvh-dsp3000", "aerosmith"),
        ("vn100", "acutrol"),
        ("ascii-line", "json-lines"),
    ],
)
def test_swapped_ports_are_told_and_nothing_moves(tmp_path: Path, gyro: str, table: str) -> None:
    with bench(gyro, table, "espec") as b:
        ports = {"gyro": b.table.line.url, "table": b.gyro.line.url}
        outcome = acquire(tmp_path, profile(b, ports=ports), within_s=60.0)
        assert outcome.code == 9, outcome.said
        assert not [text for _, text in b.lab.commands if "TEMP" not in text]


@pytest.mark.parametrize("table", TABLES)
def test_a_table_port_that_is_not_there_is_no_emergency(tmp_path: Path, table: str) -> None:
    with bench("vn100", table, "espec") as b:
        outcome = acquire(tmp_path, profile(b, ports={"table": "/dev/ttyNOBODY"}), within_s=60.0)
        assert outcome.code == 9, outcome.said
        assert "/dev/ttyNOBODY" in outcome.said


@pytest.mark.parametrize(
    ("fault", "warning"), [("knob", "NC"), ("interrupted", "NI")], ids=["knob", "interrupted"]
)
def test_a_table_that_somebody_else_moves_ends_the_run(tmp_path: Path, fault: str, warning: str) -> None:
    with bench("vn100", "zaber", "espec") as b:
        process, run = start(tmp_path, profile(b, dwell_s=30.0, rests=False))
        until(lambda: turning(b))
        time.sleep(1.0)
        setattr(b.table, fault, True)
        outcome = finish(process, run)
        assert outcome.code == 10
        assert warning in outcome.said
        assert not b.lab.table.moving


def test_a_latched_interlock_of_the_table_is_left_to_a_person(tmp_path: Path) -> None:
    with bench("vn100", "acutrol", "espec") as b:
        assert isinstance(b.table, Acutrol)
        b.table.latched = True
        outcome = acquire(tmp_path, profile(b), within_s=60.0)
        assert outcome.code in (9, 10)
        assert b.table.latched
        assert not [text for _, text in b.lab.commands if "Demand" in text]


def test_a_dsp3000_that_was_left_in_another_mode_is_not_recorded_as_rates(tmp_path: Path) -> None:
    with bench("kvh-dsp3000", "json-lines", "espec") as b:
        assert isinstance(b.gyro, Dsp3000)
        b.gyro.mode = "A"
        outcome = acquire(tmp_path, profile(b, temperatures="[24.0]", rates="[40.0]"))
        assert differences(b, outcome) == []
        assert b.gyro.mode == "R"


@pytest.mark.parametrize("gyro", ["kvh-dsp3000", "vn100"])
def test_air_that_runs_away_ends_the_run(tmp_path: Path, gyro: str) -> None:
    with bench(gyro, "json-lines", "espec") as b:
        process, run = start(tmp_path, profile(b, dwell_s=60.0, rests=False))
        until(lambda: turning(b))
        b.lab.chamber.ambient_c, b.lab.chamber.running, b.lab.chamber.ambient_lag_s = 190.0, False, 5.0
        outcome = finish(process, run)
        assert outcome.code == 10
        # 75 deg C is the gyro's limit; it rises by 3 deg C a second.
        assert b.lab.true(stops_after(b, 0.0)[0]).air_c < 85.0
        assert not b.lab.table.moving


def test_the_chambers_own_alarms_are_set(tmp_path: Path) -> None:
    with bench("vn100", "json-lines", "espec") as b:
        process, run = start(tmp_path, profile(b, rests=False))
        until(lambda: turning(b))
        high_c = b.chamber.high_c  # type: ignore[attr-defined]
        process.send_signal(signal.SIGTERM)
        finish(process, run)
        # The gyro's own limit, and a little for the chamber's swing.
        assert high_c <= 85.0


def test_a_run_outlives_its_viewer(tmp_path: Path) -> None:
    with bench("vn100", "json-lines", "espec") as b:
        process, run = start(tmp_path, profile(b, temperatures="[24.0]", rates="[40.0]"))
        until(lambda: turning(b))
        assert process.stdout is not None
        process.stdout.close()
        process.wait(90.0)
        recorded = [e for e in journal(run) if e["event"] == "segment"]
        assert process.returncode == 0
        assert len([e for e in recorded if e["kind"] == "rate"]) == 4
        assert not b.lab.table.moving


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_stops_the_table(tmp_path: Path, number: signal.Signals) -> None:
    with bench("vn100", "acutrol", "weiss") as b:
        process, run = start(tmp_path, profile(b, dwell_s=30.0, rests=False))
        until(lambda: turning(b))
        asked_s = time.monotonic()
        process.send_signal(number)
        outcome = finish(process, run)
        assert outcome.code == 130
        assert stops_after(b, asked_s)[0] - asked_s < SERVED_S
        assert not b.lab.table.moving
