"""Shapes of which empirical terms are made: one row for each, with its numbers, its values and its C."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrocal.physics.c_text import Number
from gyrocal.physics.disturbance import above_usual, above_usual_c
from gyrocal.physics.effect import Floats
from gyrocal.physics.thermal import SMOOTHING_S

#: Share of the rate scale at which the bumps in asinh turn from even steps of rate to even ratios.
ASINH_SHARE = 1e-3


@dataclass(frozen=True)
class Frame:
    """Scales of the columns: ``u = w / rate_scale``, ``v = (T - temp_center) / temp_scale``, ``V - supply``."""

    rate_scale_dps: float
    temp_center_c: float
    temp_scale_c: float
    supply_v: float = 0.0

    def __post_init__(self) -> None:
        if not (self.rate_scale_dps > 0 and self.temp_scale_c > 0):
            msg = "the scales of rate and temperature must be positive"
            raise ValueError(msg)


@dataclass(frozen=True)
class Shape:
    """A function of one scaled variable: names of its numbers with their units, its values, and its C.

    `value` is called with the scaled variable, the frame and the numbers; `c` with a writer of numbers, the frame
    and the numbers, and gives an expression of ``w`` and ``temp_c``; empty: 1.
    """

    names: tuple[str, ...]
    value: Callable[..., Floats]
    c: Callable[..., str]


def _bump(x: Floats, center: float, width: float) -> Floats:
    return np.asarray(np.exp(-0.5 * ((x - center) / width) ** 2))


def _pair(sign: float, x: Floats, center: float, width: float) -> Floats:
    return _bump(x, center, width) + sign * _bump(x, -center, width)


def legendre(x: Floats, order: float) -> Floats:
    """P_n by its recurrence, ``n P_n = (2n - 1) x P_{n-1} - (n - 1) P_{n-2}``."""
    before, now = np.zeros(x.shape), np.ones(x.shape)
    for n in range(1, round(order) + 1):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
    return now


def _logarithmic(u: Floats) -> Floats:
    return np.asarray(np.arcsinh(u / ASINH_SHARE))


def _pair_c(sign: str, x: str, n: Number, center: float, width: float) -> str:
    bump = "PREFIX_bump@f@({x}, {center}, {width})"
    sides = (bump.format(x=x, center=n(side * center), width=n(width)) for side in (1.0, -1.0))
    return f"({f' {sign} '.join(sides)})"


def _u_c(n: Number, f: Frame) -> str:
    return f"w / {n(f.rate_scale_dps)}"


def _v_c(n: Number, f: Frame) -> str:
    return f"(temp_c - ({n(f.temp_center_c)})) / {n(f.temp_scale_c)}"


def _bump_of_rate(sign: str) -> Shape:
    one = float(f"{sign}1")
    return Shape(
        ("center_dps", "width_dps"),
        lambda u, f, center, width: _pair(one, u * f.rate_scale_dps, center, width),
        lambda n, f, center, width: _pair_c(sign, "w", n, center, width),
    )


def _bump_of_asinh(sign: str) -> Shape:
    one = float(f"{sign}1")

    def in_c(n: Number, f: Frame, center: float, width: float) -> str:
        return _pair_c(sign, f"asinh@f@(w / {n(f.rate_scale_dps * ASINH_SHARE)})", n, center, width)

    return Shape(
        ("center", "width"),
        lambda u, f, center, width: _pair(one, _logarithmic(u), center, width),
        in_c,
    )


_ONE = Shape((), lambda x, f: np.ones(x.shape), lambda n, f: "")

#: Factors of the rate, functions of ``u``. Even bumps are G(w - c) + G(w + c), odd ones the difference; G is a
#: Gaussian of standard deviation `width`. The asinh ones live on asinh(u / 0.001).
RATE: dict[str, Shape] = {
    "one": _ONE,
    "linear": Shape((), lambda u, f: u, lambda n, f: f"({_u_c(n, f)})"),
    "legendre": Shape(
        ("order",),
        lambda u, f, order: legendre(u, order),
        lambda n, f, order: f"PREFIX_legendre@f@({_u_c(n, f)}, {round(order)})",
    ),
    "absolute": Shape((), lambda u, f: np.abs(u), lambda n, f: f"fabs@f@({_u_c(n, f)})"),
    "even_bump": _bump_of_rate("+"),
    "odd_bump": _bump_of_rate("-"),
    "even_asinh_bump": _bump_of_asinh("+"),
    "odd_asinh_bump": _bump_of_asinh("-"),
}

#: Factors of the temperature, functions of ``v``. An edge goes from -1 to 1, by 76 % of it within a width of its center.
TEMPERATURE: dict[str, Shape] = {
    "one": _ONE,
    "legendre": Shape(
        ("order",),
        lambda v, f, order: legendre(v, order),
        lambda n, f, order: f"PREFIX_legendre@f@({_v_c(n, f)}, {round(order)})",
    ),
    "bump": Shape(
        ("center_c", "width_c"),
        lambda v, f, center, width: _bump(v * f.temp_scale_c + f.temp_center_c, center, width),
        lambda n, f, center, width: f"PREFIX_bump@f@(temp_c, {n(center)}, {n(width)})",
    ),
    "edge": Shape(
        ("center_c", "width_c"),
        lambda v, f, center, width: np.tanh((v * f.temp_scale_c + f.temp_center_c - center) / width),
        lambda n, f, center, width: f"tanh@f@((temp_c - ({n(center)})) / {n(width)})",
    ),
}

#: What a driver remembers of temperatures and rates: kind (``lag``, ``rate``, ``play`` or ``heat``) and its number.
Trace = tuple[str, float]


@dataclass(frozen=True)
class Driver:
    """Names of its numbers; the traces that it needs; its values and its C; the channel that it cannot do without.

    `value` is called with conditions, frame, traces and numbers; `c` with a writer of numbers, the frame, the memory
    of the header and the numbers.
    """

    names: tuple[str, ...]
    traces: Callable[..., tuple[Trace, ...]]
    value: Callable[..., Floats]
    c: Callable[..., str]
    channel: str = "temp_c"


def _no_traces(*_: float) -> tuple[Trace, ...]:
    return ()


#: Drivers. A lag and a play are what the low-passed temperature or the play's position is above the temperature; heat is the
#: low-passed square of the scaled rate.
DRIVERS: dict[str, Driver] = {
    "one": Driver((), _no_traces, lambda c, f, traces: np.ones(len(c)), lambda n, f, m: ""),
    "lag": Driver(
        ("tau_s",),
        lambda tau: (("lag", tau),),
        lambda c, f, traces, tau: traces["lag", tau],
        lambda n, f, m, tau: f"(-{m.lag(tau)})",
    ),
    "band": Driver(
        ("tau_s", "longer_tau_s"),
        lambda tau, longer: (("lag", tau), ("lag", longer)),
        lambda c, f, traces, tau, longer: traces["lag", tau] - traces["lag", longer],
        lambda n, f, m, tau, longer: f"({m.lag(longer)} - {m.lag(tau)})",
    ),
    "temperature_rate": Driver(
        (),
        lambda: (("rate", SMOOTHING_S),),
        lambda c, f, traces: traces["rate", SMOOTHING_S],
        lambda n, f, m: f"({m.lag(SMOOTHING_S)} / {n(SMOOTHING_S)})",
    ),
    "play": Driver(
        ("half_width_c",),
        lambda r: (("play", r),),
        lambda c, f, traces, r: traces["play", r],
        lambda n, f, m, r: f"(@real@)({m.play(r)} - temp_c)",
    ),
    "heat": Driver(
        ("tau_s",),
        lambda tau: (("heat", tau),),
        lambda c, f, traces, tau: traces["heat", tau] / f.rate_scale_dps**2,
        lambda n, f, m, tau: f"({m.heat(tau)} / {n(f.rate_scale_dps**2)})",
        "rate_dps",
    ),
    "warm_up": Driver(
        ("tau_s",),
        _no_traces,
        lambda c, f, traces, tau: np.exp(-c.need("since_power_on_s") / tau),
        lambda n, f, m, tau: f"exp@f@(-since_power_on_s / {n(tau)})",
        "since_power_on_s",
    ),
    "supply": Driver(
        (),
        _no_traces,
        lambda c, f, traces: above_usual(c, f.supply_v),
        lambda n, f, m: above_usual_c(n, f.supply_v),
        "supply_v",
    ),
    "supply_squared": Driver(
        (),
        _no_traces,
        lambda c, f, traces: above_usual(c, f.supply_v) ** 2,
        lambda n, f, m: f"({above_usual_c(n, f.supply_v)} * {above_usual_c(n, f.supply_v)})",
        "supply_v",
    ),
}
