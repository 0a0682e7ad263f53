"""Laws against each other: which of them explains best what a block of smooth parts did, and at which shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws, Trial, likeliest
from gyrocal.diagnosis.laws.misfit import changing
from gyrocal.diagnosis.model.blocks import REPLACED
from gyrocal.diagnosis.model.intervals import refined
from gyrocal.diagnosis.model.layers import Fitted, Law, Model
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: Evidence within which two laws explain the data alike, nats: 20 to 1.
ALIKE_NATS = 3.0
#: Sets of laws of one size that are made larger.
_BEAM = 3
#: So many effects are fitted, each at its best shape; the others are far behind by a gain under fixed variances.
_REFITTED = 3


def price(law: Law, shapes: int, base: float) -> float:
    """What a law pays for being there, nats: a base, for the shapes that it had to choose from, and for an unusual one."""
    return base + 0.5 * float(np.log(max(1, shapes))) - CATALOGUE[law.effect].search.nats_before(law.shape)


@dataclass(frozen=True)
class Winner:
    """The law that won, the model with it, how much worse others are (nats), and how many shapes it had."""

    effect: Effect
    fitted: Fitted
    rivals: dict[str, float]
    shapes: int

    @property
    def law(self) -> Law:
        """The law itself."""
        return self.fitted.model.laws[-1]

    @property
    def least_nats(self) -> float:
        """What it has to gain to be believed."""
        return price(self.law, self.shapes, GAIN)


def best_law(
    fitted: Fitted, current: Fitted, block: str, trials: Sequence[Trial], laws: Laws
) -> Winner | None:
    """The law beside those of `current` that explains most of what a block did; None where none is left.

    All shapes of all laws are scanned at the variances that the other components have beside the block: estimated without it
    these would have grown to take its place. Such gains only rank; the best few laws are fitted, and compared by that.

    Parameters
    ----------
    fitted : the model with the block
    current : the model without it, and with the laws that were found so far
    """
    refits = _refitted(fitted, current, block, trials, laws)
    if not refits:
        return None
    first, *others = refits
    rivals = {r.effect.id: r.loss - first.loss for r in others}
    return Winner(first.effect, first.fitted, rivals, first.shapes)


def best_together(
    fitted: Fitted, current: Fitted, block: str, trials: Sequence[Trial], laws: Laws, most: int
) -> tuple[Winner, ...]:
    """Laws of different mechanisms, `most` at the most, that together explain best what a block did, each less what it has to gain.

    One law by itself takes a shape between those of several, beside which the others are not seen: a few of the best sets
    of each size are each made larger. None where two sets as large do alike.

    Parameters
    ----------
    fitted, current : as of `best_law`
    """
    sets: dict[frozenset[str], tuple[float, tuple[Winner, ...]]] = {}
    beam: list[tuple[float, tuple[Winner, ...]]] = [(current.nll, ())]
    for _ in range(most):
        wider: dict[frozenset[str], tuple[float, tuple[Winner, ...]]] = {}
        for loss, chosen in beam:
            beside = chosen[-1].fitted if chosen else current
            taken = {mechanism(w.effect) for w in chosen}
            fresh = [t for t in trials if mechanism(t.effect) not in taken]
            refits = _refitted(fitted, beside, block, fresh, laws)
            for r in refits:
                like = [x for x in refits if x is not r and mechanism(x.effect) == mechanism(r.effect)]
                rivals = {x.effect.id: max(x.loss - r.loss, 0.0) for x in like}
                winner = Winner(r.effect, r.fitted, rivals, r.shapes)
                paid = loss - beside.nll + r.fitted.nll + winner.least_nats
                key = frozenset({*taken, mechanism(r.effect)})
                if key not in wider or paid < wider[key][0]:
                    wider[key] = paid, (*chosen, winner)
        beam = sorted(wider.values(), key=lambda x: x[0])[:_BEAM]
        sets |= wider
    if not sets:
        return ()
    least = min(loss for loss, _ in sets.values())
    alike = [chosen for loss, chosen in sets.values() if loss < least + ALIKE_NATS]
    fewest = min(map(len, alike))
    simplest = [chosen for chosen in alike if len(chosen) == fewest]
    return simplest[0] if len(simplest) == 1 else ()


def mechanism(effect: Effect) -> str:
    """What an effect and those that it is a limit of have in common."""
    return effect.search.limit_of or effect.id


def becomes_another(effect: Effect, shape: Mapping[str, float], laws: Laws) -> bool:
    """Whether a law is at the end of its shapes, beyond which it becomes another."""
    return any(shape[n] >= effect.search.most(n, laws.offer) for n in effect.search.bounded)


@dataclass(frozen=True)
class _Refit:
    """A law that was fitted beside others: what it loses, with what is known of its shape and how many it has, nats."""

    effect: Effect
    fitted: Fitted
    loss: float
    shapes: int


def _refitted(
    fitted: Fitted, current: Fitted, block: str, trials: Sequence[Trial], laws: Laws
) -> list[_Refit]:
    """The best few effects beside the laws of `current`, each at its best shape, the best first."""
    model, logs = _without(fitted, current, block)
    score, p = fitted.contrasts.precision(model.all, logs)

    def gain_of(trial: Trial) -> float:
        beyond = fitted.contrasts.beyond(trial.columns)
        return _gain(beyond, score, p, model.law_variance) - _unlikely(trial, beyond, score, p)

    best: dict[str, tuple[float, Trial]] = {}
    shapes: dict[str, int] = {}
    for trial in trials:
        own, gain = trial.effect.id, gain_of(trial) + trial.effect.search.nats_before(trial.shape)
        shapes[own] = shapes.get(own, 0) + 1
        if own not in best or gain > best[own][0]:
            best[own] = gain, trial
    top = sorted((b for b in best.values() if np.isfinite(b[0])), key=lambda x: -x[0])[:_REFITTED]

    def loss(found: Fitted, effect: Effect) -> float:
        """What had more shapes to choose from has to gain more; one that changes with temperature is a law all the same."""
        changes = changing(found, found.model.laws[-1:], laws).nll + REPLACED
        before = effect.search.nats_before(found.model.laws[-1].shape)
        return min(found.nll, changes) - before + 0.5 * float(np.log(shapes[effect.id]))

    refits = []
    for _, trial in top:
        refined_trial, effect = _refined(trial, laws, gain_of), trial.effect
        if becomes_another(effect, refined_trial.shape, laws):
            continue
        found = _with(current, refined_trial, logs)
        refits.append(_Refit(effect, found, loss(found, effect), shapes[effect.id]))
    return sorted(refits, key=lambda r: r.loss)


def best_pair(fitted: Fitted, current: Fitted, block: str, trials: Sequence[Trial]) -> Fitted | None:
    """The model with the two laws of one effect that together explain most of what a block did; None of fewer than two.

    One law by itself takes a shape between theirs, beside which no second one is seen.

    Parameters
    ----------
    fitted, current : as of `best_law`
    trials : of one effect, of one column each
    """
    if len(trials) < 2:
        return None
    model, logs = _without(fitted, current, block)
    score, p = fitted.contrasts.precision(model.all, logs)
    columns = fitted.contrasts.beyond(np.column_stack([t.columns for t in trials]))
    pairs = np.array(list(combinations(range(len(trials)), 2)))
    information, pull = _seen(columns, score, p)
    of_pairs = information[pairs[:, :, None], pairs[:, None, :]], pull[pairs]
    first, second = (trials[k] for k in pairs[int(np.argmax(_evidence(*of_pairs, model.law_variance)))])
    return _with(_with(current, first, logs), second, logs)


def _without(fitted: Fitted, current: Fitted, block: str) -> tuple[Model, dict[str, float]]:
    """The model with the laws of `current` in place of a block, and variances (logarithms) that the block leaves it."""
    names = fitted.model.of_block(block)
    model = replace(fitted.model.without(names), laws=current.model.laws)
    return model, {**current.fit.log_variance, **fitted.fit.log_variance}


def _with(fitted: Fitted, trial: Trial, beside_block: Mapping[str, float]) -> Fitted:
    """The model with one law more, from its own variances or from those beside the block.

    What lacks the block may have noise grown so far in its place that a law which explains all of it cannot shrink it.
    """
    law = Law(trial.effect.id, trial.shape, trial.columns)
    model = fitted.model.with_laws(law)
    starts = (fitted.fit.log_variance, beside_block)
    return min((fitted.refit(model, start=start) for start in starts), key=lambda f: f.nll)


def _refined(trial: Trial, laws: Laws, gain_of: Callable[[Trial], float]) -> Trial:
    """The same law with its shape between the points of the grid, within what the grid spans."""
    effect = trial.effect
    grid = effect.search.grid(laws.offer)
    names = [n for n in effect.search.refined if n in trial.shape]
    spans = {n: (min(s[n] for s in grid), max(s[n] for s in grid)) for n in names}

    def at(shape: Mapping[str, float]) -> Trial:
        return Trial(effect, shape, laws.at(effect, shape))

    def gain(shape: Mapping[str, float]) -> float:
        new = at(shape)
        return gain_of(new) if np.isfinite(new.columns).all() else -np.inf

    return at(refined(trial.shape, names, gain, spans))


def _unlikely(trial: Trial, columns: Floats, score: Floats, p: Floats) -> float:
    """What a law loses by the amplitude that it would need, nats; infinite for a sign or size that the catalogue excludes."""
    effect, along = trial.effect, columns.T @ score
    if effect.positive(trial.shape) and float(np.sum(along)) < 0.0:
        return np.inf
    information = float(np.sum(columns * (p @ columns)))
    if along.size > 1 or information <= 0.0:
        return 0.0
    size, std = float(along[0]) / information, information**-0.5
    if abs(size) - effect.parameter("amplitude").high > NORMAL_95 * std:
        return np.inf
    return 0.0 if effect.search.natural is None else 0.5 * likeliest(effect, size, std)[1]


def _gain(columns: Floats, score: Floats, p: Floats, variance: float) -> float:
    """Evidence of columns under fixed variances, with their wide prior, nats."""
    return float(_evidence(*_seen(columns, score, p), variance))


def _seen(columns: Floats, score: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Information on columns of unit size, shape (q, q), and how they are pulled, shape (q,)."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    x = columns / np.where(size > 0, size, 1.0)
    return x.T @ p @ x, x.T @ score


def _evidence(information: Floats, pull: Floats, variance: float) -> Floats:
    """Evidence of sets of columns of unit size with their wide prior, shapes (..., q, q) and (..., q) to (...), nats."""
    whole = np.eye(pull.shape[-1]) + variance * information
    taken = np.linalg.solve(whole, pull[..., None])[..., 0]
    return np.asarray(0.5 * variance * np.sum(pull * taken, axis=-1) - 0.5 * np.linalg.slogdet(whole)[1])
