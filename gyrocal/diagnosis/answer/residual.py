"""What surface, laws and smooth parts leave of every row."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import Examination, block_curve
from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.model.layers import beyond_input, lagging
from gyrocal.diagnosis.model.parts import BIAS_IN_TIME, BLOCKS, Basis
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.means import rows_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.thermal import THERMAL_LAG

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Residuals:
    """Arrays of shape (rows of the series,), deg/s.

    Attributes
    ----------
    surface : Coefficients
        The surface alone.
    before_dps, after_dps : recorded minus the surface alone, and minus the whole model
    effects_dps : mapping
        What each named effect adds.
    wandering_dps : what the bias does in time by no law: it counts as noise, and is taken off `after_dps` too
    """

    surface: Coefficients
    before_dps: Floats
    after_dps: Floats
    effects_dps: Mapping[str, Floats]
    wandering_dps: Floats


def residuals(found: Examination, series: Series, surface: Coefficients) -> Residuals:
    """What is left of a series, patterns within its data sets included, before and after."""
    plain = surface.surface.error_at_output_dps(series.gyro_dps, series.temp_c)
    before = series.gyro_dps - series.rate_dps - plain
    fitted = found.naming.fitted
    model, solution = fitted.model, fitted.solve()
    rows = Basis(rows_of(found.series), model.basis.frame, model.basis.coil)
    total = rows.surface() @ model.legendre(solution)
    if model.bend is not None and model.direction == "output":
        total += beyond_input(rows, model.bend) @ model.legendre(solution)
    curves = {b: block_curve(fitted, solution, b, rows) for b in BLOCKS}
    total += sum(curves.values(), np.zeros(len(series)))
    effects: defaultdict[str, Floats] = defaultdict(lambda: np.zeros(len(series)))
    for pattern in found.patterns:
        effects[pattern.effect] = effects[pattern.effect] + pattern.values
    if rows.coil is not None:
        effects[THERMAL_LAG.id] = lagging(rows) @ model.legendre(solution)
    c = conditions_of(series)
    laws = Laws(rows.means, c, found.laws.offer, found.laws.surface)
    for law in model.laws:
        columns = law.columns if law.from_end else laws.columns_of(law)
        own = columns @ solution.amplitudes[law.name]
        total += own
        effects[law.effect] = effects[law.effect] + own
    for named in found.naming.named:
        if named.law.effect not in effects:
            effects[named.law.effect] = curves[named.block]
    after = found.series.gyro_dps - found.series.rate_dps - total
    return Residuals(surface, before, after, dict(effects), curves[BIAS_IN_TIME])
