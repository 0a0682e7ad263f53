"""Gyro and encoders in time: by how much the one is late, and over what time the others average."""

from __future__ import annotations

import numpy as np

from gyrocal.diagnosis.drive.series import DriveSeries, averaged

#: Reach and grid of the search for a delay, s; the fit finds it closer.
_REACH_S, _GRID_S = 2.0, 0.05
#: Windows over which encoders may average, s.
_WINDOWS_S = (0.0, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)
#: What part of the variance a delay or a window must remove before anything else is looked at.
_CLEARLY = 0.8


def align(series: DriveSeries) -> tuple[float, float]:
    """By how much the gyro is late, and over what time the encoders average, by the correlation of their rates.

    Returns
    -------
    delay_s, window_s : float
        Zero each where it removes no clear part of the variance. The delay counts to the middle of the window.
    """
    grid = np.arange(series.t_s[0] + _REACH_S, series.t_s[-1] - _REACH_S, _GRID_S)
    encoder = np.diff(np.interp(grid, series.t_s, series.encoder_rad))
    best = {}
    for window_s in _WINDOWS_S:
        heading = averaged(series.t_s, series.gyro_rad, 0.0, window_s)
        lags = np.arange(-_REACH_S, _REACH_S + 1e-9, _GRID_S)
        turned = [np.diff(np.interp(grid + lag, series.t_s, heading)) for lag in lags]
        left = np.array([1.0 - np.corrcoef(encoder, gyro)[0, 1] ** 2 for gyro in turned])
        at = int(np.argmin(left))
        best[window_s] = (float(left[at]), float(lags[at]), float(left[lags.size // 2]))
    plain = best[0.0][2]
    window_s = min(best, key=lambda w: best[w][0])
    if best[window_s][0] > _CLEARLY**2 * best[0.0][0]:
        window_s = 0.0
    found, delay_s, _ = best[window_s]
    return (delay_s, window_s) if found < _CLEARLY * plain else (0.0, 0.0)
