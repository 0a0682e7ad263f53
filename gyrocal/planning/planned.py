"""Bench plans that separate effects, as data: a profile for `acquire`, and the rows that it would record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrocal.diagnosis.rows.history import TemperatureHistory
from gyrocal.diagnosis.rows.series import Raw, Series
from gyrocal.units import S_PER_H, S_PER_MIN

Floats = NDArray[np.float64]

#: What a plan assumes of a bench whose figures it does not know.
_CASE_LAG_S = 400.0
_AIR_LAG_S = 60.0
_SETTLE_S = 4.0
_ROW_LONG_S = 5.0
_ROW_SET_S = 1.0
#: Temperatures nearer together than this are one.
_LEAST_SPAN_C = 5.0
#: Hours at rest: half a working day, and one whole.
_STATIC_S, _LONG_STATIC_S = 14400.0, 25200.0
#: Visits of a plan at one temperature.
_VISITS = 6
_FEWEST_BETWEEN, _MOST_BETWEEN = 4, 24
#: Rates of a record that are nearer together than this share are one, as a table reports them; a plan takes so many at most.
_SAME_RATE, _MOST_RATES = 2e-3, 60
#: A plan names its rates to a thousandth of a degree per second.
_LEAST_RATE_DPS = 1e-3
#: How much later than planned a ramp and a soak may end, s: a plan is to keep to its bench time.
_LATE_RAMP_S, _LATE_SOAK_S, _LATE_REST_S = 600.0, 900.0, 300.0
#: What the virtual table bears unless the profile says more, deg/s.
_VIRTUAL_TABLE_DPS = 400.0
#: Where the chamber goes at the end, deg C, if that is within reach.
_SAFE_C = 25.0
#: Sections of the profile at hand that describe the bench, not the plan.
_OF_BENCH = ("gyro", "table", "chamber", "bench", "limits", "settle", "record", "safe", "virtual")


@dataclass(frozen=True)
class Reach:
    """What a plan may ask for.

    Attributes
    ----------
    rate_dps : float
        Largest rate; 0 where the record does not show what the gyro can bear: such plans stay at rest.
    low_c, high_c, rest_c : float
        Temperatures, and the one at which the chamber rests.
    ramp_c_per_min, fast_ramp_c_per_min : float
        Usual and largest slope of the chamber.
    sizes_dps : tuple of float
        Sizes of the rates of the record at hand.
    odd_dps : tuple of float
        From and to which size of rate the doubt lives, where these are some rates of many; else empty.
    near_dps : float
        How far from zero rate the doubt lives, where that is a small part of the range; 0: not there.
    """

    rate_dps: float
    low_c: float
    high_c: float
    ramp_c_per_min: float
    fast_ramp_c_per_min: float
    rest_c: float = 25.0
    sizes_dps: tuple[float, ...] = ()
    near_dps: float = 0.0
    odd_dps: tuple[float, ...] = ()

    @property
    def middle_c(self) -> float:
        """Where a plan that needs no other temperature stays: where the chamber rests, so that nothing ramps."""
        return min(max(self.rest_c, self.low_c), self.high_c)


@dataclass(frozen=True)
class Design:
    """A plan: temperatures in the order of their visits, rates at each, and how long everything takes.

    Attributes
    ----------
    purpose : str
        What it does, in words that go into a sentence.
    rates_dps : tuple of float
        Positive; every data set is taken with both signs, shuffled.
    ramp_rates_dps : tuple of float
        Table rates during ramps and soaks, visit after visit.
    about_rate : bool
        Its many rates are for a doubt about what the rate does; they say nothing to who asks about time or temperature.
    from_power_on : bool
        The run begins with the power-on of a gyro that was off for long.
    """

    name: str
    purpose: str
    temperatures_c: tuple[float, ...]
    rates_dps: tuple[float, ...] = ()
    dwell_s: float = 20.0
    soak_s: float = 900.0
    static_s: float = 0.0
    ramp_rates_dps: tuple[float, ...] = (0.0,)
    from_power_on: bool = False
    fast: bool = False
    about_rate: bool = False

    def ramp_c_per_min(self, reach: Reach) -> float:
        """Slope of its ramps."""
        return reach.fast_ramp_c_per_min if self.fast else reach.ramp_c_per_min


def designs(reach: Reach) -> list[Design]:
    """Plans within reach, each the best that is known for one kind of doubt."""
    found = _thermal(reach)
    if reach.high_c - reach.low_c < _LEAST_SPAN_C:
        found = []
    found += _standing(reach)
    return found + (_turning(reach) if reach.rate_dps > 0 else [])


def _thermal(reach: Reach) -> list[Design]:
    """Plans that change the temperature; in a rate of zero they stay at rest."""
    w, low, mid, high = reach.rate_dps, reach.low_c, reach.middle_c, reach.high_c
    half = (0.5 * w,) if w > 0 else ()
    turning = (round(0.8 * w, 3), round(-0.8 * w, 3))
    found = [
        Design("ramps", "ramps up and down at rest", (low, high, low, high, mid), soak_s=600.0),
        Design("ramps_soaks", "ramps with long soaks at rest", (low, mid, high, mid, low), soak_s=2700.0),
        Design("fast_ramps", "fast ramps with soaks at rest", (low, high) * 3, soak_s=1500.0, fast=True),
        Design("loops", "inner loops of temperature", (low, high, mid, high, low, mid, low), soak_s=1800.0),
        Design("levels", "many temperatures up and down", _up_and_down(low, high), half, 60.0, 1500.0),
    ]
    if w > 0:
        ramps = (low, high, low, high, low)
        found.append(
            Design(
                "turning_ramps", "ramps while the table turns", ramps, soak_s=600.0, ramp_rates_dps=turning
            )
        )
        levels = np.round(np.linspace(low, high, 7), 1).tolist()
        interleaved = (*levels[::2], *levels[1::2][::-1])
        fine = tuple(np.round(np.linspace(0.1, 1.0, 10) * w, 3).tolist())
        found.append(Design("grid", "all rates at temperatures visited out of order", interleaved, fine))
    return found


def _standing(reach: Reach) -> list[Design]:
    """Plans at rest at one temperature: what two slow laws differ by grows faster than the time."""
    on = Design(
        "power_on",
        "hours at rest from power-on",
        (reach.middle_c,),
        soak_s=300.0,
        static_s=_STATIC_S,
        from_power_on=True,
    )
    rest = Design(
        "rest", "hours at rest at one temperature", (reach.middle_c,), soak_s=900.0, static_s=_STATIC_S
    )
    long = [
        replace(d, name=f"{d.name}_long", purpose=f"many {d.purpose}", static_s=_LONG_STATIC_S)
        for d in (on, rest)
    ]
    return [on, rest, *long]


def _turning(reach: Reach) -> list[Design]:
    """Plans of many rates at one temperature.

    The same visit again and again: bias wanders between data sets, so many short ones tell more than few long.
    """
    w, mid = reach.rate_dps, reach.middle_c
    rates = {
        "near_zero": ("rates dense near zero", _near_zero(reach)),
        "fine_rates": (
            "fine rates",
            _no_coarser(reach, min((0.05 * w, *(size for size in reach.sizes_dps if size > 0.0)))),
        ),
        "top_rates": ("rates dense at the upper end", _no_coarser(reach, 0.4 * w)),
        "turns": ("slow and fast turns", np.array([0.05, 0.2, 0.5, 1.0]) * w),
    }
    between = _between(reach)
    if between.size >= _FEWEST_BETWEEN:
        rates["new_rates"] = ("rates between those of this record", between)
    found = [
        Design(
            name,
            f"{purpose}, {_VISITS} times at one temperature",
            (mid,) * _VISITS,
            tuple(np.unique(np.round(r[r >= _LEAST_RATE_DPS], 3)).tolist()),
            60.0 if name == "turns" else 20.0,
            60.0,
            about_rate=name != "turns",
        )
        for name, (purpose, r) in rates.items()
    ]
    found += [
        replace(
            d,
            name=f"{d.name}_long",
            purpose=d.purpose.replace(f"{_VISITS} times", f"{3 * _VISITS} times"),
            temperatures_c=(mid,) * (3 * _VISITS),
        )
        for d in found
    ]
    again = (round(0.2 * w, 3), round(0.5 * w, 3), round(0.9 * w, 3))
    found.append(Design("repeats", "the same rates again and again", (mid,) * 8, again, 60.0, 1200.0))
    return found


def _no_coarser(reach: Reach, low_dps: float) -> Floats:
    """The rates of the record from `low_dps` on, filled up to a twentieth of the range, and twice as densely where they are odd."""
    sizes = np.array([size for size in reach.sizes_dps if low_dps < size < reach.rate_dps])
    sizes = sizes[:: int(np.ceil(sizes.size / _MOST_RATES))] if sizes.size else sizes
    knots = np.concatenate([[low_dps], sizes, [reach.rate_dps]])
    knots = knots[np.diff(knots, prepend=0.0) > _SAME_RATE * knots]
    filled = []
    for low, high in pairwise(knots.tolist()):
        odd = bool(reach.odd_dps) and low <= max(reach.odd_dps) and high >= min(reach.odd_dps)
        parts = max(int(np.ceil(np.round(20.0 * (high - low) / reach.rate_dps, 3))), 2 if odd else 1)
        filled.append(np.linspace(low, high, parts, endpoint=False))
    return np.concatenate([*filled, knots[-1:]])


def _near_zero(reach: Reach) -> Floats:
    """Rates that grow by equal factors; where the doubt lives near zero, as many within twice its reach as beyond."""
    if reach.near_dps == 0.0:
        return np.geomspace(0.005, 1.0, 12) * reach.rate_dps
    within = np.linspace(0.25, 2.0, 8) * reach.near_dps
    return np.concatenate([within, np.geomspace(4.0 * reach.near_dps, reach.rate_dps, 8)])


def _between(reach: Reach) -> Floats:
    """Rates half-way between those of the record: an error of the reference is drawn anew for each rate."""
    sizes = np.unique(np.round([s for s in reach.sizes_dps if s <= reach.rate_dps], 3))
    if sizes.size > _MOST_BETWEEN:
        sizes = sizes[:: int(np.ceil(sizes.size / _MOST_BETWEEN))]
    middles = 0.5 * (sizes[:-1] + sizes[1:])
    return np.asarray(middles[middles > 0])


def _up_and_down(low: float, high: float) -> tuple[float, ...]:
    up = np.round(np.linspace(low, high, 9), 1).tolist()
    return (*up[::2], *up[-2::-2])


def to_profile(
    design: Design, reach: Reach, sensor: Mapping[str, Any], bench: Mapping[str, Any]
) -> dict[str, Any]:
    """The profile of a design, with the devices, limits and virtual bench of `bench` (a profile at hand)."""
    plan: dict[str, Any] = {
        "temperatures_c": list(design.temperatures_c),
        "temperature_order": "listed",
        "rates_dps": list(design.rates_dps),
        "both_signs": True,
        "rate_order": "shuffled",
        "zero_first_and_last": bool(design.rates_dps),
        "dwell_s": design.dwell_s,
        "ramp_rates_dps": list(design.ramp_rates_dps),
    }
    if design.static_s:
        plan["static_s"] = design.static_s
    known = {
        k: sensor[k]
        for k in ("model", "serial", "sample_rate_hz", "rate_range_dps", "temp_range_c")
        if k in sensor
    }
    profile: dict[str, Any] = {
        "title": f"Next experiment: {design.purpose}",
        "sensor": {
            "model": "unknown",
            "sample_rate_hz": 10.0,
            # A gyro of which no rate is known stays at rest; the schema wants a range all the same.
            "rate_range_dps": [-(reach.rate_dps or 1.0), reach.rate_dps or 1.0],
            "temp_range_c": [min(reach.low_c, reach.high_c - 1.0), reach.high_c],
            **known,
        },
        "plan": plan,
        "ramp": {"rate_c_per_min": design.ramp_c_per_min(reach), "deadline_s": _LATE_RAMP_S},
        # What the gyro does while it comes to rest is wanted in the record, so its own slope does not have to vanish.
        "soak": {
            "time_s": design.soak_s,
            "slope_c_per_min": 100.0,
            "slope_over_s": min(300.0, design.soak_s),
            "deadline_s": design.soak_s
            + (_LATE_SOAK_S if len(set(design.temperatures_c)) > 1 else _LATE_REST_S),
        },
    }
    low, high = profile["sensor"]["temp_range_c"]
    profile["safe"] = {"chamber_c": float(min(max(_SAFE_C, low), high))}
    if reach.rate_dps > _VIRTUAL_TABLE_DPS:
        profile["virtual"] = {"table": {"max_rate_dps": 1.2 * reach.rate_dps}}
    if design.from_power_on:
        profile["sensor"]["on_before_s"] = 0.0
    return profile | {key: bench[key] for key in _OF_BENCH if key in bench}


@dataclass(frozen=True)
class _Piece:
    kind: str
    start_s: float
    length_s: float
    rate_dps: float
    set_c: float


def _pieces(design: Design, reach: Reach) -> list[_Piece]:
    """Segments in the order in which the bench takes them."""
    rng = np.random.default_rng(1)
    found: list[_Piece] = []
    at, from_c = 0.0, reach.middle_c

    def add(kind: str, length_s: float, rate_dps: float, set_c: float) -> None:
        nonlocal at
        found.append(_Piece(kind, at, length_s, rate_dps, set_c))
        at += length_s + _SETTLE_S

    for visit, temp_c in enumerate(design.temperatures_c):
        turning = design.ramp_rates_dps[visit % len(design.ramp_rates_dps)]
        ramp_s = abs(temp_c - from_c) / design.ramp_c_per_min(reach) * S_PER_MIN
        if ramp_s > 0:
            add("ramp", ramp_s, turning, temp_c)
        add("soak", design.soak_s, turning, temp_c)
        if design.static_s and visit == 0:
            add("static", design.static_s, 0.0, temp_c)
        both = np.array([*design.rates_dps, *(-r for r in design.rates_dps)])
        if both.size:
            for rate in (0.0, *rng.permutation(both).tolist(), 0.0):
                add("rate", design.dwell_s, rate, temp_c)
        from_c = temp_c
    return found


def duration_h(design: Design, reach: Reach) -> float:
    """Bench time of a design."""
    last = _pieces(design, reach)[-1]
    return (last.start_s + last.length_s) / S_PER_H


def _lagged(x: Floats, tau_s: float) -> Floats:
    a = 1.0 - np.exp(-1.0 / tau_s)
    return np.asarray(lfilter([a], [1.0, a - 1.0], x - x[0]) + x[0])


def planned_series(design: Design, reach: Reach, walk_dps_rt_s: float) -> Series:
    """Rows that a design would record, without noise and without a gyro.

    Parameters
    ----------
    walk_dps_rt_s : float
        White noise: standard deviation of a mean over one second, deg/s.
    """
    pieces = _pieces(design, reach)
    end_s = pieces[-1].start_s + pieces[-1].length_s
    grid = np.arange(0.0, end_s + 2.0)
    knots = [(0.0, reach.middle_c), *((p.start_s + p.length_s, p.set_c) for p in pieces)]
    set_point = np.interp(grid, [k[0] for k in knots], [k[1] for k in knots])
    case = _lagged(_lagged(set_point, _AIR_LAG_S), _CASE_LAG_S)
    parts: list[tuple[Floats, Floats]] = []
    for p in pieces:
        row_s = _ROW_SET_S if p.kind == "rate" else _ROW_LONG_S
        count = max(int(p.length_s / row_s), 1)
        parts.append((p.start_s + (np.arange(count, dtype=np.float64) + 0.5) * row_s, np.full(count, row_s)))
    t_s = np.concatenate([t for t, _ in parts])
    averaging = np.concatenate([a for _, a in parts])
    number = np.repeat(np.arange(len(pieces)), [t.size for t, _ in parts])
    rate = np.array([p.rate_dps for p in pieces])
    history = TemperatureHistory(grid, case, S_PER_MIN * np.gradient(case, grid))
    starts = np.array([p.start_s for p in pieces])
    moved = np.concatenate([[0.0], np.cumsum(rate * np.array([p.length_s + _SETTLE_S for p in pieces]))[:-1]])
    empty = np.empty(0)
    return Series(
        name=design.name,
        t_s=t_s,
        gyro_dps=rate[number],
        rate_dps=rate[number],
        temp_c=history.temp_at(t_s),
        white_std_dps=walk_dps_rt_s / np.sqrt(averaging),
        averaging_s=averaging,
        set_index=number.astype(np.int64),
        is_set=np.array([p.kind == "rate" for p in pieces])[number],
        temp_rate_c_per_min=history.rate_at(t_s),
        history=history,
        raw=Raw(empty, empty, t_s.size),
        angle_deg=moved[number] + rate[number] * (t_s - starts[number]),
        supply_v=None,
        since_power_on_s=t_s if design.from_power_on else t_s + S_PER_H,
        since_set_s=t_s - starts[number],
        step_dps=np.diff(rate, prepend=0.0)[number],
    )
