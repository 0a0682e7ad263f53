"""Effects of temperature and of its history.

A gyro feels the rate of its temperature at once, and who has a whole record knows it. A robot derives it causally from the
reported temperature, as the lag of a first-order low-pass divided by its time constant. `SMOOTHING_S` is a compromise stated
once: short against any ramp of a chamber (minutes), long enough that 0.02 degC of thermistor noise at 10 Hz is 0.04 degC/min
of rate noise. Fitted to such a rate an amplitude makes up for the delay: 2.5 times its size, beside a lag that is not there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.c_text import POWER, CMemory, CText, Number
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.effect import (
    Effect,
    Floats,
    amplitude,
    choice,
    count,
    memoryless,
    need_surface,
    of_scale,
    shape,
    where_it_acts,
    where_it_acts_c,
)
from gyrocal.physics.fold import on_lag, on_own, temperature_or_scale
from gyrocal.physics.hiding import Hiding, usual_draw
from gyrocal.physics.kernels import heat, lag, play
from gyrocal.physics.offer import (
    Offer,
    either,
    table_turns,
    temperature_changes,
    temperature_turned_back,
)
from gyrocal.physics.search import Search, Shape, Unit, scales
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS, S_PER_MIN

#: Time constant of the low-pass in the causal temperature rate, s.
SMOOTHING_S = 30.0
#: The rate whose heat in the long run is one, deg/s.
_USUAL_RATE_DPS = 100.0


def temperature_rate_c_per_s(c: Conditions, memory: Memory) -> tuple[Floats, Memory]:
    """Temperature rate, deg C/s: as it is known of a record, else low-passed by `SMOOTHING_S`."""
    if c.temp_rate_c_per_s is not None:
        return c.temp_rate_c_per_s, None
    behind_c, memory = lag(c.t_s, c.temp_c, SMOOTHING_S, memory)
    return behind_c / SMOOTHING_S, memory


def _shupe(
    c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
) -> tuple[Floats, Memory]:
    rate, memory = temperature_rate_c_per_s(c, memory)
    return MDPS * p["amplitude"] * S_PER_MIN * rate, memory


def _shupe_gradient(
    c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
) -> tuple[Floats, Memory]:
    behind_c, memory = lag(c.t_s, c.temp_c, p["tau_s"], memory)
    return MDPS * p["amplitude"] * behind_c, memory


def _thermal_lag(
    c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
) -> tuple[Floats, Memory]:
    surface = need_surface(surface, "thermal_lag")
    behind_c, memory = lag(c.t_s, c.temp_c, p["tau_s"], memory)
    own = _own_dps(c, surface)
    at_coil = surface.error_dps(own, c.temp_c - behind_c)
    return p["amplitude"] * (at_coil - surface.error_dps(own, c.temp_c)), memory


def _lag_by_surface(c: Conditions, p: Mapping[str, float], surface: Surface, memory: Memory) -> Floats:
    behind_c, _ = lag(c.t_s, c.temp_c, p["tau_s"], memory)
    own = _own_dps(c, surface)
    return np.asarray(
        p["amplitude"] * (surface.design(own, c.temp_c - behind_c) - surface.design(own, c.temp_c))
    )


def _own_dps(c: Conditions, surface: Surface) -> Floats:
    """The surface's own rate; its first-order inverse is enough for a difference of two nearby temperatures."""
    return (
        c.rate_dps if surface.direction == "input" else c.rate_dps + surface.error_dps(c.rate_dps, c.temp_c)
    )


def _hysteresis(
    c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
) -> tuple[Floats, Memory]:
    position, memory = play(c.temp_c, p["width_c"], memory)
    # The play minus the temperature itself: that part is the surface's, and without it the error is bounded.
    return where_it_acts(c, p, MDPS * p["amplitude"] * (position - c.temp_c)), memory


def _rate_heating(
    c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
) -> tuple[Floats, Memory]:
    squares, memory = heat(c.t_s, c.rate_dps, p["tau_s"], memory)
    return MDPS * p["amplitude"] * squares / _USUAL_RATE_DPS**2, memory


