"""Intervals of amplitudes that are traded against a shape."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.diagnosis.intervals import amplitude_interval


def test_shape_that_no_row_shows_says_nothing_of_the_amplitude() -> None:
    """A knee above the highest rate leaves a column of zeros: no amplitude, and no bound from it."""

    def at(knee: float) -> tuple[float, float, float]:
        if knee > 100.0:
            return 1000.0, 0.0, float("inf")
        return 500.0 + (knee - 80.0) ** 2, 2.0, 0.1

    profile = amplitude_interval(at, (79.0, 101.0), (1.0, 200.0))
    assert profile.interval == pytest.approx((2.0 - 0.196, 2.0 + 0.196), abs=0.01)
    assert np.isfinite(profile.std)
