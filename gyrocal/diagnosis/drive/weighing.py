"""What laws gain under the noise of a log: all tests are algebra on the inner products of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate

from gyrocal.diagnosis.drive.yaw import SPREAD, YawModel
from gyrocal.inference.markov import Given

Floats = NDArray[np.float64]

#: Levels of 1/f noise at which laws are weighed, in standard deviations of their logarithm from what is usual, and how
#: closely what lies between them is looked at.
_LEVELS, _BETWEEN = np.linspace(-3.0, 3.0, 9), np.linspace(-3.0, 3.0, 241)
#: What gives the cubic spline through values at the first at each of the second.
_SPLINE = interpolate.CubicSpline(_LEVELS, np.eye(_LEVELS.size))(_BETWEEN)


@dataclass(frozen=True)
class Gram:
    """All tests of a log: inner products of columns and difference under the noise, or under each of several.

    Attributes
    ----------
    names : tuple of str
    matrix : ndarray, shape (..., p, p)
        ``X' V^-1 X``, plus the inverse variances of what is known beforehand.
    right : ndarray, shape (..., p)
        ``X' V^-1 y``, plus the means of what is known over their variances.
    """

    names: tuple[str, ...]
    matrix: Floats = field(repr=False)
    right: Floats = field(repr=False)

    def knowing(self, known: Mapping[str, tuple[float, float]]) -> Gram:
        """The same with what is known of coefficients beforehand, as mean and standard deviation."""
        means, stds = np.array([known.get(n, (0.0, np.inf)) for n in self.names]).T
        return replace(self, matrix=self.matrix + np.diag(stds**-2), right=self.right + means * stds**-2)

    def less(self, names: Sequence[str], of: Sequence[str], shares: Floats) -> Gram:
        """The same with some columns less `shares`, one row for each of others, of these."""
        apart = np.eye(len(self.names))
        apart[np.ix_([self.names.index(n) for n in of], [self.names.index(n) for n in names])] = -shares
        return replace(self, matrix=apart.T @ self.matrix @ apart, right=self.right @ apart)

    def solve(self, chosen: Sequence[str]) -> tuple[Floats, Floats]:
        """Coefficients of some columns, and their covariance."""
        at = [self.names.index(n) for n in chosen]
        part = self.matrix[..., at, :][..., at]
        # Coefficients of many units: scaled, so that only true dependence counts as such.
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(part, axis1=-2, axis2=-1), 1e-300))
        scales = scale[..., :, None] * scale[..., None, :]
        covariance = np.linalg.pinv(part * scales, hermitian=True, rcond=1e-10) * scales
        return (covariance @ self.right[..., at, None])[..., 0], covariance

    def nearest(self, name: str, of: Sequence[str]) -> Floats:
        """Coefficients of other columns that come nearest to one, under the noise."""
        return replace(self, right=self.matrix[..., self.names.index(name)]).solve(of)[0]

    def gains(self, chosen: Sequence[str]) -> Floats:
        """Twice the log likelihood that some columns gain over none, under each noise."""
        at = [self.names.index(n) for n in chosen]
        return np.asarray(np.sum(self.right[..., at] * self.solve(chosen)[0], axis=-1))

    def gain(self, chosen: Sequence[str]) -> float:
        """The same under the one noise."""
        return float(self.gains(chosen))

    def added(self, chosen: Sequence[str], more: Sequence[str]) -> float:
        """Twice the log likelihood that columns add to others."""
        return self.gain([*chosen, *(n for n in more if n not in chosen)]) - self.gain(chosen)


def gram_of(model: YawModel, columns: Mapping[str, Floats]) -> Gram:
    """Inner products of columns, name -> (m,), under a model's noise."""
    return _gram(columns, model.given(_stacked(model, columns)))


def weighed_of(model: YawModel, columns: Mapping[str, Floats]) -> tuple[Gram, Floats]:
    """The same, and ``V^-1`` times the columns, shape (m, p)."""
    given = model.given(_stacked(model, columns))
    return _gram(columns, given), given.inverse()[:, :-1]


def _stacked(model: YawModel, columns: Mapping[str, Floats]) -> Floats:
    return np.column_stack([*columns.values(), model.y])


def _gram(columns: Mapping[str, Floats], given: Given) -> Gram:
    return Gram(tuple(columns), given.gram[:-1, :-1].copy(), given.gram[:-1, -1])


@dataclass(frozen=True)
class Evidence:
    """What laws gain where the 1/f noise of the bias may be whatever makes the log likeliest, with the laws and without.

    One log hardly tells that noise, and all that a law of the bias explains it would explain too, if it were strong enough:
    so it is found anew for each set of laws, held by what is usual.

    Attributes
    ----------
    own : Gram
        At the model's own level: coefficients and their covariance.
    levels : Gram
        At each of `_LEVELS`.
    loss : ndarray
        Twice the negative log likelihood at each without any law, and of the level itself.
    """

    own: Gram
    levels: Gram
    loss: Floats

    def knowing(self, known: Mapping[str, tuple[float, float]]) -> Evidence:
        """The same with what is known of coefficients beforehand, as mean and standard deviation."""
        return Evidence(self.own.knowing(known), self.levels.knowing(known), self.loss)

    def less(self, names: Sequence[str], of: Sequence[str], shares: Floats) -> Evidence:
        """The same with some columns less `shares`, one row for each of others, of these."""
        return Evidence(self.own.less(names, of, shares), self.levels.less(names, of, shares), self.loss)

    def added(self, chosen: Sequence[str], more: Sequence[str]) -> float:
        """Twice the log likelihood that columns add to others."""
        return self._least(chosen) - self._least([*chosen, *(n for n in more if n not in chosen)])

    def _least(self, chosen: Sequence[str]) -> float:
        return float(np.min(_SPLINE @ (self.loss - self.levels.gains(chosen))))


def evidence(model: YawModel, columns: Mapping[str, Floats]) -> Evidence:
    """Inner products of columns, name -> (m,), at all levels of 1/f noise that are possible."""
    stacked, spread = _stacked(model, columns), SPREAD["flicker_dps"]
    found = [model.given(stacked, model.usual.flicker_dps * float(np.exp(spread * k))) for k in _LEVELS]
    loss = [g.log_det + float(g.gram[-1, -1]) + k**2 for g, k in zip(found, _LEVELS, strict=True)]
    grams = [_gram(columns, g) for g in found]
    levels = Gram(tuple(columns), np.array([g.matrix for g in grams]), np.array([g.right for g in grams]))
    return Evidence(gram_of(model, columns), levels, np.array(loss))
