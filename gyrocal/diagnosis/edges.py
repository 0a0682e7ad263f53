"""Edges over temperature: where the scale factor goes from one level to another within few degrees.

Powers of the temperature and bumps follow an edge badly, and a plan goes through temperatures in turn: what they leave
of it looks like steps, lines and walks in time. So edges are looked for in the place of these. A bias wanders anyhow, and
edges would follow it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.layers import Fitted, Model
from gyrocal.diagnosis.parts import Part, tells_of_scale, temperatures_apart, temperatures_turned
from gyrocal.inference.additive import gains
from gyrocal.physics.smooth import Column, Factor
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]

#: Widths as shares of half the range of temperatures: an octave apart, up to where powers follow.
_WIDTHS = np.array([0.05, 0.1, 0.2, 0.4])
#: Centers as shares of half the range, half a width of the second narrowest apart.
_CENTERS = np.linspace(-0.9, 0.9, 37)
#: How often the best is looked for between its neighbours, and where on the way to either.
_ZOOMS, _EITHER_SIDE = 3, np.linspace(-1.0, 1.0, 5)
#: Edges of one record.
_MOST_EDGES = 2
#: A height, a center and a width beside the surface's three terms go through any five temperatures.
_LEAST_TEMPERATURES = SHAPE[1] + 3
#: An edge is passed so often, or a step at an instant does the same.
_PASSED = 2


def with_edges(fitted: Fitted) -> Fitted:
    """The model with the edges that it lacks."""
    tried = _shapes(fitted.model)
    for _ in range(_MOST_EDGES if tried else 0):
        new = fitted.refit(fitted.model.with_parts([_best(fitted, tried)]))
        if new.nll >= fitted.nll:
            break
        fitted = new
    return fitted


def _shapes(model: Model) -> list[tuple[float, float]]:
    """Centers and widths that are tried, degC; none where a record tells of no shape in temperature."""
    means, frame = model.means, model.basis.frame
    temp_c = temperatures_turned(means)
    if not tells_of_scale(means) or temperatures_apart(temp_c, frame) < _LEAST_TEMPERATURES:
        return []
    centers_c, widths_c = frame.temp_center_c + _CENTERS * frame.temp_scale_c, _WIDTHS * frame.temp_scale_c
    shapes = [(float(c), float(w)) for w in widths_c for c in centers_c]
    return [(c, w) for c, w in shapes if _passed(temp_c, c, w) >= _PASSED]


def _passed(temp_c: Floats, center_c: float, width_c: float) -> int:
    """How often temperatures, one after the other, went from one level of an edge to the other: once is as well an instant."""
    side = np.sign(temp_c - center_c)[np.abs(temp_c - center_c) >= width_c]
    return int(np.count_nonzero(np.diff(side)))


def _best(fitted: Fitted, tried: Sequence[tuple[float, float]]) -> Part:
    """The edge that gains most beside a model."""
    model = fitted.model
    score, p = fitted.contrasts.precision(model.all, fitted.fit.log_variance)

    def best_of(shapes: Sequence[tuple[float, float]]) -> tuple[float, float]:
        columns = np.column_stack([_column(model, *shape) for shape in shapes])
        return shapes[int(np.argmax(gains(columns, score, p)))]

    center_c, width_c = best_of(tried)
    reach_c, factor = 0.5 * float(np.diff(_CENTERS)[0]) * model.basis.frame.temp_scale_c, 2.0**0.5
    for _ in range(_ZOOMS):
        centers, widths = center_c + reach_c * _EITHER_SIDE, width_c * factor**_EITHER_SIDE
        center_c, width_c = best_of([(float(c), float(w)) for c in centers for w in widths])
        reach_c, factor = 0.5 * reach_c, factor**0.5
    return _part(center_c, width_c, toll=0.5 * float(np.log(len(tried))))


def _part(center_c: float, width_c: float, toll: float = 0.0) -> Part:
    label = f"temperature edge on scale at {center_c:.4g} degC within {width_c:.3g} degC"
    column = Column(Factor("linear"), Factor("edge", (center_c, width_c)))
    return Part(label, "temperature", (column,), (1.0,), toll)


def _column(model: Model, center_c: float, width_c: float) -> Floats:
    columns = model.basis.component(_part(center_c, width_c)).columns
    return np.asarray(columns)[:, 0]
