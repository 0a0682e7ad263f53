"""``gyrocal report``: figures, tables and one page of a calibration."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import emit_json, emit_list, json_option, progress, scale_number


@click.command("report")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--coefficients",
    "-c",
    required=True,
    type=click.Path(path_type=Path),
    help="Coefficient file of `fit` or `diagnose`.",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="New directory for the report.")
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Scale of a table in gyro_counts, sign included; as given to `fit`.",
)
@click.option("--force-sensor", is_flag=True, help="Accept coefficients of another model or serial number.")
@json_option
def command(
    recording: Path,
    coefficients: Path,
    out: Path,
    counts_per_dps: float | None,
    force_sensor: bool,
    as_json: bool,
) -> None:
    """Draw the figures and tables of RECORDING (a run directory or a table of data sets).

    Writes report.html, which holds everything and needs no network; figures/ as PNG and SVG; tables/ as CSV.
    A figure that the recording cannot carry is replaced by a sentence that says why.

    Example: gyrocal report run --coefficients fog.json --out report
    """
    from gyrocal.commands.report import ReportConfig, write_report

    config = ReportConfig(recording, coefficients, out, counts_per_dps, force_sensor)
    with progress("report", quiet=as_json) as tell:
        result = write_report(config, tell)
    if as_json:
        emit_json(result.to_json())
        return
    click.echo(result.verdict)
    emit_list(result.remarks)
    for name, reason in result.missing:
        click.echo(f"Not drawn: {name}. {reason}")
    click.echo(f"{len(result.figures)} figures and the tables: open {out / 'report.html'}")
