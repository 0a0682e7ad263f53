"""The page of a diagnosis: what was found in plain sentences, the pictures that show it, the numbers."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from gyrocal.diagnosis.result import Diagnosis, Estimate, Improvement, NamedEffect, Rows
from gyrocal.report import style
from gyrocal.report.diagnosis_figures import (
    effect_figure,
    has_surface,
    recorded_and_simulated,
    residual_maps,
    residual_over_angle,
    residual_over_time,
    turning,
)
from gyrocal.report.page import Page, Picture, Table, render_page

#: Fewer rows than this on a turning table are no picture of a turn.
_LEAST_TURNING = 100

VERDICT_SENTENCES = {
    "consistent": "The recording agrees with the simulation: nothing stands out of the noise.",
    "explained": "The recording departs from the simulation, and the physics named below explains it.",
    "partly_explained": "The recording departs from the simulation; the physics named below explains a part, and structure remains.",
    "unexplained": "The recording departs from the simulation, and no effect of the catalogue explains it.",
}


def figures(diagnosis: Diagnosis) -> list[tuple[Picture, Figure | None]]:
    """Every picture of the page with its caption; a picture that the record cannot carry says why."""
    rows = diagnosis.rows
    if rows is None:
        return []
    found: list[tuple[Picture, Figure | None]] = [
        _drawn("recorded_simulated", recorded_and_simulated(diagnosis, rows))
    ]
    if has_surface(rows):
        found.append(_drawn("map", residual_maps(diagnosis, rows)))
    else:
        found.append(_missing("map", "The recording has one rate only, so there is no surface to map."))
    found.append(_drawn("time", residual_over_time(diagnosis, rows)))
    if int(turning(rows).sum()) >= _LEAST_TURNING:
        found.append(_drawn("angle", residual_over_angle(diagnosis, rows)))
    else:
        why = diagnosis.not_testable.get("table_angle", "The table did not turn long enough.")
        found.append(_missing("angle", why[0].upper() + why[1:].rstrip(".") + "."))
    return found + [_effect_picture(rows, effect) for effect in diagnosis.effects]


_TITLES: Mapping[str, tuple[str, str]] = {
    "recorded_simulated": (
        "Recorded against simulated",
        "Above: error of the gyro as recorded and as the surface alone simulates it over the recorded sequence. "
        "Middle: the difference, which is what is examined. Below: gyro temperature.",
    ),
    "map": (
        "Residual over rate and temperature",
        "Mean residual of the data sets in each cell; the colour scale is the same in all panels.",
    ),
    "time": ("Residual over time", "Minute means; the vertical scale is the same in all panels."),
    "angle": (
        "Residual over table angle",
        "Means over one turn with 95 % intervals of the white noise; each data set's own mean is taken out.",
    ),
}


def _drawn(name: str, figure: Figure) -> tuple[Picture, Figure]:
    title, caption = _TITLES[name]
    return Picture(name, title, caption), figure


def _missing(name: str, why: str) -> tuple[Picture, None]:
    title, caption = _TITLES[name]
    return Picture(name, title, caption, missing=why), None


def _effect_picture(rows: Rows, effect: NamedEffect) -> tuple[Picture, Figure | None]:
    figure = effect_figure(rows, effect)
    caption = (
        f"{effect.statement} Folded on its own coordinate with all other named physics taken out: left the residual "
        "and the effect's law, right what is left. 95 % intervals from the scatter between data sets."
    )
    title = f"{effect.effect}, before and after"
    missing = "" if figure else "The record has no coordinate on which this effect can be folded."
    return Picture(f"effect_{effect.effect}", title, caption, missing=missing), figure


def render_pictures(diagnosis: Diagnosis) -> list[Picture]:
    """Pictures of the page with their PNG."""
    return [
        Picture(p.name, p.title, p.caption, style.render(figure, "png") if figure else None, p.missing)
        for p, figure in figures(diagnosis)
    ]


def diagnosis_page(diagnosis: Diagnosis, pictures: Sequence[Picture], provenance: Mapping[str, str]) -> str:
    """HTML of the diagnosis, self-contained."""
    remarks = plain_sentences(diagnosis)
    page = Page(
        title=f"Diagnosis of {diagnosis.recording}",
        verdict=VERDICT_SENTENCES[diagnosis.verdict],
        key_figures=_key_figures(diagnosis),
        remarks=remarks,
        pictures=pictures,
        tables=tables(diagnosis),
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
    if best is not None:
        found += [
            ("Held-out rms before", _mdps(best.heldout_rms_before_dps)),
            ("Held-out rms after", _mdps(best.heldout_rms_after_dps)),
            ("Noise floor", _mdps(best.noise_floor_dps)),
        ]
    if diagnosis.noise is not None:
        noise = diagnosis.noise
        if noise.angle_random_walk_deg_per_rt_h is not None:
            found.append(("Angle random walk", f"{noise.angle_random_walk_deg_per_rt_h:.3f} °/√h"))
        found.append(("Bias instability", f"{noise.bias_instability_deg_per_h:.2f} °/h"))
    return found


def _mdps(value_dps: float) -> str:
    return f"{value_dps * 1e3:.3g} mdeg/s"


def tables(diagnosis: Diagnosis) -> list[Table]:
    """Where the excess lives, what was named, what it gained, and what this record cannot show."""
    return [
        _table(
            "located",
            "Where the excess lives",
            ("Coordinate", "of", "Region", "p", "Share of the excess", "Still there after"),
            [
                (
                    p.coordinate,
                    p.statistic,
                    p.region,
                    format_p(p.p_value),
                    f"{p.share:.0%}" if math.isfinite(p.share) else "-",
                    "yes" if p.remains else "no",
                )
                for p in diagnosis.located
            ],
        ),
        _table(
            "effects",
            "Named physics",
            ("Effect", "Parameter", "Value", "95 % interval", "p"),
            _parameters(diagnosis),
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
            "improvement", "On data that the fit did not see", _IMPROVEMENT_COLUMNS, _improvements(diagnosis)
        ),
        _table(
            "not_testable",
            "Not testable with this record",
            ("Effect or coordinate", "because"),
            list(diagnosis.not_testable.items()),
        ),
    ]


def _table(name: str, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return Table(name, title, columns, rows, text.getvalue())


def _parameters(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    return [
        (
            f"{effect.effect} ({effect.family})",
            name,
            value_text(e),
            interval_text(e),
            format_p(effect.p_value),
        )
        for effect in diagnosis.effects
        for name, e in effect.parameters.items()
    ]


def value_text(e: Estimate) -> str:
    """A parameter with its unit."""
    return f"{e.value:.4g}" + (f" {e.unit}" if e.unit != "1" else "")


def interval_text(e: Estimate) -> str:
    """A parameter's 95 % interval."""
    low, high = e.interval_95
    return f"{low:.4g} to {high:.4g}" if low < high else "chosen, not estimated"


