"""The loops that numba compiles and keeps on disk, called once each."""

from __future__ import annotations

import numpy as np

from gyrocal.fusion import Navigator, RobotParameters
from gyrocal.inference.whitening import NoiseModel
from gyrocal.navigation.path import Motion, drive, square_via_points
from tests.inference.test_markov import some_field
from tests.inference.test_whitening import LEVELS, make_series


def compile_loops() -> None:
    """Call each as the program does."""
    Navigator(RobotParameters(0.5)).step(0.0, 0.0, 0.0, 0.0)
    motion = Motion()
    drive(square_via_points(motion, 1)[:2], motion, dt_s=0.1, static_s=1.0)
    field = some_field(10, 1)
    given = field.given(np.ones((10, 2)))
    given.restricted_slope().along(field, field)
    NoiseModel(make_series(1, 5)).whiten(LEVELS, np.ones((5, 2)))
