"""Waits for rate and temperature, deadlines, policies, interlocks, the operator: with devices that misbehave."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.bench.devices import ChamberReading, GyroSamples, TableReading
from gyrocal.bench.watching import Progress
from gyrocal.errors import DeviceError, GyrocalError, InterlockError, InterruptedRunError
from gyrocal.records.run import Run, read_run
from tests.bench.tiny import Stand


def outcomes(run: Run) -> dict[int, str]:
    """Outcome of each segment by id."""
    return {s.id: s.outcome for s in run.segments}


def events(out: Path, kind: str) -> list[dict[str, Any]]:
    """Journal lines of a kind."""
    lines = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    return [e for e in lines if e["event"] == kind]


def test_a_good_run_records_every_step(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r", plan__static_s=30.0, plan__static_at_c=[20.0])
    summary = stand.run()
    run = read_run(tmp_path / "r")
    assert summary.complete
    assert summary.recorded == len(stand.plan.steps) == len(run.segments) == 13
    for step, record in zip(stand.plan.steps, run.segments, strict=True):
        assert (record.id, record.kind, record.rate_dps, record.chamber_c) == (
            step.id,
            step.kind,
            step.rate_dps,
            step.chamber_c,
        )
        assert record.averaging_s == (1.0 if step.kind in ("ramp", "soak") else None)
    assert set(outcomes(run).values()) == {"ok"}
    times = [(r.t_start_s, r.t_end_s) for r in run.segments]
    assert all(a[1] <= b[0] for a, b in zip(times, times[1:], strict=False))  # noqa: RUF007


def test_a_data_set_holds_its_dwell_and_its_reference_covers_it(tmp_path: Path) -> None:
    Stand(tmp_path / "r").run()
    run = read_run(tmp_path / "r")
    for segment in run:
        if segment.record.kind != "rate":
            continue
        assert segment.record.n == segment.t_s.size == 30
        assert segment.bench_t_s[0] < segment.t_s[0]
        assert segment.bench_t_s[-1] == pytest.approx(segment.t_s[-1])
        turned = segment.table_angle_deg[-1] - segment.table_angle_deg[0]
        rate = turned / (segment.bench_t_s[-1] - segment.bench_t_s[0])
        assert rate == pytest.approx(segment.record.rate_dps, abs=2e-3)


def test_waiting_samples_are_counted_not_hidden(tmp_path: Path) -> None:
    Stand(tmp_path / "r").run()
    waits = events(tmp_path / "r", "at_rate")
    assert len(waits) == 12
    recorded = {e["id"]: e for e in events(tmp_path / "r", "segment")}
    for wait in waits:
        lost = round((recorded[wait["id"]]["t_start_s"] - wait["t_start_s"]) * 10)
        assert abs(wait["samples_not_kept"] - lost) <= 10  # the means of a ramp begin half a second late


def late_table(stand: Stand) -> Callable[[TableReading], TableReading]:
    """A table that never quite reaches 30 deg/s."""
    return lambda r: replace(r, rate_dps=r.rate_dps * 0.99)


def test_a_table_that_never_arrives_is_unsettled_but_recorded(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    stand.table.falsify = late_table(stand)
    summary = stand.run()
    assert summary.complete
    assert len(summary.unsettled) == 4
    assert all("deg/s within 10 s" in text or "while recording" in text for text in summary.unsettled)
    run = read_run(tmp_path / "r")
    assert [r.n for r in run.segments if r.outcome == "unsettled"] == [30] * 4
    assert "the table reached 29.7 deg/s within 10 s" in stand.watch.said[0] or "-29.7" in stand.watch.said[0]
    # the wait ends at spin-up plus deadline, to the period of the looks
    wait = events(tmp_path / "r", "rate_deadline")[0]
    assert wait["t_s"] - wait["t_start_s"] == pytest.approx(10.6, abs=0.5)


def test_a_table_that_never_arrives_fails_by_policy(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r", settle__on_deadline="fail")
    stand.table.falsify = late_table(stand)
    summary = stand.run()
    assert not summary.complete
    assert len(summary.failed) == 4
    run = read_run(tmp_path / "r")
    failed = [r for r in run.segments if r.outcome == "failed"]
    assert [r.kind for r in failed] == ["rate"] * 4
    # what was seen of it is kept
    assert all(run.segment(r).bench_t_s.size > 0 for r in failed)


def test_a_table_that_drops_out_while_recording_is_unsettled(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    seen: list[float] = []

    def stumble(reading: TableReading) -> TableReading:
        turning = abs(reading.rate_dps) > 29.99
        seen.extend([reading.t_s] if turning else [])
        return replace(reading, rate_dps=29.0) if turning and len(seen) == 5 else reading

    stand.table.falsify = stumble
    summary = stand.run()
    assert len(summary.unsettled) == 1
    assert "while recording, the table was up to" in stand.watch.said[0]


def chamber_off(stand: Stand, offset_c: Callable[[float], float]) -> None:
    """Let the chamber's reading be off by a function of time."""

    def falsify(reading: ChamberReading) -> ChamberReading:
        return replace(reading, temp_c=reading.temp_c + offset_c(reading.t_s))

    stand.chamber.falsify = falsify


