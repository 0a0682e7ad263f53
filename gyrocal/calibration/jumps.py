"""Where the course of a record at rest jumps: somebody moved the gyro, or its bias stepped.

An Allan variance pools all squares of a record, so that one jump in six hours is most of it at some averaging times and
reads as random walk, with an interval that is far too short. What jumps is left out, and said.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.course import Course

Floats = NDArray[np.float64]

#: Standard deviations of the course's bends beyond which it jumps.
_MOST = 8.0
#: Share of the bends, the largest, that the standard deviation is taken without.
_TAILS = 0.05
#: Of a normal law without its tails of 5 %: what its standard deviation is of the whole one.
_WITHOUT_TAILS = 0.8725
_LEAST_MEANS, _LEAST_SAMPLES = 64, 8


def jumps_of(course: Course, step_dps: float) -> list[tuple[float, float]]:
    """Stretches of time, start and end in s, over which the output jumps by more than noise.

    Parameters
    ----------
    step_dps : float
        Smallest step of the output: means of a rounded output jump by up to one where nothing happens.
    """
    if course.t_s.size < _LEAST_MEANS or np.median(course.n) < _LEAST_SAMPLES:
        return []
    # Second differences: a warm-up or a drift is no jump.
    bend = np.abs(np.diff(course.gyro_dps[:-1], 2))  # the last stretch may be short
    inner = np.sort(bend)[: int((1.0 - _TAILS) * bend.size)]
    scale = float(np.sqrt(np.mean(inner**2))) / _WITHOUT_TAILS
    hit = bend > max(_MOST * scale, 2.0 * step_dps)
    half_s = 0.5 * float(np.median(np.diff(course.t_s)))
    found: list[tuple[float, float]] = []
    for i in np.flatnonzero(hit).tolist():
        start, end = float(course.t_s[i]) - half_s, float(course.t_s[i + 2]) + half_s
        if found and start <= found[-1][1]:
            found[-1] = found[-1][0], end
        else:
            found.append((start, end))
    return found
