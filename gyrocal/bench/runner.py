"""The runner: takes the bench through a plan, waits for rate and temperature, records, seals."""

from __future__ import annotations

import contextlib
from dataclasses import asdict
from typing import Any

import numpy as np

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, ChamberReading, StreamHealth
from gyrocal.bench.gyros.stream import StreamTally, clumps, judge_stream
from gyrocal.bench.looking import Lookout
from gyrocal.bench.plan import Plan, Step, ramp_time_s
from gyrocal.bench.profile import Profile
from gyrocal.bench.recorder import Recorder
from gyrocal.bench.recovery import bring_back, start_devices
from gyrocal.bench.safety import Contact, Interlocks, StopRequests, kept_safe
from gyrocal.bench.watching import Progress, SteadyWatch, Summary, Watch
from gyrocal.errors import DeviceError, IncompleteError, OutputError
from gyrocal.records.journal import RunWriter, SegmentWriter
from gyrocal.units import S_PER_MIN, plural

#: Long segments are written this often; the gyro's case, minutes behind the air, moves by less than 0.5 deg C meanwhile.
_SLOW_DRAIN_S = 10.0
#: Between two looks while the table comes to rate, s.
_SETTLE_PERIOD_S = 0.5
_PROGRESS_PERIOD_S = 30.0


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
        self._writer, self._requests, self._watch = writer, requests, SteadyWatch(watch, self._note)
        self._sealed = sealed or {}
        self._planned = {step.id for step in plan.steps}
        self._next_extra_id = max(highest_id, len(plan.steps)) + 1
        self._contact = Contact()
        self._interlocks = Interlocks(profile, plan.limits)
        self._lookout = Lookout(bench, clock, profile, self._interlocks, requests)
        self._tally = StreamTally(profile.sensor.sample_rate_hz)
        #: Rates of the table in the segment at hand.
        self._turned_dps: list[float] = []
        self.summary = Summary(
            brought_back=len(self._sealed.keys() - self._planned),
            seed=profile.virtual.seed if bench.describe == "virtual" else None,
        )
        # where the bench is
        self._rate_dps = 0.0
        self._ramped_to_c: float | None = None
        self._soaked_at_c: float | None = None
        self._soak_outcome = "ok"
        self._failed_at_c: float | None = None
        # The slope of the gyro's temperature wants a handful of points.
        self._slow_drain_s = min(_SLOW_DRAIN_S, profile.soak.slope_over_s / 10.0)
        self._not_kept = self._jumps_told = 0
        self._why: str | None = None
        self._done_s = 0.0
        self._step_began_s = 0.0
        self._told_s = -np.inf
        self._acknowledged = False

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
            with kept_safe(
                self._bench, self._clock, self._profile, self._note, self._requests, self._contact
            ):
                self._note(opening, **details)
                self._start_devices()
                for step in self._plan.steps:
                    self._visit(step)
                    self._done_s += step.expected_s
        except Exception as error:
            with contextlib.suppress(OutputError):  # a full disk must not hide that error
                self._note("aborted", reason=str(error), error=type(error).__name__)
            s = self.summary
            self._watch.say(
                f"Until then {s.recorded} {plural(s.recorded, '[segment was|segments were]')} recorded, {len(s.unsettled)} unsettled, {len(s.failed)} failed, "
                f"{len(s.skipped)} skipped, and {len(s.retried)} {plural(len(s.retried), '[attempt|attempts]')} done again."
            )
            raise
        finally:
            s, seen = self.summary, self._lookout
            s.bench_time_s = self._clock.now_s() - began_s
            s.turns_ccw, s.turns_cw = seen.turns_ccw, seen.turns_cw
        self._note(
            "end",
            complete=s.complete,
            recorded=s.recorded,
            unsettled=s.unsettled,
            failed=s.failed,
            skipped=s.skipped,
            **({"retried": s.retried} if s.retried else {}),
        )
        return s

    def _start_devices(self) -> None:
        start_devices(self._bench, self._interlocks, self._contact)
        self._lookout.forget()
        table, chamber = self._lookout.look(_SETTLE_PERIOD_S)
        # Before anything moves the interlocks know the gyro's temperature too.
        self._not_kept = self._lookout.drain().t_s.size
        self._interlocks.check(table, (), chamber, self._lookout.gyro_temp_c)

    def _visit(self, step: Step) -> None:
        """Do one step of the plan, after what has to come before it; again by the profile's policy when it fails."""
        if step.id in self._sealed:
            outcome = self._sealed[step.id]
            self.summary.before += 1
            self._count(step, outcome)
            return
        self._requests.heed(1)
        policy = self._profile.retry
        for left in range(policy.attempts, -1, -1):
            try:
                if self._prepared(step) and self._perform(step, left):
                    return
            except DeviceError as error:
                self._failed(step, str(error), left)
                if left == 0 and policy.then == "stop":
                    raise
                bring_back(
                    self._bench, self._clock, self._profile, step, self._lookout, self._interlocks, error
                )
                self._rate_dps = 0.0
                if left == 0:
                    self._give_up(step, str(error))
                    return
                self._resettle(step)
            if self._failed_at_c == step.chamber_c and step.kind != "ramp":
                self._give_up(step, "the chamber or the gyro did not settle there")
                return

    def _prepared(self, step: Step) -> bool:
        """Whether the bench is at the step's temperature, or the step brings it there."""
        if step.kind != "ramp" and self._failed_at_c != step.chamber_c:
            self._approach(step)
        return step.kind == "ramp" or self._failed_at_c != step.chamber_c

    def _failed(self, step: Step, reason: str, left: int) -> None:
        """Say that an attempt failed, and how many samples are not kept with it."""
        with contextlib.suppress(DeviceError):  # the gyro may be what failed
            self._not_kept += self._lookout.drain().t_s.size
        lost, self._not_kept = self._not_kept + self._tally.n, 0
        self._note("attempt_failed", id=step.id, reason=reason, attempts_left=left, samples_not_kept=lost)
        self._watch.say(
            f"failed: {step.describe()}: {reason}"
            + (f" ({left} {plural(left, '[attempt|attempts]')} left)" if left else "")
        )
        if left:
            self.summary.retried.append(f"{step.describe()}: {reason}")

    def _give_up(self, step: Step, reason: str) -> None:
        """Skip a step; without its ramp or its soak the data sets at its temperature are skipped too."""
        self.summary.skipped.append(f"{step.describe()}: {reason}")
        self._note("skipped", id=step.id, reason=reason)
        self._watch.say(f"skipped: {step.describe()} ({reason})")
        if step.kind in ("ramp", "soak"):
            self._failed_at_c = step.chamber_c

    def _resettle(self, step: Step) -> None:
        """A chamber that left its window while a device was away is soaked again before a data set."""
        if step.kind in ("rate", "static"):
            off_c = abs(self._lookout.chamber_c - step.chamber_c)
            if not off_c <= self._profile.soak.window_c:
                self._soaked_at_c = None

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

    def _perform(self, step: Step, left: int = 0) -> bool:
        """Do a step and seal its segment; False when its stream was too bad and it is to be done again."""
        self._step_began_s, self._why = self._clock.now_s(), None
        # What lasts long is not worth its end to somebody who wants to go.
        self._requests.ends_at = 2 if step.kind == "rate" else 1
        self._tell(step, now=True)
        self._tally = StreamTally(self._profile.sensor.sample_rate_hz)
        self._turned_dps = []
        settled = self._bring_to_rate(step)
        segment = self._writer.begin_segment(step.id, step.kind, step.rate_dps, step.chamber_c)
        recorder = Recorder(segment, self._profile.record.averaging_s if self._slow(step) else None)
        before, began_s = self._bench.gyro.health(), self._clock.now_s()
        try:
            policy_fails = not settled and self._profile.settle.on_deadline == "fail"
            outcome = "failed" if policy_fails else self._record(step, recorder)
            if policy_fails:
                self._lookout.look(_SETTLE_PERIOD_S)
                self._take(recorder)
            recorder.finish()
            outcome = "unsettled" if outcome == "ok" and not settled else outcome
            verdict = None if outcome == "failed" else self._verdict(before, self._clock.now_s() - began_s)
            self._note_stream(step, before, told=verdict is not None)
            if verdict is not None and left and not self._slow(step):
                self._failed(step, verdict, left)
                return False
            if outcome == "ok" and verdict is None and step.kind == "rate":
                turned_dps = float(np.mean(self._turned_dps))
                self._interlocks.check_gyro_follows(self._clock.now_s(), turned_dps, self._tally.mean_dps())
            self._seal(step, segment, recorder, "failed" if verdict else outcome)
        finally:
            segment.abandon()
        self._remember(step, outcome)
        self._count(step, "failed" if verdict else outcome, verdict or self._why)
        if verdict is not None:
            self._note("bad_stream", id=step.id, reason=verdict)
            self._watch.say(f"failed: {step.describe()}: {verdict}")
            if self._profile.retry.then == "stop":
                raise IncompleteError(f"{step.describe()}: {verdict}. The run was ended by retry.then.")
        return True

    def _verdict(self, before: StreamHealth, duration_s: float) -> str | None:
        rate_hz, limits = self._profile.sensor.sample_rate_hz, self._profile.stream
        after = self._bench.gyro.health()
        return judge_stream(self._tally, before, after, rate_hz, limits, duration_s=duration_s)

    def _note_stream(self, step: Step, before: StreamHealth, *, told: bool) -> None:
        """Say what of a segment's stream was damaged, lost, late or called bad, also where it is too little to fail it."""
        seen = self._bench.gyro.health().since(before)
        late = clumps(self._tally, self._profile.stream)
        if late or seen.frames_bad or seen.sequence_gaps or seen.status_bad or seen.restarts:
            details = asdict(seen) | ({"clumps": late} if late else {})
            self._writer.event("stream", self._clock.now_s(), durable=False, id=step.id, **details)
        if late and not told:
            self._watch.say(f"late: {step.describe()}: {late}")

    def _seal(self, step: Step, segment: SegmentWriter, recorder: Recorder, outcome: str) -> None:
        entry = segment.seal(
            t_start_s=recorder.first_t_s,
            t_end_s=recorder.last_t_s,
            n=recorder.n,
            averaging_s=self._profile.record.averaging_s if self._slow(step) else None,
            outcome=outcome,
        )
        self.summary.samples += int(entry["n"])

    def _take(self, recorder: Recorder) -> None:
        """Hand what was sampled and read to the recorder."""
        samples = self._lookout.drain()
        self._tally.add(samples)
        recorder.add(samples, self._lookout.take_rows())

    def _remember(self, step: Step, outcome: str) -> None:
        if step.kind == "ramp":
            self._ramped_to_c, self._soaked_at_c = step.chamber_c, None
        elif step.kind == "soak":
            self._soaked_at_c, self._soak_outcome = step.chamber_c, outcome
        if step.kind in ("ramp", "soak"):
            self._failed_at_c = step.chamber_c if outcome == "failed" else None

    def _count(self, step: Step, outcome: str, reason: str | None = None) -> None:
        s = self.summary
        text = f"{step.describe()}: {reason}" if reason else step.describe()
        if step.id not in self._planned:
            s.brought_back += 1
        elif outcome == "ok":
            s.recorded += 1
        else:
            (s.unsettled if outcome == "unsettled" else s.failed).append(text)

    @staticmethod
    def _slow(step: Step) -> bool:
        return step.kind in ("ramp", "soak")

    # waits

    def _bring_to_rate(self, step: Step) -> bool:
        """Command the rate and wait until the measured one holds; the samples of the wait are counted, not kept."""
        spec = self._profile.settle
        began_s = self._clock.now_s()
        self._contact.table_moved = True
        rate_dps = self._bench.table.set_rate(step.rate_dps)
        change_dps, self._rate_dps = abs(rate_dps - self._rate_dps), rate_dps
        spin_s = change_dps / self._plan.limits.max_acceleration_dps2.value
        deadline_s = began_s + spin_s + spec.deadline_s
        since_s: float | None = None
        while True:
            table, _ = self._lookout.look(_SETTLE_PERIOD_S)
            self._not_kept += self._lookout.drain().t_s.size
            if not abs(table.rate_dps - rate_dps) <= spec.tolerance_dps:
                since_s = None
            elif since_s is None:
                since_s = table.t_s
            held = since_s is not None and table.t_s - since_s >= spec.hold_s
            if held or self._clock.now_s() >= deadline_s:
                break
        self._lookout.keep_last_row()
        self._writer.event(
            "at_rate" if held else "rate_deadline",
            self._clock.now_s(),
            durable=False,
            id=step.id,
            rate_dps=rate_dps,
            measured_dps=round(table.rate_dps, 6),
            t_start_s=round(began_s, 6),
            samples_not_kept=self._not_kept,
        )
        self._not_kept = 0
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
        self._lookout.begin_ramp(from_c)
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
            slope = self._lookout.gyro_slope_c_per_min()
            soaked = since_s is not None and chamber.t_s - since_s >= spec.time_s
            blind = np.isnan(
                self._lookout.gyro_temp_c
            )  # a gyro without a thermometer has only the chamber's word
            if soaked and (blind or abs(slope) <= spec.slope_c_per_min):
                if blind:
                    self._note("soaked_by_chamber", id=step.id, reason="the gyro sends no temperature")
                self._lookout.check_thermometer()
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
            table, chamber = self._lookout.look(period_s)
            self._acknowledge(step)
            self._turned_dps.append(table.rate_dps)
            worst_dps = max(worst_dps, _finite_or_far(table.rate_dps - self._rate_dps))
            off_c = _finite_or_far(chamber.temp_c - step.chamber_c)
            if off_c >= worst_c:
                worst_c, worst = off_c, chamber
        self._take(recorder)
        self._tell(step)
        return worst_dps, worst_c, worst

    def _record_dwell(self, step: Step, recorder: Recorder, length_s: float) -> str:
        """Record at one rate; a rate or a chamber that leaves its window makes the data set unsettled."""
        outcome = "ok" if self._soak_outcome == "ok" else "unsettled"
        self._why = self._why or (None if outcome == "ok" else "the soak was unsettled")
        end_s = self._clock.now_s() + length_s
        while end_s - self._clock.now_s() > 1e-9:
            until_s = min(end_s, self._clock.now_s() + self._slow_drain_s)
            off_dps, off_c, _ = self._record_until(step, recorder, until_s)
            disturbed = off_dps > self._profile.settle.tolerance_dps or off_c > self._profile.soak.window_c
            if disturbed and outcome == "ok":
                outcome = "unsettled"
                why = f"while recording, the table was up to {off_dps:.3g} deg/s and the chamber {off_c:.3g} °C off"
                self._warn(step, why)
        # Also where it jumped on the way here: the angles of this data set are not those of the ones before.
        if self._lookout.jumps != self._jumps_told:
            self._jumps_told = self._lookout.jumps
            outcome = "unsettled"
            self._warn(
                step, f"the table's angle jumped by {self._lookout.jumped_deg:.3g} deg: it lost its place"
            )
        return outcome

    def _late(self, step: Step, why: str, policy: str) -> str:
        self._warn(step, why)
        return "failed" if policy == "fail" else "unsettled"

    # telling

    def _acknowledge(self, step: Step) -> None:
        """Answer the first Ctrl-C at once: what it asks for may take a while."""
        if self._requests.level == 1 and not self._acknowledged:
            self._acknowledged = True
            self._watch.say(
                f"{self._requests.reason}: the run ends after {step.describe()}; once more ends it now."
            )

    def _warn(self, step: Step, why: str) -> None:
        self._why = why
        self._note("unsettled", id=step.id, reason=why)
        self._watch.say(f"unsettled: {step.describe()}: {why}")

    def _note(self, event: str, **details: Any) -> None:
        self._writer.event(event, self._clock.now_s(), **details)

    def _tell(self, step: Step, *, now: bool = False) -> None:
        now_s = self._clock.now_s()
        if not now and now_s - self._told_s < _PROGRESS_PERIOD_S:
            return
        self._told_s = now_s
        within_s = min(now_s - self._step_began_s, step.expected_s)
        total_s = self._plan.expected_s or 1.0
        left_s = max(total_s - self._done_s - within_s, 0.0)
        seen = self._lookout
        share = 1.0 - left_s / total_s
        self._watch.progress(Progress(share, left_s, step, seen.chamber_c, seen.gyro_temp_c))


def _finite_or_far(difference: float) -> float:
    """Size of a difference; a reading that is no number is infinitely far off."""
    return abs(difference) if np.isfinite(difference) else np.inf
