"""The temperature that the gyro went through, on a uniform time grid: what thermal effects remember."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrocal.inference.course import Course, smooth_course
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]

#: Points of the grid, which costs in proportion: a second each over eight hours, then longer ones.
_MOST_POINTS = 30_000
#: No thermometer has coarser steps, nor scatters more, degC: values farther apart are the set points of a plan, which hold as
#: they are written.
COARSEST_C = 2.0


@dataclass(frozen=True)
class TemperatureHistory:
    """Temperature on a uniform grid; arrays have shape (m,).

    Attributes
    ----------
    t_s, temp_c, rate_c_per_min : ndarray
    course : Course, optional
        What it was read from the thermometer as; None: it is known.
    known : tuple of ndarray, optional
        Times, and the temperatures then, where those that were read are the temperature.
    """

    t_s: Floats
    temp_c: Floats
    rate_c_per_min: Floats
    course: Course | None = None
    known: tuple[Floats, Floats] | None = None

    @property
    def step_s(self) -> float:
        """Distance of grid points, s."""
        return float(self.t_s[1] - self.t_s[0])

    def temp_at(self, t_s: Floats) -> Floats:
        """Temperature at times, deg C: not by the grid, which is coarse where a record has a long pause."""
        if self.course is not None:
            return self.course.at(t_s)[0]
        return np.asarray(np.interp(t_s, *(self.known or (self.t_s, self.temp_c))))

    def rate_at(self, t_s: Floats) -> Floats:
        """Rate of change of temperature at times, deg C/min."""
        return np.asarray(np.interp(t_s, self.t_s, self.rate_c_per_min))

    def covariance_at(self, t_s: Floats) -> Floats | None:
        """Covariance of what is not known of the temperature at times, shape (n, n), deg C squared; None: it is known."""
        return None if self.course is None else self.course.covariance(t_s)

    def as_read(self, t_s: Floats, temp_c: Floats) -> TemperatureHistory:
        """The same with readings that are the temperature, scatter and all, straight between them."""
        here_c = np.interp(self.t_s, t_s, temp_c)
        slope = S_PER_MIN * np.gradient(here_c, self.t_s)
        return replace(self, temp_c=here_c, rate_c_per_min=slope, course=None, known=(t_s, temp_c))

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


def temperature_history(
    t_s: Floats,
    temp_c: Floats,
    count: Floats | None = None,
    step_c: float | None = None,
    *,
    all_along: bool = False,
) -> TemperatureHistory:
    """The temperature behind readings, and its rate, on a uniform grid.

    Parameters
    ----------
    t_s, temp_c : ndarray, shape (n,)
        Readings in time order; NaN where there is none.
    count : ndarray, shape (n,), optional
        How many readings each is a mean of.
    step_c : float, optional
        Steps of the thermometer, where it has any; coarser ones than any has are none of it.
    all_along : bool
        Whether it was read all the time, and not with the data sets only.
    """
    known = np.isfinite(temp_c)
    t, read = t_s[known], temp_c[known]
    often = np.ones(t.size) if count is None else count[known]
    steps_c = step_c if step_c and step_c <= COARSEST_C else 0.0
    course = smooth_course(t, read, often, steps_c, all_along=all_along)
    span = max(float(t_s[-1] - t_s[0]), 1.0)
    step = max(1.0, span / _MOST_POINTS)
    grid = t_s[0] + step * np.arange(int(np.ceil(span / step)) + 1)
    temp, slope = course.at(grid)
    return TemperatureHistory(grid, temp, S_PER_MIN * slope, course)
