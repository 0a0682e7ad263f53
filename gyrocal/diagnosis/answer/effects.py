"""What was found as the answer's records: named effects with parameters, rivals and evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter

import numpy as np

from gyrocal.diagnosis.answer.locate import block_p_value, coordinate_here, place_of
from gyrocal.diagnosis.answer.staircase import Step
from gyrocal.diagnosis.answer.untimed import between_sets, by_data_set
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.laws import estimates
from gyrocal.diagnosis.laws.contest import ALIKE_NATS
from gyrocal.diagnosis.laws.in_place import NAMED_LEVEL, Named, by_chance
from gyrocal.diagnosis.model.blocks import plain
from gyrocal.diagnosis.model.layers import Law, Model, beyond_input, lagging
from gyrocal.diagnosis.model.parts import BLOCKS, EACH_RATE, ODD
from gyrocal.diagnosis.model.rate_errors import largest
from gyrocal.diagnosis.model.within import Pattern
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Alternative, Estimate, Located, NamedEffect, UnnamedPart
from gyrocal.diagnosis.rows.inputs import went_one_way
from gyrocal.diagnosis.sweeps.candidates import averaged
from gyrocal.diagnosis.sweeps.changes import STEPS
from gyrocal.diagnosis.sweeps.lag_posterior import lag_estimates
from gyrocal.diagnosis.sweeps.law_posterior import posterior_of
from gyrocal.diagnosis.sweeps.open_loop import in_favour, phase_of
from gyrocal.diagnosis.sweeps.unclocked import lacks_clock
from gyrocal.physics.catalogue import CATALOGUE, as_large
from gyrocal.physics.rate import FIT_DIRECTION, RATE_ORDER, REFERENCE_RATE_ERROR, SAGNAC_SINE
from gyrocal.physics.thermal import TEMPERATURE_ORDER, THERMAL_LAG
from gyrocal.physics.timewise import BIAS_DRIFT, WARM_UP

#: Of the fifth order of a cubic of the output, what a sine has.
_SINE_FIFTH = 0.1


def named_effects(found: Examination) -> list[NamedEffect]:
    """All that has a name, the strongest first."""
    named = [(n.gain, _law(found, n)) for n in found.naming.named]
    named += [(-np.log(max(p.p_value, 1e-300)), _pattern(found, p)) for p in found.patterns]
    named += [(s.nats, _of_table(found, s)) for s in _searched(found) if s.p_value <= NAMED_LEVEL]
    gain = found.rate_errors_nats
    if gain > 0.0:
        size = estimates.of_draws(found.naming.fitted)
        p = block_p_value(gain, len(BLOCKS))
        found_as = _effect(
            found,
            REFERENCE_RATE_ERROR.id,
            {"amplitude": size},
            p,
            _instead_of_each_rate(found) | _shapes_instead(found),
        )
        where = Remark(Said.LARGEST_RATES, {"rates": largest(found.naming.fitted)})
        named.append((gain, replace(found_as, beside=where)))
    if found.of_a_sine:
        sine = {"amplitude": Estimate.exact(1.0, "1"), "phase_rad_per_dps": phase_of(found.candidates)}
        # What has any cubic explains the rates as well, where the sine's is no more than likely.
        like = [RATE_ORDER.id, *([FIT_DIRECTION.id] if found.of_the_input else [])]
        rivals = dict.fromkeys(like, max(found.sine_nats - in_favour(), 0.0))
        p = float(1.0 / (1.0 + np.exp(min(found.sine_nats, 700.0))))
        gain = max(found.sine_nats, found.naming.input_gain)
        named.append((gain, _effect(found, SAGNAC_SINE.id, sine, p, rivals)))
    elif found.of_the_input:
        share = _input_share(found)
        p = by_chance(found.naming.input_gain, 1)
        # What leaves as little of what is odd in the rate explains it as well.
        near = dict(found.naming.nearest.get(ODD, {}))
        near[SAGNAC_SINE.id] = min(near.get(SAGNAC_SINE.id, np.inf), _of_a_sine(share))
        rivals = {e: max(near[e], 0.0) for e in FIT_DIRECTION.looks_like if e in near}
        named.append(
            (found.naming.input_gain, _effect(found, FIT_DIRECTION.id, {"amplitude": share}, p, rivals))
        )
    by_effect: dict[str, list[NamedEffect]] = {}
    for _, effect in sorted(named, key=lambda x: -x[0]):
        by_effect.setdefault(effect.effect, []).append(effect)
    return [_as_one(laws) for laws in by_effect.values()]


def _instead_of_each_rate(found: Examination) -> dict[str, float]:
    """The law that explains what errors of each rate do, though not surely enough for a name; mostly there is none.

    Its evidence, less what it pays, is more than theirs alone, so that it is no less likely: 0 nats.
    """
    named = {n.law.effect for n in found.naming.named}
    better = [c for c in found.of_rate if c.score < found.ranked[0].score]
    instead = better[0].fitted.model.laws[-1].effect if better else None
    return {instead: 0.0} if instead is not None and instead not in named else {}


def _shapes_instead(found: Examination) -> dict[str, float]:
    """Orders of the rate, where shapes in the rate explain as much as the errors of each rate that stand in their place, nats behind."""
    shaped, drawn = found.whole, found.settled
    odd = [n for n in shaped.model.of_block(ODD) if not shaped.has_died(n)]
    replaced = odd and ODD not in drawn.model.blocks.values() and shaped.model.laws == drawn.model.laws
    named = any(n.law.effect == RATE_ORDER.id for n in found.naming.named)
    if not replaced or named or shaped.nll - drawn.nll >= ALIKE_NATS:
        return {}
    return {RATE_ORDER.id: max(shaped.nll - drawn.nll, 0.0)}


def _as_one(laws: list[NamedEffect]) -> NamedEffect:
    """Several laws of one effect, the strongest first, as one: figures of the one that adds most."""
    by_size = sorted(laws, key=lambda e: -(e.adds.value if e.adds else 0.0))
    largest, of_scale = by_size[0], _of_scale(by_size[0])
    if (between := largest.beside) is not None:
        if len(laws) > 1:
            between = replace(between, facts={**between.facts, "others": len(laws) - 1})
        return replace(largest, p_value=laws[0].p_value, beside=between)
    said = Remark(Said.SEVERAL_LAWS, {"count": len(laws)}) if len(laws) > 1 else None
    amplitudes = [e.parameters["amplitude"] for e in by_size if _of_scale(e) != of_scale]
    if amplitudes or of_scale:
        said = _acts_on(of_scale, amplitudes[:1], largest.parameters["amplitude"].unit)
    return replace(largest, p_value=laws[0].p_value, beside=said)


def _acts_on(of_scale: bool, too: Sequence[Estimate], unit: str) -> Remark:
    """Whether what else acts on the bias acts on the scale factor, and what it adds by the other of the two."""
    facts = {"of_scale": of_scale, "too": [(a.value, *a.interval_95) for a in too], "unit": unit}
    return Remark(Said.OF_SCALE, facts)


def _of_scale(effect: NamedEffect) -> bool:
    """Whether what else acts on the bias acts on the scale factor here."""
    return "of_scale" in effect.parameters and bool(effect.parameters["of_scale"].value)


def _effect(
    found: Examination,
    effect_id: str,
    parameters: Mapping[str, Estimate],
    p_value: float,
    rivals: Mapping[str, float],
    share: float = 1.0,
    adds: Estimate | None = None,
) -> NamedEffect:
    effect = CATALOGUE[effect_id]
    stated = by_data_set(found.series, parameters)
    others = [
        Alternative(e, float(np.exp(np.clip(nats, 0.0, 50.0))))
        for e, nats in sorted(rivals.items(), key=lambda item: item[1])
        if nats < ALIKE_NATS
    ]
    return NamedEffect(
        effect.id,
        effect.family,
        stated,
        p_value,
        tuple(others),
        None,
        effect.runtime,
        share,
        beside=between_sets(stated),
        adds=adds,
    )


def _law(found: Examination, named: Named) -> NamedEffect:
    own = found.model.of_block(named.block)
    known = estimates.of_law(found.naming.fitted.granting_noise, named.law, found.laws, own)
    share = min(named.share, 1.0) if own else 1.0
    # A drift of any course is a shape in a temperature that went one way.
    timewise = named.law.effect == TEMPERATURE_ORDER.id and went_one_way(found.series)
    rivals = {**named.rivals, BIAS_DRIFT.id: 0.0} if timewise else named.rivals
    slows_down = named.law.effect == BIAS_DRIFT.id and _slows_down(known.parameters)
    if slows_down and WARM_UP.why_not(found.laws.offer) is None:
        # Few gyros warm up by one exponential, and what slows down from power-on is as well a warm-up of another law.
        rivals = {**rivals, WARM_UP.id: 0.0}
    effect = _effect(found, named.law.effect, known.parameters, named.p_value, rivals, share, known.adds)
    if (too := known.on_scale) is None:
        return effect
    return replace(effect, beside=_acts_on(False, [too], too.unit))


def _slows_down(drift: Mapping[str, Estimate]) -> bool:
    """Whether a drift surely does: by a power below one, or by the logarithm of time."""
    return "knee_s" in drift or drift["power"].interval_95[1] < 1.0


def _pattern(found: Examination, pattern: Pattern) -> NamedEffect:
    parameters = estimates.of_pattern(pattern)
    least, _ = parameters["amplitude"].interval_95
    # The earth turns no faster, whatever the table's tilt.
    first, *twins = as_large(pattern.effect, least)
    return _effect(found, first, parameters, pattern.p_value, dict.fromkeys(twins, 0.0))


def _input_share(found: Examination) -> Estimate:
    """Where the surface lies between one of the output (0) and one of the input (1), by least squares beside everything else."""
    fitted = found.naming.fitted
    bend = fitted.model.bend_of(fitted.solve())
    column = beyond_input(fitted.model.basis, bend) @ bend
    of_input = fitted.refit(fitted.model.directed("input", bend)).granting_noise
    score, p = of_input.contrasts.precision(of_input.model.all, of_input.fit.log_variance)
    information = float(column @ p @ column)
    return Estimate.normal(1.0 - float(column @ score) / information, float(information**-0.5), "1")


def _of_a_sine(share: Estimate) -> float:
    """How much worse a sine of a small phase explains where the surface lies than a cubic of the input does, nats.

    Of the fifth order that a cubic of the output has, one of the input has nothing, and a sine with the same third order
    a tenth: ``K**4 / 120`` of ``3 (K**2 / 6)**2``.
    """
    cubic, sine = ((share.value - where) / share.std for where in (1.0, 1.0 - _SINE_FIFTH))
    return float(0.5 * (sine**2 - cubic**2))


@dataclass(frozen=True)
class _Searched:
    """What the search of a table put in: the lag of the coil, or a law of time.

    Attributes
    ----------
    nats : float
        How much worse the best model without it is; 0 of a law that only mends what others leave.
    law : Law or None
        None: the lag of the coil.
    rivals : mapping
        Each law of models without it that the best model lacks, to how much worse the best of these models is, nats.
    """

    effect: str
    nats: float
    law: Law | None
    rivals: dict[str, float]

    @property
    def p_value(self) -> float:
        """Probability that it gains as much by chance, beyond what laws pay there."""
        return by_chance(self.nats, 2 if self.law is None else 1)


def _searched(found: Examination) -> list[_Searched]:
    if not found.ranked:
        return []
    best = found.ranked[0]
    searched = []
    if best.coil is not None:
        nats = min(c.score for c in found.ranked if c.coil is None) - best.score
        searched.append(_Searched(THERMAL_LAG.id, nats, None, {}))
    for law in (law for law in best.fitted.model.laws if law.effect in best.effects):
        # No smooth part is like a step; a drift and what remembers have those that are.
        models = found.ranked
        if law.effect in STEPS:
            models = tuple(sorted([*models, *found.smooth], key=attrgetter("score")))
        without = [c for c in models if law.effect not in c.effects]
        ahead = next(c for c in models if law.effect in c.effects).score
        # The best model with each comes last and stays.
        rivals = {e: c.score - ahead for c in reversed(without) for e in c.effects - best.effects}
        nats = 0.0 if law.name in found.mending else without[0].score - ahead
        searched.append(_Searched(law.effect, nats, law, rivals))
    return searched


def _of_table(found: Examination, searched: _Searched) -> NamedEffect:
    """The coil's lag or a law of time of a table."""
    if searched.law is None:
        # Of models as near one side of a warm-up may have none.
        near = [(weight, c) for weight, c in averaged(found.ranked) if c.coil is not None]
        coils = near or [(1.0, found.ranked[0])]
        return _effect(found, searched.effect, lag_estimates(coils), searched.p_value, {})
    # The search goes from one shape of its grid to the next.
    fitted = found.ranked[0].fitted
    shaped = estimates.reshaped(fitted, found.laws)
    law = shaped.model.laws[fitted.model.laws.index(searched.law)]
    known = estimates.of_law(shaped.granting_noise, law, found.laws, [])
    parameters = posterior_of(averaged(found.ranked), law, known.parameters)
    return _effect(found, searched.effect, parameters, searched.p_value, searched.rivals, adds=known.adds)


