"""A fitted surface against the truth, which only a simulation knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.surface import SHAPE, Floats, Surface

_GRID = 41


@dataclass(frozen=True)
class TruthComparison:
    """How a calibration compares with the surface that it was to find.

    Attributes
    ----------
    inside, terms : int
        Coefficients whose 95 % interval holds the truth, of how many.
    rms_dps, largest_dps : float
        Difference of fitted and true error over the valid range, deg/s.
    expected_rms_dps : float
        What the coefficients' own covariance says it should be, deg/s.
    """

    inside: int
    terms: int
    rms_dps: float
    largest_dps: float
    expected_rms_dps: float


def compare_with_truth(coefficients: Coefficients, half_width_dps: Floats, truth: Surface) -> TruthComparison:
    """Compare over the valid range; both surfaces are polynomials of the same orders, so terms compare one to one.

    Parameters
    ----------
    half_width_dps : ndarray, shape (4, 3)
        Half widths of the coefficients' 95 % intervals.
    """
    valid = coefficients.valid
    gyro, temp = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(*valid.rate_dps, _GRID), np.linspace(*valid.temp_c, _GRID))
    )
    fitted = coefficients.surface
    true_error = truth.error_at_output_dps(gyro, temp)
    own = gyro if fitted.direction == "output" else gyro - true_error
    true_terms = np.linalg.lstsq(fitted.design(own, temp), true_error, rcond=None)[0].reshape(SHAPE)
    off = np.abs(fitted.coefficients_dps - true_terms)
    difference = fitted.error_at_output_dps(gyro, temp) - true_error
    expected = coefficients.sigma_dps(gyro, temp)
    return TruthComparison(
        inside=int(np.count_nonzero(off <= half_width_dps)),
        terms=off.size,
        rms_dps=float(np.sqrt(np.mean(difference**2))),
        largest_dps=float(np.abs(difference).max()),
        expected_rms_dps=float(np.sqrt(np.mean(expected**2))),
    )
