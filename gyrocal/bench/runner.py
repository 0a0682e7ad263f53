"""The runner: takes the bench through a plan, waits for rate and temperature, records, seals."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, ChamberReading, GyroSamples, TableReading
from gyrocal.bench.plan import Plan, Step, ramp_time_s
from gyrocal.bench.profile import Profile
from gyrocal.bench.recorder import BenchRow, Recorder
from gyrocal.bench.safety import Interlocks, StopRequests, kept_safe
from gyrocal.errors import DeviceError, GyrocalError, InterruptedRunError, OutputError
from gyrocal.records.journal import RunWriter
from gyrocal.units import S_PER_MIN

_DEG_PER_TURN = 360.0
#: Long segments are written this often; the gyro's case, minutes behind the air, moves by less than 0.5 deg C meanwhile.
_SLOW_DRAIN_S = 10.0
#: Without a single sample for this long, or for this many sample intervals, the gyro is gone.
_SILENCE_S = 10.0
_SILENT_SAMPLES = 50.0
#: Between two looks while the table comes to rate, s.
_SETTLE_PERIOD_S = 0.5
_PROGRESS_PERIOD_S = 30.0


@dataclass(frozen=True)
class Progress:
    """Where a run is."""

    share: float
    left_s: float
    step: Step
    chamber_c: float
    gyro_c: float


class Watch(Protocol):
    """Who looks on: a progress bar, a log, nobody."""

    def progress(self, progress: Progress) -> None:
        """A step has begun, or goes on."""
        ...

    def say(self, text: str) -> None:
        """Something happened that the operator should know."""
        ...


@dataclass
class Summary:
    """What came of a run, this start and those before it. Entries are the steps in words."""

    recorded: int = 0
    unsettled: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    before: int = 0
    samples: int = 0
    bench_time_s: float = 0.0
    turns_ccw: float = 0.0
    turns_cw: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether every step was recorded, unsettled ones included."""
        return not self.failed and not self.skipped


