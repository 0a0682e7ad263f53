"""Directories that a command fills step by step, and what is said when it is interrupted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gyrocal.errors import InterruptedRunError


@contextmanager
def filling(out: Path) -> Iterator[None]:
    """Within, `out` is filled step by step: what ends that says what is left there, and not how a run of the bench goes on."""
    try:
        yield
    except (InterruptedRunError, KeyboardInterrupt) as error:
        raise InterruptedRunError(
            f"interrupted; {out} holds what was done until then, which nothing carries on. Remove it and run it again."
        ) from error
