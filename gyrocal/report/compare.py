"""What `gyrocal compare` says of its changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gyrocal.calibration.compare import ALARM_RATE, Change
from gyrocal.calibration.figure import value_said
from gyrocal.calibration.summary import said
from gyrocal.units import p_equals


def changes_sentence(changes: Sequence[Change]) -> str:
    """The answer in one sentence."""
    changed = [c.figures[0].title for c in changes if c.changed]
    if not changed:
        return f"Nothing changed from the first run to the last by more than noise (at {ALARM_RATE:.0%} false alarms)."
    return f"Changed from the first run to the last by more than noise: {', '.join(changed)}."


def change_rows(
    changes: Sequence[Change], names: Sequence[str]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows: a figure a row, a run a column, how they differ where they are three or more, then the change."""
    several = len(names) > 2
    rows = [
        (
            f"{c.figures[0].title}, {c.figures[0].unit}",
            *(said(f) for f in c.figures),
            *([said(c.repeatability)] if several else []),
            _change(c),
            "changed" if c.changed else "",
        )
        for c in changes
    ]
    return ("figure", *names, *(["run to run (sd)"] if several else []), "last less first", ""), rows


def blank_sentences(changes: Sequence[Change], names: Sequence[str]) -> list[str]:
    """Why figures have no number, a sentence a reason."""
    by_reason: dict[str, list[str]] = {}
    for c in changes:
        for name, figure in zip(names, c.figures, strict=True):
            if figure.value is None:
                by_reason.setdefault(f"{name}: {figure.reason}", []).append(figure.title)
    return [f"{', '.join(titles)} of {reason}" for reason, titles in by_reason.items()]


def _change(change: Change) -> str:
    if change.change is None or change.low is None or change.high is None:
        return "-"
    said_change = value_said(change.change, change.low, change.high)
    return f"{said_change} {p_equals(change.p_value)}" if change.changed else said_change


def to_json(changes: Sequence[Change], names: Sequence[str]) -> dict[str, Any]:
    """``gyrocal-comparison/1``."""
    return {
        "schema": "gyrocal-comparison/1",
        "runs": list(names),
        "figures": {
            c.figures[0].name: {
                "runs": [f.to_json() for f in c.figures],
                "repeatability": c.repeatability.to_json(),
                "change": c.change,
                "interval_95": None if c.change is None else [c.low, c.high],
                "p_value": c.p_value,
                "changed": c.changed,
            }
            for c in changes
        },
    }
