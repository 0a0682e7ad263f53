"""How far two error surfaces are apart, as bias and scale factor, against what was put between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.surfaces import surfaces_apart
from gyrocal.fusion import Coefficients, Valid
from gyrocal.physics.surface import Direction
from gyrocal.report.versus import surface_sentences
from tests.diagnosis.versus.tables import SURFACE, plan, table

BIAS_DPS, SLOPE_PPM, STD_DPS = 25.0 / 3600.0, 500.0, 1e-3


def law(direction: Direction = "output") -> Coefficients:
    """25 deg/h, and 500 ppm that grow by a half over 30 degC."""
    c = SURFACE.coefficients_dps.copy()
    c[0, 0] += BIAS_DPS
    c[1, :2] += 1e-6 * SLOPE_PPM * SURFACE.rate_scale_dps * np.array([1.0, 0.5])
    covariance = np.zeros((12, 12))
    covariance[0, 0] = STD_DPS**2
    surface = replace(SURFACE, coefficients_dps=c, direction=direction)
    return Coefficients({"model": "test"}, surface, covariance, Valid((-100, 100), (-10, 50)))


def test_bias_and_scale_factor_between_surfaces() -> None:
    t, rate, temp = plan(8)
    difference = series_of_table(table("d.csv", t, rate, rate, temp))
    simulated = replace(SURFACE, direction="input")
    apart = surfaces_apart(law("input"), simulated, difference)
    np.testing.assert_allclose(
        apart.temp_c, [temp.min(), 0.5 * (temp.min() + temp.max()), temp.max()], rtol=1e-6
    )
    np.testing.assert_allclose(apart.bias_dps, BIAS_DPS)
    np.testing.assert_allclose(apart.bias_std_dps, STD_DPS)
    assert apart.scale_ppm is not None
    np.testing.assert_allclose(apart.scale_ppm, SLOPE_PPM * (1.0 + 0.5 * (apart.temp_c - 20.0) / 30.0))
    assert apart.to_json()["bias_interval_95_dps"][0] == pytest.approx(
        [BIAS_DPS - 1.96 * STD_DPS, BIAS_DPS + 1.96 * STD_DPS], rel=1e-4
    )
    (said,) = surface_sentences(apart)
    assert "bias 25.0 ± 3.6 deg/h" in said
    assert "scale factor 616.660 ± less than 0.001 ppm (500.000" in said


def test_over_the_output_it_is_the_same_to_the_error_of_the_scale_factor() -> None:
    t, rate, temp = plan(8)
    difference = series_of_table(table("d.csv", t, rate, rate, temp))
    apart = surfaces_apart(law(), SURFACE, difference)
    assert apart.scale_ppm is not None
    np.testing.assert_allclose(apart.bias_dps, BIAS_DPS, rtol=0.02)
    expected_ppm = SLOPE_PPM * (1.0 + 0.5 * (apart.temp_c - 20.0) / 30.0)
    np.testing.assert_allclose(apart.scale_ppm, expected_ppm, rtol=0.03)


def test_surfaces_that_are_not_surely_apart_are_not_said_to_be() -> None:
    t, _, temp = plan(8)
    still = series_of_table(table("d.csv", t, np.zeros(t.size), np.zeros(t.size), temp))
    near = replace(law(), surface=SURFACE)
    apart = surfaces_apart(near, SURFACE, still)
    assert apart.scale_ppm is None
    assert surface_sentences(apart) == []
    assert "scale_factor_ppm" not in apart.to_json()
