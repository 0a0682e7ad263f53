"""One clock for encoders and gyro: what is late is shifted forward, and the gyro smoothed as the encoders are."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.fusion.robot import RobotParameters

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Rows that `Navigator.run` takes, arrays of shape (n,); `smooth_dps` as there."""

    t_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    temp_c: Floats
    smooth_dps: Floats


class Aligner:
    """Takes rows as they come and gives them back on one clock, as late as the robot's delay and window ask.

    With neither a delay nor a window the rows pass through untouched. A row of whose time most has no rate, or no
    distance, has none: what then holds is the navigator's business. Of less, and within the window, the last rate or
    speed goes on, as it does in the navigator. Blocks of any size give the same numbers.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self.gyro_late_s = max(robot.gyro.delay_s, 0.0)
        self.encoders_late_s = max(-robot.gyro.delay_s, 0.0)
        self.half_s = 0.5 * robot.encoders.window_s
        self._kept = Rows(*[np.empty(0) for _ in fields(Rows)])
        self._angle, self._left, self._right = _Sum(), _Sum(), _Sum()
        self._done = 0  # rows of `_kept` that have been given back

    def push(
        self, t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike
    ) -> Rows:
        """Take rows, arrays of shape (n,) in time order; give back those that can be aligned."""
        new = [np.array(a, dtype=np.float64, ndmin=1) for a in (t_s, left_m, right_m, gyro_dps, temp_c)]
        t, left, right, gyro, temp = new
        if self.gyro_late_s == self.encoders_late_s == self.half_s == 0.0:
            return Rows(t, left, right, gyro, temp, np.zeros(t.size))
        if not t.size:
            return self._give(self._done)
        before = self._kept.t_s[-1:] if self._kept.t_s.size else t[:1]
        dt = np.diff(t, prepend=before)
        self._angle.add(dt, gyro, gyro * dt)
        if self.encoders_late_s > 0.0:
            for way, steps_m in ((self._left, left), (self._right, right)):
                way.add(dt, np.divide(steps_m, dt, out=np.full(t.size, np.nan), where=dt > 0), steps_m)
        held = [getattr(self._kept, f.name) for f in fields(Rows)]
        self._kept = Rows(
            *[np.concatenate([a, b]) for a, b in zip(held, [*new, np.zeros(t.size)], strict=True)]
        )
        # The sums of these rows, and those of all later blocks, are then known to the last time that is asked for.
        asked_s = np.maximum(
            self._kept.t_s + self.gyro_late_s + self.half_s, self._kept.t_s + self.encoders_late_s
        )
        return self._give(max(int(np.searchsorted(asked_s, t[-1], side="right")), self._done))

    def flush(self) -> Rows:
        """The rows that are still held, the last rate and speed of the late channel taken to be zero."""
        return self._give(self._kept.t_s.size)

    def _give(self, until: int) -> Rows:
        kept, start = self._kept, self._done
        rows = slice(start, until)
        t = kept.t_s[rows]
        before = kept.t_s[max(start - 1, 0) : until - 1] if start else np.concatenate([t[:1], t[:-1]])
        dt = t - before
        now, then = t + self.gyro_late_s, before + self.gyro_late_s
        gyro, bridged = kept.gyro_dps[rows], self._angle.rate[rows]
        if self.gyro_late_s > 0.0:
            turned = self._angle.between(kept.t_s, then, now)
            bridged = np.divide(turned, dt, out=np.interp(now, kept.t_s, self._angle.rate), where=dt > 0)
            gyro = np.where(self._angle.lacks(kept.t_s, then, now), np.nan, bridged)
        left, right = kept.left_m[rows], kept.right_m[rows]
        if self.encoders_late_s > 0.0:
            ends = before + self.encoders_late_s, t + self.encoders_late_s
            left, right = (
                np.where(way.lacks(kept.t_s, *ends), np.nan, way.between(kept.t_s, *ends))
                for way in (self._left, self._right)
            )
        smooth = np.zeros(t.size)
        if self.half_s > 0.0:
            turned = self._angle.mean(kept.t_s, now, self.half_s) - self._angle.mean(
                kept.t_s, then, self.half_s
            )
            smooth = np.divide(turned, dt, out=smooth, where=dt > 0) - np.where(dt > 0, bridged, 0.0)
        given = Rows(t, left, right, gyro, kept.temp_c[rows], smooth)
        # What the window and the shift of the next row look back on stays.
        first = int(np.searchsorted(kept.t_s, (t[-1] if t.size else -np.inf) - self.half_s)) - 2
        first = min(max(first, 0), until)
        self._kept = Rows(*[getattr(kept, f.name)[first:] for f in fields(Rows)])
        for channel in (self._angle, self._left, self._right):
            channel.forget(first)
        self._done = until - first
        return given


class _Sum:
    """Running sum of angles or distances at the kept rows, straight between them.

    It is carried on from block to block, so that its rounding has nothing to do with where a block ends.
    """

    def __init__(self) -> None:
        self.rate, self.sum, self.area, self.lacking_s = (np.zeros(0) for _ in range(4))

    def add(self, dt_s: Floats, rate: Floats, amounts: Floats) -> None:
        """Take the next rows; where there is no amount, the last rate goes on."""
        known = np.isfinite(amounts)
        rates = np.concatenate([self.rate[-1:] if self.rate.size else [0.0], rate])
        held = rates[np.maximum.accumulate(np.where(np.isfinite(rates), np.arange(rates.size), 0))][1:]
        self.rate = np.concatenate([self.rate, held])
        before = self.sum[-1:]
        self.sum = _carried_on(self.sum, np.where(known, amounts, held * dt_s))
        sums = self.sum[-dt_s.size :]
        before = np.concatenate([before if before.size else sums[:1], sums[:-1]])
        self.area = _carried_on(self.area, 0.5 * (sums + before) * dt_s)
        self.lacking_s = _carried_on(self.lacking_s, np.where(known, 0.0, dt_s))

    def forget(self, rows: int) -> None:
        """Drop the first rows."""
        self.rate, self.sum = self.rate[rows:], self.sum[rows:]
        self.area, self.lacking_s = self.area[rows:], self.lacking_s[rows:]

    def between(self, t_s: Floats, then_s: Floats, now_s: Floats) -> Floats:
        """What is added between two times; before the first row and after the last it stands still."""
        return np.asarray(np.interp(now_s, t_s, self.sum) - np.interp(then_s, t_s, self.sum))

    def lacks(self, t_s: Floats, then_s: Floats, now_s: Floats) -> NDArray[np.bool_]:
        """Whether nothing is known of more than half of the time between."""
        lacking_s = np.interp(now_s, t_s, self.lacking_s) - np.interp(then_s, t_s, self.lacking_s)
        return np.asarray(lacking_s > 0.5 * (now_s - then_s))

    def mean(self, t_s: Floats, at_s: Floats, half_s: float) -> Floats:
        """Mean of the sum over a window about these times."""
        return (self._integral(t_s, at_s + half_s) - self._integral(t_s, at_s - half_s)) / (2.0 * half_s)

    def _integral(self, t_s: Floats, at_s: Floats) -> Floats:
        k = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, t_s.size - 1)
        reached = np.interp(at_s, t_s, self.sum)
        return np.asarray(self.area[k] + 0.5 * (self.sum[k] + reached) * (at_s - t_s[k]))


def _carried_on(sums: Floats, added: Floats) -> Floats:
    """The same sums with those of further rows."""
    last = sums[-1:] if sums.size else np.zeros(1)
    return np.concatenate([sums, np.cumsum(np.concatenate([last, added]))[1:]])
