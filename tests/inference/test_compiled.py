"""The compiled loops against themselves where numba is missing."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray

from gyrocal.inference.whitening import NoiseModel
from gyrocal.navigation.path import Motion, drive, square_via_points
from tests.inference.test_markov import some_field
from tests.inference.test_whitening import LEVELS, make_series


def results() -> list[NDArray[np.float64]]:
    """What each loop makes of a small task."""
    field = some_field(20, 1)
    given = field.given(np.random.default_rng(2).normal(size=(20, 3)))
    slope = given.restricted_slope()
    model = NoiseModel(make_series(5))
    white, _ = model.whiten(LEVELS, np.random.default_rng(3).standard_normal((model.fresh.size, 2)))
    coloured = model.simulate(LEVELS, np.random.default_rng(4), 1)
    motion = Motion(length_m=20.0)
    path = drive(square_via_points(motion, 1), motion, dt_s=0.1, static_s=1.0)
    along = np.array([slope.along(field, some_field(20, 2))])
    return [given.gram, given.inverse(), slope.push, slope.keep, along, white, coloured, path.x_m, path.y_m]


def test_the_same_functions_run_without_numba() -> None:
    code = """
import json, sys
sys.modules["numba"] = None
from gyrocal.inference import markov
from tests.inference.test_compiled import results
assert not hasattr(markov._eliminate, "py_func")
print(json.dumps([x.tolist() for x in results()]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for slow, fast in zip(json.loads(done.stdout), results(), strict=True):
        np.testing.assert_allclose(slow, fast, rtol=1e-8, atol=1e-10 * float(np.abs(fast).max()))
