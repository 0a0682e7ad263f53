"""What a record offers an effect: the ranges that grids of shapes and blind draws are made for, and what is lacking."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.units import S_PER_H

Floats = NDArray[np.float64]

#: Fewer different rates than this carry no shape beyond the cubic.
_FEWEST_RATES = 6
#: And fewer sizes of rate no shape that is odd in it: slope and cubic take two, a law one, and one is left to check it.
_FEWEST_SIZES = 4
#: Nor, with rest, a peak, which is even in it: bias and square take two, the peak three, and one is left to check it.
_FEWEST_FOR_PEAK = 6
#: Of four a knee explains any errors of single rates: such a file made another run 3.8 times as bad.
_FEWEST_FOR_KNEE = 5
#: Rates below this are rest, deg/s.
_REST_DPS = 0.01
#: Dead zones are looked for among rates up to this, deg/s.
SMALL_DPS = 10.0
#: A temperature that never turns back by as much shows no branches, deg C.
_TURNED_BACK_C = 2.0
#: Half of a gyro's warm-up is over by then, and the rest of it is a drift, s.
_WARM_S = 5400.0


@dataclass(frozen=True)
class Offer:
    """Ranges of a record.

    Attributes
    ----------
    t_s : (first, last) time of its rows, s
    rates_dps : ndarray, the different rates, to a thousandth, ascending, deg/s
    largest_rate_dps : largest size of a rate, deg/s
    temp_c : (lowest, highest) temperature of its rows, deg C
    temp_span_c : range of the temperatures as they were sampled, deg C
    temp_back_c : by how much the temperature both rose and fell (`turned_back_c`), deg C
    turn_starts_s : ndarray, beginnings of data sets between the first turns of the table and its last, s
    since_power_on_s : least time since the gyro was switched on, s; None: nobody knows when that was
    channels : fields of `Conditions` that the record has
    lacking : coordinate to the reason why the record cannot show it
    supply_v : usual supply, V; None where it was not read
    continuous : whether single samples of the output were read, and lie on no lattice
    """

    t_s: tuple[float, float]
    rates_dps: Floats
    largest_rate_dps: float
    temp_c: tuple[float, float]
    temp_span_c: float
    temp_back_c: float
    turn_starts_s: Floats
    since_power_on_s: float | None
    channels: frozenset[str]
    lacking: Mapping[str, Reason]
    supply_v: float | None = None
    continuous: bool = False

    @property
    def span_s(self) -> float:
        """Length of the record, s."""
        return self.t_s[1] - self.t_s[0]

    @property
    def from_zero(self) -> bool:
        """Whether its clock began to count with it, or no longer before than it is long."""
        return 0.0 <= self.t_s[0] <= self.span_s

    @property
    def sizes_dps(self) -> Floats:
        """The different sizes of its rates, ascending, deg/s."""
        return np.unique(np.abs(self.rates_dps))

    @property
    def turning_sizes(self) -> int:
        """How many sizes of its rates are none of rest."""
        return int(np.count_nonzero(self.sizes_dps > _REST_DPS))

    @property
    def all_sizes(self) -> int:
        """The same with rest, which is one."""
        return self.turning_sizes + int(self.turning_sizes < self.sizes_dps.size)

    @property
    def left_by_cubic(self) -> tuple[int, int]:
        """How many differences between sizes of the rate a cubic leaves over, odd and even in the rate."""
        return max(self.turning_sizes - 2, 0), max(self.all_sizes - 2, 0)

    @property
    def turns(self) -> bool:
        """Whether the table turned at all."""
        return self.largest_rate_dps > 0

    def why_unseen(self, coordinate: str) -> Reason | None:
        """Why a coordinate does not show in the record; None where it does.

        Time is never lacking (the order of the rows stands for it), and a warm-up has the same shape whenever it is
        first seen.
        """
        if coordinate in ("time", "time_since_power_on"):
            return None
        return self.lacking.get(coordinate)


def turned_back_c(temp_c: Floats) -> float:
    """By how much temperatures in the order of time both rose and fell.

    A play whose half width is above it goes one way only, and is a function of the temperature, as the surface is.
    """
    return min(fell_c(temp_c), fell_c(-temp_c))


def fell_c(temp_c: Floats) -> float:
    """The most by which temperatures in the order of time fell from any that was before."""
    return float(np.max(np.maximum.accumulate(temp_c) - temp_c))


#: Why a record does not meet a need of an effect; None: it does.
Requirement = Callable[[Offer], Reason | None]


def table_turns(offer: Offer) -> Reason | None:
    """The table turned."""
    return None if offer.turns else Lack(Why.NO_TURN)


def rates_differ(offer: Offer) -> Reason | None:
    """Rates to tell a scale factor by: at one rate what changes it is what changes the bias."""
    return None if offer.rates_dps.size > 1 else Lack(Why.ONE_RATE)


def many_rates(offer: Offer) -> Reason | None:
    """Enough rates for a shape that a cubic leaves over."""
    count = offer.rates_dps.size
    if count >= _FEWEST_RATES:
        return None
    return Lack(Why.FEW_RATES, {"count": count, "fewest": _FEWEST_RATES})


def many_sizes(offer: Offer) -> Reason | None:
    """Enough sizes of rate for a shape that is odd in it beyond the cubic."""
    return _turning_sizes(offer, _FEWEST_SIZES)


def sizes_for_even(offer: Offer) -> Reason | None:
    """Enough sizes of rate for a shape that is even in it: bias and square take two, a law one, and one is left to check it."""
    return _all_sizes(offer, _FEWEST_SIZES, Why.FEW_FOR_EVEN)


def sizes_for_knee(offer: Offer) -> Reason | None:
    """Enough sizes of rate for a knee beside the cubic, which has a place and a height, and one to check them by."""
    return _turning_sizes(offer, _FEWEST_FOR_KNEE)


def _turning_sizes(offer: Offer, fewest: int) -> Reason | None:
    if offer.turning_sizes >= fewest:
        return None
    return Lack(Why.FEW_SIZES, {"count": offer.turning_sizes, "fewest": fewest})


def sizes_for_peak(offer: Offer) -> Reason | None:
    """Enough sizes of rate for a peak, which has a place, a width and a height."""
    return _all_sizes(offer, _FEWEST_FOR_PEAK, Why.FEW_FOR_PEAK)


def _all_sizes(offer: Offer, fewest: int, why: Why) -> Reason | None:
    if offer.all_sizes >= fewest:
        return None
    return Lack(why, {"count": offer.all_sizes, "fewest": fewest})


def both_ways(offer: Offer) -> Reason | None:
    """Turns to the left and to the right."""
    return None if offer.rates_dps.min() < 0 < offer.rates_dps.max() else Lack(Why.ONE_WAY)


def data_at_rest(offer: Offer) -> Reason | None:
    """Rows at rest."""
    return None if np.any(np.abs(offer.rates_dps) < _REST_DPS) else Lack(Why.NO_REST)


def cut_or_dead(offer: Offer) -> Reason | None:
    """Samples on a lattice, or none that would show it; or no small rates, which would tell what is lost from a dead band."""
    small = (offer.sizes_dps > _REST_DPS) & (offer.sizes_dps <= SMALL_DPS)
    return Lack(Why.CONTINUOUS) if offer.continuous and np.any(small) else None


def steps_of_rate(offer: Offer) -> Reason | None:
    """Samples that say how long ago the rate changed, and by how much."""
    return None if {"since_step_s", "step_dps"} <= offer.channels else Lack(Why.NO_STEPS)


def begins_warm(offer: Offer) -> Reason | None:
    """A beginning soon after power-on, where that is known."""
    late = offer.since_power_on_s is not None and offer.since_power_on_s > _WARM_S
    return Lack(Why.LATE, {"hours": _WARM_S / S_PER_H}) if late else None


def temperature_changes(by_c: float) -> Requirement:
    """A change of temperature of at least so much."""

    def requirement(offer: Offer) -> Reason | None:
        span = offer.temp_c[1] - offer.temp_c[0]
        return Lack(Why.STEADY_TEMPERATURE, {"by_c": by_c}) if span < by_c else None

    return requirement


def temperature_turned_back(offer: Offer) -> Reason | None:
    """Heating and cooling, by more than a thermometer scatters."""
    return None if offer.temp_back_c >= _TURNED_BACK_C else Lack(Why.ONE_BRANCH, {"by_c": _TURNED_BACK_C})


def either(first: Requirement, second: Requirement) -> Requirement:
    """One of two needs; the reason of the second where neither is met."""

    def requirement(offer: Offer) -> Reason | None:
        return None if first(offer) is None else second(offer)

    return requirement
