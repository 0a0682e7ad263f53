"""What the gyro says while the robot stands: a law of its bias has to agree with that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive_series import DriveSeries
from gyrocal.fusion.static_bias import MOVED_M

Floats = NDArray[np.float64]

#: A rest lasts at least so long, after so much for the robot to come to a stand, s.
_LEAST_S, _SETTLE_S = 2.0, 0.5
#: A gyro's bias wanders by so much between rests, whatever its noise, deg/s.
_WANDER_DPS = 0.003
#: Rate of wrongly speaking against a law.
_LEVEL = 1e-3


@dataclass(frozen=True)
class Rest:
    """The gyro's mean rate over a rest, and its standard deviation, deg/s; the temperature above that of the start."""

    t_s: float
    rate_dps: float
    std_dps: float
    warmer_c: float


def rests(series: DriveSeries) -> tuple[Rest, ...]:
    """Stretches in which neither wheel moves."""
    t = series.t_s
    moves = np.zeros(t.size, dtype=bool)
    for wheel in (series.left_m, series.right_m):
        moves |= np.abs(np.diff(wheel, prepend=wheel[0])) > 0.05 * MOVED_M
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moves, [True]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2] - 1
    known = np.flatnonzero(np.isfinite(series.temp_c))
    found = []
    for begin, end in zip(begins, ends, strict=True):
        i = int(np.searchsorted(t, t[begin] + (_SETTLE_S if begin else 0.0)))
        j = int(np.searchsorted(t, t[end] - _SETTLE_S))
        if j - i < 10 or t[j] - t[i] < _LEAST_S:
            continue
        seconds = float(t[j] - t[i])
        rate = float(series.gyro_deg[j] - series.gyro_deg[i]) / seconds
        steps = np.diff(series.gyro_deg[i : j + 1])
        white = float(np.var(steps - rate * np.diff(t[i : j + 1]))) * steps.size / seconds**2
        warmer = 0.0
        if known.size:
            warmer = float(
                np.mean(np.interp(t[i : j + 1], t[known], series.temp_c[known])) - series.start_temp_c
            )
        found.append(Rest(float(t[i]), rate, float(np.hypot(np.sqrt(white), _WANDER_DPS)), warmer))
    return tuple(found)


def evidence_of_rests(
    seen: tuple[Rest, ...], before: tuple[float, float], after: tuple[float, float]
) -> float:
    """Log-likelihood that a new law (bias, deg/s, and its slope, deg/s per degC) gains at the rests, nats."""

    def squares(law: tuple[float, float]) -> float:
        return float(sum(((r.rate_dps - law[0] - law[1] * r.warmer_c) / r.std_dps) ** 2 for r in seen))

    return 0.5 * (squares(before) - squares(after))


def rests_speak_against(
    seen: tuple[Rest, ...], before: tuple[float, float], after: tuple[float, float]
) -> bool:
    """Whether a new law meets the rests clearly worse than the old one."""
    return evidence_of_rests(seen, before, after) < -0.5 * float(stats.chi2.isf(_LEVEL, 1))


def white_rate_dps_rt_s(series: DriveSeries) -> float:
    """White noise of the gyro's rate, deg/s times the root of a second: its angle walks so much in a second.

    From second differences of neighbouring rows, so that turns do not count; robustly, so that bumps do not.
    """
    dt = np.diff(series.t_s)
    rate = np.divide(np.diff(series.gyro_deg), dt, out=np.zeros_like(dt), where=dt > 0)[dt > 0]
    bends = rate[2:] - 2 * rate[1:-1] + rate[:-2]
    return float(1.4826 * np.median(np.abs(bends)) / np.sqrt(6.0) * np.sqrt(series.usual_dt_s))
