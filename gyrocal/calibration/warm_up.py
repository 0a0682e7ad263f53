"""How long a gyro takes after power-on: an exponential beside the noise, over the course of a record at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from gyrocal.calibration.course import Course
from gyrocal.calibration.figure import Figure
from gyrocal.calibration.trend import CourseNoise

WARM_UP = "warm_up_time"
#: Fewer means do not show a course.
_LEAST_MEANS = 16
#: A record that begins later has missed the most of it.
_LATEST_S = 600.0
#: Time constants of an exponential until 95 % of it is over.
_CONSTANTS = 3.0
_TRIED = 80
#: Chance that noise passes for a warm-up of one time constant; of any that are tried it does in less than one of a hundred.
_ALARM = 1e-3
#: Rise of the cost at the ends of a 95 % interval.
_RISE = float(stats.chi2.isf(0.05, 1))

NOT_SEEN = Figure(
    WARM_UP,
    "min",
    "time from power-on until 95 % of the change of the output at rest is over, three time constants",
    method="exponential beside the temperature, by likelihood beside white noise and drift",
    size=True,
)


def warm_up(course: Course, on_s: float | None, sample: str) -> Figure:
    """Warm-up time of a record at rest, or why it says none.

    Parameters
    ----------
    on_s : time of power-on on the clock of the course; None where it is not known
    """
    blank = replace(NOT_SEEN, sample=sample)
    if on_s is None:
        return replace(blank, reason="the record does not say when the power came on")
    since_s = course.t_s - on_s
    if not 0.0 <= since_s[0] <= _LATEST_S:
        late = f"{since_s[0] / 60.0:.0f} min after power-on"
        return replace(
            blank, reason=f"the record begins {late}; record at rest from power-on (sensor.on_before_s)"
        )
    if since_s.size < _LEAST_MEANS:
        return replace(blank, reason="the record is too short")
    tau_s = np.geomspace(2.0 * float(np.median(np.diff(since_s))), 0.5 * course.span_s, _TRIED)
    columns = [np.ones(since_s.size)]
    if np.isfinite(course.temp_c).all() and np.ptp(course.temp_c) > 0:
        columns.append(course.temp_c - course.temp_c.mean())
    # The levels of the Allan variance would have the warm-up in them.
    noise, decays = CourseNoise(course), np.exp(-since_s[:, None] / tau_s)
    without, cost = noise.costs(course.gyro_dps, np.stack(columns, axis=1), decays)
    best = int(np.argmin(cost))
    if without - cost[best] < stats.chi2.isf(_ALARM, 2):
        return replace(blank, reason="no change since power-on stands out of the noise")
    inside = np.flatnonzero(cost <= cost[best] + _RISE)
    low, high = max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 1, _TRIED - 1)
    value_min = _CONSTANTS * tau_s / 60.0
    if int(inside[-1]) == _TRIED - 1:
        reason = f"the record is too short for it: longer than {value_min[low]:.3g} min with 95 %"
        return replace(blank, reason=reason)
    return replace(
        blank, value=float(value_min[best]), low=float(value_min[low]), high=float(value_min[high])
    )
