"""1/f bias noise: its covariance over windows, and what records at rest say about its level.

In a run of few temperatures the surface takes drift from one temperature to the next for a dependence on
temperature; data sets then show flicker only within each visit, and say little about its level. Records at rest
(static segments; soaks once the temperature is steady) show it without any of that. Each is cut into windows; a
constant, a straight line in time and one in temperature are taken off, since they say nothing that the surface does
not touch; what is left is rotated to independent contrasts, whose variances are ``white + flicker * gain``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from gyrocal.records.run import Segment, SegmentRecord

Floats = NDArray[np.float64]

#: Time constants of the Ornstein-Uhlenbeck sum, s: a decade apart they add up to 1/f within 6 %. The slowest lasts
#: longer than a run: nobody sees it in the data, and the bias found today is off by it some days later.
TIME_CONSTANTS_S = (2.0, 20.0, 200.0, 2000.0, 20000.0, 200000.0)

#: Kinds of segment that may be records at rest.
_KINDS = ("static", "rate", "soak")
#: Shorter records say next to nothing about drift.
_SHORTEST_S = 300.0
#: Windows of a record: enough for two decades of time, few enough for dense algebra.
_WINDOWS = 64
_FEWEST_WINDOWS = 12
_SHORTEST_WINDOW_S = 10.0
#: A window must hold this share of the samples of the fullest one.
_FULL = 0.5
#: A soak is steady from where the temperature stays this near to where it ends, °C.
_STEADY_C = 0.5


def flicker_correlation(t_s: Floats, duration_s: Floats, time_constants: tuple[float, ...]) -> Floats:
    """Covariance of window means of a sum of unit Ornstein-Uhlenbeck processes, shape (n, n).

    Exact for windows that do not overlap: the mean of ``exp(-|t - s| / tau)`` over both windows.
    """
    gap = np.abs(t_s[:, None] - t_s[None, :]) - 0.5 * (duration_s[:, None] + duration_s[None, :])
    total = np.zeros_like(gap)
    for tau in time_constants:
        share = duration_s / tau
        window = -np.expm1(-share) / share
        covariance = np.exp(-np.maximum(gap, 0.0) / tau) * window[:, None] * window[None, :]
        np.fill_diagonal(covariance, 2.0 * (share + np.expm1(-share)) / share**2)
        total += covariance
    return total


@dataclass(frozen=True)
class Rest:
    """Independent contrasts of records at rest: ``square ~ (white + flicker * gain) * chi2(1)``.

    Attributes
    ----------
    gain : ndarray, shape (m,), s
        How strongly flicker shows in each contrast.
    square : ndarray, shape (m,), (deg/s)^2 s
        Squared contrasts.
    records : int
        Number of records.
    span_s : float
        Their length together.
    """

    gain: Floats
    square: Floats
    records: int
    span_s: float

    def cost(self, flicker: float) -> tuple[float, float]:
        """Minus the log-likelihood of a level of flicker, (deg/s)^2 a decade, and its slope.

        The angle random walk is whatever suits it best: hundreds of contrasts leave it little freedom.
        """
        drift = flicker * self.gain
        middle = np.log(float(np.mean(self.square)) + np.finfo(float).tiny)

        def value(log_white: float) -> float:
            variance = np.exp(log_white) + drift
            return 0.5 * float(np.sum(np.log(variance) + self.square / variance))

        found = optimize.minimize_scalar(
            value, bounds=(middle - 20.0, middle + 3.0), method="bounded", options={"xatol": 1e-6}
        )
        variance = np.exp(found.x) + drift
        slope = 0.5 * float(np.sum((1.0 - self.square / variance) * self.gain / variance))
        return float(found.fun), slope


def merge_rest(records: Iterable[Rest | None]) -> Rest | None:
    """Records together; None where there is none."""
    present = [r for r in records if r is not None]
    if not present:
        return None
    return Rest(
        gain=np.concatenate([r.gain for r in present]),
        square=np.concatenate([r.square for r in present]),
        records=sum(r.records for r in present),
        span_s=sum(r.span_s for r in present),
    )


def rest_of_windows(t_s: Floats, gyro_dps: Floats, temp_c: Floats, window_s: float) -> Rest:
    """Contrasts of one record from its windows of equal length.

    Parameters
    ----------
    t_s, gyro_dps, temp_c : ndarray, shape (n,)
        Mid time and means of each window; NaN temperatures are taken for constant.
    """
    columns = [np.ones(t_s.size), t_s - t_s.mean()]
    if np.all(np.isfinite(temp_c)) and np.ptp(temp_c) > 0:
        columns.append(temp_c - temp_c.mean())
    nuisance = np.stack([c / np.linalg.norm(c) for c in columns], axis=1)
    free = linalg.null_space(nuisance.T)
    # Windows are as long as one another: their sample noise is white, and weighed by their length the same in all.
    covariance = flicker_correlation(t_s, np.full(t_s.size, window_s), TIME_CONSTANTS_S)
    gain, vectors = linalg.eigh(free.T @ covariance @ free)
    contrast = vectors.T @ (free.T @ gyro_dps)
    return Rest(np.maximum(gain, 0.0) * window_s, contrast**2 * window_s, 1, t_s.size * window_s)


class RestWindows:
    """Means over windows of a segment at rest, gathered as its blocks pass by."""

    def __init__(self, record: SegmentRecord) -> None:
        span_s = record.t_end_s - record.t_start_s
        self.wanted = (
            record.kind in _KINDS
            and record.outcome == "ok"
            and record.rate_dps == 0.0
            and span_s >= _SHORTEST_S
        )
        self._steady_only = record.kind == "soak"
        self._start_s = record.t_start_s
        self.window_s = max(_SHORTEST_WINDOW_S, span_s / _WINDOWS)
        self._count, self._time, self._gyro = (np.zeros(_WINDOWS) for _ in range(3))
        self._warm, self._temp = np.zeros(_WINDOWS), np.zeros(_WINDOWS)
        self._offset_dps = 0.0

    def watch(self, blocks: Iterable[Segment]) -> Iterator[Segment]:
        """Pass blocks on, and add them up."""
        for block in blocks:
            if self.wanted:
                self._add(block)
            yield block

    def _add(self, block: Segment) -> None:
        good = block.good
        t_s, gyro_dps, temp_c = block.t_s[good], block.gyro_dps[good], block.gyro_temp_c[good]
        if t_s.size == 0:
            return
        if not self._count.any():
            self._offset_dps = float(gyro_dps[0])
        row = np.clip(((t_s - self._start_s) / self.window_s).astype(np.int64), 0, _WINDOWS - 1)
        warm = np.isfinite(temp_c)
        self._count += np.bincount(row, minlength=_WINDOWS)
        self._time += np.bincount(row, t_s - self._start_s, minlength=_WINDOWS)
        self._gyro += np.bincount(row, gyro_dps - self._offset_dps, minlength=_WINDOWS)
        self._warm += np.bincount(row[warm], minlength=_WINDOWS)
        self._temp += np.bincount(row[warm], temp_c[warm], minlength=_WINDOWS)

    def of(self, blocks: Iterable[Segment]) -> Rest | None:
        """What a whole segment says, from its blocks."""
        for _ in self.watch(blocks):
            pass
        return self.rest()

    def rest(self) -> Rest | None:
        """What the segment says about flicker; None where it is short, or its temperature never steady."""
        full = self._count >= _FULL * max(self._count.max(), 1.0)
        if not self.wanted or full.sum() < _FEWEST_WINDOWS:
            return None
        with np.errstate(invalid="ignore", divide="ignore"):
            temp_c = (self._temp / self._warm)[full]
        t_s, gyro_dps = (v[full] / self._count[full] for v in (self._time, self._gyro))
        if self._steady_only:
            moving = np.flatnonzero(~(np.abs(temp_c - temp_c[-1]) <= _STEADY_C))
            first = int(moving[-1]) + 1 if moving.size else 0
            t_s, gyro_dps, temp_c = t_s[first:], gyro_dps[first:], temp_c[first:]
        if t_s.size < _FEWEST_WINDOWS:
            return None
        return rest_of_windows(t_s, gyro_dps, temp_c, self.window_s)
