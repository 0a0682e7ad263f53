"""What holds for every test."""

from __future__ import annotations

import os
import signal

# As the command line does, before numpy is imported: threads of BLAS in every worker fight for the same cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tables fold to the window: the same one for every test, whatever terminal it is run from.
os.environ["COLUMNS"] = "100"

import pytest
from hypothesis import settings

# A first example pays for what is compiled or imported on the way; each test has its time-out. What is drawn is the
# same each time, so that a change is judged by itself.
settings.register_profile("gyrocal", deadline=None, derandomize=True)
settings.load_profile("gyrocal")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell's background job ignores Ctrl-C, and so would every program that the tests start and interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Compile what numba compiles before the processes of the tests start: each would do it for itself, at once."""
    if config.getoption("numprocesses", None):
        from tests.compiled import compile_loops

        compile_loops()
