"""What the scatter of data sets may be made of: sample noise, which is known, and the parts whose levels `inference.scatter` finds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets
from gyrocal.inference.flicker import TIME_CONSTANTS_S, Rest, flicker_correlation, walk_covariance
from gyrocal.inference.scatter import Scatter, scatter_of

Floats = NDArray[np.float64]

#: Without times the order of the data sets stands for them; time constants in data sets.
TIME_CONSTANTS_SETS = (1.0, 10.0, 100.0, 1000.0, 10000.0)

#: Without times a step of temperature of this share of the span was a soak, taken to last this many data sets:
#: half an hour against 20 s. Left out, drift between temperatures would pass for structure in temperature.
_SOAK_STEP = 0.05
_SOAK_SETS = 100.0


def scatter_parts(sets: DataSets) -> tuple[Floats, tuple[Floats, ...], bool]:
    """Known variances, shape (n,), the parts of `PARTS` (1-d: a diagonal), and whether times are known."""
    known = sets.mean_variance_dps2
    known = np.where(np.isfinite(known), known, 0.0)
    constants: tuple[float, ...]
    if sets.timed:
        duration = np.where(np.isfinite(sets.duration_s) & (sets.duration_s > 0), sets.duration_s, 1.0)
        place, constants = sets.t_s, TIME_CONSTANTS_S
    else:
        duration, place, constants = np.ones(len(sets)), order_of(sets), TIME_CONSTANTS_SETS
    flicker, walk = flicker_correlation(place, duration, constants), walk_covariance(place, duration)
    return known, (np.ones(len(sets)), flicker, sets.rate_dps**2, walk), sets.timed


def order_of(sets: DataSets) -> Floats:
    """Place of each data set in the order of the recording, shape (n,), with room for soaks between temperatures."""
    step = np.abs(np.diff(sets.temp_c, prepend=sets.temp_c[0]))
    soaks = np.cumsum(step > _SOAK_STEP * np.ptp(sets.temp_c)) if np.ptp(sets.temp_c) > 0 else 0
    return np.asarray(sets.segment + _SOAK_SETS * soaks, dtype=np.float64)


def estimate_scatter(sets: DataSets, design: Floats, rest: Rest | None = None) -> Scatter:
    """Levels of the scatter of data sets around a linear model, and how well they are known.

    Parameters
    ----------
    design : ndarray, shape (n, p)
        Columns of the model of the error.
    rest : Rest, optional
        Records at rest of the same run.
    """
    known, parts, timed = scatter_parts(sets)
    return scatter_of(sets.error_dps, known, parts, design, timed=timed, rest=rest)
