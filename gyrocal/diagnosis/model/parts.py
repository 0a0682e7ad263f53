"""Everything that a calibration may contain, as parts of an additive model of the error over the input rate.

Parts that stay with the gyro are sums of columns that a robot can evaluate (`gyrocal.physics.smooth`); what passes
(a drift, an error of the table, noise) is fitted beside them and left out of the correction.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from gyrocal.diagnosis.model.settling import SETTLING
from gyrocal.diagnosis.rows.means import Means
from gyrocal.diagnosis.rows.series import LEAST_SUPPLY_V
from gyrocal.diagnosis.rows.visited import (
    LEAST_SPAN_C,
    TEMP_BUMPS,
    apart,
    tells_of_branches,
    tells_of_scale,
    temperatures_apart,
    temperatures_turned,
    turned,
)
from gyrocal.inference.additive import Component
from gyrocal.inference.processes import ornstein_uhlenbeck, wiener
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.offer import turned_back_c
from gyrocal.physics.shapes import ASINH_SHARE, DRIVERS
from gyrocal.physics.smooth import Column, Factor, Frame, design, histories, rate_factors, temperature_factors
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Blocks of laws: what is odd and even in the rate, what remembers the temperature, what settles since power-on, and what bias
#: and scale factor do in time.
ODD, EVEN, MEMORY, SINCE_ON = "odd rate", "even rate", "memory", "warm-up"
BIAS_IN_TIME, SCALE_IN_TIME = "bias in time", "scale in time"
#: Component, and block, of errors of single rates, which explain whatever laws of the rate do.
EACH_RATE = "each rate"
#: Block of what remembers past rates.
PAST_RATES = "past rates"
#: Blocks that follow the temperature, and with it the order of the plan.
FOLLOWING = (MEMORY, "temperature")
#: Block of the scale factor's next order in temperature where temperatures are just enough for it: what it is nobody can tell.
AT_FEW = "scale over temperature"

#: Share of the full lag and time constant (s) of the coil; None: the coil has the sensor's temperature.
Coil = tuple[float, float] | None

#: Scaled rates at which shapes in rate are compared with the surface.
EVENLY = np.linspace(-1.0, 1.0, 401)
_LINEAR = Factor("linear")
#: Driver of the time since power-on.
_SINCE_ON = next(kind for kind, d in DRIVERS.items() if d.channel == "since_power_on_s")
#: Each further order of rate or temperature is expected to be this much smaller.
_STEP = 0.2
#: Standard deviation of the bumps: in rate as a share of the range, in scaled temperature, in asinh(u/0.001).
_RATE_BUMP, _TEMP_BUMP, _NEAR_ZERO_BUMP = 0.12, 0.3, 0.8
#: Bumps in rate from rest to the largest, and in temperature from the lowest to the highest: nearer to each other than they
#: are wide, so that none falls between.
_RATE_BUMPS = 13
#: The same of narrow ones in temperature, for ripples and kinks, which the others smooth away and 1/f noise takes in.
_NARROW_BUMP, _NARROW_BUMPS = 0.1, 31
_BUMPS = ("temperature", _TEMP_BUMP, TEMP_BUMPS), ("narrow temperature", _NARROW_BUMP, _NARROW_BUMPS)
#: Share of their places that a record has to have visited: of the temperatures most, since what is between them can follow
#: time; of the rates fewer, as they come again, and without bumps a ripple over the rate is a knee.
_VISITED, _VISITED_RATES = 0.7, 0.5
#: Powers of temperature beyond the surface's own, of bias and scale factor each; bumps follow what is no power.
_TEMP_ORDERS = 3
#: Time constants of what remembers temperature and of what warms up, s: sums of exponentials an octave apart follow
#: anything between, a stretched one too.
_LAGS_S, _WARM_UPS_S = 40.0 * 2.0 ** np.arange(6), 150.0 * 2.0 ** np.arange(6)
#: The same of the heat of past turns.
_HEATS_S = 150.0 * 2.0 ** np.arange(5)
#: Half widths of the plays, as shares of the range of temperatures.
_PLAYS = (0.01, 0.02, 0.035, 0.06, 0.10, 0.16, 0.25)
#: A warming that tells the slope of a surface, degC.
_WARMER_C = 0.01
#: Name of the processes whose sum is 1/f noise, before the memory of each.
FLICKER = "flicker"
#: Memories of the processes whose sum is 1/f noise, s: a decade apart it is so to some percent.
_FLICKER_S = (20.0, 200.0, 2000.0, 20000.0)
#: Fewer degC than so many times those of one temperature say nothing of shapes in temperature.
_SHAPED = 4.0
DRIFTING_BIAS, DRIFTING_SCALE = "bias drift", "scale drift"
#: Rates that differ by less are one: tables repeat theirs closer.
_SAME_RATE_DPS = 0.01
#: Of more rates none has data sets enough to tell an error of its own from what is smooth.
_MOST_RATES = 80


def _legendre(order: int) -> Factor:
    return Factor("legendre", (float(order),)) if order else Factor()


def term(i: int, j: int) -> int:
    """Where the term of these orders in rate and temperature stands in `SURFACE`."""
    return SHAPE[1] * i + j


#: The twelve terms of the surface as products of Legendre polynomials, row-major as in `physics.surface`.
SURFACE = tuple(
    Column(_LINEAR if i == 1 else _legendre(i), _legendre(j))
    for i in range(SHAPE[0])
    for j in range(SHAPE[1])
)
#: Of these: cubic in the rate and linear in temperature for bias and scale factor are always free ...
FLAT = (*(term(i, 0) for i in range(SHAPE[0])), term(0, 1), term(1, 1))
#: ... and the others are expected to be small, with one variance, the bend of the bias less than what that of the scale factor
#: does at the largest rate.
SHRUNK = {term(0, 2): 0.3, term(1, 2): 1.0} | {term(i, j): 0.2 / j for j in (1, 2) for i in (2, 3)}


@dataclass(frozen=True)
class Part:
    """Columns with one variance.

    Attributes
    ----------
    block : str
        What it is taken out and kept together with, a key of `BLOCKS`.
    weights : tuple of float
        Expected size of each column's amplitude, relative to each other.
    toll : float
        What it costs to have been given the shape that it has, nats.
    """

    name: str
    block: str
    columns: tuple[Column, ...]
    weights: tuple[float, ...]
    toll: float = 0.0


@dataclass(frozen=True)
class Block:
    """Family and coordinate of what is decided together.

    Attributes
    ----------
    stays : bool
        Whether it is part of the gyro.
    lasts : bool
        Whether it goes into the file: what stays, and where a scale factor was at the end of its course. Neither
        walks as a rule: what a law leaves of it is the law's misfit.
    """

    family: str
    coordinate: str
    stays: bool = True
    lasts: bool = True


BLOCKS = {
    MEMORY: Block("thermal transient", "temperature_rate"),
    PAST_RATES: Block("thermal transient", "rate"),
    ODD: Block("rate shape", "rate"),
    EVEN: Block("rate shape", "rate"),
    "temperature": Block("temperature shape", "temperature"),
    AT_FEW: Block("temperature shape", "temperature"),
    SINCE_ON: Block("time", "time_since_power_on"),
    "supply": Block("supply", "supply"),
    BIAS_IN_TIME: Block("time", "time", stays=False, lasts=False),
    SCALE_IN_TIME: Block("time", "time", stays=False),
    SETTLING: Block("step", "time_since_step", stays=False, lasts=False),
    EACH_RATE: Block("rate shape", "rate", stays=False, lasts=False),
}


def frame_of(means: Means) -> Frame:
    """Scales that span the record; the supply counts from its median."""
    temp_c = means.series.history.temp_c
    low, high = float(temp_c.min()), float(temp_c.max())
    supply = 0.0 if means.supply_v is None else float(np.median(means.supply_v))
    return Frame(
        float(np.max(np.abs(means.rate_dps))) or 1.0, 0.5 * (low + high), max(0.5 * (high - low), 0.5), supply
    )


@dataclass
class Basis:
    """Columns at the rows of a record, each driver worked out once.

    Drivers run on the fine grid of the temperature history and are averaged over each row. The surface lives at the
    temperature of the coil.
    """

    means: Means
    frame: Frame
    coil: Coil = None
    _known: dict[Factor, Floats] = field(default_factory=dict)

    def drivers(self, wanted: list[Factor]) -> dict[Factor, Floats]:
        """Means of drivers over the rows."""
        new = [d for d in dict.fromkeys(wanted) if d not in self._known]
        m, h = self.means, self.means.series.history
        past = Conditions(t_s=h.t_s, rate_dps=np.zeros(h.t_s.size), temp_c=h.temp_c)
        on_grid = [d for d in new if DRIVERS[d.kind].channel == "temp_c" and d != Factor()]
        for driver, values in histories(past, self.frame, on_grid)[0].items():
            self._known[driver] = self._averaged(values)
        here = Conditions(m.t_s, m.rate_dps, m.temp_c, supply_v=m.supply_v, since_power_on_s=since_on(m))
        self._known |= histories(here, self.frame, [d for d in new if d not in on_grid])[0]
        return self._known

    def _averaged(self, values: Floats) -> Floats:
        m, h = self.means, self.means.series.history
        points = np.interp(m.t_s, h.t_s, values)
        from_s, to_s = (np.clip(t, h.t_s[0], h.t_s[-1]) for t in (m.from_s, m.to_s))
        total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1])) * h.step_s])
        whole = np.interp(to_s, h.t_s, total) - np.interp(from_s, h.t_s, total)
        wide = to_s - from_s > 2.0 * h.step_s
        return np.where(wide, whole / np.where(wide, to_s - from_s, 1.0), points)

    def at(self, columns: tuple[Column, ...]) -> Floats:
        """Columns, shape (n, p)."""
        drivers = self.drivers([c.driver for c in columns])
        return design(self.means.rate_dps, self.means.temp_c, self.frame, columns, drivers)

    def surface(self) -> Floats:
        """The twelve terms of the surface, shape (n, 12)."""
        here = self.at(SURFACE)
        if self.coil is None:
            return here
        share, tau = self.coil
        behind = self.means.series.history.lagged_at(tau, self.means.t_s)
        there = design_at(self.means.rate_dps, behind, self.frame)
        return np.asarray((1.0 - share) * here + share * there)

    def component(self, part: Part) -> Component:
        """A part freed of the surface's polynomials, and scaled by its weights."""
        if part.block == "surface":
            own = self.surface()[:, [SURFACE.index(c) for c in part.columns]]
        else:
            own = self.at(part.columns) - self.surface() @ polynomials(part.columns, self.frame)
        columns = own * np.array(part.weights)
        return Component(part.name, columns, expected=part.block == "surface", toll=part.toll)


