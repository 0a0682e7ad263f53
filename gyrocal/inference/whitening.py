"""Noise of a recording and its whitening: white noise, 1/f bias noise, rate random walk, a rate error of each data set.

The covariance is that of a state-space model: angle random walk over each row's averaging time, a sum of Ornstein-Uhlenbeck processes of common amplitude (their spectrum adds up to 1/f),
an offset that is drawn anew for each data set, proportional to the rate, and, where the record insists on it, a
random walk of the bias (IEEE 952: N, B and K). A Kalman filter whitens the record and every regression column in
one pass; the restricted likelihood of its innovations gives the levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.stats import chi2

from gyrocal.inference.compiled import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Rows(Protocol):
    """Rows of a record in time order, as the diagnosis bins them; every array has shape (n,)."""

    @property
    def t_s(self) -> Floats:
        """Time."""
        ...

    @property
    def rate_dps(self) -> Floats:
        """Reference rate."""
        ...

    @property
    def white_std_dps(self) -> Floats:
        """White noise of a row, but for a factor common to all."""
        ...

    @property
    def averaging_s(self) -> Floats:
        """Time that a row averages over."""
        ...

    @property
    def set_index(self) -> Ints:
        """Data set that the row belongs to."""
        ...


#: Correlation times of the bias noise, s; a record that is longer than the last has more, a decade apart.
TAUS_S = (2.0, 20.0, 200.0, 2000.0, 20000.0)
#: Levels below the first (flicker, jitter and walk in units of the white noise) are none; none is above the second.
_LOWEST, _HIGHEST = np.log([1e-5, 1e-8, 1e-7]), np.log([1e4, 1.0, 1e2])
#: A walk whose likeliest guess is so much (nats) worse than none is not looked for any further.
_HOPELESS = 3.0
#: A jitter that offsets a set at the largest rate by so many standard errors of its mean is known well enough.
_SURE_JITTER = 3.0


@dataclass(frozen=True)
class NoiseLevels:
    """The levels of the noise model.

    Attributes
    ----------
    white : float
        Factor on the rows' own ``white_std_dps``.
    flicker_dps : float
        Standard deviation of each Ornstein-Uhlenbeck process, deg/s.
    jitter : float
        Standard deviation of the relative rate error of a data set.
    walk : float
        Rate random walk of the bias, deg/s in the square root of a second.
    """

    white: float
    flicker_dps: float
    jitter: float
    walk: float = 0.0


@njit(cache=True)
def _gains(  # type: ignore[no-untyped-def]
    decay, read, drive, fresh, white_var, offset_var
):  # pragma: no cover - compiled
    """Kalman gains (n, states) and innovation standard deviations (n,); `drive` is the variance of each step."""
    n, k = decay.shape
    m = k + 1
    gains = np.zeros((n, m))
    std = np.zeros(n)
    P = np.zeros((m, m))
    ph = np.zeros(m)
    for i in range(n):
        for a in range(k):
            for b in range(k):
                P[a, b] *= decay[i, a] * decay[i, b]
            P[a, k] *= decay[i, a]
            P[k, a] = P[a, k]
            P[a, a] += drive[i, a]
        if fresh[i]:
            for a in range(m):
                P[a, k] = 0.0
                P[k, a] = 0.0
            P[k, k] = offset_var[i]
        s = white_var[i]
        for a in range(m):
            acc = P[a, k]
            for b in range(k):
                acc += P[a, b] * read[i, b]
            ph[a] = acc
        for b in range(k):
            s += read[i, b] * ph[b]
        s += ph[k]
        std[i] = np.sqrt(s)
        for a in range(m):
            gains[i, a] = ph[a] / s
        for a in range(m):
            for b in range(m):
                P[a, b] -= ph[a] * ph[b] / s
    return gains, std


@njit(cache=True, fastmath=True)
def _whiten_loops(decay, read, fresh, gains, std, X):  # type: ignore[no-untyped-def]  # pragma: no cover
    n, m = X.shape
    k = decay.shape[1]
    state = np.zeros((k + 1, m))
    out = np.empty((n, m))
    r = np.empty(m)
    for i in range(n):
        for c in range(m):
            r[c] = X[i, c]
        if fresh[i]:
            for c in range(m):
                state[k, c] = 0.0
        for a in range(k):
            f = decay[i, a]
            h = read[i, a]
            for c in range(m):
                state[a, c] *= f
                r[c] -= h * state[a, c]
        for c in range(m):
            r[c] -= state[k, c]
        for a in range(k + 1):
            g = gains[i, a]
            for c in range(m):
                state[a, c] += g * r[c]
        inverse = 1.0 / std[i]
        for c in range(m):
            out[i, c] = r[c] * inverse
    return out


@njit(cache=True)
def _colour_loops(decay, read, drive, flicker):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Sum of Ornstein-Uhlenbeck processes from standard normal draws, shape (k, n, m) in, (n, m) out."""
    k, n, m = drive.shape
    out = np.zeros((n, m))
    state = np.zeros(m)
    for a in range(k):
        for c in range(m):
            state[c] = flicker * drive[a, 0, c]
            out[0, c] += read[0, a] * state[c]
        for i in range(1, n):
            f = decay[i, a]
            g = flicker * np.sqrt(1.0 - f * f)
            for c in range(m):
                state[c] = f * state[c] + g * drive[a, i, c]
                out[i, c] += read[i, a] * state[c]
    return out


