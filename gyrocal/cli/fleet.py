"""``gyrocal fleet``: many units of one type, who is out of line and what drifts."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_list, emit_table, json_option, progress, scale_number


@click.command("fleet")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for the results.")
@click.option("--jobs", type=click.IntRange(1), help="Processes; as many as there are cores if not given.")
@click.option("--dask", metavar="ADDRESS", help="Scheduler of a Dask cluster to work on, as tcp://host:8786.")
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Nominal scale of tables in gyro_counts, sign included.",
)
@json_option
def command(
    recordings: tuple[Path, ...],
    out: Path,
    jobs: int | None,
    dask: str | None,
    counts_per_dps: float | None,
    as_json: bool,
) -> None:
    """Fit each of RECORDINGS (runs or tables of data sets) and put the units beside each other.

    Writes fleet.html, fleet.json, fleet.csv and, where pyarrow is installed, fleet.parquet: every figure of every
    unit, its spread between units and within one, units out of line with the figure that says so, and figures
    that change along the serial numbers. A recording that cannot be fitted is listed and does not stop the others.

    Example: gyrocal fleet units/*/run --out fleet
    """
    from gyrocal.calibration.fleet import FleetConfig, measure_fleet
    from gyrocal.records.output import check_output
    from gyrocal.report.fleet import fleet_sentence, tables, to_json, write_fleet

    check_output(out)
    with progress("fleet", quiet=as_json) as tell:
        fleet = measure_fleet(FleetConfig(recordings, jobs, dask, counts_per_dps), tell)
    write_fleet(fleet, out)
    if as_json:
        emit_json(to_json(fleet))
        return
    click.echo(fleet_sentence(fleet))
    for table in tables(fleet):
        if table.rows:
            click.echo("")
            emit_table(table.columns, table.rows, table.title)
    if fleet.failed:
        click.echo("\nNot fitted:")
        emit_list(f"{unit.source}: {unit.error}" for unit in fleet.failed)
    click.echo(f"\nPictures and numbers: open {out / 'fleet.html'}")
