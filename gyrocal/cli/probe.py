"""``gyrocal probe``: what is on this port."""

from __future__ import annotations

import sys

import click

from gyrocal.cli.console import emit_json, finite_number, json_option


@click.command()
@click.argument("port")
@click.option(
    "--baud", type=click.IntRange(min=1), help="Line speed; without it the usual ones are tried in turn."
)
@click.option(
    "--seconds",
    default=2.0,
    show_default=True,
    type=click.FloatRange(0.1, 600),
    callback=finite_number,
    help="Time to listen.",
)
@json_option
def command(port: str, baud: int | None, seconds: float, as_json: bool) -> None:
    """Listen on PORT and say what is there: nothing, bytes but no frame, or frames of which kind and how often.

    Exit code 0 when a known gyro was found, 9 when not.

    \b
    Example:
      gyrocal probe /dev/ttyUSB0
      gyrocal probe socket://192.168.1.5:4001 --baud 921600
    """
    from gyrocal.bench.clock import RealClock
    from gyrocal.bench.probe import probe_port
    from gyrocal.errors import EXIT_CODES, DeviceError

    finding = probe_port(port, baud, RealClock(), seconds)
    if as_json:
        emit_json(finding.to_json())
    else:
        click.echo(finding.verdict)
    if finding.kind is None:
        sys.exit(EXIT_CODES[DeviceError])
