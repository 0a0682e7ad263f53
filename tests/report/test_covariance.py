"""What the report expects of residuals: the covariance behind bars and margins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrocal.calibration.fit import fit_surface
from gyrocal.calibration.material import residual_covariance
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.inference.scatter import projection
from gyrocal.report.figures_residual import level_means
from gyrocal.report.levels import levels
from gyrocal.units import NORMAL_95
from tests.report.examples import SURFACE, grid

COEFFICIENTS = Coefficients({}, SURFACE, np.diag(np.full(12, 1e-6)), Valid((-100, 100), (-10, 50)))


def test_covariance_of_residuals_of_own_and_of_other_data() -> None:
    sets = grid().sets
    scatter = fit_surface(sets).scatter
    own = residual_covariance(sets, scatter, COEFFICIENTS, own=True)
    # V^-1 cov(M e) V^-1 is the projection of generalised least squares.
    inverse = np.linalg.inv(scatter.matrix)
    wanted, _ = projection(scatter.matrix, scatter.design)
    np.testing.assert_allclose(inverse @ own @ inverse, wanted, atol=1e-6 * np.abs(wanted).max())
    other = residual_covariance(sets, scatter, COEFFICIENTS, own=False)
    sigma = COEFFICIENTS.sigma_dps(sets.gyro_dps, sets.temp_c)
    np.testing.assert_allclose(np.diag(other), np.diag(scatter.matrix) + sigma**2)
    assert (np.diag(own) < np.diag(other)).all()


def test_margins_know_what_data_sets_of_one_temperature_share() -> None:
    data = grid()
    found, _ = levels(data.sets.temp_c, most=12, bins=12)
    together = np.zeros_like(data.covariance_dps2)
    for level in found:
        together[np.ix_(level.rows, level.rows)] = 4e-6
    shared = replace(data, covariance_dps2=data.covariance_dps2 + together)
    _, mean, half = level_means(shared, found)
    size = np.array([level.rows.size for level in found])
    np.testing.assert_allclose(half, NORMAL_95 * np.sqrt(1e-6 / size + 4e-6) * 3600.0)
    np.testing.assert_allclose(mean, [data.residual_dps[level.rows].mean() * 3600.0 for level in found])
