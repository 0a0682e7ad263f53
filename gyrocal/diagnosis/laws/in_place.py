"""Laws alone in place of a block of smooth parts: one, two of one effect, or several mechanisms together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws, Trial, effects_of
from gyrocal.diagnosis.laws.contest import (
    ALIKE_NATS,
    Winner,
    best_law,
    best_pair,
    best_together,
    mechanism,
    price,
)
from gyrocal.diagnosis.laws.estimates import reshaped
from gyrocal.diagnosis.laws.misfit import with_misfit
from gyrocal.diagnosis.laws.scan import free_of
from gyrocal.diagnosis.model.blocks import BENT, REPLACED
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.diagnosis.model.parts import BIAS_IN_TIME, BLOCKS, EACH_RATE, ODD
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect
from gyrocal.physics.thermal import SHUPE
from gyrocal.physics.timewise import BIAS_DRIFT

#: A law that chance would make with more than this probability has no name. On 222 recordings by two other authors 8 of 15 names
#: with 0.005 to 0.05 were wrong, of those with less 35 of 445.
NAMED_LEVEL = 0.005
#: A further law of another kind leaves nothing of the block or takes this share of its evidence, and no other law is like
#: it: else it is the first one's misfit. On 69 recordings four were refused so, none of which was there.
_SECOND = 0.2
#: Several mechanisms together leave nothing of the block or no more than this share of its evidence: else they mend the misfit
#: of each other. Of 77 recordings with thermal transients five had several so, each with the right ones; one that left 0.15 had
#: a wrong one among them.
_MISFIT = 0.05
#: Laws of one block. A search ends by what they gain; only the plays of a hysteresis without a corner ever were as many.
_MOST_LAWS = 3


def by_chance(nats: float, amplitudes: int, trials: int = 1) -> float:
    """Probability that the best of some trials, of so many amplitudes each, gains as much where nothing is."""
    return min(1.0, trials * float(chi2.sf(2.0 * max(nats, 0.0), amplitudes)))


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

    @property
    def p_value(self) -> float:
        """Probability that the best of as many shapes gains as much by chance."""
        return by_chance(self.gain, self.law.columns.shape[1], self.trials)


def passes(effect: Effect) -> bool:
    """Whether it is of what passes: its state at the end is held, and it does not begin anew."""
    return effect.family == BLOCKS[BIAS_IN_TIME].family and not effect.runtime


def is_passing(named: Named) -> bool:
    """Whether a law is of what passes."""
    return passes(CATALOGUE[named.law.effect])


@dataclass(frozen=True)
class Alone:
    """Laws alone in place of a block: the model, what each of the nearest ones leaves of the block, nats, and the nearest."""

    fitted: Fitted
    named: list[Named]
    near: dict[str, float]
    nearest: Winner | None = None

    @property
    def kinds(self) -> set[str]:
        """Effects that it takes."""
        return {n.law.effect for n in self.named}

    @property
    def cost(self) -> float:
        """One mechanism of several laws is likelier than two that do hardly better."""
        return self.fitted.nll + GAIN * max(len(self.kinds) - 1, 0)


def simplest(fitted: Fitted, without: Fitted, block: str, laws: Laws, worth: float) -> Alone:
    """The laws that explain a block best, those of one mechanism if they do nearly as well.

    A drift that slows down may be nearer to a warm-up of two time constants than one exponential is: two together are asked
    as well, and win where they are more than alike. Plays of two widths, which could follow any memory, are not.
    """
    trials = [t for e in effects_of(block) for t in laws.trials(e)]
    best = _alone(fitted, without, block, trials, laws, worth)
    summed = {t.effect.id for t in trials if t.effect.search.adds_up}
    if BLOCKS[block].family != BIAS_DRIFT.family:
        summed &= best.kinds
    for kind in sorted(summed):
        if not best.kinds or best.kinds == {kind}:
            continue
        single = _alone(fitted, without, block, [t for t in trials if t.effect.id == kind], laws, worth)
        ahead = best.cost - single.cost
        if ahead > (0.0 if kind in best.kinds else ALIKE_NATS):
            left = single.fitted.nll - (without.nll - worth)
            best = replace(single, near=dict.fromkeys(best.near, left + ahead) | {kind: left})
    return _together(fitted, without, block, trials, laws, worth, best)


def _together(
    fitted: Fitted,
    without: Fitted,
    block: str,
    trials: Sequence[Trial],
    laws: Laws,
    worth: float,
    best: Alone,
) -> Alone:
    """Several thermal transients in place of what one by itself hardly holds for, where they explain surely more.

    A lag, a play and a gradient are of different parts of a gyro. Of what goes by the rate the misfit of one law is like another law.
    """
    nothing = without.nll - worth
    if BLOCKS[block].family != SHUPE.family or not best.named:
        return best
    if best.fitted.nll <= nothing + REPLACED + len(best.named):
        return best
    winners = best_together(fitted, without, block, trials, laws, _MOST_LAWS)
    if len(winners) < 2:
        return best
    several = reshaped(winners[-1].fitted, laws, [w.law.name for w in winners])
    paid = [price(n.law, n.trials, GAIN) for n in best.named]
    ahead = best.fitted.nll + sum(paid) - several.nll - sum(w.least_nats for w in winners)
    if ahead <= ALIKE_NATS or several.nll > nothing + max(REPLACED + len(winners), _MISFIT * worth):
        return best
    before = [without, *(w.fitted for w in winners)]
    own = several.model.laws[-len(winners) :]
    named = [
        Named(law, block, b.nll - w.fitted.nll, 0.0, w.rivals, w.shapes)
        for law, w, b in zip(own, winners, before, strict=False)
    ]
    return replace(best, fitted=several, named=named)


def _alone(
    fitted: Fitted, without: Fitted, block: str, trials: Sequence[Trial], laws: Laws, worth: float
) -> Alone:
    """The best law in place of a block, and further ones beside it.

    Parameters
    ----------
    without : the model without the block
    worth : evidence for the block, nats
    """
    found = Alone(without, [], {})
    while len(found.named) < _MOST_LAWS:
        best = best_law(fitted, found.fitted, block, [t for t in trials if _may_follow(t, found)], laws)
        if best is None:
            break
        gain = found.fitted.nll - best.fitted.nll
        if not found.named:
            behind = {best.effect.id: 0.0, **best.rivals}
            near = {e: worth - gain + more for e, more in behind.items()}
            found = replace(found, near=near, nearest=best)
        least = best.least_nats
        if gain < least:
            break
        another = found.named and best.effect.id not in found.kinds
        if another and not _left_to_check([*(n.law for n in found.named), best.law], block, laws):
            # They would explain anything.
            break
        bends = BLOCKS[block].family == BIAS_DRIFT.family
        if another and not bends and _beyond_misfit(found, best.fitted, laws) < least:
            # In time the first would bend into it.
            break
        told_apart = min(best.rivals.values(), default=np.inf) > ALIKE_NATS
        left = worth - (without.nll - best.fitted.nll)
        enough = left <= REPLACED + len(found.named) + 1 or gain >= _SECOND * worth
        if another and not (told_apart and enough):
            # The misfit of a law of another kind is no second effect, nor is what several laws take equally well.
            break
        law = Named(best.law, block, gain, 0.0, best.rivals, best.shapes)
        found = Alone(best.fitted, [*found.named, law], found.near)
    return _paired(fitted, without, block, trials, laws, found)


def beyond_chance(share: float, several: Sequence[Law], block: str, laws: Laws) -> float:
    """The share of a block that laws take, less what as many parameters would take of any curve; 0 where that is all of it.

    An adjusted coefficient of determination.
    """
    left = _left_to_check(several, block, laws)
    return 1.0 - (1.0 - share) / left if left else 0.0


def _left_to_check(several: Sequence[Law], block: str, laws: Laws) -> float:
    """Share of the numbers that a block is that the parameters of laws leave to check them by; 0: none.

    Of what goes by the rate the sizes of the rate leave over but a few; all else has many.
    """
    if block not in BENT:
        return 1.0
    odd, even = laws.offer.left_by_cubic
    numbers = odd if block in (ODD, EACH_RATE) else even
    shapes = sum(len(free_of(law)) for law in several)
    free = numbers - shapes - sum(law.columns.shape[1] for law in several)
    return free / numbers if free > 0 else 0.0


def _may_follow(trial: Trial, found: Alone) -> bool:
    """Whether a law may stand beside those that were found: one of another mechanism, or one that adds up to one effect."""
    effect = trial.effect
    if effect.id in found.kinds:
        return effect.search.adds_up
    return mechanism(effect) not in {mechanism(CATALOGUE[e]) for e in found.kinds}


def _beyond_misfit(found: Alone, best: Fitted, laws: Laws) -> float:
    """What a further law explains beyond what the first ones would if they nearly held, nats.

    Else it mends the shape that they had on the grid, or a corner that is round.
    """
    before, after = reshaped(found.fitted, laws), reshaped(best, laws)
    first = slice(len(before.model.laws) - len(found.named), len(before.model.laws))
    nearly = [with_misfit(f, f.model.laws[first], laws) for f in (before, after)]
    return nearly[0].nll - nearly[1].nll


def _paired(
    fitted: Fitted, without: Fitted, block: str, trials: Sequence[Trial], laws: Laws, found: Alone
) -> Alone:
    """Two laws of one effect in place of one, where they explain more by what a second law has to."""
    if len(found.named) != 1:
        return found
    law = found.named[0].law
    if law.columns.shape[1] != 1 or not CATALOGUE[law.effect].search.adds_up:
        return found
    own = [t for t in trials if t.effect.id == law.effect]
    pair = best_pair(fitted, without, block, own)
    if pair is None:
        return found
    # Laws of other blocks keep the shapes by which their names know them.
    pair = reshaped(pair, laws, [one.name for one in pair.model.laws[-2:]])
    gain = found.fitted.nll - pair.nll
    both = pair.model.laws[-2:]
    if gain < sum(price(one, len(own), GAIN) for one in both) - price(law, len(own), GAIN):
        return found
    two = [replace(found.named[0], law=one) for one in both]
    return replace(found, fitted=pair, named=[two[0], replace(two[1], gain=gain)])
