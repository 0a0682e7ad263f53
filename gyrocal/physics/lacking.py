"""Why a record cannot show an effect, as data; `gyrocal.report.reasons` has the words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto


class Why(Enum):
    """What is lacking; the facts that each needs stand in its words."""

    # Ranges of a record.
    NO_TURN = auto()
    ONE_RATE = auto()
    FEW_RATES = auto()
    FEW_SIZES = auto()
    FEW_FOR_EVEN = auto()
    FEW_FOR_PEAK = auto()
    ONE_WAY = auto()
    NO_REST = auto()
    NO_STEPS = auto()
    LATE = auto()
    STEADY_TEMPERATURE = auto()
    ONE_BRANCH = auto()
    NO_CHANNEL = auto()
    CONTINUOUS = auto()
    # What a run did not log or do.
    ANGLE_NOT_LOGGED = auto()
    SUPPLY_NOT_LOGGED = auto()
    STEADY_SUPPLY = auto()
    NO_POWER_ON = auto()
    # What a table of data sets does not carry.
    TABLE_NO_ANGLE = auto()
    TABLE_NO_SUPPLY = auto()
    TABLE_NO_POWER_ON = auto()
    TABLE_NO_SAMPLES = auto()
    UNTIMED_ORDER = auto()
    # A drive log.
    NO_INCLINATION = auto()
    LIKE_GYRO_BIAS = auto()
    MOMENTS_ONLY = auto()
    SINGLE_BUMPS = auto()
    NO_GYRO_TEMPERATURE = auto()
    NO_REST_AT_START = auto()
    ONE_SPEED = auto()
    LIKE_SEPARATION = auto()
    LIKE_WAY = auto()
    POOR_TRUTH = auto()


@dataclass(frozen=True)
class Lack:
    """Something that is lacking, and the facts that belong to it."""

    why: Why
    facts: Mapping[str, float | str] = field(default_factory=dict)


#: What is lacking, or what an effect from outside of the package says of it in its own words.
Reason = Lack | str
