"""The restricted likelihood of a sum of components in the space of error contrasts, with its slope and its bend.

References
----------
Harville, J. Am. Stat. Assoc. 72 (1977): derivatives.
Gilmour, Thompson and Cullis, Biometrics 51 (1995): average information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.inference.gls import inverse_of
from gyrocal.inference.newton import SETTLED

Floats = NDArray[np.float64]

#: Rate of the exponential prior of each component's standard deviation, relative to that of the record: large parts
#: that cancel each other are not believed where small ones do as well (Simpson et al., Stat. Sci. 32, 2017).
_PRIOR_RATE = 1.0
#: Leaps of the climb before Newton's steps, and how many times as far as its two steps one goes at the most.
_LEAPS, _FARTHEST = 2, 4.0
#: Added to the diagonal, relative to the mean of the diagonal, so that rounding cannot make a matrix indefinite.
JITTER = 1e-10


@dataclass(frozen=True)
class Part:
    """A component in the space of error contrasts, scaled to a mean diagonal of one."""

    name: str
    factor: Floats | None
    matrix: Floats | None
    scale: float
    expected: bool = False


@dataclass(frozen=True)
class Point:
    """The negative log-likelihood at some variances, for their logarithms, shape (k,).

    Attributes
    ----------
    value : float
        With the prior, nats.
    size : ndarray, shape (k,)
        Variances.
    trace, square : ndarray, shape (k,)
        For each component ``tr(A^-1 M)`` and ``y' A^-1 M A^-1 y``.
    doubt : ndarray, shape (k,)
        What the prior has against each.
    pulled : ndarray, shape (k, m)
        ``L^-1 M A^-1 y``, of the lower factor ``A = L L'``.
    """

    value: float
    size: Floats
    trace: Floats
    square: Floats
    doubt: Floats
    pulled: Floats

    @property
    def slope(self) -> Floats:
        """Of the value."""
        return np.asarray(0.5 * (self.size * (self.trace - self.square) + self.doubt))

    @property
    def bend(self) -> Floats:
        """Average information, shape (k, k), that of the prior beside it."""
        pulled = self.size[:, None] * self.pulled
        return np.asarray(0.5 * pulled @ pulled.T + 0.25 * np.diag(self.doubt))

    @property
    def idle(self) -> NDArray[np.bool_]:
        """Which components add nothing, shape (k,)."""
        return np.asarray(self.size * np.maximum(self.trace, self.square) < SETTLED)


class Likelihood:
    """Negative log-likelihood of the contrasts, for the logarithms of the variances."""

    def __init__(self, parts: Sequence[Part], left: Floats) -> None:
        self.left = left
        self.rate = np.array([0.0 if p.expected else _PRIOR_RATE for p in parts])
        self.with_columns = [k for k, p in enumerate(parts) if p.factor is not None]
        self.dense = [k for k, p in enumerate(parts) if p.matrix is not None]
        factors = [p.factor for p in parts if p.factor is not None]
        self.stacked = np.concatenate([*factors, left[:, None]], axis=1)
        self.columns = self.stacked[:, :-1]
        self.owner = np.repeat(self.with_columns, [f.shape[1] for f in factors]).astype(np.int64)
        # Each as a row.
        matrices = [p.matrix.ravel() for p in parts if p.matrix is not None]
        self.matrices = np.reshape(matrices, (len(self.dense), left.size**2))

    def _lower(self, logs: Floats) -> Floats:
        """Lower factor of the covariance of the contrasts, zero above the diagonal, shape (m, m)."""
        size = np.exp(logs)
        a = (size[self.dense] @ self.matrices).reshape(self.left.size, self.left.size)
        # BLAS takes no matrix without columns: the record is one of no variance.
        scaled = self.stacked * np.append(np.sqrt(size[self.owner]), 0.0)
        lower = linalg.blas.dsyrk(1.0, scaled.T, 1.0, a.T, trans=1, lower=1, overwrite_c=1)
        lower[np.diag_indices_from(lower)] += JITTER * np.trace(lower) / len(lower)
        factor, info = linalg.lapack.dpotrf(lower, lower=1, clean=1, overwrite_a=1)
        if info:
            raise linalg.LinAlgError("the covariance of the contrasts is not positive definite")
        return np.asarray(factor)

    def inverse(self, logs: Floats) -> Floats:
        """Inverse of the covariance."""
        return inverse_of(self._lower(logs))

    def at(self, logs: Floats) -> Point:
        """What it is there, and how it goes on."""
        lower = self._lower(logs)
        white = linalg.blas.dtrsm(1.0, lower, self.stacked.T, side=1, lower=1, trans_a=1)
        value = float(np.sum(np.log(np.diag(lower))) + 0.5 * white[-1] @ white[-1])
        weighted = linalg.blas.dtrsv(lower, white[-1], lower=1, trans=1)
        trace, square, pulled = np.zeros(logs.size), np.zeros(logs.size), np.zeros((logs.size, len(lower)))
        each = np.einsum("ij,ij->i", white[:-1], white[:-1])
        along = weighted @ self.columns
        begins = np.flatnonzero(np.diff(self.owner, prepend=-1))
        if begins.size:
            owners = self.owner[begins]
            trace[owners] = np.add.reduceat(each, begins)
            square[owners] = np.add.reduceat(along**2, begins)
            pulled[owners] = np.add.reduceat(white[:-1] * along[:, None], begins, axis=0)
        if self.dense:
            forced = self.matrices.reshape(-1, self.left.size, self.left.size) @ weighted
            square[self.dense] = forced @ weighted
            pulled[self.dense] = linalg.blas.dtrsm(1.0, lower, forced, side=1, lower=1, trans_a=1)
        # Below the diagonal the inverse, above it zeros.
        below = linalg.lapack.dpotri(lower, lower=1, overwrite_c=1)[0]
        twice = 2.0 * (self.matrices @ below.T.ravel())
        trace[self.dense] = twice - self.matrices[:, :: len(below) + 1] @ np.diag(below)
        size = np.exp(logs)
        doubt = self.rate * np.sqrt(size)
        return Point(value + float(np.sum(doubt)), size, trace, square, doubt, pulled)


def climb(likelihood: Likelihood, logs: Floats, bounds: Floats) -> Floats:
    """Some leaps towards more likelihood, from anywhere.

    Two steps that cannot lose any (Zhou et al., J. Comput. Graph. Stat. 28, 2019) tell how far their path goes on (scheme S3 of
    Varadhan and Roland, Scand. J. Stat. 35, 2008).
    """
    logs = np.clip(logs, *bounds.T)
    for _ in range(_LEAPS):
        once = _stepped(likelihood, logs, bounds)
        twice = _stepped(likelihood, once, bounds)
        first, bent = once - logs, twice - 2.0 * once + logs
        straight = linalg.norm(first) / max(linalg.norm(bent), np.finfo(float).tiny)
        length = float(np.clip(straight, 1.0, _FARTHEST))
        logs = np.clip(logs + 2.0 * length * first + length**2 * bent, *bounds.T)
    return logs


def _stepped(likelihood: Likelihood, logs: Floats, bounds: Floats) -> Floats:
    here = likelihood.at(logs)
    ratio = np.maximum(here.square, 1e-30) / np.maximum(here.trace, 1e-30)
    return np.clip(logs + 0.5 * np.log(ratio), *bounds.T)
