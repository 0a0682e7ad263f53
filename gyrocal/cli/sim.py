"""``gyrocal sim``: the virtual bench on ports, for drivers, plans and operators to try themselves on."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import click

from gyrocal.cli.console import emit_json, json_option


@click.command()
@click.option("--profile", required=True, help="A .toml file or the name of a shipped profile.")
@click.option("--tcp", is_flag=True, help="TCP ports on this computer instead of pseudo-terminals.")
@click.option(
    "--links",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory for links gyro, table and chamber to the pseudo-terminals.",
)
@click.option("--gyro", help="Kind of gyro to serve (default: the profile's, else kvh-frame-a).")
@click.option("--table", help="Kind of table to serve (default: the profile's, else json-lines).")
@click.option("--chamber", help="Kind of chamber to serve (default: the profile's, else espec).")
@json_option
def command(
    profile: str,
    tcp: bool,
    links: Path | None,
    gyro: str | None,
    table: str | None,
    chamber: str | None,
    as_json: bool,
) -> None:
    """Serve a gyro, a table and a chamber on three ports, one physical model behind them, in real time until Ctrl-C.

    Prints the ports and the lines that put them into a profile: save that profile, and acquire runs it
    in another terminal as on a real bench.

    \b
    Example:
      gyrocal sim --profile rd2100
      gyrocal sim --profile quick --tcp --gyro vn100 --table zaber --chamber watlow-f4t-scpi
    """
    from gyrocal.bench.clock import RealClock
    from gyrocal.bench.profile import load_profile
    from gyrocal.bench.virtual.endpoints import Endpoint, PtyEndpoint, TcpEndpoint
    from gyrocal.bench.virtual.serving import serve_profile

    if links is not None and tcp:
        raise click.UsageError("--links is for pseudo-terminals, and --tcp has none.")

    def endpoint(role: str) -> Endpoint:
        return TcpEndpoint() if tcp else PtyEndpoint(links / role if links else None)

    if links is not None:
        links = links.resolve()  # the profile may be used from elsewhere
        links.mkdir(parents=True, exist_ok=True)
    kinds = {"gyro": gyro, "table": table, "chamber": chamber}
    served = serve_profile(load_profile(profile), RealClock(), endpoint, kinds)
    if as_json:
        emit_json({"addresses": served.addresses, "profile_lines": served.snippet})
    else:
        click.echo(f"# Put these lines into the profile, in the place of its own:\n\n{served.snippet}")
        click.echo("# Serving until Ctrl-C.")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    served.run(stop)
