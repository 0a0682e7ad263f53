"""The frame around every command: --debug, Ctrl-C and SIGTERM, and how a bug is said."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest

from gyrocal.cli import COMMANDS, _say_bug, gyrocal_command, main


@pytest.mark.parametrize(
    "arguments", [["--debug", "fit", "no", "-o", "o"], ["fit", "no", "-o", "o", "--debug"]]
)
def test_debug_stands_anywhere(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    said = capsys.readouterr().err
    assert ended.value.code == 3
    assert said.startswith("Traceback")
    assert said.endswith("gyrocal: no: no such file or directory. Check the path.\n")


def test_without_debug_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["fit", "no", "-o", "o"])
    assert capsys.readouterr().err == "gyrocal: no: no such file or directory. Check the path.\n"


def test_a_bug_is_said_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    _say_bug(KeyError, KeyError("x"), None)
    assert (
        capsys.readouterr().err == "gyrocal: a bug, KeyError: 'x'. Add --debug to see where, and report it.\n"
    )


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_leaves_nothing(tmp_path: Path, number: signal.Signals) -> None:
    """`apply` is stopped while it writes."""
    script = f"""
import os, sys
from pathlib import Path
import gyrocal.calibration.apply as apply
from gyrocal.records.files import writing_atomically
def stopped(config, report):
    with writing_atomically(config.output) as file:
        file.write(b"half")
        os.kill(os.getpid(), {int(number)})
        file.write(b"written")
apply.apply_recording = stopped
sys.argv = ["gyrocal", "apply", "r", "-c", "c", "-o", {str(tmp_path / "o.csv")!r}]
from gyrocal.cli import main
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 130
    assert (
        done.stderr.splitlines()[-1] == "gyrocal: interrupted; nothing was left half-written. Run it again."
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="closes streams by a shell")
@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_streams_that_were_closed_before_are_no_bug(closed: str) -> None:
    command = f'exec "{sys.executable}" -m gyrocal profile {closed}'
    assert subprocess.run(["/bin/sh", "-c", command], check=False).returncode == 0


@pytest.mark.skipif(os.name != "posix", reason="pipes of a shell")
@pytest.mark.parametrize("words", ["--help", "fit --help", "profile"])
def test_a_pipe_that_was_closed_ends_silently_as_in_unix_tools(words: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "gyrocal", *words.split()], stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode == 128 + signal.SIGPIPE


def test_no_option_that_is_a_number_takes_nan_or_an_endless_one() -> None:
    numbers = 0
    for name in COMMANDS:
        command = gyrocal_command.get_command(click.Context(gyrocal_command), name)
        assert command is not None
        for param in command.params:
            # The readers of tables refuse a scale that is none, where it is wanted.
            if isinstance(param.type, click.types.FloatParamType) and param.name != "counts_per_dps":
                numbers += 1
                for value in ("nan", "inf"):
                    with pytest.raises(click.BadParameter):
                        param.process_value(click.Context(command), value)
    assert numbers
