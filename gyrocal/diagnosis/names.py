"""Laws in place of smooth parts: what has a name.

A law takes the place of a block of smooth parts where it explains as much; where it takes most of the block's
evidence it is named and the block stays beside it; where no law does, the block stays, without a name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.intervals import REFINED_AT, REFINED_OVER
from gyrocal.diagnosis.jumps import Jump, with_jumps
from gyrocal.diagnosis.laws import Laws, Trial, effects_of, tied_anew
from gyrocal.diagnosis.layers import Fitted, Law
from gyrocal.diagnosis.parts import BLOCKS
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect
from gyrocal.physics.rate import RATE_ORDER
from gyrocal.physics.timewise import BIAS_DRIFT, WARM_UP
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: Blocks whose removal costs less, nats, are not there.
_ABSENT = 2.5
#: What a law gains at least, nats, with the logarithm of the root of the number of its shapes.
GAIN = 8.0
#: A further law of the same block leaves nothing of the block, or takes this share of its evidence.
_SECOND = 0.2
#: And no other law explains as much to within 20 to 1, nats.
_TOLD_APART = 3.0
#: Laws stand for a block that gains no more than this beside them, and a nat for each of them.
_REPLACED = 2.0
#: A law that takes this share of a block's evidence names it, lack of fit and all.
_NAMED_SHARE = 0.6
#: A law worth less at the end is dropped, nats.
_DROPPED = 4.0
#: A walk follows a drift nearly as well as the drift itself does: it has to be this much worse, nats. Of 100 data sets
#: at rest, walks of 2.5 times the noise were called a drift in 0 of 24 (0 to 14 %), drifts of d' 12 in 17, of 25 in 24 of 24.
_LINE = 2.0
#: What a law lacks that was not even near, nats.
_UNLIKELY = 50.0
_REFITTED = 3
#: Blocks that a wrong direction of the surface looks like.
_BENT = ("odd rate", "even rate", "each rate")
_MOST_LAWS = 3
#: Rounds in which the bend of a surface follows the surface; each leaves its slope (percents) of the change before.
_BENDS = 6
#: What the coefficients of a bend may change by at its end, deg/s.
_SETTLED_DPS = 1e-4


@dataclass(frozen=True)
class Named:
    """A law that was named.

    Attributes
    ----------
    block : str
        Smooth parts that it stands for; empty: it stands beside all of them.
    gain : float
        Evidence for it, nats.
    share : float
        Part of its block's evidence that the laws take; below one there is lack of fit.
    rivals : mapping
        Other effects to how much worse they explain the same, nats.
    trials : int
        Shapes that were tried.
    """

    law: Law
    block: str
    gain: float
    share: float
    rivals: dict[str, float]
    trials: int


@dataclass(frozen=True)
class Naming:
    """The model at the end: names, and the blocks that have none, with their evidence in nats.

    `input_gain`: how much better a surface over the input is than one over the output, nats.
    """

    fitted: Fitted
    named: tuple[Named, ...]
    unnamed: dict[str, float] = field(default_factory=dict)
    nearest: dict[str, dict[str, float]] = field(default_factory=dict)
    input_gain: float = 0.0

    @property
    def comes_again(self) -> float:
        """Probability that what the bias did since power-on begins anew with the next one: of a warm-up, not a drift."""
        near = self.nearest.get("warm-up") or self.nearest.get("bias in time", {})
        behind = near.get(WARM_UP.id, _UNLIKELY) - near.get(BIAS_DRIFT.id, _UNLIKELY)
        return float(1.0 / (1.0 + np.exp(np.clip(behind, -_UNLIKELY, _UNLIKELY))))


def settle_direction(fitted: Fitted) -> tuple[Fitted, float]:
    """The model with a surface of the output or of the input, where either does as well as what is between.

    Also how much better the input is, nats. Around itself: what bends is the surface that stands beside all else.
    """
    model = fitted.model
    if np.unique(np.round(model.means.rate_dps, 2)).size <= len(model.flat):
        return fitted, 0.0
    bend = model.bend_of(fitted.solve())
    free = fitted.refit(model.directed("free", bend), 40)
    bend = free.model.bend_of(free.solve())
    free = free.refit(model.directed("free", bend), 20)
    ways = {d: free.refit(free.model.directed(d, bend), 40) for d in ("output", "input")}
    gain = ways["output"].nll - ways["input"].nll
    best = ways["input"] if gain > 0.0 else ways["output"]
    # What is between the two is neither: it takes evidence to be believed.
    return (best if best.nll < free.nll + GAIN else free), gain


def around_itself(fitted: Fitted) -> Fitted:
    """The same with the bend of the surface that it has now: what is taken out of a model moves its surface."""
    if fitted.model.direction == "input":
        return fitted
    for _ in range(_BENDS):
        bend = fitted.model.bend_of(fitted.solve())
        if fitted.model.bend is not None and np.abs(bend - fitted.model.bend).max() < _SETTLED_DPS:
            break
        fitted = fitted.refit(fitted.model.directed(fitted.model.direction, bend), 20)
    return fitted


def errors_of_each_rate(fitted: Fitted, draws: Component | None) -> Fitted:
    """The model with an error of each rate in place of odd smooth parts, where it explains as much.

    A few rates can be followed by anything smooth; independent errors of one size are the simpler account of them.
    """
    odd = [n for n, b in fitted.model.blocks.items() if b == "odd rate"]
    if draws is None or not odd:
        return fitted
    without = fitted.model.without(odd)
    other = replace(without, components={**without.components, draws.name: draws})
    found = fitted.refit(other, 40)
    return found if found.nll <= fitted.nll + _REPLACED else fitted


def evidence(fitted: Fitted, block: str, laws: Laws | None = None) -> tuple[float, Fitted]:
    """What a block is worth, nats, and the model without it, in which laws act through the surface that it leaves."""
    names = [n for n, b in fitted.model.blocks.items() if b == block]
    model, bend = fitted.model.without(names), fitted.model.bend
    ways = [model]
    if block in _BENT and bend is not None:
        ways = [model.directed(d, bend) for d in ("input", "output")]
    without = min((fitted.refit(way, 30) for way in ways), key=lambda f: f.nll)
    if laws is not None and without.model.laws:
        without = min(without, tied_anew(without, laws)[0], key=lambda f: f.nll)
    return without.nll - fitted.nll, without


def present(fitted: Fitted, laws: Laws | None = None) -> tuple[Fitted, dict[str, float]]:
    """The model less the blocks that are not there, and what each of the others is worth."""
    while True:
        found = {b: evidence(fitted, b, laws) for b in sorted(set(fitted.model.blocks.values()))}
        weak = sorted((gain, b) for b, (gain, _) in found.items() if gain < _ABSENT)
        if not weak:
            return around_itself(fitted), {b: gain for b, (gain, _) in found.items()}
        # The weakest at once, so that one of two that share a pattern stays.
        fitted = found[weak[0][1]][1]
        for _, block in weak[1:]:
            gain, without = evidence(fitted, block, laws)
            if gain < _ABSENT:
                fitted = without


def name(
    fitted: Fitted,
    worth: Mapping[str, float],
    laws: Laws,
    jumps: Sequence[Jump] = (),
    passes: Sequence[Component] = (),
) -> tuple[Naming, Laws]:
    """Name what can be named, the strongest block first; also the laws through the surface at the end.

    Parameters
    ----------
    fitted, worth : the model with the blocks that are there, and what each is worth
    jumps : jumps in the model
    passes : what is to stand beside further jumps, which only names have made visible; empty: they are not looked for
    """
    named = [_jumped(jump) for jump in jumps]
    fitted, laws, found, nearest = _name_blocks(fitted, worth, named, laws)
    named += found
    if passes:
        fitted, more = with_jumps(fitted, passes, laws, GAIN)
        named += [_jumped(jump) for jump in more]
        # A walk that smooth parts had taken the place of: laws that it can follow are none.
        fitted = _beside(fitted, passes)
    fitted, named = _backward(fitted, named)
    fitted, input_gain = settle_direction(fitted)
    # What a law's first surface or shape had left to smooth parts may be gone.
    fitted, left = present(around_itself(fitted), laws)
    if passes:
        fitted, laws, found, near = _name_blocks(fitted, left, named, laws)
        named, nearest = named + found, {**near, **nearest}
        fitted, left = present(fitted, laws) if found else (fitted, left)
        fitted, left, instead = _instead(fitted, left, named, passes, laws)
        named += instead
    fitted, laws = tied_anew(fitted, laws)
    fitted = around_itself(fitted)
    return Naming(fitted, tuple(_mechanisms(_as_fitted(named, fitted))), left, nearest, input_gain), laws


def _name_blocks(
    fitted: Fitted, worth: Mapping[str, float], before: Sequence[Named], laws: Laws
) -> tuple[Fitted, Laws, list[Named], dict[str, dict[str, float]]]:
    """Name the blocks that no name stands for yet, the strongest first.

    Returns the model, its laws through the surface as it is then, the names, and the nearest laws of each block.
    """
    taken = {n.block for n in before}
    named: list[Named] = []
    nearest: dict[str, dict[str, float]] = {}
    for block in sorted(worth, key=lambda b: -worth[b]):
        if block in taken or block not in fitted.model.blocks.values() or not effects_of(block):
            continue
        answer = _name_either_way(fitted, block, laws)
        (fitted, laws), nearest[block] = tied_anew(answer.fitted, laws), answer.near
        named += answer.named
    return fitted, laws, named, nearest


def _instead(
    fitted: Fitted, worth: dict[str, float], named: list[Named], passes: Sequence[Component], laws: Laws
) -> tuple[Fitted, dict[str, float], list[Named]]:
    """The model with laws of other blocks, or jumps, in place of a block without a name, where they explain as much.

    A plan goes through temperatures in turn: what is smooth in temperature can follow what happens in time.
    """
    for block in sorted(worth, key=lambda b: -worth[b]):
        if not BLOCKS[block].stays or block in {n.block for n in named}:
            continue
        other = _beside(evidence(fitted, block, laws)[1], passes)
        other, _, more, _ = _name_blocks(*present(other, laws), named, laws)
        other, jumps = with_jumps(other, passes, laws, GAIN)
        more += [_jumped(jump) for jump in jumps]
        if more and other.nll <= fitted.nll + _REPLACED + len(more):
            return *present(other, laws), more
    return fitted, worth, []


def _beside(fitted: Fitted, passes: Sequence[Component]) -> Fitted:
    """The model with what passes, that may have died where something else took its place."""
    components = {**fitted.model.components, **{c.name: c for c in passes}}
    return fitted.refit(replace(fitted.model, components=components), 40)


def _as_fitted(named: list[Named], fitted: Fitted) -> list[Named]:
    """With the columns that the laws have in the model."""
    own = {law.name: law for law in fitted.model.laws}
    return [replace(n, law=own.get(n.law.name, n.law)) for n in named]


def _mechanisms(named: list[Named]) -> list[Named]:
    """Less the orders of the rate beside a law of the rate: they claim no mechanism, and are its misfit."""
    others = [
        n
        for n in named
        if CATALOGUE[n.law.effect].family == RATE_ORDER.family and n.law.effect != RATE_ORDER.id
    ]
    return [n for n in named if not others or n.law.effect != RATE_ORDER.id]


def _jumped(jump: Jump) -> Named:
    return Named(jump.law, "", jump.gain, 1.0, dict(jump.rivals), jump.trials)


@dataclass(frozen=True)
class _Answer:
    """What became of a block: the model, its laws, the nearest laws, and the loss with laws alone in its place."""

    fitted: Fitted
    named: list[Named]
    near: dict[str, float]
    nll: float


def _name_either_way(fitted: Fitted, block: str, laws: Laws) -> _Answer:
    """Name a block; one that is odd in the rate beside a surface of the input and beside one of the output.

    Smooth parts make up for the wrong one of the two, a law cannot.
    """
    bend = fitted.model.bend
    if block not in _BENT or bend is None:
        return _name_block(fitted, block, laws)
    ways = [fitted.refit(fitted.model.directed(d, bend), 30) for d in ("input", "output")]
    found = [_name_block(way, block, laws) for way in ways]
    return min(found, key=lambda a: a.nll + GAIN * max(len(a.named), 1))


def _name_block(fitted: Fitted, block: str, laws: Laws) -> _Answer:
    worth, without = evidence(fitted, block)
    trials = [t for e in effects_of(block) for t in laws.trials(e)]
    current, chosen, near = _chosen(fitted, without, block, trials, laws)
    kinds = {n.law.effect for n in chosen}
    for kind in sorted(kinds) if len(kinds) > 1 else ():
        if CATALOGUE[kind].search.adds_up:
            # One mechanism of several laws is likelier than two that do hardly better.
            alone, only, _ = _chosen(fitted, without, block, [t for t in trials if t.effect.id == kind], laws)
            ahead = current.nll + GAIN * (len(kinds) - 1) - alone.nll
            if ahead > 0.0:
                left = worth - (without.nll - alone.nll)
                near = dict.fromkeys(near, left + ahead) | {kind: left}
                current, chosen, kinds = alone, only, {kind}
    if not chosen:
        return _Answer(fitted, [], near, fitted.nll)
    share = (without.nll - current.nll) / worth
    chosen = [replace(n, share=share) for n in chosen]
    # What stays and a robot cannot evaluate as a law of one amplitude stays as a smooth part.
    replaces = all(_of_robot(n) or _passes(n) for n in chosen) or not BLOCKS[block].stays
    # Errors of single rates are as simple as a law is.
    slack = 0.0 if block == "each rate" else _REPLACED + len(chosen)
    if current.nll <= fitted.nll + slack:
        return _Answer(current if replaces else fitted, chosen, near, current.nll)
    # A scale factor seldom walks: what a law leaves of its course is the law's misfit.
    misfit = BLOCKS[block].stays or block == "scale in time"
    if misfit and share < _NAMED_SHARE:
        return _Answer(fitted, [], near, fitted.nll)
    if not replaces:
        return _Answer(fitted, chosen, near, current.nll)
    beside = fitted.refit(replace(fitted.model, laws=current.model.laws), 30)
    if misfit:
        return _Answer(beside, chosen, near, current.nll)
    # A walk follows a line without being one: each law must say more than the walk does.
    if fitted.nll - beside.nll > GAIN * len(chosen):
        return _Answer(beside, chosen, near, beside.nll)
    return _Answer(fitted, [], near, fitted.nll)


def _chosen(
    fitted: Fitted, without: Fitted, block: str, trials: Sequence[Trial], laws: Laws
) -> tuple[Fitted, list[Named], dict[str, float]]:
    """The best law in place of a block, and further ones beside it; also what each leaves of the block, nats.

    Parameters
    ----------
    without : the model without the block
    """
    worth = without.nll - fitted.nll
    current = without
    chosen: list[Named] = []
    near: dict[str, float] = {}
    while trials and len(chosen) < _MOST_LAWS:
        taken = {n.law.effect for n in chosen if not CATALOGUE[n.law.effect].search.adds_up}
        found = _best_law(fitted, current, block, trials, taken, laws)
        if not found:
            break
        trial, better, rivals, count = found
        gain = current.nll - better.nll
        if not chosen:
            near = {trial.effect.id: worth - gain} | {e: worth - gain + r for e, r in rivals.items()}
        if gain < GAIN + 0.5 * np.log(count) - trial.effect.search.prior_nats:
            break
        whole = better.nll <= fitted.nll + _REPLACED + len(chosen) + 1
        more = trial.effect.id in {n.law.effect for n in chosen}
        told = min(rivals.values(), default=np.inf) > _TOLD_APART
        if chosen and not more and not (told and (whole or gain >= _SECOND * worth)):
            # The misfit of a law of another kind is no second effect, nor is what several laws take equally well.
            break
        chosen.append(Named(better.model.laws[-1], block, gain, 0.0, rivals, count))
        current = better
    return current, chosen, near


def _of_robot(named: Named) -> bool:
    return CATALOGUE[named.law.effect].runtime and named.law.columns.shape[1] == 1


def _passes(named: Named) -> bool:
    """Whether a law is of what passes: its state at the end is held, and it does not begin anew."""
    effect = CATALOGUE[named.law.effect]
    return effect.family == BLOCKS["bias in time"].family and not effect.runtime


def _best_law(
    fitted: Fitted, current: Fitted, block: str, trials: Sequence[Trial], taken: set[str], laws: Laws
) -> tuple[Trial, Fitted, dict[str, float], int] | None:
    """The law that explains most of what a block did, its rivals and how many shapes it had; None where none is left.

    Shapes are compared under the variances that the block leaves to the others: without it these would swell to
    take its place. Gains can be compared after a new fit only, so the best few are fitted.
    """
    names = [n for n, b in fitted.model.blocks.items() if b == block]
    model = replace(fitted.model.without(names), laws=current.model.laws)
    logs = {**current.fit.log_variance, **fitted.fit.log_variance}
    score, p = fitted.contrasts.precision(model.all, logs)

    def gain_of(trial: Trial) -> float:
        beyond = fitted.contrasts.beyond(trial.columns)
        if _unphysical(trial.effect, beyond, score, p):
            return -np.inf
        return _gain(beyond, score, p, model.law_variance)

    best: dict[str, tuple[float, Trial]] = {}
    counts: dict[str, int] = {}
    for trial in trials:
        if trial.effect.id in taken:
            continue
        gain = gain_of(trial) + trial.effect.search.prior_nats
        counts[trial.effect.id] = counts.get(trial.effect.id, 0) + 1
        if trial.effect.id not in best or gain > best[trial.effect.id][0]:
            best[trial.effect.id] = gain, trial
    top = sorted((b for b in best.values() if np.isfinite(b[0])), key=lambda x: -x[0])[:_REFITTED]
    if not top:
        return None
    refined = [_refined(trial, laws, gain_of) for _, trial in top]
    refits = []
    for trial in refined:
        law = Law(trial.effect.id, trial.shape, trial.columns)
        refits.append((current.refit(replace(current.model, laws=(*current.model.laws, law)), 30), trial))

    def loss(found: Fitted, trial: Trial) -> float:
        """What had more shapes to choose from has to gain more."""
        return found.nll - trial.effect.search.prior_nats + 0.5 * float(np.log(counts[trial.effect.id]))

    refits.sort(key=lambda x: loss(*x))
    winner = refits[0]
    rivals = {t.effect.id: loss(f, t) - loss(*winner) for f, t in refits[1:]}
    return winner[1], winner[0], rivals, counts[winner[1].effect.id]


def _refined(trial: Trial, laws: Laws, gain_of: Callable[[Trial], float]) -> Trial:
    """The same law with its shape between the points of the grid, one parameter after the other."""
    best, best_gain = trial, gain_of(trial)
    grid = trial.effect.search.grid(laws.offer)
    for spread in REFINED_OVER:
        for parameter in trial.effect.search.refined:
            value = best.shape.get(parameter, 0.0)
            if value <= 0.0:
                continue
            around, tried = best, [s[parameter] for s in grid]
            for factor in np.geomspace(1.0 / spread, spread, REFINED_AT):
                shape = {**around.shape, parameter: float(np.clip(value * factor, min(tried), max(tried)))}
                new = Trial(trial.effect, shape, laws.at(trial.effect, shape))
                gain = gain_of(new) if np.isfinite(new.columns).all() else -np.inf
                if gain > best_gain:
                    best, best_gain = new, gain
    return best


def _unphysical(effect: Effect, columns: Floats, score: Floats, p: Floats) -> bool:
    """Whether a law would need a sign, or a size beyond doubt, that physics does not know."""
    along = columns.T @ score
    if effect.positive and float(np.sum(along)) < 0.0:
        return True
    if along.size > 1:
        return False
    information = float(np.sum(columns * (p @ columns)))
    most = effect.parameter("amplitude").high
    return bool(abs(along[0]) - most * information > NORMAL_95 * np.sqrt(max(information, 0.0)))


def _gain(columns: Floats, score: Floats, p: Floats, variance: float) -> float:
    """Evidence of columns under fixed variances, with their wide prior, nats."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    x = columns / np.where(size > 0, size, 1.0)
    information = x.T @ p @ x
    b = x.T @ score
    whole = np.eye(b.size) + variance * information
    return float(0.5 * variance * b @ np.linalg.solve(whole, b) - 0.5 * np.linalg.slogdet(whole)[1])


def _least_worth(named: Named) -> float:
    return _LINE if named.law.effect == BIAS_DRIFT.id else _DROPPED


def _backward(fitted: Fitted, named: list[Named]) -> tuple[Fitted, list[Named]]:
    """Drop laws that the others have made superfluous."""
    beside = [n for n in named if n.block in fitted.model.blocks.values() and n.block != "bias in time"]
    named = [n for n in named if n not in beside]
    while named:
        gains = []
        for n in named:
            laws = tuple(law for law in fitted.model.laws if law.name != n.law.name)
            gains.append((fitted.refit(replace(fitted.model, laws=laws), 30), n))
        gains.sort(key=lambda x: x[0].nll - _least_worth(x[1]))
        without, weakest = gains[0]
        if without.nll - fitted.nll >= _least_worth(weakest):
            worth = {n.law.name: f.nll - fitted.nll for f, n in gains}
            return fitted, beside + [replace(n, gain=worth[n.law.name]) for n in named]
        fitted, named = without, [n for n in named if n is not weakest]
    return fitted, beside
