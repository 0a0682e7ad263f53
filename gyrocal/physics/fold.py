"""The coordinate on which an effect stands out: where its residual is folded to be seen.

The rms of data sets barely moves for thermal, angle and ringing effects; on their own coordinate they show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.conditions import Conditions
from gyrocal.units import MDPS, PPM, S_PER_H, S_PER_MIN

Floats = NDArray[np.float64]

_TURN_DEG = 360.0
#: The customary rate, and step of rate, to which an ordinate in proportion to it refers, deg/s.
_RATE_DPS, _STEP_DPS = 100.0, 10.0
#: Turns are slow below this share of the largest, and what adds less than this share to them is a scale factor's.
_SLOW, _HARDLY = 0.1, 0.5
#: A response is followed for so many of its time constants, and at least so long, s.
_DECAYS, _LEAST_S, _USUAL_TAU_S = 6.0, 5.0, 3.0


@dataclass(frozen=True)
class FoldAxis:
    """Where rows lie on an effect's coordinate; arrays of shape (n,), NaN where a row has no place there.

    Attributes
    ----------
    gain : ndarray
        What the effect multiplies; the ordinate is residual over gain, in `unit`.
    within_set : bool
        The effect changes inside a data set, so that each set's own mean is only noise to it.
    of_time : bool
        The coordinate is time: a record without times has the order of its data sets in its stead.
    linear_within : float
        The effect lives within so much of zero, far less than the range: from there on the coordinate is to be drawn by its
        logarithm. 0: it is linear.
    """

    label: str
    x: Floats
    gain: Floats
    unit: str
    within_set: bool = False
    of_time: bool = False
    linear_within: float = 0.0


#: The coordinate for rows, from an effect's parameters and from what it adds to them (deg/s, shape (n,)).
Fold = Callable[[Conditions, Mapping[str, float], Floats], FoldAxis]


def plain(label: str, x: Floats, *, within_set: bool = False, of_time: bool = False) -> FoldAxis:
    """An axis whose ordinate is the residual in mdeg/s."""
    return FoldAxis(label, x, np.full(x.size, MDPS), "mdeg/s", within_set, of_time)


def on_channel(label: str, channel: str, factor: float = 1.0) -> Fold:
    """Folded on a field of the conditions, times `factor`."""

    def fold(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
        return plain(label, factor * c.need(channel))

    return fold


def on_turn(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on the table angle, or on the part of a turn that repeats."""
    period = _TURN_DEG / max(round(p.get("harmonic", 1.0)), 1)
    label = "Table angle, deg" if period == _TURN_DEG else f"Table angle, deg (folded on {period:g}°)"
    return plain(label, np.where(c.rate_dps != 0, c.need("angle_deg") % period, np.nan), within_set=True)


def on_turn_with_rate(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """The same, for an effect in proportion to the rate."""
    turn = on_turn(c, p, error_dps)
    return FoldAxis(turn.label, turn.x, MDPS * c.rate_dps / _RATE_DPS, f"mdeg/s at {_RATE_DPS:g} deg/s", True)


def on_time(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on time since the record began."""
    return plain("Time, h", (c.t_s - c.t_s[0]) / S_PER_H, of_time=True)


def scale_on_time(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """The same, for a change of the scale factor."""
    time = on_time(c, p, error_dps)
    turning = np.where(c.rate_dps != 0, time.x, np.nan)
    return FoldAxis(time.label, turning, PPM * c.rate_dps, "ppm of rate", of_time=True)


def temperature_or_scale(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on the temperature, for an effect on the bias or the scale factor: on what it hardly adds to slow turns as the latter."""
    sizes = np.abs(c.rate_dps)
    slow = sizes <= _SLOW * sizes.max(initial=0.0)
    whole, own = (np.mean(x**2) if x.size else 0.0 for x in (error_dps, error_dps[slow]))
    if own >= _HARDLY**2 * whole:
        return plain("Gyro temperature, °C", c.temp_c)
    turning = np.where(slow, np.nan, c.temp_c)
    return FoldAxis("Gyro temperature, °C", turning, PPM * c.rate_dps, "ppm of rate")


def since_step(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on the time since the rate changed, while the response lasts."""
    since_s, step_dps = c.need("since_step_s"), c.need("step_dps")
    near = (since_s <= max(_DECAYS * p.get("tau_s", _USUAL_TAU_S), _LEAST_S)) & (step_dps != 0)
    x = np.where(near, since_s, np.nan)
    unit = f"mdeg/s per {_STEP_DPS:g} deg/s of step"
    return FoldAxis("Time since the data set began, s", x, MDPS * step_dps / _STEP_DPS, unit, True)


def on_own(label: str) -> Fold:
    """Folded on what the effect is in proportion to: what it adds, over its amplitude in mdeg/s."""

    def fold(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
        return plain(label, error_dps / (MDPS * p["amplitude"]))

    return fold


def on_lag(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on what a lag adds, as modelled, in mdeg/s."""
    return plain("Error by the lag as modelled, mdeg/s", error_dps / MDPS)


def near_zero_rate(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
    """Folded on the table rate, wide open around zero: a zone of a small part of a degree per second is no wider than a pixel."""
    return replace(plain("Table rate, deg/s", c.need("rate_dps")), linear_within=p.get("width_dps", 0.0))


#: The fold of an effect that has none of its own, by the coordinate in which it is seen.
BY_COORDINATE: Mapping[str, Fold] = {
    "rate": on_channel("Table rate, deg/s", "rate_dps"),
    "temperature": on_channel("Gyro temperature, °C", "temp_c"),
    "temperature_rate": on_channel("Temperature rate, °C/min", "temp_rate_c_per_s", S_PER_MIN),
    "temperature_branch": on_channel("Temperature rate, °C/min", "temp_rate_c_per_s", S_PER_MIN),
    "time": on_time,
    "time_since_power_on": on_channel("Time since power-on, min", "since_power_on_s", 1.0 / S_PER_MIN),
    "table_angle": on_turn,
    "time_since_step": since_step,
    "supply": on_channel("Supply, V", "supply_v"),
    "data_set_index": on_channel("Data set", "data_set_index"),
}
