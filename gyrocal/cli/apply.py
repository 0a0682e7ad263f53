"""``gyrocal apply``: a recording through a coefficient file."""

from __future__ import annotations

from pathlib import Path

import click

from gyrocal.cli.console import overwrite_option, scale_number


@click.command("apply")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--coefficients",
    "-c",
    required=True,
    type=click.Path(path_type=Path),
    help="Coefficient file of `fit` or `diagnose`.",
)
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), help="CSV to write.")
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Scale of a table in gyro_counts, sign included; as given to `fit`.",
)
@click.option(
    "--force-sensor",
    is_flag=True,
    help="Accept coefficients of another model or serial number, and columns of a table that do not look like what they say.",
)
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON on stdout.")
def command(
    recording: Path,
    coefficients: Path,
    output: Path,
    counts_per_dps: float | None,
    force_sensor: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Correct RECORDING (a run directory or a table of data sets) and write a CSV.

    A row for each gyro sample, or data set: segment (or row), t_s, gyro_dps, temp_c, corrected_dps,
    sigma_dps, flag. An unknown value is an empty cell.

    sigma_dps is the standard deviation of the predicted error: the uncertainty of the coefficients, and of
    the terms that `diagnose` added. The noise of the sample itself is not in it.

    flag is a sum: 1 rate, 2 temperature outside the range that the calibration covers; 4 not finite;
    8 bad status; 16 temperature held from an earlier sample; 32 beyond what a
    term was fitted to. 0 is good.

    Example: gyrocal apply run --coefficients fog.json -o corrected.csv
    """
    from gyrocal.calibration.apply import FLAGS, ApplyConfig, apply_recording
    from gyrocal.cli.console import emit_json, progress
    from gyrocal.units import plural

    config = ApplyConfig(recording, coefficients, output, counts_per_dps, force_sensor, overwrite)
    with progress("apply", quiet=as_json) as report:
        applied = apply_recording(config, report)
    if as_json:
        emit_json(applied.to_json())
        return
    flagged = ", ".join(f"{n} {FLAGS[bit]}" for bit, n in applied.flagged.items() if n)
    click.echo(
        f"{output}: {applied.rows} {plural(applied.rows, '[row|rows]')} of "
        f"{applied.segments} {plural(applied.segments, '[segment|segments]')} corrected; "
        f"{applied.flagged_rows} flagged{f' ({flagged})' if flagged else ''}."
    )
    if applied.terms:
        click.echo(f"Terms applied beside the surface: {', '.join(applied.terms)}.")
    if applied.not_applied:
        click.echo(f"Terms of the bench, not applied: {', '.join(applied.not_applied)}.")
    for note in applied.notes:
        click.echo(f"Note: {note}.")
