"""Covariance of data-set means: what their scatter is made of, estimated from the scatter itself.

``V = diag(std^2/n) + white I + flicker K(t) + jitter diag(rate^2)``

- ``std^2/n``: sample noise (angle random walk), known from each data set;
- ``white``: what independent scatter there is beyond it (all of it where a table gives no ``std`` and ``n``);
- ``flicker``: 1/f bias noise, a sum of Ornstein-Uhlenbeck processes a decade apart with one common variance,
  averaged over the window of each data set; it correlates neighbours in time;
- ``jitter``: a rate error of the table, independent from data set to data set, proportional to the rate.

The three levels are estimated by restricted maximum likelihood (Patterson, Thompson 1971), which allows for the
coefficients that the same data have to give.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from gyrocal.calibration.datasets import DataSets

Floats = NDArray[np.float64]

#: Names of the estimated levels, in the order of `Scatter.levels`.
PARTS = ("white", "flicker", "jitter")

#: Time constants of the Ornstein-Uhlenbeck sum, s: a decade apart they add up to 1/f within 6 %.
TIME_CONSTANTS_S = (2.0, 20.0, 200.0, 2000.0, 20000.0)

#: Without times the order of the data sets stands for them; time constants in data sets.
TIME_CONSTANTS_SETS = (1.0, 10.0, 100.0, 1000.0)

#: Without times a step of temperature of this share of the span was a soak, taken to last this many data sets:
#: half an hour against 20 s. Left out, drift between temperatures would pass for structure in temperature.
_SOAK_STEP = 0.05
_SOAK_SETS = 100.0

#: A level below this share of the scatter is none.
_NOTHING = 1e-6

#: Relative variance of arithmetic: nothing is known better.
_ROUNDING = 1e-22


@dataclass(frozen=True)
class Scatter:
    """Estimated levels of the scatter and the covariance they make.

    Attributes
    ----------
    levels : ndarray, shape (3,)
        ``white`` in (deg/s)^2, ``flicker`` in (deg/s)^2 for each decade, ``jitter`` relative, squared.
    information : ndarray, shape (3, 3)
        Average information of the levels (Gilmour, Thompson, Cullis 1995); zero rows where a level is none.
    matrix : ndarray, shape (n, n), (deg/s)^2
    parts : tuple of ndarray, shape (n, n) or (n,) for a diagonal
        Derivative of the matrix by each level.
    design : ndarray, shape (n, p)
        Columns of the model that the levels were estimated beside.
    timed : bool
        Whether times were known; else the order stood for them.
    """

    levels: Floats
    information: Floats
    matrix: Floats
    parts: tuple[Floats, ...]
    design: Floats
    timed: bool

    @property
    def white_dps(self) -> float:
        """Standard deviation of independent scatter beyond sample noise."""
        return float(np.sqrt(self.levels[0]))

    @property
    def flicker_dps(self) -> float:
        """Standard deviation of the bias for each decade of time."""
        return float(np.sqrt(self.levels[1]))

    @property
    def jitter(self) -> float:
        """Relative rate error from data set to data set."""
        return float(np.sqrt(self.levels[2]))


def flicker_correlation(t_s: Floats, duration_s: Floats, time_constants: tuple[float, ...]) -> Floats:
    """Covariance of window means of a sum of unit Ornstein-Uhlenbeck processes, shape (n, n).

    Exact for windows that do not overlap: the mean of ``exp(-|t - s| / tau)`` over both windows.
    """
    gap = np.abs(t_s[:, None] - t_s[None, :]) - 0.5 * (duration_s[:, None] + duration_s[None, :])
    total = np.zeros_like(gap)
    for tau in time_constants:
        share = duration_s / tau
        window = -np.expm1(-share) / share
        covariance = np.exp(-np.maximum(gap, 0.0) / tau) * window[:, None] * window[None, :]
        np.fill_diagonal(covariance, 2.0 * (share + np.expm1(-share)) / share**2)
        total += covariance
    return total


def scatter_parts(sets: DataSets) -> tuple[Floats, tuple[Floats, ...], bool]:
    """Known variances, shape (n,), the parts of `PARTS` (1-d: a diagonal), and whether times are known."""
    known = sets.mean_variance_dps2
    known = np.where(np.isfinite(known), known, 0.0)
    if sets.timed:
        duration = np.where(np.isfinite(sets.duration_s) & (sets.duration_s > 0), sets.duration_s, 1.0)
        correlation = flicker_correlation(sets.t_s, duration, TIME_CONSTANTS_S)
    else:
        correlation = flicker_correlation(order_of(sets), np.ones(len(sets)), TIME_CONSTANTS_SETS)
    return known, (np.ones(len(sets)), correlation, sets.rate_dps**2), sets.timed


def order_of(sets: DataSets) -> Floats:
    """Place of each data set in the order of the recording, shape (n,), with room for soaks between temperatures."""
    step = np.abs(np.diff(sets.temp_c, prepend=sets.temp_c[0]))
    soaks = np.cumsum(step > _SOAK_STEP * np.ptp(sets.temp_c)) if np.ptp(sets.temp_c) > 0 else 0
    return np.asarray(sets.segment + _SOAK_SETS * soaks, dtype=np.float64)


def estimate_scatter(sets: DataSets, design: Floats) -> Scatter:
    """Levels of the scatter around a linear model, by restricted maximum likelihood.

    Parameters
    ----------
    design : ndarray, shape (n, p)
        Columns of the model of the error.
    """
    known, parts, timed = scatter_parts(sets)
    error_dps = sets.error_dps
    basis = np.asarray(linalg.qr(design, mode="economic")[0], dtype=np.float64)
    residual = error_dps - basis @ (basis.T @ error_dps)
    # Whatever is estimated, the matrix stays regular: rounding is noise too.
    known = known + _ROUNDING * float(np.mean(error_dps**2)) + np.finfo(float).tiny
    unit = max(float(residual @ residual) / (len(sets) - design.shape[1]), float(known.mean()))
    sizes = np.array([np.mean(_diagonal(part)) for part in parts])
    # Levels are sought as logarithms of their share of the scatter: positive, and of one size.
    scale = np.where(sizes > 0, unit / np.where(sizes > 0, sizes, 1.0), 0.0)

    def cost(log_share: Floats) -> tuple[float, Floats]:
        levels = (scale * np.exp(log_share)).astype(np.float64)
        value, slope = _restricted_likelihood(known, parts, levels, basis, error_dps)
        return value, slope * levels

    found = optimize.minimize(
        cost,
        np.log(np.full(len(parts), 1.0 / len(parts))),
        jac=True,
        method="L-BFGS-B",
        bounds=[(np.log(0.01 * _NOTHING), np.log(1e3))] * len(parts),
        options={"ftol": 1e-10, "gtol": 1e-5, "maxiter": 200},
    )
    share = np.exp(found.x)
    levels = np.where(share > _NOTHING, scale * share, 0.0).astype(np.float64)
    matrix = _matrix(known, parts, levels)
    information = _average_information(matrix, parts, levels, basis, error_dps)
    return Scatter(levels, information, matrix, parts, design, timed)


def _diagonal(part: Floats) -> Floats:
    return part if part.ndim == 1 else np.diag(part)


def times(part: Floats, columns: Floats) -> Floats:
    """A part of the covariance times columns, shape (n,) or (n, k)."""
    if part.ndim == 2:
        return part @ columns
    return part * columns if columns.ndim == 1 else part[:, None] * columns


def _matrix(known: Floats, parts: tuple[Floats, ...], levels: Floats) -> Floats:
    diagonal = known.copy()
    matrix = np.zeros((known.size, known.size))
    for level, part in zip(levels, parts, strict=True):
        if part.ndim == 1:
            diagonal += level * part
        elif level > 0:
            matrix += level * part
    matrix[np.diag_indices_from(matrix)] += diagonal
    return matrix


def projection(matrix: Floats, design: Floats) -> tuple[Floats, float]:
    """``P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1`` and ``log|V| + log|X' V^-1 X|``.

    ``P y`` are the residuals of generalised least squares, weighted by ``V^-1``.
    """
    factor = linalg.cholesky(matrix, lower=True, check_finite=False)
    half, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = np.tril(half) + np.tril(half, -1).T
    weighted = inverse @ design
    inner = linalg.cholesky(design.T @ weighted, lower=True)
    root = linalg.solve_triangular(inner, weighted.T, lower=True)
    log_det = 2.0 * float(np.log(np.diag(factor)).sum() + np.log(np.diag(inner)).sum())
    return inverse - root.T @ root, log_det


def _restricted_likelihood(
    known: Floats, parts: tuple[Floats, ...], levels: Floats, design: Floats, y: Floats
) -> tuple[float, Floats]:
    """Minus the restricted log-likelihood, and its slope by the levels."""
    p, log_det = projection(_matrix(known, parts, levels), design)
    py = p @ y
    slope = []
    for part in parts:
        trace = float(np.sum(p * part)) if part.ndim == 2 else float(np.diag(p) @ part)
        slope.append(0.5 * (trace - float(py @ times(part, py))))
    return 0.5 * (log_det + float(y @ py)), np.array(slope)


def _average_information(
    matrix: Floats, parts: tuple[Floats, ...], levels: Floats, design: Floats, y: Floats
) -> Floats:
    p, _ = projection(matrix, design)
    py = p @ y
    working = np.stack([times(part, py) for part in parts], axis=1)
    information = 0.5 * working.T @ p @ working
    present = levels > 0
    return np.where(present[:, None] & present[None, :], information, 0.0)
