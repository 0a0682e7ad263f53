"""Looking at the bench while it runs: readings, samples, interlocks, the operator's wishes, the gyro's temperature."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from gyrocal.bench.clock import Clock
from gyrocal.bench.devices import Bench, ChamberReading, GyroSamples, TableReading
from gyrocal.bench.profile import Profile
from gyrocal.bench.recorder import BenchRow
from gyrocal.bench.safety import Interlocks, StopRequests
from gyrocal.errors import DeviceError
from gyrocal.units import S_PER_MIN

T = TypeVar("T")

_DEG_PER_TURN = 360.0
#: Without a single sample for this long, or for this many sample intervals, the gyro is gone.
_SILENCE_S = 10.0
_SILENT_SAMPLES = 50.0
#: An angle that differs by more, and by more than this share of the way, from what the rate leads to, has jumped.
_JUMP_DEG = 5.0
_JUMP_SHARE = 0.05
#: A slope of the gyro's temperature wants so many points, over this share of the profile's span.
_FEWEST_TEMPS, _SPAN_SHARE = 3, 0.8
#: A question is asked so often before its device counts as failed: one damaged answer is no reason to lose a segment.
_ASKED = 3


class Lookout:
    """What is read off the bench between two commands, and what is known from it."""

    def __init__(
        self, bench: Bench, clock: Clock, profile: Profile, interlocks: Interlocks, requests: StopRequests
    ) -> None:
        self._bench, self._clock, self._profile = bench, clock, profile
        self._interlocks, self.requests = interlocks, requests
        self._rows: list[BenchRow] = []
        self._temps: deque[tuple[float, float]] = deque()
        self._slope_span_s = _SPAN_SHARE * profile.soak.slope_over_s
        self._last_sample_s = clock.now_s()
        self._last: TableReading | None = None
        self._wraps = 0
        # the chamber at the beginning of the ramp, and the gyro's extremes since then
        self._ramp_from_c = self._low_c = self._high_c = float("nan")
        self.gyro_temp_c = float("nan")
        self.chamber_c = float("nan")
        self.turns_ccw = self.turns_cw = 0.0
        #: How often, and by how much at last, the angle went where the rate does not lead.
        self.jumps = 0
        self.jumped_deg = 0.0

    def forget(self) -> None:
        """The gyro was started (again): its silence counts from now, and the angle may have been lost."""
        self._last_sample_s = self._clock.now_s()
        self._last = None

    def look(self, period_s: float) -> tuple[TableReading, ChamberReading]:
        """Let a period pass, read the bench, attend to requests, check the interlocks.

        Raises
        ------
        DeviceError, InterlockError, InterruptedRunError
        """
        self._clock.sleep(period_s)
        table = self._unwrapped(self._ask(self._bench.table.read))
        chamber = self._ask(self._bench.chamber.read)
        supply_v = self._bench.supply.read_v()
        self._rows.append(BenchRow(table.t_s, table.rate_dps, table.angle_deg, chamber.temp_c, supply_v))
        self.chamber_c = chamber.temp_c
        self.requests.attend()
        self._interlocks.check(table, self._ask(self._bench.table.faults), chamber, self.gyro_temp_c)
        return table, chamber

    def _unwrapped(self, table: TableReading) -> TableReading:
        """The reading with its angle unwrapped; counts turns, and jumps of an encoder that lost its place."""
        last = self._last
        table = replace(table, angle_deg=table.angle_deg - _DEG_PER_TURN * self._wraps)
        if last is not None and np.isfinite(table.angle_deg - last.angle_deg):
            since_s = table.t_s - last.t_s
            led_deg = 0.5 * (last.rate_dps + table.rate_dps) * since_s
            # Between two rates the table may have changed at once after the one reading, or just before the other.
            changed_deg = 0.5 * abs(table.rate_dps - last.rate_dps) * since_s
            slip_deg = table.angle_deg - last.angle_deg - led_deg
            unsure_deg = max(abs(last.rate_dps), abs(table.rate_dps)) * (last.unsure_s + table.unsure_s)
            near_deg = _JUMP_DEG + _JUMP_SHARE * abs(led_deg) + changed_deg + unsure_deg
            turns = round(slip_deg / _DEG_PER_TURN) if np.isfinite(slip_deg) else 0
            if turns and abs(slip_deg - _DEG_PER_TURN * turns) <= near_deg:
                self._wraps += turns
                table = replace(table, angle_deg=table.angle_deg - _DEG_PER_TURN * turns)
            elif abs(slip_deg) > near_deg:
                self.jumps, self.jumped_deg = self.jumps + 1, slip_deg
            turned = (table.angle_deg - last.angle_deg) / _DEG_PER_TURN
            self.turns_ccw += max(turned, 0.0)
            self.turns_cw += max(-turned, 0.0)
        self._last = table
        return table

    def drain(self) -> GyroSamples:
        """Samples since the last drain; keeps the history of the gyro's temperature.

        Raises
        ------
        DeviceError
            The stream is gone, or no sample has come for too long.
        """
        samples = self._bench.gyro.drain()
        now_s = self._clock.now_s()
        if samples.t_s.size:
            self._last_sample_s = now_s
            good = np.isfinite(samples.gyro_temp_c)
            if good.any():
                self.gyro_temp_c = float(np.mean(samples.gyro_temp_c[good]))
                self._temps.append((float(np.mean(samples.t_s[good])), self.gyro_temp_c))
                self._low_c = float(np.fmin(self._low_c, self.gyro_temp_c))
                self._high_c = float(np.fmax(self._high_c, self.gyro_temp_c))
        silence_s = max(_SILENCE_S, _SILENT_SAMPLES / self._profile.sensor.sample_rate_hz)
        if now_s - self._last_sample_s > silence_s:
            msg = f"The gyro has sent no sample for {silence_s:.0f} s (at {now_s:.0f} s). Check its supply and its cable, then --resume."
            raise DeviceError(msg)
        self._forget_temperatures(now_s - self._profile.soak.slope_over_s)
        return samples

    def _forget_temperatures(self, before_s: float) -> None:
        """Let go of old ones, but for those without which, drained seldom, the rest would give no slope."""
        while len(self._temps) > _FEWEST_TEMPS and self._temps[0][0] < before_s:
            if self._temps[-1][0] - self._temps[1][0] < self._slope_span_s:
                return
            self._temps.popleft()

    def gyro_slope_c_per_min(self) -> float:
        """Least-squares slope of the gyro's temperature over the profile's span; NaN until the span is nearly full."""
        if len(self._temps) < _FEWEST_TEMPS:
            return float("nan")
        t_s, temp_c = np.array(self._temps).T
        if t_s[-1] - t_s[0] < self._slope_span_s:
            return float("nan")
        centred = t_s - t_s.mean()
        return float(centred @ temp_c / (centred @ centred)) * S_PER_MIN

    def begin_ramp(self, chamber_c: float) -> None:
        """The chamber leaves `chamber_c`: from here on the gyro's thermometer is to move too."""
        self._ramp_from_c = chamber_c
        self._low_c = self._high_c = self.gyro_temp_c

    def check_thermometer(self) -> None:
        """The gyro is soaked: its thermometer has to have seen the chamber's ramp; raises InterlockError."""
        moved_c = self.chamber_c - self._ramp_from_c
        self._interlocks.check_thermometer(self._clock.now_s(), moved_c, self._high_c - self._low_c)

    def take_rows(self) -> list[BenchRow]:
        """Bench readings since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def keep_last_row(self) -> None:
        """Forget all bench readings but the last, which opens the segment: rate by angle then covers all of it."""
        self._rows = self._rows[-1:]

    def _ask(self, question: Callable[[], T]) -> T:
        """Ask a device, again when its answer is missing or damaged; commands are never repeated like this."""
        for _ in range(_ASKED - 1):
            with contextlib.suppress(DeviceError):
                return question()
        return question()
