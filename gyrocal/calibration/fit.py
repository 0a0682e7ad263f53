"""The paper's least squares on data-set means: eqs. 1 to 5, weighted by what the data say about their scatter.

The error of each data set (eq. 1) is regressed on powers of its output and mean temperature (eqs. 2, 3, 5), both
centred and scaled. The output in the regressors is the one that the surface itself predicts at the true rate, not the
one that was measured: a measured output carries the noise that is to be explained, and beside columns in the true
rate (`residuals.structure_tests`) it explains it altogether.

``gls`` (the default) weights by the inverse of the estimated covariance (`covariance.Scatter`): scatter that grows
with the rate, or that is common to neighbours in time, then counts for what it is worth. ``ols`` gives every data
set the same weight, as the paper does. The standard errors of both come from the same estimated covariance, since
those that ordinary least squares gives for itself cover 44 to 96 % instead of 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, stats

from gyrocal.calibration.covariance import estimate_scatter
from gyrocal.calibration.datasets import DataSets
from gyrocal.errors import DataError
from gyrocal.inference.flicker import Rest
from gyrocal.inference.scatter import Scatter, projection, times
from gyrocal.physics.surface import SHAPE, Direction, Surface

Floats = NDArray[np.float64]
Weights = Literal["gls", "ols"]

#: Number of coefficients.
TERMS = SHAPE[0] * SHAPE[1]
ALL_TERMS = np.ones(TERMS, dtype=np.bool_)

_ROUNDS = 3
#: As good as a normal law.
_MOST_DOF = 1e6


@dataclass(frozen=True)
class SurfaceFit:
    """A fitted surface; arrays over data sets have shape (n,) and the order of `sets`.

    Attributes
    ----------
    terms : ndarray of bool, shape (12,)
        Those that were fitted.
    own_dps : ndarray
        What the powers are of: the output as the surface predicts it, or the true rate.
    covariance_dps2 : ndarray, shape (12, 12), (deg/s)^2
        Of the coefficients, row-major over (i, j); for the weights used, under the estimated scatter.
    dof : ndarray, shape (12,)
        Degrees of freedom of each standard error, more than 4, for Student intervals.
    residual_dps : ndarray
        Corrected rate minus true rate.
    ols : Surface
        The same terms with equal weights, whatever the weights used.
    ols_residual_dps : ndarray
    """

    sets: DataSets
    surface: Surface
    weights: Weights
    terms: NDArray[np.bool_]
    own_dps: Floats
    covariance_dps2: Floats
    dof: Floats
    scatter: Scatter
    design: Floats
    residual_dps: Floats
    ols: Surface
    ols_residual_dps: Floats

    @property
    def std_dps(self) -> Floats:
        """Standard errors of the coefficients, shape (4, 3), deg/s."""
        return np.asarray(np.sqrt(np.diag(self.covariance_dps2)).reshape(SHAPE))

    def half_width_dps(self, level: float = 0.95) -> Floats:
        """Half widths of the coefficients' confidence intervals, shape (4, 3), deg/s."""
        return np.asarray(self.std_dps * half_width(level, self.dof).reshape(SHAPE))

    @property
    def condition(self) -> float:
        """Condition number of the scaled design."""
        return float(np.linalg.cond(self.design))


def half_width(level: float, dof: ArrayLike) -> Floats:
    """Half the width of an interval, in standard deviations of Student's law: the scatter's covariance has these, not its scale.

    Parameters
    ----------
    level : float
    dof : array_like
        Degrees of freedom, above two.
    """
    dof = np.asarray(dof, dtype=np.float64)
    return np.asarray(stats.t.ppf(0.5 + 0.5 * level, dof) * np.sqrt((dof - 2.0) / dof))


