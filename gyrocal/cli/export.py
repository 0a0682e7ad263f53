"""``gyrocal export``: coefficients for a robot's firmware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import overwrite_option

if TYPE_CHECKING:
    from gyrocal.calibration.export import CType


@click.command("export")
@click.argument("coefficients", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "form",
    type=click.Choice(["c-header"]),
    default="c-header",
    show_default=True,
    help="What to write.",
)
@click.option("--output", "-o", type=click.Path(path_type=Path), help="File to write; without it, stdout.")
@click.option(
    "--type",
    "ctype",
    type=click.Choice(["both", "float", "double"]),
    default="both",
    show_default=True,
    help="Which functions to write.",
)
@click.option(
    "--prefix", default="gyrocal", show_default=True, help="First part of every name in the header."
)
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print what was exported as JSON on stdout; needs -o.")
def command(
    coefficients: Path,
    form: str,
    output: Path | None,
    ctype: CType,
    prefix: str,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write COEFFICIENTS as a C99 header without dependencies.

    It holds PREFIX_error, PREFIX_correct and PREFIX_flags in double, and the same ending in f in float. The
    error in float is within 1e-6 deg/s of the coefficient file's; the corrected rate in float has the steps
    of a float besides (7.6e-6 deg/s at 100 deg/s).

    Terms of `diagnose` that a robot can evaluate go along. Those that remember earlier temperatures bring a
    small state and need the time step; the header says how to call.

    Example: gyrocal export fog.json --format c-header -o fog.h
    """
    from gyrocal.calibration.export import export_c_header, write_header
    from gyrocal.calibration.provenance import naming
    from gyrocal.cli.console import emit_json
    from gyrocal.errors import OutputError
    from gyrocal.fusion.coefficients import load_coefficients
    from gyrocal.records.files import check_output_file

    if as_json and output is None:
        raise click.UsageError("--json prints what was exported; say with -o where the header itself goes.")
    loaded = load_coefficients(coefficients)
    with naming(coefficients):
        export = export_c_header(loaded, ctype, prefix)
    if output is None:
        click.echo(export.text, nl=False)
        return
    if output.resolve() == coefficients.resolve():
        raise OutputError(f"{output}: is the coefficient file itself. Choose another --output.")
    check_output_file(output, overwrite=overwrite)
    write_header(export, output)
    if as_json:
        emit_json(export.to_json() | {"output": str(output)})
        return
    click.echo(f"{output}: {', '.join(export.functions)}.")
    if export.terms:
        click.echo(f"Terms beside the surface: {', '.join(export.terms)}.")
    if export.not_exported:
        click.echo(f"Terms of the bench, not exported: {', '.join(export.not_exported)}.")
