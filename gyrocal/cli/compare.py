"""``gyrocal compare``: runs of a unit beside each other, as before and after a repair."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_list, emit_table, json_option, progress, scale_number


@click.command("compare")
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Nominal scale of tables in gyro_counts, sign included.",
)
@json_option
def command(runs: tuple[Path, ...], counts_per_dps: float | None, as_json: bool) -> None:
    """Compare RUNS of one unit, in the order in which they were made: repeatability, before and after a repair.

    Every figure of every run, of three or more the standard deviation from run to run beyond the error within them, the
    change from the first to the last with its 95 % interval, and whether it is more than noise (1 % false alarms over
    all figures together). Runs at rest are compared by noise, mean and drift.

    Example: gyrocal compare before after
    """
    from gyrocal.commands.compare import compare
    from gyrocal.report.compare import blank_sentences, change_rows, changes_sentence, to_json

    with progress("compare", quiet=as_json) as tell:
        changes = compare(runs, counts_per_dps, tell)
    names = [path.name for path in runs]
    if as_json:
        emit_json(to_json(changes, names))
        return
    click.echo(changes_sentence(changes))
    click.echo("")
    emit_table(*change_rows(changes, names))
    emit_list(blank_sentences(changes, names))
