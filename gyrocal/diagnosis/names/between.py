"""What follows the table angle from one data set to the next.

A set that turns through a part of a turn only has most of such a pattern in its mean, beside the surface and all noise of
the means. Within the set it is hardly told from a slow change.

References
----------
Fisher, Statistical Methods for Research Workers (1932): one probability from two independent ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.laws.in_place import by_chance
from gyrocal.diagnosis.model.layers import Fitted
from gyrocal.diagnosis.model.within import Pattern, kind_of, tested_alone
from gyrocal.diagnosis.rows.means import Means

Floats = NDArray[np.float64]


def between_sets(fitted: Fitted, known: Sequence[Pattern], level: float) -> Pattern | None:
    """The further pattern of the table angle that data sets show most surely, within and between them together; None where none does.

    Of 204 that were not there (runs by another author) 3 % had a probability below 0.05, and none one below 0.01.
    Between them it is tested by what is not the same at each rate: there it could be a shape in the rate. What one tells and
    the other denies is as improbable by chance, and is none: both together have to be sure of its amplitude.

    Parameters
    ----------
    fitted : a run with all that its means may have, less the patterns that are known
    level : rate of false alarms over all patterns together
    """
    means = fitted.model.means
    found = {kind_of(p) for p in known}
    candidates = [p for p in tested_alone(means.series) if kind_of(p) not in found]
    if not candidates:
        return None
    score, precision = fitted.contrasts.precision(fitted.model.all, fitted.fit.log_variance)
    rates = np.round(means.rate_dps, 2)
    each_rate = (rates[:, None] == np.unique(rates)).astype(np.float64)
    tested = [_with_means(p, means, each_rate, score, precision) for p in candidates]
    sure = [p for p in tested if p.p_value * len(tested) <= level and p.is_sure]
    return min(sure, key=lambda p: p.p_value, default=None)


def _with_means(
    within: Pattern,
    means: Means,
    each_rate: Floats,
    score: Floats,
    precision: Floats,
) -> Pattern:
    """The pattern as both tell of it: within sets, and between them beside a model of their means."""
    rows = np.column_stack([means.spread(x) for x in within.columns.T])
    shown = rows - each_rate @ np.linalg.lstsq(each_rate, rows, rcond=None)[0]
    information = shown.T @ precision @ shown
    pull = shown.T @ score
    between = np.linalg.pinv(information, hermitian=True) @ pull
    by_means = by_chance(0.5 * float(between @ pull), pull.size)
    both = np.log(np.maximum([within.p_value, by_means], np.finfo(np.float64).tiny))
    p = float(chi2.sf(-2.0 * np.sum(both), 4))
    inside = np.linalg.pinv(within.covariance, hermitian=True)
    covariance = np.asarray(np.linalg.pinv(inside + information, hermitian=True))
    amplitudes = covariance @ (inside @ within.amplitudes + information @ between)
    dof = within.dof + np.count_nonzero(means.is_set)
    return replace(within, amplitudes=amplitudes, covariance=covariance, p_value=p, dof=dof)