def _temperature_order(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    v = (c.temp_c - p["center_c"]) / p["scale_c"]
    return np.asarray(MDPS * p["amplitude"] * v ** round(p["order"]))


def _widths(offer: Offer) -> list[dict[str, float]]:
    least_c, most_c = 0.012 * offer.temp_span_c, min(0.45 * offer.temp_span_c, offer.temp_back_c)
    widths_c = np.geomspace(least_c, most_c, 11) if most_c > least_c > 0.0 else np.empty(0)
    on_bias = [{"width_c": x} for x in widths_c.tolist()]
    return on_bias + [{**shape, "of_scale": 1.0} for shape in on_bias if table_turns(offer) is None]


def _powers(offer: Offer) -> list[dict[str, float]]:
    low, high = offer.temp_c
    middle, half = (low + high) / 2, (high - low) / 2 or 1.0
    on_bias = [{"order": order, "center_c": middle, "scale_c": half} for order in (3.0, 4.0)]
    full = offer.largest_rate_dps
    return on_bias + ([{**shape, "rate_scale_dps": full} for shape in on_bias] if full else [])


def _order_columns(unit_dps: Unit, c: Conditions, given: Shape, surface: Surface | None) -> Floats:
    """The law on the bias; with a scale of the rate on the scale factor as well."""
    bias = unit_dps(c, given, surface)
    if "rate_scale_dps" not in given:
        return bias[:, None]
    return np.column_stack([bias, bias * c.rate_dps / given["rate_scale_dps"]])


def _draw_order(usual: Mapping[str, float], offer: Offer, rng: np.random.Generator) -> dict[str, float]:
    return usual_draw(usual, offer, rng) | _powers(offer)[0]


def _shupe_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(MDPS * p['amplitude'] * S_PER_MIN / SMOOTHING_S)} * {memory.lag(SMOOTHING_S)}"


def _shupe_gradient_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(MDPS * p['amplitude'])} * {memory.lag(p['tau_s'])}"


def _thermal_lag_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(p['amplitude'])} * PREFIX_lagged@f@(w, temp_c, {memory.lag(p['tau_s'])})"


def _hysteresis_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    played = f"{n(MDPS * p['amplitude'])} * (@real@)({memory.play(p['width_c'])} - temp_c)"
    return where_it_acts_c(p, n, played)


def _rate_heating_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(MDPS * p['amplitude'] / _USUAL_RATE_DPS**2)} * {memory.heat(p['tau_s'])}"


def _temperature_order_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    v = f"(temp_c - ({n(p['center_c'])})) / {n(p['scale_c'])}"
    return f"{n(MDPS * p['amplitude'])} * PREFIX_power@f@({v}, {round(p['order'])})"


_LAGGED = """\
static inline @real@ PREFIX_lagged@f@(@real@ w, @real@ temp_c, @real@ behind_c)
{
    const @real@ own = @own@;
    return PREFIX_surface@f@(own, temp_c - behind_c) - PREFIX_surface@f@(own, temp_c);
}
"""

#: Below this nothing that follows the temperature's history can be seen, deg C.
_SOME_CHANGE = temperature_changes(2.0)


SHUPE = Effect(
    id="shupe",
    family="thermal transient",
    equation="e = k dT/dt",
    statement="The bias follows the rate of change of temperature: the two halves of the coil warm unequally (Shupe effect).",
    parameters=(amplitude("mdeg/s per degC/min", 1000.0, 3.0, "bias per temperature rate"),),
    needs=("t_s", "temp_c"),
    seen_in="temperature_rate",
    looks_like=("shupe_gradient", "thermal_lag"),
    reference="Shupe, Applied Optics 19(5), 654-655 (1980)",
    runtime=True,
    error_dps=_shupe,
    has_memory=True,
    search=Search(requires=(_SOME_CHANGE,), limit_of="shupe_gradient"),
    c_text=CText(_shupe_c),
)

SHUPE_GRADIENT = Effect(
    id="shupe_gradient",
    family="thermal transient",
    equation="e = k (T - T_in), tau dT_in/dt = T - T_in",
    statement="The bias follows the temperature difference between outside and inside of the coil, and decays after a ramp.",
    parameters=(
        amplitude("mdeg/s per degC", 1000.0, 1.0, "bias per degree of difference"),
        shape("tau_s", "s", 30.0, 3600.0, 400.0, "time constant of the inside"),
    ),
    needs=("t_s", "temp_c"),
    seen_in="temperature_rate",
    looks_like=("shupe", "thermal_hysteresis", "thermal_lag"),
    reference="IEEE Std 952, temperature-gradient sensitivity",
    runtime=True,
    error_dps=_shupe_gradient,
    has_memory=True,
    search=Search(grid=scales(60.0, 3600.0, 12), refined=("tau_s",), requires=(_SOME_CHANGE,)),
    fold=on_own("T - T_in, °C"),
    c_text=CText(_shupe_gradient_c),
)