def legendre_to_powers() -> Floats:
    """Coefficients of ``u^i v^j`` from those of ``P_i(u) P_j(v)``, row-major, shape (12, 12): for a file."""
    powers = [np.pad(legendre.leg2poly(np.eye(n + 1)[n]), (0, SHAPE[0] - n - 1)) for n in range(SHAPE[0])]
    rate = np.array(powers).T
    return np.kron(rate, rate[: SHAPE[1], : SHAPE[1]])


def design_at(rate_dps: Floats, temp_c: Floats, frame: Frame) -> Floats:
    """The twelve terms of the surface at rates and temperatures, shape (n, 12)."""
    one = {Factor(): np.ones(rate_dps.size)}
    return design(rate_dps, temp_c, frame, SURFACE, one)


def slope_by_temperature(rate_dps: Floats, temp_c: Floats, frame: Frame, surface: Floats) -> Floats:
    """How fast a surface changes with temperature, shape (n,), deg/s for each degC.

    Parameters
    ----------
    surface : its coefficients, of Legendre products, shape (12,)
    """
    warmer = design_at(rate_dps, temp_c + _WARMER_C, frame) - design_at(rate_dps, temp_c, frame)
    return np.asarray(warmer @ surface / _WARMER_C)


def since_on(means: Means) -> Floats:
    """Time since power-on; since what counts as that where nobody says."""
    known = means.since_power_on_s
    return means.t_s - means.series.switched_on_s if known is None else known


