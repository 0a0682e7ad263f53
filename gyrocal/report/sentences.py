"""The answer in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal.diagnosis.remarks import Note
from gyrocal.diagnosis.result import Alternative, Diagnosis, Estimate, Improvement, Located, NamedEffect
from gyrocal.physics.catalogue import described
from gyrocal.report.diagnosis_layers import NOT_IN_MEANS, nameless, staircase_sentence, unnamed_sentences
from gyrocal.report.folds import Fold, fold_of
from gyrocal.report.reasons import reason_words
from gyrocal.report.remarks import of_the_data, remark_words, statement
from gyrocal.report.words import (
    coordinate_words,
    estimate_text,
    fixed,
    listed,
    parameter_words,
    part_words,
    place_words,
    range_text,
    region_words,
    times_text,
)
from gyrocal.units import decimals, p_equals

#: An amplitude that is so much less known than what the effect adds is traded for a shape.
_TRADED = 4.0
#: Larger errors than this are read in deg/s.
_LARGE_DPS = 0.3
_FEWEST_UNITS = 8
_MOST_PLACES = 4
#: A smaller share is told as less than this.
_LEAST_PART = 0.01

_MORE = "Beyond the error surface something stands out of the noise"
_VERDICTS = {
    "consistent": "Beyond the error surface nothing stands out of the noise.",
    "explained": f"{_MORE}, and the physics named below explains it.",
    "partly_explained": f"{_MORE}; the physics named below explains a part of it.",
    "unexplained": f"{_MORE}, and no physics of the catalogue is sure to be behind it.",
}


@dataclass(frozen=True)
class Counted:
    """What errors are means of, in words: ``data set``, ``data-set means``."""

    each: str
    means: str


def counted(d: Diagnosis) -> Counted:
    """What is left out, and what its errors are means of: data sets, segments of a run, steps of a log,
    seconds of a drive."""
    rows = d.rows
    if d.drive is not None:
        return Counted("second", "means over a second")
    if d.counted_in:
        return Counted(d.counted_in, "bins")
    if rows is None:
        return Counted("data set", "data-set means")
    pieces = np.unique(rows.set_index).size
    if pieces == rows.t_s.size and np.ptp(rows.rate_dps) == 0:
        step = f"{np.median(np.diff(rows.t_s)):.2g} s"
        return Counted(f"step of {step}", f"{step} means") if has_times(d) else Counted("row", "rows")
    if pieces < _FEWEST_UNITS:
        return Counted("stretch of time", "means over stretches of time")
    return Counted("data set", "data-set means") if rows.is_set.all() else Counted("segment", "segment means")


def has_times(d: Diagnosis) -> bool:
    """Whether the recording says when its rows were."""
    return "time" not in d.not_testable


def verdict_sentence(d: Diagnosis) -> str:
    """The verdict; of a drive it is the first thing that was said of it."""
    return d.sentences[0] if d.sentences else _VERDICTS[d.verdict]


def plain_sentences(d: Diagnosis) -> list[str]:
    """What there is to say, in order, each thing once: what was found, what to measure next, what the data lack."""
    said = [*(d.sentences or _sentences(d)), *(_begun(n) for n in d.notes if not of_the_data(n))]
    if d.next_experiment is not None:
        said.append(d.next_experiment["statement"])
    return _once([*said, *data_sentences(d)])


def short_sentences(d: Diagnosis) -> list[str]:
    """The answer without its details, which the page has: verdict, places, names with their sizes, what is gained and left."""
    said = list(d.sentences)
    if not said:
        named = [s for e in d.effects for s in _named(e)]
        said = [_VERDICTS[d.verdict], *_places(d), *named, *_whole_gain(d), *unnamed_sentences(d), *_left(d)]
    said += [_begun(n) for n in d.notes if not of_the_data(n)]
    if d.next_experiment is not None:
        said.append(d.next_experiment["statement"])
    return _once(said)


def short_data_sentences(d: Diagnosis, told: Collection[str] = ()) -> list[str]:
    """`data_sentences` with all that cannot be tested in one, without the reasons."""
    notes = [_begun(n) for n in d.notes if of_the_data(n) and n not in told]
    untested = [f"Not testable with this record (why: see the page): {', '.join(d.not_testable)}"]
    return _once([*notes, *(untested if d.not_testable else [])])


def data_sentences(d: Diagnosis, told: Collection[str] = ()) -> list[str]:
    """What the data lack and what they cannot show, each thing once.

    Parameters
    ----------
    told : notes that are an answer and stand elsewhere
    """
    notes = [_begun(n) for n in d.notes if of_the_data(n) and n not in told]
    return _once([*notes, *not_testable_sentences(d)])


def _once(said: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(s.rstrip(".") + "." for s in said))


def _begun(note: Note) -> str:
    words = remark_words(note)
    # A file has the name that it has.
    return words if "." in words.split()[0].rstrip(".") else words[0].upper() + words[1:]


def document(d: Diagnosis) -> dict[str, Any]:
    """What `diagnose` writes: the answer, and the same in words."""
    found = d.to_json()
    for entry, place in zip(found["located"], d.located, strict=True):
        entry["region"] = region_words(place)
    for entry, effect in zip(found["effects"], d.effects, strict=True):
        law = described(effect.effect)
        entry |= {"equation": law.equation, "reference": law.reference, "statement": statement(effect)}
        _say_left_out(entry["improvement"], effect.improvement)
    _say_left_out(found["improvement"], d.improvement)
    if d.drive is not None:
        errors = [e | {"part": part_words(e["log"], e["from_share"])} for e in d.drive["position_error"]]
        found["drive"] = {**d.drive, "position_error": errors}
    found["not_testable"] = {what: reason_words(why) for what, why in d.not_testable.items()}
    return found | {"notes": [remark_words(note) for note in d.notes], "statements": plain_sentences(d)}


def _say_left_out(entry: dict[str, Any] | None, gained: Improvement | None) -> None:
    if entry is not None and gained is not None:
        entry["left_out"] = remark_words(gained.scheme)


def _sentences(d: Diagnosis) -> list[str]:
    """Does the recording agree with the simulation; where not; which physics; how sure; what is gained."""
    said = [_VERDICTS[d.verdict], *_places(d)]
    for effect in d.effects:
        said += [*_named(effect), *_shown(effect, d)]
    said += [*unnamed_sentences(d), *filter(None, [staircase_sentence(d)])]
    if nameless(d) or sum(e.improvement is not None for e in d.effects) > 1:
        said += _whole_gain(d)
    return said + _left(d)


def _whole_gain(d: Diagnosis) -> list[str]:
    """What all that was found gains together."""
    measured = [e for e in d.effects if e.improvement is not None]
    if len(measured) == 1 and not nameless(d):
        return [_own_gain(measured[0], d)]
    if d.improvement is None or not measured:
        return []
    whole = "All that was found, also without a name" if nameless(d) else "All named physics together"
    return [f"{whole}, against the surface alone: " + _gain(d.improvement, counted(d))]


def _own_gain(effect: NamedEffect, d: Diagnosis) -> str:
    """What one effect gains beside the others; of none that was not measured."""
    if effect.improvement is None:
        return ""
    others = [e.effect for e in d.effects if e is not effect and e.improvement is not None]
    beside = f", beside {listed(others)}" if others else ""
    transient = effect.family in NOT_IN_MEANS
    return f"{effect.effect}{beside}: " + _gain(effect.improvement, counted(d), transient)


def not_testable_sentences(d: Diagnosis) -> list[str]:
    """What this record cannot show, by reason."""
    by_reason: dict[str, list[str]] = {}
    for what, why in d.not_testable.items():
        by_reason.setdefault(reason_words(why).rstrip("."), []).append(what)
    return [
        f"Not testable with this record: {', '.join(things)}, because {why}."
        for why, things in by_reason.items()
    ]


def _places(d: Diagnosis) -> list[str]:
    """Where it departs, the strongest first: the place of the mean in full with what only mirrors it, and of the scatter."""
    places = [p for p in d.located if not p.finding]
    if not places:
        return []
    scatter = [
        f"The scatter stands out most in {_where(d, p)}." for p in places if p.statistic == "variance"
    ][:1]
    means = [p for p in places if p.statistic == "mean"]
    if places[0].statistic == "variance":
        return scatter + _places_of_mean(d, means)
    return _places_of_mean(d, means) + scatter


def _places_of_mean(d: Diagnosis, means: list[Located]) -> list[str]:
    if not means:
        return []
    first, others = means[0], means[1:]
    if d.verdict == "consistent":
        return [f"It comes nearest to that in {_where(d, first)}: too little to name or to correct."]
    mirrored = dict.fromkeys(_coordinate(d, p) for p in others if p.coordinate != first.coordinate)
    also = f"; it is also seen in {listed(list(mirrored))}" if mirrored else ""
    return [f"The mean departs most in {_where(d, first)}{also}."]


def _left(d: Diagnosis) -> list[str]:
    """What is left with names and curves in the model: the one account of it."""
    if d.verdict == "consistent":
        return []
    left = [p for p in d.located if p.remains and not p.curve and not p.finding]
    curved = dict.fromkeys(_coordinate(d, p) for p in d.located if p.curve)
    curved |= dict.fromkeys(coordinate_words(part.coordinate) for part in d.unnamed)
    curves = [f"a curve without a name over {listed(list(curved))}"] if curved else []
    model = listed([e.effect for e in d.effects] + curves) or "the surface fitted here"
    if not left:
        return [f"With {model} in the model nothing is left beyond the noise."]
    places = [
        f"{'scatter in ' if p.statistic == 'variance' else ''}{place_words(p, _coordinate(d, p))}"
        for p in left[:_MOST_PLACES]
    ]
    return [f"With {model} in the model there is left: {'; '.join(places)}."]


def _coordinate(d: Diagnosis, place: Located) -> str:
    # A table without samples shows nothing since a step, but it shows what earlier data sets did to later ones.
    if place.coordinate == "time_since_step" and place.coordinate in d.not_testable:
        return "the rates measured before"
    return coordinate_words(place.coordinate)


def _where(d: Diagnosis, place: Located) -> str:
    return f"{place_words(place, _coordinate(d, place))}, {p_equals(place.p_value)}"


def _named(effect: NamedEffect) -> list[str]:
    """What an effect is, how large, and what else it could be."""
    in_name_only = _in_name_only(effect)
    known = {} if in_name_only else effect.parameters
    values = [f"{parameter_words(n)} {estimate_text(e)}" for n, e in known.items() if e.std > 0]
    sure = "; ".join([*(v for v in [", ".join(values)] if v), p_equals(effect.p_value)])
    said = [f"{effect.effect}: {statement(effect)} {sure[0].upper() + sure[1:]}."]
    if effect.share < 1.0:
        untold = ", too little to tell its size" if in_name_only else ""
        said.append(
            f"{effect.effect} only resembles it: the law takes {_part(effect.share)} of the evidence for this {effect.family}{untold}, "
            "and a curve without a name follows the rest."
        )
    if effect.alternatives:
        rivals = "; ".join(_other(a) for a in effect.alternatives)
        said.append(f"The same data could be {rivals}.")
    return said


def _in_name_only(effect: NamedEffect) -> bool:
    """Whether a law that only resembles what is there takes so little of it that its size says nothing."""
    amplitude = effect.parameters.get("amplitude")
    holds_zero = amplitude is not None and amplitude.interval_95[0] <= 0.0 <= amplitude.interval_95[1]
    return effect.share < _LEAST_PART or (effect.share < 1.0 and holds_zero)


def _shown(effect: NamedEffect, d: Diagnosis) -> list[str]:
    """What is known of an effect all the same, what it gains, and how it stands out."""
    said = [s for s in (traded_sentence(effect), _own_gain(effect, d)) if s]
    folded = fold_of(d, effect)
    if folded is not None:
        said.append(f"{effect.effect}: " + _folded(folded))
    return said


def _part(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= _LEAST_PART else f"less than {100.0 * _LEAST_PART:.0f} %"


def _other(a: Alternative) -> str:
    odds = "equally well" if a.evidence_ratio < 1.05 else f"{a.evidence_ratio:.2g} to 1 against it"
    return f"{a.effect} ({odds})"


def traded_sentence(effect: NamedEffect) -> str:
    """For an amplitude that the record cannot separate from a shape: what is well known all the same."""
    amplitude, adds = effect.parameters.get("amplitude"), effect.adds
    shapes = [n for n, e in effect.parameters.items() if n != "amplitude" and e.std > 0]
    if amplitude is None or amplitude.at_bound or adds is None or not shapes:
        return ""
    if _relative(amplitude) < _TRADED * _relative(adds):
        return ""
    return (
        f"{effect.effect}: this record cannot separate amplitude and {listed([parameter_words(n) for n in shapes])}, and each "
        f"interval allows for the other; known is what the effect adds beyond the surface, {estimate_text(adds)} rms."
    )


def _relative(e: Estimate) -> float:
    """Length of an interval in units of the value."""
    low, high = e.interval_95
    return (high - low) / abs(e.value) if e.value else math.inf


def _gain(i: Improvement, c: Counted, transient: bool = False) -> str:
    """What is gained on data left out: the error first, or first what shows an effect that errors of means hide."""
    parts = [_logloss(i, c), _rms(i, c)] if transient or in_the_noise(i) else [_rms(i, c), _logloss(i, c)]
    return f"on data left out {'; '.join(parts)}."


def in_the_noise(i: Improvement) -> bool:
    """Whether the error was within the noise before anything was named, so that it can show no gain."""
    return not math.isfinite(i.excess_removed) or i.heldout_rms_before_dps <= i.noise_floor_dps


def scale_of(i: Improvement) -> tuple[float, str]:
    """Factor and unit in which errors of this size are read."""
    return (1.0, "deg/s") if i.heldout_rms_before_dps > _LARGE_DPS else (1e3, "mdeg/s")


def logloss_gain(i: Improvement) -> tuple[str, str]:
    """Drop of the held-out log-loss and its 95 % interval, nats."""
    low, high = i.logloss_interval_95
    return fixed(i.logloss_before - i.logloss_after, decimals(0.5 * (high - low))), range_text(low, high)


def _sureness(low: float, high: float) -> str:
    """What is to be said of a gain by its interval; nothing of a sure one."""
    return "" if low > 0 else ", no sure gain" if high >= 0 else ", surely no gain"


def likelier(i: Improvement) -> str:
    """How many times as probable the model makes what was left out, with its 95 % interval: the drop of the log-loss."""
    low, high = (times_text(nats) for nats in i.logloss_interval_95)
    times = times_text(i.logloss_before - i.logloss_after)
    interval = f" (95 %: {low} to {high}{_sureness(*i.logloss_interval_95)})" if times != low else ""
    return f"{times} times as probable{interval}"


def _logloss(i: Improvement, c: Counted) -> str:
    return f"a {c.each} becomes {likelier(i)}"


def _folded(folded: Fold) -> str:
    before, after, noise = folded.rms()
    places = decimals(noise)
    label = folded.coordinate.label.rsplit(",", 1)[0]
    label = label[0].lower() + label[1:] if label[1:2].islower() else label
    here = f"{fixed(before, places)} to {fixed(after, places)} {folded.coordinate.unit}"
    if after < before:
        return f"over {label} (its picture) the rms of the residual falls from {here}."
    return f"over {label} (its picture) it cannot be seen by itself, for other layers live there too: the rms goes from {here}."


def _rms(i: Improvement, c: Counted) -> str:
    scale, unit = scale_of(i)
    low, high = i.interval_95
    # Two or three digits of the noise, as the drop is known.
    least = decimals(scale * i.noise_floor_dps)
    places = min(max(decimals(0.5 * scale * (high - low)), least), least + 1)
    before, after, floor = (
        fixed(scale * x, places)
        for x in (i.heldout_rms_before_dps, i.heldout_rms_after_dps, i.noise_floor_dps)
    )
    if in_the_noise(i):
        return (
            f"the rms of {c.means} ({before} before, {after} after) is within the noise of such a mean "
            f"({floor} {unit}): see the pictures"
        )
    drop = range_text(low, high, scale)
    sure = _sureness(low, high)
    reached = i.heldout_rms_after_dps <= i.noise_floor_dps
    moves = "falls" if i.heldout_rms_after_dps < i.heldout_rms_before_dps else "rises"
    noise = f"which is the noise ({floor})" if reached else f"where noise alone would leave {floor}"
    return (
        f"the rms of {c.means} {moves} from {before} to {after} {unit} (drop {drop} at 95 %{sure}), {noise}"
    )
