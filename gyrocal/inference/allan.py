"""Overlapping Allan variance of a rate signal, and how its values at different averaging times vary together.

``avar(tau) = < (mean over the next tau - mean over this tau)^2 > / 2``, over all stretches of ``2 tau`` (IEEE Std 952,
annex C; Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, eq. 11). Gaps cut a record into pieces; no
estimate bridges them, and the squares of all pieces are pooled.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Averaging factors of the samples themselves; every later octave is taken from means of two of the octave before, so
#: that a stretch starts at each 32nd of tau: that gives as much as a start at each sample, to 0.1 %, but of white angle
#: noise, whose covariance allows for it.
_FACTORS = (1, 2, 4, 8, 16, 32)
_LONGEST = _FACTORS[-1]
#: Number of stretches, in averaging times, that an estimate needs: with fewer it is one difference of two means.
_LEAST_STRETCHES = 2
#: Terms of the model by power of tau: quantisation, angle random walk, bias instability, rate random walk.
POWERS = (-2, -1, 0, 1)

#: Lags are summed in steps of this share of their distance from where the covariance bends, one at least.
_LAG_STEP = 16


def _differences(rate: Floats, factor: int) -> Floats:
    """Mean of `factor` samples minus that of the `factor` before, at every start."""
    # Taking one value off costs nothing and keeps the digits of the running sum.
    total = np.concatenate(([0.0], np.cumsum(rate - rate[0])))
    second = total[2 * factor :] - 2.0 * total[factor:-factor] + total[: -2 * factor]
    return np.asarray(second / factor)


@dataclass(frozen=True)
class AllanCurve:
    """Allan variances at octaves of the sample time, shape (m,), pooled over pieces.

    Attributes
    ----------
    dt_s : float
        Sample time.
    factor : ndarray of int
        Averaging times over the sample time.
    avar : ndarray
        In the square of the samples' unit.
    lengths, repeats : ndarray of int, shape (p,)
        Numbers of samples that pieces have, and how many pieces have as many.
    """

    dt_s: float
    factor: Ints
    avar: Floats
    lengths: Ints
    repeats: Ints

    @property
    def tau_s(self) -> Floats:
        """Averaging times."""
        return np.asarray(self.factor * self.dt_s)

    @property
    def record_s(self) -> float:
        """Length of all pieces together."""
        return float(self.lengths @ self.repeats) * self.dt_s


class AllanSums:
    """Allan variance of a record as it is read, in memory that does not grow with it."""

    def __init__(self, dt_s: float) -> None:
        self.dt_s = dt_s
        self._sums: dict[int, float] = {}
        self._counts: dict[int, int] = {}
        self._pieces: Counter[int] = Counter()
        self._tails: list[Floats] = []
        self._odd: list[Floats] = []
        self._length = 0

    def add(self, rate: Floats) -> None:
        """Go on with samples that follow the last ones without a gap."""
        self._length += rate.size
        level, values = 0, rate
        while values.size:
            if level == len(self._tails):
                self._tails.append(np.empty(0))
                self._odd.append(np.empty(0))
            self._take(level, values)
            values = np.concatenate([self._odd[level], values])
            pairs = values.size // 2
            self._odd[level] = values[2 * pairs :]
            values, level = values[: 2 * pairs].reshape(-1, 2).mean(axis=1), level + 1

    def _take(self, level: int, values: Floats) -> None:
        tail = self._tails[level]
        whole = np.concatenate([tail, values])
        for factor in _FACTORS if level == 0 else (_LONGEST,):
            if whole.size < 2 * factor:
                break
            seen = max(tail.size - 2 * factor + 1, 0)
            new = _differences(whole[seen:], factor)
            name = factor << level
            self._sums[name] = self._sums.get(name, 0.0) + float(new @ new)
            self._counts[name] = self._counts.get(name, 0) + new.size
        self._tails[level] = whole[-(2 * _LONGEST - 1) :]

    def cut(self) -> None:
        """A gap: what follows is another piece."""
        if self._length:
            self._pieces[self._length] += 1
        self._tails, self._odd, self._length = [], [], 0

    def curve(self) -> AllanCurve:
        """Allan variances of all that was added, at averaging times that have two stretches or more beside the first."""
        self.cut()
        lengths = np.array(sorted(self._pieces), dtype=np.int64)
        repeats = np.array([self._pieces[n] for n in lengths.tolist()], dtype=np.int64)
        factors = [
            m
            for m in sorted(self._counts)
            if np.sum(repeats * np.maximum(lengths - 2 * m + 1, 0)) > _LEAST_STRETCHES * m
        ]
        avar = np.array([0.5 * self._sums[m] / self._counts[m] for m in factors])
        return AllanCurve(self.dt_s, np.array(factors, dtype=np.int64), avar, lengths, repeats)


def covariance_parts(curve: AllanCurve) -> Floats:
    """What the covariance of the Allan variances is made of, shape (m, m, 4, 4).

    For Gaussian noise with ``avar = sum_k c_k tau^POWERS[k]`` the covariance of the values at a and b is
    ``c' parts[a, b] c``: ``1/2 sum over lags of (covariance of the two differences)^2 * number of pairs at that lag``,
    exact for a finite record up to the steps in which lags are summed. The differences' covariance follows from the
    generalised covariances of the angle, ``delta(s) / 3, -|s| / 2, s^2 ln|s| / (4 ln 2), |s|^3 / 4``.
    """
    size = curve.factor.size
    parts = np.zeros((size, size, 4, 4))
    scale = curve.dt_s ** np.array(POWERS, dtype=np.float64)
    for i in range(size):
        for j in range(i, size):
            a, b = int(curve.factor[i]), int(curve.factor[j])
            parts[i, j] = parts[j, i] = _pair(a, b, curve.lengths, curve.repeats) * np.outer(scale, scale)
    return parts


#: Second difference of the angle.
_STENCIL = np.array([1.0, -2.0, 1.0])


def _pair(a: int, b: int, lengths: Ints, repeats: Ints) -> Floats:
    """``parts[a, b]`` in sample times, for averaging factors ``a <= b``."""
    shift = b * np.arange(3)[None, :] - a * np.arange(3)[:, None]
    lag, step = _lags(np.unique(shift), a, b)
    weight = np.outer(_STENCIL, _STENCIL) / (a * b)
    pairs_a, pairs_b = (np.maximum(lengths - 2 * m + 1, 0) for m in (a, b))

    def pairs(at: Ints) -> Floats:
        """Number of pairs of differences at each lag, over all pairs of their numbers."""
        last = np.minimum(pairs_a[:, None], pairs_b[:, None] + at)
        count = np.maximum(last - np.maximum(at, 0), 0) * (np.minimum(pairs_a, pairs_b) > 0)[:, None]
        return np.asarray(repeats @ count / (float(repeats @ pairs_a) * float(repeats @ pairs_b)))

    def smooth(at: Ints) -> Floats:
        """Covariance of the differences at each lag without what white angle noise adds; shape (3, lags)."""
        s = np.abs(at[None, None, :] - shift[:, :, None]).astype(np.float64)
        generalised = (-0.5 * s, s**2 * np.log(np.maximum(s, 1.0)) / (4.0 * np.log(2.0)), 0.25 * s**3)
        return np.stack([np.tensordot(weight, g, axes=2) for g in generalised])

    part = np.zeros((4, 4))
    covariance = smooth(lag)
    part[1:, 1:] = (covariance * pairs(lag) * step) @ covariance.T
    spot, where = np.unique(shift, return_inverse=True)
    spike = np.bincount(where.ravel(), weight.ravel()) / 3.0
    # White angle noise is another at each start, of which there is one in each 32nd of tau.
    share = pairs(spot) * max(a // _LONGEST, 1)
    part[0, 0] = spike**2 @ share
    part[0, 1:] = part[1:, 0] = smooth(spot) @ (spike * share)
    return 0.5 * part


def _lags(bends: Ints, a: int, b: int) -> tuple[Ints, Floats]:
    """Lags that stand for all, and how many each stands for: close together where the covariance bends."""
    near = np.arange(0, max(a, _LAG_STEP) + 1, max(1, a // _LAG_STEP))
    far = a * np.exp(np.arange(0.0, np.log(4.0 * b / a) + 1.0 / _LAG_STEP, 1.0 / _LAG_STEP))
    steps = np.unique(np.concatenate([near, np.rint(far).astype(np.int64)]))
    lag = np.unique((bends[:, None] + np.concatenate([-steps, steps])).ravel())
    ends = np.concatenate([lag[:1] - 1, lag, lag[-1:] + 1])
    return lag, 0.5 * (ends[2:] - ends[:-2])