def polynomials(columns: tuple[Column, ...], frame: Frame) -> Floats:
    """What the surface's polynomials take of memoryless columns, on a uniform grid: shape (12, p)."""
    u, v = EVENLY, np.linspace(-1.0, 1.0, 201)
    temps = frame.temp_center_c + frame.temp_scale_c * v
    rates = rate_factors(u * frame.rate_scale_dps, frame, (c.rate for c in (*columns, *SURFACE)))
    temperatures = temperature_factors(temps, frame, (c.temperature for c in (*columns, *SURFACE)))
    of_rate = np.linalg.pinv(np.column_stack([rates[SURFACE[term(i, 0)].rate] for i in range(SHAPE[0])]))
    of_temp = np.linalg.pinv(
        np.column_stack([temperatures[SURFACE[term(0, j)].temperature] for j in range(SHAPE[1])])
    )
    found = np.zeros((len(SURFACE), len(columns)))
    for k, c in enumerate(columns):
        if c.driver == Factor():
            found[:, k] = np.outer(of_rate @ rates[c.rate], of_temp @ temperatures[c.temperature]).ravel()
    return found


def surface_part(carried: Ints) -> Part:
    """The terms of the surface that are not free, as far as a record carries them."""
    kept = {k: w for k, w in SHRUNK.items() if k in carried}
    return Part("surface", "surface", tuple(SURFACE[k] for k in kept), tuple(kept.values()))


