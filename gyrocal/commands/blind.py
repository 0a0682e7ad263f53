"""`gyrocal blind`: hidden physics sealed, diagnosed, opened, and all that is written of it."""

from __future__ import annotations

from pathlib import Path

from gyrocal.records.files import make_output_directory, write_atomically
from gyrocal.report.diagnosis_blind import BlindResult, write_trials
from gyrocal.report.made_up_blind import MadeUpResult, write_opened
from gyrocal.trial.blind import BlindConfig, Finder, Progress, check_profile, run_trials
from gyrocal.trial.opened import run_made_up


class Commitments:
    """What was committed to so far, in ``commitments.txt`` of a directory."""

    def __init__(self, out: Path) -> None:
        self._file = out / "commitments.txt"
        self._seals: list[str] = []

    def add(self, number: int, seal: str) -> None:
        """Write down what trial `number` is sealed by; trials come in their order."""
        self._seals.append(seal)
        write_atomically(self._file, "".join(f"{n:4d} {s}\n" for n, s in enumerate(self._seals)))


def write_blind(
    config: BlindConfig, out: Path, progress: Progress, finder: Finder | None = None
) -> BlindResult:
    """Run a blind trial and write commitments.txt, blind.json, blind.html and its pictures to `out`.

    A commitment is on disk before the run that it seals is diagnosed.

    Raises
    ------
    ProfileError, OutputError
        No such profile, or it cannot be written.
    """
    check_profile(config)
    make_output_directory(out)
    return write_trials(config, run_trials(config, Commitments(out).add, progress, finder), out)


def write_made_up(
    config: BlindConfig, out: Path, progress: Progress, finder: Finder | None = None
) -> MadeUpResult:
    """Run a blind trial of a kind and write commitments.txt, blind.json, blind.html and the recordings to `out`.

    A commitment is on disk before the recording that it seals is diagnosed.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    make_output_directory(out)
    trials = run_made_up(config, out / "recordings", Commitments(out).add, progress, finder)
    return write_opened(config, trials, out)
