"""What rounding does to means of samples whose noise carries them over few steps of the output."""

from __future__ import annotations

import math


def mean_error(step: float, scatter: float) -> float:
    """How far the mean of many rounded samples may be off: the first harmonic of the steps that noise leaves.

    The scatter of the samples has a twelfth of the square of a step in it, which is none of the noise's.
    """
    noise_steps2 = max((scatter / step) ** 2 - 1.0 / 12.0, 0.0)
    return step / math.pi * math.exp(-2.0 * math.pi**2 * noise_steps2)


def slope_error(step: float, scatter: float) -> float:
    """The share by which what is slow may come out too large or too small: the slope of that harmonic."""
    return 2.0 * math.pi * mean_error(step, scatter) / step
