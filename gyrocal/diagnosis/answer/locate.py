"""Where a recording departs from the surface alone, and what is left: places as records, no words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.examine import Examination, block_curve
from gyrocal.diagnosis.laws.at_rows import is_of_scale_in_time
from gyrocal.diagnosis.model.layers import NEGLIGIBLE
from gyrocal.diagnosis.model.parts import BIAS_IN_TIME, BLOCKS, EACH_RATE, ODD, SCALE_IN_TIME, SINCE_ON
from gyrocal.diagnosis.result import Located, UnnamedPart
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.sweeps.unclocked import without_clock
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Units of the coordinates; a data set is counted from 1.
_UNITS = {
    "rate": "deg/s",
    "temperature": "degC",
    "temperature_rate": "degC/min",
    "time": "s",
    "data_set_index": "data set",
    "time_since_power_on": "s",
    "supply": "V",
    "time_since_step": "s",
}
#: Stretches of a coordinate that takes many values; a place is told in no finer ones.
_QUANTILES = 25
#: Values nearer than this share of their range are one.
_SAME = 1e-6


def block_p_value(nats: float, blocks: int) -> float:
    """P-value of a variance that is zero without the block, for the best of some blocks.

    At the bound of its range half of the law is at zero (Self and Liang, J. Am. Stat. Assoc. 82, 1987).
    """
    return float(min(1.0, blocks * 0.5 * chi2.sf(2.0 * max(nats, 0.0), 1)))


def coordinate_of(block: str, series: Series) -> str:
    """Coordinate of a block."""
    return coordinate_here(BLOCKS[block].coordinate, series)


def coordinate_here(coordinate: str, series: Series) -> str:
    """A coordinate as a record has it; without times, the number of the data set stands for time."""
    if coordinate == "time_since_power_on" and series.since_power_on_s is None:
        coordinate = "time"
    return series.time_coordinate if coordinate == "time" else coordinate


def located(found: Examination, level: float) -> list[Located]:
    """Coordinates where there is more than the surface and noise, the strongest first."""
    series = found.series
    solution = found.settled.solve()
    curves = {b: block_curve(found.settled, solution, b) for b in found.worth}
    total = sum(float(np.mean(c**2)) for c in curves.values()) or 1.0
    places = []
    for block, nats in sorted(found.worth.items(), key=lambda item: -item[1]):
        p = block_p_value(nats, len(BLOCKS))
        if p > level:
            continue
        share = float(np.mean(curves[block] ** 2)) / total
        remains = block_p_value(_left(found, block), len(BLOCKS)) < level
        if block == BIAS_IN_TIME and remains:
            # A bias that wanders by no law is noise, and is told as such (`engine._noise`).
            continue
        places.append(
            Located(
                coordinate_of(block, series),
                "mean",
                p,
                share,
                remains,
                # Whatever is left of a block is in the model as its smooth part.
                curve=remains,
                target="scale factor" if block == SCALE_IN_TIME else "",
                **stretch(found, block, curves[block]),
            )
        )
    places += _jumps(found)
    for pattern in found.patterns:
        rms = float(np.sqrt(np.mean(pattern.values**2)))
        coordinate = CATALOGUE[pattern.effect].seen_in
        places.append(Located(coordinate, "mean", pattern.p_value, 0.0, False, rms_dps=rms))
    return places


def _explained(found: Examination) -> set[str]:
    """Blocks of which nothing is left by names that stand for no law in the model: errors of each rate, and the sine of an open loop."""
    each_rate = {EACH_RATE} if found.rate_errors_nats else set()
    return each_rate | ({ODD} if found.of_a_sine else set())


def _left(found: Examination, block: str) -> float:
    """What is left of a block, nats: of one that stands in the model for laws which no robot evaluates, what they lack."""
    if block in _explained(found):
        return 0.0
    stood_for = [n for n in found.naming.named if n.block == block and not found.model.holds(n.law)]
    lacking = 1.0 - min(max((n.share for n in stood_for), default=0.0), 1.0)
    return found.naming.unnamed.get(block, 0.0) * lacking


def _jumps(found: Examination) -> list[Located]:
    """Each jump, from its instant to the end of the record."""
    jumps = [n for n in found.naming.named if not n.block]
    amplitudes = found.naming.fitted.solve().amplitudes if jumps else {}
    return [
        place_of(
            CATALOGUE[jump.law.effect],
            jump.law.shape,
            jump.law.columns @ amplitudes[jump.law.name],
            found.series,
            jump.p_value,
        )
        for jump in jumps
    ]


def place_of(
    effect: Effect, shape: Mapping[str, float], added_dps: Floats, series: Series, p_value: float
) -> Located:
    """Where a law acts, by what it adds to the rows: one that jumps from its instant on, others all along."""
    coordinate = coordinate_here(effect.seen_in, series)
    on_scale = bool(shape.get("of_scale")) or is_of_scale_in_time(effect)
    place = Located(
        coordinate,
        "mean",
        p_value,
        1.0,
        target="scale factor" if on_scale else "",
        rms_dps=float(np.sqrt(np.mean(added_dps**2))),
    )
    if "at_s" not in shape:
        return place
    low, high = shape["at_s"], float(series.t_s[-1])
    if coordinate != "time":
        low, high = series.data_set_at(low), series.data_set_at(high)
    return replace(place, low=low, high=high, unit=_UNITS[coordinate])


def stretch(found: Examination, block: str, curve: Floats) -> dict[str, Any]:
    """Where on its coordinate a block's curve is largest: the range with half of its power."""
    means, coordinate = found.whole.model.means, coordinate_of(block, found.series)
    values = {
        "rate": means.rate_dps,
        "temperature": means.temp_c,
        "temperature_rate": means.spread(found.series.temp_rate_c_per_min),
        "time": means.t_s,
        "data_set_index": means.set_index.astype(np.float64) + 1.0,
        "time_since_power_on": means.since_power_on_s,
        "supply": means.supply_v,
        # Rows see all the steps before them.
        "time_since_step": None,
    }[coordinate]
    rms = {"rms_dps": float(np.sqrt(np.mean(curve**2))), "unit": _UNITS[coordinate]}
    if values is None or np.ptp(values) == 0:
        return rms
    bins, lows, highs = binned(values)
    power = np.bincount(bins, curve**2) / np.bincount(bins)
    first = last = int(np.argmax(power))
    while first > 0 and power[first - 1] > 0.5 * power.max():
        first -= 1
    while last < power.size - 1 and power[last + 1] > 0.5 * power.max():
        last += 1
    if first == 0 and last == power.size - 1:
        return rms
    return {**rms, "low": float(lows[first]), "high": float(highs[last])}


