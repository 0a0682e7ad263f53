"""Static bias: the mean of the gyro over the first seconds at rest, which the paper subtracts before each run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError
from gyrocal.units import STDS_PER_MAD

LEAST_STATIC_S = 5.0  # the paper stands still for 5 to 10 s
REST_MOVED_M = 0.002  # a robot whose wheels go further in all does not rest,
TURNED_DPS = 0.5  # nor one whose gyro departs further for a second
_HUBER, _FEWEST = 2.5, 6  # samples beyond so many deviations weigh less; of 6, 95 % cover 91 %, of 8 95 %


@dataclass(frozen=True)
class StaticBias:
    """Bias at rest and its standard error (of white and correlated noise), from `n` samples over `duration_s`."""

    bias_dps: float
    std_error_dps: float
    n: int
    duration_s: float


def static_bias(
    t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, rate_dps: ArrayLike, static_s: float
) -> StaticBias:
    """Huber mean of the rates, shape (n,), in the first `static_s` seconds; of a calibrated gyro, compensated ones.

    The standard error is by the Newey-West long-run variance, at least that of white noise. It says nothing of a
    bias that changes after the rest. DataError where the rest is too short or empty, or the robot moves in it.
    """
    t, left, right, rate = (np.asarray(a, dtype=np.float64) for a in (t_s, left_m, right_m, rate_dps))
    if static_s < LEAST_STATIC_S:
        msg = f"static_s is {static_s:g} s, and a static bias takes {LEAST_STATIC_S:g} to 10 s at rest: stand longer."
        raise DataError(msg)
    rest = t - t[:1] <= static_s
    good = rest & np.isfinite(rate)
    n = int(np.count_nonzero(good))
    if n < _FEWEST or t[good][-1] - t[0] < 0.8 * static_s:
        msg = f"the log has only {n} finite gyro samples in its first {static_s:g} s, the last after {max(t[good] - t[:1], default=0.0):.3g} s, too few for a static bias: stand longer, or shorten static_s."
        raise DataError(msg)
    moved = max(float(np.nansum(np.abs(distance[rest]))) for distance in (left, right))
    t, rate = t[good], rate[good]
    turned = _largest_departure(t, rate)
    if moved > REST_MOVED_M or turned > TURNED_DPS:
        msg = f"the robot moves in its first {static_s:g} s (wheels {moved * 1e3:.3g} mm, gyro off its median by {max(turned, 0.0):.2g} deg/s): let it stand, or shorten static_s."
        raise DataError(msg)
    mean, influence = _huber(rate)
    return StaticBias(mean, math.sqrt(_variance_of_mean(influence)), n, float(t[-1] - t[0]))


def _largest_departure(t: NDArray[np.float64], rate: NDArray[np.float64]) -> float:
    """Largest departure of a one-second mean from the median of all, beyond 5 sigma of white noise."""
    second = np.floor(t - t[0]).astype(np.int64)
    n = np.bincount(second)
    means = np.bincount(second, weights=rate)[n > 0] / n[n > 0]
    noise = np.std(np.diff(rate)) / math.sqrt(2.0)
    return float(np.max(np.abs(means - np.median(rate)) - 5.0 * noise / np.sqrt(n[n > 0])))


def _huber(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Huber mean, and the influence of each sample on it."""
    mean = float(np.median(x))
    limit = _HUBER * (STDS_PER_MAD * float(np.median(np.abs(x - mean))) or float(np.std(x)))
    for _ in range(50):
        mean += float(np.mean(np.clip(x - mean, -limit, limit)))
    inside = float(np.mean(np.abs(x - mean) <= limit))
    return mean, np.clip(x - mean, -limit, limit) / inside


def _variance_of_mean(x: NDArray[np.float64]) -> float:
    """Variance of the mean of a series about zero: Newey-West over a quarter of it, at least white."""
    n, lags = x.size, np.arange(1, x.size // 4 + 1)
    shared = (1.0 - lags / (lags.size + 1)) @ np.array([x[k:] @ x[:-k] for k in lags])
    # The series is about its own mean, which takes a share (lags + 1) / n of the sum away.
    return float(x @ x + 2.0 * max(shared, 0.0)) / (n - lags.size - 1) / n
