"""Errors that go by the way on which a rate was reached: a hysteresis of the rate, of which the catalogue has no law."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN
from gyrocal.diagnosis.laws.in_place import by_chance
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.series import Series, set_means
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: Data sets that came from below, and from above: of fewer a disturbed one may be all that is seen.
_LEAST_WAYS = 8


def strange_ways(series: Series, left_dps: Floats, surface: Surface) -> list[Located]:
    """That the rest goes by the sign of the step of the rate before each data set; mostly nothing.

    Parameters
    ----------
    left_dps : ndarray, shape (n,)
        What everything that was found leaves of each row.
    surface : whose terms take up what a plan has the way go with
    """
    _, left = set_means(series, left_dps)
    rate, gyro, temp = (set_means(series, x)[1] for x in (series.rate_dps, series.gyro_dps, series.temp_c))
    way = np.sign(np.diff(rate, prepend=rate[:1]))
    if min(np.count_nonzero(way == side) for side in (1.0, -1.0)) < _LEAST_WAYS:
        return []
    design = surface.design(rate if surface.direction == "input" else gyro, temp)[:, carried_terms(series)]
    x, y = (v - design @ np.linalg.lstsq(design, v, rcond=1e-10)[0] for v in (way, left))
    freedom = y.size - design.shape[1] - 1
    # A plan of one way at each rate has none by itself.
    if freedom < _LEAST_WAYS or x @ x < 0.1 * (way @ way):
        return []
    size = float(x @ y) / float(x @ x)
    gain = -0.5 * freedom * float(np.log1p(-size * float(x @ y) / float(y @ y)))
    if gain < GAIN:
        return []
    return [
        Located(
            "rate",
            "mean",
            by_chance(gain, 1),
            1.0,
            True,
            target="way",
            rms_dps=abs(size) * float(np.std(way)),
        )
    ]
