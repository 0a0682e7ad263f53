"""Fixes of a truth that cannot be: one far off its neighbours, and zeros before the first one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.inference.runs import runs_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A fix is wild where it leaps by so many times what fixes mostly leap by beyond the way, and by so much, m: there and back, or away
#: from a start or an end. Receivers jump by metres as satellites come and go, and stay there, which is no leap there and back.
_TIMES, _BACK_M, _AWAY_M = 20.0, 1.0, 10.0
#: A position that stands to the last digit for so long, s, while the wheels go so many times what they mostly go from one fix to the
#: next, and so far, m, is no fix: a receiver that is slower than the log repeats each for as long as any other.
_FROZEN_S, _FROZEN_M = 5.0, 2.0
#: Of fewer nobody knows what is usual.
_FEWEST = 10


def wild_fixes(x_m: Floats, y_m: Floats, way_m: Floats) -> Bools:
    """Rows of fixes from which the robot would have had to leap, there and back, or away from at the start.

    A fix that stands in several rows, as of a receiver that is slower than the log, is one.

    Parameters
    ----------
    x_m, y_m : ndarray, shape (n,)
        NaN where there is none.
    way_m : ndarray, shape (n,)
        Way of the robot up to each row.

    Returns
    -------
    ndarray, shape (n,)
    """
    wild = np.zeros(x_m.size, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    if known.size < _FEWEST:
        return wild
    here = x_m[known] + 1j * y_m[known]
    fix = np.cumsum(np.append(0.0, np.abs(np.diff(here))) > 0.0)
    first = np.flatnonzero(np.diff(fix, prepend=-1))
    if first.size < _FEWEST:
        return wild
    at, way = here[first], way_m[known][first]

    def leaps(rows: int) -> Floats:
        """Beyond the way, from each fix to one some rows later, shape (fixes - rows,)."""
        return np.asarray(np.abs(at[rows:] - at[:-rows]) - (way[rows:] - way[:-rows]))

    one, over = leaps(1), leaps(2)
    # Where a path winds, most lie closer than the way between them, and what is beyond it is nothing in the median.
    usual_m = _TIMES * float(np.median(np.abs(one)))
    back_m, away_m = max(usual_m, _BACK_M), max(usual_m, _AWAY_M)
    alone = np.zeros(at.size, dtype=np.bool_)
    alone[1:-1] = (one[:-1] > back_m) & (one[1:] > back_m) & (over <= back_m)
    far = one > away_m
    # At either end there is one neighbour, which has to agree with the next.
    alone[0], alone[-1] = far[0] and not far[1], far[-1] and not far[-2]
    wild[known] = alone[fix]
    return wild


def frozen_fixes(t_s: Floats, x_m: Floats, y_m: Floats, way_m: Floats) -> Bools:
    """Rows behind the first of a fix that stands still to the last digit while the robot drives; arrays as in `wild_fixes`."""
    frozen = np.zeros(x_m.size, dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    if known.size < _FEWEST:
        return frozen
    here = x_m[known] + 1j * y_m[known]
    first = np.flatnonzero(np.diff(here, prepend=np.nan) != 0.0)
    last = np.append(first[1:], known.size) - 1
    t, way = t_s[known], way_m[known]
    next_m = np.diff(way[first])
    going_m = next_m[next_m > 0.0]
    if going_m.size < _FEWEST:
        return frozen
    least_m = max(_TIMES * float(np.median(going_m)), _FROZEN_M)
    for a, b in zip(first, last, strict=True):
        if t[b] - t[a] > _FROZEN_S and way[b] - way[a] > least_m:
            frozen[known[a + 1 : b + 1]] = True
    return frozen


def no_fixes(t_s: Floats, x_m: Floats, y_m: Floats, way_m: Floats) -> tuple[Bools, tuple[str, ...]]:
    """Rows whose truth is none, shape (n,), and what is said of them; arrays as in `wild_fixes`."""
    wild, frozen = wild_fixes(x_m, y_m, way_m), frozen_fixes(t_s, x_m, y_m, way_m)
    said = [wild_said(wild, t_s)] if wild.any() else []
    return wild | frozen, (*said, *_frozen_said(frozen, t_s, way_m))


def _frozen_said(frozen: Bools, t_s: Floats, way_m: Floats) -> tuple[str, ...]:
    if not frozen.any():
        return ()
    rows = np.flatnonzero(frozen)
    each = [
        f"{t_s[r[0] - 1]:.0f} to {t_s[r[-1]]:.0f} ({way_m[r[-1]] - way_m[r[0] - 1]:.3g} m)"
        for r in runs_of(rows)
    ]
    return (
        f"{rows.size} of the truth's rows are left out: its position stands still to the last digit while the wheels go on, from t_s = {', '.join(each)}",
    )


def wild_said(wild: Bools, t_s: Floats) -> str:
    """What was set aside, in words."""
    rows = np.flatnonzero(wild)
    return (
        f"{rows.size} of the truth's rows {'is' if rows.size == 1 else 'are'} set aside (the first at {t_s[rows[0]]:.6g} s): the wheels never "
        "went as far as it leaps there"
    )
