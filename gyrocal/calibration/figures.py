"""Figures of merit of a calibrated gyro, named after IEEE Std 952 (fiber-optic gyro test procedures).

Each figure is ``{"value", "std", "unit", "meaning"}``; standard deviations carry the covariance of the
coefficients through the figure's slope, found by differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion.coefficients import Valid
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.units import DPS_TO_DPH

Floats = NDArray[np.float64]

_GRID = 81
_PPM = 1e6


#: Unit, meaning, and the figure as a function of the surface.
Law = tuple[str, str, Callable[[Surface], float]]


def merit_figures(
    surface: Surface, covariance_dps2: Floats, valid: Valid, *, bias_only: bool = False
) -> dict[str, dict[str, Any]]:
    """Figures of merit over the valid range of rate and temperature; `bias_only` leaves out the scale factor's."""
    middle = 0.5 * (valid.temp_c[0] + valid.temp_c[1])
    laws = _bias_laws(valid, middle) | ({} if bias_only else _scale_factor_laws(valid, middle))
    figures = {}
    for name, (unit, meaning, law) in laws.items():
        value, std = _propagated(law, surface, covariance_dps2)
        figures[name] = {"value": value, "std": std, "unit": unit, "meaning": meaning}
    return figures


def _bias_laws(valid: Valid, middle_c: float) -> dict[str, Law]:
    temps = np.linspace(*valid.temp_c, _GRID)
    return {
        "bias": (
            "deg/h",
            f"error at zero output, {middle_c:.1f} °C",
            lambda s: float(s.error_dps(0.0, middle_c)) * DPS_TO_DPH,
        ),
        "bias_over_temperature": (
            "deg/h peak to peak",
            "range of the error at zero output",
            lambda s: float(np.ptp(s.error_dps(0.0, temps))) * DPS_TO_DPH,
        ),
    }


def _scale_factor_laws(valid: Valid, middle_c: float) -> dict[str, Law]:
    """Laws of the slope of the error over the output, by least squares over both signs or one."""
    rates = np.linspace(*valid.rate_dps, _GRID)
    temps = np.linspace(*valid.temp_c, 13)
    full = max(abs(valid.rate_dps[0]), abs(valid.rate_dps[1]))

    def slope(s: Surface, temp_c: float, sign: int = 0) -> float:
        g = rates if sign == 0 else rates[rates * sign > 0]
        return float(np.polyfit(g, s.error_dps(g, temp_c), 1)[0])

    def slope_range(s: Surface) -> float:
        slopes = [slope(s, float(t)) for t in temps]
        return max(slopes) - min(slopes)

    def off_line(s: Surface) -> float:
        e = s.error_dps(rates, middle_c)
        return float(np.sqrt(np.mean((e - np.polyval(np.polyfit(rates, e, 1), rates)) ** 2)))

    at = f"{middle_c:.1f} °C"
    return {
        "scale_factor_error": (
            "ppm",
            f"slope of the error over the output, {at}",
            lambda s: slope(s, middle_c) * _PPM,
        ),
        "scale_factor_over_temperature": (
            "ppm peak to peak",
            "range of that slope",
            lambda s: slope_range(s) * _PPM,
        ),
        "scale_factor_asymmetry": (
            "ppm",
            f"slope for positive less that for negative rates, {at}",
            lambda s: (slope(s, middle_c, 1) - slope(s, middle_c, -1)) * _PPM,
        ),
        "scale_factor_nonlinearity": (
            "% of full scale rms",
            f"error less its straight line, {at}",
            lambda s: off_line(s) / full * 100.0,
        ),
    }


def _propagated(
    law: Callable[[Surface], float], surface: Surface, covariance_dps2: Floats
) -> tuple[float, float]:
    """Value of a figure and its standard deviation to first order."""
    value = law(surface)
    c = surface.coefficients_dps.ravel()
    steps = np.sqrt(np.diag(covariance_dps2))
    slopes = np.zeros(c.size)
    for k in np.flatnonzero(steps > 0):
        moved = c.copy()
        moved[k] += steps[k]
        slopes[k] = (law(replace(surface, coefficients_dps=moved.reshape(SHAPE))) - value) / steps[k]
    return value, math.sqrt(max(float(slopes @ covariance_dps2 @ slopes), 0.0))