class NoiseModel:
    """Covariance of the rows of a record, but for its levels.

    Parameters
    ----------
    rows : Rows
        Its times, rates, data sets and relative white noise.
    """

    def __init__(self, rows: Rows) -> None:
        span_s = float(np.ptp(rows.t_s))
        longer = int(np.ceil(np.log10(max(span_s / TAUS_S[-1], 1.0))))
        taus = np.append(TAUS_S, TAUS_S[-1] * 10.0 ** np.arange(1, longer + 1))
        self.gap_s = np.diff(rows.t_s, prepend=rows.t_s[0])
        self.decay = np.exp(-self.gap_s[:, None] / taus)
        # A mean over T of an OU process scatters less than its points do; T = 0 reads the process itself.
        x = np.maximum(rows.averaging_s[:, None] / taus, 1e-6)
        self.read = np.sqrt(np.where(x < 1e-3, 1.0, 2.0 / x**2 * (x - 1.0 + np.exp(-x))))
        self.fresh = np.diff(rows.set_index, prepend=-1) != 0
        self.white_var = rows.white_std_dps**2
        self.rate_var = rows.rate_dps**2
        self.typical_white = float(np.sqrt(np.median(self.white_var)))
        self.turns = bool(np.any(rows.rate_dps != 0))

    def whiten(self, levels: NoiseLevels, X: Floats) -> tuple[Floats, Floats]:
        """Whitened columns, shape (n, m), and the standard deviations of the innovations, shape (n,)."""
        decay, read, gains, std = self._filter(levels)
        return _whiten_loops(decay, read, self.fresh, gains, std, np.ascontiguousarray(X)), std

    def _filter(self, levels: NoiseLevels) -> tuple[Floats, Floats, Floats, Floats]:
        decay, read, drive = self.states(levels)
        white_var, offset_var = levels.white**2 * self.white_var, levels.jitter**2 * self.rate_var
        return decay, read, *_gains(decay, read, drive, self.fresh, white_var, offset_var)

    def states(self, levels: NoiseLevels) -> tuple[Floats, Floats, Floats]:
        """Decay, reading and variance of each step of the slow states, shape (n, states); the walk's is the last."""
        before = np.concatenate([np.zeros((1, self.decay.shape[1])), self.decay[1:]])
        drive = (1.0 - before**2) * levels.flicker_dps**2
        if not levels.walk:
            return self.decay, self.read, drive
        ones = np.ones(self.gap_s.size)
        step = levels.walk**2 * self.gap_s
        decay, read = np.column_stack([self.decay, ones]), np.column_stack([self.read, ones])
        return decay, read, np.column_stack([drive, step])

    def simulate(self, levels: NoiseLevels, rng: np.random.Generator, count: int) -> Floats:
        """Draws of the noise at the rows, deg/s, shape (n, count)."""
        n, k = self.decay.shape
        flicker = _colour_loops(self.decay, self.read, rng.standard_normal((k, n, count)), levels.flicker_dps)
        white = levels.white * np.sqrt(self.white_var)[:, None] * rng.standard_normal((n, count))
        first = np.flatnonzero(self.fresh)
        size = levels.jitter * np.sqrt(self.rate_var[first])[:, None]
        offset = size * rng.standard_normal((first.size, count))
        noise = flicker + white + offset[np.cumsum(self.fresh) - 1]
        if levels.walk:
            steps = np.sqrt(self.gap_s)[:, None] * rng.standard_normal(noise.shape)
            noise += levels.walk * np.cumsum(steps, axis=0)
        return np.asarray(noise)


