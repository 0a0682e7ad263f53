"""Recursions over irregular time steps, and random draws that any split of a record repeats.

The loops are plain Python; long blocks run compiled where numba is installed, with the same arithmetic
in the same order and so the same numbers.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Between two samples there is a pause where they are farther apart than this, s, and than so many times those before.
PAUSE_S, PAUSE_STEPS = 180.0, 4.0

#: Blocks shorter than this are not worth the import of numba (a second); where it is imported already, these.
_LONG_BLOCK = 500_000
_SHORT_BLOCK = 1000


@functools.cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` compiled by numba where it is installed, itself otherwise."""
    try:
        import numba
    except ImportError:
        return function
    try:
        machine: Callable[..., Any] = numba.njit(cache=True)(function)
    except RuntimeError:  # nowhere to keep the cache: a read-only installation
        machine = numba.njit(function)
    return machine


def _run(loop: Callable[..., Any], block: int, *arguments: Any) -> Any:
    worthwhile = _SHORT_BLOCK if "numba" in sys.modules else _LONG_BLOCK
    if block >= worthwhile:
        return compiled(loop)(*arguments)
    *given, out = arguments
    # Python reads a list several times faster than an array.
    return loop(*(a.tolist() if isinstance(a, np.ndarray) else a for a in given), out)


def _lag_loop(decay: Floats, gain: Floats, values: Floats, last: float, behind: float, out: Floats) -> Any:
    for k in range(len(values)):
        if values[k] != values[k]:  # NaN
            out[k] = np.nan
        else:
            behind = decay[k] * behind + gain[k] * (values[k] - last)
            last = values[k]
            out[k] = behind
    return last, behind


#: Time and value of the last good sample, and how far the low-passed value is behind it.
LagMemory = tuple[float, float, float]


def lag(
    t_s: Floats, values: Floats, tau_s: float, memory: LagMemory | None
) -> tuple[Floats, LagMemory | None]:
    """How far a first-order lag follows behind: ``x - y`` with ``tau dy/dt = x - y``.

    Exact for an input that is linear between samples, whatever their spacing; so it is right for samples at
    100 Hz and for a table with a row a minute alike. At rest at the start. Values and times that are not finite
    are passed over (NaN out), and the recursion goes on at the next good one.

    Parameters
    ----------
    t_s, values : ndarray, shape (n,)
    tau_s : float, s
    memory : what the call before returned, None at the start

    Returns
    -------
    behind : ndarray, shape (n,)
    memory : for the next block
    """
    values = np.where(np.isfinite(values) & np.isfinite(t_s), values, np.nan)
    good = np.flatnonzero(~np.isnan(values))
    if good.size == 0:
        return np.full(values.size, np.nan), memory
    start_t, last, behind = (t_s[good[0]], values[good[0]], 0.0) if memory is None else memory
    step = np.zeros(values.size)
    step[good] = np.maximum(np.diff(t_s[good], prepend=start_t), 0.0) / tau_s
    decay = np.exp(-step)
    safe = np.where(step > 0, step, 1.0)
    gain = np.where(step > 0, -np.expm1(-step) / safe, 1.0)
    out = np.empty(values.size)
    last, behind = _run(_lag_loop, values.size, decay, gain, values, float(last), float(behind), out)
    return out, (float(t_s[good[-1]]), float(last), float(behind))


#: Of the squares of the rate, and how far the sample before the last good one was.
HeatMemory = tuple[LagMemory, float]


def heat(
    t_s: Floats, rate_dps: Floats, tau_s: float, memory: HeatMemory | None
) -> tuple[Floats, HeatMemory | None]:
    """What is left of the squares of past rates, ``tau dh/dt = w^2 - h``: of the heat that turning makes.

    Exact for squares that are linear between samples, as `lag` is; cold before the first sample. In a pause (`PAUSE_S`,
    `PAUSE_STEPS`) it stood, but for half of the usual step at both of its ends: samples may be means of data sets.

    Returns
    -------
    h : ndarray, shape (n,), deg^2/s^2; NaN where rate or time are not finite, which are passed over
    memory : for the next block
    """
    squares = np.square(rate_dps)
    out = np.full(squares.size, np.nan)
    good = np.flatnonzero(np.isfinite(squares) & np.isfinite(t_s))
    if good.size == 0:
        return out, memory
    t, own = t_s[good], squares[good]
    last, step_before_s = memory or ((float(t[0]), 0.0, 0.0), 0.0)
    before_t, before = np.append(last[0], t[:-1]), np.append(last[1], own[:-1])
    step_s = t - before_t
    usual_s = np.append(step_before_s, step_s[:-1])
    paused = np.flatnonzero((usual_s > 0.0) & (step_s > np.maximum(PAUSE_S, PAUSE_STEPS * usual_s)))
    still, turned_s = np.zeros(paused.size), 0.5 * usual_s[paused]
    ends_s = [before_t[paused] + turned_s, t[paused] - turned_s]
    times = np.column_stack([ends_s[0], ends_s[0], ends_s[1], ends_s[1]])
    values = np.column_stack([before[paused], still, still, own[paused]])
    at = np.repeat(paused, 4)
    behind, after = lag(np.insert(t, at, times.ravel()), np.insert(own, at, values.ravel()), tau_s, last)
    rows = np.arange(t.size)
    out[good] = own - behind[rows + 4 * np.searchsorted(paused, rows, side="right")]
    return out, (after or last, float(step_s[-1]))


def _play_loop(values: Floats, half_width: float, position: float, out: Floats) -> Any:
    for k in range(len(values)):
        if values[k] != values[k]:  # NaN
            out[k] = np.nan
        else:
            position = max(values[k] - half_width, min(values[k] + half_width, position))
            out[k] = position
    return position


def play(values: Floats, half_width: float, position: float | None) -> tuple[Floats, float | None]:
    """Play operator (backlash) of the given half width, at rest in its middle at the start.

    Values that are not finite are passed over, as in `lag`. Returns the positions, shape (n,), and the last one.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    good = np.flatnonzero(~np.isnan(values))
    if good.size == 0:
        return np.full(values.size, np.nan), position
    out = np.empty(values.size)
    first = float(values[good[0]]) if position is None else position
    return out, float(_run(_play_loop, values.size, values, half_width, first, out))


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Steele, Lea and Flood's splitmix64 finaliser: 64 well-mixed bits from a counter."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


def uniform(seed: float, stream: int, keys: Floats) -> Floats:
    """A draw in (0, 1) for each key (rounded to whole numbers): the same key, the same draw, in any order."""
    start = _mix(np.array([int(seed)], dtype=np.int64).view(np.uint64)) ^ np.uint64(stream)
    bits = _mix(_mix(start) ^ _mix(np.rint(keys).astype(np.int64).view(np.uint64)))
    return np.asarray(((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)


def normal(seed: float, stream: int, keys: Floats) -> Floats:
    """A standard normal draw for each key, by Box and Muller's transform of two `uniform` ones."""
    radius = np.sqrt(-2.0 * np.log(uniform(seed, 2 * stream, keys)))
    return np.asarray(radius * np.cos(2.0 * np.pi * uniform(seed, 2 * stream + 1, keys)))


def erf(x: Floats) -> Floats:
    """The error function, element by element: numpy has none, and a robot has no scipy."""
    return np.fromiter(map(math.erf, x.tolist()), dtype=np.float64, count=x.size)