def format_p(p: float) -> str:
    """A p-value as people read it."""
    return "< 1e-15" if p < 1e-15 else f"{p:.2g}"


_IMPROVEMENT_COLUMNS = (
    "Model",
    "Held-out rms before, mdeg/s",
    "after",
    "drop, 95 % interval",
    "Noise floor",
    "Excess removed",
    "Log-loss a data set before, nats",
    "after",
)


def _improvements(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    rows = [(e.effect, e.improvement) for e in diagnosis.effects if e.improvement is not None]
    if diagnosis.improvement is not None:
        rows.append(("all named physics", diagnosis.improvement))
    return [(name, *_improvement_cells(i)) for name, i in rows if i is not None]


def _improvement_cells(i: Improvement) -> tuple[str, ...]:
    low, high = (x * 1e3 for x in i.interval_95)
    return (
        f"{i.heldout_rms_before_dps * 1e3:.3f}",
        f"{i.heldout_rms_after_dps * 1e3:.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{i.noise_floor_dps * 1e3:.3f}",
        f"{i.excess_removed:.0%}",
        f"{i.logloss_before:.2f}",
        f"{i.logloss_after:.2f}",
    )


def not_testable_sentences(diagnosis: Diagnosis) -> list[str]:
    """What this record cannot show, by reason."""
    by_reason: dict[str, list[str]] = {}
    for what, why in diagnosis.not_testable.items():
        by_reason.setdefault(why.rstrip("."), []).append(what)
    return [
        f"Not testable with this record: {', '.join(things)}, because {why}."
        for why, things in by_reason.items()
    ]


def plain_sentences(diagnosis: Diagnosis) -> list[str]:
    """What there is to say, in order, each thing once."""
    said = [s for s in diagnosis.sentences if not s.startswith("Not testable")]
    said += [n[0].upper() + n[1:] for n in diagnosis.notes if not any(n.rstrip(".") in s for s in said)]
    said = [s.rstrip(".") + "." for s in said]
    return [*dict.fromkeys(said), *not_testable_sentences(diagnosis)]
