"""What else the laws of a run may be: models with a rival in place of a law that is hardly likelier."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws, tied_anew
from gyrocal.diagnosis.laws.contest import best_law, price
from gyrocal.diagnosis.laws.estimates import reshaped
from gyrocal.diagnosis.laws.in_place import NAMED_LEVEL, Named, is_passing
from gyrocal.diagnosis.laws.jumps import best_jump
from gyrocal.diagnosis.model.blocks import around_itself
from gyrocal.diagnosis.model.layers import NEGLIGIBLE, Fitted, Model, beyond_input
from gyrocal.diagnosis.model.parts import EACH_RATE, FOLLOWING, ODD, PASSING, passing
from gyrocal.diagnosis.model.starts import alive
from gyrocal.diagnosis.sweeps.candidates import AVERAGED_NATS
from gyrocal.diagnosis.sweeps.changes import DRIFTS, STEPS
from gyrocal.diagnosis.sweeps.coil import TOLL_NATS
from gyrocal.physics.catalogue import CATALOGUE

Floats = NDArray[np.float64]


def with_rivals(fitted: Fitted, named: Sequence[Named], laws: Laws) -> list[tuple[float, Fitted]]:
    """A model, and those with rivals in place of one or more of its laws, or of errors of each rate, with how likely each is.

    Of a few rates, or of temperatures that come once, several laws explain the same, and away from what was visited each
    makes something else of it: a file of one alone would be sure of what nobody knows.
    """
    near = [(0.0, fitted)]
    for one in named:
        near += [other for loss, model in near for other in _with_rival(loss, model, one, laws)]
        least = min(loss for loss, _ in near)
        near = [(loss - least, model) for loss, model in near if loss < least + AVERAGED_NATS]
    near += [other for loss, model in near for other in _with_shapes(loss, model)]
    least = min(loss for loss, _ in near)
    weights = np.exp([least - loss for loss, _ in near])
    return [*zip((weights / weights.sum()).tolist(), (model for _, model in near), strict=True)]


def of_one_surface(near: Sequence[tuple[float, Fitted]]) -> list[tuple[float, Fitted]]:
    """Models with their weights, whose surfaces have a mean: all of the input, or of the output with one bend.

    Beside a sine the surface may be what it is not beside a knee; over the output their mean is neither's.
    """
    settled = [_instead(np.log(weight), model, around_itself(model)) for weight, model in near]
    chosen = [one for one, same in zip(settled, _as_the_first([m for _, m in settled]), strict=True) if same]
    if len(chosen) < len(near):
        straight = [_instead(log, model, _straight(model)) for log, model in settled]
        chosen = max(chosen, straight, key=lambda models: np.logaddexp.reduce([log for log, _ in models]))
    logs = np.array([log for log, _ in chosen])
    weights = np.exp(logs - np.logaddexp.reduce(logs))
    return [*zip(weights.tolist(), (model for _, model in chosen), strict=True)]


def _instead(log_weight: float, model: Fitted, other: Fitted) -> tuple[float, Fitted]:
    return log_weight + model.nll - other.nll, other


def _straight(fitted: Fitted) -> Fitted:
    """The same with a surface of the input."""
    if fitted.model.direction == "input":
        return fitted
    return fitted.refit(fitted.model.directed("input", _bend(fitted)))


def _bend(fitted: Fitted) -> Floats:
    return fitted.model.bend_of(fitted.solve())


def _as_the_first(models: Sequence[Fitted]) -> list[bool]:
    """Whether the surface of each has with that of the first the mean that their parameters have, at every row."""
    direction, basis = models[0].model.direction, models[0].model.basis
    alike = [fitted.model.direction == direction for fitted in models]
    if direction == "input":
        return alike
    solution = models[0].solve()
    bend, least_dps = models[0].model.bend_of(solution), NEGLIGIBLE * float(np.std(solution.left))
    beyond = beyond_input(basis, bend)

    def near(other: Floats) -> bool:
        return bool(np.max(np.abs((beyond_input(basis, other) - beyond) @ (other - bend))) < least_dps)

    return [same and near(_bend(fitted)) for same, fitted in zip(alike, models, strict=True)]


def or_lasting(
    fitted: Fitted, named: Sequence[Named], followed: Sequence[Named], laws: Laws
) -> tuple[Fitted, list[Named]]:
    """The model, and the names, with the likelier of a law that passes and one that stays which it can follow; the other is its rival.

    A plan goes through temperatures in turn: a lag in each of them is like a step from one to the next.

    Parameters
    ----------
    followed : laws that stay, and have no name because what passes can follow them
    """
    named = [*named]
    for lasts in followed:
        for k, passes in enumerate(named):
            if not (is_passing(passes) and fitted.model.holds(passes.law)):
                continue
            model = fitted.model.without_laws([passes.law.name]).with_laws(lasts.law)
            other, _ = tied_anew(fitted.refit(model), laws)
            behind = other.nll + paid_by(lasts) - fitted.nll - paid_by(passes)
            if behind < 0.0:
                fitted, named[k] = other, replace(lasts, rivals={**lasts.rivals, passes.law.effect: -behind})
            else:
                named[k] = replace(passes, rivals={**passes.rivals, lasts.law.effect: behind})
    return fitted, named


def or_passing(fitted: Fitted, named: Sequence[Named], laws: Laws) -> tuple[Fitted, list[Named]]:
    """The model, and the names, with the likelier of what follows the temperature and a law that passes in its place; the other is its rival.

    Where each temperature comes once, what remembers it can follow a jump or a drift, and a walk hides them.
    """
    named = [*named]
    for block in FOLLOWING:
        own = [n for n in named if n.block == block]
        smooth = fitted.model.of_block(block)
        sets = [[n] for n in own] + ([own] if len(own) > 1 else [])
        found = []
        for instead_of in sets:
            plain = fitted.model.without_laws([n.law.name for n in instead_of]).without(smooth)
            instead = _passing_law(fitted.refit(plain), laws)
            if instead is not None:
                passes, other = instead
                paid = sum(paid_by(n) for n in instead_of if fitted.model.holds(n.law))
                behind = other.nll + paid_by(passes) - fitted.nll - paid
                found.append((behind, instead_of, passes, other))
        if not found:
            continue
        behind, instead_of, passes, other = min(found, key=lambda one: one[0])
        lasts = max(instead_of, key=lambda n: n.gain)
        if behind < 0.0:
            fitted, named = other, [n for n in named if not any(n is x for x in instead_of)]
            named.append(replace(passes, rivals={**passes.rivals, lasts.law.effect: -behind}))
        else:
            beside = replace(lasts, rivals={**lasts.rivals, passes.law.effect: behind})
            named = [beside if n is lasts else n for n in named]
    return fitted, named


def _passing_law(without: Fitted, laws: Laws) -> tuple[Named, Fitted] | None:
    """The likeliest jump or drift beside a model, and the model with it; None where none is surely there."""
    jumps = (best_jump(without, laws, effect) for effect in STEPS)
    tried: list[tuple[Fitted, dict[str, float], int]] = [
        (fitted, {}, rows) for fitted, rows in filter(None, jumps)
    ]
    trials = [t for effect in DRIFTS for t in laws.trials(CATALOGUE[effect]) if t.columns.shape[1] == 1]
    if (drift := best_law(without, without, "", trials, laws)) is not None:
        tried.append((drift.fitted, drift.rivals, drift.shapes))
    found = [
        (Named(fitted.model.laws[-1], "", without.nll - fitted.nll, 1.0, rivals, shapes), fitted)
        for fitted, rivals, shapes in tried
    ]
    sure = [one for one in found if one[0].p_value <= NAMED_LEVEL]
    return min(sure, key=lambda one: one[1].nll + paid_by(one[0]), default=None)


def may_wander(model: Model, without: Sequence[str] = ()) -> Model:
    """The same, with a bias and a scale factor that may wander, but for some blocks."""
    passes = passing(model.means, model.basis.frame)
    wander = {c.name: c for c in passes if PASSING.get(c.name) not in (EACH_RATE, *without)}
    return replace(model, components={**wander, **model.components})


def _with_rival(loss: float, fitted: Fitted, one: Named, laws: Laws) -> Iterator[tuple[float, Fitted]]:
    """Models with each of its rivals in place of a law, with their losses, nats; of what passes with a walk, too."""
    if not fitted.model.holds(one.law):
        return
    model = fitted.model.without_laws([one.law.name])
    own = fitted.nll + paid_by(one)
    if is_passing(one):
        wandering = fitted.refit(may_wander(model))
        yield loss + wandering.nll - own, wandering
    without = fitted.refit(model)
    for effect in (e for e, behind in one.rivals.items() if loss + behind < AVERAGED_NATS):
        trials = [t for t in laws.trials(CATALOGUE[effect]) if t.columns.shape[1] == 1]
        rival = best_law(without, without, one.block, trials, laws)
        if rival is not None:
            shaped = reshaped(rival.fitted, laws, [rival.law.name])
            yield loss + shaped.nll + price(rival.law, rival.shapes, TOLL_NATS) - own, shaped


def _with_shapes(loss: float, fitted: Fitted) -> Iterator[tuple[float, Fitted]]:
    """The model with shapes in rate, which pay together what a law pays, in place of errors of each rate of the table.

    A few rates are followed by anything smooth as well as by errors that know nothing of each other, and only one of the two
    is the gyro's.
    """
    model = fitted.model
    drawn = model.of_block(EACH_RATE)
    shapes = [model.basis.component(p) for p in model.parts if p.block == ODD]
    if drawn and shapes and not model.of_block(ODD):
        shaped = alive(fitted.refit(model.without(drawn).with_components(*shapes)))
        yield loss + shaped.nll + TOLL_NATS - fitted.nll, shaped


def paid_by(named: Named) -> float:
    """What a named law pays for being there, nats."""
    return price(named.law, named.trials, TOLL_NATS)
