"""What there is to say of a recording beside its numbers, as data; `gyrocal.report.remarks` has the words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any


class Said(Enum):
    """What a remark says; the facts that each needs stand in its words."""

    # The recording of a bench.
    FAILED_SEGMENTS = auto()
    SET_ASIDE_AFTER_STEPS = auto()
    UNUSABLE_SAMPLES = auto()
    MISSING_SAMPLES = auto()
    STRAY_SAMPLES = auto()
    WHOLE_DEGREES = auto()
    DITHERED = auto()
    SMOOTHED = auto()
    NOMINAL_RATES = auto()
    CHAMBER_FOR_GYRO = auto()
    SAME_TIMES = auto()
    SHARED_TIMES = auto()
    SLIP_OF_OWN_TRACK = auto()
    NO_SPREAD = auto()
    SCALE_FAR_OFF = auto()
    STRAY_SETS = auto()
    CLIPPED = auto()
    # What was found in it.
    TEMPERATURE_ALONE = auto()
    NOT_TEMPERATURE_ALONE = auto()
    NOT_WRITTEN = auto()
    LAW_NOT_WRITTEN = auto()
    SINE_WRITTEN = auto()
    BEFORE_SINE = auto()
    OPEN_SINCE_POWER_ON = auto()
    EDGE = auto()
    ALSO_WRITTEN = auto()
    STATE_AT_END = auto()
    NOT_LOGGED_MEANWHILE = auto()
    LATER_ON_A_ROBOT = auto()
    GIVE_TIMES = auto()
    WANDERS = auto()
    MEAN_OF_DRIFT = auto()
    INPUT_ALREADY = auto()
    NO_SURE_GAIN = auto()
    NO_INVERSE = auto()
    TOO_FEW_TO_WRITE = auto()
    TOO_FEW_RATES = auto()
    ONE_WAY = auto()
    FEW_TEMPERATURES = auto()
    DEAD_SETS = auto()
    STRANGE_SETS = auto()
    FAR_SETS = auto()
    BURST_SAMPLES = auto()
    OUTPUT_STEPS = auto()
    LOST_IN_STEPS = auto()
    SAMPLE_CLOCK = auto()
    BETWEEN_SETS = auto()
    SEVERAL_LAWS = auto()
    OF_SCALE = auto()
    LARGEST_RATES = auto()
    # What was left out of a fit together, to see what it foretells.
    LEFT_OUT_SETS = auto()
    LEFT_OUT_BLOCKS = auto()
    # A drive log.
    GAPS = auto()
    EMPTY_WHEEL = auto()
    CALIBRATED = auto()
    GYRO_BRIDGED = auto()
    GYRO_SPIKES = auto()
    TRUTH_UNIT = auto()
    TRUTH_RADIANS = auto()
    TRUTH_CLOCKWISE = auto()
    TRUTH_MIRRORED = auto()
    TRUTH_SENSOR = auto()
    UNEVEN_CLOCK = auto()
    # What was found in it.
    GYRO_COLUMN = auto()
    WHEEL_SIGN = auto()
    WHEELS_SWAPPED = auto()
    MISSING_ROWS = auto()
    WAYS_ADDED = auto()
    NO_REST = auto()
    STANDS = auto()
    CREEPS = auto()
    WHEEL_TURN = auto()
    ENCODERS_LATE = auto()
    SAMPLES_OF_ROWS = auto()
    MEANS_OF_ROWS = auto()
    TURNS_INWARD = auto()
    BIAS_IN_MOTION = auto()
    BIAS_WHILE_MOVING = auto()
    BIAS_NO_REST = auto()
    BIAS_JUMPS = auto()
    BIAS_SETTLES = auto()
    SIDES_DIFFER = auto()
    TEMPERATURE_OR_TIME = auto()
    WHEELS_CHANGE = auto()
    TRACK_CHANGES = auto()
    DELAY_GROWS = auto()
    TRACK_MIXED_UP = auto()


@dataclass(frozen=True)
class Remark:
    """Something to be said, and the numbers in it."""

    said: Said
    facts: Mapping[str, Any] = field(default_factory=dict)


#: A remark, or what the reader of a file has said of it in its own words.
Note = Remark | str

#: What is said of the improved coefficients; a difference of two recordings has a law in their place.
OF_COEFFICIENTS = frozenset(
    {
        Said.NOT_WRITTEN,
        Said.LAW_NOT_WRITTEN,
        Said.ALSO_WRITTEN,
        Said.SINE_WRITTEN,
        Said.LATER_ON_A_ROBOT,
        Said.OPEN_SINCE_POWER_ON,
        Said.STATE_AT_END,
        Said.MEAN_OF_DRIFT,
        Said.INPUT_ALREADY,
        Said.NO_SURE_GAIN,
        Said.NO_INVERSE,
        Said.TOO_FEW_TO_WRITE,
        Said.TOO_FEW_RATES,
    }
)
