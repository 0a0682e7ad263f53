"""Covariances of drifting noise, for rows that are means over a while."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Below this share of a time constant a mean over a while is as good as a point.
_POINT = 1e-3


def ornstein_uhlenbeck(t_s: Floats, row_s: Floats, tau_s: float) -> Floats:
    """Covariance of an Ornstein-Uhlenbeck process of unit variance, shape (n, n).

    A decade apart, a few of them stand for 1/f noise (bias instability, IEEE 952).

    Parameters
    ----------
    t_s, row_s : ndarray, shape (n,)
        Middle and length of each row, s.
    """
    covariance = np.exp(-np.abs(t_s[:, None] - t_s[None, :]) / tau_s)
    x = np.maximum(row_s, 0.0) / tau_s
    safe = np.maximum(x, _POINT)
    within = 2.0 * (safe - 1.0 + np.exp(-safe)) / safe**2
    covariance[np.diag_indices_from(covariance)] = np.where(x > _POINT, within, 1.0)
    return np.asarray(covariance)


def wiener(t_s: Floats) -> Floats:
    """Covariance of a Wiener process that is one at the end of the record and zero just before it, shape (n, n)."""
    span = float(np.ptp(t_s)) or 1.0
    x = (t_s - t_s.min()) / span
    return np.asarray(np.minimum(x[:, None], x[None, :]) + 1e-6)
