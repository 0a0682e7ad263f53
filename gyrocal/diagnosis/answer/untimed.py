"""A table without time stamps: its times are made up, so what depends on them is stated in data sets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.rows.order import SURROGATE_PERIOD_S
from gyrocal.diagnosis.rows.series import Series
from gyrocal.physics.timewise import growth
from gyrocal.units import S_PER_H, S_PER_MIN

#: An interval that ends this little behind a data set ends at it.
_ON_THE_SET = 0.05
#: Ends of units: in time, in data sets, and the factor from the one to the other.
_PER_TIME = (
    ("per degC/min", "per degC a data set", S_PER_MIN / SURROGATE_PERIOD_S),
    ("/h", " a data set", SURROGATE_PERIOD_S / S_PER_H),
)
#: Instants and what they are called in data sets, which count from one.
_INSTANTS = {"at_s": "at_data_set", "from_s": "from_data_set"}
#: Spans of time and what they are called in data sets.
_SPANS = {"tau_s": "tau_data_sets", "knee_s": "knee_data_sets"}


def by_data_set(series: Series, parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Parameters of an effect as the record can state them: times and rates of change in data sets if it has no time."""
    if series.has_time:
        return dict(parameters)
    found: dict[str, Estimate] = {}
    for name, e in parameters.items():
        if name in _INSTANTS:
            low, high = map(series.data_set_at, e.interval_95)
            found[_INSTANTS[name]] = Estimate.spanning(series.data_set_at(e.value), (low, high), "1")
        elif name in _SPANS:
            found[_SPANS[name]] = _scaled(e, 1.0 / SURROGATE_PERIOD_S, "data sets")
        else:
            found[name] = _per_set(e, {n: p.value for n, p in parameters.items()})
    return found


def by_time(parameters: Mapping[str, Estimate]) -> dict[str, float]:
    """Values of `by_data_set` in the catalogue's units again, for its laws."""
    found = {
        in_s: parameters[in_sets].value * SURROGATE_PERIOD_S
        for in_s, in_sets in _SPANS.items()
        if in_sets in parameters
    }
    found |= {
        in_s: (parameters[in_set].value - 1.0) * SURROGATE_PERIOD_S
        for in_s, in_set in _INSTANTS.items()
        if in_set in parameters
    }
    shape = {name: e.value for name, e in parameters.items()} | found
    for name, e in parameters.items():
        if name not in (*_SPANS.values(), *_INSTANTS.values()):
            factors = [_grown(factor, shape) for _, per_set, factor in _PER_TIME if e.unit.endswith(per_set)]
            found[name] = e.value / next(iter(factors), 1.0)
    return found


def between_sets(parameters: Mapping[str, Estimate]) -> Remark | None:
    """The data sets that a jump lies between, for what the interval allows; None for what is no jump."""
    at = parameters.get("at_data_set")
    if at is None:
        return None
    first = int(np.floor(at.interval_95[0]))
    last = max(int(np.ceil(at.interval_95[1] - _ON_THE_SET)), first + 1)
    return Remark(Said.BETWEEN_SETS, {"first": first, "last": last})


def _per_set(e: Estimate, shape: Mapping[str, float]) -> Estimate:
    for per_time, per_set, factor in _PER_TIME:
        if e.unit.endswith(per_time):
            return _scaled(e, _grown(factor, shape), e.unit.removesuffix(per_time) + per_set)
    return e


def _grown(factor: float, shape: Mapping[str, float]) -> float:
    """Size in data sets over that in time: of a drift each is what has grown after one unit."""
    return float(growth(np.array([factor * S_PER_H]), {"power": 1.0, **shape, "from_s": 0.0})[0])


def _scaled(e: Estimate, factor: float, unit: str) -> Estimate:
    low, high = (x * factor for x in e.interval_95)
    return Estimate(e.value * factor, e.std * factor, unit, (low, high))
