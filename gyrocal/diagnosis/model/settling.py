"""What an output that creeps after steps of the rate, as data sets show, does to later rows, where its law only nearly holds.

Of rows alone it is not told: the first of some sweeps, which no other comes before, is like a warm-up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.means import Means
from gyrocal.inference.additive import Component

Floats = NDArray[np.float64]

#: Component, and block, of it.
SETTLING = "settling"
#: Time constants, as multiples of the usual distance of rows: an octave apart their sums follow anything between.
_TIMES = (0.25, 0.5, 1.0, 2.0)
#: Columns smaller than this, as shares of the steps, say nothing.
_TOLD = 1e-3


def settling(means: Means) -> list[Component]:
    """Exponentials after steps of the rate, each step half way between two rows; none where the rate does not change.

    Linear in the steps, and each on what the ones before have left: with a thermal memory of turns or an asymmetry, which
    are even in the rate, it has nothing in common but its plan.
    """
    steps_dps = np.diff(means.rate_dps)
    if not steps_dps.any():
        return []
    at_s = 0.5 * (means.to_s[:-1] + means.from_s[1:])
    taus_s = float(np.median(np.diff(means.t_s))) * np.array(_TIMES)
    left, columns = np.zeros(taus_s.size), np.zeros((len(means), taus_s.size))
    kept = np.exp(-np.diff(at_s, prepend=at_s[0])[:, None] / taus_s)
    # That it turned before the first row is granted to no step: what is left of one is a warm-up.
    for row, (step_dps, fade) in enumerate(zip(steps_dps, kept, strict=True), start=1):
        left = left * fade + step_dps
        since_s = np.array([means.from_s[row], means.to_s[row]]) - at_s[row - 1]
        columns[row] = left * _mean_of_exponentials(since_s, taus_s)
    # What a plan does not tell from the surface is the surface's: where -r follows +r a scale factor is like what creeps.
    u = means.rate_dps / np.abs(means.rate_dps).max()
    shapes = np.column_stack([u**0, u, u**2, u**3])
    columns = columns - shapes @ np.linalg.lstsq(shapes, columns, rcond=None)[0]
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    told = sizes > _TOLD * np.sqrt(np.mean(steps_dps**2))
    return [Component(SETTLING, columns[:, told] / sizes[told])] if told.any() else []


def _mean_of_exponentials(from_to_s: Floats, taus_s: Floats) -> Floats:
    """Means of ``exp(-t / tau)`` between two times, at the first of them where they are one, shape (times,)."""
    z = (from_to_s[1] - from_to_s[0]) / taus_s
    share = np.where(z > 0.0, -np.expm1(-z) / np.where(z > 0.0, z, 1.0), 1.0)
    return np.asarray(np.exp(-from_to_s[0] / taus_s) * share)
