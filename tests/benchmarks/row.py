"""What a benchmark says: a number, its goal, and whether it is met.

Every ``tests/benchmarks/bench_*.py`` has ``measure() -> list[Row]``; ``python -m tests.benchmarks [name ...]`` runs
them and prints one table. Ratios are taken inside one run, on one machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One measured number; `at_least` tells whether the goal is a floor or a ceiling; no goal: for information."""

    what: str
    value: float
    unit: str
    goal: float | None = None
    at_least: bool = False

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.at_least else self.value <= self.goal


def best_time_s(work: Callable[[], object], repeats: int = 3) -> float:
    """Shortest of `repeats` wall-clock times of `work`: the one that other programs disturbed least."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)
