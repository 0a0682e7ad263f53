"""The page of a diagnosis: what was found in plain sentences, the pictures that show it, the numbers."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from gyrocal.diagnosis.result import Diagnosis, Improvement, Located, NamedEffect, Rows
from gyrocal.physics.catalogue import described
from gyrocal.report.diagnosis_figures import (
    effect_figure,
    has_surface,
    recorded_and_simulated,
    residual_maps,
    residual_over_angle,
    residual_over_time,
    turning,
)
from gyrocal.report.diagnosis_layers import (
    STAIRCASE_CAPTION,
    layer_rows,
    nameless,
    not_a_step,
    staircase_figure,
)
from gyrocal.report.drive_words import drive_tables
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.report.reasons import reason_words
from gyrocal.report.remarks import remark_words, statement
from gyrocal.report.sentences import (
    counted,
    data_sentences,
    in_the_noise,
    likelier,
    logloss_gain,
    plain_sentences,
    scale_of,
    traded_sentence,
    verdict_sentence,
)
from gyrocal.report.words import (
    fixed,
    interval_text,
    listed,
    range_text,
    region_words,
    value_text,
)
from gyrocal.units import decimals, p_text

#: Fewer rows than this on a turning table are no picture of a turn.
_LEAST_TURNING = 100
#: Levels of noise below this, in whatever unit they are read, are nothing.
_LEAST_LEVEL = 1e-4
_NATS = "A nat is a unit of evidence, the natural logarithm of odds: 2.3 nats are 10 to 1, 4.6 nats 100 to 1."


def figures(
    diagnosis: Diagnosis, first: tuple[Picture, Figure] | None = None
) -> list[tuple[Picture, Figure | None]]:
    """Every picture of the page with its caption; a picture that the record cannot carry says why.

    Parameters
    ----------
    first : in place of the recording against its surface, where it was compared with another simulation
    """
    rows = diagnosis.rows
    if rows is None:
        return []
    found: list[tuple[Picture, Figure | None]] = [
        first or _drawn("recorded_simulated", recorded_and_simulated(diagnosis, rows))
    ]
    if has_surface(rows):
        found.append(_drawn("map", residual_maps(diagnosis, rows)))
    else:
        found.append(_missing("map", "The recording has one rate only, so there is no surface to map."))
    found.append(_drawn("time", residual_over_time(diagnosis, rows)))
    if int(turning(rows).sum()) >= _LEAST_TURNING:
        found.append(_drawn("angle", residual_over_angle(diagnosis, rows)))
    else:
        why = reason_words(diagnosis.not_testable.get("table_angle", "The table did not turn long enough."))
        found.append(_missing("angle", why[0].upper() + why[1:].rstrip(".") + "."))
    found += [_effect_picture(diagnosis, rows, effect) for effect in diagnosis.effects]
    if diagnosis.layers:
        picture, figure = _drawn("staircase", staircase_figure(diagnosis))
        caption = f"{picture.caption} {not_a_step(diagnosis)}".rstrip()
        found.append((replace(picture, caption=caption), figure))
    return found


_TITLES: Mapping[str, tuple[str, str]] = {
    "staircase": ("Layer by layer, on data that the fit did not see", STAIRCASE_CAPTION),
    "recorded_simulated": (
        "Recorded against simulated",
        "Above: error of the gyro as recorded and as the surface alone simulates it over the recorded sequence. "
        "Middle: the difference, which is what is examined. Below: gyro temperature.",
    ),
    "map": (
        "Residual over rate and temperature",
        "Mean residual of the data sets in each cell; the colour scale is the same in all panels. What lives in "
        "ramps, within a turn or after a step hardly shows here: see the pictures of the effects.",
    ),
    "time": (
        "Residual over time",
        "The vertical scale is the same in all panels. Patterns without a name are not taken out.",
    ),
    "angle": (
        "Residual over table angle",
        "Means over one turn with 95 % intervals of the white noise; each data set's own mean is taken out. "
        "Before and after are drawn beside each other.",
    ),
}


def _drawn(name: str, figure: Figure) -> tuple[Picture, Figure]:
    title, caption = _TITLES[name]
    return Picture(name, title, caption), figure


def _missing(name: str, why: str) -> tuple[Picture, None]:
    title, caption = _TITLES[name]
    return Picture(name, title, caption, missing=why), None


def _effect_picture(diagnosis: Diagnosis, rows: Rows, effect: NamedEffect) -> tuple[Picture, Figure | None]:
    figure = effect_figure(diagnosis, effect)
    caption = (
        f"{statement(effect)} Means over its own coordinate with all other named physics taken out: left the residual "
        "and the effect's law, less what the error surface follows of it; right what is left, with whatever has no name. 95 % intervals from the scatter "
        "between data sets, of all bins together where a bin has fewer than three."
    )
    title = f"{effect.effect}, before and after"
    missing = "The record has no coordinate on which this effect can be shown."
    if effect.effect not in rows.effect_dps:
        missing = "The means drawn here do not show it: it was found in single samples or data sets, or is in the surface itself."
    return Picture(f"effect_{effect.effect}", title, caption, missing="" if figure else missing), figure


def diagnosis_page(
    diagnosis: Diagnosis,
    pictures: Sequence[Picture],
    provenance: Mapping[str, str],
    more: Sequence[Table] = (),
    verdict: str = "",
    told: Sequence[str] = (),
) -> str:
    """HTML of the diagnosis, self-contained.

    Parameters
    ----------
    more : tables that stand first
    verdict : what stands above all, where it is not the diagnosis's own
    told : what a comparison with a simulation says, before the diagnosis's own
    """
    verdict = verdict or verdict_sentence(diagnosis)
    # The verdict stands above them, and what the data lack at the end.
    data = data_sentences(diagnosis, told)
    elsewhere = {verdict, *data}
    remarks = [s for s in dict.fromkeys([*told, *plain_sentences(diagnosis)]) if s not in elsewhere]
    page = Page(
        title=f"Diagnosis of {diagnosis.recording}",
        verdict=verdict,
        key_figures=_key_figures(diagnosis),
        remarks=remarks,
        pictures=pictures,
        tables=[*more, *tables(diagnosis)],
        quality=data,
        provenance=provenance,
        beside="Every figure stands beside this page as PNG, and every number in diagnosis.json.",
    )
    return render_page(page)


def _key_figures(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    found = [
        ("Verdict", diagnosis.verdict.replace("_", " ")),
        ("Named", ", ".join(e.effect for e in diagnosis.effects) or "nothing"),
    ]
    best = diagnosis.improvement
    if best is not None and diagnosis.effects:
        before, after, floor = _rms_cells(best)
        found += [
            ("Held-out rms", f"{before} to {after}"),
            ("Noise floor", floor),
            (f"A {counted(diagnosis).each} left out is", likelier(best)),
        ]
    if diagnosis.noise is not None:
        noise = diagnosis.noise
        if noise.angle_random_walk_deg_per_rt_h is not None:
            found.append(("Angle random walk", f"{noise.angle_random_walk_deg_per_rt_h:.3f} °/√h"))
        if noise.bias_instability_deg_per_h > _LEAST_LEVEL:
            found.append(("Bias instability", f"{noise.bias_instability_deg_per_h:.2f} °/h"))
    return found


def _rms_cells(i: Improvement) -> tuple[str, str, str]:
    scale, unit = scale_of(i)
    places = decimals(scale * i.noise_floor_dps) + 1
    values = (i.heldout_rms_before_dps, i.heldout_rms_after_dps, i.noise_floor_dps)
    before, after, floor = (fixed(scale * v, places) for v in values)
    return before, f"{after} {unit}", f"{floor} {unit}"


def tables(diagnosis: Diagnosis) -> list[Table]:
    """Where the excess lives, what was named, what it gained, the noise, and what this record cannot show."""
    return [
        *drive_tables(diagnosis),
        _table(
            "located",
            "Where the excess lives",
            ("Coordinate", "of", "Region", "p", "Share of the excess", "With the model found"),
            [_located(diagnosis, p) for p in diagnosis.located],
            "What lives on one coordinate is seen on others, so that the shares overlap, and those of a mean and of a variance are of "
            "two excesses. A curve without a name is in the model and no law; what is still there is in none.",
        ),
        _table(
            "effects",
            "Named physics",
            ("Effect", "Parameter", "Value", "95 % interval", "p"),
            _parameters(diagnosis),
            " ".join(filter(None, map(traded_sentence, diagnosis.effects))),
        ),
        _table(
            "laws",
            "Their laws",
            ("Effect", "Law", "Where it is written", "Easily taken for"),
            [
                (law.id, law.equation, law.reference, ", ".join(law.looks_like) or "-")
                for law in map(described, dict.fromkeys(e.effect for e in diagnosis.effects))
            ],
        ),
        _table(
            "alternatives",
            "What else it could be",
            ("Named", "Alternative", "Evidence for the name"),
            [
                (e.effect, a.effect, f"{a.evidence_ratio:.3g} : 1")
                for e in diagnosis.effects
                for a in e.alternatives
            ],
        ),
        _table(
            "layers",
            "Layer by layer, on data that the fit did not see",
            ("Layer", "Error left out, rms", "Noise alone"),
            layer_rows(diagnosis),
            f"Each row has all layers above it. {not_a_step(diagnosis)}".rstrip(),
        ),
        _improvement_table(diagnosis),
        _table("noise", "Noise of the recording", ("Noise", "Level"), _noise_rows(diagnosis)),
    ]


def _located(diagnosis: Diagnosis, place: Located) -> tuple[str, ...]:
    with_model = "explained" if diagnosis.effects else "taken up"
    left = "a curve without a name" if place.curve else "still there"
    return (
        place.coordinate,
        place.statistic,
        f"see {place.finding}" if place.finding else region_words(place),
        p_text(place.p_value),
        f"{place.share:.0%}" if math.isfinite(place.share) else "-",
        left if place.remains else with_model,
    )


def _noise_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Levels that this record tells."""
    noise = diagnosis.noise
    if noise is None:
        return []
    found = [
        ("white noise of a row, typically", noise.white_std_dps * 1e3, "mdeg/s"),
        ("angle random walk", noise.angle_random_walk_deg_per_rt_h, "deg/√h"),
        ("bias instability", noise.bias_instability_deg_per_h, "deg/h"),
        ("rate random walk", noise.rate_random_walk_deg_per_h_per_rt_h, "deg/h/√h"),
    ]
    if diagnosis.rows is None or np.ptp(diagnosis.rows.rate_dps) > 0:
        found.append(("scatter of the table's rate from set to set", noise.rate_jitter_ppm, "ppm of rate"))
    return [
        (name, f"{value:.3g} {unit}" if value > _LEAST_LEVEL else "none seen")
        for name, value, unit in found
        if value is not None and math.isfinite(value)
    ]


