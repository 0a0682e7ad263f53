"""Laws in place of smooth parts: what has a name.

A law takes the place of a block of smooth parts where it explains as much; where it takes most of the block's
evidence it is named and the block stays beside it; where no law does, the block stays, without a name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.stats import chi2

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws, effects_of, tied_anew
from gyrocal.diagnosis.laws.contest import ALIKE_NATS, Winner, best_law
from gyrocal.diagnosis.laws.estimates import reshaped
from gyrocal.diagnosis.laws.in_place import NAMED_LEVEL, Named, beyond_chance, is_passing, simplest
from gyrocal.diagnosis.laws.jumps import Jump, with_jumps
from gyrocal.diagnosis.laws.misfit import changing, without_mending
from gyrocal.diagnosis.laws.scan import scan_of
from gyrocal.diagnosis.model.blocks import (
    BENT,
    REPLACED,
    around_itself,
    beside_laws,
    evidence,
    gain_of_input,
    less,
    present,
    settle_direction,
)
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.diagnosis.model.parts import BIAS_IN_TIME, BLOCKS, EACH_RATE, ODD, PASSING, SINCE_ON, by_size
from gyrocal.diagnosis.model.rate_errors import is_beyond_a_table
from gyrocal.diagnosis.names.rivals import or_lasting, or_passing, paid_by
from gyrocal.diagnosis.rows.means import Means
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import DEAD_ZONE, RATE_ORDER, TRUNCATION
from gyrocal.physics.timewise import BIAS_DRIFT, WARM_UP
from gyrocal.units import NORMAL_95

#: A law that takes most of a block's evidence names it, lack of fit and all. On the same recordings right ones took 0.69 and
#: more, and none was refused; on 136 others an asymmetry with a soft knee took 0.57.
_NAMED_SHARE = 0.5
#: A peak of which one size of rate, either way, shows more than this is known from that alone.
_SEEN_AT_ONE = 0.95
#: A walk follows a drift nearly as well as the drift itself does: it has to be this much worse, nats. Of 100 data sets
#: at rest walks of 2.5 and of 6 times the noise were called a drift in 2 of 100 (1 to 7 %; 8 without this bound), drifts of
#: d' 12 in 19 of 24, none of which the bound had refused.
_LINE = 2.0
#: What a law lacks that was not even near, nats.
_UNLIKELY = 50.0


@dataclass(frozen=True)
class Naming:
    """The model at the end: names, and the blocks that have none, with their evidence in nats.

    `input_gain`: how much better a surface over the input is than one over the output, nats; 0 where something else is.
    """

    fitted: Fitted
    named: tuple[Named, ...]
    unnamed: dict[str, float] = field(default_factory=dict)
    nearest: dict[str, dict[str, float]] = field(default_factory=dict)
    input_gain: float = 0.0

    @property
    def comes_again(self) -> float:
        """Probability that what the bias did since power-on begins anew with the next one: of a warm-up, not a drift."""
        near = self.nearest.get(SINCE_ON) or self.nearest.get(BIAS_IN_TIME, {})
        behind = near.get(WARM_UP.id, _UNLIKELY) - near.get(BIAS_DRIFT.id, _UNLIKELY)
        return float(1.0 / (1.0 + np.exp(np.clip(behind, -_UNLIKELY, _UNLIKELY))))


def name(
    fitted: Fitted,
    worth: Mapping[str, float],
    laws: Laws,
    held: Sequence[Named] = (),
    passes: Sequence[Component] = (),
) -> tuple[Naming, Laws]:
    """Name what can be named, the strongest block first; also the laws through the surface at the end.

    Parameters
    ----------
    fitted, worth : the model with the blocks that are there, and what each is worth
    held : what has a name and is in the model
    passes : what is to stand beside further jumps, which only names have made visible; empty: they are not looked for
    """
    named = [*held]
    fitted, laws, found, nearest = _name_blocks(fitted, worth, named, laws)
    named += found
    if passes:
        fitted, more = with_jumps(fitted, passes, laws)
        named += [jumped(jump) for jump in more]
        # A walk that smooth parts had taken the place of: laws that it can follow are none.
        fitted = _beside(fitted, passes)
    fitted, named, followed = _backward(fitted, named)
    settled = settle_direction(fitted, partial(reshaped, laws=laws))
    fitted, named = settled, _as_fitted(named, fitted, settled)
    # What a law's first surface or shape had left to smooth parts may be gone.
    fitted, left = present(around_itself(fitted), laws)
    if passes:
        fitted, laws, found, near = _name_blocks(fitted, left, named, laws)
        named, nearest = named + found, {**near, **nearest}
        fitted, left = present(fitted, laws) if found else (fitted, left)
        fitted, left, instead = _instead(fitted, left, named, passes, laws)
        named += instead
    fitted, unseen = _unseen(fitted, named, passes, laws)
    named += unseen
    nearest = {n.block: {n.law.effect: 0.0, **n.rivals} for n in unseen} | nearest
    shaped, named, laws = _at_rest(fitted, named, laws)
    before = shaped.model.laws
    shaped, named = or_lasting(shaped, still_there(named, shaped, left), followed, laws)
    if passes:
        shaped, named = or_passing(shaped, named, laws)
        left = {block: nats for block, nats in left.items() if block in shaped.model.blocks.values()}
    shaped, named = _no_misfits(shaped, _mechanisms(_of_some_size(named, shaped, laws)), laws)
    if shaped.model.laws != before:
        shaped, named, laws = _at_rest(shaped, named, laws)
    shaped = around_itself(shaped)
    return Naming(shaped, tuple(named), left, nearest, _of_input(shaped)), laws


def _at_rest(fitted: Fitted, named: list[Named], laws: Laws) -> tuple[Fitted, list[Named], Laws]:
    """The model with its laws through the surface that stands beside them, each at the shape that is best beside the others."""
    tied, anew = tied_anew(fitted, laws)
    if tied.nll > fitted.nll + ALIKE_NATS:
        # Of a surface and a lag that chase each other neither is the end.
        tied, anew = fitted, laws
    shaped = reshaped(around_itself(tied), anew)
    return shaped, _as_fitted(named, tied, shaped), anew


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
    """The model with laws of other blocks, or jumps, in place of what has no name, where they explain as much.

    That is a block without a name, or what the law of one leaves of it.

    A plan goes through temperatures in turn: what is smooth in temperature can follow what happens in time.
    """
    for block in sorted(worth, key=lambda b: -worth[b]):
        if not BLOCKS[block].stays:
            continue
        # A law that no robot can evaluate has its block in the model for it.
        own = [n.law for n in named if n.block == block and not fitted.model.holds(n.law)]
        other = _beside(_with_laws(evidence(fitted, block, laws)[1], own), passes)
        other, _, more, _ = _name_blocks(*present(other, laws), named, laws)
        other, jumps = with_jumps(other, passes, laws)
        more += [jumped(jump) for jump in jumps]
        if not more:
            continue
        both = _with_laws(fitted, [n.law for n in more])
        if other.nll <= fitted.nll + may_lose(more):
            return *present(both if own else other, laws), more
        # A block that has followed them may be like a law of its own beside them.
        both, _, mine, _ = _name_blocks(*present(both, laws), [*named, *more], laws)
        if mine and both.nll <= fitted.nll + may_lose(more) + len(mine):
            return *present(both, laws), [*more, *mine]
    return fitted, worth, []


def may_lose(laws: Sequence[Named]) -> float:
    """How much worse laws of other blocks may explain what has no name, nats: one is simpler than smooth parts, each further one pays.

    Seven jumps had stood for a step in temperature of a few degrees.
    """
    return REPLACED + 1.0 - sum(sorted(map(paid_by, laws))[1:])


def _unseen(
    fitted: Fitted, named: Sequence[Named], passes: Sequence[Component], laws: Laws
) -> tuple[Fitted, list[Named]]:
    """The model with laws that no smooth part is like enough to show, as a dead zone between two rates is.

    Nor does a walk of the bias show a drift that 1/f noise follows as well.
    """
    found: list[Named] = []
    for block in (ODD, BIAS_IN_TIME):
        if any(CATALOGUE[n.law.effect].family == BLOCKS[block].family for n in named):
            continue
        if passes and not BLOCKS[block].stays and not any(PASSING.get(c.name) == block for c in passes):
            continue
        beside = _beside(fitted, passes) if passes and not BLOCKS[block].stays else fitted
        # No smooth part would stand in the file for a law of two amplitudes, which a file cannot hold.
        best = best_law(beside, beside, block, laws.of_one_amplitude(block), laws)
        gain = 0.0 if best is None else beside.nll - best.fitted.nll
        if best is not None and gain >= best.least_nats:
            fitted = best.fitted
            found.append(Named(best.law, block, gain, 1.0, best.rivals, best.shapes))
    return fitted, found


def _of_input(fitted: Fitted) -> float:
    """How much better a surface over the input is than one over the output, where that is most of what is odd in the rate."""
    gain, left = gain_of_input(fitted)
    return gain if gain >= _NAMED_SHARE * (gain + left) else 0.0


def _with_laws(fitted: Fitted, more: Sequence[Law]) -> Fitted:
    """The model with further laws, where there are any."""
    return fitted.refit(fitted.model.with_laws(*more)) if more else fitted


def _beside(fitted: Fitted, passes: Sequence[Component]) -> Fitted:
    """The model with what passes, that may have died where something else took its place."""
    return fitted.refit(fitted.model.with_components(*passes))


def _as_fitted(named: list[Named], before: Fitted, fitted: Fitted) -> list[Named]:
    """With the shapes and columns that the laws have in the model, which came from one `before` law by law."""
    own = {old.name: law for old, law in zip(before.model.laws, fitted.model.laws, strict=True)}
    return [replace(n, law=own.get(n.law.name, n.law)) for n in named]


def still_there(named: list[Named], fitted: Fitted, worth: Mapping[str, float]) -> list[Named]:
    """Less those whose smooth parts stood in the model for them, and went when later laws explained as much."""
    held = [n for n in named if fitted.model.holds(n.law)]
    stood_for = [n for n in named if n not in held and n.block in worth]
    return held + [replace(n, gain=min(n.gain, worth[n.block])) for n in stood_for]


def _of_some_size(named: list[Named], fitted: Fitted, laws: Laws) -> list[Named]:
    """Less those that smooth parts stand for in the model, in the place of which the law may be nothing: they show something else."""

    def may_be_nothing(named: Named) -> bool:
        own = fitted.model.of_block(named.block)
        here = scan_of(fitted.granting_noise, named.law, laws, own).of(named.law.columns, named.law.shape)
        return abs(here.amplitude) < NORMAL_95 * here.std

    return [n for n in named if fitted.model.holds(n.law) or not may_be_nothing(n)]


def _mechanisms(named: list[Named]) -> list[Named]:
    """Less what is the misfit of another law: orders of the rate worth less than any, and the lesser of what swallows small rates.

    What is odd in the rate is no misfit of what is even in it; of a sine about a bias even orders are one.
    """
    gains = {e.id: sum(n.gain for n in named if n.law.effect == e.id) for e in (DEAD_ZONE, TRUNCATION)}
    if all(gains.values()):
        named = [n for n in named if n.law.effect != min(gains, key=lambda e: gains[e])]
    of_rate = [n for n in named if CATALOGUE[n.law.effect].family == RATE_ORDER.family]
    laws = [n for n in of_rate if n.law.effect != RATE_ORDER.id]

    def is_misfit(orders: Named) -> bool:
        like = [n for n in laws if orders.block != ODD or n.block in (ODD, EACH_RATE)]
        return orders.gain <= max((n.gain for n in like), default=0.0)

    return [n for n in named if n.law.effect != RATE_ORDER.id or not is_misfit(n)]


def _no_misfits(fitted: Fitted, named: list[Named], laws: Laws) -> tuple[Fitted, list[Named]]:
    """Drop laws that only mend what others leave that hold nearly."""
    held = {n.law.name: fitted.model.of_block(n.block) for n in named}
    held = {law.name: held[law.name] for law in fitted.model.laws if law.name in held}
    fitted = without_mending(fitted, held, laws)
    mending = [n for n in named if n.law.name in held and not fitted.model.holds(n.law)]
    left = [n for n in named if n not in mending]
    earned = [n for n in left if _earned_without(n, mending, named, fitted)]
    lost = [n.law.name for n in left if n not in earned]
    return fitted.refit(fitted.model.without_laws(lost)) if lost else fitted, earned


def _earned_without(named: Named, mending: Sequence[Named], before: Sequence[Named], fitted: Fitted) -> bool:
    """Whether a law that has smooth parts beside it has its name without those that only mended it."""
    own = [n for n in before if n.block == named.block]
    if named.block not in fitted.model.blocks.values() or not any(n in mending for n in own):
        return True
    return named.share * named.gain >= _NAMED_SHARE * sum(n.gain for n in own)


def jumped(jump: Jump) -> Named:
    """A jump, which stands beside all smooth parts."""
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
    if block not in BENT or bend is None:
        return _name_block(fitted, block, laws, fitted.nll)
    ways = [fitted.refit(fitted.model.directed(d, bend)) for d in ("input", "output")]
    whole_nll = min(way.nll for way in ways)
    found = [_name_block(way, block, laws, whole_nll) for way in ways]
    return min(found, key=lambda a: a.nll + GAIN * max(len(a.named), 1))


def _name_block(fitted: Fitted, block: str, laws: Laws, whole_nll: float) -> _Answer:
    """Laws in place of a block where they explain as much; else beside it, if they say enough.

    Parameters
    ----------
    whole_nll : what the block explains, the surface being as it fits best beside it
    """
    without = less(fitted, block)
    if block == EACH_RATE and ODD in without.model.blocks.values():
        # Smooth parts that grow where errors of each rate go would lend a law what it does not explain.
        without = less(without, ODD)
    worth = without.nll - whole_nll
    alone = simplest(fitted, without, block, laws, worth)
    # Of what says less than any law has to, none takes a share.
    unnamed = _Answer(fitted, [], alone.near if worth >= GAIN else {}, fitted.nll)
    if any(_at_one_size(n.law, laws.means) for n in alone.named):
        return unnamed
    if not alone.named:
        return replace(unnamed, named=_resembling(alone.nearest, without, block, worth))
    if block == EACH_RATE and alone.fitted.nll > whole_nll:
        # Errors of single rates have no shape that a grid could miss.
        shaped = reshaped(alone.fitted, laws, [n.law.name for n in alone.named])
        alone = replace(alone, fitted=shaped, named=_as_fitted(alone.named, alone.fitted, shaped))
    share = (without.nll - alone.fitted.nll) / worth
    named = [replace(n, share=share) for n in alone.named]
    # What stays and a robot cannot evaluate as a law of one amplitude stays as a smooth part.
    replaces = all(_of_robot(n) or is_passing(n) for n in named) or not BLOCKS[block].stays
    own = [n.law for n in named]
    of_gyro = block in (ODD, EACH_RATE) and is_beyond_a_table(alone.fitted, own)
    if block in BENT and not of_gyro and not beyond_chance(1.0, own, block, laws):
        # Of so few sizes of the rate anything makes a law.
        return unnamed
    # Errors of single rates are as simple as a law is, which had its shapes to choose from.
    slack = -sum(map(paid_by, named)) if block == EACH_RATE else REPLACED + len(named)
    if alone.fitted.nll <= whole_nll + slack:
        return _Answer(alone.fitted if replaces else fitted, named, alone.near, alone.fitted.nll)
    beside = beside_laws(fitted, alone.fitted.model.laws, block) if replaces else fitted
    if BLOCKS[block].lasts:
        # What a law leaves is its misfit.
        at_most = (without.nll - changing(alone.fitted, own, laws).nll) / worth
        earned = beyond_chance(at_most, own, block, laws) >= _NAMED_SHARE or _stands_for(block)
        return _Answer(beside, named, alone.near, alone.fitted.nll) if earned else unnamed
    # A walk follows a line without being one: each law must say more than the walk does.
    says_more = fitted.nll - beside.nll > GAIN * len(named)
    return _Answer(beside, named, alone.near, beside.nll) if says_more else unnamed


def _at_one_size(law: Law, means: Means) -> bool:
    """Whether a peak over the rate was seen at one size of it alone, where it is no shape but a reading."""
    if not CATALOGUE[law.effect].search.scatters:
        return False
    seen = np.sum(law.columns**2, axis=1)
    at_each = np.sum(by_size(means, np.sqrt(seen)) ** 2, axis=0)
    return bool(np.max(at_each, initial=0.0) > _SEEN_AT_ONE * np.sum(seen))


def _resembling(nearest: Winner | None, without: Fitted, block: str, worth: float) -> list[Named]:
    """The only law of a family, for what it hardly resembles: a ripple over temperature is of a higher order, too.

    The smooth parts stay in the model for it.
    """
    if nearest is None or not (_stands_for(block) and BLOCKS[block].lasts) or worth < nearest.least_nats:
        return []
    share = max((without.nll - nearest.fitted.nll) / worth, 0.0)
    return [Named(nearest.law, block, worth, share, {}, nearest.shapes)]


def _stands_for(block: str) -> bool:
    """Whether the only law of a block has the name for all that is like it: a curve has, over what is logged; what remembers has a mechanism."""
    effects = effects_of(block)
    return len(effects) == 1 and not effects[0].has_memory


def _of_robot(named: Named) -> bool:
    effect = CATALOGUE[named.law.effect]
    return effect.runtime and not effect.search.in_part and named.law.columns.shape[1] == 1


def _least_worth(named: Named, others: Sequence[Named]) -> float:
    """What a law has to be worth at the end to stay, nats: one of several that are one effect has its name by the others."""
    if named.law.effect == BIAS_DRIFT.id:
        return _LINE
    if any(n is not named and n.law.effect == named.law.effect for n in others):
        return ALIKE_NATS
    return 0.5 * float(chi2.isf(NAMED_LEVEL / named.trials, named.law.columns.shape[1]))


def _backward(fitted: Fitted, named: list[Named]) -> tuple[Fitted, list[Named], list[Named]]:
    """Drop laws that the others have made superfluous; also those of them that stay."""
    followed: list[Named] = []
    beside = [n for n in named if n.block in fitted.model.blocks.values() and n.block != BIAS_IN_TIME]
    named = [n for n in named if n not in beside]
    while named:
        gains = [(fitted.refit(fitted.model.without_laws([n.law.name])), n) for n in named]
        gains.sort(key=lambda x: x[0].nll - _least_worth(x[1], named))
        without, weakest = gains[0]
        if without.nll - fitted.nll >= _least_worth(weakest, named):
            worth = {n.law.name: f.nll - fitted.nll for f, n in gains}
            return fitted, beside + [replace(n, gain=worth[n.law.name]) for n in named], followed
        fitted, named = without, [n for n in named if n is not weakest]
        if weakest.block and BLOCKS[weakest.block].stays:
            followed.append(weakest)
    return fitted, beside, followed