def staying(means: Means, frame: Frame, carried: Ints, *, memory: bool = True) -> list[Part]:
    """All parts that stay with the gyro and that this record may tell of.

    Parameters
    ----------
    carried : terms of the surface that rates and temperatures can tell apart
    memory : whether parts that remember temperatures or rates, and a warm-up, are among them
    """
    found = [surface_part(carried)]
    turning = _turns(means)
    span_c = float(np.ptp(means.series.history.temp_c))
    if turning:
        found += _of_rate(means, frame)
        found += [_of_past_rates(means)] if memory else []
    if span_c > _SHAPED * LEAST_SPAN_C:
        found += _of_temperature(means, frame, turning)
    if memory:
        found += remembering(means)
        warm = tuple(
            Column(driver=Factor(_SINCE_ON, (float(tau),)))
            for tau in _WARM_UPS_S
            if tau < 2.0 * np.ptp(means.t_s)
        )
        found.append(_part("warm-up", SINCE_ON, warm))
    if means.supply_v is not None and np.ptp(means.supply_v) > LEAST_SUPPLY_V:
        found.append(_part("supply", "supply", (Column(driver=Factor("supply")),)))
        found.append(_part("supply squared", "supply", (Column(driver=Factor("supply_squared")),)))
        if turning:
            found.append(_part("supply on scale", "supply", (Column(_LINEAR, driver=Factor("supply")),)))
    return [p for p in found if p.columns]


def _turns(means: Means) -> bool:
    return np.unique(np.round(means.rate_dps, 2)).size > 3


def _part(name: str, block: str, columns: tuple[Column, ...], weights: tuple[float, ...] = ()) -> Part:
    return Part(name, block, columns, weights or (1.0,) * len(columns))


def _of_rate(means: Means, frame: Frame) -> list[Part]:
    """Shapes in rate that the visited rates can tell from each other.

    As many as there are rates, the surface's included: more of them go through every one, and between two of them anywhere.
    """
    found = []
    spacing = frame.rate_scale_dps / (_RATE_BUMPS - 1.0)
    sizes = np.abs(means.rate_dps)
    # What is nearer to rest tells of the shapes near zero alone: through it an order of the rate could have any size elsewhere.
    visited = apart(sizes[sizes > 0.5 * spacing], spacing)
    centers = spacing * np.arange(_RATE_BUMPS)
    near_zero = _near_visited(np.arcsinh(sizes / (ASINH_SHARE * frame.rate_scale_dps)))
    for parity, block, orders, first in (
        ("odd", ODD, range(5, min(2 * visited, 12), 2), 1),
        ("even", EVEN, range(4, min(2 * visited + 1, 11), 2), 0),
    ):
        columns = tuple(Column(_legendre(n)) for n in orders)
        falling = tuple(_STEP**k for k in range(len(columns)))
        found.append(_part(f"{parity} orders", block, columns, falling))
        # A rate that is near to rest stands for rest, where bumps begin.
        if apart(sizes[sizes > 0.0], spacing) > _VISITED_RATES * _RATE_BUMPS:
            width = _RATE_BUMP * frame.rate_scale_dps
            bumps = [Factor(f"{parity}_bump", (float(c), width)) for c in centers[first:]]
            found.append(_part(f"{parity} bumps", block, tuple(map(Column, bumps))))
        bumps = [
            Factor(f"{parity}_asinh_bump", (c, _NEAR_ZERO_BUMP)) for c in near_zero if c > 0.0 or not first
        ]
        found.append(_part(f"{parity} near zero", block, tuple(map(Column, bumps))))
        with_t = tuple(Column(_legendre(n), _legendre(j)) for n in orders[:2] for j in (1, 2))
        weights = (1.0, 1.0, _STEP, _STEP)[: len(with_t)]
        found.append(_part(f"{parity} orders by temperature", block, with_t, weights))
    found.append(_part("absolute rate", EVEN, (Column(Factor("absolute")),)))
    with_t = tuple(Column(Factor("absolute"), _legendre(j)) for j in (1, 2))
    found.append(_part("absolute rate by temperature", EVEN, with_t, (1.0, _STEP)))
    return [part for part in found if part.columns]


