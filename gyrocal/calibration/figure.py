"""A figure of a gyro: a number with its interval, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

#: Value, and both ends of its 95 % interval.
Interval = tuple[float, float, float]


def number(value: float) -> str:
    """Four digits or more, without an exponent where people write none."""
    if value == 0.0 or not 1e-4 <= abs(value) < 1e8:
        return f"{value:.4g}"
    return f"{value:,.{max(3 - math.floor(math.log10(abs(value))), 0)}f}"


def interval_said(low: float, high: float) -> str:
    """Both ends of an interval."""
    return f"{number(low)} to {number(high)}"


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
