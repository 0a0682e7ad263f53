"""On what an effect is folded to be seen."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.fold import temperature_or_scale


@pytest.mark.parametrize(("of_scale", "unit"), [(False, "mdeg/s"), (True, "ppm of rate")])
def test_a_shape_in_temperature_is_drawn_as_what_it_acts_on(of_scale: bool, unit: str) -> None:
    rate = np.tile([0.0, -60.0, 60.0], 40)
    temp = np.repeat(np.linspace(-10.0, 50.0, 40), 3)
    shape = 1e-4 * np.tanh((temp - 25.0) / 4.0)
    error_dps = shape * rate if of_scale else 30.0 * shape
    axis = temperature_or_scale(Conditions(np.arange(float(rate.size)), rate, temp), {}, error_dps)
    assert axis.unit == unit
    here = np.isfinite(axis.x) & (axis.gain != 0.0)
    told = error_dps[here] / axis.gain[here]
    np.testing.assert_allclose(told, (1e6 if of_scale else 30e3) * shape[here], rtol=1e-12)
