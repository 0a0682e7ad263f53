"""Noise with a memory as a Gaussian Markov field: exact likelihood and generalised least squares in linear time.

States that each remember only their last value make the precision of all states together block tridiagonal, so that one
Cholesky factor of the band gives ``log|V|``, ``Z' V^-1 Z`` and ``V^-1 y`` of the observations without any dense matrix
(Rue and Held, Gaussian Markov Random Fields, 2005, section 2.4; the inverse by Woodbury's identity).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from gyrocal.inference.compiled import njit

Floats = NDArray[np.float64]

#: Steps of the search for levels at the most.
_ITERATIONS = 40
#: Step of logarithms of levels by which the field is seen to change, and what counts as no progress, of -2 log likelihood.
_STEP, _CONVERGED = 1e-5, 1e-3
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
        f, means = self.field, self._means()
        seen = np.einsum("ks,ksm->km", f.after, means[1:]) + np.einsum("ks,ksm->km", f.before, means[:-1])
        return np.asarray((self.columns - seen) / f.noise[:, None])

    def inverse_diagonal(self) -> Floats:
        """Diagonal of ``V^-1``, shape (n,)."""
        f = self.field
        *_, of_seen = _spread(self.lower, self.below, f.keep, f.before, f.after)
        return np.asarray((1.0 - of_seen / f.noise) / f.noise)

    def _means(self, mixed: Floats | None = None) -> Floats:
        """Means of the states given each of the columns, or each mixture of them (shape (m, q)): shape (n + 1, s, q)."""
        states = self.states if mixed is None else self.states @ mixed
        return np.asarray(_substitute(self.lower, self.below, states))

    def restricted_loss(self) -> float:
        """-2 log of the likelihood of the last column with the coefficients of the others integrated out (REML)."""
        lower = np.linalg.cholesky(self.gram)
        return self.log_det + 2.0 * float(np.sum(np.log(np.diag(lower)[:-1]))) + float(lower[-1, -1] ** 2)

    def restricted_slope(self) -> MarkovSlope:
        """Slope of `restricted_loss` along the logarithms of the field's variances, and along what its states keep.

        Of each independent normal of variance v it is 1 less its mean square given the observations, in v (Fisher's
        identity: Louis, J. R. Stat. Soc. B 44, 1982); along a factor it is -2 times the mean product, given the
        observations, of the push and the state before, over v. The means of squares and products are those of the means,
        the variances beside known coefficients, and what is not known of the coefficients.
        """
        f, lower = self.field, np.linalg.cholesky(self.gram)
        # Columns of unit information, that have nothing in common, and what they leave of the last.
        mixed = np.linalg.inv(lower).T
        mixed[:, -1] *= lower[-1, -1]
        means = self._means(mixed)
        of_start, of_push, of_keep, of_noise = _spread(self.lower, self.below, f.keep, f.before, f.after)
        of_start += np.sum(means[0] ** 2, axis=1)
        _add_means(of_push, of_keep, of_noise, means, self.columns @ mixed, f.keep, f.before, f.after)
        return MarkovSlope(
            1.0 - of_start / f.start,
            -2.0 * of_keep / f.push,
            1.0 - of_push / f.push,
            1.0 - of_noise / f.noise,
        )


@dataclass(frozen=True)
class MarkovSlope:
    """Slope along the logarithm of each variance of a field, and along each factor; shapes as in `MarkovField`."""

    start: Floats
    keep: Floats
    push: Floats
    noise: Floats

    def along(self, field: MarkovField, moved: MarkovField) -> float:
        """By how much it rises from a field to one near it, to first order."""
        rises = _along(self.keep, self.push, field.keep, field.push, moved.keep, moved.push)
        starts, noises = moved.start / field.start - 1.0, moved.noise / field.noise - 1.0
        return float(self.start @ starts + rises + self.noise @ noises)


@njit(cache=True, error_model="numpy")
def _eliminate(
    start: Floats, keep: Floats, push: Floats, before: Floats, after: Floats, noise: Floats, columns: Floats
) -> tuple[Floats, Floats, Floats]:  # pragma: no cover - compiled
    """Blocks of the Cholesky factor, on and below its diagonal, and the forward substitution of the columns."""
    (n, s), m = keep.shape, columns.shape[1]
    lower, below, out = np.zeros((n + 1, s, s)), np.zeros((n + 1, s, s)), np.zeros((n + 1, s, m))
    block = np.zeros((s, s))
    for k in range(n + 1):
        own, beside, told = lower[k], below[k], out[k]
        for a in range(s):
            for b in range(a + 1):
                value = 0.0
                if k > 0:
                    value += after[k - 1, a] * after[k - 1, b] / noise[k - 1]
                if k < n:
                    value += before[k, a] * before[k, b] / noise[k]
                block[a, b] = value
            block[a, a] += 1.0 / (start[a] if k == 0 else push[k - 1, a])
            if k < n:
                block[a, a] += keep[k, a] ** 2 / push[k, a]
            if k > 0:
                weight = after[k - 1, a] / noise[k - 1]
                for j in range(m):
                    told[a, j] += weight * columns[k - 1, j]
            if k < n:
                weight = before[k, a] / noise[k]
                for j in range(m):
                    told[a, j] += weight * columns[k, j]
        if k > 0:
            last = lower[k - 1]
            # Row by row: below[k] lower[k-1]' is the block of the precision beside the diagonal.
            for a in range(s):
                for b in range(s):
                    value = after[k - 1, a] * before[k - 1, b] / noise[k - 1]
                    if a == b:
                        value -= keep[k - 1, a] / push[k - 1, a]
                    for c in range(b):
                        value -= beside[a, c] * last[b, c]
                    beside[a, b] = value / last[b, b]
            for a in range(s):
                for b in range(a + 1):
                    for c in range(s):
                        block[a, b] -= beside[a, c] * beside[b, c]
                for c in range(s):
                    weight = beside[a, c]
                    for j in range(m):
                        told[a, j] -= weight * out[k - 1, c, j]
        for a in range(s):
            for b in range(a + 1):
                value = block[a, b]
                for c in range(b):
                    value -= own[a, c] * own[b, c]
                own[a, b] = np.sqrt(value) if a == b else value / own[b, b]
            for c in range(a):
                weight = own[a, c]
                for j in range(m):
                    told[a, j] -= weight * told[c, j]
            for j in range(m):
                told[a, j] /= own[a, a]
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


@njit(cache=True, error_model="numpy")
def _spread(
    lower: Floats, below: Floats, keep: Floats, before: Floats, after: Floats
) -> tuple[Floats, Floats, Floats, Floats]:  # pragma: no cover - compiled
    """Variances of the states at node 0, of the pushes, and of what is seen of the states, given the observations.

    Before the last one: covariances of the pushes and the states before them.

    They need no more of the inverse of the precision than its blocks beside the diagonal, which follow from the last one
    (Takahashi's recursion; Rue and Held, section 2.2.5).
    """
    n, s = keep.shape
    of_push, of_keep, of_seen = np.zeros((n, s)), np.zeros((n, s)), np.zeros(n)
    own, last, beside = np.zeros((s, s)), np.zeros((s, s)), np.zeros((s, s))
    inverse, gain = np.zeros((s, s)), np.zeros((s, s))
    for k in range(n, -1, -1):
        for b in range(s):
            # Columns of the inverse of the triangle.
            for a in range(b, s):
                value = 1.0 if a == b else 0.0
                for c in range(b, a):
                    value -= lower[k, a, c] * inverse[c, b]
                inverse[a, b] = value / lower[k, a, a]
        if k < n:
            for a in range(s):
                for b in range(s):
                    gain[a, b] = 0.0
                for c in range(s):
                    for b in range(c + 1):
                        gain[a, b] += below[k + 1, a, c] * inverse[c, b]
            for a in range(s):
                for b in range(s):
                    beside[a, b] = 0.0
                for c in range(s):
                    for b in range(s):
                        beside[a, b] -= last[a, c] * gain[c, b]
        for a in range(s):
            for b in range(a + 1):
                value = 0.0
                for c in range(a, s):
                    value += inverse[c, a] * inverse[c, b]
                if k < n:
                    for c in range(s):
                        value -= gain[c, a] * beside[c, b]
                own[a, b] = own[b, a] = value
        if k < n:
            for a in range(s):
                fades = keep[k, a]
                of_push[k, a] = last[a, a] - 2.0 * fades * beside[a, a] + fades**2 * own[a, a]
                of_keep[k, a] = beside[a, a] - fades * own[a, a]
                for b in range(s):
                    of_seen[k] += (
                        after[k, a] * after[k, b] * last[a, b] + before[k, a] * before[k, b] * own[a, b]
                    )
                    of_seen[k] += 2.0 * after[k, a] * before[k, b] * beside[a, b]
        own, last = last, own
    return np.diag(last).copy(), of_push, of_keep, of_seen


@njit(cache=True, error_model="numpy")
def _add_means(
    of_push: Floats,
    of_keep: Floats,
    of_noise: Floats,
    means: Floats,
    columns: Floats,
    keep: Floats,
    before: Floats,
    after: Floats,
) -> None:  # pragma: no cover - compiled
    """Add what the means of the states, shape (n + 1, s, q), give to the variances and covariances of `_spread`."""
    (n, s), q = keep.shape, columns.shape[1]
    for k in range(n):
        for j in range(q):
            left = columns[k, j]
            for a in range(s):
                past, now = means[k, a, j], means[k + 1, a, j]
                push = now - keep[k, a] * past
                of_push[k, a] += push * push
                of_keep[k, a] += push * past
                left -= after[k, a] * now + before[k, a] * past
            of_noise[k] += left * left


@njit(cache=True, error_model="numpy")
def _along(
    of_keep: Floats, of_push: Floats, keep: Floats, push: Floats, kept: Floats, pushed: Floats
) -> float:  # pragma: no cover - compiled
    """What factors and pushes that are others, `kept` and `pushed`, make of the slopes along them."""
    rise = 0.0
    for k in range(keep.shape[0]):
        for a in range(keep.shape[1]):
            rise += of_keep[k, a] * (kept[k, a] - keep[k, a]) + of_push[k, a] * (
                pushed[k, a] / push[k, a] - 1.0
            )
    return rise


def restricted_maximum(
    field_of: Callable[[Floats], MarkovField],
    y: Floats,
    columns: Floats,
    prior: Floats,
    spread: Floats,
    first: Floats,
    asked: Sequence[int] | None = None,
) -> tuple[Floats, Floats]:
    """Logarithms of the noise's levels that maximise the restricted likelihood times a normal prior.

    Parameters
    ----------
    field_of : callable
        Field for logarithms of levels, shape (p,).
    y, columns : ndarray, shapes (n,), (n, m)
    prior, spread, first : ndarray, shape (p,)
        Mean and standard deviation of each logarithm beforehand, and where the search begins.
    asked : sequence of int, optional
        Places of the levels whose standard deviation is asked for: each costs two more likelihoods. Default: all.

    Returns
    -------
    logs, left : ndarray, shapes (p,), (q,)
        The logarithms, and the standard deviation that is left beside the others to each that is asked for.
    """
    # Columns of unit size: only their span matters, and the Gram matrix stays well conditioned.
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    both = np.column_stack([scaled, y])

    def loss(levels: Floats) -> float:
        beforehand = (levels - prior) / spread
        try:
            return field_of(levels).given(both).restricted_loss() + float(beforehand @ beforehand)
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE

    def loss_and_slope(levels: Floats) -> tuple[float, Floats]:
        field = field_of(levels)
        try:
            given = field.given(both)
            value, slope = given.restricted_loss(), given.restricted_slope()
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE, np.zeros_like(levels)
        moved = [field_of(levels + step) for step in _STEP * np.eye(levels.size)]
        beforehand = (levels - prior) / spread
        slopes = np.array([slope.along(field, near) for near in moved]) / _STEP + 2.0 * beforehand / spread
        return value + float(beforehand @ beforehand), slopes

    limits = [(m - 6.0 * s, m + 6.0 * s) for m, s in zip(prior, spread, strict=True)]
    found = optimize.minimize(
        loss_and_slope,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": _ITERATIONS, "ftol": _CONVERGED / max(abs(loss(first)), 1.0)},
    )
    places = list(range(prior.size) if asked is None else asked)
    return np.asarray(found.x), _widths(loss, found.x, found.fun, spread, places)


def _widths(
    loss: Callable[[Floats], float], at: Floats, least: float, spread: Floats, places: list[int]
) -> Floats:
    """Standard deviations of some levels beside the others, by how the loss rises to both sides of its least."""
    steps = _LOOKED * np.diag(spread)[places]
    rises = [0.5 * (loss(at + h) + loss(at - h)) - least for h in steps]
    # No level is known worse than beforehand.
    widths = _LOOKED * spread[places] / np.maximum(rises, 1e-9) ** 0.5
    return np.asarray(np.minimum(widths, spread[places]))
