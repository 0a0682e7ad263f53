"""Numbers and places in words: rounded to what is known of them, never "nan", no ids where a reader needs a phrase."""

from __future__ import annotations

import math

from gyrocal.diagnosis.result import Estimate, Located
from gyrocal.units import S_PER_H, decimals

#: More decimals than this are read as a power of ten.
_MOST_DECIMALS = 6
#: Larger logarithms of odds are a matter of what was assumed of the noise, not of the data: a million to one.
_MOST_NATS = 6.0 * math.log(10.0)
_NEARLY_ONE = 0.1
#: A stretch that begins within this share of its length from zero begins at zero.
_NEARLY = 0.05
#: Coordinates in seconds that are read in hours, where they come to so many.
_LEAST_H = 0.5
_IN_HOURS = ("time", "time_since_power_on", "data_set_index")
#: What a located excess follows, as a reader would call it; empty where the place says it all.
_CURVES = {
    "bias": "",
    "mean": "",
    "instant": "",
    "lagged": "with a lag",
    "constant": "alike at all rates",
    "scale factor": "in proportion to the rate",
    "by temperature": "changing with temperature",
    "with temperature": "changing with temperature",
    "growing with rate": "growing with the rate",
    "per step": "in proportion to the step of the rate",
    "memory of past rates": "after-effect of earlier rates",
}
#: What departs, where it is no curve on a coordinate, and what its size is.
_TARGETS = {
    "surface": "the error surface itself is not the one given{}; fit again",
    "walk": "the bias walks at random{}",
    "output": "data sets whose output is exactly 0",
    "data sets": "single data sets that do not belong to the rest",
    "samples": "single samples",
    "sample times": "arrival times of all samples",
    "rest": "the table at rest",
    "way": "by whether a rate was reached from below or from above{}",
}


def fixed(value: float, places: int) -> str:
    """`value` at so many decimals (negative: tens, hundreds); "not known" where it is not finite."""
    if not math.isfinite(value):
        return "not known"
    value = round(value, places) + 0.0
    if value != 0 and places > _MOST_DECIMALS:
        return f"{value:.{max(places + math.floor(math.log10(abs(value))), 0)}e}"
    return f"{value:.{max(places, 0)}f}"


def value_text(e: Estimate) -> str:
    """A parameter to the digits that its interval has, with its unit; a plain number has none."""
    low, high = e.interval_95
    text = _of_sign(e.value, e) if low < high else f"{e.value:.4g}"
    if not math.isfinite(e.value):
        return "not known"
    return text if e.unit == "1" else f"{text} {e.unit}"


def interval_text(e: Estimate) -> str:
    """A parameter's 95 % interval, to the digits of the value."""
    low, high = e.interval_95
    if not low < high:
        return "chosen, not estimated"
    if e.at_bound:
        return f"from {_of_sign(low, e)} on" if math.isinf(high) else f"up to {_of_sign(high, e)}"
    return f"{_of_sign(low, e)} to {_of_sign(high, e)}"


def _of_sign(value: float, e: Estimate) -> str:
    """A number to the digits of the interval on its side, and never as 0 where the interval has numbers of one sign."""
    low, high = e.interval_95
    # Of an interval that is open on one side, or begins at the value, the other one tells.
    sides = [side for side in (e.value - low, high - e.value) if 0.0 < side < math.inf]
    own = abs(value - e.value)
    if own not in sides:
        own = min(sides, default=0.0)
    # An end at zero has no digits of its own.
    places = decimals(own if value else max(sides, default=0.0))
    if low * high >= 0 and math.isfinite(value) and value and round(value, places) == 0:
        return f"{value:.2g}"
    return fixed(value, places)


def estimate_text(e: Estimate) -> str:
    """Value with unit and, where it was estimated, its interval."""
    low, high = e.interval_95
    if e.at_bound:
        least = "at least" if math.isinf(high) else "at most"
        return f"{least} {value_text(e)}, the bound of the catalogue (95 %: {interval_text(e)})"
    return f"{value_text(e)} (95 %: {interval_text(e)})" if low < high else value_text(e)


