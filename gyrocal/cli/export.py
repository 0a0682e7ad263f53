"""``gyrocal export``: coefficients for a robot's firmware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import finite_number, overwrite_option
from gyrocal.errors import InputError

if TYPE_CHECKING:
    from gyrocal.calibration.export import CType
    from gyrocal.calibration.export_others import Axis
    from gyrocal.fusion.coefficients import Coefficients


def _identifier(_ctx: click.Context, _param: click.Parameter, value: str) -> str:
    from gyrocal.calibration.export import check_prefix

    try:
        check_prefix(value)
    except InputError as error:
        raise click.BadParameter(str(error)) from error
    return value


@click.command("export")
@click.argument("coefficients", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "form",
    type=click.Choice(["c-header", "kalibr", "px4", "ardupilot"]),
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
    "--prefix",
    default="gyrocal",
    callback=_identifier,
    show_default=True,
    help="First part of every name in the header.",
)
@click.option(
    "--axis",
    type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
    default="-z",
    show_default=True,
    help="px4, ardupilot: axis of the vehicle (z down) about which the gyro's output is positive.",
)
@click.option(
    "--instance", type=click.IntRange(0, 3), default=0, show_default=True, help="px4, ardupilot: which gyro."
)
@click.option(
    "--rate-hz",
    type=click.FloatRange(0.1),
    callback=finite_number,
    help="kalibr: sample rate, if the file does not say it.",
)
@overwrite_option
@click.option("--json", "as_json", is_flag=True, help="Print what was exported as JSON on stdout; needs -o.")
def command(
    coefficients: Path,
    form: str,
    output: Path | None,
    ctype: CType,
    prefix: str,
    axis: Axis,
    instance: int,
    rate_hz: float | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write COEFFICIENTS as a C99 header without dependencies, or what other programs take of them.

    kalibr: imu.yaml with the gyro's noise. px4, ardupilot: parameters with the bias over temperature; they have no place
    for the rest. The header holds PREFIX_error, PREFIX_correct and PREFIX_flags in double, and the same ending in f in float. The
    error in float is within 1e-6 deg/s of the coefficient file's in its valid range; the corrected rate in float has the steps
    of a float besides (7.6e-6 deg/s at 100 deg/s).

    Terms of `diagnose` that a robot can evaluate go along. Those that remember earlier temperatures bring a
    small state and need the time step; the header says how to call.

    Example: gyrocal export fog.json --format c-header -o fog.h
    """
    from gyrocal.calibration.export import export_c_header, write_header
    from gyrocal.calibration.provenance import naming
    from gyrocal.cli.console import emit_json
    from gyrocal.fusion.coefficients import load_coefficients
    from gyrocal.records.files import check_output_file, write_atomically

    if as_json and output is None:
        raise click.UsageError("--json prints what was exported; say with -o where the file itself goes.")
    loaded = load_coefficients(coefficients)
    with naming(coefficients):
        made = None if form == "c-header" else _other(loaded, form, axis, instance, rate_hz)
        export = None if made is not None else export_c_header(loaded, ctype, prefix)
    if output is None:
        click.echo(made if export is None else export.text, nl=False)
        return
    check_output_file(output, overwrite=overwrite, inputs=[coefficients])
    if export is None:
        write_atomically(output, made or "")
        about = {"format": form, "sensor": dict(loaded.sensor)}
    else:
        write_header(export, output)
        about = export.to_json()
    if as_json:
        emit_json(about | {"output": str(output)})
        return
    click.echo(f"{output}: {', '.join(export.functions) if export else form}.")
    if export and export.terms:
        click.echo(f"Terms beside the surface: {', '.join(dict.fromkeys(export.terms))}.")
    if export and export.not_exported:
        click.echo(f"Terms of the bench, not exported: {', '.join(export.not_exported)}.")


def _other(file: Coefficients, form: str, axis: Axis, instance: int, rate_hz: float | None) -> str:
    from gyrocal.calibration.export_others import ardupilot, kalibr, px4

    if form == "kalibr":
        return kalibr(file, rate_hz)
    return (px4 if form == "px4" else ardupilot)(file, axis, instance)
