"""Generalised least squares with dense noise, beside what is known beforehand, and the restricted likelihood of that noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """What columns explain of a record.

    Attributes
    ----------
    values : ndarray, shape (p,)
        Amplitudes of the columns.
    covariance : ndarray, shape (p, p)
    loss : float
        ``log|V| + log|X' V^-1 X| + r' V^-1 r``: minus twice the restricted log-likelihood (Patterson, Thompson 1971),
        but for a constant.
    left : float
        The last of the three: what remains of the record, and of what was known, in variances.
    """

    values: Floats
    covariance: Floats
    loss: float
    left: float


def regress(
    noise: Floats, columns: Floats, y: Floats, mean: Floats | None = None, std: Floats | None = None
) -> Regression:
    """Amplitudes of columns in noise that is known.

    Parameters
    ----------
    noise : ndarray, shape (n, n)
        Covariance of the record; LinAlgError where it is none.
    columns : ndarray, shape (n, p)
    y : ndarray, shape (n,)
    mean, std : ndarray, shape (p,), optional
        What is known of each amplitude beforehand; a `std` that is infinite for nothing. Needed where columns alone do
        not tell amplitudes apart.
    """
    lower, triangle = _triangle(noise, columns, y, mean, std)
    inverse = linalg.solve_triangular(triangle[:-1, :-1], np.eye(columns.shape[1]))
    left = float(triangle[-1, -1]) ** 2
    return Regression(inverse @ triangle[:-1, -1], inverse @ inverse.T, _loss(lower, triangle), left)


def restricted_loss(noise: Floats, columns: Floats, y: Floats) -> float:
    """The loss of `regress` alone, for the same input."""
    return _loss(*_triangle(noise, columns, y, None, None))


@dataclass(frozen=True)
class Levels:
    """The restricted likelihood for the logarithms of the levels that some parts of the noise have.

    Attributes
    ----------
    value : float
        Half of the loss.
    slope : ndarray, shape (k,)
    bend : ndarray, shape (k, k)
        Average information (Gilmour, Thompson and Cullis, Biometrics 51, 1995).
    """

    value: float
    slope: Floats
    bend: Floats


def restricted_levels(
    rest: Floats, parts: Sequence[Floats], columns: Floats, y: Floats, mean: Floats, std: Floats
) -> Levels:
    """Half the loss of `regress` where the noise is some parts and a rest, shape (n, n) each, and how it follows their sizes."""
    lower, triangle = _triangle(np.asarray(sum(parts, rest)), columns, y, mean, std)
    inverse = np.linalg.inv(triangle[:-1, :-1])
    values = inverse @ triangle[:-1, -1]
    precision = inverse_of(lower)
    # Columns that have nothing in common, of which as much is known as of what is asked.
    known = precision @ columns @ inverse
    left = precision @ (y - columns @ values)
    pulled = np.stack([part @ left for part in parts])
    trace = [float(np.sum(precision * part) - np.sum(known * (part @ known))) for part in parts]
    along = pulled @ known
    bend = 0.5 * (pulled @ precision @ pulled.T - along @ along.T)
    return Levels(0.5 * _loss(lower, triangle), 0.5 * (np.array(trace) - pulled @ left), bend)


def inverse_of(lower: Floats) -> Floats:
    """Inverse of a matrix from its lower Cholesky factor, which is zero above the diagonal."""
    below = linalg.lapack.dpotri(lower, lower=1)[0]
    return np.asarray(below + np.tril(below, -1).T)


def _triangle(
    noise: Floats, columns: Floats, y: Floats, mean: Floats | None, std: Floats | None
) -> tuple[Floats, Floats]:
    """Lower factor of the noise, and the triangle of columns and record in white noise, shape (p + 1, p + 1)."""
    lower = linalg.cholesky(noise, lower=True, check_finite=False)
    white = linalg.solve_triangular(lower, np.column_stack([columns, y]), lower=True, check_finite=False)
    if mean is not None and std is not None:
        white = np.vstack([white, np.column_stack([np.diag(1.0 / std), mean / std])])
    return lower, np.asarray(np.linalg.qr(white, mode="r"))


def _loss(lower: Floats, triangle: Floats) -> float:
    size = np.abs(np.diag(triangle))
    # The last element is what remains of the record.
    return 2.0 * float(np.log(np.diag(lower)).sum() + np.log(size[:-1]).sum()) + float(size[-1]) ** 2
