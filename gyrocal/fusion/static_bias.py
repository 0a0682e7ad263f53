"""Static bias: the mean of the gyro over the first seconds at rest, which the paper subtracts before each run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError

#: The paper stands still for 5 to 10 s.
LEAST_STATIC_S = 5.0
#: A robot whose wheels go further, or whose gyro departs further for a second, does not rest.
MOVED_M = 0.002
TURNED_DPS = 0.5
#: Samples further out than this many robust standard deviations lose weight (Huber).
_HUBER = 2.5


@dataclass(frozen=True)
class StaticBias:
    """Bias at rest with its standard error (white and correlated noise), over `n` samples in `duration_s`."""

    bias_dps: float
    std_error_dps: float
    n: int
    duration_s: float


def static_bias(
    t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, rate_dps: ArrayLike, static_s: float
) -> StaticBias:
    """Huber mean of the rates in the first `static_s` seconds; rates of a calibrated gyro are given compensated.

    The standard error is that of the Newey-West long-run variance, or of white noise where that is larger.
    It says nothing of bias that changes after the rest.

    Raises
    ------
    DataError
        The rest is too short or empty, or the robot moves in it.
    """
    t, left, right, rate = (np.asarray(a, dtype=np.float64) for a in (t_s, left_m, right_m, rate_dps))
    if static_s < LEAST_STATIC_S:
        raise DataError(
            f"static_s is {static_s:g} s, and a static bias takes {LEAST_STATIC_S:g} to 10 s at rest: stand longer."
        )
    first = (t - t[:1] <= static_s) & np.isfinite(rate)
    if np.count_nonzero(first) < 10 or t[first][-1] - t[0] < 0.8 * static_s:
        raise DataError(
            f"the log has {np.count_nonzero(first)} finite gyro samples in its first {static_s:g} s, too few for a static bias."
        )
    moved = max(float(np.nansum(np.abs(d[t - t[0] <= static_s]))) for d in (left, right))
    t, rate = t[first], rate[first]
    turned = _largest_departure(t, rate)
    if moved > MOVED_M or turned > TURNED_DPS:
        raise DataError(
            f"the robot moves in its first {static_s:g} s (wheels {moved * 1e3:.3g} mm, gyro {turned:.2g} deg/s from its median for a second): let it stand, or shorten static_s."
        )
    mean, weighted = _huber(rate)
    return StaticBias(mean, math.sqrt(_variance_of_mean(weighted)), rate.size, float(t[-1] - t[0]))


def _largest_departure(t: NDArray[np.float64], rate: NDArray[np.float64]) -> float:
    """Largest departure of a one-second mean from the median of all, beyond what white noise does to it."""
    second = np.floor(t - t[0]).astype(np.int64)
    n = np.bincount(second)
    means = np.bincount(second, weights=rate)[n > 0] / n[n > 0]
    noise = np.std(np.diff(rate)) / math.sqrt(2.0)
    return float(np.max(np.abs(means - np.median(rate)) - 5.0 * noise / np.sqrt(n[n > 0])))


def _huber(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Huber mean and the influence of each sample on it."""
    mean = float(np.median(x))
    scale = 1.4826 * float(np.median(np.abs(x - mean))) or float(np.std(x))
    if scale == 0.0:
        return mean, np.zeros(x.size)
    for _ in range(50):
        mean += float(np.mean(np.clip(x - mean, -_HUBER * scale, _HUBER * scale)))
    clipped = np.clip(x - mean, -_HUBER * scale, _HUBER * scale)
    return mean, clipped / np.mean(np.abs(x - mean) < _HUBER * scale)


def _variance_of_mean(x: NDArray[np.float64]) -> float:
    """Variance of the mean of a series of mean zero: Newey-West with a bandwidth of 1.3 sqrt(n), at least white."""
    n = x.size
    white = float(x @ x) / (n - 1)
    bandwidth = min(n - 1, math.ceil(1.3 * math.sqrt(n)))
    lags = np.arange(1, bandwidth + 1)
    shared = np.array([x[k:] @ x[:-k] for k in lags]) / n
    return max(white, white + 2.0 * float((1.0 - lags / (bandwidth + 1)) @ shared)) / n
