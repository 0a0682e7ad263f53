"""``gyrocal replay``: drive logs through the runtime, in the paper's four conditions."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import finite_number, json_option
from gyrocal.cli.log_options import drive_options

#: Of so many rows the errors all along the path are shown on a terminal beside those at the ends.
_FEW_ROWS = 12


@click.command("replay")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG...")
@click.option(
    "--robot", required=True, type=click.Path(path_type=Path), help="Robot file (TOML): geometry and noise."
)
@click.option(
    "--coefficients",
    "-c",
    type=click.Path(path_type=Path),
    help="Coefficient file; without it only the conditions without calibration.",
)
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Directory to write; new or empty."
)
@click.option(
    "--align",
    type=click.Choice(["start", "positions"]),
    help="How truth and estimate are laid on each other; default: by the start pose where its heading is known.",
)
@click.option(
    "--filter",
    "kind",
    type=click.Choice(["model", "paper"]),
    default="model",
    show_default=True,
    help="The drive model, or the paper's nine states with white measurement noise.",
)
@click.option(
    "--returns", is_flag=True, help="The robot came back to its start: without truth, that is the error."
)
@click.option(
    "--power-on-s",
    type=float,
    callback=finite_number,
    help="When the gyro was switched on, on the log's clock.",
)
@drive_options
@json_option
def command(
    logs: tuple[Path, ...],
    robot: Path,
    coefficients: Path | None,
    out: Path,
    columns: Path | None,
    align: str | None,
    kind: str,
    returns: bool,
    power_on_s: float | None,
    topics: dict[str, str],
    axis: str,
    as_json: bool,
) -> None:
    """Dead reckoning of drive logs with and without calibration, with and without the Kalman filter.

    LOG is a CSV (t_s, left_m, right_m or ticks, gyro_dps, and gyro_temp_c and truth where there is some), a ROS
    bag or an MCAP file. Writes trajectories, states, one table in the layout of the paper's Table II, figures,
    and replay.html, which holds them all. A log whose channels cannot be right is refused.

    Example: gyrocal replay drives/*.csv --robot drives/robot.toml -c fog.json --out replay
    """
    from gyrocal.cli.console import emit_json, emit_table, progress
    from gyrocal.commands.replay import ReplayRequest, replay_to_directory
    from gyrocal.navigation.table import HEADINGS
    from gyrocal.records.drive_source import Reading

    reading = Reading(columns, topics, axis)
    request = ReplayRequest(logs, robot, out, coefficients, reading, align, returns, power_on_s, kind)
    with progress("replay", quiet=as_json) as report:
        result = replay_to_directory(request, report)
    if as_json:
        emit_json(result.summary)
        return
    emit_table(HEADINGS, result.table.lines())
    click.echo("")
    # Of many squares the errors at their ends are the table that is asked for; all along the path they are on the page.
    if result.table.measure == "end" or 0 < len(result.errors.rows) <= _FEW_ROWS:
        emit_table(result.errors.columns, result.errors.rows, result.errors.title)
        click.echo("")
    click.echo(result.verdict)
    for remark in result.remarks:
        click.echo(f"Note: {remark}")
    click.echo(f"Page, figures and trajectories: {out}/replay.html")
