"""The temperature that the gyro went through, on a uniform time grid: what thermal effects remember."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]

#: Standard deviations of the smoothing kernels, s: temperature, and its rate of change.
_SMOOTH_TEMP_S = 10.0
_SMOOTH_RATE_S = 20.0
_MOST_POINTS = 30_000
#: A pause between readings over which nothing is smoothed: longer than this, s, and than so many usual ones.
_GAP_S, _GAP_STEPS = 60.0, 20.0


@dataclass(frozen=True)
class TemperatureHistory:
    """Temperature on a uniform grid; arrays have shape (m,).

    Attributes
    ----------
    t_s, temp_c, rate_c_per_min : ndarray
    """

    t_s: Floats
    temp_c: Floats
    rate_c_per_min: Floats

    @property
    def step_s(self) -> float:
        """Distance of grid points, s."""
        return float(self.t_s[1] - self.t_s[0])

    def temp_at(self, t_s: Floats) -> Floats:
        """Smoothed temperature at times, deg C."""
        return np.asarray(np.interp(t_s, self.t_s, self.temp_c))

    def rate_at(self, t_s: Floats) -> Floats:
        """Rate of change of temperature at times, deg C/min."""
        return np.asarray(np.interp(t_s, self.t_s, self.rate_c_per_min))

    def lagged_at(self, tau_s: float, t_s: Floats) -> Floats:
        """Temperature behind a first-order lag, ``tau dT_in/dt = T - T_in``, at times, deg C.

        Before the record the temperature is taken to have been constant.
        """
        a = float(np.exp(-self.step_s / tau_s))
        # Exact for an input that is linear between grid points (first-order hold).
        hold = tau_s / self.step_s * (1.0 - a)
        relative = self.temp_c - self.temp_c[0]
        lagged = lfilter([1.0 - hold, hold - a], [1.0, -a], relative) + self.temp_c[0]
        return np.asarray(np.interp(t_s, self.t_s, lagged))


def fill_gaps(t_s: Floats, values: Floats) -> Floats:
    """Linear interpolation across NaN."""
    known = np.isfinite(values)
    return values if known.all() else np.asarray(np.interp(t_s, t_s[known], values[known]))


def temperature_history(t_s: Floats, temp_c: Floats, smooth: bool = True) -> TemperatureHistory:
    """Smoothed temperature and its rate on a uniform grid, from readings in time order, shape (n,)."""
    span = max(float(t_s[-1] - t_s[0]), 1.0)
    step = max(1.0, span / _MOST_POINTS)
    grid = t_s[0] + step * np.arange(int(np.ceil(span / step)) + 1)
    temp = np.interp(grid, t_s, temp_c)
    typical = float(np.median(np.diff(t_s))) if t_s.size > 1 else step
    kernel_s = max(_SMOOTH_TEMP_S, 2.0 * min(typical, 60.0))
    pieces = _pieces(grid, t_s)
    fine = _smoothed(temp, pieces, kernel_s / step) if smooth and t_s.size > 3 else temp
    slow = _smoothed(temp, pieces, max(_SMOOTH_RATE_S, kernel_s) / step)
    rate = np.gradient(slow, step) * 60.0
    return TemperatureHistory(grid, fine, rate)


def _pieces(grid: Floats, t_s: Floats) -> list[slice]:
    """Parts of the grid that readings cover; between them the temperature is not known and not smoothed over."""
    gaps = np.flatnonzero(np.diff(t_s) > max(_GAP_S, _GAP_STEPS * float(np.median(np.diff(t_s)))))
    if t_s.size < 3 or gaps.size == 0:
        return [slice(0, grid.size)]
    starts = np.concatenate([[t_s[0]], t_s[gaps + 1]])
    ends = np.concatenate([t_s[gaps], [t_s[-1]]])
    return [
        slice(int(np.searchsorted(grid, a)), int(np.searchsorted(grid, b, side="right")))
        for a, b in zip(starts, ends, strict=True)
    ]


def _smoothed(values: Floats, pieces: list[slice], sigma: float) -> Floats:
    out = values.copy()
    for piece in pieces:
        if piece.stop - piece.start > 2:
            out[piece] = _gaussian(values[piece], sigma)
    return out


def _gaussian(values: Floats, sigma: float) -> Floats:
    """Gaussian smoothing; the ends are continued by point reflection, which keeps straight lines straight."""
    half = min(int(np.ceil(4.0 * sigma)), values.size - 1)
    if half < 1:
        return values
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)
    before = 2.0 * values[0] - values[half:0:-1]
    after = 2.0 * values[-1] - values[-2 : -half - 2 : -1]
    return np.asarray(np.convolve(np.concatenate([before, values, after]), kernel / kernel.sum(), "valid"))
