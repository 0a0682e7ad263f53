"""The command line: one file a command; options, one library call, render.

Commands are imported when they run, so that ``gyrocal --help`` answers at once.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback

import click

import gyrocal
from gyrocal.errors import GyrocalError, exit_code

#: Command name -> (module of this package, one line for --help). In the order of the work.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "The whole main job on the virtual bench, in a minute."),
    "acquire": ("acquire", "Run a profile on the bench and record every data set."),
    "fit": ("fit", "Fit the error surface and write a coefficient file."),
    "apply": ("apply", "Correct a recording with a coefficient file, to CSV."),
    "export": ("export", "Export coefficients for a robot's firmware."),
    "report": ("report", "Draw the figures and tables of a calibration."),
    "diagnose": ("diagnose", "Find, name and model the physics that a calibration lacks."),
    "blind": ("blind", "Prove diagnose on your own profile: hidden physics, sealed answers."),
    "replay": ("replay", "Dead reckoning of drive logs, with and without calibration and filter."),
    "simulate": ("simulate", "Simulate robot drives with the virtual gyro."),
    "probe": ("probe", "Say what is on a port: nothing, unknown bytes, or which gyro."),
    "sim": ("sim", "The virtual bench on ports, in real time, for acquire in another terminal."),
    "status": ("status", "Where a run is: progress, time left, temperatures, last events."),
    "decode": ("decode", "Decode a raw capture to samples."),
}


class LazyGroup(click.Group):
    """A group whose commands are imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names, in the order of the work."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command `cmd_name`, imported now."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"gyrocal.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(gyrocal.__version__, prog_name="gyrocal")
@click.option("--debug", is_flag=True, help="Show the traceback when something fails.")
def gyrocal_command(debug: bool) -> None:
    """Calibration bench for fiber-optic gyros: acquire, fit, report, replay, diagnose."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; every GyrocalError becomes one sentence on stderr and its own exit code."""
    argv = sys.argv[1:] if arguments is None else arguments
    # One thread for linear algebra: the matrices are small, threads cost more than they give, and sums taken in
    # another order on another number of cores would change the last digits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MKL_NUM_THREADS", "1")
    try:
        gyrocal_command(args=arguments, prog_name="gyrocal")
    except GyrocalError as error:
        if "--debug" in argv:
            traceback.print_exc()
        click.echo(f"gyrocal: {error}", err=True)
        sys.exit(exit_code(error))