def soak_times(out: Path) -> list[float]:
    """Length of each soak."""
    return [r.t_end_s - r.t_start_s for r in read_run(out).segments if r.kind == "soak"]


def test_an_excursion_restarts_the_soak(tmp_path: Path) -> None:
    plain = Stand(tmp_path / "plain")
    plain.run()
    soak = next(r for r in read_run(tmp_path / "plain").segments if r.kind == "soak")
    out_s = soak.t_start_s + 18.0
    stand = Stand(tmp_path / "r")
    chamber_off(stand, lambda t_s: 1.0 if abs(t_s - out_s) < 1.0 else 0.0)
    summary = stand.run()
    assert summary.complete
    assert summary.unsettled == []
    assert len(events(tmp_path / "r", "excursion")) == 1
    # 18 s in vain, then all 20 s again
    assert soak_times(tmp_path / "plain")[0] < 35.0
    assert soak_times(tmp_path / "r")[0] >= 18.0 + 20.0


def test_overshoot_does_not_count_as_soaked(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    chamber_off(stand, lambda t_s: 3.0 * np.exp(-t_s / 40.0) * np.sin(t_s / 8.0))
    summary = stand.run()
    assert summary.complete
    run = read_run(tmp_path / "r")
    segment = run.segment(next(r for r in run.segments if r.kind == "soak"))
    last = segment.chamber_temp_c[segment.bench_t_s >= segment.bench_t_s[-1] - 20.0]
    assert np.all(np.abs(last - 20.0) <= 0.5)


def test_the_gyros_own_slope_prolongs_the_soak(tmp_path: Path) -> None:
    strict = Stand(
        tmp_path / "r",
        soak__slope_c_per_min=0.05,
        soak__deadline_s=400.0,
        virtual__chamber={"air_s": 2.0, "case_s": 30.0, "ripple_c": 0.0},
    )
    summary = strict.run()
    assert summary.unsettled == []
    run = read_run(tmp_path / "r")
    for record in (r for r in run.segments if r.kind == "soak"):
        s = run.segment(record)
        last = s.t_s >= s.t_s[-1] - 20.0
        slope = np.polyfit(s.t_s[last], s.gyro_temp_c[last], 1)[0] * 60.0
        assert abs(slope) < 0.1
    assert max(soak_times(tmp_path / "r")) > 60.0


def never(stand: Stand) -> None:
    """The chamber never gets nearer than 2 degC to 24 degC."""
    stand.chamber.falsify = lambda r: replace(r, temp_c=min(r.temp_c, 22.0))


def test_a_chamber_that_never_arrives_marks_all_that_follows(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    never(stand)
    summary = stand.run()
    assert summary.complete
    assert summary.recorded == 6
    assert len(summary.unsettled) == 6
    assert summary.unsettled[-1] == "rate at +0 deg/s, 24 °C: the soak was unsettled"
    marked = {i for i, o in outcomes(read_run(tmp_path / "r")).items() if o == "unsettled"}
    assert marked == {7, 8, 9, 10, 11, 12}
    reasons = [e["reason"] for e in events(tmp_path / "r", "unsettled")]
    assert reasons[0].startswith("the chamber was at 22.00 °C after ")
    assert "the gyro still moved by" in reasons[1]
    # waits last their deadlines: 48 s of ramp and 60 s of grace, then 120 s
    lengths = [r.t_end_s - r.t_start_s for r in read_run(tmp_path / "r").segments if r.id in (7, 8)]
    assert 60.0 < lengths[0] < 125.0
    assert lengths[1] == pytest.approx(120.0, abs=12.0)


def test_a_chamber_that_never_arrives_fails_by_policy_and_skips_its_data_sets(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r", ramp__on_deadline="fail")
    never(stand)
    summary = stand.run()
    assert not summary.complete
    assert summary.failed == ["ramp 20 to 24 °C: the chamber was at 22.00 °C after 2 min"]
    assert len(summary.skipped) == 5
    assert events(tmp_path / "r", "end")[0]["complete"] is False


def test_a_soak_that_fails_by_policy_skips_its_data_sets(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r", soak__on_deadline="fail")
    never(stand)
    summary = stand.run()
    (failed,) = summary.failed
    assert failed.startswith("soak, 24 °C: after 2 min the chamber was at 22.00 °C")
    assert len(summary.skipped) == 4


class Mute:
    """A gyro whose samples can be changed."""

    def __init__(self, inner: Any, change: Callable[[GyroSamples], GyroSamples]) -> None:
        self.inner, self.change = inner, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def drain(self) -> GyroSamples:
        """Changed samples."""
        return self.change(self.inner.drain())


def with_gyro(stand: Stand, change: Callable[[GyroSamples], GyroSamples]) -> None:
    """Put a changed gyro in."""
    stand.bench = replace(stand.bench, gyro=Mute(stand.bench.gyro, change))


def test_a_silent_gyro_ends_the_run(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    with_gyro(stand, lambda s: s if s.t_s.size and s.t_s[-1] < 30.0 else GyroSamples())
    with pytest.raises(
        DeviceError, match=r"^The gyro has sent no sample for 10 s \(at \d+ s\)\. Check its supply"
    ):
        stand.run()
    assert events(tmp_path / "r", "make_safe")[0]["table_stopped"] is True
    assert events(tmp_path / "r", "aborted")[0]["error"] == "DeviceError"


def test_a_gyro_without_thermometer_soaks_by_the_chamber(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    with_gyro(stand, lambda s: replace(s, gyro_temp_c=np.full(s.t_s.size, np.nan)))
    assert stand.run().unsettled == []
    assert [e["id"] for e in events(tmp_path / "r", "soaked_by_chamber")] == [2, 8]


def test_a_thermometer_that_dies_is_not_taken_for_a_flat_one(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    nan_after = lambda s: replace(s, gyro_temp_c=np.where(s.t_s < 25.0, s.gyro_temp_c, np.nan))  # noqa: E731
    with_gyro(stand, nan_after)
    summary = stand.run()
    assert any(text.startswith("soak, 24 °C: after ") for text in summary.unsettled)


INTERLOCKS: list[tuple[str, Callable[[Stand], None], str]] = [
    ("fault", lambda s: setattr(s.table, "fault", ("encoder lost",)), "the table reports encoder lost"),
    (
        "over-rate",
        lambda s: setattr(s.table, "falsify", lambda r: replace(r, rate_dps=r.rate_dps + (300 if r.t_s > 80 else 0))),
        "the table turns at",
    ),
    (
        "alarm",
        lambda s: setattr(s.chamber, "falsify", lambda r: replace(r, alarms=("door open",) if r.t_s > 60 else ())),
        "the chamber reports door open",
    ),
    (
        "stopped",
        lambda s: setattr(s.chamber, "falsify", lambda r: replace(r, running=r.t_s < 60)),
        "the chamber is not running",
    ),
    (
        "hot",
        lambda s: with_gyro(s, lambda x: replace(x, gyro_temp_c=x.gyro_temp_c + 70.0 * (x.t_s > 60.0))),
        "outside -45 to 80 °C",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "spoil", "sentence"), INTERLOCKS, ids=[i[0] for i in INTERLOCKS])
def test_interlocks_end_the_run_and_make_safe(
    tmp_path: Path, name: str, spoil: Callable[[Stand], None], sentence: str
) -> None:
    stand = Stand(tmp_path / "r")
    spoil(stand)
    with pytest.raises(GyrocalError) as caught:
        stand.run()
    # a reading that shows 300 deg/s for ever also keeps the stop from being confirmed
    trip = caught.value.__context__ if name == "over-rate" else caught.value
    assert isinstance(trip, InterlockError)
    assert sentence in str(trip)
    assert str(trip).endswith(". Find the cause, then --resume.")
    assert stand.table.motions[-1] == "stop"
    assert stand.chamber.setpoints[-1] == 22.0


def without_thermometer(stand: Stand) -> None:
    with_gyro(stand, lambda x: replace(x, gyro_temp_c=np.full(x.t_s.size, np.nan)))


RUNAWAYS: dict[str, tuple[dict[str, Any], Callable[[ChamberReading], ChamberReading], str]] = {
    "air, by the sensor's range": (
        {},
        lambda r: replace(r, temp_c=r.temp_c + max(r.t_s - 60.0, 0.0)),
        "the chamber's air is at 80.",
    ),
    "air, by the user's limit": (
        {"limits__max_temp_c": 30.0},
        lambda r: replace(r, temp_c=r.temp_c + max(r.t_s - 60.0, 0.0)),
        "outside -45 to 35 °C",
    ),
    "plate": (
        {},
        lambda r: replace(r, plate_c=r.temp_c - max(r.t_s - 60.0, 0.0)),
        "the plate under the gyro is at -45.",
    ),
    "nothing is known": ({}, lambda r: replace(r, temp_c=np.nan), "neither gyro nor chamber says how warm"),
}


@pytest.mark.parametrize("name", RUNAWAYS)
def test_without_a_thermometer_in_the_gyro_air_and_plate_count(tmp_path: Path, name: str) -> None:
    changes, lie, sentence = RUNAWAYS[name]
    changes = {"soak__deadline_s": 21.0, "ramp__deadline_s": 200.0, "plan__dwell_s": 60.0, **changes}
    stand = Stand(tmp_path / "r", **changes)
    without_thermometer(stand)
    stand.chamber.falsify = lie
    with pytest.raises(InterlockError) as caught:
        stand.run()
    assert sentence in str(caught.value)
    assert stand.table.motions[-1] == "stop"
    assert stand.chamber.setpoints[-1] == 22.0


@pytest.mark.parametrize(
    ("says", "sentence"),
    [
        (lambda dps: 0.01 * dps, r"turned at -30 deg/s and the gyro said -0\.29.*: its mode \(increments"),
        (lambda dps: -dps, r"turned at -30 deg/s and the gyro said 29\.6.*its sign"),
    ],
)
def test_a_gyro_that_does_not_say_what_the_table_does_ends_the_run_at_its_first_data_set(
    tmp_path: Path, says: Callable[[Any], Any], sentence: str
) -> None:
    stand = Stand(tmp_path / "r")
    with_gyro(stand, lambda x: replace(x, gyro_dps=says(x.gyro_dps)))
    with pytest.raises(InterlockError, match=sentence):
        stand.run()
    assert [r.rate_dps for r in read_run(tmp_path / "r").segments if r.kind == "rate"] == [0.0]
    free = Stand(tmp_path / "free", safe__follow_share=0.0)
    with_gyro(free, lambda x: replace(x, gyro_dps=says(x.gyro_dps)))
    assert free.run().complete


def test_a_viewer_that_goes_ends_nothing_and_the_journal_says_so(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    told = []

    def gone(progress: Progress) -> None:
        told.append(progress)
        if len(told) > 3:
            raise BrokenPipeError(32, "Broken pipe")

    stand.watch.progress = gone  # type: ignore[method-assign]
    assert stand.run().complete
    assert len(told) == 4
    (line,) = events(tmp_path / "r", "viewer_gone")
    assert "Broken pipe" in line["reason"]
    assert events(tmp_path / "r", "end")[0]["complete"] is True


def test_a_viewer_that_takes_no_word_keeps_nobody_waiting(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    released, told = threading.Event(), threading.Event()

    def held(
        progress: Progress,
    ) -> None:  # as a terminal after Ctrl-S, or at the end of a connection that hangs
        assert released.wait(10.0)

    stand.watch.progress = held  # type: ignore[method-assign]
    stand.watch.say = lambda text: told.set()  # type: ignore[method-assign]
    stand.table.falsify = lambda reading: replace(reading, rate_dps=0.9 * reading.rate_dps)
    began_s = time.monotonic()
    stand.run()
    assert time.monotonic() - began_s < 5.0
    assert len(events(tmp_path / "r", "viewer_stalled")) == 1
    assert not told.is_set()
    released.set()
    assert told.wait(10.0)


def test_one_ctrl_c_finishes_the_data_set_at_hand(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")

    def ask(reading: TableReading) -> TableReading:
        if abs(reading.rate_dps) > 29.0:
            stand.requests.ask(1, "Ctrl-C")
        return reading

    stand.table.falsify = ask
    with pytest.raises(InterruptedRunError) as caught:
        stand.run()
    assert str(caught.value) == "Ended by Ctrl-C; what was sealed is kept, and --resume carries on."
    assert stand.watch.said == [
        "Ctrl-C: the run ends after rate at -30 deg/s, 20 °C; once more ends it now.",
        "Until then 4 segments were recorded, 0 unsettled, 0 failed, 0 skipped, and 0 attempts done again.",
    ]
    run = read_run(tmp_path / "r")
    assert [r.id for r in run.segments] == [1, 2, 3, 4]
    assert run.segments[-1].n == 30
    assert not list((tmp_path / "r" / "data").glob("*.part"))


@pytest.mark.parametrize(("level", "when_kind"), [(1, "soak"), (2, "rate"), (1, "ramp")])
def test_what_lasts_long_ends_at_once(tmp_path: Path, level: int, when_kind: str) -> None:
    stand = Stand(tmp_path / "r")

    def ask(reading: ChamberReading) -> ChamberReading:
        now = {p.step.kind for p in stand.watch.seen[-1:]}
        if now == {when_kind} and reading.t_s > 10.0:
            stand.requests.ask(level, "Ctrl-C")
        return reading

    stand.chamber.falsify = ask
    with pytest.raises(InterruptedRunError):
        stand.run()
    part = list((tmp_path / "r" / "data").glob("*.part"))
    assert len(part) <= 1
    assert when_kind not in {r.kind for r in read_run(tmp_path / "r").segments}


def test_progress_counts_down(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    stand.run()
    shares = [p.share for p in stand.watch.seen]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert stand.watch.seen[0].left_s == pytest.approx(stand.plan.expected_s)
    assert stand.watch.seen[-1].left_s <= stand.plan.steps[-1].expected_s + 1e-9


def test_turns_are_counted_in_each_direction(tmp_path: Path) -> None:
    stand = Stand(tmp_path / "r")
    summary = stand.run()
    assert (summary.turns_ccw, summary.turns_cw) == pytest.approx(stand.plan.turns, rel=0.3)
    assert summary.turns_ccw > 0.5
