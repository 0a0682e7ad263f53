"""Edges over temperature: where the scale factor, or the bias, goes from one level to another within few degrees.

Powers of the temperature and bumps follow an edge badly, and a plan goes through temperatures in turn: what they leave
of it looks like steps, lines and walks in time. So edges are looked for in the place of these. A bias wanders anyhow, and
edges would follow it: its own are looked for where it jumps more than once, as it does where it passes one up and down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.model.intervals import RISE_95
from gyrocal.diagnosis.model.layers import Fitted, Model
from gyrocal.diagnosis.model.parts import Part
from gyrocal.diagnosis.rows.visited import tells_of_scale, temperatures_apart, temperatures_turned
from gyrocal.inference.additive import gains
from gyrocal.physics.smooth import Column, Factor
from gyrocal.physics.surface import SHAPE
from gyrocal.physics.timewise import BIAS_STEP
from gyrocal.units import MDPS, PPM

Floats = NDArray[np.float64]

#: Widths as shares of half the range of temperatures: an octave apart, up to where powers follow.
_WIDTHS = np.array([0.05, 0.1, 0.2, 0.4])
#: Centers as shares of half the range, half a width of the second narrowest apart.
_CENTERS = np.linspace(-0.9, 0.9, 37)
#: How often the best is looked for between its neighbours, and where on the way to either.
_ZOOMS, _EITHER_SIDE = 3, np.linspace(-1.0, 1.0, 5)
#: Shape of the temperature that an edge is, and by which shape of the rate it acts on the scale factor or the bias.
_EDGE, _BY_RATE = "edge", {"scale": Factor("linear"), "bias": Factor()}
#: Jumps of the bias from which on they may be passages of an edge.
_PASSAGES = 2
#: Shapes about the best of which it is told which are likely, each way: how many, how far in widths, and by which factor;
#: how many tell the ends, and how often they are looked for closer.
_ALL_OVER, _FARTHEST, _WIDEST, _TELLING, _CLOSER = 25, 2.0, 6.0, 9, 4
#: Fall of the log-likelihood at the ends of a 95 % interval.
_LIKELY = 0.5 * RISE_95
#: Edges of one record.
_MOST_EDGES = 2
#: What is nearer to the center of an edge, in widths, may have passed it by noise.
_ASIDE = 0.25
#: A height, a center and a width beside the surface's three terms go through any five temperatures.
_LEAST_TEMPERATURES = SHAPE[1] + 3


def targets(effects: Sequence[str]) -> tuple[str, ...]:
    """On what edges may act, beside effects that were found at instants without them."""
    return ("scale", "bias") if effects.count(BIAS_STEP.id) >= _PASSAGES else ("scale",)


def with_edges(fitted: Fitted, on: Sequence[str] = ("scale",)) -> Fitted:
    """The model with the edges that it lacks, of the scale factor or the bias."""
    tried = [(target, *shape) for target in on for shape in _shapes(fitted.model, target)]
    for _ in range(_MOST_EDGES if tried else 0):
        first = fitted.refit(fitted.model.with_parts([_best(fitted, tried)]))
        # Narrow shapes had followed the edge nearly to its middle, and beside it they no longer do.
        part = _best(replace(fitted, fit=first.fit), tried)
        new = min(
            first, fitted.refit(fitted.model.with_parts([part]), first.fit.log_variance), key=lambda f: f.nll
        )
        if new.nll >= fitted.nll:
            break
        fitted = new
    return fitted


def told(fitted: Fitted) -> list[dict[str, float]]:
    """Each edge of a model of a known sign: the change of the scale factor, ppm, or of the bias, mdeg/s, its center and its width, degC.

    With 95 % intervals; `of_scale` tells which.

    They are those of the profile likelihood, at the variances that all else has.
    """
    parts = [p for p in fitted.model.parts if p.name in fitted.model.components]
    edges = [
        _told(fitted.granting_noise, p) for p in parts if any(c.temperature.kind == _EDGE for c in p.columns)
    ]
    return [edge for edge in edges if edge["size_low"] * edge["size_high"] > 0.0]


def _told(fitted: Fitted, part: Part) -> dict[str, float]:
    model = fitted.model.without([part.name])
    score, p = fitted.contrasts.precision(model.all, fitted.fit.log_variance)
    center_c, width_c = part.columns[0].temperature.numbers
    target = next(t for t, rate in _BY_RATE.items() if part.columns[0].rate == rate)
    # From -1 to 1 it goes by two.
    shown = 2.0 / PPM / model.basis.frame.rate_scale_dps if target == "scale" else 2.0 / MDPS
    reach, ratio = _FARTHEST * width_c, _WIDEST
    for _ in range(_CLOSER):
        centers = center_c + reach * np.linspace(-1.0, 1.0, _ALL_OVER)
        widths = width_c * ratio ** np.linspace(-1.0, 1.0, _ALL_OVER)
        shapes = [(float(c), float(w)) for c in centers for w in widths]
        columns = np.column_stack([_column(model, target, *shape) for shape in shapes])
        found = 0.5 * gains(columns, score, p)
        above = found - found.max() + _LIKELY
        likely = (above > 0.0).reshape(_ALL_OVER, _ALL_OVER)
        center, width = centers[likely.any(axis=1)], widths[likely.any(axis=0)]
        # The ends lie between what is likely and its neighbours.
        beyond_c, factor = reach / (_ALL_OVER - 1), ratio ** (1.0 / (_ALL_OVER - 1))
        if min(center.size, width.size) >= _TELLING:
            break
        # Between two neighbours at the least.
        reach = max(float(np.ptp(center)), 2.0 * reach / _ALL_OVER)
        ratio = max(float(width[-1] / width[0]), ratio ** (2.0 / _ALL_OVER))
    kept = above > 0.0
    information = np.einsum("ij,ij->j", columns[:, kept], p @ columns[:, kept])
    sizes = shown * (columns[:, kept].T @ score) / information
    half = shown * np.sqrt(2.0 * above[kept] / information)
    return {
        "of_scale": target == "scale",
        "size": float(sizes[np.argmax(above[kept])]),
        "size_low": float(np.min(sizes - half)), "size_high": float(np.max(sizes + half)),
        "center_c": center_c, "center_low": float(center[0]) - beyond_c, "center_high": float(center[-1]) + beyond_c,
        "width_c": width_c, "width_low": float(width[0]) / factor, "width_high": float(width[-1]) * factor,
    }  # fmt: skip


def _shapes(model: Model, target: str) -> list[tuple[float, float]]:
    """Centers and widths that are tried, degC: of edges whose two levels were seen; none where a record tells of no shape."""
    means, frame = model.means, model.basis.frame
    temp_c = temperatures_turned(means) if target == "scale" else means.temp_c
    if (target == "scale" and not tells_of_scale(means)) or temperatures_apart(
        temp_c, frame
    ) < _LEAST_TEMPERATURES:
        return []
    centers_c, widths_c = frame.temp_center_c + _CENTERS * frame.temp_scale_c, _WIDTHS * frame.temp_scale_c
    low_c, high_c = temp_c.min(), temp_c.max()
    seen = [(float(c), float(w)) for w in widths_c for c in centers_c if low_c + w <= c <= high_c - w]
    return [shape for shape in seen if _comes_again(temp_c, *shape)]


def _comes_again(temp_c: Floats, center_c: float, width_c: float) -> bool:
    """Whether temperatures, one after the other, pass an edge more than once: once it is as well an instant."""
    away_c = temp_c - center_c
    return bool(np.count_nonzero(np.diff(np.sign(away_c[np.abs(away_c) >= _ASIDE * width_c]))) > 1)


def _best(fitted: Fitted, tried: Sequence[tuple[str, float, float]]) -> Part:
    """The edge that gains most beside a model."""
    model = fitted.model
    score, p = fitted.contrasts.precision(model.all, fitted.fit.log_variance)

    def best_of(shapes: Sequence[tuple[str, float, float]]) -> tuple[str, float, float]:
        columns = np.column_stack([_column(model, *shape) for shape in shapes])
        return shapes[int(np.argmax(gains(columns, score, p)))]

    target, center_c, width_c = best_of(tried)
    reach_c, factor = 0.5 * float(np.diff(_CENTERS)[0]) * model.basis.frame.temp_scale_c, 2.0**0.5
    for _ in range(_ZOOMS):
        centers, widths = center_c + reach_c * _EITHER_SIDE, width_c * factor**_EITHER_SIDE
        _, center_c, width_c = best_of([(target, float(c), float(w)) for c in centers for w in widths])
        reach_c, factor = 0.5 * reach_c, factor**0.5
    return _part(target, center_c, width_c, toll=0.5 * float(np.log(len(tried))))


def _part(target: str, center_c: float, width_c: float, toll: float = 0.0) -> Part:
    label = f"temperature edge on {target} at {center_c:.4g} degC within {width_c:.3g} degC"
    column = Column(_BY_RATE[target], Factor(_EDGE, (center_c, width_c)))
    return Part(label, "temperature", (column,), (1.0,), toll)


def _column(model: Model, target: str, center_c: float, width_c: float) -> Floats:
    columns = model.basis.component(_part(target, center_c, width_c)).columns
    return np.asarray(columns)[:, 0]
