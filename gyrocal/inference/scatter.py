"""Covariance of data-set means: what their scatter is made of, estimated from the scatter itself.

``V = diag(std^2/n) + white I + flicker K(t) + jitter diag(rate^2) + walk W(t)``

- ``std^2/n``: sample noise (angle random walk), known from each data set;
- ``white``: what independent scatter there is beyond it (all of it where a table gives no ``std`` and ``n``);
- ``flicker``: 1/f bias noise, a sum of Ornstein-Uhlenbeck processes a decade apart with one common variance,
  averaged over the window of each data set; it correlates neighbours in time;
- ``jitter``: a rate error of the table, independent from data set to data set, proportional to the rate;
- ``walk``: a random walk of the bias, averaged likewise; it has no mean, and the constant beside it stands for the bias at
  either end of the recording and anywhere between (`flicker.walk_covariance`).

The four levels come from the restricted likelihood (Patterson, Thompson 1971), which allows for the coefficients
that the same data have to give, and for flicker and walk from records at rest as well (`flicker.Rest`). What is not known about
the levels is carried on: the covariance is the mean over their posterior (`levels`), and its own spread gives the
degrees of freedom of every interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, stats

from gyrocal.inference.flicker import Rest
from gyrocal.inference.gls import inverse_of, restricted_loss
from gyrocal.inference.levels import integrate

Floats = NDArray[np.float64]

#: Names of the estimated levels, in the order of `Scatter.levels`.
PARTS = ("white", "flicker", "jitter", "walk")
#: Those that records at rest speak of, in the order of `Rest.cost`.
_DRIFTS = [1, 3]
#: Those that are nothing with even odds.
_RARE = np.array([part == "walk" for part in PARTS])

#: A search starts here or higher: as logarithms, levels that are nearly none hardly move.
_SEED_SHARE = 0.05
#: A level below this share of the scatter is none.
_NOTHING = 1e-6

#: Of more data sets than these the levels are taken from the peak of their likelihood and its curvature: integration
#: would take minutes, and that many say well enough what they say.
_MOST_INTEGRATED = 1000
#: Chance that records at rest are set aside although they speak for the data sets.
_DISAGREEMENT = 0.01

#: Relative variance of arithmetic: nothing is known better.
_ROUNDING = 1e-22


@dataclass(frozen=True)
class Scatter:
    """Levels of the scatter and the covariance they make.

    Attributes
    ----------
    levels : ndarray, shape (4,)
        Posterior means: ``white`` in (deg/s)^2, ``flicker`` in (deg/s)^2 for each decade, ``jitter`` relative, squared,
        ``walk`` in (deg/s)^2 a second, or a place in the order where times are unknown.
    level_covariance : ndarray, shape (4, 4)
        How well they are known.
    upper : ndarray, shape (4,)
        95 % upper bounds.
    seen : ndarray of bool, shape (4,)
        Whether the recording shows the level at all: the likelihood falls by 1.35 (5 %, one-sided) without it.
    matrix : ndarray, shape (n, n), (deg/s)^2
    parts : tuple of ndarray, shape (n, n) or (n,) for a diagonal
        Derivative of the matrix by each level.
    design : ndarray, shape (n, p)
        Columns of the model that the levels were estimated beside.
    timed : bool
        Whether times were known; else the order stood for them.
    rest : Rest or None
        Records at rest that the levels rest on too.
    rest_disagrees : bool
        The data sets drift more than the records at rest allow: those were then left aside.
    """

    levels: Floats
    level_covariance: Floats
    upper: Floats
    seen: NDArray[np.bool_]
    matrix: Floats
    parts: tuple[Floats, ...]
    design: Floats
    timed: bool
    rest: Rest | None = None
    rest_disagrees: bool = False

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

    @property
    def walk_dps(self) -> float:
        """Standard deviation of what the bias walks in a second, or from one place in the order to the next."""
        return float(np.sqrt(self.levels[3]))


@dataclass(frozen=True)
class _Likelihood:
    """Restricted likelihood of the levels, given as shares of the scatter (``level = scale * share^2``)."""

    known: Floats
    parts: tuple[Floats, ...]
    scale: Floats
    basis: Floats
    error_dps: Floats
    rest: Rest | None

    def cost(self, log_levels: Floats) -> tuple[float, Floats]:
        """Minus the logarithm, and its slope by the logarithms of ``share^2``."""
        levels = (self.scale * np.exp(log_levels)).astype(np.float64)
        value, slope = _restricted_likelihood(self.known, self.parts, levels, self.basis, self.error_dps)
        if self.rest is not None:
            more, *steeper = self.rest.cost(*levels[_DRIFTS])
            value += more
            slope[_DRIFTS] += steeper
        return value, slope * levels

    def log_likelihood(self, share: Floats) -> float:
        """The logarithm alone: a third of the work."""
        levels = (self.scale * share**2).astype(np.float64)
        matrix = _matrix(self.known, self.parts, levels)
        value = -0.5 * restricted_loss(matrix, self.basis, self.error_dps)
        return value if self.rest is None else value - self.rest.cost(*levels[_DRIFTS])[0]

    def peak(self, start: Floats) -> tuple[Floats, float]:
        """``share^2`` of the highest likelihood, and the cost there."""
        found = optimize.minimize(
            self.cost,
            np.log(start),
            jac=True,
            method="L-BFGS-B",
            bounds=[(np.log(0.01 * _NOTHING), np.log(1e3))] * start.size,
            options={"ftol": 1e-10, "gtol": 1e-5, "maxiter": 200},
        )
        return np.asarray(np.exp(found.x), dtype=np.float64), float(found.fun)


def scatter_of(
    error_dps: Floats,
    known: Floats,
    parts: tuple[Floats, ...],
    design: Floats,
    *,
    timed: bool,
    rest: Rest | None = None,
) -> Scatter:
    """Levels of the scatter around a linear model, and how well they are known.

    Parameters
    ----------
    error_dps, known : ndarray, shape (n,)
        Errors, and the variances that are known.
    parts : tuple of ndarray, shape (n, n) or (n,) for a diagonal
        What each level adds to the covariance.
    design : ndarray, shape (n, p)
        Columns of the model of the error.
    timed : bool
        Whether the rows have times.
    rest : Rest, optional
        Records at rest of the same run; only used where the rows have times.
    """
    basis = np.asarray(linalg.qr(design, mode="economic")[0], dtype=np.float64)
    residual = error_dps - basis @ (basis.T @ error_dps)
    # Whatever is estimated, the matrix stays regular: rounding is noise too.
    known = known + _ROUNDING * float(np.mean(error_dps**2)) + np.finfo(float).tiny
    # Levels are sought as their share of the residual's scatter: positive, and of one size. What the model takes for
    # itself (drift from one temperature to the next, mostly) is no part of that scatter.
    dof = error_dps.size - design.shape[1]
    sizes = np.array([_trace(part) - _trace(basis.T @ times(part, basis)) for part in parts]) / dof
    sizes = np.where(
        sizes > _NOTHING * np.array([_trace(part) / error_dps.size for part in parts]), sizes, 0.0
    )
    unit = max(float(residual @ residual) / dof, float(known.mean()))
    scale = np.where(sizes > 0, unit / np.where(sizes > 0, sizes, 1.0), 0.0)
    alone = _Likelihood(known, parts, scale, basis, residual, None)
    square, least = alone.peak(np.full(len(parts), 1.0 / len(parts)))
    likelihood, disagrees = alone, False
    if timed and rest is not None:
        both = replace(alone, rest=rest)
        joint, _ = both.peak(np.maximum(square, _SEED_SHARE))
        # What the data sets alone would gain is chi-square, a degree of freedom for each drift, if rest speaks for them.
        gain = 2.0 * (alone.cost(np.log(joint))[0] - least)
        less = float(joint[_DRIFTS].sum()) < float(square[_DRIFTS].sum())
        disagrees = bool(less and gain > stats.chi2.isf(_DISAGREEMENT, len(_DRIFTS)))
        if not disagrees:
            square, likelihood = joint, both
    return _weighed(likelihood, square, design, timed, rest, disagrees)


def _weighed(
    likelihood: _Likelihood, square: Floats, design: Floats, timed: bool, rest: Rest | None, disagrees: bool
) -> Scatter:
    """Scatter from the likelihood: its posterior, or for many data sets its peak and curvature."""
    parts, scale = likelihood.parts, likelihood.scale
    active = np.flatnonzero(scale > 0)

    def log_likelihood(share: Floats) -> float:
        whole = np.zeros(scale.size)
        whole[active] = share
        return likelihood.log_likelihood(whole)

    mode = np.sqrt(np.where(square > _NOTHING, square, 0.0))[active]
    seen = np.zeros(scale.size, dtype=np.bool_)
    top = log_likelihood(mode)
    without = [log_likelihood(np.where(np.arange(mode.size) == k, 0.0, mode)) for k in range(mode.size)]
    seen[active] = top - np.array(without) > 0.5 * stats.chi2.isf(0.1, 1)
    levels, upper, spread = np.zeros(scale.size), np.zeros(scale.size), np.zeros((scale.size, scale.size))
    if likelihood.error_dps.size <= _MOST_INTEGRATED:
        posterior = integrate(log_likelihood, mode, _RARE[active])
        levels[active], upper[active] = scale[active] * posterior.mean, scale[active] * posterior.upper
        spread[np.ix_(active, active)] = posterior.covariance * np.outer(scale[active], scale[active])
        matrix = _matrix(likelihood.known, parts, levels)
    else:
        levels[active] = scale[active] * mode**2
        matrix = _matrix(likelihood.known, parts, levels)
        information = _average_information(matrix, parts, levels, likelihood.basis, likelihood.error_dps)
        spread[:] = np.linalg.pinv(information, hermitian=True)
        upper = levels + stats.norm.ppf(0.95) * np.sqrt(np.diag(spread))
    used = None if disagrees or not timed else rest
    return Scatter(levels, spread, upper, seen, matrix, parts, design, timed, used, disagrees)


def _trace(part: Floats) -> float:
    return float(part.sum() if part.ndim == 1 else np.trace(part))


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
    inverse = inverse_of(factor)
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
