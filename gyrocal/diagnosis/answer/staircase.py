"""What each layer is worth on data left out, from the surface alone down to the noise.

Whole data sets, and whole temperatures or sweeps, are left out in turn. Under a Gaussian model the prediction of
what is left out, and its covariance, follow from the precision matrix at once (`P_oo^-1 P y`), surface included. The error
is one without what its neighbours tell of the noise, which no robot has: a walk of the bias would follow whatever the layers
lack. How probable it is counts with the noise that the errors themselves show: the variances are those of the whole model,
and what lacks layers errs by more. The surface alone is the one of the file of that name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.model.layers import Fitted, Model
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Improvement, Layer
from gyrocal.diagnosis.rows.means import Means
from gyrocal.inference.additive import Component, adds, precision
from gyrocal.inference.resampling import block_means
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Every eighth segment is left out at a time: 88 % of the record are left to predict it from.
_FOLDS = 8
#: Stretches that stand for segments in a record of few: five to a fold, so that no fold is a single hole.
_STRETCHES = 40
#: Whole temperatures are left out too where there are so many, each of so many data sets: fewer are no sweeps.
_FEWEST = 3
#: Neighbouring data sets farther apart are at another temperature, degC: more than a sweep drifts by, less than plans step.
_LEAST_JUMP_C = 3.0
#: Stretches of the record that are drawn whole, a row with all of its repeats.
_BLOCKS = 24
#: Draws of the intervals of held-out errors: it puts their ends off by 2 % of the width.
_BOOTSTRAP = 1000
#: Noise of a prediction, in units of the usual one, from which on it is an extrapolation.
_EXTRAPOLATED = 4.0
#: The share removed of an excess that is less than this share of the noise, in the mean square, is a ratio of two noises.
_LEAST_EXCESS = 0.02


@dataclass(frozen=True)
class LeftOut:
    """Each row left out, shape (m,).

    Attributes
    ----------
    squares, variance : squared error, and what it would be by the noise of the prediction
    block : number of the stretch of the record that it lies in, in which errors may have much in common
    """

    squares: Floats
    variance: Floats
    block: Ints

    def logloss(self, rows: NDArray[np.bool_]) -> Floats:
        """Log-loss of some rows, nats, each with its variance times what they err by more than that."""
        squares, variance = self.squares[rows], self.variance[rows]
        variance = variance * max(float(np.mean(squares / variance)), np.finfo(float).tiny)
        return np.asarray(0.5 * (squares / variance + np.log(2.0 * np.pi * variance)))


def folds_of(means: Means) -> list[Ints]:
    """Rows of the means that are left out together, each row at least once."""
    unit = _units(means)
    numbers = np.unique(unit)
    folds = [np.flatnonzero(np.isin(unit, numbers[k::_FOLDS])) for k in range(_FOLDS)]
    return [f for f in folds if f.size] + _sweeps(means)


def _units(means: Means) -> Ints:
    """What is left out together at the least: a segment, or a stretch of time in a record of few segments."""
    if np.unique(means.set_index).size >= _FOLDS:
        return means.set_index
    share = (means.t_s - means.t_s[0]) / max(float(np.ptp(means.t_s)), 1e-9)
    return np.asarray(np.minimum(share * _STRETCHES, _STRETCHES - 1), dtype=np.int64)


def _sweeps(means: Means) -> list[Ints]:
    """Groups of neighbouring data sets at one temperature: a ramp or a jump begins a new one."""
    rows = np.flatnonzero(means.is_set)
    if np.ptp(means.rate_dps) == 0:
        return []
    jumps = np.abs(np.diff(means.temp_c[rows])) > _LEAST_JUMP_C
    groups = np.split(rows, np.flatnonzero(jumps | (np.diff(rows) > 1)) + 1)
    groups = [g for g in groups if g.size >= _FEWEST]
    return groups if len(groups) >= _FEWEST else []


def _stretches(means: Means) -> Ints:
    """Number of the stretch of the record that each row lies in: neighbouring units."""
    unit = np.unique(_units(means), return_inverse=True)[1]
    return np.asarray(unit * _BLOCKS // max(_BLOCKS, int(unit.max()) + 1))


def leave_out(fitted: Fitted, model: Model, folds: Sequence[Ints], passing: Collection[str] = ()) -> LeftOut:
    """Predict what is left out under some of the components of a fitted model, at its variances.

    Parameters
    ----------
    passing : components of which an error is one of the mean over the record, whatever the neighbours tell of them
    """
    flat = model.design[:, model.flat]
    score, p = precision(model.error_dps, flat, model.all, fitted.fit.variance)
    told = _beyond_mean(flat, [c for c in model.all if c.name in passing], fitted.fit.variance)
    told_p = told @ p
    squares, variance = [], []
    for rows in folds:
        block = p[np.ix_(rows, rows)]
        block = block + 1e-12 * np.trace(block) / len(block) * np.eye(len(block))
        covariance = np.linalg.inv(block)
        error = covariance @ score[rows]
        # What the others tell of the passing here: it is by what they are beside the prediction of the whole.
        own = told[np.ix_(rows, rows)]
        of_others = told_p[np.ix_(rows, rows)] - own @ p[np.ix_(rows, rows)]
        followed = told[rows] @ score - own @ score[rows] - of_others @ error
        known = np.einsum("ij,ij->i", told_p[rows] - own @ p[rows], told[rows])
        known -= np.einsum("ij,ij->i", of_others, own) + np.einsum(
            "ij,jk,ik->i", of_others, covariance, of_others
        )
        squares.append((error + followed) ** 2)
        variance.append(np.diag(covariance) + np.maximum(known, 0.0))
    return LeftOut(
        np.concatenate(squares),
        np.concatenate(variance),
        _stretches(model.means)[np.concatenate(folds)],
    )


def left_out_by(surface: Surface, means: Means, folds: Sequence[Ints], variance: Floats) -> LeftOut:
    """Predict what is left out by the terms of a surface alone, fitted to the other data sets with equal weights.

    Parameters
    ----------
    variance : of the noise of each prediction, shape (m,)
    """
    own_dps = means.rate_dps if surface.direction == "input" else means.gyro_dps
    design = surface.design(own_dps, means.temp_c)[:, surface.coefficients_dps.ravel() != 0.0]
    fitted = means.is_set if means.is_set.any() else ~means.is_set
    squares = []
    for rows in folds:
        others = np.setdiff1d(np.flatnonzero(fitted), rows)
        coefficients = np.linalg.lstsq(design[others], means.error_dps[others], rcond=None)[0]
        squares.append((means.error_dps[rows] - design[rows] @ coefficients) ** 2)
    return LeftOut(np.concatenate(squares), variance, _stretches(means)[np.concatenate(folds)])


def _beyond_mean(flat: Floats, passing: Sequence[Component], variance: Mapping[str, float]) -> Floats:
    """Covariance of what passes beyond what free columns take of it over the record, with all of it, shape (n, n)."""
    whole = np.zeros((len(flat), len(flat)))
    for c in passing:
        whole += variance[c.name] * adds(c)
    return whole - flat @ np.linalg.lstsq(flat, whole, rcond=None)[0]


def improvement(
    before: LeftOut, after: LeftOut, sure: NDArray[np.bool_], rng: np.random.Generator
) -> Improvement:
    """How much better the second model predicts the rows that count."""
    squares = np.column_stack([before.squares, after.squares])[sure]
    loss = np.column_stack([before.logloss(sure), after.logloss(sure)])
    rms = np.sqrt(squares.mean(axis=0))
    floor = float(np.sqrt(after.variance[sure].mean()))
    drawn = block_means([*squares.T, *loss.T], after.block[sure], _BOOTSTRAP, rng)
    drop = np.sqrt(drawn[0]) - np.sqrt(drawn[1])
    nats = drawn[2] - drawn[3]
    excess = float(rms[0] ** 2 - floor**2)
    told = excess > _LEAST_EXCESS * floor**2
    removed = min(float((rms[0] ** 2 - rms[1] ** 2) / excess), 1.0) if told else float("nan")
    low, high = np.quantile(drop, [0.025, 0.975])
    nats_low, nats_high = np.quantile(nats, [0.025, 0.975])
    means = loss.mean(axis=0)
    return Improvement(
        float(rms[0]),
        float(rms[1]),
        floor,
        (float(low), float(high)),
        float(means[0]),
        float(means[1]),
        (float(nats_low), float(nats_high)),
        removed,
        Remark(Said.LEFT_OUT_SETS),
    )


@dataclass(frozen=True)
class Staircase:
    """The layers one after the other, and each by itself."""

    layers: tuple[Layer, ...]
    total: Improvement | None
    each: dict[str, Improvement]


@dataclass(frozen=True)
class Step:
    """A step of the staircase: a layer, and what a model is without it.

    Attributes
    ----------
    name : str
        Effect or block.
    nats : float
        What it is worth.
    instead : tuple of str
        Smooth parts that stand beside a law and would take its place: by itself it is judged without them.
    """

    name: str
    nats: float
    less: Callable[[Model], Model]
    instead: tuple[str, ...] = ()


def staircase(found: Examination, steps: Sequence[Step], alone: Surface, seed: int) -> Staircase:
    """Left-out errors of the surface alone, of every further layer on top, and of all but each one.

    Parameters
    ----------
    steps : the strongest first
    alone : the surface without anything beside it
    """
    fitted = found.naming.fitted
    means = fitted.model.means
    folds = folds_of(means)
    if not steps:
        return Staircase((), None, {})
    sets = np.concatenate([means.is_set[rows] for rows in folds])
    sets = sets if sets.any() else ~sets
    rng = np.random.default_rng([seed, 7])
    down = [fitted.model]
    for step in reversed(steps):
        down.append(step.less(down[-1]))
    surface = down.pop()
    passing = surface.components.keys() - {part.name for part in surface.parts}
    on_the_way = [leave_out(fitted, model, folds, passing) for model in down]
    whole = on_the_way[0]
    on_the_way.append(left_out_by(alone, means, folds, whole.variance))
    # What noise alone moves this much is extrapolated from what is left: no model is judged by it.
    sure = sets & (whole.variance < _EXTRAPOLATED**2 * np.median(whole.variance[sets]))
    names = ["", *(step.name for step in steps)]
    layers = [_layer(n, f, sure) for n, f in zip(names, reversed(on_the_way), strict=True)]
    each = {}
    for step in steps:
        judged, by_itself = fitted, whole
        if step.instead:
            judged = _without(fitted, step.instead)
            by_itself = leave_out(judged, judged.model, folds, passing)
        without = leave_out(judged, step.less(judged.model), folds, passing)
        each[step.name] = improvement(without, by_itself, sure, rng)
    return Staircase(tuple(layers), improvement(on_the_way[-1], whole, sure, rng), each)


def _without(fitted: Fitted, names: Sequence[str]) -> Fitted:
    """The model less some components; laws that had died beside them come back."""
    laws = {law.name for law in fitted.model.laws}
    start = {n: v for n, v in fitted.fit.log_variance.items() if n not in laws}
    return fitted.refit(fitted.model.without(names), start=start)


def _layer(name: str, found: LeftOut, sure: NDArray[np.bool_]) -> Layer:
    return Layer(
        name,
        float(np.sqrt(found.squares[sure].mean())),
        float(np.sqrt(found.variance[sure].mean())),
        float(found.logloss(sure).mean()),
    )
