"""What a robot can undo: shapes near zero rate that let the output rise with the rate.

Within a dead zone the output stands still, and no file brings the rate back that it swallowed. A shape that follows it
there would make noise of what is near to rest, or throw it from one edge of the zone to the other. Where the law of a
dead zone explains as much as that shape, the file has the law, which knows what lies between the visited rates, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.model.blocks import REPLACED
from gyrocal.diagnosis.model.intervals import descend
from gyrocal.diagnosis.model.layers import Fitted, Law, Model
from gyrocal.diagnosis.model.parts import Part
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import DEAD_ZONE, TRUNCATION
from gyrocal.physics.shapes import ASINH_SHARE
from gyrocal.physics.smooth import Frame, rate_factors
from gyrocal.physics.timewise import BIAS_DRIFT
from gyrocal.units import MDPS

Floats = NDArray[np.float64]

#: With every deg/s the output has to rise by this much at the least: below it what is not known counts more than twice.
_LEAST_RISE = 0.5
#: An output of less than this share of a dead zone's width is rest. From there on the rate leaps by the width: noise of any
#: size grows to its double at the most, as beside a slope of one half.
_REST = 0.5
#: Rates at which the slope is looked at, evenly over asinh of the rate.
_PLACES = 2001
#: The width of a dead zone is sought within this ratio of what it takes of the larger rates.
_NEAR = 2.0


def rising(fitted: Fitted, zone: Law | None) -> Fitted:
    """The model whose shapes near zero let the output rise with the rate, those that do not being no part of it any more.

    The law of a dead zone takes their place where it explains as much. Else the narrowest shapes are fitted to the rows
    within the zone alone, and explain what was swallowed there; the others follow what lies beyond, at the same variances.
    Where these cannot, the narrowest are fitted to all rows, and what lies beyond is corrected no more than the rest of the
    shape does.

    Parameters
    ----------
    zone : the law that may (`dead_zone`)
    """
    fitted = _by_law(fitted, zone)
    amplitudes = fitted.solve().amplitudes
    for part in fitted.model.parts:
        if part.name in amplitudes and _near_zero(part):
            fitted, amplitudes = _freed(fitted, part, amplitudes)
    return fitted


def dead_zone(fitted: Fitted, laws: Laws) -> Law | None:
    """The law of a dead zone that explains most in place of what stands for one, as far as a robot undoes it; None without any.

    Nor of a gyro whose bias has moved by more than an output that is rest: on the next run nobody knows where the zone is.
    """
    rests = _less_zones(fitted)
    if not rests:
        return None
    shape = _zone(laws, *fitted.contrasts.precision(rests[0].all, fitted.fit.log_variance))
    if shape is None or _moved_dps(fitted) > _REST * shape["width_dps"]:
        return None
    return Law(DEAD_ZONE.id, {**shape, "rest": _REST}, laws.at(DEAD_ZONE, shape))


def _by_law(fitted: Fitted, zone: Law | None) -> Fitted:
    """The model with a law in place of what stands for a dead zone; else laws that no robot undoes are in no file."""
    model = fitted.model
    by_law = [] if zone is None else [rest.with_laws(zone) for rest in _less_zones(fitted)]
    for each in by_law:
        found = fitted.refit(each)
        if found.nll <= fitted.nll + REPLACED:
            return found
    zones = [law for law in model.laws if law.effect == DEAD_ZONE.id]
    amplitudes = fitted.solve().amplitudes if zones else {}
    held = [model.law_component(law) for law in zones if not _rises(law, amplitudes[law.name])]
    if not held:
        return fitted
    return replace(fitted, model=model.without_laws([c.name for c in held]).with_components(*held))


def _rises(zone: Law, amplitude: Floats) -> bool:
    """Whether the output rises within a zone all the same, which takes a part of a small rate only."""
    lost_dps = MDPS * abs(float(amplitude[0]))
    return zone.shape["form"] > 0.0 and lost_dps < (1.0 - _LEAST_RISE) * zone.shape["width_dps"]


def _less_zones(fitted: Fitted) -> list[Model]:
    """The model less its laws of a dead zone and the shapes near zero that fall as one does; none where it has neither.

    First without any shape near zero: what stands beside a law mends its width, and would be in the way of a better one.
    """
    model, amplitudes = fitted.model, fitted.solve().amplitudes
    # Of means nobody sees the steps of the output: cut or swallowed, it lacks as much.
    swallow = {DEAD_ZONE.id, TRUNCATION.id} if model.means.series.is_table else {DEAD_ZONE.id}
    held = [law.name for law in model.laws if law.effect in swallow]
    near = [p for p in model.parts if p.name in amplitudes and _near_zero(p)]
    falling = [p for p in near if _falling(p, amplitudes, model.basis.frame).size]
    if not held and not falling:
        return []
    plain = model.without_laws(held)
    # Where all of them fall the two are one model.
    each = [near] if len(falling) == len(near) else [near, falling]
    return [plain.without([p.name for p in parts]) for parts in each]


def _moved_dps(fitted: Fitted) -> float:
    """By how much the bias has moved in what passes."""
    solution = fitted.solve()
    course = solution.random.get("bias walk", np.zeros(len(fitted.model.means)))
    for law in fitted.model.laws:
        effect = CATALOGUE[law.effect]
        if effect.family == BIAS_DRIFT.family and not effect.runtime and "rate_dps" not in effect.needs:
            course = course + law.columns @ solution.amplitudes[law.name]
    return float(np.ptp(course))


def _near_zero(part: Part) -> bool:
    return all(c.rate.kind.endswith("asinh_bump") for c in part.columns)


def _zone(laws: Laws, score: Floats, precision: Floats) -> dict[str, float] | None:
    """Width and form of the dead zone that explains most beside a model; None where none explains anything.

    What the zone takes of a rate is all of it, or of a larger rate the zone's width: its width is its amplitude.
    """

    def loss(form: float, width_dps: float) -> float:
        lost = width_dps / MDPS * laws.at(DEAD_ZONE, {"width_dps": width_dps, "form": form})[:, 0]
        return float(lost @ precision @ lost - 2.0 * (score @ lost))

    best: dict[str, float] | None = None
    least = 0.0
    for trial in laws.trials(DEAD_ZONE):
        column, form = trial.columns[:, 0], trial.shape["form"]
        size_dps = MDPS * float(column @ score) / float(column @ precision @ column)
        # What is lost at rest alone is the bias there, of which a robot knows no more.
        if form > 0.0 and size_dps > 0.0:
            width_dps = descend(partial(loss, form), size_dps, _NEAR)
            if (found := loss(form, width_dps)) < least:
                best, least = {"width_dps": width_dps, "form": form}, found
    return best


def _freed(
    fitted: Fitted, part: Part, amplitudes: Mapping[str, Floats]
) -> tuple[Fitted, Mapping[str, Floats]]:
    """The model less the narrowest shapes of a part, as many as need be, and its amplitudes."""
    frame = fitted.model.basis.frame
    falling = _falling(part, amplitudes, frame)
    if not falling.size:
        return fitted, amplitudes
    for narrow in range(1, len(part.columns) + 1):
        # Of models that are averaged each may keep others: what differs has another name.
        gone, stays = (
            replace(part, name=f"{part.name}{of}", columns=part.columns[own], weights=part.weights[own])
            for own, of in ((slice(narrow), ", within"), (slice(narrow, None), f" from {narrow}"))
        )
        split = _split(fitted, part, gone, stays, float(falling.max()))
        if split.nll > fitted.nll + REPLACED:
            split = _split(fitted, part, gone, stays, np.inf)
        left = split.solve().amplitudes
        if not stays.columns or np.min(_slopes(stays, left, frame)[1]) >= _LEAST_RISE - 1.0:
            break
    return split, left


def _falling(part: Part, amplitudes: Mapping[str, Floats], frame: Frame) -> Floats:
    """Sizes of the rates at which what a part adds falls too fast, deg/s."""
    rates_dps, slopes = _slopes(part, amplitudes, frame)
    return np.abs(rates_dps[slopes < _LEAST_RISE - 1.0])


def _slopes(part: Part, amplitudes: Mapping[str, Floats], frame: Frame) -> tuple[Floats, Floats]:
    """Rates, and how fast what a part adds rises there, deg/s for each deg/s."""
    reach = np.arcsinh(1.0 / ASINH_SHARE)
    rates_dps = ASINH_SHARE * frame.rate_scale_dps * np.sinh(np.linspace(-reach, reach, _PLACES))
    factors = rate_factors(rates_dps, frame, [c.rate for c in part.columns])
    columns = [w * factors[c.rate] for w, c in zip(part.weights, part.columns, strict=True)]
    return rates_dps, np.gradient(np.column_stack(columns) @ amplitudes[part.name], rates_dps)


def _split(fitted: Fitted, part: Part, gone: Part, stays: Part, edge_dps: float) -> Fitted:
    """The same variances, with the columns that go as a component that does not stay, of the rows up to an edge alone."""
    model, fit = fitted.model, fitted.fit
    sizes_dps = np.abs(model.means.rate_dps)
    # An edge that is nearer to rest than any rate is at the least of them.
    inside = sizes_dps <= max(edge_dps, float(sizes_dps[sizes_dps > 0.0].min()))
    components = {n: c for n, c in model.components.items() if n != part.name}
    swallowed = np.asarray(model.basis.component(gone).columns) * inside[:, None]
    components[gone.name] = Component(gone.name, swallowed)
    if stays.columns:
        components[stays.name] = model.basis.component(stays)
    parts = tuple(stays if p is part else p for p in model.parts if p is not part or stays.columns)
    model = replace(model, parts=parts, components=components)
    variance = {**fit.variance, gone.name: fit.variance[part.name], stays.name: fit.variance[part.name]}
    logs = fitted.contrasts.logs(model.all, variance)
    fit = replace(
        fit,
        variance=variance,
        log_variance={**fit.log_variance, **logs},
        nll=fitted.contrasts.nll(model.all, logs),
    )
    return replace(fitted, model=model, fit=fit)
