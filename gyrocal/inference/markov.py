"""Noise with a memory as a Gaussian Markov field: exact likelihood and generalised least squares in linear time.

States that each remember only their last value make the precision of all states together block tridiagonal, so that one
Cholesky factor of the band gives ``log|V|``, ``Z' V^-1 Z`` and ``V^-1 y`` of the observations without any dense matrix
(Rue and Held, Gaussian Markov Random Fields, 2005, section 2.4; the inverse by Woodbury's identity).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import optimize

Floats = NDArray[np.float64]

#: Steps of the search for levels at the most.
_ITERATIONS = 40
#: Step of the difference gradients, of logarithms, and what counts as no progress, of -2 log likelihood.
_STEP, _CONVERGED = 1e-3, 1e-3
#: How far to either side of the maximum its width is looked at, of what a level may be off by beforehand.
_LOOKED = 0.5
#: Stands for the loss of levels that no matrix can be made of; larger than any loss.
_IMPOSSIBLE = 1e12


@dataclass(frozen=True)
class MarkovField:
    """``x_k = keep_k x_(k-1) + N(0, push_k)`` and ``y_k = before_k x_(k-1) + after_k x_k + N(0, noise_k)``, k = 1..n.

    Attributes
    ----------
    start : ndarray, shape (s,)
        Variances of the states at node 0.
    keep, push, before, after : ndarray, shape (n, s)
        Factors, variances of the pushes, and weights of the states in each observation.
    noise : ndarray, shape (n,)
        Variances of the white noise of the observations.
    """

    start: Floats
    keep: Floats
    push: Floats
    before: Floats
    after: Floats
    noise: Floats

    def given(self, columns: Floats) -> Given:
        """The field with its states integrated out, looked at through `columns`, shape (n, m).

        Raises
        ------
        numpy.linalg.LinAlgError
            Variances so far apart, or none, that rounding leaves no positive definite matrix.
        """
        lower, below, states = _eliminate(
            self.start, self.keep, self.push, self.before, self.after, self.noise, columns
        )
        if not np.all(np.isfinite(states)):
            raise np.linalg.LinAlgError("the precision of the states is not positive definite")
        log_det = sum(float(np.sum(np.log(v))) for v in (self.start, self.push, self.noise))
        log_det += 2.0 * float(np.sum(np.log(np.einsum("kss->ks", lower))))
        told = states.reshape(-1, columns.shape[1])
        gram = columns.T @ (columns / self.noise[:, None]) - told.T @ told
        return Given(self, columns, log_det, 0.5 * (gram + gram.T), lower, below, states)


@dataclass(frozen=True)
class Given:
    """Columns under the covariance V of the observations of a field.

    Attributes
    ----------
    log_det : float
        ``log|V|``.
    gram : ndarray, shape (m, m)
        ``columns' V^-1 columns``.
    """

    field: MarkovField
    columns: Floats
    log_det: float
    gram: Floats
    lower: Floats
    below: Floats
    states: Floats

    def inverse(self) -> Floats:
        """``V^-1 columns``, shape (n, m)."""
        f = self.field
        states = _substitute(self.lower, self.below, self.states)
        told = np.einsum("ks,ksm->km", f.after, states[1:]) + np.einsum("ks,ksm->km", f.before, states[:-1])
        return np.asarray((self.columns - told) / f.noise[:, None])


@njit(cache=True, error_model="numpy")
def _eliminate(
    start: Floats, keep: Floats, push: Floats, before: Floats, after: Floats, noise: Floats, columns: Floats
) -> tuple[Floats, Floats, Floats]:  # pragma: no cover - compiled
    """Blocks of the Cholesky factor, on and below its diagonal, and the forward substitution of the columns."""
    n, s = keep.shape
    m = columns.shape[1]
    lower, below, out = np.zeros((n + 1, s, s)), np.zeros((n + 1, s, s)), np.zeros((n + 1, s, m))
    block = np.zeros((s, s))
    for k in range(n + 1):
        for a in range(s):
            for b in range(a + 1):
                block[a, b] = 0.0
                if k > 0:
                    block[a, b] += after[k - 1, a] * after[k - 1, b] / noise[k - 1]
                if k < n:
                    block[a, b] += before[k, a] * before[k, b] / noise[k]
            block[a, a] += 1.0 / (start[a] if k == 0 else push[k - 1, a])
            if k < n:
                block[a, a] += keep[k, a] ** 2 / push[k, a]
            for j in range(m):
                if k > 0:
                    out[k, a, j] += after[k - 1, a] * columns[k - 1, j] / noise[k - 1]
                if k < n:
                    out[k, a, j] += before[k, a] * columns[k, j] / noise[k]
        if k > 0:
            # Row by row: below[k] lower[k-1]' is the block of the precision beside the diagonal.
            for a in range(s):
                for b in range(s):
                    value = after[k - 1, a] * before[k - 1, b] / noise[k - 1]
                    if a == b:
                        value -= keep[k - 1, a] / push[k - 1, a]
                    for c in range(b):
                        value -= below[k, a, c] * lower[k - 1, b, c]
                    below[k, a, b] = value / lower[k - 1, b, b]
            for a in range(s):
                for b in range(a + 1):
                    for c in range(s):
                        block[a, b] -= below[k, a, c] * below[k, b, c]
                for c in range(s):
                    for j in range(m):
                        out[k, a, j] -= below[k, a, c] * out[k - 1, c, j]
        for a in range(s):
            for b in range(a + 1):
                value = block[a, b]
                for c in range(b):
                    value -= lower[k, a, c] * lower[k, b, c]
                lower[k, a, b] = np.sqrt(value) if a == b else value / lower[k, b, b]
            for c in range(a):
                for j in range(m):
                    out[k, a, j] -= lower[k, a, c] * out[k, c, j]
            for j in range(m):
                out[k, a, j] /= lower[k, a, a]
    return lower, below, out


@njit(cache=True, error_model="numpy")
def _substitute(lower: Floats, below: Floats, states: Floats) -> Floats:  # pragma: no cover - compiled
    """Backward substitution: the states that belong to the columns."""
    count, s, m = states.shape
    out = states.copy()
    for k in range(count - 1, -1, -1):
        if k < count - 1:
            for a in range(s):
                for c in range(s):
                    for j in range(m):
                        out[k, a, j] -= below[k + 1, c, a] * out[k + 1, c, j]
        for a in range(s - 1, -1, -1):
            for c in range(a + 1, s):
                for j in range(m):
                    out[k, a, j] -= lower[k, c, a] * out[k, c, j]
            for j in range(m):
                out[k, a, j] /= lower[k, a, a]
    return out


def restricted_loss(field: MarkovField, y: Floats, columns: Floats) -> float:
    """-2 log of the likelihood of `y`, shape (n,), with the coefficients of `columns`, (n, m), integrated out (REML).

    LinAlgError where the columns depend on each other, or as `MarkovField.given`.
    """
    given = field.given(np.column_stack([columns, y]))
    lower = np.linalg.cholesky(given.gram)
    return given.log_det + 2.0 * float(np.sum(np.log(np.diag(lower)[:-1]))) + float(lower[-1, -1] ** 2)


def restricted_maximum(
    field_of: Callable[[Floats], MarkovField],
    y: Floats,
    columns: Floats,
    prior: Floats,
    spread: Floats,
    first: Floats,
) -> tuple[Floats, Floats]:
    """Logarithms of the noise's levels that maximise the restricted likelihood times a normal prior.

    Parameters
    ----------
    field_of : callable
        Field for logarithms of levels, shape (p,).
    y, columns : ndarray, shapes (n,), (n, m)
    prior, spread : ndarray, shape (p,)
        Mean and standard deviation of each logarithm beforehand.
    first : ndarray, shape (p,)
        Where the search begins.

    Returns
    -------
    logs, left : ndarray, shape (p,)
        The logarithms, and the standard deviation that is left to each beside the others.
    """
    # Columns of unit size: only their span matters, and the Gram matrix stays well conditioned.
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)

    def loss(levels: Floats) -> float:
        beforehand = float(np.sum(((levels - prior) / spread) ** 2))
        try:
            return restricted_loss(field_of(levels), y, scaled) + beforehand
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE

    limits = [(m - 6.0 * s, m + 6.0 * s) for m, s in zip(prior, spread, strict=True)]
    found = optimize.minimize(
        loss,
        first,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": _ITERATIONS, "eps": _STEP, "ftol": _CONVERGED / max(abs(loss(first)), 1.0)},
    )
    steps = _LOOKED * np.diag(spread)
    rises = [0.5 * (loss(found.x + h) + loss(found.x - h)) - found.fun for h in steps]
    left = [min(_LOOKED * s / max(rise, 1e-9) ** 0.5, s) for s, rise in zip(spread, rises, strict=True)]
    return np.asarray(found.x), np.array(left)
