"""Parameters of what was named, with intervals: amplitudes beside everything else, shapes by their profile."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fmin
from scipy.stats import t as student

from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.laws.scan import Scan, free_of, rarity, scan_of, shapes_of_others
from gyrocal.diagnosis.model.intervals import (
    RISE_95,
    Interval,
    Point,
    along_axis,
    amplitude_interval,
    descend,
    holding,
    instant_interval,
    profile_interval,
    shapes_within,
)
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.diagnosis.model.parts import EACH_RATE
from gyrocal.diagnosis.model.rate_errors import size_ppm
from gyrocal.diagnosis.model.within import Pattern
from gyrocal.diagnosis.result import Estimate
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect
from gyrocal.units import MDPS, NORMAL_95

Floats = NDArray[np.float64]

#: The best of one parameter is sought within this ratio.
_NEAR = 2.0
#: That of two from a simplex of this size (logarithm), in so many steps, and from so many places of the grid.
_SIMPLEX, _DESCENTS, _STARTS = 0.2, 80, 5
#: Shapes that are best in their neighbourhood are one within this (logarithm).
_SAME_MODE = 0.1
#: Of two parameters so many values each, to this power of the ratio within which each would be by itself: parameters that
#: are traded for one another have intervals up to about that much wider.
_GRID, _WIDER = 21, 3.0
#: Values of each of two parameters by which a law is averaged whose amplitude is known to no better than this ratio.
_AVERAGED, _KNOWN = 6, 1.25
#: Shapes of less than this share of the likeliest one's weight count for nothing.
_IDLE = 0.01
#: Rows on either side of a jump in which its instant is looked for more closely than between rows.
_ROWS_NEAR = 2


@dataclass(frozen=True)
class LawEstimates:
    """Parameters of a law, and what it adds beyond the surface, mdeg/s rms over the rows.

    Of parameters that a record cannot separate the sum of what they do is known all the same. `on_scale` is the amplitude on the
    scale factor of a law that acts on it beside the bias, at 100 deg/s.
    """

    parameters: dict[str, Estimate]
    adds: Estimate
    on_scale: Estimate | None = None


def of_law(fitted: Fitted, law: Law, laws: Laws, without: list[str]) -> LawEstimates:
    """Parameters of a law beside everything else in a model.

    Each has the interval in which its likelihood, the others at their best, is high enough: of parameters that are
    traded for one another every interval allows for the others, those of other laws too.

    Parameters
    ----------
    without : components that the law takes the place of
    """
    effect = CATALOGUE[law.effect]
    beside = scan_of(fitted, law, laws, without, shapes_of_others(fitted, law, laws))
    here = beside.of(law.columns, law.shape)
    free = free_of(law)
    intervals, along = _intervals(beside, law.shape, free)
    points = [here, *along]
    known = effect.parameter("amplitude")
    amplitude = Estimate.spanning(here.amplitude, amplitude_interval(points), known.unit)
    amplitude = amplitude.open_at(known.low, known.high)
    low, high = amplitude_interval([_sized(p) for p in points])
    size = abs(here.amplitude) * here.unit_dps / MDPS
    adds = Estimate.spanning(size, (low / MDPS, high / MDPS), "mdeg/s")
    return LawEstimates(
        {"amplitude": amplitude, **_shapes(effect, law.shape, intervals)},
        adds.open_at(-size, size) if amplitude.at_bound else adds,
        beside.on_scale(law) if "rate_scale_dps" in law.shape else None,
    )


def likely_shapes(fitted: Fitted, law: Law, laws: Laws) -> list[tuple[float, Mapping[str, float], Fitted]]:
    """Shapes that a law of the rate may have, with their weights and the model with each: one where its size is known.

    Shapes far apart may be as likely, each beside other variances.
    """
    free = free_of(law)
    if not free:
        return [(1.0, law.shape, fitted)]
    beside = scan_of(fitted, law, laws, [])
    modes = _modes(beside, law.shape, free)
    along = [point for mode in modes for point in _around(beside, mode, free, law.shape)[1]]
    low, high = amplitude_interval([beside.of(law.columns, law.shape), *along])
    if low * high > 0.0 and max(abs(low), abs(high)) < _KNOWN * min(abs(low), abs(high)):
        return [(1.0, law.shape, fitted)]
    found: list[tuple[float, Mapping[str, float], Fitted]] = []
    for mode in modes:
        near = moved(fitted, law, mode, laws)
        found += _shapes_near(fitted.refit(near.model, start=near.fit.log_variance), mode, law, laws)
    # A shape that does nothing at these rows has neither amplitude nor weight.
    found = [one for one in found if np.isfinite(one[0])]
    if not found:
        return [(1.0, law.shape, fitted)]
    logarithms = np.array([logarithm for logarithm, _, _ in found])
    weights = np.exp(logarithms - logarithms.max())
    weights[weights < _IDLE] = 0.0
    weights /= weights.sum()
    return [(w, *own) for w, (_, *own) in zip(weights.tolist(), found, strict=True) if w > 0.0]


def _shapes_near(
    fitted: Fitted, shape: Mapping[str, float], before: Law, laws: Laws
) -> list[tuple[float, Mapping[str, float], Fitted]]:
    """Shapes all over the intervals around one: logarithm of the weight, shape and model of each.

    Parameters
    ----------
    before : the law at the shape that it had, by its effect in the model
    """
    law = next(x for x in fitted.model.laws if x.effect == before.effect and x.shape == shape)
    free = free_of(law)
    beside = scan_of(fitted, law, laws, []).of_kind(shape)
    intervals = _around(beside, shape, free, shape)[0]
    axes = [np.geomspace(*intervals[name], _AVERAGED) for name in free]
    # Points are as far apart as the intervals are wide.
    cell = float(np.sum([np.log(np.log(high / low)) for low, high in (intervals[n] for n in free)]))
    # The evidence has no prior of the amplitude yet.
    here = beside.of(law.columns, law.shape)
    likely = here.loss / 2.0 - fitted.nll - rarity(here.amplitude, here.std)
    found: list[tuple[float, Mapping[str, float], Fitted]] = []
    for place in product(*axes):
        other = {**law.shape, **dict(zip(free, map(float, place), strict=True))}
        found.append((likely - beside.at(other).loss / 2.0 + cell, other, moved(fitted, law, other, laws)))
    return found


def moved(fitted: Fitted, law: Law, shape: Mapping[str, float], laws: Laws) -> Fitted:
    """The same variances, with a law at another shape."""
    other = replace(law, shape=shape, columns=laws.at(CATALOGUE[law.effect], shape))
    own = tuple(other if x is law else x for x in fitted.model.laws)
    variance, log_variance = (
        {**known, other.name: known[law.name]} for known in (fitted.fit.variance, fitted.fit.log_variance)
    )
    fit = replace(fitted.fit, variance=variance, log_variance=log_variance)
    return replace(fitted, model=replace(fitted.model, laws=own), fit=fit)


def reshaped(fitted: Fitted, laws: Laws, only: Collection[str] | None = None) -> Fitted:
    """The model with each law, or only those of some names, at the shape that does best beside everything else that is in it by now.

    Its shape was found before the others were in the model, and while the noise stood in for them. Instants of jumps stay
    where they are, and laws that are spread over several shapes have no single one. Which law is named is decided before
    this: with its shape free one law can take what belongs to another, as a drift that slows down takes a warm-up of two
    time constants.
    """
    for law in fitted.model.laws:
        free = free_of(law)
        asked = only is None or law.name in only
        if not asked or not free or "at_s" in free or law.from_end or law.spread or law.mixture:
            continue
        shape = _modes(scan_of(fitted, law, laws, []), law.shape, free)[0]
        fitted = min(fitted, fitted.refit(moved(fitted, law, shape, laws).model), key=lambda f: f.nll)
    return fitted


def _sized(point: Point) -> Point:
    """The same with what the law adds in place of its amplitude."""
    return replace(point, amplitude=abs(point.amplitude) * point.unit_dps, std=point.std * point.unit_dps)


def _shapes(
    effect: Effect, shape: Mapping[str, float], intervals: Mapping[str, Interval]
) -> dict[str, Estimate]:
    """Parameters of a shape; one that was chosen from a few has no interval."""
    units = {p.name: p.unit for p in effect.parameters}
    return {
        name: Estimate.spanning(float(value), intervals[name], units[name])
        if name in intervals
        else Estimate.exact(float(value), units[name])
        for name, value in shape.items()
        if name in units
    }


def _intervals(
    beside: Scan, shape: Mapping[str, float], free: Sequence[str]
) -> tuple[dict[str, Interval], list[Point]]:
    """Intervals of the parameters of a shape, the others at their best, and points all over them."""
    if "at_s" in free:
        instants = _instants(beside.laws, shape["at_s"])
        own = instant_interval(partial(_loss, beside, shape, "at_s"), shape["at_s"], instants)
        inside = instants[(instants >= own[0]) & (instants <= own[1])]
        return {"at_s": own}, [beside.at({**shape, "at_s": float(x)}) for x in inside]
    each = [_around(beside, mode, free, shape) for mode in _modes(beside, shape, free)]
    ends = {n: np.array([own[n] for own, _ in each]) for n in free}
    hull = {n: (float(own[:, 0].min()), float(own[:, 1].max())) for n, own in ends.items()}
    return hull, [point for _, points in each for point in points]


def _around(
    beside: Scan, best_shape: Mapping[str, float], free: Sequence[str], stated: Mapping[str, float]
) -> tuple[dict[str, Interval], list[Point]]:
    """The same around one of the shapes that are best in their neighbourhood.

    Parameters
    ----------
    stated : the shape that stands in the model, which is inside
    """
    alone = {}
    for name in free:
        loss = partial(_loss, beside, best_shape, name)
        own = profile_interval(loss, best_shape[name], _limits(beside, name))
        alone[name] = holding(own, stated[name])
    if len(free) > 1:
        return _jointly(beside, stated, best_shape, alone)
    values = {n: shapes_within(own) for n, own in alone.items()}
    return alone, [beside.at({**stated, n: float(x)}) for n, tried in values.items() for x in tried]


def _modes(beside: Scan, shape: Mapping[str, float], free: Sequence[str]) -> list[dict[str, float]]:
    """Shapes that are best in their neighbourhood, the likeliest first, and hardly less likely: that in the model was found beside less.

    Of two parameters that are traded for one another there may be several, far apart: a peak that is narrow and high, and
    a wide one beside it. Of one as well, as of a knee between two rates.
    """
    kinds = [beside.of_kind({**shape, **kind}) for kind in beside.kinds(shape)]
    best = [(kind, _best_shape(kind, {**shape, **kind.kind}, free)) for kind in kinds]
    best += [
        (kind, _best_shape(kind, start, free))
        for kind in kinds
        for start in _starts(kind, {**shape, **kind.kind}, free)
    ]
    ranked = sorted(((kind.at(mode).loss, k) for k, (kind, mode) in enumerate(best)))
    found = list[dict[str, float]]()
    for loss, k in ranked:
        kind, mode = best[k]
        same = [x for x in found if all(x[n] == value for n, value in kind.kind.items())]
        near = any(all(abs(np.log(mode[n] / x[n])) < _SAME_MODE for n in free) for x in same)
        if loss <= ranked[0][0] + RISE_95 and not near:
            found.append(mode)
    return found


def _starts(beside: Scan, shape: Mapping[str, float], free: Sequence[str]) -> list[dict[str, float]]:
    """The best shapes of the grid, one for each value of the first parameter; of one parameter those that are better than those next to them."""
    best: dict[float, tuple[float, dict[str, float]]] = {}
    # Of a law that has several forms the grid may have others, and those without a corner's softness.
    whole = beside.effect.search.grid(beside.laws.offer)
    grid = [at for at in whole if free and at.keys() >= {*free} and all(at[n] > 0.0 for n in free)]
    for at in grid:
        tried = {**shape, **{n: at[n] for n in free}}
        loss = beside.at(tried).loss
        if at[free[0]] not in best or loss < best[at[free[0]]][0]:
            best[at[free[0]]] = loss, tried
    along = [best[value] for value in sorted(best)]
    if len(free) < 2:
        losses = np.pad([loss for loss, _ in along], 1, constant_values=np.inf)
        along = [
            x for x, near, far in zip(along, losses[:-2], losses[2:], strict=True) if x[0] < min(near, far)
        ]
    return [tried for _, tried in sorted(along, key=lambda x: x[0])[:_STARTS]]


def _best_shape(beside: Scan, shape: Mapping[str, float], free: Sequence[str]) -> dict[str, float]:
    """The best shape near one."""
    if len(free) < 2:
        best = {n: descend(partial(_loss, beside, shape, n), shape[n], _NEAR) for n in free}
        return {**shape, **{n: float(np.clip(x, *_limits(beside, n))) for n, x in best.items()}}
    limits = np.log(np.maximum([_limits(beside, n) for n in free], np.finfo(float).tiny))

    def at(logs: Floats) -> dict[str, float]:
        return {**shape, **dict(zip(free, np.exp(np.clip(logs, *limits.T)).tolist(), strict=True))}

    start = np.log([shape[n] for n in free])
    simplex = np.vstack([start, start + _SIMPLEX * np.eye(len(free))])

    def loss(logs: Floats) -> float:
        return beside.at(at(logs)).loss

    best_logs = fmin(
        loss, start, xtol=2e-3, ftol=1e-3, maxiter=_DESCENTS, initial_simplex=simplex, disp=False
    )
    return at(np.asarray(best_logs))


def _loss(beside: Scan, shape: Mapping[str, float], name: str, value: float) -> float:
    return beside.at({**shape, name: value}).loss


def _limits(beside: Scan, name: str) -> tuple[float, float]:
    known, search = beside.effect.parameter(name), beside.effect.search
    return known.low, search.most(name, beside.laws.offer) if name in search.bounded else known.high


def _jointly(
    beside: Scan,
    shape: Mapping[str, float],
    best_shape: Mapping[str, float],
    alone: Mapping[str, Interval],
) -> tuple[dict[str, Interval], list[Point]]:
    """Intervals of two parameters that are traded for one another, from a grid over both.

    The grid reaches beyond the interval that each has by itself.
    """
    axes = {}
    for name, own in alone.items():
        best, (low, high) = best_shape[name], _limits(beside, name)
        ends = [
            max(best * (own[0] / best) ** _WIDER, low),
            min(best * (own[1] / best) ** _WIDER, high),
        ]
        axes[name] = np.unique([*np.geomspace(ends[0], ends[1], _GRID), best])
    names = list(axes)
    places = [dict(zip(names, map(float, place), strict=True)) for place in product(*axes.values())]
    points = [beside.at({**shape, **place}) for place in places]
    loss = np.array([p.loss for p in points]).reshape([axis.size for axis in axes.values()])
    # A peak between two rates may fit better than the one that is stated, and be none: both are inside.
    stated = beside.at(shape).loss
    intervals = {
        name: holding(along_axis(axis, loss.min(axis=1 - k), stated), shape[name])
        for k, (name, axis) in enumerate(axes.items())
    }
    return intervals, points


def _instants(laws: Laws, near_s: float) -> Floats:
    """Boundaries between rows, and instants within the rows near one."""
    means = laws.means
    row = int(np.searchsorted(means.from_s, near_s))
    first, last = means.from_s[max(row - _ROWS_NEAR, 0)], means.to_s[min(row + _ROWS_NEAR, len(means)) - 1]
    return np.unique([*means.from_s, *np.linspace(first, last, 16 * _ROWS_NEAR), near_s])


def of_pattern(pattern: Pattern) -> dict[str, Estimate]:
    """Parameters of a pattern within data sets: amplitude and phase from cosine and sine.

    Their covariance is known to the scatter between the sets: Student's t.
    """
    effect = CATALOGUE[pattern.effect]
    b, v = pattern.amplitudes, pattern.covariance * (student.ppf(0.975, pattern.dof) / NORMAL_95) ** 2
    unit = effect.parameter("amplitude").unit
    if b.size == 1:
        found = {"amplitude": Estimate.normal(float(b[0]), float(np.sqrt(v[0, 0])), unit)}
    else:
        size = float(np.hypot(*b))
        along, across = b / size, np.array([-b[1], b[0]]) / size**2
        found = {
            "amplitude": Estimate.normal(size, float(np.sqrt(along @ v @ along)), unit),
            "phase_rad": Estimate.normal(
                float(np.arctan2(-b[1], b[0])), float(np.sqrt(across @ v @ across)), "rad"
            ),
        }
    if pattern.size is not None:
        found["amplitude"] = Estimate.spanning(found["amplitude"].value, pattern.size, unit)
    return found | _shapes(effect, pattern.shape, pattern.intervals)


def of_draws(fitted: Fitted) -> Estimate:
    """Size of the independent errors of the rates, ppm, with the interval of its likelihood."""
    logs = dict(fitted.fit.log_variance)
    steps = np.linspace(-4.0, 4.0, 33)
    nll = [
        fitted.contrasts.nll(fitted.model.all, {**logs, EACH_RATE: logs[EACH_RATE] + float(s)}) for s in steps
    ]
    between = np.linspace(steps[0], steps[-1], 1001)
    likely = np.interp(between, steps, nll)
    inside = between[likely < min(nll) + 0.5 * RISE_95]
    # The variance was fitted before the last laws were there; beside them another may be likelier.
    shifts = np.array([between[np.argmin(likely)], inside[0], inside[-1]])
    best, low, high = (size_ppm(fitted) * np.exp(0.5 * shifts)).tolist()
    return Estimate.spanning(best, (low, high), "ppm")