@dataclass(frozen=True)
class Likelihood:
    """Generalised least squares at given noise levels.

    Attributes
    ----------
    levels : NoiseLevels
    reml : float
        Log-likelihood of the noise levels with the coefficients integrated out.
    """

    levels: NoiseLevels
    reml: float


def _ratios(levels: NoiseLevels, model: NoiseModel) -> Floats:
    """Logarithms of flicker, jitter and walk in units of the white noise, shape (3,)."""
    unit = levels.white * model.typical_white
    raw = np.array([levels.flicker_dps / unit, levels.jitter / levels.white, levels.walk / unit])
    return np.asarray(np.log(np.maximum(raw, np.exp(_LOWEST))))


def _evaluate(model: NoiseModel, ratios: Floats, yX: Floats) -> Likelihood:
    """Likelihood at `_ratios`, with the white level profiled out; two ratios are without a walk."""
    size = np.exp(ratios)
    walk = size[2] * model.typical_white if ratios.size > 2 and ratios[2] > _LOWEST[2] else 0.0
    base = NoiseLevels(1.0, float(size[0]) * model.typical_white, float(size[1]), float(walk))
    white, std = model.whiten(base, yX)
    n, p = white.shape[0], white.shape[1] - 1
    gram = white.T @ white
    bad = Likelihood(base, -np.inf)
    try:
        scale = np.sqrt(np.diag(gram)[1:])
        scale[scale == 0] = 1.0
        factor = cho_factor(gram[1:, 1:] / np.outer(scale, scale) + 1e-10 * np.eye(p), lower=True)
        solved = cho_solve(factor, gram[1:, 0] / scale)
    except LinAlgError:
        return bad
    rss = float(gram[0, 0] - (gram[1:, 0] / scale) @ solved)
    if rss <= 0:
        return bad
    log_std = float(np.log(std).sum())
    log_gram = float(2.0 * np.log(np.diag(factor[0])).sum() + 2.0 * np.log(scale).sum())
    variance = rss / (n - p)
    reml = -0.5 * ((n - p) * (np.log(variance) + 1.0) + 2.0 * log_std + log_gram)
    q = float(np.sqrt(variance))
    return Likelihood(NoiseLevels(q, q * base.flicker_dps, q * base.jitter, q * base.walk), reml)