def times_text(nats: float) -> str:
    """By how much a logarithm of odds makes something likelier: ``1.015``, ``38``, ``more than 1,000,000``."""
    if nats > _MOST_NATS:
        return f"more than {math.exp(_MOST_NATS):,.0f}"
    times = math.exp(nats)
    if abs(times - 1.0) < _NEARLY_ONE:
        return f"{times:.3f}"
    return f"{times:.2g}" if times < 100.0 else f"{float(f'{times:.2g}'):,.0f}"


def range_text(low: float, high: float, scale: float = 1.0) -> str:
    """An interval whose ends have the digits of its half width."""
    places = decimals(0.5 * scale * (high - low))
    return f"{fixed(scale * low, places)} to {fixed(scale * high, places)}"


def span_text(low: float, high: float) -> str:
    """A stretch of a coordinate, its ends to two digits of its length; a beginning that is nearly zero is 0."""
    places = decimals(high - low)
    if 0.0 < low < _NEARLY * (high - low):
        low = 0.0
    ends = (fixed(end, places) for end in (low, high))
    return " to ".join("0" if float(end) == 0 else end for end in ends)


def region_words(place: Located) -> str:
    """Where a place is on its coordinate and what departs there."""
    if place.times_given is not None:
        return f"noise {place.times_given:.2g} times what was given"
    # Two digits, never as a power of ten.
    size = "" if place.rms_dps is None else f"{float(f'{1e3 * place.rms_dps:.2g}'):g} mdeg/s rms"
    where = stretch_words(place)
    if place.target in _TARGETS:
        said = _TARGETS[place.target].format(f" ({size})" if size else "")
        return f"{said}, {where}" if where else said
    where = where or ("all along" if size else "everywhere")
    inside = [part for part in (_CURVES.get(place.target, place.target), size) if part]
    return f"{where} ({'; '.join(inside)})" if inside else where


def stretch_words(place: Located) -> str:
    """The stretch that a place takes, with its unit; empty where it is all along."""
    if place.low is None or place.high is None:
        return ""
    if place.unit == "data set":
        first, last = round(place.low), round(place.high)
        return f"data set {first}" if first == last else f"data sets {first} to {last}"
    unit, low, high = place.unit, place.low, place.high
    if place.coordinate in _IN_HOURS and high >= _LEAST_H * S_PER_H:
        unit, low, high = "h", low / S_PER_H, high / S_PER_H
    return f"at {low:g} {unit}" if low == high else f"{span_text(low, high)} {unit}"


def place_words(place: Located, coordinate: str) -> str:
    """The same in a sentence, behind the name of its coordinate."""
    region = region_words(place)
    if place.low is None:
        return f"{coordinate}: {region}"
    if place.unit == "data set":
        return region if place.coordinate == "data_set_index" else f"{coordinate}: {region}"
    return f"{coordinate} {region}"


def coordinate_words(coordinate: str) -> str:
    """A coordinate of the formats as it is read."""
    return coordinate.replace("_", " ").replace("power on", "power-on")


def parameter_words(name: str) -> str:
    """A parameter without the unit in its name, which stands behind its value."""
    for unit in ("_rad_per_dps", "_data_sets", "_dps", "_rad", "_hz", "_s", "_c"):
        if name.endswith(unit):
            return name.removesuffix(unit).replace("_", " ")
    return name.replace("_", " ")


def listed(things: list[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return things[0] if len(things) == 1 else f"{', '.join(things[:-1])} and {things[-1]}" if things else ""


def part_words(log: str | None, from_share: float) -> str:
    """Which log, or which part of this one, the figures were not fitted to."""
    if log:
        return log
    return f"the last {100 * (1 - from_share):.0f} % of the log, with figures from the first {100 * from_share:.0f} %"