def binned(values: Floats) -> tuple[Ints, Floats, Floats]:
    """Bin of each value, and the least and largest value in each: levels by themselves where there are few of them."""
    order = np.argsort(values, kind="stable")
    new = np.diff(values[order], prepend=-np.inf) > _SAME * np.ptp(values)
    level = np.cumsum(new) - 1
    ranked = values[order][new][level]
    bins = level if level[-1] < _QUANTILES else np.arange(values.size) * _QUANTILES // values.size
    first, last = (np.searchsorted(bins, np.arange(bins[-1] + 1), side) for side in ("left", "right"))
    where = np.empty(values.size, dtype=np.int64)
    where[order] = bins
    return where, ranked[first], ranked[last - 1]


def unnamed(found: Examination, level: float, withheld: Sequence[str]) -> tuple[UnnamedPart, ...]:
    """Structure that stays without a name, the strongest first.

    Parameters
    ----------
    withheld : blocks that are not in the correction
    """
    fitted = found.naming.fitted
    solution = fitted.solve()
    named = {n.block for n in found.naming.named}
    passed = {b for n, b in fitted.model.blocks.items() if n in without_clock(fitted.model)}
    passed |= set() if found.comes_again > 0.5 else {SINCE_ON}
    least_dps = NEGLIGIBLE * float(np.std(solution.left))
    told = {*named, BIAS_IN_TIME, *_explained(found)}
    parts = []
    for block, nats in sorted(found.naming.unnamed.items(), key=lambda item: -item[1]):
        if block in told or block_p_value(nats, len(BLOCKS)) > level:
            continue
        place = stretch(found, block, block_curve(fitted, solution, block))
        if place["rms_dps"] < least_dps:
            continue
        parts.append(
            UnnamedPart(
                coordinate_of(block, found.series),
                BLOCKS[block].family,
                nats,
                place["rms_dps"],
                place.get("low"),
                place.get("high"),
                place["unit"],
                found.naming.nearest.get(block, {}),
                BLOCKS[block].stays and block not in (*withheld, *passed),
            )
        )
    return tuple(parts)