def _climb(model: NoiseModel, yX: Floats, first: Floats, step: float) -> Likelihood:
    """The most likely levels near `first`; jitter stays where it is in a record at rest."""
    free = np.ones(first.size, dtype=bool) if model.turns else np.arange(first.size) != 1
    low, high = _LOWEST[: first.size], _HIGHEST[: first.size]

    def at(x: Floats) -> Floats:
        ratios = first.copy()
        ratios[free] = x
        return ratios

    def loss(x: Floats) -> float:
        inside = np.clip(at(x), low, high)
        value = _evaluate(model, inside, yX).reml
        return -value + float(np.sum((at(x) - inside) ** 2)) if np.isfinite(value) else 1e12

    start = first[free]
    best = minimize(
        loss,
        start,
        method="Nelder-Mead",
        options={
            "xatol": 0.03,
            "fatol": 0.05,
            "maxfev": 30 * start.size,
            "initial_simplex": start + step * np.vstack([np.zeros(start.size), np.eye(start.size)]),
        },
    )
    peak = np.clip(at(best.x), low, high)
    return _evaluate(model, _expected_jitter(model, yX, peak) if model.turns else peak, yX)


def _expected_jitter(model: NoiseModel, yX: Floats, peak: Floats) -> Floats:
    """The ratios with the expected jitter for the likeliest, where the record hardly tells it from none.

    The likelihood of a small variance is often highest at zero and no less likely far above it; at zero, tests of
    what grows with rate would be too sure. The mean of a posterior with a flat prior is neither.
    """
    rows_a_set = np.bincount(np.cumsum(model.fresh) - 1)
    unit = model.typical_white / np.sqrt(np.median(rows_a_set)) / np.sqrt(np.max(model.rate_var))
    if np.exp(peak[1]) > _SURE_JITTER * unit:
        return peak
    grid = unit * np.linspace(0.0, 2.0 * _SURE_JITTER, 9)[1:]
    trials = [np.concatenate([peak[:1], [np.log(jitter)], peak[2:]]) for jitter in grid]
    logl = np.array([_evaluate(model, r, yX).reml for r in trials])
    share = np.exp(logl - logl.max())
    return np.concatenate([peak[:1], [np.log(share @ grid / share.sum())], peak[2:]])


def estimate_levels(model: NoiseModel, y: Floats, X: Floats) -> Likelihood:
    """Noise levels by restricted maximum likelihood, with the columns of X as unknown mean.

    Parameters
    ----------
    y : ndarray, shape (n,)
    X : ndarray, shape (n, p)
        May be nearly collinear; a small ridge takes care of it.
    """
    yX = np.column_stack([y, X])
    jitters = np.log([3e-6, 1e-4]) if model.turns else [np.log(1e-9)]
    trials = [np.array([a, b]) for a in np.log([0.05, 0.3, 2.0]) for b in jitters]
    return _climb(model, yX, max(trials, key=lambda r: _evaluate(model, r, yX).reml), 0.7)


def look_for_walk(model: NoiseModel, y: Floats, X: Floats, without: Likelihood) -> tuple[NoiseLevels, float]:
    """Levels with a rate random walk, and the p-value of the walk; without one where there is no likely one.

    Parameters
    ----------
    without : Likelihood
        The best without a walk.
    """
    yX = np.column_stack([y, X])
    first = _ratios(without.levels, model)
    span_s = max(float(model.gap_s.sum()), 1.0)
    # Walks that end one to eight times as far off as the flicker is large, with less flicker beside them.
    trials = [
        np.array([first[0] + np.log(less), first[1], first[0] + np.log(far) - 0.5 * np.log(span_s)])
        for far in (1.0, 3.0, 8.0)
        for less in (1.0, 0.4)
    ]
    likelihoods = [_evaluate(model, r, yX).reml for r in trials]
    if max(likelihoods) < without.reml - _HOPELESS:
        return without.levels, 1.0
    found = _climb(model, yX, trials[int(np.argmax(likelihoods))], 0.3)
    return found.levels, walk_p_value(found, without)


def walk_p_value(found: Likelihood, without: Likelihood) -> float:
    """A walk from nothing is a variance at the edge of what it can be: half a chi-square of one degree of freedom."""
    return 0.5 * float(chi2.sf(max(2.0 * (found.reml - without.reml), 0.0), 1))
