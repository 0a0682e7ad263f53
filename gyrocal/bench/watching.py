"""Who looks on while a run goes on, and what he is told of it: the run does not end with him."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from gyrocal.bench.plan import Step
from gyrocal.bench.safety import Note


@dataclass(frozen=True)
class Progress:
    """Where a run is."""

    share: float
    left_s: float
    step: Step
    chamber_c: float
    gyro_c: float


class Watch(Protocol):
    """Who looks on: a progress bar, a log, nobody."""

    def progress(self, progress: Progress) -> None:
        """A step has begun, or goes on."""
        ...

    def say(self, text: str) -> None:
        """Something happened that the operator should know."""
        ...


class SteadyWatch:
    """A watch that may go (a closed terminal, a viewer that was killed): it is then told nothing more, and the journal it is."""

    def __init__(self, watch: Watch, note: Note) -> None:
        self._watch: Watch | None = watch
        self._note = note

    def progress(self, progress: Progress) -> None:
        """Pass it on, if anybody is there."""
        if self._watch is not None:
            try:
                self._watch.progress(progress)
            except OSError as error:
                self._gone(error)

    def say(self, text: str) -> None:
        """Pass it on, if anybody is there."""
        if self._watch is not None:
            try:
                self._watch.say(text)
            except OSError as error:
                self._gone(error)

    def _gone(self, error: OSError) -> None:
        self._watch = None
        self._note("viewer_gone", reason=str(error))


@dataclass
class Summary:
    """What came of a run, this start and those before it. Entries are the steps in words, with the reason where known.

    `seed` is that of the virtual bench's noise; None on a real bench.
    """

    recorded: int = 0
    unsettled: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    retried: list[str] = field(default_factory=list)
    before: int = 0
    samples: int = 0
    bench_time_s: float = 0.0
    turns_ccw: float = 0.0
    turns_cw: float = 0.0
    seed: int | None = None

    @property
    def complete(self) -> bool:
        """Whether every step was recorded, unsettled ones included."""
        return not self.failed and not self.skipped
