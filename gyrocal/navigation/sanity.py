"""Mix-ups of a truth that no dead reckoning explains: another unit, a heading in radians, a mirrored frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.align import align_positions
from gyrocal.units import RAD_TO_DEG

Floats = NDArray[np.float64]

#: A factor this near to that of a wrong unit is one; dead reckoning is never off by so much.
_UNIT_FACTOR = 3.0
#: A mirrored truth fits this much better in a mirror than as it stands, and as it stands misses by this share of the
#: path's extent: a straight path, which is its own mirror image, does neither.
_BETTER_IN_MIRROR, _MISSES = 0.25, 0.2
#: Turned less than this in all, headings in degrees and radians look alike.
_TURNED_DEG = 60.0


def truth_fault(path: Floats, truth: Floats) -> str | None:
    """What is wrong with a truth, in words, and what to do; None where nothing is.

    Parameters
    ----------
    path, truth : ndarray, shape (n, 3)
        x and y in m and heading in deg at the same rows, dead reckoning and truth; NaN where the truth has none.
    """
    known = np.isfinite(truth[:, 0] + truth[:, 1])
    own, told = path[known, :2], truth[known, :2]
    if own.shape[0] < 10:
        return None
    return _wrong_unit(own, told) or _mirrored(own, told) or _in_radians(path[:, 2], truth[:, 2])


def _extent(points: Floats) -> float:
    return float(np.sqrt(np.sum(np.var(points, axis=0))))


def _wrong_unit(own: Floats, told: Floats) -> str | None:
    if min(_extent(own), _extent(told)) == 0.0:
        return None
    ratio = _extent(told) / _extent(own)
    for factor, unit in ((1e3, "millimetres"), (1e-3, "kilometres")):
        if 1.0 / _UNIT_FACTOR < ratio / factor < _UNIT_FACTOR:
            return f"the truth reaches {ratio:.3g} times as far as the path: it is in {unit}. State its unit in a mapping with --columns."
    return None


def _mirrored(own: Floats, told: Floats) -> str | None:
    misses = [_misfit(own, told), _misfit(own, told * np.array([1.0, -1.0]))]
    if misses[0] < _MISSES * _extent(own) or misses[1] > _BETTER_IN_MIRROR * misses[0]:
        return None
    return f"the truth follows the path in a mirror only (rms {misses[1]:.3g} m, {misses[0]:.3g} m as it stands): its y has the wrong sign, or x and y are swapped. State the signs in a mapping with --columns."


def _misfit(own: Floats, told: Floats) -> float:
    aligned = np.stack(align_positions(own, told).apply(own[:, 0], own[:, 1]), axis=1)
    return float(np.sqrt(np.mean(np.sum((aligned - told) ** 2, axis=1))))


def _in_radians(own_deg: Floats, told: Floats) -> str | None:
    known = np.isfinite(told)
    if np.count_nonzero(known) < 10:
        return None
    turned, said = np.diff(own_deg[known]), np.diff(told[known])
    range_deg = float(np.ptp(own_deg[known]))
    if range_deg < _TURNED_DEG or float(np.ptp(told[known])) > 0.1 * range_deg:
        return None
    apart = [
        float(np.mean(np.abs((unit * said - turned + 180.0) % 360.0 - 180.0))) for unit in (1.0, RAD_TO_DEG)
    ]
    if apart[1] >= 0.5 * apart[0]:
        return None
    return "the truth's heading is in radians. Write it in degrees, or state its unit in a mapping with --columns."
