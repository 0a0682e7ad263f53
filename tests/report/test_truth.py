"""A fit compared with a known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.report.truth import compare_with_truth
from tests.report.examples import SURFACE

VALID = Valid((-100.0, 100.0), (-10.0, 50.0))


def calibration(surface: Surface) -> Coefficients:
    """Coefficients with a standard error of 1 mdeg/s each."""
    return Coefficients({}, surface, np.eye(12) * 1e-6, VALID)


def test_the_same_surface_on_other_scales_is_the_same() -> None:
    other = Surface(np.zeros(SHAPE), 3.0, 90.0, 15.0, 40.0)
    gyro, temp = (g.ravel() for g in np.meshgrid(np.linspace(-100, 100, 9), np.linspace(-10, 50, 7)))
    terms = np.linalg.lstsq(other.design(gyro, temp), SURFACE.error_dps(gyro, temp), rcond=None)[0]
    other = replace(other, coefficients_dps=np.asarray(terms, dtype=np.float64).reshape(SHAPE))
    found = compare_with_truth(calibration(other), np.full(SHAPE, 1e-9), SURFACE)
    assert (found.inside, found.terms) == (12, 12)
    assert found.largest_dps < 1e-12


def test_a_shifted_bias_is_seen() -> None:
    terms = SURFACE.coefficients_dps.copy()
    terms[0, 0] += 0.01
    found = compare_with_truth(
        calibration(replace(SURFACE, coefficients_dps=terms)), np.full(SHAPE, 2e-3), SURFACE
    )
    assert found.inside == 11
    assert found.rms_dps == pytest.approx(0.01)
    assert found.largest_dps == pytest.approx(0.01)
    assert 1e-3 <= found.expected_rms_dps <= np.sqrt(12) * 1e-3
