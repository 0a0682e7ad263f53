"""``gyrocal acquire``: run a profile on the bench and record every data set."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import Report, emit_json, emit_table, json_option, progress
from gyrocal.errors import IncompleteError

if TYPE_CHECKING:
    from gyrocal.bench.plan import Plan
    from gyrocal.bench.profile import Profile
    from gyrocal.bench.runner import Progress, Summary

_H_S = 3600.0
_MIN_S = 60.0


@click.command("acquire")
@click.argument("profile")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Run directory to write; it must not hold files yet."
)
@click.option("--simulate", is_flag=True, help="Use the virtual bench, whatever devices the profile names.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the virtual bench's noise.")
@click.option(
    "--resume", is_flag=True, help="Carry on the run in --out; sealed segments are not recorded again."
)
@click.option(
    "--dry-run", is_flag=True, help="Show steps, turns, duration and limits; nothing moves or is written."
)
@click.option("--raw", is_flag=True, help="Also keep every port's bytes with their times, in RUN/raw.")
@json_option
def command(
    profile: str,
    out: Path | None,
    simulate: bool,
    seed: int | None,
    resume: bool,
    dry_run: bool,
    raw: bool,
    as_json: bool,
) -> None:
    """Run PROFILE, a .toml file or the name of a shipped profile (quick, rd2100, ...), on the bench.

    Ctrl-C once ends the run after the data set at hand, twice at once; the table is stopped and the
    chamber goes to its safe set point either way, and --resume carries on.

    Example: gyrocal acquire quick --simulate --seed 7 --out run
    """
    from gyrocal.bench import session

    if out is None and not dry_run:
        raise click.UsageError("Missing option '--out'.")
    config = session.AcquireConfig(profile, out or Path(), simulate, seed, resume, raw, _ask)
    if dry_run:
        _show_plan(*session.dry_run(config), as_json)
        return
    with progress("acquire", quiet=as_json, still=True) as report:
        summary = session.acquire(config, _Watch(report))
    if as_json:
        emit_json({"run": str(out), "complete": summary.complete, **asdict(summary)})
    else:
        _show_summary(out or Path(), summary)
    if not summary.complete:
        lost = summary.failed + summary.skipped
        msg = (
            f"{out}: {len(summary.failed)} segments failed and {len(summary.skipped)} were skipped, the first of them "
            f"{lost[0]}; the bench is safe. Look into the journal for why, and use --resume for what was skipped."
        )
        raise IncompleteError(msg)


def _ask(question: str) -> str:
    click.echo(f"\n{question.rstrip()}", err=True)
    return input()


class _Watch:
    """Progress bar for the steps, stderr for what the operator should know."""

    def __init__(self, report: Report) -> None:
        self._report = report

    def progress(self, progress: Progress) -> None:
        """One line: step, chamber, bench time left."""
        chamber = f", chamber {progress.chamber_c:.1f} °C" if progress.chamber_c == progress.chamber_c else ""
        left = _duration(progress.left_s)
        self._report(progress.share, f"{progress.step.describe()}{chamber}, {left} of bench time left")

    def say(self, text: str) -> None:
        """Pass it on."""
        click.echo(text, err=True)


def _duration(seconds: float) -> str:
    if seconds < _MIN_S:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / _MIN_S), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def _show_plan(profile: Profile, plan: Plan, as_json: bool) -> None:
    if as_json:
        emit_json({"profile": profile.source, "profile_sha256": profile.sha256, **plan.to_json()})
        return
    rows = [[str(s.id), s.describe(), _duration(s.expected_s), _duration(s.latest_s)] for s in plan.steps]
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
        f"\n{len(plan.steps)} steps ({kinds}): {_duration(plan.expected_s)} expected, {_duration(plan.latest_s)} at the "
        f"latest.\nTurns of the table: {ccw:.1f} counter-clockwise, {cw:.1f} clockwise, at most {plan.winding_turns:.1f} "
        "from where it began. Nothing has moved."
    )
    for note in profile.notes:
        click.echo(f"Note: {note}.")


def _show_summary(out: Path, s: Summary) -> None:
    click.echo(
        f"{out}: {s.recorded} segments recorded, {len(s.unsettled)} unsettled, {len(s.failed)} failed, "
        f"{len(s.skipped)} skipped" + (f" ({s.before} of them before this start)." if s.before else ".")
    )
    click.echo(
        f"Bench time {_duration(s.bench_time_s)}, {s.samples} gyro rows; the table made {s.turns_ccw:.1f} turns "
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