def _of_past_rates(means: Means) -> Part:
    """What the bias keeps of the heat of past turns; what it has forgotten by the next data set is a shape in rate."""
    least_s, most_s = float(np.median(np.diff(means.t_s))), float(np.ptp(means.t_s))
    heats = [Factor("heat", (float(tau),)) for tau in _HEATS_S if least_s < tau < most_s]
    return _part("heat of past rates", PAST_RATES, tuple(Column(driver=d) for d in heats))


def _near_visited(places: Floats) -> list[float]:
    """Centers of the bumps near zero, over asinh of the rate, within two widths of some rate: of others no more than the foot is seen."""
    centers = np.arange(0.0, np.arcsinh(1.0 / ASINH_SHARE), _NEAR_ZERO_BUMP)
    away = np.min(np.abs(centers[:, None] - np.unique(np.round(places, 2))), axis=1)
    return [float(c) for c in centers[away <= 2.0 * _NEAR_ZERO_BUMP]]


def _of_temperature(means: Means, frame: Frame, turning: bool) -> list[Part]:
    """The same in temperature, of the bias and, at the temperatures at which it turned, of the scale factor."""
    found = []
    of_scale = (("scale", _LINEAR),) if turning and tells_of_scale(means) else ()
    for target, rate in (("bias", Factor()), *of_scale):
        temps_c = temperatures_turned(means) if target == "scale" else means.temp_c
        orders = range(SHAPE[1], min(SHAPE[1] + _TEMP_ORDERS, temperatures_apart(temps_c, frame)))
        powers = tuple(Column(rate, _legendre(n)) for n in orders)
        falling = tuple(_STEP**k for k in range(len(powers)))
        found.append(_part(f"temperature orders on {target}", "temperature", powers, falling))
        for kind, width, count in _BUMPS:
            if temperatures_apart(temps_c, frame, count) > _VISITED * count:
                centers = frame.temp_center_c + frame.temp_scale_c * np.linspace(-1.0, 1.0, count)
                bumps = (Factor("bump", (float(c), width * frame.temp_scale_c)) for c in centers)
                columns = tuple(Column(rate, b) for b in bumps)
                found.append(_part(f"{kind} on {target}", "temperature", columns))
    if turning and not of_scale and temperatures_apart(temperatures_turned(means), frame) > SHAPE[1]:
        found.append(_part("next order on scale", AT_FEW, (Column(_LINEAR, _legendre(SHAPE[1])),)))
    return [part for part in found if part.columns]


