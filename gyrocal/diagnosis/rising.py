"""What a robot can undo: shapes near zero rate that let the output rise with the rate.

Within a dead zone the output stands still, and no file brings the rate back that it swallowed. A shape that follows it
there would make noise of what is near to rest, or throw it from one edge of the zone to the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.layers import Fitted
from gyrocal.diagnosis.parts import Part
from gyrocal.inference.additive import Component
from gyrocal.physics.shapes import ASINH_SHARE
from gyrocal.physics.smooth import Frame, rate_factors

Floats = NDArray[np.float64]

#: With every deg/s the output has to rise by this much at the least: below it what is not known counts more than twice.
_LEAST_RISE = 0.5
#: Rates at which the slope is looked at, evenly over asinh of the rate.
_PLACES = 2001


def rising(fitted: Fitted) -> Fitted:
    """The model whose shapes near zero let the output rise with the rate, those that do not being no part of it any more.

    The narrowest shapes are fitted to the rows within the zone alone, and explain what was swallowed there; the others
    follow what lies beyond, at the same variances.
    """
    amplitudes = fitted.solve().amplitudes
    for part in fitted.model.parts:
        if part.name in amplitudes and all(c.rate.kind.endswith("asinh_bump") for c in part.columns):
            fitted, amplitudes = _freed(fitted, part, amplitudes)
    return fitted


def _freed(
    fitted: Fitted, part: Part, amplitudes: Mapping[str, Floats]
) -> tuple[Fitted, Mapping[str, Floats]]:
    """The model less the narrowest shapes of a part, as many as need be, and its amplitudes."""
    frame = fitted.model.basis.frame
    rates_dps, slopes = _slopes(part, amplitudes, frame)
    falling = np.abs(rates_dps[slopes < _LEAST_RISE - 1.0])
    if not falling.size:
        return fitted, amplitudes
    for narrow in range(1, len(part.columns) + 1):
        # Of models that are averaged each may keep others: what differs has another name.
        gone, stays = (
            replace(part, name=f"{part.name}{of}", columns=part.columns[own], weights=part.weights[own])
            for own, of in ((slice(narrow), ", within"), (slice(narrow, None), f" from {narrow}"))
        )
        split = _split(fitted, part, gone, stays, float(falling.max()))
        left = split.solve().amplitudes
        if not stays.columns or np.min(_slopes(stays, left, frame)[1]) >= _LEAST_RISE - 1.0:
            break
    return split, left


def _slopes(part: Part, amplitudes: Mapping[str, Floats], frame: Frame) -> tuple[Floats, Floats]:
    """Rates, and how fast what a part adds rises there, deg/s for each deg/s."""
    reach = np.arcsinh(1.0 / ASINH_SHARE)
    rates_dps = ASINH_SHARE * frame.rate_scale_dps * np.sinh(np.linspace(-reach, reach, _PLACES))
    factors = rate_factors(rates_dps, frame, [c.rate for c in part.columns])
    columns = [w * factors[c.rate] for w, c in zip(part.weights, part.columns, strict=True)]
    return rates_dps, np.gradient(np.column_stack(columns) @ amplitudes[part.name], rates_dps)


def _split(fitted: Fitted, part: Part, gone: Part, stays: Part, edge_dps: float) -> Fitted:
    """The same variances, with the columns that go as a component that does not stay, of the rows within the zone alone."""
    model, fit = fitted.model, fitted.fit
    inside = np.abs(model.means.rate_dps) <= edge_dps
    components = {n: c for n, c in model.components.items() if n != part.name}
    swallowed = np.asarray(model.basis.component(gone).columns) * inside[:, None]
    components[gone.name] = Component(gone.name, swallowed)
    if stays.columns:
        components[stays.name] = model.basis.component(stays)
    parts = tuple(stays if p is part else p for p in model.parts if p is not part or stays.columns)
    variance, log_variance = (
        {**known, gone.name: known[part.name], stays.name: known[part.name]}
        for known in (fit.variance, fit.log_variance)
    )
    fit = replace(fit, variance=variance, log_variance=log_variance)
    return replace(fitted, model=replace(model, parts=parts, components=components), fit=fit)
