"""The overlapping Allan variance by its definition, as a reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def overlapping_avar(rate: NDArray[np.float64], factor: int) -> float:
    """Allan variance of gapless samples, shape (n,), at one averaging factor, in the square of their unit."""
    total = np.concatenate(([0.0], np.cumsum(rate - rate[0])))
    second = total[2 * factor :] - 2.0 * total[factor:-factor] + total[: -2 * factor]
    return float(np.mean((second / factor) ** 2)) / 2.0
