"""Runs of neighbouring rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


def runs_of(rows: Ints) -> list[Ints]:
    """Numbers in rising order, split where one is left out."""
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else []
