"""`gyrocal diagnose --simulation`: what to add to somebody's own simulation, in words, as JSON and as Python."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.fit import rms
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.versus.answer import Comparison, Versus, counts_from_s
from gyrocal.diagnosis.versus.law_file import python_file
from gyrocal.diagnosis.versus.match import Clock, Match
from gyrocal.diagnosis.versus.surfaces import Apart
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.effect import Effect
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.terms import Term
from gyrocal.report.words import estimate_text, fixed, listed, parameter_words, range_text
from gyrocal.units import MDPS, NORMAL_95, S_PER_H, decimals, plural

Floats = NDArray[np.float64]

LAW_JSON, LAW_PYTHON = "law.json", "law.py"

_MOST_RATES = 6
#: From so many terms on it is said why there are as many.
_SEVERAL = 6
#: Temperatures that differ by less are one, degC.
_ONE_C = 1.0


def law_files(found: Versus) -> dict[str, bytes | str]:
    """``law.json`` where the two differ; ``law.py`` where the law brings the simulation nearer on sets left out."""
    if found.diagnosis.verdict == "consistent" and not found.helps:
        return {}
    files: dict[str, bytes | str] = {
        LAW_JSON: json.dumps(found.to_json(), indent=1, sort_keys=True, allow_nan=False) + "\n"
    }
    if found.helps:
        title = f"What {found.simulation} lacks against {found.recording}."
        adds = found.terms_dps
        rms_dps = [rms(x) for x in adds]
        head = "Terms beside the surface, the largest first, with what they add and 95 % intervals:"
        formula = "\n".join([head, *_formula(found, adds), "", *_mean_of_models(found), *_valid(found)])
        files[LAW_PYTHON] = python_file(
            found.law, found.match.surface, title, formula, counts_from_s(found.match.difference), rms_dps
        )
    return files


def told(found: Versus) -> tuple[str, ...]:
    """The answer in sentences: what the law brings, partners, clocks."""
    sentences = ["The data sets are too few to leave some out; whether the law helps is not known."]
    if found.comparison is not None:
        sentences = [_gain(found.comparison)]
    sentences += [*_named_elsewhere(found), *surface_sentences(found.surfaces_apart), *_partners(found.match)]
    if found.match.clock is not None:
        sentences.append(_clock(found.match.clock))
    return tuple(sentences)


def _named_elsewhere(found: Versus) -> list[str]:
    """Laws that are named and that the function has not: parts without a name stand for them."""
    held = {term.name for term in found.law.terms}
    lacking = [e.effect for e in found.diagnosis.effects if e.effect not in held and e.runtime]
    if not (lacking and found.helps):
        return []
    return [
        f"The law has no {listed(lacking)} by name: it is the mean of models that are about as likely, in which curves without a "
        "name stand for that. Add the function, not the figures of the names."
    ]


def surface_sentences(apart: Apart) -> list[str]:
    """How far bias and scale factor are apart in the middle of the temperatures, and how that goes over them, where it is sure."""
    low_c, middle_c, high_c = apart.temp_c.tolist()
    quantities = [("bias", "deg/h", S_PER_H, apart.bias_dps, apart.bias_std_dps)]
    if apart.scale_ppm is not None and apart.scale_std_ppm is not None:
        quantities.append(("scale factor", "ppm", 1.0, apart.scale_ppm, apart.scale_std_ppm))
    said = []
    for what, unit, factor, value, std in quantities:
        if not np.any(np.abs(value) > NORMAL_95 * std):
            continue
        at = [_plus_minus(factor * x, factor * s) for x, s in zip(value, std, strict=True)]
        ends = "" if high_c - low_c < _ONE_C else f" ({at[0]} at {low_c:.3g} °C, {at[2]} at {high_c:.3g} °C)"
        said.append(f"{what} {at[1]} {unit}{ends}")
    if not said:
        return []
    return [f"Recording less simulation at {middle_c:.3g} °C: {listed(said)} (± one standard deviation)."]


def _partners(m: Match) -> list[str]:
    by = "rate, temperature and order" if m.in_order else "rate and temperature; their orders differ"
    if m.clock is not None:
        by = "rate, temperature, order and time"
    sentences = [
        f"{m.matched_sets} of {m.sets} data sets have a partner in the simulation, matched by {by}; its temperature "
        f"differs by {m.temp_apart_c:.2g} °C rms{_from_course(m)}."
    ]
    if m.bridged_sets:
        sentences.append(
            f"{m.bridged_sets} more have none, but nothing is seen in the simulation beside its error surface: they are compared "
            "with that."
        )
    if m.lonely_temp_c:
        sentences.append(
            f"{m.sets - m.matched_sets - m.bridged_sets} have none, at {_rates(m.lonely_rates_dps)} deg/s and {range_text(*m.lonely_temp_c)} °C: there the "
            "simulation does not overlap, and nothing is said."
        )
    return sentences


def _from_course(m: Match) -> str:
    """That it is a smooth course that temperatures are compared with, and not what the recording says, where it is."""
    smoothed = any(isinstance(n, Remark) and n.said is Said.SMOOTHED for n in m.difference.notes)
    return " from the smooth course of the recording's" if smoothed else ""


def _rates(rates_dps: Sequence[float]) -> str:
    """The first of some rates, and how many there are more."""
    rates = [f"{rate:g}" for rate in rates_dps[:_MOST_RATES]]
    more = len(rates_dps) - len(rates)
    return f"{', '.join(rates)} and {more} more" if more else listed(rates)


def _clock(clock: Clock) -> str:
    offset, drift = clock.offset_s, clock.drift_ppm
    return (
        f"The simulation's clock is {_plus_minus(offset, clock.offset_std_s)} s ahead of the recording's and gains "
        f"{_plus_minus(drift, clock.drift_std_ppm)} ppm on it; that leaves {clock.left_s:.2g} s rms of the starts."
    )


def _plus_minus(value: float, std: float) -> str:
    places = min(max(decimals(2.0 * std), 0), 3) if std > 0 else 3
    known = fixed(std, places)
    return f"{fixed(value, places)} ± {known if float(known) else f'less than {fixed(0.1**places, places)}'}"


def _gain(c: Comparison) -> str:
    before, after = c.before_dps / MDPS, c.after_dps / MDPS
    low, high = (x / MDPS for x in c.interval_95)
    what = (
        f"Left out, {c.sets} data sets differ from the simulation by {before:.3g} mdeg/s rms, and from the simulation with "
        f"the law by {after:.3g}; on another run of the same plan the gain is {range_text(low, high)} (95 %)."
    )
    for count, where in (
        (c.beyond, "beyond the rates, the temperatures or the times of the others"),
        (c.beside_jumps, "beside a jump"),
    ):
        if count:
            what += f" {count} more {plural(count, f'[lies|lie] {where} and [is|are] not judged')}."
    if c.helps:
        return f"{what} Add the law: {LAW_PYTHON}, {LAW_JSON}."
    if c.worse_at_dps:
        return f"{what} But at {_rates(c.worse_at_dps)} deg/s it takes the simulation farther off, so no {LAW_PYTHON} is written."
    return f"{what} That is no sure gain, so no {LAW_PYTHON} is written."


def _valid(found: Versus) -> list[str]:
    d = found.match.difference
    lines = [
        f"Known from {d.rate_dps.min():.4g} to {d.rate_dps.max():.4g} deg/s and from {d.temp_c.min():.4g} to "
        f"{d.temp_c.max():.4g} degC."
    ]
    began_s = counts_from_s(d)
    if began_s is not None:
        t_s = d.t_s - began_s
        lines.append(
            f"since_power_on_s, where a law needs it, counts from t_s = {began_s:.12g} s: t_s is on the recording's clock, whose data sets "
            f"began {t_s.min():.0f} to {t_s.max():.0f} s after that."
        )
    return lines


def _formula(found: Versus, adds_dps: Sequence[Floats]) -> list[str]:
    """A line for each law or smooth part, with all its terms."""
    estimates = {effect.effect: effect.parameters for effect in found.diagnosis.effects}
    lines: dict[str, str] = {}
    held: dict[str, float] = {}
    sums: dict[str, Floats] = {}
    for term, adds in zip(found.law.terms, adds_dps, strict=True):
        if isinstance(term, SmoothTerm):
            key = term.label
            lines[key] = f"- {term.family}, no name: {term.label}, {len(term.columns)} columns"
        else:
            effect = find_effect(term.effect)
            key, known = effect.id, estimates.get(effect.id, {})
            values = [f"{parameter_words(name)} {estimate_text(e)}" for name, e in known.items()]
            held[key] = held.get(key, 0.0) + float(term.parameters["amplitude"]["value"])
            rest = _held_elsewhere(held[key], known.get("amplitude"))
            lines[key] = (
                f"- {effect.id}: {_equation(effect, found.law.terms)}; {listed(values) or 'not named'}{rest}"
            )
        sums[key] = sums.get(key, 0.0) + adds
    largest = sorted(lines, key=lambda key: -rms(sums[key]))
    said = [f"{lines[key]}; {rms(sums[key]) / MDPS:.2g} mdeg/s rms" for key in largest]
    return said or ["- none: the surfaces differ, and nothing else"]


def _equation(effect: Effect, terms: Sequence[Term | SmoothTerm]) -> str:
    """Its equation, without what is of the scale factor where none of its terms acts on that."""
    own = [t for t in terms if isinstance(t, Term) and t.effect == effect.id]
    if any(float(t.parameters.get("of_scale", {"value": 0.0})["value"]) for t in own):
        return effect.equation
    return effect.equation.partition("; of the scale factor")[0]


def _held_elsewhere(held: float, amplitude: Estimate | None) -> str:
    """That parts without a name have most of what a law is estimated at, where they do."""
    if amplitude is None or amplitude.interval_95[0] <= held <= amplitude.interval_95[1]:
        return ""
    return f", of which {held:.3g} {amplitude.unit} stand here and the rest in parts without a name"


def _mean_of_models(found: Versus) -> list[str]:
    """Why there are so many terms, and which there are not."""
    lines = []
    if (count := len(found.law.terms)) >= _SEVERAL:
        lines.append(
            f"The law is a mean over all models that explain the recording about as well, and has the terms of each, {count} in all."
        )
    if (unseen := found.unseen) is not None:
        what = "[term that models have which are|terms that models have which are] about as likely [is|are] not in it"
        lines.append(
            f"{unseen.count} {plural(unseen.count, what)}: together {unseen.rms_dps / MDPS:.2g} mdeg/s rms, which the data do not show "
            f"and the uncertainty of the surface in {LAW_JSON} has."
        )
    return [*lines, ""] if lines else []
