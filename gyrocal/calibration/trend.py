"""What a record at rest does that is no noise: it drifts straight, settles, or steps.

An Allan variance takes each of them for a random walk of the rate, with an interval that is far too short. Here they
are weighed against noise in the time domain: each counts that makes the course of the record likelier than any white
noise with 1/f noise and a random walk of whatever level beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from gyrocal.calibration.course import Course
from gyrocal.inference.allan import AllanCurve
from gyrocal.inference.flicker import TIME_CONSTANTS_S, flicker_correlation

Floats = NDArray[np.float64]

#: Levels of the drift that are tried, four a decade.
_LEVELS = 25
#: Shares of a random walk in the drift that are tried, the rest 1/f noise.
_WALKS = (0.0, 0.01, 0.05, 0.3, 1.0)
#: Nominal chance that noise passes for each of a drift, a settling and a step; where few slow modes tell their level it is larger.
_ALARM = 1e-4
#: Means that a course needs, and time constants of a settling that are tried.
_LEAST_MEANS, _TRIED = 32, 40
#: Fewer steps than this are told: what has more, as a telegraph, is a noise of its own.
_MOST_STEPS = 8
#: Means to either side of a step within which another is none.
_NEAR = 2
#: Rise of the cost at the ends of a 95 % interval.
_RISE = float(stats.chi2.isf(0.05, 1))


class CourseNoise:
    """Likelihood of a course under white noise with 1/f noise and a random walk beside it, of any level."""

    def __init__(self, course: Course) -> None:
        duration_s = course.n / course.n.sum() * course.span_s
        later_s = course.t_s - course.t_s[0]
        self._root_s = np.sqrt(duration_s)
        self._drifts: list[tuple[Floats, Floats]] = []
        flicker = flicker_correlation(course.t_s, duration_s, TIME_CONSTANTS_S)
        walk = np.minimum(later_s[:, None], later_s[None, :])
        walk *= np.trace(flicker) / np.trace(walk)
        for share in _WALKS:
            drift = share * walk + (1.0 - share) * flicker
            power, vectors = linalg.eigh(drift * np.outer(self._root_s, self._root_s))
            levels = np.append(0.0, np.geomspace(1e-3, 1e3, _LEVELS) / power[power.size // 2 :].mean())
            self._drifts.append((1.0 + levels[:, None] * np.maximum(power, 0.0), vectors))

    def costs(self, gyro_dps: Floats, known: Floats, tried: Floats) -> tuple[float, Floats]:
        """Minus twice the log-likelihood beside the columns `known`, and beside each of `tried` too.

        Parameters
        ----------
        gyro_dps : ndarray, shape (k,)
        known : ndarray, shape (k, m)
        tried : ndarray, shape (k, t)

        Returns
        -------
        without : float
        cost : ndarray, shape (t,)
        """
        without, cost = np.inf, np.full(tried.shape[1], np.inf)
        for white, spread in self._whitened(np.column_stack([known, gyro_dps, tried])):
            alone, beside = _squares(white, known.shape[1])
            without = min(without, gyro_dps.size * float(np.log(alone)) + spread)
            cost = np.minimum(cost, gyro_dps.size * np.log(beside) + spread)
        return without, cost

    def sizes(self, gyro_dps: Floats, known: Floats) -> tuple[Floats, Floats]:
        """Likeliest amplitudes of the columns `known` and their variances, shape (m,) each."""
        best, none = np.inf, np.zeros(known.shape[1])
        found: tuple[Floats, Floats] = none, none
        for white, spread in self._whitened(np.column_stack([known, gyro_dps])):
            sizes = np.asarray(np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0], dtype=np.float64)
            rest = white[:, -1] - white[:, :-1] @ sizes
            cost = gyro_dps.size * float(np.log(rest @ rest)) + spread
            if cost < best:
                inverse = np.linalg.pinv(white[:, :-1])
                each = float(rest @ rest) / max(gyro_dps.size - sizes.size, 1)
                best, found = cost, (sizes, each * np.sum(inverse**2, axis=1))
        return found

    def _whitened(self, columns: Floats) -> Iterator[tuple[Floats, float]]:
        """Columns under each noise, of unit variance, and the logarithm of its determinant."""
        scaled = columns * self._root_s[:, None]
        for variances, vectors in self._drifts:
            turned = vectors.T @ scaled
            for variance in variances:
                yield turned / np.sqrt(variance)[:, None], float(np.log(variance).sum())


def _squares(white: Floats, nuisance: int) -> tuple[float, Floats]:
    """Sum of squares of the column after the first `nuisance` ones beside them, and beside each later one too."""
    q = linalg.qr(white[:, :nuisance], mode="economic")[0]
    rest = white[:, nuisance:] - q @ (q.T @ white[:, nuisance:])
    error, decay = rest[:, 0], rest[:, 1:]
    size = np.maximum(np.sum(decay**2, axis=0), np.finfo(float).tiny)
    alone = float(error @ error)
    return alone, np.asarray(alone - (error @ decay) ** 2 / size)


@dataclass(frozen=True)
class Trend:
    """What was found.

    Attributes
    ----------
    start_s : float
        When the course begins.
    drift_dps_per_s, drift_variance : float
        0 where there is none; the variance in (deg/s/s)^2.
    settling : tuple of (float, float), optional
        Size at the beginning, deg/s, and time constant, s, of an exponential.
    steps : tuple of (float, float)
        Stretches of time, s, within which the output steps.
    """

    start_s: float = 0.0
    drift_dps_per_s: float = 0.0
    drift_variance: float = 0.0
    settling: tuple[float, float] | None = None
    steps: tuple[tuple[float, float], ...] = ()

    def smooth_dps(self, t_s: Floats) -> Floats:
        """The drift and what settles, at times, shape (n,)."""
        later_s = t_s - self.start_s
        off = self.drift_dps_per_s * later_s
        if self.settling is None:
            return off
        size_dps, constant_s = self.settling
        return np.asarray(off + size_dps * np.exp(-later_s / constant_s))

    def restored(self, curve: AllanCurve) -> AllanCurve:
        """The curve of a record without its drift, with what of its noise went with that: a slope of noise is ``R^2 tau^2 / 2``."""
        return replace(curve, avar=curve.avar + 0.5 * self.drift_variance * curve.tau_s**2)


def trend_of(course: Course, jumps: Sequence[tuple[float, float]], rounding_dps: float) -> Trend:
    """What `course` does that noise does not.

    Parameters
    ----------
    jumps : stretches of time, s, over which it is known to jump
    rounding_dps : what rounding may put a mean off by, either way; no smaller step is told
    """
    t_s, gyro_dps = course.t_s, course.gyro_dps
    if t_s.size < _LEAST_MEANS or len(jumps) > _MOST_STEPS:
        return Trend()
    noise, tried = CourseNoise(course), _tried(course)
    known = [np.ones(t_s.size), *((t_s > start).astype(np.float64) for start, _ in jumps)]
    needed, found, spans = tried.needed.copy(), list[tuple[int, int]](), list[tuple[float, float]]()
    while len(spans) < _MOST_STEPS:
        without, cost = noise.costs(gyro_dps, np.stack(known, axis=1), tried.columns)
        best = int(np.argmax(without - cost - needed))
        if not without - cost[best] > needed[best]:
            break
        found.append((best, len(known)))
        known.append(tried.columns[:, best])
        k = best - tried.smooth
        if k < 0:
            # One drift, and one settling.
            needed[tried.needed == tried.needed[best]] = np.inf
            continue
        if abs(noise.sizes(gyro_dps, np.stack(known, axis=1))[0][-1]) < 2.0 * rounding_dps:
            found.pop()
        else:
            spans.append(_around(t_s, cost[tried.smooth :], k))
        # It may be within either of the two means beside it: they say nothing more.
        known += [np.eye(t_s.size)[k + 1], np.eye(t_s.size)[k + 2]]
        needed[best - min(k, _NEAR) : best + _NEAR + 1] = np.inf
    if not found or len(spans) == _MOST_STEPS:
        return Trend()
    sizes, variances = noise.sizes(gyro_dps, np.stack(known, axis=1))
    drift, variance = next(
        ((float(sizes[at]), float(variances[at])) for k, at in found if k == 0), (0.0, 0.0)
    )
    settling = next(
        ((float(sizes[at]), float(tried.constants_s[k - 1])) for k, at in found if 0 < k < tried.smooth), None
    )
    return Trend(float(t_s[0]), drift, variance, settling, tuple(sorted(spans)))


@dataclass(frozen=True)
class _Tried:
    """Columns: the drift, settlings of `constants_s`, a step between the means `k + 1` and `k + 2` of each k; the gains they need."""

    columns: Floats
    needed: Floats
    constants_s: Floats

    @property
    def smooth(self) -> int:
        """Number of columns that are no steps."""
        return 1 + self.constants_s.size


def _tried(course: Course) -> _Tried:
    t_s, later_s = course.t_s, course.t_s - course.t_s[0]
    constants_s = np.geomspace(2.0 * float(np.median(np.diff(t_s))), 0.5 * course.span_s, _TRIED)
    # One mean at an end that is off by itself is no step.
    steps = t_s[:, None] > t_s[1:-2]
    columns = np.column_stack([later_s, np.exp(-later_s[:, None] / constants_s), steps])
    count = steps.shape[1]
    needed = np.repeat(stats.chi2.isf([_ALARM, _ALARM, _ALARM / count], [1, 2, 1]), [1, _TRIED, count])
    return _Tried(columns, needed, constants_s)


def _around(t_s: Floats, cost: Floats, k: int) -> tuple[float, float]:
    """Times between which the step of least `cost` is with 95 %, and no less than the two means beside it."""
    off = np.flatnonzero(cost > cost[k] + _RISE)
    first = off[off < k].max(initial=-1) + 1
    last = off[off > k].min(initial=cost.size) - 1
    half_s = 0.5 * float(np.median(np.diff(t_s)))
    return float(t_s[first + 1]) - half_s, float(t_s[last + 2]) + half_s
