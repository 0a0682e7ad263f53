"""Directories that a command fills step by step, and what is said when it is interrupted or the disk is full."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gyrocal.errors import InterruptedRunError, OutputError


@contextmanager
def filling(out: Path) -> Iterator[None]:
    """Within, `out` is filled step by step: what ends that says what is left there, and not how a run of the bench goes on."""
    try:
        yield
    except (InterruptedRunError, KeyboardInterrupt) as error:
        raise InterruptedRunError(
            f"interrupted; {out} holds what was done until then, which nothing carries on. Remove it and run it again."
        ) from error
    except OutputError as error:
        if not isinstance(error.__cause__, OSError) or not out.is_dir():
            raise
        temporary = tempfile.gettempdir()
        if str(error).startswith(temporary) and not out.resolve().is_relative_to(temporary):
            raise OutputError(
                f"{temporary}: cannot write what is looked at and thrown away ({error.__cause__.strerror}). Free some space there, or "
                f"name another place in TMPDIR; {out} holds what was done until then, which nothing carries on: remove it."
            ) from error
        raise OutputError(
            f"{out}: cannot write all of it ({error.__cause__.strerror}); it holds what was done until then, which nothing carries on. "
            "Remove it, and free some space or choose another place."
        ) from error
