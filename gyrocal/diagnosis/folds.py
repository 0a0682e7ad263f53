"""What is left out together: interleaved data sets, then whole temperatures or sweeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.means import Means

Ints = NDArray[np.int64]

#: Every eighth segment is left out at a time: 88 % of the record are left to predict it from.
_FOLDS = 8
#: Stretches that stand for segments in a record of few: five to a fold, so that no fold is a single hole.
_STRETCHES = 40
#: Data sets from which on whole temperatures are left out too: four at each of three temperatures.
_FEWEST_SETS = 12
#: Neighbouring data sets farther apart are at another temperature, degC: more than a sweep drifts by, less than plans step.
_LEAST_JUMP_C = 3.0


def fold_numbers(means: Means) -> list[Ints]:
    """Rows of the means that are left out together, each row at least once."""
    unit = _units(means)
    numbers = np.unique(unit)
    folds = [np.flatnonzero(np.isin(unit, numbers[k::_FOLDS])) for k in range(_FOLDS)]
    return [f for f in folds if f.size] + _sweeps(means)


def _units(means: Means) -> Ints:
    """What is left out together at the least: a segment, or a stretch of time in a record of few segments."""
    if np.unique(means.set_index).size >= _FOLDS:
        return means.set_index
    share = (means.t_s - means.t_s[0]) / max(float(np.ptp(means.t_s)), 1e-9)
    return np.asarray(np.minimum(share * _STRETCHES, _STRETCHES - 1), dtype=np.int64)


def _sweeps(means: Means) -> list[Ints]:
    """Groups of neighbouring data sets at one temperature: a ramp or a jump begins a new one."""
    rows = np.flatnonzero(means.is_set)
    if rows.size < _FEWEST_SETS or np.ptp(means.rate_dps) == 0:
        return []
    jumps = np.abs(np.diff(means.temp_c[rows])) > _LEAST_JUMP_C
    groups = np.split(rows, np.flatnonzero(jumps | (np.diff(rows) > 1)) + 1)
    groups = [g for g in groups if g.size >= 3]
    return groups if 3 <= len(groups) <= 20 else []