THERMAL_LAG = Effect(
    id="thermal_lag",
    family="thermal transient",
    equation="e = a (S(T_c) - S(T)), tau dT_c/dt = T - T_c, S the error surface",
    statement="The coil follows the temperature sensor with a lag, so that bias and scale factor belong to an earlier temperature "
    "(to a later one, by a sensor that lags behind the coil, if the amplitude is negative).",
    parameters=(
        amplitude("1", 3.0, 1.0, "share of the full lag"),
        shape("tau_s", "s", 15.0, 1800.0, 300.0, "time constant of the coil"),
    ),
    needs=("t_s", "temp_c"),
    seen_in="temperature_rate",
    looks_like=("shupe", "shupe_gradient"),
    reference="first-order heat flow between sensor and coil",
    runtime=True,
    error_dps=_thermal_lag,
    has_memory=True,
    search=Search(
        grid=scales(30.0, 1800.0, 10),
        refined=("tau_s",),
        requires=(_SOME_CHANGE, either(temperature_changes(10.0), table_turns)),
        # Physics report, G4: 1 to 10 min. A shorter one may be the smoothing of a noisy thermometer.
        usual={"tau_s": (60.0, 600.0)},
    ),
    fold=on_lag,
    c_text=CText(_thermal_lag_c, (_LAGGED,)),
    by_surface=_lag_by_surface,
)

THERMAL_HYSTERESIS = Effect(
    id="thermal_hysteresis",
    family="thermal transient",
    equation="e = k (P_r[T] - T), P_r the play operator of half width r; of the scale factor times w/(100 deg/s)",
    statement="Heating and cooling give different biases, or scale factors, at the same temperature, after any soak (hysteresis).",
    parameters=(
        amplitude("mdeg/s per degC", 1000.0, 1.0, "bias per degree of play"),
        shape("width_c", "degC", 0.2, 60.0, 5.0, "half width of the play"),
        of_scale(),
    ),
    needs=("t_s", "temp_c"),
    seen_in="temperature_branch",
    looks_like=("shupe_gradient", "bias_drift"),
    reference="Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989): play operator",
    runtime=True,
    error_dps=_hysteresis,
    has_memory=True,
    search=Search(
        grid=_widths,
        refined=("width_c",),
        requires=(temperature_turned_back,),
        # Friction of parts in each other, freed within some degrees. A wider play has hardly begun to move while a
        # record turns back, and looks like a step in time.
        usual={"width_c": (0.5, 15.0)},
        # A sum of plays is what hysteresis is in general (Prandtl and Ishlinskii).
        adds_up=True,
    ),
    fold=on_own("Play of the temperature, P[T] - T, °C"),
    c_text=CText(_hysteresis_c),
)

RATE_HEATING = Effect(
    id="rate_heating",
    family="thermal transient",
    equation="e = k h / (100 deg/s)^2, tau dh/dt = w^2 - h",
    statement="The bias follows the heat of past turns (drag of the air, bearings, the drive): their squares, and decays after them.",
    parameters=(
        amplitude("mdeg/s", 10000.0, 3.0, "bias after long turning at 100 deg/s"),
        # What decays sooner is the table's or the gyro's response to a step of the rate.
        shape("tau_s", "s", 100.0, 7200.0, 600.0, "time constant of the warming"),
    ),
    needs=("t_s", "rate_dps"),
    seen_in="rate",
    looks_like=("scale_asymmetry", "warm_up"),
    reference="first-order heat flow, of a loss that goes with the square of the rate",
    runtime=True,
    error_dps=_rate_heating,
    has_memory=True,
    search=Search(
        grid=scales(120.0, 3600.0, 12),
        refined=("tau_s",),
        requires=(table_turns,),
        # It grows as a warm-up does, which more gyros have.
        prior_nats=-2.0,
    ),
    fold=on_own("Heat of past turns, share of that of 100 °/s"),
    c_text=CText(_rate_heating_c),
)

TEMPERATURE_ORDER = Effect(
    id="temperature_order",
    family="temperature shape",
    equation="e = k ((T - T_m)/T_s)^n, n = 3, 4, ...",
    statement="The bias, or the scale factor with it, bends more with temperature than a quadratic can.",
    parameters=(
        amplitude("mdeg/s", 10000.0, 5.0, "size at T_m + T_s"),
        count("order", 3.0, 9.0, 3.0, "power"),
        choice("center_c", "degC", -100.0, 150.0, 20.0, "temperature T_m where it vanishes"),
        choice("scale_c", "degC", 1.0, 200.0, 30.0, "scale T_s"),
    ),
    needs=("temp_c",),
    seen_in="temperature",
    looks_like=(),
    reference="next order of the paper's eq. 3",
    runtime=True,
    error_dps=memoryless(_temperature_order),
    search=Search(
        grid=_powers,
        columns=_order_columns,
        requires=(_SOME_CHANGE,),
    ),
    hiding=Hiding(_draw_order),
    fold=temperature_or_scale,
    c_text=CText(_temperature_order_c, (POWER,)),
)

EFFECTS = (SHUPE, SHUPE_GRADIENT, THERMAL_LAG, THERMAL_HYSTERESIS, RATE_HEATING, TEMPERATURE_ORDER)