def remembering(means: Means) -> list[Part]:
    """Parts that remember the temperature; none where it does not change."""
    span_c, span_s = float(np.ptp(means.series.history.temp_c)), float(np.ptp(means.t_s))
    if span_c <= LEAST_SPAN_C:
        return []
    lags = [Factor("lag", (float(tau),)) for tau in _LAGS_S if tau < span_s]
    bands = [Factor("band", (float(a), float(b))) for a, b in pairwise(_LAGS_S) if b < span_s]
    back_c = turned_back_c(means.series.history.temp_c)
    widths_c = [share * span_c for share in _PLAYS if share * span_c <= back_c]
    plays = [Factor("play", (width_c,)) for width_c in widths_c if tells_of_branches(means.temp_c)]
    slope, one = _legendre(1), Factor()
    found = [
        _part("lag on bias", MEMORY, tuple(Column(driver=d) for d in lags)),
        _part("lag on bias by temperature", MEMORY, tuple(Column(one, slope, d) for d in lags)),
        _part("band on bias", MEMORY, tuple(Column(driver=d) for d in bands)),
        _part("temperature rate", MEMORY, (Column(driver=Factor("temperature_rate")),)),
        _part("play on bias", MEMORY, tuple(Column(driver=d) for d in plays)),
        _part("play on bias by temperature", MEMORY, tuple(Column(one, slope, d) for d in plays)),
    ]
    if _turns(means) and tells_of_scale(means):
        found += [
            _part("lag on scale", MEMORY, tuple(Column(_LINEAR, one, d) for d in lags)),
            _part("lag on scale by temperature", MEMORY, tuple(Column(_LINEAR, slope, d) for d in lags)),
            _part("band on scale", MEMORY, tuple(Column(_LINEAR, one, d) for d in bands)),
            _part("temperature rate on scale", MEMORY, (Column(_LINEAR, one, Factor("temperature_rate")),)),
            _part("play on scale", MEMORY, tuple(Column(_LINEAR, one, d) for d in plays)),
        ]
    return [p for p in found if p.columns]


#: Blocks of what passes, by the name of the component.
PASSING = {
    "bias walk": BIAS_IN_TIME,
    "scale line": SCALE_IN_TIME,
    "scale walk": SCALE_IN_TIME,
    SETTLING: SETTLING,
    EACH_RATE: EACH_RATE,
}


def passing(means: Means, frame: Frame) -> list[Component]:
    """What does not stay: the bias and the scale factor in time, an error of each rate, noise."""
    u = means.felt_dps / frame.rate_scale_dps
    walk = wiener(means.t_s)
    found = [Component("bias walk", covariance=walk)]
    if turned(means).any():
        ahead = (means.t_s - means.t_s[-1]) / (float(np.ptp(means.t_s)) or 1.0)
        if tells_of_scale(means):
            found.append(Component("scale line", (ahead * u)[:, None]))
        found.append(Component("scale walk", covariance=walk * np.outer(u, u)))
        each = by_size(means, u)
        if 3 < each.shape[1] < _MOST_RATES:
            found.append(Component(EACH_RATE, each))
        found.append(Component("jitter", covariance=np.diag(u**2)))
    return found + noise(means)


def of_each_direction(means: Means, frame: Frame) -> Component:
    """What errors of each rate, which are odd in the rate, have of their own in each direction."""
    return Component("each direction", by_size(means, np.abs(means.felt_dps) / frame.rate_scale_dps))


def by_size(means: Means, values: Floats) -> Floats:
    """Values at each size of rate by itself, shape (n, sizes)."""
    sizes = np.round(np.abs(means.rate_dps) / _SAME_RATE_DPS)
    return np.where(sizes[:, None] == np.unique(sizes[sizes > 0]), values[:, None], 0.0)


def drifts(means: Means, frame: Frame) -> list[Component]:
    """Straight drifts of the bias and the scale factor, of which the surface has the mean."""
    away = (means.t_s - np.mean(means.t_s)) / (float(np.ptp(means.t_s)) or 1.0)
    u = means.felt_dps / frame.rate_scale_dps
    return [Component(DRIFTING_BIAS, away[:, None]), Component(DRIFTING_SCALE, (away * u)[:, None])]


def noise(means: Means) -> list[Component]:
    """White noise and 1/f noise of the bias."""
    row_s = means.to_s - means.from_s
    nearest = float(np.median(np.diff(means.t_s)))
    found = [
        Component(f"{FLICKER} {tau:g} s", covariance=ornstein_uhlenbeck(means.t_s, row_s, tau))
        for tau in _FLICKER_S
        if tau > nearest
    ]
    white = means.white_dps**2
    return [*found, Component("white", covariance=np.diag(white / np.mean(white)))]
