"""Time as a parameter. Only the real clock sleeps; the virtual one makes a 14-hour plan take seconds."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds since the run began, and a way to let time pass."""

    def now_s(self) -> float:
        """Seconds since the run began."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Let `duration_s` seconds pass."""
        ...


#: Longest sleep between two looks at what is to be attended to, s.
_NAP_S = 0.1


class RealClock:
    """Host monotonic time; immune to NTP steps of the wall clock. Who sleeps calls `attend`, which may end the sleep."""

    def __init__(self, offset_s: float = 0.0, attend: Callable[[], None] = lambda: None) -> None:
        self._zero_s = time.monotonic() - offset_s
        self._attend = attend

    def now_s(self) -> float:
        """Seconds since the run began."""
        return time.monotonic() - self._zero_s

    def sleep(self, duration_s: float) -> None:
        """Sleep, attending on the way; the only place in the package that does."""
        deadline_s = time.monotonic() + duration_s
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            time.sleep(min(left_s, _NAP_S))
            self._attend()


class VirtualClock:
    """Time that passes at once; what lives in it is told of every step through `advance`."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._listeners: list[Callable[[float], None]] = []

    def now_s(self) -> float:
        """Seconds since the run began."""
        return self._now_s

    def sleep(self, duration_s: float) -> None:
        """Pass `duration_s` seconds: listeners first, so that they can look up to the new time."""
        self._now_s += max(0.0, duration_s)
        for listener in self._listeners:
            listener(self._now_s)

    def subscribe(self, advance_to: Callable[[float], None]) -> None:
        """Call `advance_to(now_s)` after every step."""
        self._listeners.append(advance_to)