class Runner:
    """One start of a run; `sealed` are the outcomes of the segments that earlier starts left, by id."""

    def __init__(
        self,
        bench: Bench,
        clock: Clock,
        profile: Profile,
        plan: Plan,
        writer: RunWriter,
        requests: StopRequests,
        watch: Watch,
        *,
        sealed: dict[int, str] | None = None,
        highest_id: int = 0,
    ) -> None:
        self._bench, self._clock, self._profile, self._plan = bench, clock, profile, plan
        self._writer, self._requests, self._watch = writer, requests, watch
        self._sealed = sealed or {}
        self._next_extra_id = max(highest_id, len(plan.steps)) + 1
        self._interlocks = Interlocks(profile, plan.limits)
        self.summary = Summary()
        # where the bench is
        self._rate_dps = 0.0
        self._ramped_to_c: float | None = None
        self._soaked_at_c: float | None = None
        self._soak_outcome = "ok"
        self._failed_at_c: float | None = None
        # what is being read
        self._rows: list[BenchRow] = []
        self._temps: deque[tuple[float, float]] = deque()
        self._gyro_temp_c = float("nan")
        self._last_sample_s = 0.0
        self._last_angle_deg = float("nan")
        # The slope of the gyro's temperature wants a handful of points.
        self._slow_drain_s = min(_SLOW_DRAIN_S, profile.soak.slope_over_s / 10.0)
        self._done_s = 0.0
        self._step_began_s = 0.0
        self._told_s = -np.inf

    # the run

    def run(self, opening: str, **details: Any) -> Summary:
        """Do every step that is not sealed yet; `opening` is the journal's first event of this start.

        Raises
        ------
        DeviceError, InterlockError, InterruptedRunError, OutputError, StopNotVerifiedError
            The run ended early; the table stands (or the error says that it may not).
        """
        began_s = self._clock.now_s()
        try:
            with kept_safe(self._bench, self._clock, self._profile, self._note):
                self._note(opening, **details)
                self._start_devices()
                for step in self._plan.steps:
                    self._visit(step)
                    self._done_s += step.expected_s
        except GyrocalError as error:
            self._note_if_possible("aborted", reason=str(error), error=type(error).__name__)
            raise
        finally:
            self.summary.bench_time_s = self._clock.now_s() - began_s
        s = self.summary
        self._note(
            "end",
            complete=s.complete,
            recorded=s.recorded,
            unsettled=s.unsettled,
            failed=s.failed,
            skipped=s.skipped,
        )
        return s

    def _start_devices(self) -> None:
        self._bench.table.start()
        self._bench.chamber.start()
        self._bench.gyro.start()
        self._bench.chamber.set_alarm_limits(*self._interlocks.gyro_range_c)
        self._last_sample_s = self._clock.now_s()
        self._look(_SETTLE_PERIOD_S)

    def _visit(self, step: Step) -> None:
        """Do one step of the plan, after what has to come before it."""
        if step.id in self._sealed:
            outcome = self._sealed[step.id]
            self.summary.before += 1
            self._count(step, outcome)
            return
        if self._requests.level >= 1:
            self._interrupt()
        if step.kind != "ramp" and self._failed_at_c != step.chamber_c:
            self._approach(step)
        if step.kind != "ramp" and self._failed_at_c == step.chamber_c:
            self.summary.skipped.append(step.describe())
            self._watch.say(f"skipped: {step.describe()} (the chamber or the gyro did not settle there)")
            return
        self._perform(step)

    def _approach(self, step: Step) -> None:
        """Bring the bench back to a step's temperature after a restart; recorded as segments of their own."""
        if step.kind == "soak":
            if self._ramped_to_c != step.chamber_c:
                self._perform(self._extra("ramp", step))
        elif self._soaked_at_c != step.chamber_c:
            self._perform(self._extra("ramp", step))
            if self._failed_at_c != step.chamber_c:
                self._perform(self._extra("soak", step))

    def _extra(self, kind: str, step: Step) -> Step:
        """A ramp or a soak that the plan does not have, with a number after the plan's last."""
        extra = Step(self._next_extra_id, kind, 0.0, step.chamber_c, step.chamber_c, 0.0, 0.0)
        self._next_extra_id += 1
        return extra

    def _perform(self, step: Step) -> None:
        self._step_began_s = self._clock.now_s()
        self._tell(step, now=True)
        settled = self._bring_to_rate(step)
        segment = self._writer.begin_segment(step.id, step.kind, step.rate_dps, step.chamber_c)
        recorder = Recorder(segment, self._profile.record.averaging_s if self._slow(step) else None)
        try:
            policy_fails = not settled and self._profile.settle.on_deadline == "fail"
            outcome = "failed" if policy_fails else self._record(step, recorder)
            if policy_fails:
                self._look(_SETTLE_PERIOD_S)
                recorder.add(self._drain(), self._take_rows())
            recorder.finish()
            outcome = "unsettled" if outcome == "ok" and not settled else outcome
            entry = segment.seal(
                t_start_s=recorder.first_t_s,
                t_end_s=recorder.last_t_s,
                n=recorder.n,
                averaging_s=self._profile.record.averaging_s if self._slow(step) else None,
                outcome=outcome,
            )
        finally:
            segment.abandon()
        self.summary.samples += int(entry["n"])
        self._remember(step, outcome)
        self._count(step, outcome)

    def _remember(self, step: Step, outcome: str) -> None:
        if step.kind == "ramp":
            self._ramped_to_c, self._soaked_at_c = step.chamber_c, None
        elif step.kind == "soak":
            self._soaked_at_c, self._soak_outcome = step.chamber_c, outcome
        if step.kind in ("ramp", "soak"):
            self._failed_at_c = step.chamber_c if outcome == "failed" else None

    def _count(self, step: Step, outcome: str) -> None:
        s = self.summary
        if outcome == "ok":
            s.recorded += 1
        else:
            (s.unsettled if outcome == "unsettled" else s.failed).append(step.describe())

    @staticmethod
    def _slow(step: Step) -> bool:
        return step.kind in ("ramp", "soak")

    # waits

    def _bring_to_rate(self, step: Step) -> bool:
        """Command the rate and wait until the measured one holds; the samples of the wait are counted, not kept."""
        spec = self._profile.settle
        began_s = self._clock.now_s()
        rate_dps = self._bench.table.set_rate(step.rate_dps)
        change_dps, self._rate_dps = abs(rate_dps - self._rate_dps), rate_dps
        spin_s = change_dps / self._plan.limits.max_acceleration_dps2.value
        deadline_s = began_s + spin_s + spec.deadline_s
        since_s: float | None = None
        lost = 0
        while True:
            table, _ = self._look(_SETTLE_PERIOD_S)
            lost += self._drain().t_s.size
            if not abs(table.rate_dps - rate_dps) <= spec.tolerance_dps:
                since_s = None
            elif since_s is None:
                since_s = table.t_s
            held = since_s is not None and table.t_s - since_s >= spec.hold_s
            if held or self._clock.now_s() >= deadline_s:
                break
        # The last reading opens the segment: rate by angle then covers all of it.
        self._rows = self._rows[-1:]
        self._writer.event(
            "at_rate" if held else "rate_deadline",
            self._clock.now_s(),
            durable=False,
            id=step.id,
            rate_dps=rate_dps,
            measured_dps=round(table.rate_dps, 6),
            t_start_s=round(began_s, 6),
            samples_not_kept=lost,
        )
        if not held:
            self._warn(step, f"the table reached {table.rate_dps:.4g} deg/s within {spec.deadline_s:g} s")
        return held

    def _record(self, step: Step, recorder: Recorder) -> str:
        """Record one segment; returns its outcome."""
        if step.kind == "ramp":
            return self._record_ramp(step, recorder)
        if step.kind == "soak":
            return self._record_soak(step, recorder)
        length_s = self._profile.plan.static_s if step.kind == "static" else self._profile.plan.dwell_s
        return self._record_dwell(step, recorder, length_s)

    def _record_ramp(self, step: Step, recorder: Recorder) -> str:
        spec = self._profile.ramp
        from_c = self._bench.chamber.read().temp_c
        self._bench.chamber.set_setpoint(step.chamber_c, spec.rate_c_per_min)
        latest_s = ramp_time_s(self._profile, step.chamber_c - from_c) + spec.deadline_s
        deadline_s = self._clock.now_s() + latest_s
        while True:
            chamber = self._record_slowly(step, recorder)
            if abs(chamber.temp_c - step.chamber_c) <= self._profile.soak.window_c:
                return "ok"
            if self._clock.now_s() >= deadline_s:
                why = f"the chamber was at {chamber.temp_c:.2f} °C after {latest_s / S_PER_MIN:.0f} min"
                return self._late(step, why, spec.on_deadline)

    def _record_soak(self, step: Step, recorder: Recorder) -> str:
        """Chamber in its window without a break for the soak time, and the gyro's own temperature flat."""
        spec = self._profile.soak
        self._bench.chamber.set_setpoint(step.chamber_c, self._profile.ramp.rate_c_per_min)
        deadline_s = self._clock.now_s() + spec.deadline_s
        since_s: float | None = None
        while True:
            chamber = self._record_slowly(step, recorder)
            if not abs(chamber.temp_c - step.chamber_c) <= spec.window_c:
                if since_s is not None:
                    self._note("excursion", id=step.id, chamber_c=round(chamber.temp_c, 3))
                since_s = None
            elif since_s is None:
                since_s = chamber.t_s
            slope = self._gyro_slope_c_per_min()
            soaked = since_s is not None and chamber.t_s - since_s >= spec.time_s
            blind = np.isnan(self._gyro_temp_c)  # a gyro without a thermometer has only the chamber's word
            if soaked and (blind or abs(slope) <= spec.slope_c_per_min):
                return "ok"
            if self._clock.now_s() >= deadline_s:
                why = (
                    f"after {spec.deadline_s / S_PER_MIN:.0f} min the chamber was at {chamber.temp_c:.2f} °C and the gyro "
                    f"still moved by {slope:.3g} °C/min"
                )
                return self._late(step, why, spec.on_deadline)

    def _record_slowly(self, step: Step, recorder: Recorder) -> ChamberReading:
        """Record for one slow drain; returns the chamber reading that was farthest off."""
        until_s = self._clock.now_s() + self._slow_drain_s
        return self._record_until(step, recorder, until_s)[2]

    def _record_until(
        self, step: Step, recorder: Recorder, until_s: float
    ) -> tuple[float, float, ChamberReading]:
        """Record up to a time; returns how far table and chamber were off at worst, and the worst chamber reading."""
        worst_dps, worst_c, worst = 0.0, -1.0, None
        while worst is None or until_s - self._clock.now_s() > 1e-9:
            period_s = min(self._profile.record.bench_period_s, max(until_s - self._clock.now_s(), 1e-3))
            table, chamber = self._look(period_s, abandon=step.kind != "rate")
            worst_dps = max(worst_dps, _finite_or_far(table.rate_dps - self._rate_dps))
            off_c = _finite_or_far(chamber.temp_c - step.chamber_c)
            if off_c >= worst_c:
                worst_c, worst = off_c, chamber
        recorder.add(self._drain(), self._take_rows())
        self._tell(step)
        return worst_dps, worst_c, worst

    def _record_dwell(self, step: Step, recorder: Recorder, length_s: float) -> str:
        """Record at one rate; a rate or a chamber that leaves its window makes the data set unsettled."""
        outcome = "ok" if self._soak_outcome == "ok" else "unsettled"
        end_s = self._clock.now_s() + length_s
        while end_s - self._clock.now_s() > 1e-9:
            until_s = min(end_s, self._clock.now_s() + self._slow_drain_s)
            off_dps, off_c, _ = self._record_until(step, recorder, until_s)
            disturbed = off_dps > self._profile.settle.tolerance_dps or off_c > self._profile.soak.window_c
            if disturbed and outcome == "ok":
                outcome = "unsettled"
                why = f"while recording, the table was up to {off_dps:.3g} deg/s and the chamber {off_c:.3g} °C off"
                self._warn(step, why)
        return outcome

    def _late(self, step: Step, why: str, policy: str) -> str:
        self._warn(step, why)
        return "failed" if policy == "fail" else "unsettled"

    # looking

    def _look(self, period_s: float, *, abandon: bool = False) -> tuple[TableReading, ChamberReading]:
        """Let a period pass, read the bench, heed the operator, check the interlocks.

        With `abandon` a first Ctrl-C ends at once too: what is being recorded lasts too long to be finished.
        """
        self._clock.sleep(period_s)
        table, chamber = self._bench.table.read(), self._bench.chamber.read()
        self._rows.append(
            BenchRow(table.t_s, table.rate_dps, table.angle_deg, chamber.temp_c, self._bench.supply.read_v())
        )
        turned = (table.angle_deg - self._last_angle_deg) / _DEG_PER_TURN
        self.summary.turns_ccw += max(turned, 0.0) if turned == turned else 0.0
        self.summary.turns_cw += max(-turned, 0.0) if turned == turned else 0.0
        self._last_angle_deg = table.angle_deg
        if self._requests.level >= (1 if abandon else 2):
            self._interrupt()
        self._interlocks.check(table, self._bench.table.faults(), chamber, self._gyro_temp_c)
        return table, chamber

    def _drain(self) -> GyroSamples:
        """Samples since the last drain; keeps the history of the gyro's temperature."""
        samples = self._bench.gyro.drain()
        now_s = self._clock.now_s()
        if samples.t_s.size:
            self._last_sample_s = now_s
            good = np.isfinite(samples.gyro_temp_c)
            if good.any():
                self._gyro_temp_c = float(np.mean(samples.gyro_temp_c[good]))
                self._temps.append((float(np.mean(samples.t_s[good])), self._gyro_temp_c))
        silence_s = max(_SILENCE_S, _SILENT_SAMPLES / self._profile.sensor.sample_rate_hz)
        if now_s - self._last_sample_s > silence_s:
            msg = f"The gyro has sent no sample for {silence_s:.0f} s (at {now_s:.0f} s). Check its supply and its cable, then --resume."
            raise DeviceError(msg)
        while self._temps and self._temps[0][0] < now_s - self._profile.soak.slope_over_s:
            self._temps.popleft()
        return samples

    def _gyro_slope_c_per_min(self) -> float:
        """Least-squares slope of the gyro's temperature over the profile's span; NaN until the span is nearly full."""
        if len(self._temps) < 3:
            return float("nan")
        t_s, temp_c = np.array(self._temps).T
        if t_s[-1] - t_s[0] < 0.8 * self._profile.soak.slope_over_s:
            return float("nan")
        centred = t_s - t_s.mean()
        return float(centred @ temp_c / (centred @ centred)) * S_PER_MIN

    def _take_rows(self) -> list[BenchRow]:
        rows, self._rows = self._rows, []
        return rows

    # telling

    def _interrupt(self) -> None:
        msg = f"Ended by {self._requests.reason}; what was sealed is kept, and --resume carries on."
        raise InterruptedRunError(msg)

    def _warn(self, step: Step, why: str) -> None:
        self._note("unsettled", id=step.id, reason=why)
        self._watch.say(f"unsettled: {step.describe()}: {why}")

    def _note(self, event: str, **details: Any) -> None:
        self._writer.event(event, self._clock.now_s(), **details)

    def _note_if_possible(self, event: str, **details: Any) -> None:
        """On the way out of an error a full disk must not hide that error."""
        try:
            self._note(event, **details)
        except OutputError as error:
            self._watch.say(str(error))

    def _tell(self, step: Step, *, now: bool = False) -> None:
        now_s = self._clock.now_s()
        if not now and now_s - self._told_s < _PROGRESS_PERIOD_S:
            return
        self._told_s = now_s
        within_s = min(now_s - self._step_began_s, step.expected_s)
        total_s = self._plan.expected_s or 1.0
        left_s = max(total_s - self._done_s - within_s, 0.0)
        last_c = self._rows[-1].chamber_temp_c if self._rows else float("nan")
        self._watch.progress(Progress(1.0 - left_s / total_s, left_s, step, last_c, self._gyro_temp_c))


def _finite_or_far(difference: float) -> float:
    """Size of a difference; a reading that is no number is infinitely far off."""
    return abs(difference) if np.isfinite(difference) else np.inf
