"""Noise of a recording and its whitening: white noise, 1/f bias noise, and a rate error of each data set.

The covariance is that of a state-space model (physics.md; physics-report.md, B.0): angle random walk over each
row's averaging time, a sum of Ornstein-Uhlenbeck processes of common amplitude (their spectrum adds up to 1/f),
and an offset that is drawn anew for each data set, proportional to the rate. A Kalman filter whitens the record
and every regression column in one pass; the restricted likelihood of its innovations gives the three levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize, minimize_scalar

from gyrocal.diagnosis.series import Series

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

try:
    from numba import njit

    HAVE_NUMBA = True
except ImportError:  # the same functions run as plain Python, on blocks of columns
    HAVE_NUMBA = False

    def njit(*_: Any, **__: Any) -> Any:  # type: ignore[no-redef]
        return lambda function: function


#: Correlation times of the bias noise, s.
TAUS_S = (2.0, 20.0, 200.0, 2000.0, 20000.0)
_STATES = len(TAUS_S) + 1


@dataclass(frozen=True)
class NoiseLevels:
    """The three levels of the noise model.

    Attributes
    ----------
    white : float
        Factor on the rows' own ``white_std_dps``.
    flicker_dps : float
        Standard deviation of each Ornstein-Uhlenbeck process, deg/s.
    jitter : float
        Standard deviation of the relative rate error of a data set.
    """

    white: float
    flicker_dps: float
    jitter: float


@njit(cache=True)
def _gains(  # type: ignore[no-untyped-def]
    decay, read, fresh, white_var, offset_var, flicker_var
):  # pragma: no cover - compiled
    """Kalman gains (n, states) and innovation standard deviations (n,) of the noise model."""
    n, k = decay.shape
    m = k + 1
    gains = np.zeros((n, m))
    std = np.zeros(n)
    P = np.zeros((m, m))
    for j in range(k):
        P[j, j] = flicker_var
    ph = np.zeros(m)
    for i in range(n):
        for a in range(k):
            for b in range(k):
                P[a, b] *= decay[i, a] * decay[i, b]
            P[a, k] *= decay[i, a]
            P[k, a] = P[a, k]
            P[a, a] += (1.0 - decay[i, a] * decay[i, a]) * flicker_var
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


def _whiten_numpy(
    decay: Floats, read: Floats, fresh: NDArray[np.bool_], gains: Floats, std: Floats, X: Floats
) -> Floats:
    """The same recursion with all columns at once, for where numba is not installed."""
    k = decay.shape[1]
    state = np.zeros((k + 1, X.shape[1]))
    out = np.empty_like(X)
    for i in range(X.shape[0]):
        if fresh[i]:
            state[k] = 0.0
        state[:k] *= decay[i][:, None]
        innovation = X[i] - read[i] @ state[:k] - state[k]
        state += gains[i][:, None] * innovation
        out[i] = innovation / std[i]
    return out


class NoiseModel:
    """Covariance of the rows of a series, but for its levels.

    Parameters
    ----------
    series : Series
        Its times, rates, data sets and relative white noise.
    """

    def __init__(self, series: Series) -> None:
        taus = np.array(TAUS_S)
        gap = np.diff(series.t_s, prepend=series.t_s[0])
        self.decay = np.exp(-gap[:, None] / taus)
        # A mean over T of an OU process scatters less than its points do; T = 0 reads the process itself.
        x = np.maximum(series.averaging_s[:, None] / taus, 1e-6)
        self.read = np.sqrt(np.where(x < 1e-3, 1.0, 2.0 / x**2 * (x - 1.0 + np.exp(-x))))
        self.fresh = np.diff(series.set_index, prepend=-1) != 0
        self.white_var = series.white_std_dps**2
        self.rate_var = series.rate_dps**2
        self.typical_white = float(np.sqrt(np.median(self.white_var)))
        self.turns = bool(np.any(series.rate_dps != 0))

    def whiten(self, levels: NoiseLevels, X: Floats) -> tuple[Floats, Floats]:
        """Whitened columns, shape (n, m), and the standard deviations of the innovations, shape (n,)."""
        gains, std = _gains(
            self.decay,
            self.read,
            self.fresh,
            levels.white**2 * self.white_var,
            levels.jitter**2 * self.rate_var,
            levels.flicker_dps**2,
        )
        run = _whiten_loops if HAVE_NUMBA else _whiten_numpy
        return run(self.decay, self.read, self.fresh, gains, std, np.ascontiguousarray(X)), std

    def simulate(self, levels: NoiseLevels, rng: np.random.Generator, count: int) -> Floats:
        """Draws of the noise at the rows, deg/s, shape (n, count)."""
        n, k = self.decay.shape
        flicker = _colour_loops(self.decay, self.read, rng.standard_normal((k, n, count)), levels.flicker_dps)
        white = levels.white * np.sqrt(self.white_var)[:, None] * rng.standard_normal((n, count))
        first = np.flatnonzero(self.fresh)
        size = levels.jitter * np.sqrt(self.rate_var[first])[:, None]
        offset = size * rng.standard_normal((first.size, count))
        return np.asarray(flicker + white + offset[np.cumsum(self.fresh) - 1])


@dataclass(frozen=True)
class Likelihood:
    """Generalised least squares at given noise levels.

    Attributes
    ----------
    levels : NoiseLevels
    reml, ml : float
        Log-likelihood of the noise levels with the coefficients integrated out, and at their estimate.
    """

    levels: NoiseLevels
    reml: float
    ml: float


def _evaluate(model: NoiseModel, ratios: Floats, yX: Floats) -> Likelihood:
    """Likelihood with the white level profiled out; `ratios` are log(flicker/white), log(jitter)."""
    base = NoiseLevels(1.0, float(np.exp(ratios[0])) * model.typical_white, float(np.exp(ratios[1])))
    white, std = model.whiten(base, yX)
    n, p = white.shape[0], white.shape[1] - 1
    gram = white.T @ white
    bad = Likelihood(base, -np.inf, -np.inf)
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
    ml = -0.5 * (n * (np.log(rss / n) + 1.0) + 2.0 * log_std)
    q = float(np.sqrt(variance))
    return Likelihood(NoiseLevels(q, q * base.flicker_dps, q * base.jitter), reml, ml)


def estimate_levels(model: NoiseModel, y: Floats, X: Floats, start: NoiseLevels | None = None) -> Likelihood:
    """Noise levels by restricted maximum likelihood, with the columns of X as unknown mean.

    Parameters
    ----------
    y : ndarray, shape (n,)
    X : ndarray, shape (n, p)
        May be nearly collinear; a small ridge takes care of it.
    start : NoiseLevels, optional
        Where to begin; a few evaluations suffice from a good start.
    """
    yX = np.column_stack([y, X])
    jitters = np.log([3e-6, 1e-4]) if model.turns else [np.log(1e-9)]
    if start is not None:
        first = np.array(
            [
                np.log(max(start.flicker_dps / start.white / model.typical_white, 1e-4)),
                np.log(max(start.jitter / start.white, 1e-7)),
            ]
        )
    else:
        trials = [np.array([a, b]) for a in np.log([0.05, 0.3, 2.0]) for b in jitters]
        first = max(trials, key=lambda r: _evaluate(model, r, yX).reml)

    def loss(r: Floats) -> float:
        inside = np.clip(r, [np.log(1e-5), np.log(1e-8)], [np.log(1e4), np.log(1.0)])
        value = _evaluate(model, inside, yX).reml
        return -value + float(np.sum((r - inside) ** 2)) if np.isfinite(value) else 1e12

    if not model.turns:
        ratio = float(first[0])
        flat = minimize_scalar(
            lambda a: loss(np.array([a, first[1]])),
            bounds=(ratio - 4.0, ratio + 4.0),
            method="bounded",
            options={"xatol": 0.01, "maxiter": 40},
        )
        return _evaluate(model, np.array([flat.x, first[1]]), yX)
    step = 0.3 if start is not None else 0.7
    simplex = first + step * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    best = minimize(
        loss,
        first,
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.02, "maxfev": 60, "initial_simplex": simplex},
    )
    return _evaluate(model, best.x, yX)
