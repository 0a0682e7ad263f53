"""``gyrocal status``: where a run is, from another terminal or after a crash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gyrocal.cli.acquired import brought_back
from gyrocal.cli.console import emit_json, emit_table, json_option

_SEEN = {
    "running": "is running",
    "complete": "is complete",
    "incomplete": "has ended, and some segments failed or were skipped; --resume carries on",
    "stopped": "was ended early",
    "dead": "died without a word; make sure that the table stands, then carry on with --resume",
}


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@json_option
def command(run: Path, as_json: bool) -> None:
    """Say where RUN is: progress, time left, temperatures, last events. The run is not disturbed.

    \b
    Example:
      gyrocal status run
    """
    from gyrocal.bench.safety import made_safe_text
    from gyrocal.bench.status import read_status
    from gyrocal.units import plural

    s = read_status(run)
    if as_json:
        emit_json({"run": str(run), **s.to_json()})
        return
    click.echo(f"{run} {_SEEN[s.state]}{_why(s.reason)}.")
    done = s.recorded + s.unsettled + s.failed
    click.echo(
        f"{done} {plural(done, '[segment|segments]')} sealed, {s.steps} {plural(s.steps, '[step|steps]')} planned: {s.recorded} ok, "
        f"{s.unsettled} unsettled, {s.failed} failed; {s.retried} {plural(s.retried, '[attempt|attempts]')} failed."
        + brought_back(s.brought_back)
    )
    if s.now:
        click.echo(f"Recording {s.now}.")
    if s.state not in ("complete", "incomplete") and s.left_s == s.left_s:
        click.echo(f"{_duration(s.left_s)} of bench time left.")
    if s.made_safe is not None:
        click.echo(made_safe_text(s.made_safe))
    readings = (("chamber", s.chamber_c, "°C"), ("gyro", s.gyro_c, "°C"), ("table", s.table_dps, "deg/s"))
    known = [f"{name} {value:.2f} {unit}" for name, value, unit in readings if value == value]
    click.echo(f"Last recorded: {', '.join(known) or 'nothing'}; last change {_duration(s.quiet_s)} ago.\n")
    emit_table(["t, s", "event", "what"], [_row(e) for e in s.events], "Last events")


def _why(reason: str | None) -> str:
    """Why it was ended, which mostly says already what to do."""
    if reason is None:
        return ""
    return f": {reason.removesuffix('.')}" + ("" if "--resume" in reason else "; --resume carries on")


def _duration(seconds: float) -> str:
    from gyrocal.units import S_PER_H, S_PER_MIN

    if seconds < 2 * S_PER_MIN:
        return f"{seconds:.0f} s"
    if seconds < 2 * S_PER_H:
        return f"{seconds / S_PER_MIN:.0f} min"
    return f"{seconds / S_PER_H:.1f} h"


def _row(event: dict[str, Any]) -> list[str]:
    shown = ("id", "kind", "rate_dps", "chamber_c", "outcome", "reason", "table_stopped", "complete")
    what = ", ".join(f"{key} {event[key]}" for key in shown if event.get(key) is not None)
    return [f"{event.get('t_s', 0.0):.1f}", str(event.get("event")), what]
