"""Effects of the rate: shapes that a cubic leaves over, and errors that belong to single rates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.effect import (
    MDPS,
    PPM,
    Conditions,
    Effect,
    Floats,
    Parameter,
    amplitude,
    memoryless,
    need_surface,
    shape,
)
from gyrocal.physics.kernels import normal
from gyrocal.physics.surface import Surface

#: Two commanded rates nearer than this are the same rate, deg/s.
_SAME_RATE_DPS = 1e-3
#: Two samples nearer than this are the same sample, s.
_SAME_TIME_S = 1e-6

#: Rounds of the inverse of the surface: a slope of 5 % leaves 1e-13 of the error after ten.
ROUNDS = 10

_SEED = shape("seed", "1", 0.0, 2.0**52, 1.0, "which draw")


def _asymmetry(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(PPM * p["amplitude"] * np.maximum(c.rate_dps, 0.0))


def _dead_zone(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(-MDPS * p["amplitude"] * (np.abs(c.rate_dps) < p["width_dps"]))


def _truncation(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    if c.gyro_dps is None:
        return np.asarray(-MDPS * p["amplitude"] * np.sign(c.rate_dps))
    step_dps = 2.0 * MDPS * p["amplitude"]
    if step_dps == 0.0:
        return np.zeros(len(c))
    return np.asarray(np.trunc(c.gyro_dps / step_dps) * step_dps - c.gyro_dps)


def _sagnac_sine(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    k = p["phase_rad_per_dps"]
    return np.asarray(p["amplitude"] * (np.sin(k * c.rate_dps) / k - c.rate_dps))


def _saturation(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    above = np.maximum(np.abs(c.rate_dps) - p["knee_dps"], 0.0)
    return np.asarray(-p["amplitude"] * above * np.sign(c.rate_dps))


def _rate_order(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * (c.rate_dps / p["scale_dps"]) ** round(p["order"]))


def _fit_direction(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    surface = need_surface(surface, "fit_direction")
    output = c.rate_dps
    # A fixed number of rounds, never a test of the whole block: a wild sample must not stop its neighbours.
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            output = c.rate_dps + surface.error_dps(output, c.temp_c)
        error = surface.error_dps(c.rate_dps, c.temp_c) - surface.error_dps(output, c.temp_c)
    return np.asarray(p["amplitude"] * error)


def _resonance(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    detuning = (np.abs(c.rate_dps) - p["center_dps"]) / p["width_dps"]
    visit = c.t_s / _SAME_TIME_S if c.data_set_index is None else c.data_set_index
    size = p["amplitude"] * (1.0 + p["scatter"] * normal(p["seed"], 1, visit))
    return np.asarray(MDPS * size / (1.0 + detuning**2))


def _reference(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    command = c.rate_dps if c.command_dps is None else c.command_dps
    relative = normal(p["seed"], 2, np.abs(command) / _SAME_RATE_DPS)
    return np.asarray(PPM * p["amplitude"] * relative * c.rate_dps)


SCALE_ASYMMETRY = Effect(
    id="scale_asymmetry",
    family="rate shape",
    equation="e = k w for w > 0, 0 otherwise",
    statement="The scale factor differs between turning left and turning right.",
    parameters=(amplitude("ppm", 50000.0, 200.0, "scale factor to the left minus to the right"),),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("dead_zone",),
    reference="IEEE Std 952, scale factor asymmetry",
    runtime=True,
    error_dps=memoryless(_asymmetry),
)

DEAD_ZONE = Effect(
    id="dead_zone",
    family="rate shape",
    equation="output 0 while |w| < w_d: e = -k there, k what stood at the input at rest",
    statement="The output stays at zero for small inputs (dead zone, lock-in), so that the Earth's rate is lost at rest.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 2.0, "input that is lost at rest"),
        shape("width_dps", "deg/s", 1e-6, 10.0, 0.01, "half width w_d"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("scale_asymmetry", "truncation"),
    reference="IEEE Std 952, dead band",
    runtime=False,
    error_dps=memoryless(_dead_zone),
)

TRUNCATION = Effect(
    id="truncation",
    family="rate shape",
    equation="e = -k sign(w), k = q/2",
    statement="The output is cut toward zero instead of rounded, which leaves half a step of either sign.",
    parameters=(Parameter("amplitude", "mdeg/s", 0.0, 1000.0, 1.5, True, "half the output's step"),),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("dead_zone", "rate_order"),
    reference="conversion to integers in C (ISO/IEC 9899, 6.3.1.4)",
    runtime=True,
    error_dps=memoryless(_truncation),
)

SAGNAC_SINE = Effect(
    id="sagnac_sine",
    family="rate shape",
    equation="e = a (sin(K w)/K - w), K the Sagnac phase per rate",
    statement="The open-loop output follows the sine of the Sagnac phase, with odd orders above the third.",
    parameters=(
        amplitude("1", 3.0, 0.5, "share of the sine in the output"),
        shape("phase_rad_per_dps", "rad per deg/s", 5e-4, 0.03, 0.004, "Sagnac phase per rate"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("saturation", "rate_order"),
    reference="Lefevre, The Fiber-Optic Gyroscope: open-loop response",
    runtime=True,
    error_dps=memoryless(_sagnac_sine),
)

SATURATION = Effect(
    id="saturation",
    family="rate shape",
    equation="e = -a (|w| - w_k) sign(w) for |w| > w_k",
    statement="The gain falls above a knee, near the end of the range.",
    parameters=(
        amplitude("1", 1.0, 0.01, "share of the gain that is lost above the knee"),
        shape("knee_dps", "deg/s", 1.0, 1000.0, 80.0, "knee w_k"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("sagnac_sine", "rate_order"),
    reference="physics-report.md G8",
    runtime=True,
    error_dps=memoryless(_saturation),
)

RATE_ORDER = Effect(
    id="rate_order",
    family="rate shape",
    equation="e = k (w/w_s)^n, n = 4, 5, ...",
    statement="The error bends more with rate than a cubic can; no mechanism is claimed.",
    parameters=(
        amplitude("mdeg/s", 10000.0, 5.0, "size at w_s"),
        shape("order", "1", 4.0, 9.0, 5.0, "power"),
        shape("scale_dps", "deg/s", 1.0, 10000.0, 100.0, "scale w_s"),
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("sagnac_sine", "saturation"),
    reference="next orders of the paper's eq. 2",
    runtime=True,
    error_dps=memoryless(_rate_order),
)

FIT_DIRECTION = Effect(
    id="fit_direction",
    family="rate shape",
    equation="e = a (S(w, T) - S(g, T)), g - S(g, T) = w",
    statement="Not physics: the error is a cubic of the input rate and was fitted as one of the output.",
    parameters=(amplitude("1", 3.0, 1.0, "1: cubic in the input, 0: cubic in the output"),),
    needs=("rate_dps", "temp_c"),
    seen_in="rate",
    looks_like=("rate_order", "sagnac_sine"),
    reference="physics-report.md G26",
    runtime=True,
    error_dps=memoryless(_fit_direction),
)

MECHANICAL_RESONANCE = Effect(
    id="mechanical_resonance",
    family="rate shape",
    equation="e = k (1 + s n)/(1 + ((|w| - w_r)/b)^2), n a normal draw for each visit",
    statement="Near certain rates the table or the mount vibrates, which shifts the bias and scatters it.",
    parameters=(
        amplitude("mdeg/s", 1000.0, 5.0, "mean shift at resonance"),
        shape("center_dps", "deg/s", 0.0, 10000.0, 60.0, "rate w_r of the resonance"),
        shape("width_dps", "deg/s", 0.01, 1000.0, 5.0, "half width b"),
        shape("scatter", "1", 0.0, 100.0, 0.5, "scatter as a share of the shift"),
        _SEED,
    ),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("rate_order",),
    reference="vibration rectification; physics-report.md G19",
    runtime=False,
    error_dps=memoryless(_resonance),
)

REFERENCE_RATE_ERROR = Effect(
    id="reference_rate_error",
    family="rate shape",
    equation="e = k n(|w_c|) w, n a normal draw for each commanded rate",
    statement="The table's true rates differ from the reported ones by a fixed share for each rate (rounding of stepper or clock).",
    parameters=(amplitude("ppm", 100000.0, 50.0, "standard deviation of the relative error"), _SEED),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=("rate_order",),
    reference="physics-report.md B2",
    runtime=False,
    error_dps=memoryless(_reference),
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
