"""The course of a record at rest: no line goes where nothing was measured."""

from __future__ import annotations

import numpy as np

from gyrocal.calibration.course import Course
from gyrocal.report.noise import course_of


def test_no_line_goes_across_a_gap() -> None:
    t = np.concatenate([np.arange(0.0, 100.0, 10.0), np.arange(5000.0, 5100.0, 10.0)])
    course = Course(t, np.full(t.size, 1e-3), np.full(t.size, 20.0), np.ones(t.size))
    for axes in course_of(course).axes:
        (line,) = axes.get_lines()
        x, y = np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)
        assert np.flatnonzero(np.isnan(x)).tolist() == [10]
        assert np.flatnonzero(np.isnan(y)).tolist() == [10]
        assert np.isfinite(x).sum() == t.size
