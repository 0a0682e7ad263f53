"""How much time the machine kept from this process: bounds in real time hold for the product, not for what else runs."""

from __future__ import annotations

import threading
import time
from types import TracebackType

#: Wakes are wanted so often, s; so late they are by the turns that threads of one process take.
_PERIOD_S, _TURN_S = 0.01, 0.02


class Pulse:
    """A thread that wakes often and keeps how late it did: hold it in a ``with`` statement."""

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Pulse:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def given_s(self, begin_s: float, end_s: float) -> float:
        """Of the time between two instants of the monotonic clock, what the machine gave."""
        kept_s = 0.0
        for woke_s, late_s in self._late:
            # of a wake that came late, the part between the instants
            inside_s = min(woke_s, end_s) - max(woke_s - late_s, begin_s)
            kept_s += max(inside_s - _TURN_S, 0.0)
        return end_s - begin_s - kept_s

    def _beat(self) -> None:
        while not self._stop.is_set():
            due_s = time.monotonic() + _PERIOD_S
            time.sleep(_PERIOD_S)
            woke_s = time.monotonic()
            self._late.append((woke_s, woke_s - due_s))
