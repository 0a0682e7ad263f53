"""Whether an output follows the rate: another unit, another sign, a stuck gyro, a value that is a slip of the pen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: An output that follows the rate by more than this factor, or less than its inverse, is in another unit.
WORST_SCALE = 1.5
#: A scale that is this near to a well-known mistake is that mistake.
_NEAR = 0.15
#: An output that follows the rate by less does not follow it.
_DEAD = 2e-3
#: A data set that is further off than this many times the largest rate was not measured.
_GROSS = 10.0
#: Scale to the mistake that makes it.
_MISTAKES = (
    (np.pi / 180.0, "it is in rad/s"),
    (180.0 / np.pi, "the rate is in rad/s"),
    (-1.0, "the sign of the output, or that of the rate, is inverted"),
    (-np.pi / 180.0, "it is in rad/s and of inverted sign"),
    (0.5, "half of the rate: a wrong scale, or a sample rate off by two"),
    (2.0, "twice the rate: a wrong scale, or a sample rate off by two"),
    (3600.0, "it is in deg/h"),
    (1.0 / 3600.0, "the rate is in deg/h"),
    (60.0, "it is in deg/min"),
    (1e3, "it is in mdeg/s"),
)


_STUCK = "Check the gyro's power, its cable and the column, and record again"
_CONVERT = (
    "Rates are deg/s, counter-clockwise positive; for counts the nominal scale and its sign are given with "
    "--counts-per-dps. Convert the output"
)


class Odd(NamedTuple):
    """What is wrong with an output, and what to do; neither ends with a full stop."""

    what: str
    remedy: str


def output_scale(rate_dps: Floats, gyro_dps: Floats) -> float:
    """Slope of output over rate, (deg/s)/(deg/s): the median over pairs of rows half the record apart in rate.

    A bias, or some wild values, do not move it. NaN where there is one rate only.
    """
    order = np.argsort(rate_dps, kind="stable")
    rate, gyro = rate_dps[order], gyro_dps[order]
    half = rate.size // 2
    step = rate[half:] - rate[: rate.size - half]
    apart = step > 1e-9
    if half == 0 or not apart.any():
        return float("nan")
    return float(np.median((gyro[half:] - gyro[: rate.size - half])[apart] / step[apart]))


def gross_row(rate_dps: Floats, gyro_dps: Floats) -> int | None:
    """The row that is furthest off the straight line, where no gyro and no table is that wrong; else None."""
    scale, largest = output_scale(rate_dps, gyro_dps), float(np.max(np.abs(rate_dps), initial=0.0))
    if not np.isfinite(scale) or largest == 0.0:
        return None
    off = gyro_dps - scale * rate_dps
    off = np.abs(off - np.median(off))
    row = int(np.argmax(off))
    return row if off[row] > _GROSS * largest * max(1.0, abs(scale)) else None


def odd_output(rate_dps: Floats, gyro_dps: Floats) -> Odd | None:
    """What is wrong with an output that does not follow the rate as a gyro's does; None if it does."""
    if gyro_dps.size > 1 and float(np.ptp(gyro_dps)) == 0.0:
        return Odd(f"the gyro says {gyro_dps[0]:.6g} in every row: it is stuck", _STUCK)
    scale = output_scale(rate_dps, gyro_dps)
    if not np.isfinite(scale) or 1.0 / WORST_SCALE < scale < WORST_SCALE:
        return None
    text = f"the output is {scale:.3g} times the rate"
    for mistake, meaning in _MISTAKES:
        if abs(scale / mistake - 1.0) < _NEAR:
            return Odd(f"{text} ({meaning}), which is another unit or sign", _CONVERT)
    if abs(scale) < _DEAD:
        return Odd(f"{text}: it does not follow the rate", _STUCK)
    return Odd(f"{text}, which is another unit or sign", _CONVERT)
