"""Bias that drifts at random, as 1/f noise and as a walk: covariances over windows, and what records at rest say of the levels.

In a run of few temperatures the surface takes drift from one temperature to the next for a dependence on temperature; data
sets then show drift only within each visit, and say little about its level. Records at rest show it without any of that.
Each is cut into windows; a constant, a straight line in time and one in temperature are taken off, since they say nothing
that the surface does not touch; what is left is rotated to contrasts that are hardly correlated, whose
variances are ``white + flicker * gain + walk * walk_gain``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

Floats = NDArray[np.float64]

#: Time constants of the Ornstein-Uhlenbeck sum, s: a decade apart they add up to 1/f within 6 %. The slowest lasts
#: longer than a run: nobody sees it in the data, and the bias found today is off by it some days later.
TIME_CONSTANTS_S = (2.0, 20.0, 200.0, 2000.0, 20000.0, 200000.0)


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


def walk_covariance(t_s: Floats, duration_s: Floats) -> Floats:
    """Covariance of window means of a random walk of unit variance a second about the middle of where it goes, shape (n, n), s.

    A walk has no mean, so what the constant beside it stands for is a choice. ``(span - |t - s|) / 2`` is the mean of a walk
    that begins at nothing and one that ends there: a constant that is estimated under it is off from the bias at either end,
    and anywhere between, by what is stated. Exact for windows that do not overlap.
    """
    apart = np.abs(t_s[:, None] - t_s[None, :])
    np.fill_diagonal(apart, duration_s / 3.0)
    span = float(np.max(t_s + 0.5 * duration_s) - np.min(t_s - 0.5 * duration_s))
    return np.asarray(0.5 * (span - apart))


@dataclass(frozen=True)
class Rest:
    """Contrasts of records at rest: ``square ~ (white + flicker * gain + walk * walk_gain) * chi2(1)``.

    Attributes
    ----------
    gain : ndarray, shape (m,), s
        How strongly flicker shows in each contrast.
    walk_gain : ndarray, shape (m,), s^2
        The same of a walk.
    square : ndarray, shape (m,), (deg/s)^2 s
        Squared contrasts.
    records : int
        Number of records.
    span_s : float
        Their length together.
    """

    gain: Floats
    walk_gain: Floats
    square: Floats
    records: int
    span_s: float

    def cost(self, flicker: float, walk: float) -> tuple[float, float, float]:
        """Minus the log-likelihood of levels of flicker, (deg/s)^2 a decade, and walk, (deg/s)^2/s, and its slopes.

        The angle random walk is whatever suits it best: hundreds of contrasts leave it little freedom.
        """
        drift = flicker * self.gain + walk * self.walk_gain
        middle = np.log(float(np.mean(self.square)) + np.finfo(float).tiny)

        def value(log_white: float) -> float:
            variance = np.exp(log_white) + drift
            return 0.5 * float(np.sum(np.log(variance) + self.square / variance))

        found = optimize.minimize_scalar(
            value, bounds=(middle - 20.0, middle + 3.0), method="bounded", options={"xatol": 1e-6}
        )
        variance = np.exp(found.x) + drift
        pull = 0.5 * (1.0 - self.square / variance) / variance
        return float(found.fun), float(pull @ self.gain), float(pull @ self.walk_gain)


def merge_rest(records: Iterable[Rest | None]) -> Rest | None:
    """Records together; None where there is none."""
    present = [r for r in records if r is not None]
    if not present:
        return None
    return Rest(
        gain=np.concatenate([r.gain for r in present]),
        walk_gain=np.concatenate([r.walk_gain for r in present]),
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
    lengths = np.full(t_s.size, window_s)
    gain, vectors = linalg.eigh(free.T @ flicker_correlation(t_s, lengths, TIME_CONSTANTS_S) @ free)
    rotated = free @ vectors
    # Of a walk the contrasts that are independent are all but the same.
    walk_gain = np.sum(rotated * (walk_covariance(t_s, lengths) @ rotated), axis=0)
    return Rest(
        np.maximum(gain, 0.0) * window_s,
        np.maximum(walk_gain, 0.0) * window_s,
        (rotated.T @ gyro_dps) ** 2 * window_s,
        1,
        t_s.size * window_s,
    )
