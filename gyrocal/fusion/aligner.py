"""One clock for encoders and gyro: what is late is shifted forward, and the gyro smoothed as the encoders are."""

from __future__ import annotations

from dataclasses import dataclass

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


#: What is kept of a row: as it came, the rate that is taken where there is none (deg/s, m/s), and running sums of turn and ways,
#: and of the turn over time.
_T, _TEMP, _CAME, _RATES, _SUMS, _AREA = 0, 1, 2, 5, 8, 11


class Aligner:
    """Takes rows as they come and gives them back on one clock, as late as the robot's delay and window ask.

    With neither a delay nor a window the rows pass through untouched. A row without a rate or a distance in its middle
    has none: what then holds is the navigator's business. Beside that, the last rate or speed goes on, as it does
    there. Sums are carried on, so that blocks of any size give the same numbers.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self.gyro_late_s = max(robot.gyro.delay_s, 0.0)
        self.encoders_late_s = max(-robot.gyro.delay_s, 0.0)
        self.half_s = 0.5 * robot.encoders.window_s
        self._kept = np.zeros((_AREA + 1, 0))
        self._done = 0  # rows of `_kept` that have been given back

    def push(
        self, t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike
    ) -> Rows:
        """Take rows, arrays of shape (n,) in time order; give back those that can be aligned."""
        new = [np.array(a, dtype=np.float64, ndmin=1) for a in (t_s, left_m, right_m, gyro_dps, temp_c)]
        if self.gyro_late_s == self.encoders_late_s == self.half_s == 0.0:
            return Rows(*[*new, np.zeros(new[0].size)])
        came = np.stack([new[3], new[1], new[2]])
        self._kept = np.concatenate([self._kept, self._summed(new[0], came, new[4])], axis=1)
        rows_s = self._kept[_T]
        asked_s = np.maximum(rows_s + self.gyro_late_s + self.half_s, rows_s + self.encoders_late_s)
        return self._give(max(int(np.searchsorted(asked_s, rows_s[-1:].sum(), side="right")), self._done))

    def flush(self) -> Rows:
        """The rows that are still held, the last rate and speed of the late channel taken to be zero."""
        return self._give(self._kept.shape[1])

    def _summed(self, t: Floats, came: Floats, temp: Floats) -> Floats:
        """Rows with what is kept of them; where there is no rate the last one goes on."""
        last = self._kept[:, -1:] if self._kept.size else np.pad(t[None, :1], ((0, _AREA), (0, 0)))
        dt = np.diff(t, prepend=last[_T])
        added = came * np.stack([dt, np.ones(t.size), np.ones(t.size)])
        rates = np.divide(came, dt, out=np.full(came.shape, np.nan), where=dt > 0)
        rates = np.concatenate([last[_RATES:_SUMS], np.vstack([came[:1], rates[1:]])], axis=1)
        known = np.maximum.accumulate(np.where(np.isfinite(rates), np.arange(t.size + 1), 0), axis=1)
        rates = np.take_along_axis(rates, known, axis=1)[:, 1:]
        added = np.where(np.isfinite(added), added, rates * dt)
        sums = np.cumsum(np.concatenate([last[_SUMS:_AREA], added], axis=1), axis=1)
        area = np.append(last[_AREA], 0.5 * (sums[0, 1:] + sums[0, :-1]) * dt).cumsum()
        return np.vstack([t, temp, came, rates, sums[:, 1:], area[1:]])

    def _give(self, until: int) -> Rows:
        start, t_s = self._done, self._kept[_T]
        t, temp, *came, bridged = self._kept[: _RATES + 1, start:until]
        before = t_s[max(start - 1, 0) : until - 1] if start else np.concatenate([t[:1], t[:-1]])
        dt, smooth = t - before, np.zeros(t.size)
        for k, late_s in enumerate((self.gyro_late_s, self.encoders_late_s, self.encoders_late_s)):
            if late_s > 0.0:
                middle = np.searchsorted(t_s, 0.5 * (before + t) + late_s).clip(max=t_s.size - 1)
                sums = self._kept[_SUMS + k]
                grown = np.interp(t + late_s, t_s, sums) - np.interp(before + late_s, t_s, sums)
                if k == 0:
                    grown = bridged = np.divide(grown, dt, out=self._kept[_RATES, middle], where=dt > 0)
                came[k] = np.where(np.isfinite(self._kept[_CAME + k, middle]), grown, np.nan)
        if self.half_s > 0.0:
            turned = self._mean(t + self.gyro_late_s) - self._mean(before + self.gyro_late_s)
            smooth = np.divide(turned, dt, out=smooth, where=dt > 0) - np.where(dt > 0, bridged, 0.0)
        # What the window and the shift of the next row look back on stays.
        first = max(int(np.searchsorted(t_s, t[-1] - self.half_s)) - 2, 0) if t.size else 0
        self._kept, self._done = self._kept[:, first:], until - first
        return Rows(t, came[1], came[2], came[0], temp, smooth)

    def _mean(self, t: Floats) -> Floats:
        """Mean of the turn over a window about these times; before the first row and after the last it stands still."""
        ends = np.stack([t - self.half_s, t + self.half_s])
        t_s, turn, area = self._kept[[_T, _SUMS, _AREA]]
        k = np.clip(np.searchsorted(t_s, ends, side="right") - 1, 0, t_s.size - 1)
        integral = area[k] + 0.5 * (turn[k] + np.interp(ends, t_s, turn)) * (ends - t_s[k])
        return np.asarray((integral[1] - integral[0]) / (2.0 * self.half_s))