def _table(
    name: str, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], note: str = ""
) -> Table:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return Table(name, title, columns, rows, text.getvalue(), note if rows else "")


def _parameters(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    return [
        (
            f"{effect.effect} ({effect.family})",
            name,
            value_text(e),
            interval_text(e),
            p_text(effect.p_value),
        )
        for effect in diagnosis.effects
        for name, e in effect.parameters.items()
    ]


def _improvement_table(diagnosis: Diagnosis) -> Table:
    """Per effect beside all others; all of them together only where that says more."""
    measured = {e.effect: e.improvement for e in diagnosis.effects if e.improvement is not None}
    bare = "nominal model" if diagnosis.counted_in else "surface"
    bare = bare if diagnosis.drive is None else "robot file"
    rows = []
    for name, i in measured.items():
        others = [other for other in measured if other != name]
        rows.append((name, listed([bare, *others]), *_improvement_cells(i)))
    if diagnosis.improvement is not None and len(measured) > 1:
        whole = "all that was found" if nameless(diagnosis) else "all named physics"
        rows.append((whole, bare, *_improvement_cells(diagnosis.improvement)))
    columns = (
        "Added",
        "to",
        "Held-out rms before",
        "after",
        "drop, 95 % interval",
        "Noise floor",
        "Excess removed",
        f"Log-loss gain, nats a {counted(diagnosis).each}",
        "95 % interval",
    )
    gained = diagnosis.improvement
    note = "" if gained is None else f"Left out: {remark_words(gained.scheme)}. {_NATS}"
    return _table("improvement", "On data that the fit did not see", columns, rows, note)


def _improvement_cells(i: Improvement) -> tuple[str, ...]:
    scale, unit = scale_of(i)
    before, after, floor = _rms_cells(i)
    low, high = i.interval_95
    gain, interval = logloss_gain(i)
    removed = "within the noise" if in_the_noise(i) else f"{i.excess_removed:.0%}"
    return (
        f"{before} {unit}",
        after,
        f"{range_text(low, high, scale)} {unit}",
        floor,
        removed,
        gain,
        interval,
    )
