"""The command line: one file a command; options, one library call, render.

Commands are imported when they run, so that ``gyrocal --help`` answers at once.
"""

from __future__ import annotations

import atexit
import importlib
import os
import signal
import sys
import traceback
from types import FrameType, TracebackType
from typing import Any, NoReturn

import click

import gyrocal
from gyrocal.cli.streams import (
    drop_what_nobody_reads,
    ends_when_nobody_reads,
    open_closed_streams,
    to_whoever_listens,
)
from gyrocal.errors import GyrocalError, InterruptedRunError, exit_code

#: Command name -> (module of this package, one line for --help). In the order of the work.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "The whole main job on the virtual bench, in a minute."),
    "profile": ("profile", "The profiles that ship, and a commented one to begin from."),
    "acquire": ("acquire", "Run a profile on the bench and record every data set."),
    "fit": ("fit", "Fit the error surface and write a coefficient file."),
    "apply": ("apply", "Correct a recording with a coefficient file, to CSV."),
    "export": ("export", "Export coefficients for a robot's firmware."),
    "noise": ("noise", "Allan curve, noise figures and bias of a gyro that stands."),
    "report": ("report", "Draw the figures and tables of a calibration."),
    "diagnose": ("diagnose", "Find, name and model the physics that a calibration lacks."),
    "certify": ("certify", "The certificate of one unit: figures, limits, what was not tested."),
    "compare": ("compare", "Runs of one unit beside each other: what changed."),
    "fleet": ("fleet", "Many units beside each other: spread, who is out of line, what drifts."),
    "blind": ("blind", "Prove diagnose on your own profile: hidden physics, sealed answers."),
    "turn": ("turn", "Scale factor without a table: rests and whole turns on a mark."),
    "umbmark": ("umbmark", "Wheels and track of a robot from squares driven both ways."),
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

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Read the options; `--help` is printed here."""
        with ends_when_nobody_reads():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; Ctrl-C (and SIGTERM, see `main`) unwinds it, so that temporary files are removed."""
        try:
            with ends_when_nobody_reads():
                return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise InterruptedRunError("interrupted; nothing was left half-written. Run it again.") from error

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
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    if arguments is None:
        _as_a_program(debug)
    # One thread for linear algebra: the matrices are small, threads cost more than they give, and sums taken in
    # another order on another number of cores would change the last digits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MKL_NUM_THREADS", "1")
    try:
        # --debug may stand anywhere, since it is added to a command that has just failed.
        gyrocal_command(args=[word for word in given if word != "--debug"], prog_name="gyrocal")
    except GyrocalError as error:
        with to_whoever_listens():
            if debug:
                traceback.print_exc()
            click.echo(f"gyrocal: {error}{_notes(error)}", err=True)
        sys.exit(exit_code(error))


def _notes(error: BaseException) -> str:
    """What was noted on an error's way here, in lines of their own: how the bench was left."""
    return "".join(f"\n{note}" for note in getattr(error, "__notes__", ()))


def _as_a_program(debug: bool) -> None:
    """What holds for the process, and not for a caller within Python: signals, and how a bug is said."""
    open_closed_streams()
    signal.signal(signal.SIGTERM, _terminated)
    atexit.register(drop_what_nobody_reads)
    if not debug:
        sys.excepthook = _say_bug


def _terminated(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _say_bug(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    click.echo(
        f"gyrocal: a bug, {kind.__name__}: {error}. Add --debug to see where, and report it.{_notes(error)}",
        err=True,
    )
