"""A table without time stamps: its times are made up, so what depends on them is stated in data sets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.series import SURROGATE_PERIOD_S, Series
from gyrocal.units import S_PER_H, S_PER_MIN

#: An interval that ends this little behind a data set ends at it.
_ON_THE_SET = 0.05
#: Ends of units: in time, in data sets, and the factor from the one to the other.
_PER_TIME = (
    ("per degC/min", "per degC a data set", S_PER_MIN / SURROGATE_PERIOD_S),
    ("/h", " a data set", SURROGATE_PERIOD_S / S_PER_H),
)


def by_data_set(series: Series, parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Parameters of an effect as the record can state them: times and rates of change in data sets if it has no time."""
    if series.has_time:
        return dict(parameters)
    found: dict[str, Estimate] = {}
    for name, e in parameters.items():
        if name == "at_s":
            found["at_data_set"] = _scaled(e, 1.0 / SURROGATE_PERIOD_S, 1.0, "1")
        elif name == "tau_s":
            found["tau_data_sets"] = _scaled(e, 1.0 / SURROGATE_PERIOD_S, 0.0, "data sets")
        else:
            found[name] = _per_set(e, _power(parameters))
    return found


def by_time(parameters: Mapping[str, Estimate]) -> dict[str, float]:
    """Values of `by_data_set` in the catalogue's units again, for its laws."""
    found = {}
    for name, e in parameters.items():
        if name == "at_data_set":
            found["at_s"] = (e.value - 1.0) * SURROGATE_PERIOD_S
        elif name == "tau_data_sets":
            found["tau_s"] = e.value * SURROGATE_PERIOD_S
        else:
            factors = [factor for _, per_set, factor in _PER_TIME if e.unit.endswith(per_set)]
            found[name] = e.value / next(iter(factors), 1.0) ** _power(parameters)
    return found


def between_sets(parameters: Mapping[str, Estimate]) -> Remark | None:
    """The data sets that a jump lies between, for what the interval allows; None for what is no jump."""
    at = parameters.get("at_data_set")
    if at is None:
        return None
    first = int(np.floor(at.interval_95[0]))
    last = max(int(np.ceil(at.interval_95[1] - _ON_THE_SET)), first + 1)
    return Remark(Said.BETWEEN_SETS, {"first": first, "last": last})


def _per_set(e: Estimate, power: float) -> Estimate:
    for per_time, per_set, factor in _PER_TIME:
        if e.unit.endswith(per_time):
            return _scaled(e, factor**power, 0.0, e.unit.removesuffix(per_time) + per_set)
    return e


def _power(parameters: Mapping[str, Estimate]) -> float:
    """Of time, by which a drift grows: its size is that after one unit of time."""
    power = parameters.get("power")
    return 1.0 if power is None else power.value


def _scaled(e: Estimate, factor: float, offset: float, unit: str) -> Estimate:
    low, high = (x * factor + offset for x in e.interval_95)
    return Estimate(e.value * factor + offset, e.std * factor, unit, (low, high))
