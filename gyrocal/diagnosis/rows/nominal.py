"""Rates that were meant, where the readings of a table's own rate scatter about them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.physics.surface import RATE_ORDER

Floats = NDArray[np.float64]

#: Gaps between rates are wider than those between readings of one rate by this factor.
_APART = 5.0
#: Most of the rates that are meant come again, and none scatters by more than so many times what they mostly do.
_COME_AGAIN, _ALIKE = 0.8, 4.0
#: Readings of both ways are off alike where their mean is so many standard deviations from none.
_SURELY = 2.0
#: Digits of a rate that a table was told, and of a mean of readings.
_TOLD, _MEAN = 3, 6


def nominal_rates(rate_dps: Floats) -> Floats | None:
    """The rate that each row was meant to have, shape (n,); None where readings do not scatter about rates that come again.

    Gaps between readings of one rate and gaps between rates are of two kinds: where the first ends and the second begins, a
    gap is several times the one before it. A rate is meant both ways alike. What is gathered about zero stays as it was read:
    a rest, and slow rates beside it, of which a dead zone knows. What the readings are surely off by both ways stays, too,
    such as the Earth's rate: it is no scatter, and without it a bias would be another one.
    """
    if 2 * np.unique(np.round(rate_dps, _TOLD)).size <= rate_dps.size:
        return None
    either_dps = np.concatenate([rate_dps, -rate_dps])
    readings, row = np.unique(either_dps, return_inverse=True)
    steps = np.diff(readings)
    gaps = np.sort(steps)
    for narrowest in gaps[1:][gaps[1:] > _APART * gaps[:-1]]:
        either = np.append(0, np.cumsum(steps >= narrowest))[row]
        rate = either[: rate_dps.size]
        mean_dps = np.round(np.bincount(either, either_dps) / np.bincount(either), _MEAN)[rate]
        turning = mean_dps != 0.0
        off_dps = rate_dps - mean_dps
        if _are_rates(rate[turning], off_dps[turning]):
            return np.where(turning, mean_dps + _common(off_dps[turning]), rate_dps)
    return None


def _common(off_dps: Floats) -> float:
    """Mean of what readings are off by; 0 where it may be chance."""
    mean_dps = float(np.round(np.mean(off_dps), _MEAN))
    return mean_dps if abs(mean_dps) > _SURELY * np.std(off_dps) / np.sqrt(off_dps.size) else 0.0


def _are_rates(rate: NDArray[np.int64], off_dps: Floats) -> bool:
    """Whether rows come to numbered rates again, and scatter about all of them alike."""
    visits, squares = np.bincount(rate), np.bincount(rate, off_dps**2)
    again = visits[visits > 0] > 1
    if not rate.size or 2 * again.size > rate.size or np.mean(again) < _COME_AGAIN:
        return False
    scatter = np.sqrt(squares[visits > 1] / visits[visits > 1])
    return bool(np.max(scatter) < _ALIKE * np.median(scatter))


def at_nominal(
    rate_dps: Floats, gyro_dps: Floats, free: Callable[[Floats], Floats]
) -> tuple[Floats, Floats, list[Remark]]:
    """Rates that were meant, the output at them, and what is to be said of it.

    Where the output follows the readings the table did turn so, and the output is moved as far as the rate is; where it does
    not, they are the noise of an encoder, and the output stays.

    Parameters
    ----------
    free : columns of what an output may do beside following them, shape (n, p), for given rates
    """
    nominal_dps = nominal_rates(rate_dps)
    if nominal_dps is None:
        return rate_dps, gyro_dps, []
    output = np.polynomial.Polynomial.fit(rate_dps, gyro_dps, RATE_ORDER)
    moved_dps = gyro_dps - (output(rate_dps) - output(nominal_dps))
    columns = free(nominal_dps)

    def left_dps(output_dps: Floats) -> float:
        error = output_dps - nominal_dps
        return float(np.linalg.norm(error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]))

    follows = left_dps(moved_dps) < left_dps(gyro_dps)
    gathered = nominal_dps != rate_dps
    facts = {
        "rms_dps": float(np.std((rate_dps - nominal_dps)[gathered])),
        "rates": int(np.unique(nominal_dps[gathered]).size),
        "does": "follows" if follows else "does not follow",
    }
    return nominal_dps, moved_dps if follows else gyro_dps, [Remark(Said.NOMINAL_RATES, facts)]
