"""Terms of a coefficient file as C: what the gyro remembers, each effect's law, and the solution for the rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gyrocal.physics.c_text import CMemory, Number
from gyrocal.physics.inverse import FIRST_STEP, GROWTH, HALVINGS, SECANTS, STEPS
from gyrocal.physics.kernels import PAUSE_S, PAUSE_STEPS
from gyrocal.physics.surface import NEAR_ROUNDS, Surface
from gyrocal.physics.terms import Part


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


_STATE = """\
/* What the error remembers. Set all members to zero before the first sample. */
typedef struct {
    int started;
    double since_s, last_c@arrays@;
} PREFIX_state;

static inline void PREFIX_remember(PREFIX_state *s, double dt_s, double temp_c@rate@)
{
@constants@
    int i;
    s->since_s += dt_s > 0 ? dt_s : 0;
@heat@    if (!(temp_c - temp_c <= 0)) {
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

_UPDATE_HEAT = """\
    s->turned_s += s->turned && dt_s > 0 ? dt_s : 0;
    if (rate_dps - rate_dps <= 0) {
        const double square = rate_dps * rate_dps;
        for (i = 0; i < @heats@; i++) {
            const double z = s->turned_s / heat_tau_s[i], end = exp(-s->step_s / 2 / heat_tau_s[i]);
            const double gain = z > 0 ? -expm1(-z) / z : 1;
            double behind = s->last_dps2 - s->heat_dps2[i];
            if (s->step_s > 0 && s->turned_s > @pause_s@ && s->turned_s > @pause_steps@ * s->step_s) {
                behind = end * behind - s->last_dps2;
                behind = end * (exp(-(s->turned_s - s->step_s) / heat_tau_s[i]) * behind + square);
            } else {
                behind = exp(-z) * behind + gain * (square - s->last_dps2);
            }
            s->heat_dps2[i] = square - behind;
        }
        s->turned = 1;
        s->step_s = s->turned_s;
        s->turned_s = 0;
        s->last_dps2 = square;
    }
"""

#: The rate of the surface alone, which squares of past rates are made of, by the surface's direction.
_ALONE = {
    "output": """\
    const double rate_dps = gyro_dps - PREFIX_surface@f@(gyro_dps, temp_c);
""",
    "input": """\
    double rate_dps = gyro_dps;
    for (i = 0; i < @near_rounds@; i++) {
        rate_dps = gyro_dps - PREFIX_surface@f@((@real@)rate_dps, temp_c);
    }
""",
}

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

/* What is too much in `left`, the output minus the surface's own rate; and the error of the gyro with it */
static inline @real@ PREFIX_miss@f@(@real@ left, @miss_parameters@, @real@ *error)
{
    const @real@ own = gyro_dps - left, surface = PREFIX_surface@f@(own, temp_c);
@miss@}

/* Moves an end of the interval outward, as far as the output rises there or until it holds the solution */
static inline @real@ PREFIX_follow@f@(@real@ *end, @real@ step, @miss_parameters@)
{
    @real@ error, miss = PREFIX_miss@f@(*end, @miss_arguments@, &error);
    int i;
    for (i = 0; i < @steps@ && (step > 0 ? miss < 0 : miss > 0); i++) {
        const @real@ ahead = PREFIX_miss@f@(*end + step, @miss_arguments@, &error);
        if (!(step > 0 ? ahead > miss : ahead < miss)) {
            break;
        }
        *end += step;
        miss = ahead;
        step *= @growth@;
    }
    return miss;
}

/* Secants inside an interval that holds the solution, and halving where they are slow */
static inline @real@ PREFIX_error@f@(@parameters@)
{
    @real@ low = gyro_dps - (@own_high@), high = gyro_dps - (@own_low@);
    const @real@ step = (high - low) * @first_step@;
    @real@ at_low, at_high, left, slope, before = 0, miss_before = 0, error = 0;
    int i;
@remember@    at_low = PREFIX_follow@f@(&low, -step, @miss_arguments@);
    at_high = PREFIX_follow@f@(&high, step, @miss_arguments@);
    if (!(at_low <= 0 && at_high >= 0)) {
        return (@real@)NAN;
    }
    left = low > 0 ? low : high < 0 ? high : 0;
    slope = (at_high - at_low) / (high - low);
    for (i = 0; i < @rounds@; i++) {
        const @real@ miss = PREFIX_miss@f@(left, @miss_arguments@, &error);
        const @real@ tolerance = @tolerance@ + @digits@ * fabs@f@(left);
        @real@ ahead;
        if (fabs@f@(miss) <= tolerance || (i > 0 && fabs@f@(left - before) <= tolerance)) {
            break;
        }
        if (miss < 0) {
            low = left;
        } else {
            high = left;
        }
        if (i > 0) {
            slope = (miss - miss_before) / (left - before);
        }
        ahead = left - miss / slope;
        if (!(i < @secants@ && ahead >= low && ahead <= high)) {
            ahead = low + (high - low) / 2;
        }
        before = left;
        miss_before = miss;
        left = ahead;
    }
    return error;
}
"""

#: What follows the surface in ``PREFIX_miss``, by the surface's direction.
_MISS = {
    "output": """\
    *error = left + surface;
    return left - PREFIX_terms@f@(@term_call@);
""",
    "input": """\
    *error = left;
    return left - (surface + PREFIX_terms@f@(@term_call@));
""",
}
_RATE = {"output": "own - surface", "input": "own"}
_OWN = {"output": "w + PREFIX_surface@f@(w, temp_c)", "input": "w"}
_TURN = {"output": "", "input": "-"}

#: Tolerance and last digits of a solution in each C type.
_PRECISION = {"double": ("1e-12", "4.4e-16"), "float": ("1e-8f", "1.2e-7f")}


def term_source(surface: Surface, terms: Sequence[Part], number: Number, kind: str) -> TermSource:
    """C of the runtime terms and of the solution for the rate, in the C type `kind`.

    @real@, @f@ and PREFIX are left for who puts the header together.

    Raises
    ------
    CoefficientError
        An effect that has no C.
    """
    memory = CMemory()
    sources = [term.c_laws(number, memory) for term in terms]
    helpers = dict.fromkeys(helper for _, called in sources for helper in called)
    remembers = bool(memory.tau_s or memory.width_c or memory.heat_tau_s)
    alone = _ALONE[surface.direction] if memory.heat_tau_s else ""
    remember = f"{alone}    PREFIX_remember(s, dt_s, temp_c{', rate_dps' if alone else ''});\n"
    needed = frozenset().union(*(term.channels for term in terms))
    last = [f"@real@ {name}" for name in ("since_power_on_s", "supply_v") if name in needed]
    state = ["const PREFIX_state *s"] * remembers
    parameters = [*["PREFIX_state *s", "@real@ dt_s"] * remembers, "@real@ gyro_dps", "@real@ temp_c", *last]
    of_miss = [*state, "@real@ gyro_dps", "@real@ temp_c", *last]
    of_terms = [*state, "@real@ w", "@real@ temp_c", *last]
    body = [
        "    @real@ e = 0;",
        *(f"    e += {law};" for laws, _ in sources for law in laws),
        *(f"    (void){name};" for name in _names(of_terms)),
        "    return e;",
    ]
    tolerance, digits = _PRECISION[kind]
    values = {
        "miss": _MISS[surface.direction],
        "sum": "\n".join(body),
        "term_parameters": ", ".join(of_terms),
        "term_call": ", ".join(_RATE[surface.direction] if x == "w" else x for x in _names(of_terms)),
        "miss_parameters": ", ".join(of_miss),
        "miss_arguments": ", ".join(_names(of_miss)),
        "parameters": ", ".join(parameters),
        "remember": remember if remembers else "",
        "own_low": number(surface.rate_center_dps - surface.rate_scale_dps),
        "own_high": number(surface.rate_center_dps + surface.rate_scale_dps),
        "first_step": number(FIRST_STEP),
        "growth": number(GROWTH),
        "steps": str(STEPS),
        "secants": str(SECANTS),
        "near_rounds": str(NEAR_ROUNDS),
        "rounds": str(SECANTS + HALVINGS),
        "tolerance": tolerance,
        "digits": digits,
        "own": _OWN[surface.direction],
        "turn": _TURN[surface.direction],
    }
    text = filled("\n".join([*helpers, _ERROR]), values)
    return TermSource(
        text, _state(memory) if remembers else "", ", ".join(parameters), ", ".join(_names(parameters))
    )


def filled(text: str, values: Mapping[str, str]) -> str:
    """A text with values in their places, in this order: a value may have places for those that follow."""
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    return text


def _names(parameters: list[str]) -> list[str]:
    return [parameter.replace("*", " ").split()[-1] for parameter in parameters]


def _state(memory: CMemory) -> str:
    lags, plays = len(memory.tau_s), len(memory.width_c)
    heats = len(memory.heat_tau_s)
    sizes = {"behind_c": lags, "play_c": plays, "heat_dps2": heats}
    arrays = "".join(f", {name}[{size}]" for name, size in sizes.items() if size)
    turned = ";\n    int turned;\n    double turned_s, step_s, last_dps2" if heats else ""
    constants = [
        f"    static const double {name}[{len(values)}] = {{{', '.join(repr(x) for x in values)}}};"
        for name, values in vars(memory).items()
        if values
    ]
    values = {
        "arrays": arrays + turned,
        "constants": "\n".join(constants),
        "rate": ", double rate_dps" if heats else "",
        "heat": _UPDATE_HEAT if heats else "",
        "start": _START_PLAY if plays else "",
        "update": (_UPDATE_LAG if lags else "") + (_UPDATE_PLAY if plays else ""),
        "lags": str(lags),
        "plays": str(plays),
        "heats": str(heats),
        "pause_s": repr(PAUSE_S),
        "pause_steps": repr(PAUSE_STEPS),
    }
    return filled(_STATE, values)
