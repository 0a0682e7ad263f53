"""Mix-ups of a truth that no dead reckoning explains: another unit, a heading in radians, a mirrored frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.align import align_positions
from gyrocal.units import RAD_TO_DEG

Floats = NDArray[np.float64]

#: Units that positions come in by mistake, in metres.
UNITS = {1e-3: "millimetres", 1e3: "kilometres"}
#: Stretches of a path whose lengths tell the truth's unit.
_STRETCHES = 50
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
    fault = gyro_fault(path[known, 2], truth[known, 2])
    if fault is not None:
        return fault
    unit_m = truth_unit_m(own, told)
    if unit_m != 1.0:
        return f"the truth's positions are {1.0 / unit_m:g} times the path's: they are in {UNITS[unit_m]}. State their unit in a mapping with --columns."
    if in_radians(path[:, 2], truth[:, 2]):
        return "the truth's heading is in radians. Write it in degrees, or state its unit in a mapping with --columns."
    return _mirrored(own, told)


def truth_unit_m(own: Floats, told: Floats) -> float:
    """The truth's unit in metres, by the lengths of stretches: a key of `UNITS`, or 1.

    Parameters
    ----------
    own, told : ndarray, shape (n, 2)
        Positions of dead reckoning, m, and of the truth at the same rows. Only lengths count, so that a heading that
        drifts does no harm.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(own, axis=0).T))])
    if way[-1] <= 0.0:
        return 1.0
    stretch_m = way[-1] / _STRETCHES
    marks = np.searchsorted(way, np.arange(0.0, way[-1], stretch_m))
    a, b = (np.hypot(*np.diff(points[marks], axis=0).T) for points in (own, told))
    moved = a > 0.3 * stretch_m
    ratio = float(np.median(b[moved] / a[moved])) if moved.any() else 0.0
    fits = [unit for unit in UNITS if ratio > 0.0 and abs(np.log(ratio * unit)) < np.log(_UNIT_FACTOR)]
    return fits[0] if fits else 1.0


def _extent(points: Floats) -> float:
    return float(np.sqrt(np.sum(np.var(points, axis=0))))


def _mirrored(own: Floats, told: Floats) -> str | None:
    misses = [_misfit(own, told), _misfit(own, told * np.array([1.0, -1.0]))]
    if misses[0] < _MISSES * _extent(own) or misses[1] > _BETTER_IN_MIRROR * misses[0]:
        return None
    return f"the truth follows the path in a mirror only (rms {misses[1]:.3g} m, {misses[0]:.3g} m as it stands): its y has the wrong sign, or x and y are swapped. State the signs in a mapping with --columns."


def _misfit(own: Floats, told: Floats) -> float:
    aligned = np.stack(align_positions(own, told).apply(own[:, 0], own[:, 1]), axis=1)
    return float(np.sqrt(np.mean(np.sum((aligned - told) ** 2, axis=1))))


def gyro_fault(own_deg: Floats, told_deg: Floats) -> str | None:
    """What is wrong with a gyro whose headings turn as the truth's do in radians; None where nothing is."""
    known = np.isfinite(told_deg)
    if not in_radians(np.unwrap(told_deg[known], period=360.0), own_deg[known]):
        return None
    return "by the truth the robot turns 57.3 times as far as by the gyro: gyro_dps is in rad/s. Write it in deg/s, or state its unit in a mapping with --columns."


def in_radians(own_deg: Floats, told: Floats) -> bool:
    """Whether a truth's headings, NaN where there is none, are in radians, by the turns of dead reckoning."""
    known = np.isfinite(told)
    if np.count_nonzero(known) < 10:
        return False
    turned, said = np.diff(own_deg[known]), np.diff(told[known])
    range_deg = float(np.ptp(own_deg[known]))
    if range_deg < _TURNED_DEG or float(np.ptp(told[known])) > 0.1 * range_deg:
        return False
    apart = [
        float(np.mean(np.abs((unit * said - turned + 180.0) % 360.0 - 180.0))) for unit in (1.0, RAD_TO_DEG)
    ]
    return apart[1] < 0.5 * apart[0]
