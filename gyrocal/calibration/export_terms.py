"""Terms of a coefficient file as C: what the gyro remembers, each effect's law, and the solution for the rate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gyrocal.errors import CoefficientError
from gyrocal.physics.effect import MDPS, PPM
from gyrocal.physics.rate import ROUNDS
from gyrocal.physics.terms import RuntimeTerm
from gyrocal.physics.thermal import SMOOTHING_S
from gyrocal.units import S_PER_MIN

#: Writes a number in the C type of the function.
Number = Callable[[float], str]


@dataclass(frozen=True)
class TermSource:
    """C of the terms.

    Attributes
    ----------
    text : str
        Functions.
    state : str
        What is remembered and how, where something is. In double also for the float functions: a lag of minutes
        at 100 samples a second changes by less than the digits of a float hold.
    parameters, arguments : str
        Of ``PREFIX_error``: declared, and handed on.
    """

    text: str
    state: str
    parameters: str
    arguments: str


@dataclass(frozen=True)
class _Memory:
    """Time constants (s) and half widths of plays (deg C) that the state keeps, in the order of their index."""

    tau_s: list[float]
    width_c: list[float]

    def lag(self, tau_s: float) -> str:
        self.tau_s.append(tau_s)
        return f"(@real@)s->behind_c[{len(self.tau_s) - 1}]"

    def play(self, width_c: float) -> str:
        self.width_c.append(width_c)
        return f"s->play_c[{len(self.width_c) - 1}]"


def _law(effect_id: str, p: Mapping[str, float], n: Number, memory: _Memory) -> str:
    """The effect's error as a C expression of ``w`` (rate), ``temp_c`` and the state."""
    a = p["amplitude"]
    if effect_id == "scale_asymmetry":
        return f"(w > 0 ? {n(PPM * a)} * w : 0)"
    if effect_id == "truncation":
        return f"{n(MDPS * a)} * (@real@)((w < 0) - (w > 0))"
    if effect_id == "sagnac_sine":
        return f"{n(a)} * w * PREFIX_sine_loss@f@({n(p['phase_rad_per_dps'])} * w)"
    if effect_id == "saturation":
        knee, k = n(p["knee_dps"]), n(a)
        return f"(w > {knee} ? {k} * ({knee} - w) : w < -{knee} ? -{k} * ({knee} + w) : 0)"
    if effect_id == "rate_order":
        return f"{n(MDPS * a)} * PREFIX_power@f@(w / {n(p['scale_dps'])}, {round(p['order'])})"
    if effect_id == "temperature_order":
        v = f"(temp_c - ({n(p['center_c'])})) / {n(p['scale_c'])}"
        return f"{n(MDPS * a)} * PREFIX_power@f@({v}, {round(p['order'])})"
    if effect_id == "fit_direction":
        return f"{n(a)} * PREFIX_direction@f@(w, temp_c)"
    if effect_id == "shupe":
        return f"{n(MDPS * a * S_PER_MIN / SMOOTHING_S)} * {memory.lag(SMOOTHING_S)}"
    if effect_id == "shupe_gradient":
        return f"{n(MDPS * a)} * {memory.lag(p['tau_s'])}"
    if effect_id == "thermal_lag":
        return f"{n(a)} * PREFIX_lagged@f@(w, temp_c, {memory.lag(p['tau_s'])})"
    if effect_id == "thermal_hysteresis":
        return f"{n(MDPS * a)} * (@real@)({memory.play(p['width_c'])} - temp_c)"
    if effect_id == "warm_up":
        return f"{n(MDPS * a)} * exp@f@(-since_power_on_s / {n(p['tau_s'])})"
    raise CoefficientError(
        f"The coefficients hold the term {effect_id}, which cannot be written in C: the surface alone would be wrong. "
        "Use gyrocal.fusion.Compensator on the robot, or export the coefficients from before diagnose."
    )


#: Helpers by the effect that calls them.
_HELPERS = {
    "sagnac_sine": """\
/* sin(x)/x - 1 by its series: the difference of nearly equal numbers would lose digits */
static inline @real@ PREFIX_sine_loss@f@(@real@ x)
{
    @real@ loss = 0;
    int k;
    for (k = 14; k > 0; k--) {
        loss = -x * x / (@real@)(2 * k * (2 * k + 1)) * (1 + loss);
    }
    return loss;
}
""",
    "power": """\
static inline @real@ PREFIX_power@f@(@real@ x, int order)
{
    @real@ power = 1;
    while (order-- > 0) {
        power *= x;
    }
    return power;
}
""",
    "fit_direction": """\
static inline @real@ PREFIX_direction@f@(@real@ w, @real@ temp_c)
{
    @real@ output = w;
    int i;
    for (i = 0; i < @rounds@; i++) {
        output = w + PREFIX_surface@f@(output, temp_c);
    }
    return PREFIX_surface@f@(w, temp_c) - PREFIX_surface@f@(output, temp_c);
}
""",
    "thermal_lag": """\
static inline @real@ PREFIX_lagged@f@(@real@ w, @real@ temp_c, @real@ behind_c)
{
    const @real@ output = w + PREFIX_surface@f@(w, temp_c);
    return PREFIX_surface@f@(output, temp_c - behind_c) - PREFIX_surface@f@(output, temp_c);
}
""",
}
_HELPER_OF = {"rate_order": "power", "temperature_order": "power"}

