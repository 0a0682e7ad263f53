"""Small benches for the tests of the made-up recordings."""

from __future__ import annotations

import numpy as np

from gyrocal.trial.plans import Bench, Frame, RunPlan, run_bench, sweep, table_bench

FRAME = Frame(100.0, 20.0, 30.0)


def small_run(seed: int = 1) -> Bench:
    """Two temperatures, five rates, dwells of 2 s."""
    rates = sweep(100.0, 5)
    return run_bench(
        FRAME, RunPlan([10.0, 30.0], [rates, rates], 2.0, 4.0, 120.0), np.random.default_rng(seed)
    )


def small_table(seed: int = 1, sets: int = 60) -> Bench:
    """Sweeps of 29 rates in a drifting box."""
    return table_bench(FRAME, sweep(100.0, 29), sets, np.random.default_rng(seed))
