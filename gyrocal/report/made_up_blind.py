"""A blind trial on made-up recordings on paper: commitments, opened answers, names and shares."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import gyrocal
from gyrocal.records.files import write_atomically
from gyrocal.report.page import Page, Table, render_page
from gyrocal.trial.blind import BlindConfig
from gyrocal.trial.opened import Opened
from gyrocal.trial.tally import Tally, tally
from gyrocal.units import plural

_ABOUT = (
    "The recordings are made by code that shares no formula with the finder. The second run is of the same gyro on "
    "another plan, without noise; what is removable there is what a least-squares fit removes that knows the laws and "
    "the noise.",
    "Each answer was sealed by its sha256 before the recording was diagnosed, and opened after.",
)


@dataclass(frozen=True)
class MadeUpResult:
    """What came of it, and where it is."""

    tally: Tally
    trials: tuple[Opened, ...]
    out: Path


def write_opened(config: BlindConfig, trials: Sequence[Opened], out: Path) -> MadeUpResult:
    """blind.json and blind.html in `out`, of opened trials of a kind."""
    counted = tally(trials)
    document = {
        "schema": "gyrocal-blind-made-up/1",
        "kind": config.kind,
        "seed": config.seed,
        "false_alarm_rate": config.false_alarm_rate,
        "software": f"gyrocal {gyrocal.__version__}",
        "summary": counted.to_json(),
        "trials": [t.to_json() for t in trials],
    }
    write_atomically(
        out / "blind.json", json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
    )
    write_atomically(out / "blind.html", _page(config, counted, trials))
    return MadeUpResult(counted, tuple(trials), out)


def _page(config: BlindConfig, counted: Tally, trials: Sequence[Opened]) -> str:
    right, wrong = counted.shares[0], counted.shares[3]
    page = Page(
        title=f"Blind trial: {len(trials)} made-up {plural(len(trials), '[recording|recordings]')} of the kind {config.kind}",
        verdict=(
            f"Of {right.trials} hidden layers of d' 12 and more {right.hits} were named; of {wrong.trials} names "
            f"{wrong.hits} were wrong; of the removable error on the second run was removed: {counted.removed_text}."
        ),
        key_figures=[(s.name, s.cells()[2]) for s in (*counted.shares, *counted.by_strength)],
        remarks=list(_ABOUT),
        pictures=[],
        tables=[_trial_table(trials)],
        provenance={
            "kind": config.kind,
            "seed": str(config.seed),
            "software": f"gyrocal {gyrocal.__version__}",
        },
        beside="Every number, the opened answers and their seals stand beside this page in blind.json.",
    )
    return render_page(page)


def _trial_table(trials: Sequence[Opened]) -> Table:
    rows = [
        (
            str(t.number),
            t.commitment[:12],
            f"{t.answer.gyro}, {t.answer.plan}, {t.answer.oddity}",
            ", ".join(f"{a.law} (d' {a.d_prime:.3g})" for a in t.answer.layers) or "nothing",
            ", ".join("/".join(c) for c in t.classes) or "nothing",
            t.verdict,
            " ".join(_deg_per_h(e) for e in (t.before_dps, t.after_dps, t.oracle_dps)),
            "" if t.share is None else f"{t.share:.2f}",
        )
        for t in trials
    ]
    columns = (
        "Trial",
        "Seal",
        "Gyro, plan, oddity",
        "Hidden",
        "Named (with alternatives)",
        "Verdict",
        "Second run: surface, improved, oracle, deg/h",
        "Share removed",
    )
    return Table("trials", "Trials", columns, rows, "")


def _deg_per_h(error_dps: float | None) -> str:
    return "-" if error_dps is None else f"{3600 * error_dps:.3g}"