_STATE = """\
/* What the error remembers. Set all members to zero before the first sample. */
typedef struct {
    int started;
    double since_s, last_c@arrays@;
} PREFIX_state;

static inline void PREFIX_remember(PREFIX_state *s, double dt_s, double temp_c)
{
@constants@
    int i;
    s->since_s += dt_s > 0 ? dt_s : 0;
    if (!(temp_c - temp_c <= 0)) {
        return;
    }
    if (!s->started) {
        s->started = 1;
        s->since_s = 0;
        s->last_c = temp_c;
@start@    }
@update@    s->last_c = temp_c;
    s->since_s = 0;
}
"""

_START_PLAY = """\
        for (i = 0; i < @plays@; i++) {
            s->play_c[i] = temp_c;
        }
"""

_UPDATE_LAG = """\
    for (i = 0; i < @lags@; i++) {
        const double z = s->since_s / tau_s[i];
        const double gain = z > 0 ? -expm1(-z) / z : 1;
        s->behind_c[i] = exp(-z) * s->behind_c[i] + gain * (temp_c - s->last_c);
    }
"""

_UPDATE_PLAY = """\
    for (i = 0; i < @plays@; i++) {
        const double low = temp_c - width_c[i], high = temp_c + width_c[i];
        s->play_c[i] = s->play_c[i] < low ? low : s->play_c[i] > high ? high : s->play_c[i];
    }
"""

_ERROR = """\
static inline @real@ PREFIX_terms@f@(@term_parameters@)
{
@sum@
}

/* Rate w of the output: (output - terms at w) goes through the surface */
static inline @real@ PREFIX_error@f@(@parameters@)
{
    @real@ w = gyro_dps - PREFIX_surface@f@(gyro_dps, temp_c), error = 0;
    int i;
@remember@    for (i = 0; i < 60; i++) {
        const @real@ before = w, terms = PREFIX_terms@f@(@term_arguments@);
        error = terms + PREFIX_surface@f@(gyro_dps - terms, temp_c);
        w = gyro_dps - error;
        if (w - before <= @tolerance@ && before - w <= @tolerance@) {
            break;
        }
    }
    return error;
}
"""


def term_source(terms: tuple[RuntimeTerm, ...], number: Number, tolerance: str) -> TermSource:
    """C of the runtime terms; @real@, @f@ and PREFIX are left for who puts the header together.

    Raises
    ------
    CoefficientError
        An effect that has no C.
    """
    memory = _Memory([], [])
    laws = [_law(t.effect.id, t.parameters, number, memory) for t in terms]
    helpers = dict.fromkeys(_HELPER_OF.get(t.effect.id, t.effect.id) for t in terms)
    remembers = bool(memory.tau_s or memory.width_c)
    since = any("since_power_on_s" in t.effect.needs for t in terms)
    last = ["@real@ since_power_on_s"] if since else []
    first = ["PREFIX_state *s", "@real@ dt_s"] if remembers else []
    term_first = ["const PREFIX_state *s"] if remembers else []
    parameters = [*first, "@real@ gyro_dps", "@real@ temp_c", *last]
    body = [
        "    @real@ e = 0;",
        *(f"    e += {law};" for law in laws),
        "    (void)w;",
        "    (void)temp_c;",
        "    return e;",
    ]
    error = {
        "sum": "\n".join(body),
        "term_parameters": ", ".join([*term_first, "@real@ w", "@real@ temp_c", *last]),
        "term_arguments": ", ".join(_names([*term_first, "@real@ w", "@real@ temp_c", *last])),
        "parameters": ", ".join(parameters),
        "remember": "    PREFIX_remember(s, dt_s, temp_c);\n" if remembers else "",
        "tolerance": tolerance,
    }
    parts = [_HELPERS[name].replace("@rounds@", str(ROUNDS)) for name in helpers if name in _HELPERS]
    text = _ERROR
    for name, value in error.items():
        text = text.replace(f"@{name}@", value)
    state = _state(memory) if remembers else ""
    return TermSource("\n".join([*parts, text]), state, ", ".join(parameters), ", ".join(_names(parameters)))


def _names(parameters: list[str]) -> list[str]:
    return [parameter.replace("*", " ").split()[-1] for parameter in parameters]


def _state(memory: _Memory) -> str:
    lags, plays = len(memory.tau_s), len(memory.width_c)
    arrays = (f", behind_c[{lags}]" if lags else "") + (f", play_c[{plays}]" if plays else "")
    constants = [
        f"    static const double {name}[{len(values)}] = {{{', '.join(repr(x) for x in values)}}};"
        for name, values in (("tau_s", memory.tau_s), ("width_c", memory.width_c))
        if values
    ]
    text = _STATE.replace("@arrays@", arrays).replace("@constants@", "\n".join(constants))
    text = text.replace("@start@", _START_PLAY if plays else "")
    text = text.replace("@update@", (_UPDATE_LAG if lags else "") + (_UPDATE_PLAY if plays else ""))
    return text.replace("@lags@", str(lags)).replace("@plays@", str(plays))
