"""Effects of the rate: shapes that a cubic leaves over, and errors that belong to single rates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.c_text import POWER, SINE_LOSS, CMemory, CText, Number
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import (
    Effect,
    Floats,
    amplitude,
    by_differences,
    choice,
    count,
    memoryless,
    need_surface,
    shape,
)
from gyrocal.physics.fold import near_zero_rate
from gyrocal.physics.hiding import Hiding, usual_draw
from gyrocal.physics.kernels import erf, normal
from gyrocal.physics.offer import (
    Offer,
    both_ways,
    cut_or_dead,
    data_at_rest,
    many_rates,
    many_sizes,
    sizes_for_even,
    sizes_for_knee,
    sizes_for_peak,
)
from gyrocal.physics.rate_shapes import (
    AT_REST,
    BAND,
    LOCKED,
    PEAKS,
    SAME_RATE_DPS,
    SMALL,
    dead_widths,
    each_rate,
    knees,
    loses,
    order_columns,
    orders,
    phases,
    rate_or_output,
    resonances,
    sides,
)
from gyrocal.physics.search import Search
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS, PPM

#: Two samples nearer than this are the same sample.
_SAME_TIME_S = 1e-6

#: Rounds of the inverse of the surface: a slope of 5 % leaves 1e-13 of the error after ten.
ROUNDS = 10

_SEED = choice("seed", "1", 0.0, 2.0**52, 1.0, "which draw")


def _asymmetry(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    soft = p["softness_dps"]
    # At rest nothing is added.
    return np.asarray(PPM * p["amplitude"] * (_above(c.rate_dps, soft) - soft * np.log(2.0)))


def _dead_zone(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    size = np.abs(c.rate_dps) / p["width_dps"]
    if p["form"] == AT_REST:
        return np.where(size < 1.0, -MDPS * p["amplitude"], 0.0)
    if p["form"] == SMALL:
        lost = np.where(size < 1.0, size, 0.0)
    elif p["form"] == BAND:
        lost = np.minimum(size, 1.0)
    else:
        # size - sqrt(size^2 - 1), without the difference of nearly equal numbers
        beyond = np.maximum(size, 1.0)
        lost = np.where(size < 1.0, size, 1.0 / (beyond + np.sqrt(beyond**2 - 1.0)))
    hidden = np.where(size < p["rest"], p["place_dps"], 0.0)
    lost = np.minimum(np.maximum(size - p["rest"], 0.0), lost)
    return np.asarray(hidden - MDPS * p["amplitude"] * np.sign(c.rate_dps) * lost)


def _truncation(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    half_dps, step_dps = MDPS * p["amplitude"], 2.0 * MDPS * abs(p["amplitude"])
    if c.gyro_dps is None and surface is not None and p["of_output"]:
        return np.asarray(-half_dps * _output_sign(c, surface))
    if c.gyro_dps is None:
        # What is less than a step is cut away whole: there means lose half of themselves on the average, and not
        # half a step, which a gyro at rest never had.
        return np.asarray(-0.5 * np.sign(half_dps) * np.clip(c.rate_dps, -step_dps, step_dps))
    if step_dps == 0.0:
        return np.zeros(len(c))
    cut = np.floor if half_dps > 0.0 else np.ceil
    return np.asarray(np.sign(c.gyro_dps) * cut(np.abs(c.gyro_dps) / step_dps) * step_dps - c.gyro_dps)


def _output_sign(c: Conditions, surface: Surface) -> Floats:
    """Sign of the output that is cut, at rest that of the bias.

    In a row that is a mean, the samples' noise lets it have that sign only so often.
    """
    output = c.rate_dps + surface.error_dps(c.rate_dps, c.temp_c)
    noise = c.sample_std_dps
    return erf(output / (np.sqrt(2.0) * noise)) if noise > 0 else np.sign(output)


def _sagnac_sine(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    k = p["phase_rad_per_dps"]
    return np.asarray(p["amplitude"] * (np.sin(k * c.rate_dps) / k - c.rate_dps))


def _saturation(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(-p["amplitude"] * beyond_knee_dps(c.rate_dps, p["knee_dps"], p["softness_dps"]))


def beyond_knee_dps(rate_dps: Floats, knee_dps: float, softness_dps: float) -> Floats:
    """Part of a rate beyond a knee of either sign, shape (n,); where the knee is soft it begins gradually."""
    return np.asarray(_above(np.abs(rate_dps) - knee_dps, softness_dps) * np.sign(rate_dps))


def _above(rate_dps: Floats, softness_dps: float) -> Floats:
    """Part of a rate above zero; where the corner is soft it begins gradually."""
    if softness_dps > 0:
        return np.asarray(softness_dps * np.logaddexp(0.0, rate_dps / softness_dps))
    return np.maximum(rate_dps, 0.0)


def _rate_order(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * (c.rate_dps / p["scale_dps"]) ** round(p["order"]))


def _fit_direction(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    surface = need_surface(surface, "fit_direction")
    # Of a surface in the input it is the other way: the error is a cubic of the output.
    sign = 1.0 if surface.direction == "output" else -1.0
    output = c.rate_dps
    # A fixed number of rounds, never a test of the whole block: a wild sample must not stop its neighbours.
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            output = c.rate_dps + surface.error_dps(output, c.temp_c)
        error = surface.error_dps(c.rate_dps, c.temp_c) - surface.error_dps(output, c.temp_c)
    return np.asarray(sign * p["amplitude"] * error)


def _resonance(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    detuning = (np.abs(c.rate_dps) - p["center_dps"]) / p["width_dps"]
    size: float | Floats = p["amplitude"]
    if p["scatter"]:
        visit = c.t_s / _SAME_TIME_S if c.data_set_index is None else c.data_set_index
        size = size * (1.0 + p["scatter"] * normal(p["seed"], 1, visit))
    peak = np.exp2(-(detuning**2)) if p["form"] else 1.0 / (1.0 + detuning**2)
    return np.asarray(MDPS * size * peak)


def _reference(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    command = c.rate_dps if c.command_dps is None else c.command_dps
    relative = normal(p["seed"], 2, np.abs(command) / SAME_RATE_DPS)
    return np.asarray(PPM * p["amplitude"] * relative * c.rate_dps)


def _draw_order(usual: Mapping[str, float], offer: Offer, rng: np.random.Generator) -> dict[str, float]:
    p = usual_draw(usual, offer, rng)
    return p | {"order": float(rng.integers(4, 6)), "scale_dps": float(offer.sizes_dps[-1])}


def _asymmetry_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    k, soft = PPM * p["amplitude"], p["softness_dps"]
    if soft > 0:
        return f"{n(k * soft)} * ({_above_c(f'(w / {n(soft)})')} - {n(np.log(2.0))})"
    return f"(w > 0 ? {n(k)} * w : 0)"


def _dead_zone_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    k, size = MDPS * p["amplitude"], f"(fabs@f@(w) / {n(p['width_dps'])})"
    if p["form"] == AT_REST:
        return f"({size} < 1 ? {n(-k)} : 0)"
    lost = {
        SMALL: f"({size} < 1 ? {size} : 0)",
        LOCKED: f"({size} < 1 ? {size} : 1 / ({size} + sqrt@f@({size} * {size} - 1)))",
        BAND: f"fmin@f@({size}, 1)",
    }[p["form"]]
    rest = n(p["rest"])
    hidden = f"({size} < {rest} ? {n(p['place_dps'])} : 0)"
    return f"({hidden} + {n(k)} * (@real@)((w < 0) - (w > 0)) * fmin@f@(fmax@f@({size} - {rest}, 0), {lost}))"


def _truncation_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    half = MDPS * p["amplitude"]
    if p["of_output"]:
        output = "w + PREFIX_surface@f@(w, temp_c)"
        return f"{n(half)} * (@real@)(({output} < 0) - ({output} > 0))"
    return f"fmax@f@({n(-abs(half))}, fmin@f@({n(abs(half))}, {n(-0.5 if half > 0.0 else 0.5)} * w))"


def _sagnac_sine_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(p['amplitude'])} * w * PREFIX_sine_loss@f@({n(p['phase_rad_per_dps'])} * w)"


def _resonance_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    # The mean: a robot knows of no visits.
    detuning = f"((fabs@f@(w) - {n(p['center_dps'])}) / {n(p['width_dps'])})"
    if p["form"]:
        return f"({n(MDPS * p['amplitude'])} * exp2@f@(-{detuning} * {detuning}))"
    return f"({n(MDPS * p['amplitude'])} / (1 + {detuning} * {detuning}))"


def _saturation_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    knee, k, soft = n(p["knee_dps"]), n(p["amplitude"]), p["softness_dps"]
    if soft > 0:
        above = _above_c(f"(fabs@f@(w) - {knee}) / {n(soft)}")
        return f"{k} * {n(soft)} * (@real@)((w < 0) - (w > 0)) * {above}"
    return f"(w > {knee} ? {k} * ({knee} - w) : w < -{knee} ? -{k} * ({knee} + w) : 0)"


def _above_c(x: str) -> str:
    # log(1 + exp(x)) from the side where exp cannot overflow
    return f"(fmax@f@({x}, 0) + log1p@f@(exp@f@(-fabs@f@({x}))))"


def _rate_order_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(MDPS * p['amplitude'])} * PREFIX_power@f@(w / {n(p['scale_dps'])}, {round(p['order'])})"


def _fit_direction_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return f"{n(p['amplitude'])} * PREFIX_direction@f@(w, temp_c)"


_DIRECTION = f"""\
static inline @real@ PREFIX_direction@f@(@real@ w, @real@ temp_c)
{{
    @real@ output = w;
    int i;
    for (i = 0; i < {ROUNDS}; i++) {{
        output = w + PREFIX_surface@f@(output, temp_c);
    }}
    return @turn@(PREFIX_surface@f@(w, temp_c) - PREFIX_surface@f@(output, temp_c));
}}
"""


SCALE_ASYMMETRY = Effect(
    id="scale_asymmetry",
    family="rate shape",
    equation="e = k s (log(1 + exp(w/s)) - log 2); s = 0: k w for w > 0, 0 otherwise",
    statement="The scale factor differs between turning left and turning right.",
    parameters=(
        amplitude("ppm", 50000.0, 200.0, "scale factor to the left minus to the right"),
        shape("softness_dps", "deg/s", 0.0, 1000.0, 0.0, "width s over which it changes; 0: at once"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("dead_zone",),
    reference="IEEE Std 952, scale factor asymmetry",
    runtime=True,
    error_dps=memoryless(_asymmetry),
    search=Search(
        grid=sides,
        refined=("softness_dps",),
        bounded=("softness_dps",),
        # How softly a gyro changes sides no mechanism says: an order of the rate starts as low.
        rare={"softness_dps": 3.0},
        requires=(many_rates, sizes_for_even, both_ways),
    ),
    c_text=CText(_asymmetry_c),
)

DEAD_ZONE = Effect(
    id="dead_zone",
    family="rate shape",
    equation="output 0 while |w| < w_d: e = -k there, k what stood at the input at rest; or of any input, "
    "e = -k w/w_d there, and beyond with lock-in e = -k (w - sign(w) sqrt(w^2 - w_d^2))/w_d, of a dead band e = -k sign(w); "
    "to a robot an output below r w_d is rest: |e| <= k max(|w|/w_d - r, 0), and p is added where |w| < r w_d",
    statement="The output stays at zero for small inputs (dead zone, lock-in), so that the Earth's rate is lost at rest.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 2.0, "input that is lost, the largest"),
        shape("width_dps", "deg/s", 1e-6, 10.0, 0.01, "half width w_d"),
        choice(
            "form", "1", AT_REST, BAND, AT_REST, "0: lost at rest, 1: any small input, 2: lock-in, 3: band"
        ),
        shape("rest", "1", 0.0, 1.0, 0.0, "share r of w_d below which a robot takes the output for rest"),
        shape("place_dps", "deg/s", -10.0, 10.0, 0.0, "place p in the zone, of which the spread is known"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("scale_asymmetry", "truncation"),
    reference="IEEE Std 952, dead band",
    runtime=True,
    error_dps=memoryless(_dead_zone),
    fold=near_zero_rate,
    search=Search(
        grid=dead_widths,
        refined=("width_dps",),
        requires=(many_rates, data_at_rest),
        one_sign=loses,
        scatters=True,
        in_part=True,
    ),
    c_text=CText(_dead_zone_c),
)

TRUNCATION = Effect(
    id="truncation",
    family="rate shape",
    equation="e = -k sign(w), |k| = q/2; e = -+w/2 below a step, on the average; or e = -k sign(g), g the output",
    statement="The output is cut toward zero (away from it, if the amplitude is negative) instead of rounded, which leaves "
    "half a step of either sign.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 1.5, "half the output's step"),
        choice("of_output", "1", 0.0, 1.0, 0.0, "1: the sign is that of the output, the bias in it"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("dead_zone", "rate_order"),
    reference="conversion to integers in C (ISO/IEC 9899, 6.3.1.4)",
    runtime=True,
    error_dps=memoryless(_truncation),
    acts_on="converter",
    search=Search(
        grid=rate_or_output,
        requires=(many_rates, many_sizes, both_ways, cut_or_dead),
        scatters=True,
        accounts_for=("quantisation",),
    ),
    c_text=CText(_truncation_c),
)

SAGNAC_SINE = Effect(
    id="sagnac_sine",
    family="rate shape",
    equation="e = a (sin(K w)/K - w), K the Sagnac phase per rate",
    statement="The open-loop output follows the sine of the Sagnac phase, with odd orders above the third.",
    parameters=(
        amplitude("1", 3.0, 0.5, "share of the sine in the output", positive=True),
        shape("phase_rad_per_dps", "rad per deg/s", 5e-4, 0.03, 0.004, "Sagnac phase per rate"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("saturation", "rate_order"),
    reference="Lefevre, The Fiber-Optic Gyroscope: open-loop response",
    runtime=True,
    error_dps=memoryless(_sagnac_sine),
    search=Search(
        grid=phases,
        refined=("phase_rad_per_dps",),
        requires=(many_rates, many_sizes),
        # An open loop puts out the sine and nothing beside it; half and double are one sigma off.
        natural=(1.0, 0.7),
    ),
    c_text=CText(_sagnac_sine_c, (SINE_LOSS,)),
)

SATURATION = Effect(
    id="saturation",
    family="rate shape",
    equation="e = -a s log(1 + exp((|w| - w_k)/s)) sign(w); s = 0: -a (|w| - w_k) sign(w) for |w| > w_k",
    statement="The gain falls above a knee, near the end of the range (it rises there, if the amplitude is negative).",
    parameters=(
        amplitude("1", 1.0, 0.01, "share of the gain that is lost above the knee"),
        shape("knee_dps", "deg/s", 1.0, 1000.0, 80.0, "knee w_k"),
        shape("softness_dps", "deg/s", 0.0, 1000.0, 0.0, "width s over which it begins; 0: at once"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("sagnac_sine", "rate_order"),
    reference="limits of electronics and digitiser",
    runtime=True,
    error_dps=memoryless(_saturation),
    search=Search(grid=knees, refined=("knee_dps",), requires=(many_rates, sizes_for_knee)),
    c_text=CText(_saturation_c),
)

RATE_ORDER = Effect(
    id="rate_order",
    family="rate shape",
    equation="e = k (w/w_s)^n, n = 4, 5, ...",
    statement="The error bends more with rate than a cubic can; no mechanism is claimed.",
    parameters=(
        amplitude("mdeg/s", 10000.0, 5.0, "size at w_s"),
        count("order", 4.0, 9.0, 5.0, "power"),
        choice("scale_dps", "deg/s", 1.0, 10000.0, 100.0, "scale w_s"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("sagnac_sine", "saturation"),
    reference="next orders of the paper's eq. 2",
    runtime=True,
    error_dps=memoryless(_rate_order),
    # Where a mechanism does as well to within 20 to 1, it is the mechanism.
    search=Search(grid=orders, columns=order_columns, requires=(many_rates, many_sizes), prior_nats=-3.0),
    hiding=Hiding(_draw_order),
    c_text=CText(_rate_order_c, (POWER,)),
)

FIT_DIRECTION = Effect(
    id="fit_direction",
    family="rate shape",
    equation="e = a (S(w, T) - S(g, T)), g - S(g, T) = w",
    statement="Not physics: the error is a cubic of the input rate, which a surface of the output has only nearly.",
    parameters=(
        amplitude(
            "1", 3.0, 1.0, "1: cubic in the input, 0: in the output; for a surface in the input the reverse"
        ),
    ),
    needs=("rate_dps", "temp_c"),
    seen_in="rate",
    looks_like=("rate_order", "sagnac_sine"),
    reference="deviation of a polynomial of high order",
    runtime=True,
    error_dps=memoryless(_fit_direction),
    search=Search(requires=(many_rates, many_sizes), prior_nats=-1.0),
    hiding=Hiding(free_size=False),
    c_text=CText(_fit_direction_c, (_DIRECTION,)),
    by_surface=by_differences(_fit_direction),
)

MECHANICAL_RESONANCE = Effect(
    id="mechanical_resonance",
    family="rate shape",
    equation="e = k (1 + s n)/(1 + ((|w| - w_r)/b)^2), or k (1 + s n) 2^-((|w| - w_r)/b)^2, n a normal draw for each visit",
    statement="Near certain rates the table, the mount or the gyro vibrates, which shifts the bias and scatters it.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 5.0, "mean shift at resonance"),
        shape("center_dps", "deg/s", 0.0, 10000.0, 60.0, "rate w_r of the resonance"),
        shape("width_dps", "deg/s", 0.01, 1000.0, 5.0, "half width b"),
        choice("form", "1", *PEAKS, PEAKS[0], "0: Lorentz, 1: Gauss"),
        choice("scatter", "1", 0.0, 100.0, 0.5, "scatter as a share of the shift"),
        _SEED,
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("rate_order",),
    reference="vibration rectification",
    # One bench cannot tell whose it is: what comes at each visit is taken for the gyro's.
    runtime=True,
    error_dps=memoryless(_resonance),
    search=Search(
        grid=resonances,
        refined=("center_dps", "width_dps"),
        requires=(sizes_for_peak,),
        prior_nats=-1.0,
        adds_up=True,
        scatters=True,
    ),
    c_text=CText(_resonance_c),
)

REFERENCE_RATE_ERROR = Effect(
    id="reference_rate_error",
    family="rate shape",
    equation="e = k n(|w_c|) w, n a normal draw for each commanded rate",
    statement="The table's true rates differ from the reported ones by a fixed share for each rate (rounding of stepper or clock).",
    parameters=(amplitude("ppm", 10000.0, 50.0, "standard deviation of the relative error"), _SEED),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("rate_order",),
    reference="repeatability of a rate table",
    runtime=False,
    error_dps=memoryless(_reference),
    acts_on="reference",
    search=Search(columns=each_rate, draws=True),
    # A draw of relative errors has a size of its own.
    hiding=Hiding(own_zero=False),
)

EFFECTS = (
    SCALE_ASYMMETRY,
    DEAD_ZONE,
    TRUNCATION,
    SAGNAC_SINE,
    SATURATION,
    RATE_ORDER,
    FIT_DIRECTION,
    MECHANICAL_RESONANCE,
    REFERENCE_RATE_ERROR,
)
