"""Where a rising function crosses zero, for many samples at once, each for itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Two numbers nearer than this are the same rate, deg/s; so are those that differ by their last digits.
TOLERANCE_DPS = 1e-11
_LAST_DIGITS = 4 * np.finfo(np.float64).eps

#: Rounds by secants; whoever is not there then halves his interval, which takes a range of 1e6 deg/s to 1e-12.
SECANTS = 20
HALVINGS = 60

#: Beyond its range the function is followed while it rises: first step as a share of the range, growth, steps.
FIRST_STEP = 1 / 32
GROWTH = 1.5
STEPS = 32


def crossing(miss_dps: Callable[[Floats], Floats], low: Floats, high: Floats, start: Floats) -> Floats:
    """``x`` with ``miss_dps(x) = 0``, on the branch that rises from `low` to `high`.

    Secants inside an interval that always holds the crossing, and halving where they are slow: it converges for
    any continuous function that changes its sign in between, and at a jump it finds the jump. A sample without
    a crossing there is looked for beyond the range, as far as the function rises. Nobody's numbers depend on
    his neighbours, so that blocks of any split give the same.

    Parameters
    ----------
    miss_dps : callable
        From x to function values, element by element, deg/s.
    low, high, start : ndarray, shape (n,), deg/s

    Returns
    -------
    ndarray, shape (n,); NaN where there is no crossing
    """
    with np.errstate(all="ignore"):  # a wild sample overflows to NaN, alone
        low, at_low = _followed(miss_dps, low, -FIRST_STEP * (high - low))
        high, at_high = _followed(miss_dps, high, FIRST_STEP * (high - low))
        found = (at_low <= 0) & (at_high >= 0)
        x, slope, moving = np.clip(start, low, high), (at_high - at_low) / (high - low), found
        before, miss_before = np.full_like(x, np.nan), np.full_like(x, np.nan)
        for n in range(SECANTS + HALVINGS):
            miss = miss_dps(x)
            moving = moving & (np.abs(miss) > 0.1 * TOLERANCE_DPS + _LAST_DIGITS * np.abs(x))
            if not moving.any():
                break
            low, high = np.where(miss < 0, x, low), np.where(miss > 0, x, high)
            slope = np.where(np.isnan(before), slope, (miss - miss_before) / (x - before))
            ahead = x - miss / slope
            secant = (ahead >= low) & (ahead <= high) & (n < SECANTS)
            ahead = np.where(secant, ahead, 0.5 * (low + high))
            before, miss_before = np.where(moving, x, before), np.where(moving, miss, miss_before)
            x = np.where(moving, ahead, x)
            moving = moving & (np.abs(x - before) > TOLERANCE_DPS + _LAST_DIGITS * np.abs(x))
    return np.where(found, x, np.nan)


def _followed(miss_dps: Callable[[Floats], Floats], edge: Floats, step: Floats) -> tuple[Floats, Floats]:
    """An edge, moved outward by growing steps until the crossing is inside or the function no longer rises."""
    miss = miss_dps(edge)
    outward = np.sign(step)
    for _ in range(STEPS):
        outside = outward * miss < 0
        if not outside.any():
            break
        ahead = np.where(outside, edge + step, edge)
        miss_ahead = miss_dps(ahead)
        rises = outside & (outward * (miss_ahead - miss) > 0)
        edge, miss = np.where(rises, ahead, edge), np.where(rises, miss_ahead, miss)
        step = np.where(rises, GROWTH * step, 0.0)
    return edge, miss
