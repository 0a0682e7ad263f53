"""A figure of a gyro: a number with its interval, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from gyrocal.units import decimals

#: Beyond so many decimals people write an exponent.
_MOST_DECIMALS = 6

#: Value, and both ends of its 95 % interval.
Interval = tuple[float, float, float]


def number(value: float, half_width: float = 0.0) -> str:
    """To the digits that its interval has, two of the half width; four or more of a figure that is exact. No exponent where people write none."""
    if half_width > 0.0:
        places = decimals(half_width)
        rounded = round(value, places)
        # A number that its interval tells from zero is not written as zero.
        if rounded == 0.0 != value or places > _MOST_DECIMALS:
            return f"{value:.2g}"
        return f"{rounded + 0.0:,.{max(places, 0)}f}"
    if value == 0.0 or not 1e-4 <= abs(value) < 1e8:
        return f"{value:.4g}"
    return f"{value:,.{max(3 - math.floor(math.log10(abs(value))), 0)}f}"


def interval_said(low: float, high: float) -> str:
    """Both ends of an interval."""
    half = 0.5 * (high - low)
    return f"{number(low, half)} to {number(high, half)}"


def value_said(value: float, low: float, high: float) -> str:
    """A value and its interval."""
    return f"{number(value, 0.5 * (high - low))} ({interval_said(low, high)})"


def bound_said(bound: float) -> str:
    """What something is less than: known no better than by itself."""
    return f"< {number(bound, abs(bound))}"


@dataclass(frozen=True)
class Figure:
    """One figure, named as in IEEE Std 952.

    Attributes
    ----------
    value, low, high : float or None
        Value and 95 % interval. Without a value `high` may bound what it can be at most.
    reason : str
        Why there is no value; empty where there is one.
    method, sample : str
        How it was found, and from what.
    size : bool
        Whether it is never below zero.
    """

    name: str
    unit: str
    definition: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""
    method: str = ""
    sample: str = ""
    size: bool = False

    @property
    def interval(self) -> Interval | None:
        """Value, low and high; None where there is no value."""
        if self.value is None or self.low is None or self.high is None:
            return None
        return self.value, self.low, self.high

    @property
    def title(self) -> str:
        """The name in words."""
        return self.name.replace("_", " ")

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "value": self.value,
            "interval_95": None if self.interval is None else [self.low, self.high],
            "at_most": self.high if self.value is None else None,
            "unit": self.unit,
            "definition": self.definition,
            "reason": self.reason,
            "method": self.method,
            "sample": self.sample,
        }
