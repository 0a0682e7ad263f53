"""``gyrocal acquire``: run a profile on the bench and record every data set."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.acquired import duration, show_plan, show_summary
from gyrocal.cli.console import Report, emit_json, json_option, progress
from gyrocal.cli.streams import to_whoever_listens
from gyrocal.errors import IncompleteError

if TYPE_CHECKING:
    from gyrocal.bench.watching import Progress


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
@click.option("--serial", help="Serial number of the gyro on the table.")
@click.option("--operator", help="Who measures.")
@click.option(
    "--bench-file",
    type=click.Path(path_type=Path),
    help="TOML with [bench] and [identity]: certificates of table and thermometer, and when they are due.",
)
@json_option
def command(
    profile: str,
    out: Path | None,
    simulate: bool,
    seed: int | None,
    resume: bool,
    dry_run: bool,
    raw: bool,
    serial: str | None,
    operator: str | None,
    bench_file: Path | None,
    as_json: bool,
) -> None:
    """Run PROFILE, a .toml file or the name of a shipped profile (quick, rd2100, ...), on the bench.

    Ctrl-C once ends the run after the data set at hand, twice at once; the table is stopped and the
    chamber goes to its safe set point either way, and --resume carries on. Ctrl-Z does nothing, and
    under nohup the run outlives its terminal.

    Example: gyrocal acquire quick --simulate --seed 7 --out run
    """
    from gyrocal.bench import session
    from gyrocal.units import plural

    if out is None and not dry_run:
        raise click.UsageError("Missing option '--out'.")
    config = session.AcquireConfig(
        profile, out or Path(), simulate, seed, resume, raw, _ask, serial, operator, bench_file
    )
    if dry_run:
        show_plan(*session.dry_run(config), as_json)
        return
    with progress("acquire", quiet=as_json, still=True) as report:
        summary = session.acquire(config, _Watch(report))
    with to_whoever_listens():
        if as_json:
            emit_json({"run": str(out), "complete": summary.complete, **asdict(summary)})
        else:
            show_summary(out or Path(), summary)
    if not summary.complete:
        lost = summary.failed + summary.skipped
        failed, skipped = len(summary.failed), len(summary.skipped)
        msg = (
            f"{out}: {failed} {plural(failed, '[segment|segments]')} failed and {skipped} {plural(skipped, '[was|were]')} skipped, the first of them "
            f"{lost[0]}; the bench is safe. Look into the journal for why, and use --resume for what was skipped."
        )
        raise IncompleteError(msg)


def _ask(question: str) -> str:
    try:
        click.echo(f"\n{question.rstrip()}", err=True)
        return input()
    except UnicodeError:
        return ""
    except (
        OSError,
        RuntimeError,
    ) as error:  # a terminal that is gone, or was closed before the program began
        raise EOFError(str(error)) from error


class _Watch:
    """Progress bar for the steps, stderr for what the operator should know."""

    def __init__(self, report: Report) -> None:
        self._report = report

    def progress(self, progress: Progress) -> None:
        """One line: step, chamber, bench time left."""
        chamber = f", chamber {progress.chamber_c:.1f} °C" if progress.chamber_c == progress.chamber_c else ""
        left = duration(progress.left_s)
        self._report(progress.share, f"{progress.step.describe()}{chamber}, {left} of bench time left")

    def say(self, text: str) -> None:
        """Pass it on."""
        click.echo(text, err=True)
