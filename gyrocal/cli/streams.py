"""stdin, stdout and stderr when nobody is at their other end: closed before the program began, or while it runs."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

#: What a shell shows of a program that a closed pipe ended: 128 and the number of SIGPIPE.
_PIPE_CLOSED = 141


def open_closed_streams() -> None:
    """Lead to nowhere what was closed before the program began: else a port gets its number, and what is printed there."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


@contextmanager
def ends_when_nobody_reads() -> Iterator[None]:
    """End as Unix tools do where stdout is a pipe that was closed (``| head``); click would say 1, which is a bug here."""
    try:
        yield
    except BrokenPipeError:
        sys.exit(_PIPE_CLOSED)


@contextmanager
def to_whoever_listens() -> Iterator[None]:
    """Print within; where nobody reads it any more (a viewer that was killed, a closed terminal) it is lost, and no more."""
    try:
        yield
    except OSError:
        drop_what_nobody_reads()


def drop_what_nobody_reads() -> None:
    """Send the rest of what a broken stdout or stderr still holds to nowhere: else it changes the exit code at the end."""
    for stream in (sys.stdout, sys.stderr):
        if stream is None:  # closed before the program began
            continue
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
