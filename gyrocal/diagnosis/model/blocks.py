"""Blocks of smooth parts: which of them are there, what each is worth, and which way the surface bends beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws, tied_anew
from gyrocal.diagnosis.model.layers import DIRECTION, Fitted, Law, Model
from gyrocal.diagnosis.model.parts import EACH_RATE, EVEN, ODD, SURFACE, Part
from gyrocal.inference.additive import Component
from gyrocal.physics.smooth import Factor
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: Blocks whose removal costs less, nats, are not there.
_ABSENT = 2.5
#: What is simpler stands for what it replaces where it explains no worse than by this, nats.
REPLACED = 2.0
#: Errors of each rate stand for what is odd in the rate where they explain no worse than by this, nats, 20 to 1: beside each
#: other neither is worth anything, and errors of 150 ppm had no name beside a step.
_OWN = 3.0
#: What acts on the scale factor beside the bias is there where it is worth this by itself, nats, 20 to 1: away from the
#: rates and the temperatures of the record it grows with both.
_OF_SCALE = 3.0
#: Blocks of all that a wrong direction of the surface looks like.
BENT = (ODD, EVEN, EACH_RATE)
#: Where the variance of the surface's own terms starts a second time (logarithm of the share of the record's).
_AWAKE = 0.0
#: Rounds in which the bend of a surface follows the surface; each leaves its slope (percents) of the change before.
_BENDS = 12
#: What the coefficients of a bend may change by at its end, deg/s.
_SETTLED_DPS = 1e-4


def settle_direction(fitted: Fitted, shaped: Callable[[Fitted], Fitted] = lambda fitted: fitted) -> Fitted:
    """The model with a surface of the output or of the input, where either does as well as what is between.

    Around itself: what bends is the surface that stands beside all else.

    Parameters
    ----------
    shaped : fits the shapes of the laws to the surface beside them
        A law of the rate that was shaped beside one of the two fits better beside that one.
    """
    model = fitted.model
    if np.unique(np.round(model.means.rate_dps, 2)).size <= len(model.flat):
        return fitted
    bend = model.bend_of(fitted.solve())
    free = fitted.refit(model.directed("free", bend))
    bend = free.model.bend_of(free.solve())
    free = shaped(free.refit(model.directed("free", bend)))
    ways = {d: shaped(free.refit(free.model.directed(d, bend))) for d in ("output", "input")}
    if model.direction == "output":
        # Beside a law of the rate what is between may have led its bend astray.
        ways["output"] = min(fitted, ways["output"], key=lambda f: f.nll)
    best = min(ways.values(), key=lambda f: f.nll)
    # What is between the two is neither: it takes evidence to be believed.
    return free if free.nll + GAIN <= best.nll and _is_between(free) else best


def _is_between(free: Fitted) -> bool:
    """Whether its direction may be one between that of the input, 0, and that of the output, 1: what is far beyond bends otherwise."""
    solution = free.solve()
    if DIRECTION not in solution.amplitudes:
        return False
    at = solution.starts[DIRECTION]
    share, std = float(solution.amplitudes[DIRECTION][0]), float(np.sqrt(solution.covariance[at, at]))
    return -NORMAL_95 * std <= share <= 1.0 + NORMAL_95 * std


def plain(model: Model, direction: str, bend: Floats) -> Model:
    """The model with a surface of this direction and without what is odd in the rate, which makes up for a wrong one."""
    return model.without(model.of_block(ODD)).directed(direction, bend)


def gain_of_input(fitted: Fitted) -> tuple[float, float]:
    """How much better a surface over the input is than one over the output, and what it leaves of the model, nats.

    Neither has smooth parts that are odd in the rate beside it.
    """
    bend = fitted.model.bend
    if bend is None or fitted.model.direction == "output":
        return 0.0, 0.0
    bend = fitted.model.bend_of(fitted.solve())
    ways = {
        d: min(_either_surface(fitted, plain(fitted.model, d, bend)), key=lambda f: f.nll)
        for d in ("output", "input")
    }
    return around_itself(ways["output"]).nll - ways["input"].nll, ways["input"].nll - fitted.nll


def beside_laws(fitted: Fitted, laws: Sequence[Law], block: str) -> Fitted:
    """The model with laws beside a block, less the part of it that is one of them in all but name.

    Of two columns alike the variances have either, and a law with a name would have no amplitude.
    """

    def least(one: Fitted) -> float:
        return min(one.fit.log_variance[law.name] for law in laws)

    found = fitted.refit(replace(fitted.model, laws=tuple(laws)))
    if not any(found.has_died(law.name) for law in laws):
        return found
    single = [p.name for p in found.model.parts if p.block == block and len(p.columns) == 1]
    fewer = [found.refit(found.model.without([n])) for n in single if n in found.model.components]
    return max([found, *(f for f in fewer if f.nll <= found.nll + REPLACED)], key=least)


def around_itself(fitted: Fitted) -> Fitted:
    """The same with the bend of the surface that it has now: what is taken out of a model moves its surface.

    Beside a law that may take the place of most of the surface it does not settle; then the surface is one of the input,
    which needs no bend.
    """
    if fitted.model.direction == "input":
        return fitted
    before, step = np.zeros(len(SURFACE)), 1.0
    for _ in range(_BENDS):
        bend = fitted.model.bend_of(fitted.solve())
        if fitted.model.bend is not None:
            change = bend - fitted.model.bend
            if np.abs(change).max() < _SETTLED_DPS:
                return fitted
            # Where a law takes up what the surface gives, a whole step overshoots: the last two tell by how much.
            left = float(change @ before) / max(float(before @ before), _SETTLED_DPS**2)
            step = 1.0 / (1.0 - float(np.clip(1.0 - (1.0 - left) / step, -1.0, 0.0)))
            bend, before = fitted.model.bend + step * change, change
        fitted = fitted.refit(fitted.model.directed(fitted.model.direction, bend))
    return fitted.refit(fitted.model.directed("input", bend))


def errors_of_each_rate(fitted: Fitted, draws: Component | None) -> Fitted:
    """The model with an error of each rate in place of odd smooth parts, where it explains as much.

    A few rates can be followed by anything smooth; independent errors of one size are the simpler account of them.
    """
    odd = fitted.model.of_block(ODD)
    if draws is None or not odd:
        return fitted
    without = fitted.model.without(odd)
    found = fitted.refit(without.with_components(draws))
    return found if found.nll <= fitted.nll + _OWN else fitted


def _either_surface(fitted: Fitted, model: Model) -> list[Fitted]:
    """The model fitted again from the variances that it has, and from a surface whose terms are all awake.

    Where smooth parts took the surface's place its own terms lie still: alone they do not come back.
    """
    awake = {**fitted.fit.log_variance, **{p.name: _AWAKE for p in model.parts if p.block == "surface"}}
    return [fitted.refit(model), fitted.refit(model, start=awake)]


def less(fitted: Fitted, block: str) -> Fitted:
    """The model without a block, its surface of the same direction."""
    names = fitted.model.of_block(block)
    return min(_either_surface(fitted, fitted.model.without(names)), key=lambda f: f.nll)


def idle(fitted: Fitted, names: Sequence[str], least_nats: float) -> list[str]:
    """Components that a model does without, one after the other, the weakest first, for less than `least_nats` each."""
    found: list[str] = []
    while rest := [n for n in names if n not in found]:
        without = {n: fitted.refit(fitted.model.without([n])) for n in rest}
        weakest = min(rest, key=lambda n: without[n].nll)
        if without[weakest].nll > fitted.nll + least_nats:
            break
        fitted = without[weakest]
        found.append(weakest)
    return found


def of_scale(part: Part) -> bool:
    """Whether a part goes with the rate, not with the bias alone."""
    return all(column.rate != Factor() for column in part.columns)


def evidence(fitted: Fitted, block: str, laws: Laws | None = None) -> tuple[float, Fitted]:
    """What a block is worth, nats, and the model without it, in which laws act through the surface that it leaves."""
    names = fitted.model.of_block(block)
    model, bend = fitted.model.without(names), fitted.model.bend
    ways = [model]
    if block in BENT and bend is not None:
        ways = [model.directed(d, bend) for d in ("input", "output")]
    without = min((refit for way in ways for refit in _either_surface(fitted, way)), key=lambda f: f.nll)
    if laws is not None and without.model.laws:
        without = min(without, tied_anew(without, laws)[0], key=lambda f: f.nll)
    return without.nll - fitted.nll, without


def present(fitted: Fitted, laws: Laws | None = None) -> tuple[Fitted, dict[str, float]]:
    """The model less the blocks that are not there, and what each of the others is worth."""
    while True:
        found = {b: evidence(fitted, b, laws) for b in sorted(set(fitted.model.blocks.values()))}
        weak = sorted((gain, b) for b, (gain, _) in found.items() if gain < _ABSENT)
        if not weak:
            of_bias = _of_bias_alone(fitted)
            if of_bias is not fitted:
                fitted = of_bias
                continue
            return around_itself(fitted), _of_both(fitted, {b: gain for b, (gain, _) in found.items()}, laws)
        # The weakest at once, so that one of two that share a pattern stays.
        fitted = found[weak[0][1]][1]
        for _, block in weak[1:]:
            gain, without = evidence(fitted, block, laws)
            if gain < _ABSENT:
                fitted = without


def _of_bias_alone(fitted: Fitted) -> Fitted:
    """The model less those parts of a block that act on the scale factor, where its others act on the bias and do nearly as well."""
    for block in sorted(set(fitted.model.blocks.values())):
        own = [p for p in fitted.model.parts if p.block == block and p.name in fitted.model.components]
        scale = [p.name for p in own if of_scale(p)]
        if 0 < len(scale) < len(own):
            without = fitted.refit(fitted.model.without(scale))
            if without.nll < fitted.nll + _OF_SCALE:
                fitted = without
    return fitted


def _of_both(fitted: Fitted, worth: dict[str, float], laws: Laws | None) -> dict[str, float]:
    """What blocks are worth; of odd shapes in the rate and errors of single rates, which may hide each other, the stronger then has what both say."""
    if not {ODD, EACH_RATE} <= worth.keys() or max(worth[ODD], worth[EACH_RATE]) >= GAIN:
        return worth
    weaker, stronger = sorted((ODD, EACH_RATE), key=worth.__getitem__)
    alone = evidence(fitted, weaker, laws)[1]
    return worth | {stronger: worth[weaker] + evidence(alone, stronger, laws)[0]}
