"""Who looks on while a run goes on, and what he is told of it: the run does not end with him."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Protocol

from gyrocal.bench.plan import Step
from gyrocal.bench.safety import Note

#: Longest wait for who looks on, s: a terminal that Ctrl-S holds, or a connection that hangs, takes no word for hours.
_PATIENCE_S = 0.2


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
    """A watch that may go (a closed terminal, a viewer that was killed) or that takes no word for a while.

    Who is gone is told nothing more, and the journal it is. Who takes no word keeps nobody waiting: what was said
    in the meantime comes when he takes it again.
    """

    def __init__(self, watch: Watch, note: Note) -> None:
        self._watch: Watch | None = watch
        self._note = note
        #: A thread of its own: whoever writes to a terminal that is held hangs.
        self._teller = ThreadPoolExecutor(1, "watch")
        self._last: Future[None] | None = None

    def progress(self, progress: Progress) -> None:
        """Pass it on, if anybody is there who takes it now: later it is stale."""
        watch = self._watch
        if watch is not None and self._keeps_up():
            self._tell(lambda: watch.progress(progress))

    def say(self, text: str) -> None:
        """Pass it on, if anybody is there."""
        watch = self._watch
        if watch is not None:
            self._tell(lambda: watch.say(text))

    def _keeps_up(self) -> bool:
        return self._last is None or self._last.done()

    def _tell(self, telling: Callable[[], None]) -> None:
        kept_up = self._keeps_up()
        self._last = self._teller.submit(telling)
        if not kept_up:
            return
        wait([self._last], _PATIENCE_S)
        if not self._last.done():
            self._note("viewer_stalled", reason=f"takes no word within {_PATIENCE_S:g} s")
            return
        try:
            self._last.result()
        except OSError as error:
            self._watch = None
            self._note("viewer_gone", reason=str(error))


@dataclass
class Summary:
    """What came of a run's plan, this start and those before it. Entries are the steps in words, with the reason where known.

    `brought_back` are the segments beside the plan in which a start brought the bench back to a temperature.
    `seed` is that of the virtual bench's noise; None on a real bench.
    """

    recorded: int = 0
    unsettled: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    retried: list[str] = field(default_factory=list)
    before: int = 0
    brought_back: int = 0
    samples: int = 0
    bench_time_s: float = 0.0
    turns_ccw: float = 0.0
    turns_cw: float = 0.0
    seed: int | None = None

    @property
    def complete(self) -> bool:
        """Whether every step was recorded, unsettled ones included."""
        return not self.failed and not self.skipped
