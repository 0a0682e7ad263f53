"""``gyrocal noise``: Allan curve, noise figures and bias of a gyro that stands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from gyrocal.cli.console import emit_json, emit_list, emit_table, finite_number, json_option, progress
from gyrocal.cli.log_options import gyro_options

if TYPE_CHECKING:
    from gyrocal.records.gyro_log import GyroChoice


@click.command("noise")
@click.argument("record", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), help="New directory for the page, its pictures and noise.json."
)
@click.option(
    "--latitude",
    type=click.FloatRange(-90, 90),
    callback=finite_number,
    help="Of the place, deg: takes the earth rate off.",
)
@click.option(
    "--elevation",
    type=click.FloatRange(-90, 90),
    callback=finite_number,
    default=90.0,
    show_default=True,
    help="Of the sensing axis above the horizon, deg; 90 is up.",
)
@click.option(
    "--azimuth",
    type=float,
    callback=finite_number,
    default=0.0,
    show_default=True,
    help="Of the sensing axis, deg clockwise from north.",
)
@click.option(
    "--rate-hz",
    type=click.FloatRange(min=0, min_open=True),
    callback=finite_number,
    help="Nominal sample rate, for the clock.",
)
@gyro_options
@json_option
def command(
    record: Path,
    out: Path | None,
    latitude: float | None,
    elevation: float,
    azimuth: float,
    rate_hz: float | None,
    choice: GyroChoice,
    as_json: bool,
) -> None:
    """Noise and bias of a gyro that stands: RECORD is a run, a CSV with t_s and gyro_dps, a .ulg, a .bin or a bag.

    Prints angle random walk, bias instability, rate random walk, quantisation, drift and mean with 95 % intervals, or
    the reason why the record cannot carry one; and how well the noise model fits. Hours at 1 kHz are read in blocks.

    Example: gyrocal noise still.csv --latitude 42.3 --out noise
    """
    from gyrocal.calibration.static import StaticConfig
    from gyrocal.commands.noise import examine_noise
    from gyrocal.report.noise import noise_rows, noise_sentences

    config = StaticConfig(record, latitude, elevation, azimuth, rate_hz, choice)
    with progress("noise", quiet=as_json) as tell:
        found = examine_noise(config, out, tell)
    if as_json:
        emit_json(found.to_json())
        return
    emit_table(*noise_rows(found))
    click.echo("")
    emit_list(noise_sentences(found))
    if out is not None:
        click.echo(f"\nPictures and numbers: open {out / 'noise.html'}")
