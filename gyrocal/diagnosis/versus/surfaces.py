"""How far a recording and a simulation are apart, as bias and scale factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.series import Series
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import Term
from gyrocal.units import NORMAL_95, PPM

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Apart:
    """Bias and scale factor of the recording less those of the simulation, at the lowest, middle and highest temperature.

    Attributes
    ----------
    temp_c, bias_dps, bias_std_dps : ndarray, shape (3,)
    scale_ppm, scale_std_ppm : ndarray, shape (3,), optional
        Slope of what is odd in the rate, by least squares over the rates of the recording; None where it never turned.
    """

    temp_c: Floats
    bias_dps: Floats
    bias_std_dps: Floats
    scale_ppm: Floats | None
    scale_std_ppm: Floats | None

    def to_json(self) -> dict[str, Any]:
        """Entry ``surfaces_apart`` of ``law.json``."""
        return {
            "temp_c": self.temp_c.tolist(),
            "bias_dps": self.bias_dps.tolist(),
            "bias_interval_95_dps": _interval(self.bias_dps, self.bias_std_dps),
        } | (
            {}
            if self.scale_ppm is None or self.scale_std_ppm is None
            else {
                "scale_factor_ppm": self.scale_ppm.tolist(),
                "scale_factor_interval_95_ppm": _interval(self.scale_ppm, self.scale_std_ppm),
            }
        )


def of_rate_alone(effect_id: str) -> bool:
    """Whether a law says at every rate what it adds, whenever that is."""
    return set(CATALOGUE[effect_id].needs) <= {"rate_dps"}


def surfaces_apart(law: Coefficients, simulated: Surface, difference: Series) -> Apart:
    """Bias and scale factor between a law and the surface of the simulation, over the temperatures that both have.

    Laws of the rate alone are in them: beside an asymmetry the surface has the scale factor of one way of turning. How these go with
    the surface is not known, and the intervals are at the most that wide.
    """
    low_c, high_c = float(difference.temp_c.min()), float(difference.temp_c.max())
    temps_c = np.array([low_c, 0.5 * (low_c + high_c), high_c])
    turning = np.abs(difference.rate_dps[difference.rate_dps != 0.0])
    bias = [_difference(law, simulated, np.zeros(1), np.ones(1), t) for t in temps_c.tolist()]
    scale = []
    if turning.size:
        both_ways = np.concatenate([turning, -turning])
        slope = both_ways / float(both_ways @ both_ways) / PPM
        scale = [_difference(law, simulated, both_ways, slope, t) for t in temps_c.tolist()]
    return Apart(
        temps_c,
        *np.array(bias).T,
        *(np.array(scale).T if scale else (None, None)),
    )


def _difference(
    law: Coefficients, simulated: Surface, rate_dps: Floats, weight: Floats, temp_c: float
) -> tuple[float, float]:
    """A weighted sum of what the two differ by at some rates, and its standard deviation."""
    at_c = np.full_like(rate_dps, temp_c)
    output_dps = law.surface.output_dps(rate_dps, at_c)
    x_dps = output_dps if law.surface.direction == "output" else rate_dps
    row = weight @ law.surface.design(x_dps, at_c)
    value = float(weight @ (output_dps - simulated.output_dps(rate_dps, at_c)))
    variance = max(float(row @ law.covariance_dps2 @ row), 0.0)
    c = Conditions(np.zeros(rate_dps.size), rate_dps, at_c)
    for term in law.terms:
        if isinstance(term, Term) and of_rate_alone(term.effect):
            amplitude = term.parameters["amplitude"]
            added = float(weight @ term.error_dps(c, law.surface))
            value += added
            if value_of := float(amplitude["value"]):
                variance += (added / value_of * float(amplitude.get("std") or 0.0)) ** 2
    return value, float(np.sqrt(variance))


def _interval(value: Floats, std: Floats) -> list[list[float]]:
    ends = zip((value - NORMAL_95 * std).tolist(), (value + NORMAL_95 * std).tolist(), strict=True)
    return [[low, high] for low, high in ends]
