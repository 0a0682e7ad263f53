"""A blind trial on paper: commitments, opened answers, confusion matrix and naming by strength."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import gyrocal
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.records.files import write_atomically
from gyrocal.report import style
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.trial.blind import BlindConfig, Trial
from gyrocal.trial.summary import NOTHING, BlindSummary, summarise
from gyrocal.units import plural

_CAVEAT = (
    "The virtual bench and the finder share the formulas of the effects: this proves less than recordings made by "
    "other code."
)


@dataclass(frozen=True)
class BlindResult:
    """What came of it, and where it is."""

    summary: BlindSummary
    trials: tuple[Trial, ...]
    out: Path


def write_trials(config: BlindConfig, trials: Sequence[Trial], out: Path) -> BlindResult:
    """blind.json, blind.html and its pictures in `out`, of opened trials."""
    summary = summarise(trials)
    drawn = {"confusion": confusion_matrix(summary), "strength": naming_by_strength(summary)}
    figures = {name: style.render(figure, "png") for name, figure in drawn.items()}
    document: dict[str, Any] = {
        "schema": "gyrocal-blind/1",
        "seed": config.seed,
        "profile": config.profile,
        "false_alarm_rate": config.false_alarm_rate,
        "software": f"gyrocal {gyrocal.__version__}",
        "summary": summary.to_json(),
        "trials": [t.to_json() for t in trials],
    }
    (out / "figures").mkdir()
    for name, png in figures.items():
        write_atomically(out / "figures" / f"{name}.png", png)
    write_atomically(
        out / "blind.json", json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
    )
    write_atomically(out / "blind.html", _page(config, summary, trials, figures))
    return BlindResult(summary, tuple(trials), out)


def _order(names: Sequence[str]) -> list[str]:
    """By family, as the catalogue has them; nothing last."""
    known = list(CATALOGUE)
    return sorted(names, key=lambda n: known.index(n) if n in known else len(known))


@style.styled
def confusion_matrix(summary: BlindSummary) -> Figure:
    """Hidden effect against the first name, with counts."""
    rows = _order(list(summary.confusion)) or [NOTHING]
    columns = _order(sorted({c for counts in summary.confusion.values() for c in counts} | set(rows)))
    table = np.array([[summary.confusion.get(r, {}).get(c, 0) for c in columns] for r in rows], dtype=float)
    figure = style.new_figure(style.TWO_COLUMNS_IN, 1.6 + 0.2 * len(rows))
    axes = figure.subplots()
    axes.imshow(
        np.where(table > 0, table, np.nan),
        cmap="Blues",
        vmin=0,
        vmax=max(table.max(), 1) * 1.6,
        aspect="auto",
    )
    for i, j in zip(*np.nonzero(table), strict=True):
        right = rows[i] == columns[j]
        axes.text(
            j,
            i,
            f"{table[i, j]:.0f}",
            ha="center",
            va="center",
            fontweight="bold" if right else "normal",
            fontsize=7,
        )
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(visible=False)
    axes.grid(visible=True, which="minor")
    axes.tick_params(which="minor", length=0)
    axes.set_xlabel("First name")
    axes.set_ylabel("Hidden")
    return figure


@style.styled
def naming_by_strength(summary: BlindSummary) -> Figure:
    """Share of single effects that were named, by strength, with 95 % Wilson intervals."""
    figure = style.new_figure(style.ONE_COLUMN_IN, 2.6)
    axes = figure.subplots()
    looks = ((style.BLUE, "o"), (style.GREEN, "s"), (style.ORANGE, "D"))
    for k, (colour, marker) in enumerate(looks):
        points = [(d, shares[k]) for d, shares in summary.by_strength if shares[k].trials]
        if not points:
            continue
        x = np.array([d for d, _ in points]) * (1.0 + 0.04 * (k - 1))
        y = np.array([s.hits / s.trials for _, s in points])
        interval = np.array([s.interval_95 for _, s in points])
        axes.errorbar(
            x,
            y,
            yerr=[y - interval[:, 0], interval[:, 1] - y],
            color=colour,
            marker=marker,
            label=points[0][1].name,
            elinewidth=0.8,
        )
    axes.set_xscale("log")
    axes.set_xticks([6, 8, 12, 20, 40, 100], ["6", "8", "12", "20", "40", "100"])
    axes.minorticks_off()
    axes.set_ylim(-0.02, 1.05)
    axes.set_xlabel("Strength of the hidden effect, d'")
    axes.set_ylabel("Share of trials")
    if summary.by_strength:
        axes.legend(loc="lower right")
    return figure


def _page(
    config: BlindConfig, summary: BlindSummary, trials: Sequence[Trial], figures: dict[str, bytes]
) -> str:
    wrong = next(s for s in summary.shares if s.name.startswith("nothing"))
    found = next(s for s in summary.shares if s.name == "one hidden: right name first")
    key = [(s.name, s.cells()[2]) for s in summary.shares]
    if summary.gain_shares:
        key.append(("gain, share of an oracle's", f"{np.median(summary.gain_shares):.2f} (median)"))
    pictures = [
        Picture(
            "confusion",
            "Confusion matrix",
            "What was hidden against the first name that was given; nothing and single effects.",
            figures["confusion"],
        ),
        Picture(
            "strength",
            "Naming by strength",
            "Single effects, with 95 % Wilson intervals.",
            figures["strength"],
        ),
    ]
    page = Page(
        title=f"Blind trial: {config.trials} {plural(config.trials, '[run|runs]')} of {config.profile}",
        verdict=f"Of {found.trials} single hidden {plural(found.trials, '[effect|effects]')} {found.hits} {plural(found.hits, '[was|were]')} named first; of {wrong.trials} {plural(wrong.trials, '[run|runs]')} with nothing hidden {wrong.hits} {plural(wrong.hits, '[was|were]')} given a name.",
        key_figures=key,
        remarks=[
            _CAVEAT,
            "Each answer was sealed by its sha256 before the run was diagnosed, and opened after.",
        ],
        pictures=pictures,
        tables=[_trial_table(trials), _coverage_table(summary)],
        provenance={
            "profile": config.profile,
            "seed": str(config.seed),
            "software": f"gyrocal {gyrocal.__version__}",
        },
        beside="Every number, the opened answers and their seals stand beside this page in blind.json.",
    )
    return render_page(page)


def _trial_table(trials: Sequence[Trial]) -> Table:
    rows = []
    for t in trials:
        hidden = ", ".join(
            e + (f" (d' {t.secret.d_primes[e]:g})" if e in t.secret.d_primes else "") for e in t.truth
        )
        rows.append(
            (
                str(t.number),
                t.commitment[:12],
                hidden or "nothing",
                ", ".join("/".join(c) for c in t.classes) or "nothing",
                t.verdict,
            )
        )
    columns = ("Trial", "Seal", "Hidden", "Named (with alternatives)", "Verdict")
    return Table("trials", "Trials", columns, rows, "")


def _coverage_table(summary: BlindSummary) -> Table:
    columns = ("Parameter", "Intervals that cover", "Share, 95 % interval")
    return Table(
        "coverage", "Coverage of the 95 % intervals", columns, [s.cells() for s in summary.coverage], ""
    )
