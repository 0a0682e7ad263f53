"""What `acquire` prints of a plan and of a run."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import emit_json, emit_table

if TYPE_CHECKING:
    from gyrocal.bench.plan import Plan
    from gyrocal.bench.profile import Profile
    from gyrocal.bench.watching import Summary

_MIN_S = 60.0


def duration(seconds: float) -> str:
    """Seconds as people say them."""
    if seconds < _MIN_S:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / _MIN_S), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def show_plan(profile: Profile, plan: Plan, as_json: bool) -> None:
    """Steps, limits and duration."""
    if as_json:
        emit_json({"profile": profile.source, "profile_sha256": profile.sha256, **plan.to_json()})
        return
    rows = [[str(s.id), s.describe(), duration(s.expected_s), duration(s.latest_s)] for s in plan.steps]
    emit_table(["step", "what", "expected", "at the latest"], rows, profile.title)
    limits = [
        [name, f"{bound['value']:g}", bound["whose"]]
        for name, bound in plan.to_json()["limits"].items()
        if bound
    ]
    click.echo()
    emit_table(["limit", "value", "whose"], limits, "The narrowest limits")
    ccw, cw = plan.turns
    kinds = ", ".join(f"{plan.count(kind)} {kind}" for kind in ("rate", "static", "ramp", "soak"))
    click.echo(
        f"\n{len(plan.steps)} steps ({kinds}): {duration(plan.expected_s)} expected, {duration(plan.latest_s)} at the "
        f"latest.\nTurns of the table: {ccw:.1f} counter-clockwise, {cw:.1f} clockwise, at most {plan.winding_turns:.1f} "
        "from where it began. Nothing has moved."
    )
    for note in profile.notes(datetime.now(UTC).date()):
        click.echo(f"Note: {note}.")


def brought_back(count: int) -> str:
    """How many segments were recorded beside the plan, as a sentence that follows others; empty where there are none."""
    return (
        f" {count} more beside the plan, in which the bench was brought back to a temperature."
        if count
        else ""
    )


def show_summary(out: Path, s: Summary) -> None:
    """What was recorded, and what was not."""
    from gyrocal.units import plural

    click.echo(
        f"{out}: {s.recorded} {plural(s.recorded, '[segment|segments]')} recorded, {len(s.unsettled)} unsettled, {len(s.failed)} failed, "
        f"{len(s.skipped)} skipped"
        + (f" ({s.before} of them before this start)." if s.before else ".")
        + brought_back(s.brought_back)
    )
    click.echo(
        f"{'Of this start: bench' if s.before else 'Bench'} time {duration(s.bench_time_s)}, {s.samples} gyro rows; the table made {s.turns_ccw:.1f} turns "
        f"counter-clockwise and {s.turns_cw:.1f} clockwise, and stands."
        + ("" if s.seed is None else f" Seed of the virtual bench: {s.seed}.")
    )
    for title, steps in (
        ("unsettled", s.unsettled),
        ("failed", s.failed),
        ("skipped", s.skipped),
        ("done again", s.retried),
    ):
        for text in steps:
            click.echo(f"  {title}: {text}")
