"""Noise of a made-up gyro, and the whitening that knows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.trial.plans import Bench

Floats = NDArray[np.float64]

#: Correlation times whose sum of equal variances looks like 1/f between them.
FLICKER_TAUS_S = (20.0, 200.0, 2000.0, 20000.0)


@dataclass(frozen=True)
class Noise:
    """Levels in deg/s, and what of it grows with the rate.

    Attributes
    ----------
    white : float
        Standard deviation of a mean over 1 s.
    flicker : float
        Standard deviation of each of the processes of `FLICKER_TAUS_S`.
    walk : float
        Of the bias, after an hour.
    jitter : float
        Relative error of the rate of each data set, its own for each.
    grows : float
        By how many times its own the white noise has grown at the largest rate.
    steps : float
        Error of each data set that an output in steps leaves; not drawn, since rounding makes it.
    outliers : float
        Share of rows that are thrown far off; none can whiten these.
    """

    white: float
    flicker: float = 0.0
    walk: float = 0.0
    jitter: float = 0.0
    grows: float = 0.0
    steps: float = 0.0
    outliers: float = 0.0

    def white_dps(self, bench: Bench) -> Floats:
        """Standard deviation of each row's white noise."""
        return self.white / np.sqrt(bench.averaging_s) * (1.0 + self.grows * np.abs(bench.u))

    def draw(self, bench: Bench, rng: np.random.Generator) -> tuple[Floats, float]:
        """One realisation, and where its walk of the bias has come to at the end."""
        gap = np.diff(bench.t_s, prepend=bench.t_s[0])
        out = self.white_dps(bench) * rng.standard_normal(gap.size)
        if self.outliers:
            hit = rng.random(gap.size) < self.outliers
            out = out * np.where(hit, rng.uniform(8.0, 40.0, size=gap.size), 1.0)
        for tau in FLICKER_TAUS_S if self.flicker else ():
            keep = np.exp(-gap / tau)
            push = self.flicker * np.sqrt(1.0 - keep**2) * rng.standard_normal(gap.size)
            push[0] = self.flicker * rng.standard_normal()
            level = 0.0
            for k, (share, kick) in enumerate(zip(keep.tolist(), push.tolist(), strict=True)):
                level = share * level + kick
                out[k] += level
        walked = self.walk / 60.0 * np.cumsum(np.sqrt(gap) * rng.standard_normal(gap.size))
        each = self.jitter * rng.standard_normal(len(bench.segments))
        return np.asarray(out + walked + each[bench.segment] * bench.rate_dps), float(walked[-1])

    def whiten(self, bench: Bench, columns: Floats) -> Floats:
        """Columns, shape (n, m), as innovations of the noise's Kalman filter in their standard deviations.

        Their inner products are those under the inverse of the noise's covariance, in time linear in the rows.
        """
        taus = np.array(FLICKER_TAUS_S if self.flicker else ())
        gap = np.diff(bench.t_s, prepend=bench.t_s[0])
        keep = np.hstack([np.exp(-gap[:, None] / taus), np.ones((gap.size, 2))])
        push = np.hstack(
            [self.flicker**2 * (1.0 - np.exp(-2.0 * gap[:, None] / taus)), np.zeros((gap.size, 2))]
        )
        push[:, -2] = self.walk**2 / 3600.0 * gap
        jitter = (self.jitter * bench.rate_dps) ** 2 + self.steps**2
        starts = np.diff(bench.segment, prepend=-1) != 0
        white = self.white_dps(bench) ** 2
        states = taus.size + 2
        mean = np.zeros((states, columns.shape[1]))
        cover = np.diag(np.append(np.full(taus.size, self.flicker**2), [0.0, 0.0]))
        out = np.empty_like(columns, dtype=np.float64)
        for k in range(gap.size):
            mean *= keep[k][:, None]
            cover *= np.outer(keep[k], keep[k])
            cover[np.diag_indices(states)] += push[k]
            if starts[k]:
                mean[-1], cover[-1], cover[:, -1], cover[-1, -1] = 0.0, 0.0, 0.0, jitter[k]
            seen = cover.sum(axis=1)
            variance = seen.sum() + white[k]
            gain = seen / variance
            innovation = columns[k] - mean.sum(axis=0)
            out[k] = innovation / np.sqrt(variance)
            mean += np.outer(gain, innovation)
            cover -= np.outer(gain, seen)
        return out
