"""``gyrocal fit``: the error surface of a recording, and its coefficient file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from gyrocal.cli.console import overwrite_option, scale_number

if TYPE_CHECKING:
    from gyrocal.calibration.calibrate import Calibration


def _ids(_ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]) -> tuple[int, ...]:
    try:
        return tuple(int(part) for value in values for part in value.split(",") if part.strip())
    except ValueError as error:
        raise click.BadParameter("give numbers of data sets, as 12 or 12,40") from error


@click.command("fit")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--output", "-o", required=True, type=click.Path(path_type=Path), help="Coefficient file to write (JSON)."
)
@click.option(
    "--counts-per-dps",
    type=float,
    callback=scale_number,
    help="Nominal scale of a table in gyro_counts, sign included.",
)
@click.option(
    "--weights",
    type=click.Choice(["gls", "ols"]),
    help="gls: weigh data sets by their estimated scatter. ols: equal weights, as in the paper. "
    "Without it, what does better on data left out.",
)
@click.option(
    "--direction",
    type=click.Choice(["output", "input"]),
    help="Powers of the gyro's output, as in the paper, or of the true rate. Without it, what does better.",
)
@click.option("--paper", is_flag=True, help="The paper's twelve terms in the output, whatever does better.")
@click.option(
    "--bias-only", is_flag=True, help="Bias over temperature, from a recording at one rate or at rest."
)
@click.option(
    "--exclude",
    multiple=True,
    callback=_ids,
    metavar="N[,N...]",
    help="Leave out these data sets (segment or row number).",
)
@click.option("--force", is_flag=True, help="Fit data that are doubtful (saturated, stuck, whole degrees).")
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
def command(
    recording: Path,
    output: Path,
    counts_per_dps: float | None,
    weights: Literal["gls", "ols"] | None,
    direction: Literal["output", "input"] | None,
    paper: bool,
    bias_only: bool,
    exclude: tuple[int, ...],
    force: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Fit the error of RECORDING (a run directory or a table of data sets) over output and temperature.

    Prints one line of verdict first, then coefficients with their uncertainties, figures of merit,
    cross-validation, structure of the residual and outliers. Nothing is dropped unless --exclude says so.
    Direction, terms and weights are those that predict best what is left out; a line says which, and why.

    Example: gyrocal fit run -o fog.json
    """
    from gyrocal.calibration.calibrate import FitConfig, calibrate
    from gyrocal.calibration.summary import to_json
    from gyrocal.cli.console import emit_json
    from gyrocal.records.files import check_output_file, write_atomically

    check_output_file(output, overwrite=overwrite, inputs=[recording])
    result = calibrate(
        recording, FitConfig(counts_per_dps, weights, bias_only, exclude, force, direction, paper)
    )
    write_atomically(output, result.coefficients.to_text())
    if as_json:
        emit_json({"output": output.name} | to_json(result))
    else:
        _show(result, output)


def _show(result: Calibration, output: Path) -> None:
    from gyrocal.calibration.summary import remarks, tables, verdict
    from gyrocal.cli.console import emit_list, emit_table

    click.echo(f"{output}: {verdict(result)}.")
    for table in tables(result):
        click.echo()
        emit_table(table.columns, table.rows, table.title)
    click.echo()
    emit_list(f"{remark}." for remark in remarks(result))
