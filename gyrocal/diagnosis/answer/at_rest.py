"""Bias over temperature of a record at one rate: whether it follows the temperature alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import Examination, block_curve
from gyrocal.diagnosis.model.parts import BIAS_IN_TIME, MEMORY, SINCE_ON, Basis
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.means import rows_of
from gyrocal.diagnosis.rows.series import Series

Floats = NDArray[np.float64]

#: Over less the question is not put, degC: both branches lie in a stretch or two.
_LEAST_SPAN_C = 10.0
#: Heating and cooling are compared in so many stretches of temperature, where either has this many rows at the least
#: and moves faster than a soak does.
_STRETCHES, _FEWEST_ROWS, _MOVING_C_PER_MIN = 20, 5, 0.1
#: Evidence that something else than the temperature moves the bias, nats: odds of 150; and the blocks that say so.
_HISTORY_NATS = 5.0
_NO_TEMPERATURE = (MEMORY, SINCE_ON, BIAS_IN_TIME)


def temperature_alone(found: Examination) -> tuple[Remark, ...]:
    """For a record at one rate: is bias a function of temperature alone? Empty where that is no question."""
    series = found.series
    if np.ptp(series.rate_dps) > 0 or np.ptp(series.temp_c) < _LEAST_SPAN_C:
        return ()
    named = [n for n in found.naming.named if n.block in ("", *_NO_TEMPERATURE)]
    if not named and max(found.worth.get(block, 0.0) for block in _NO_TEMPERATURE) < _HISTORY_NATS:
        return (Remark(Said.TEMPERATURE_ALONE),)
    fitted = found.naming.fitted
    solution = fitted.solve()
    rows = Basis(rows_of(series), fitted.model.basis.frame)
    curves = [block_curve(fitted, solution, b, rows) for b in _NO_TEMPERATURE]
    whose = rows.means.group_of(fitted.model.means)
    laws = [n.law for n in named if n.law.name in solution.amplitudes]
    curves += [(law.columns @ solution.amplitudes[law.name])[whose] for law in laws]
    left = np.sum(curves, axis=0)
    gap = _branch_gap(series, left)
    facts = {
        "left_mdps": 1e3 * float(np.std(left)),
        "branches_mdps": None if gap is None else 1e3 * gap,
    }
    return (Remark(Said.NOT_TEMPERATURE_ALONE, facts),)


def _branch_gap(series: Series, left: Floats) -> float | None:
    """Difference between heating and cooling at the same temperature, rms over the temperatures of both, deg/s."""
    edges = np.linspace(series.temp_c.min(), series.temp_c.max(), _STRETCHES + 1)
    bins = np.clip(np.searchsorted(edges, series.temp_c, side="right") - 1, 0, _STRETCHES - 1)
    means = []
    rate = series.temp_rate_c_per_min
    for up in (rate > _MOVING_C_PER_MIN, rate < -_MOVING_C_PER_MIN):
        count = np.bincount(bins[up], minlength=_STRETCHES)
        total = np.bincount(bins[up], weights=left[up], minlength=_STRETCHES)
        means.append(np.where(count >= _FEWEST_ROWS, total / np.maximum(count, 1), np.nan))
    gap = means[0] - means[1]
    return float(np.sqrt(np.nanmean(gap**2))) if np.isfinite(gap).any() else None
