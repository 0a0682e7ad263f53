"""Edges over temperature: where the bias or the scale factor goes from one level to another within few degrees.

Powers of the temperature and bumps follow an edge badly, and a plan goes through temperatures in turn: what they leave
of it looks like steps, lines and walks in time. So it is looked for where nothing wanders, and stays if it explains
more than all that does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.jumps import gains
from gyrocal.diagnosis.layers import Fitted, Model
from gyrocal.diagnosis.parts import Part, tells_of_scale, temperatures_apart, temperatures_telling
from gyrocal.physics.smooth import Column, Factor
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]

#: Widths as shares of half the range of temperatures: an octave apart, up to where powers follow.
_WIDTHS = (0.05, 0.1, 0.2, 0.4)
#: Centers as shares of half the range, half a width of the second narrowest apart.
_CENTERS = np.linspace(-0.9, 0.9, 37)
#: How often the best is looked for between its neighbours, and where on the way to either.
_ZOOMS, _EITHER_SIDE = 3, np.linspace(-1.0, 1.0, 5)
#: Factor of the rate where it is the scale factor that changes.
_SCALE = Factor("linear")
#: Edges of one record.
_MOST_EDGES = 2
#: A height, a center and a width beside the surface's three terms go through any five temperatures.
_LEAST_TEMPERATURES = SHAPE[1] + 3


def with_edges(fitted: Fitted) -> Fitted:
    """The model with the edges that it lacks."""
    tried = {target: shapes for target in (Factor(), _SCALE) if (shapes := _shapes(fitted.model, target))}
    for _ in range(_MOST_EDGES if tried else 0):
        parts = [_best(fitted, target, shapes) for target, shapes in tried.items()]
        new = min((fitted.refit(fitted.model.with_parts([part])) for part in parts), key=lambda f: f.nll)
        if new.nll >= fitted.nll:
            break
        fitted = new
    return fitted


def _shapes(model: Model, target: Factor) -> list[tuple[float, float]]:
    """Centers and widths that are tried, degC: of edges whose two levels were seen; none where a record tells of no shape."""
    means, frame = model.means, model.basis.frame
    temp_c = temperatures_telling(means, of_scale=target == _SCALE)
    tells = target != _SCALE or tells_of_scale(means)
    if not tells or temperatures_apart(temp_c, frame) < _LEAST_TEMPERATURES:
        return []
    low_c, high_c = float(temp_c.min()), float(temp_c.max())
    shapes = [
        (frame.temp_center_c + c * frame.temp_scale_c, w * frame.temp_scale_c)
        for w in _WIDTHS
        for c in _CENTERS
    ]
    return [(float(c), float(w)) for c, w in shapes if low_c + w <= c <= high_c - w]


def _best(fitted: Fitted, target: Factor, tried: Sequence[tuple[float, float]]) -> Part:
    """The edge that gains most beside a model."""
    model = fitted.model
    score, p = fitted.contrasts.precision(model.all, fitted.fit.log_variance)

    def best_of(shapes: Sequence[tuple[float, float]]) -> tuple[float, float]:
        columns = np.column_stack([_column(model, target, *shape) for shape in shapes])
        return shapes[int(np.argmax(gains(columns, score, p)))]

    center_c, width_c = best_of(tried)
    reach_c, factor = 0.5 * float(np.diff(_CENTERS)[0]) * model.basis.frame.temp_scale_c, 2.0**0.5
    for _ in range(_ZOOMS):
        centers, widths = center_c + reach_c * _EITHER_SIDE, width_c * factor**_EITHER_SIDE
        center_c, width_c = best_of([(float(c), float(w)) for c in centers for w in widths])
        reach_c, factor = 0.5 * reach_c, factor**0.5
    return _part(target, center_c, width_c, toll=0.5 * float(np.log(len(tried))))


def _part(target: Factor, center_c: float, width_c: float, toll: float = 0.0) -> Part:
    name = "scale" if target == _SCALE else "bias"
    label = f"temperature edge on {name} at {center_c:.4g} degC within {width_c:.3g} degC"
    column = Column(target, Factor("edge", (center_c, width_c)))
    return Part(label, "temperature", (column,), (1.0,), toll)


def _column(model: Model, target: Factor, center_c: float, width_c: float) -> Floats:
    columns = model.basis.component(_part(target, center_c, width_c)).columns
    return np.asarray(columns)[:, 0]