def places_of_table(found: Examination) -> list[Located]:
    """Where the laws act that the search of a table named: no block of its model stands for them."""
    named = [s for s in _searched(found) if s.p_value <= NAMED_LEVEL]
    if not named:
        return []
    best = found.ranked[0]
    solution, model = best.fitted.solve(), best.fitted.model
    places = []
    for s in named:
        shape: Mapping[str, float] = {} if s.law is None else s.law.shape
        added_dps = (
            lagging(replace(model.basis, coil=best.coil)) @ model.legendre(solution)
            if s.law is None
            else s.law.columns @ solution.amplitudes[s.law.name]
        )
        places.append(place_of(CATALOGUE[s.effect], shape, added_dps, found.series, s.p_value))
    return places


def open_laws(found: Examination, level: float) -> tuple[UnnamedPart, ...]:
    """Laws that the search of a table put in, but that models nearly as good do without: they are modelled, and have no name."""
    if not found.ranked:
        return ()
    fitted = found.ranked[0].fitted
    parts = []
    for s in _searched(found):
        if s.law is None or s.p_value <= NAMED_LEVEL:
            continue
        nats = fitted.refit(fitted.model.without_laws([s.law.name])).nll - fitted.nll
        if block_p_value(nats, len(BLOCKS)) > level:
            continue
        adds = estimates.of_law(fitted.granting_noise, s.law, found.laws, []).adds
        effect = CATALOGUE[s.effect]
        taken = effect.runtime and not lacks_clock(found.series, s.effect)
        taken &= s.effect != WARM_UP.id or found.comes_again > 0.5
        near = {s.effect: 0.0, **{e: max(left, 0.0) for e, left in s.rivals.items()}}
        where = coordinate_here(effect.seen_in, found.series)
        parts.append(UnnamedPart(where, effect.family, nats, 1e-3 * adds.value, None, None, "", near, taken))
    return tuple(parts)


