"""Tests of several things at once: families held together, and coefficients by their scatter over a few draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

Floats = NDArray[np.float64]


def holm(p_values: Floats) -> Floats:
    """Holm's step-down correction of a family of p-values, same order, shape (m,)."""
    order = np.argsort(p_values)
    stepped = np.maximum.accumulate(p_values[order] * np.arange(p_values.size, 0, -1))
    corrected = np.empty_like(p_values)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def hotelling_p_value(t2: float, draws: float, size: int) -> float:
    """P-value of Hotelling's T2 of `size` means, whose covariance is known from so many draws."""
    dof = draws - size
    return float(fisher.sf(t2 * dof / ((draws - 1.0) * size), size, dof))
