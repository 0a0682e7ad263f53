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

    With neither a delay nor a window the rows pass through untouched. A rate that is not finite is bridged by the
    angle of the rows beside it, a distance likewise. Blocks of any size give the same rows.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self.gyro_late_s = max(robot.gyro.delay_s, 0.0)
        self.encoders_late_s = max(-robot.gyro.delay_s, 0.0)
        self.half_s = 0.5 * robot.encoders.window_s
        self._kept = Rows(*[np.empty(0) for _ in fields(Rows)])
        self._done = 0  # rows of `_kept` that have been given back

    def push(
        self, t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike
    ) -> Rows:
        """Take rows, arrays of shape (n,) in time order; give back those that can be aligned."""
        new = [np.array(a, dtype=np.float64, ndmin=1) for a in (t_s, left_m, right_m, gyro_dps, temp_c)]
        if self.gyro_late_s == self.encoders_late_s == self.half_s == 0.0:
            return Rows(new[0], new[1], new[2], new[3], new[4], np.zeros(new[0].size))
        new.append(np.zeros(new[0].size))
        held = [getattr(self._kept, f.name) for f in fields(Rows)]
        self._kept = Rows(*[np.concatenate([a, b]) for a, b in zip(held, new, strict=True)])
        ahead_s = max(self.gyro_late_s, self.encoders_late_s) + self.half_s
        if not new[0].size:
            return self._give(self._done)
        until = int(np.searchsorted(self._kept.t_s, self._kept.t_s[-1] - ahead_s, side="right"))
        return self._give(max(until, self._done))

    def flush(self) -> Rows:
        """The rows that are still held, the last rate and speed of the late channel taken to be zero."""
        return self._give(self._kept.t_s.size)

    def _give(self, until: int) -> Rows:
        kept, start = self._kept, self._done
        rows = slice(start, until)
        t = kept.t_s[rows]
        before = kept.t_s[max(start - 1, 0) : until - 1] if start else np.concatenate([t[:1], t[:-1]])
        dt = t - before
        angle = _Integral(kept.t_s, kept.gyro_dps * np.diff(kept.t_s, prepend=kept.t_s[:1]))
        gyro = kept.gyro_dps[rows]
        if self.gyro_late_s > 0.0:
            turned = angle.at(t + self.gyro_late_s) - angle.at(before + self.gyro_late_s)
            held = np.interp(t + self.gyro_late_s, kept.t_s, kept.gyro_dps)
            gyro = np.divide(turned, dt, out=held, where=dt > 0)
        left, right = kept.left_m[rows], kept.right_m[rows]
        if self.encoders_late_s > 0.0:
            left, right = (
                way.at(t + self.encoders_late_s) - way.at(before + self.encoders_late_s)
                for way in (_Integral(kept.t_s, kept.left_m), _Integral(kept.t_s, kept.right_m))
            )
        smooth = np.zeros(t.size)
        if self.half_s > 0.0:
            now, then = (angle.mean(at + self.gyro_late_s, self.half_s) for at in (t, before))
            turned = np.divide(now - then, dt, out=np.zeros(t.size), where=dt > 0)
            smooth = turned - np.where(dt > 0, gyro, 0.0)
        given = Rows(t, left, right, gyro, kept.temp_c[rows], smooth)
        # What the window and the shift of the next row look back on stays.
        first = int(np.searchsorted(kept.t_s, (t[-1] if t.size else -np.inf) - self.half_s)) - 2
        first = min(max(first, 0), until)
        self._kept = Rows(*[getattr(kept, f.name)[first:] for f in fields(Rows)])
        self._done = until - first
        return given


class _Integral:
    """Sum of increments as a function of time, straight between rows; missing increments are bridged."""

    def __init__(self, t_s: Floats, increments: Floats) -> None:
        finite = np.isfinite(increments)
        self.t_s, self.sum = t_s[finite], np.cumsum(increments[finite])
        middle = 0.5 * (self.sum[1:] + self.sum[:-1]) * np.diff(self.t_s)
        self.area = np.concatenate([[0.0], np.cumsum(middle)])

    def at(self, t_s: Floats) -> Floats:
        """The sum at these times; before the first row and after the last it stands still."""
        return np.asarray(np.interp(t_s, self.t_s, self.sum))

    def mean(self, t_s: Floats, half_s: float) -> Floats:
        """Mean of the sum over a window about these times."""
        return (self._integral(t_s + half_s) - self._integral(t_s - half_s)) / (2.0 * half_s)

    def _integral(self, t_s: Floats) -> Floats:
        k = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, self.t_s.size - 1)
        return np.asarray(self.area[k] + 0.5 * (self.sum[k] + self.at(t_s)) * (t_s - self.t_s[k]))