def scaled_surface(
    sets: DataSets, coefficients_dps: Floats | None = None, direction: Direction = "output"
) -> Surface:
    """A surface centred on and scaled to the data: both variables run over [-1, 1]."""

    def middle_and_half(values: Floats) -> tuple[float, float]:
        low, high = float(values.min()), float(values.max())
        return 0.5 * (low + high), max(0.5 * (high - low), np.finfo(float).tiny)

    rate = middle_and_half(sets.gyro_dps if direction == "output" else sets.rate_dps)
    temp = middle_and_half(sets.temp_c)
    c = np.zeros(SHAPE) if coefficients_dps is None else coefficients_dps.reshape(SHAPE)
    return Surface(c, *rate, *temp, direction)


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def fit_surface(
    sets: DataSets,
    weights: Weights = "gls",
    terms: NDArray[np.bool_] = ALL_TERMS,
    rest: Rest | None = None,
    *,
    direction: Direction = "output",
    scatter: Scatter | None = None,
) -> SurfaceFit:
    """Fit the twelve terms to data sets that `checks.check_surface` has passed.

    Parameters
    ----------
    weights : {"gls", "ols"}
        Weight by the estimated covariance of the scatter, or equally as the paper does.
    terms : ndarray of bool, shape (12,)
        Terms to fit, row-major over (i, j); the others are zero.
    rest : Rest, optional
        What the run's records at rest say about drift (`Recording.rest`): better intervals, the same surface.
    direction : {"output", "input"}
        What the powers are of: the gyro's output, as in the paper, or the true rate.
    scatter : Scatter, optional
        Estimated before beside the same terms.
    """
    own = predicted_output(sets, terms) if direction == "output" else sets.rate_dps
    design = scaled_surface(sets, direction=direction).design(own, sets.temp_c)[:, terms]
    scatter = estimate_scatter(sets, design, rest) if scatter is None else scatter
    error_dps = sets.error_dps
    ols_gain: Floats = np.asarray(np.linalg.pinv(design), dtype=np.float64)
    gain: Floats = gls_gain(scatter.matrix, design) if weights == "gls" else ols_gain
    place = np.eye(TERMS)[:, terms]
    surface = scaled_surface(sets, place @ gain @ error_dps, direction)
    ols = scaled_surface(sets, place @ ols_gain @ error_dps, direction)
    return SurfaceFit(
        sets=sets,
        surface=surface,
        weights=weights,
        terms=terms,
        own_dps=own,
        covariance_dps2=place @ gain @ scatter.matrix @ gain.T @ place.T,
        dof=place @ _degrees_of_freedom(scatter, gain) + _MOST_DOF * ~terms,
        scatter=scatter,
        design=design,
        residual_dps=surface.rate_dps(sets.gyro_dps, sets.temp_c) - sets.rate_dps,
        ols=ols,
        ols_residual_dps=ols.rate_dps(sets.gyro_dps, sets.temp_c) - sets.rate_dps,
    )


def predicted_output(sets: DataSets, terms: NDArray[np.bool_] = ALL_TERMS) -> Floats:
    """Output of each data set as the surface predicts it at the true rate, shape (n,), deg/s: free of its noise.

    A few rounds of equal weights: the noise of the outputs is far below what moves the surface's columns.
    """
    output = sets.gyro_dps
    for _ in range(_ROUNDS):
        design = scaled_surface(sets).design(output, sets.temp_c)[:, terms]
        coefficients = np.eye(TERMS)[:, terms] @ np.linalg.lstsq(design, sets.error_dps, rcond=None)[0]
        try:
            output = scaled_surface(sets, coefficients).output_dps(sets.rate_dps, sets.temp_c)
        except DataError:
            # Beyond a turning point of the cubic: a polynomial in the true rate always has an output.
            columns = scaled_surface(sets).design(sets.rate_dps, sets.temp_c)[:, terms]
            return np.asarray(
                sets.rate_dps + columns @ np.linalg.lstsq(columns, sets.error_dps, rcond=None)[0]
            )
    return output


def gls_gain(matrix: Floats, design: Floats) -> Floats:
    """``(X' V^-1 X)^-1 X' V^-1``, shape (p, n): what generalised least squares multiplies the data with."""
    lower = linalg.cholesky(matrix, lower=True)
    whitened = linalg.solve_triangular(lower, design, lower=True)
    q, r = linalg.qr(whitened, mode="economic")
    return np.asarray(linalg.solve_triangular(r, linalg.solve_triangular(lower, q, lower=True, trans="T").T))


def _degrees_of_freedom(scatter: Scatter, gain: Floats) -> Floats:
    """Degrees of freedom of each variance ``(G V G')_kk``: ``4 + 2 mean^2 / variance`` over the posterior of the levels.

    A normal error whose variance is drawn like that is Student's t with as many.
    """
    slopes = np.stack([np.sum(gain * times(part, gain.T).T, axis=1) for part in scatter.parts], axis=1)
    variance = np.sum(gain * (gain @ scatter.matrix), axis=1)
    spread = np.einsum("ki,ij,kj->k", slopes, scatter.level_covariance, slopes)
    with np.errstate(divide="ignore", over="ignore"):
        dof = 4.0 + 2.0 * variance**2 / np.maximum(spread, 0.0)
    return np.asarray(np.minimum(dof, _MOST_DOF))


def studentised_residuals(scatter: Scatter, error_dps: Floats) -> Floats:
    """Each data set minus what all others predict for it, in standard deviations (deleted residuals).

    The prediction includes what neighbours in time say about the bias; under the model each one is Student's t
    with n - 13 degrees of freedom.
    """
    p, _ = projection(scatter.matrix, scatter.design)
    # P annihilates the surface; taking it off first saves the digits that it would cost.
    residual = error_dps - scatter.design @ np.linalg.lstsq(scatter.design, error_dps, rcond=None)[0]
    py = p @ residual
    squared = py**2 / np.maximum(np.diag(p), np.finfo(float).tiny)
    dof = error_dps.size - scatter.design.shape[1]
    least = max(1e-9 * float(squared.max()), np.finfo(float).tiny)
    rest = np.maximum(float(residual @ py) - squared, least) / max(dof - 1, 1)
    return np.asarray(np.sign(py) * np.sqrt(squared / rest))
