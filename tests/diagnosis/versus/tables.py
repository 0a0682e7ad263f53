"""A plan of a rate table, as a recording and as somebody's simulation of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.surface import Surface
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

SURFACE = Surface(
    np.array([[0.05, 0.02, 0.01], [0.4, 0.3, -0.1], [0.02, 0.01, 0.0], [-0.3, 0.05, 0.02]]), 0, 100, 20, 30
)
_SIZES = (10.0, 20.0, 40.0, 60.0, 80.0, 100.0)
RATES = np.array([0.0, *(side * size for size in _SIZES for side in (1.0, -1.0))])


def plan(sweeps: int = 10) -> tuple[Floats, Floats, Floats]:
    """Time, rate and temperature of each data set: sweeps a minute a rate, while the temperature swings."""
    rate: Floats = np.tile(RATES, sweeps)
    t: Floats = 60.0 * np.arange(rate.size, dtype=np.float64)
    return t, rate, np.asarray(20.0 + 28.0 * np.sin(t / 2500.0), dtype=np.float64)


def table(name: str, t: Floats | None, rate: Floats, gyro: Floats, temp: Floats) -> DataSetTable:
    return DataSetTable(Path(name), rate, gyro, temp, t_s=t)