def layers_of(found: Examination, level: float) -> list[Step]:
    """Steps of the staircase, the strongest first: laws, the lag of a coil, blocks without a name, errors of each rate.

    What the answer does not tell of, since it may be chance at the rate `level`, is none.
    """
    model = found.naming.fitted.model
    searched = {s.effect: s for s in sorted(_searched(found), key=lambda s: s.nats)}
    steps = [_step_of_table(found, s) for s in searched.values()]
    if found.of_the_input:
        bend = model.bend_of(found.naming.fitted.solve())
        less = partial(plain, direction="output", bend=bend)
        of = SAGNAC_SINE if found.of_a_sine else FIT_DIRECTION
        steps.append(Step(of.id, found.naming.input_gain, less))
    for effect in dict.fromkeys(n.law.effect for n in found.naming.named):
        own = [n for n in found.naming.named if n.law.effect == effect and model.holds(n.law)]
        if own:
            less = partial(Model.without_laws, names=[n.law.name for n in own])
            beside = tuple(model.of_block(*{law.block for law in own}))
            steps.append(Step(effect, max(n.gain for n in own), less, beside))
    for block, nats in found.naming.unnamed.items():
        names = model.of_block(block)
        if block == ODD and found.of_a_sine and found.of_the_input:
            # What is left of the sine goes with it.
            continue
        owners = [n.law.effect for n in found.naming.named if n.block == block and not model.holds(n.law)]
        titles = {EACH_RATE: REFERENCE_RATE_ERROR.id, **({ODD: SAGNAC_SINE.id} if found.of_a_sine else {})}
        title = owners[0] if owners else titles.get(block, block)
        told = owners or block_p_value(nats, len(BLOCKS)) <= level
        if names and told and (BLOCKS[block].stays or block == EACH_RATE):
            steps.append(Step(title, nats, partial(Model.without, names=names)))
    return sorted(steps, key=lambda step: -step.nats)


def _step_of_table(found: Examination, searched: _Searched) -> Step:
    best = found.ranked[0]
    if searched.law is not None:
        # The model at the end has the law at another shape than the search, under another name.
        names = [law.name for law in found.model.laws if law.effect == searched.effect]
        return Step(searched.effect, searched.nats, partial(Model.without_laws, names=names))
    moved = -lagging(replace(best.fitted.model.basis, coil=best.coil))
    return Step(searched.effect, searched.nats, partial(Model.with_surface_moved, moved=moved))
