"""``gyrocal umbmark``: wheel scales and track of a robot from squares driven both ways."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_table, finite_number, json_option


@click.command("umbmark")
@click.argument("runs", type=click.Path(path_type=Path))
@click.option(
    "--robot", required=True, type=click.Path(path_type=Path), help="Robot file in use on these runs."
)
@click.option(
    "--side-m",
    required=True,
    type=click.FloatRange(0.1, 1000.0),
    callback=finite_number,
    help="Side of the square, in metres.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Of the draws behind the intervals.",
)
@json_option
def command(runs: Path, robot: Path, side_m: float, seed: int, as_json: bool) -> None:
    """Correct a robot's wheels and track by UMBmark (Borenstein and Feng, 1996).

    RUNS is a CSV with a row for each square driven: direction (1 counter-clockwise, -1 clockwise), and x_m, y_m:
    the measured end position less the one that odometry believes, x along the first leg and y to its left. Three
    runs in each direction are wanted, five are usual.

    Example: gyrocal umbmark squares.csv --robot robot.toml --side-m 4
    """
    from dataclasses import asdict

    from gyrocal.commands.turn import examine_squares
    from gyrocal.report.turns import SQUARES_TAKE, square_rows

    found = examine_squares(runs, robot, side_m, seed)
    if as_json:
        emit_json({"schema": "gyrocal-umbmark/1", **asdict(found), "notes": [SQUARES_TAKE]})
        return
    click.echo(f"Systematic error before correction: {found.before_m:.3g} m after a square of {side_m:g} m.")
    click.echo("")
    emit_table(("figure", "value", "95 %", "where it goes"), square_rows(found))
    click.echo("")
    click.echo(SQUARES_TAKE)
