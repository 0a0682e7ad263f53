"""``gyrocal turn``: scale factor without a table, from rests and whole turns on a mark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import emit_json, emit_list, emit_table, finite_number, json_option
from gyrocal.cli.log_options import gyro_options

if TYPE_CHECKING:
    from gyrocal.records.gyro_log import GyroChoice


@click.command("turn")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--mark-deg",
    type=click.FloatRange(1.0, 360.0),
    callback=finite_number,
    default=360.0,
    show_default=True,
    help="Every turn ends at a multiple of this angle.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="New directory for the page, its picture and turns.json."
)
@gyro_options
@json_option
def command(
    log: Path,
    mark_deg: float,
    out: Path | None,
    choice: GyroChoice,
    as_json: bool,
) -> None:
    """Calibrate a gyro by turning it on a mark: LOG is a CSV with t_s and gyro_dps, a .ulg, a .bin or a bag.

    Stand still for a few seconds, turn by whole turns back to the mark, stand still again, and so on, by hand or
    with the robot spinning in place, some turns each way. Rests and turns are found in the log; the angle between
    them is the reference. Prints scale factor, asymmetry and bias with 95 % intervals.

    Example: gyrocal turn turns.csv --mark-deg 360
    """
    from gyrocal.commands.turn import examine_turns, write_turns
    from gyrocal.report.turns import count_sentence, turn_rows, turn_sentence

    report = examine_turns(log, mark_deg, choice)
    if out is not None:
        write_turns(report, out)
    if as_json:
        emit_json(report.to_json())
        return
    click.echo(turn_sentence(report.found))
    click.echo("")
    emit_table(*turn_rows(report.found))
    emit_list([count_sentence(report.found), *report.notes])
    if out is not None:
        click.echo(f"\nPictures and numbers: open {out / 'turns.html'}")
