"""A coefficient file as a C99 header for a robot's firmware.

The double functions repeat the arithmetic of `Surface`. The float ones cannot simply do so: at 100 deg/s the
steps of a float are 7.6e-6 deg/s, and a plain Horner scheme adds a few roundings of the largest term. So the
float functions

- take the error, which is small, as the quantity to compute: the corrected rate in float has the steps of a
  float, the error has not;
- divide by powers of two only, on a polynomial re-expanded for that, so that scaling rounds nothing;
- carry every number as an unevaluated sum of two floats (Dekker, Numerische Mathematik 18, 224-242, 1971).

What is left is the last rounding of the error to a float: 6e-8 of its size.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from math import ceil, comb, log2
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal import __version__
from gyrocal.calibration.export_terms import TermSource, filled, term_source
from gyrocal.errors import InputError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_RATE, FLAG_TEMPERATURE, Coefficients
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.terms import Part
from gyrocal.records.files import write_atomically

Floats = NDArray[np.float64]

CType = Literal["both", "float", "double"]

#: Steps of the temperature about which the float polynomial is expanded, deg C: a number that a float holds.
_CENTER_STEP_C = 0.125
#: Calls into the mathematics library.
_MATHEMATICS = re.compile(r"\b(?:expm?1?|log1p|fabs|fmax|asinh)(?:@f@|f)?\(")


@dataclass(frozen=True)
class Export:
    """A header and what is in it."""

    text: str
    functions: tuple[str, ...]
    terms: tuple[str, ...]
    not_exported: tuple[str, ...]
    sha256: str
    sensor: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "format": "c-header",
            "functions": list(self.functions),
            "terms": list(self.terms),
            "terms_of_the_bench_not_exported": list(self.not_exported),
            "coefficients_sha256": self.sha256,
            "sensor": self.sensor,
        }


def check_prefix(prefix: str) -> None:
    """Raise InputError where `prefix` cannot begin the names of a C header."""
    if not re.fullmatch(r"[a-z_][a-z0-9_]*", prefix):
        raise InputError(
            f"the prefix is {prefix!r}; a C identifier of small letters, digits and underscores is wanted."
        )


def export_c_header(coefficients: Coefficients, ctype: CType = "both", prefix: str = "gyrocal") -> Export:
    """C99 header with ``PREFIX_error``, ``PREFIX_correct`` and ``PREFIX_flags``, the float ones ending in ``f``.

    Parameters
    ----------
    prefix : str
        A C identifier; tells two gyros in one firmware apart.

    Raises
    ------
    InputError
        `prefix` is no C identifier.
    CoefficientError
        The file holds a runtime term that cannot be evaluated, or that has no C.
    """
    check_prefix(prefix)
    terms = coefficients.runtime_terms()
    parts = [_DOCUMENT, _GUARD]
    functions: list[str] = []
    for kind, suffix in (("double", ""), ("float", "f")):
        if ctype in ("both", kind):
            state, text = _functions(coefficients, terms, kind, suffix)
            parts += [state] * (state != "" and not functions)
            parts.append(text)
            functions += [f"{prefix}_{name}{suffix}" for name in ("error", "correct", "flags")]
    libm = any(_MATHEMATICS.search(part) for part in parts)
    solved = any("NAN" in part for part in parts)
    digest = json.loads(coefficients.to_text())["sha256"]
    head = {
        "terms": _comment(", ".join(dict.fromkeys(t.name for t in terms)) or "none beside the surface"),
        "library": "the mathematics library (-lm)" if libm else "no library",
        "math": "#include <math.h>\n" if libm or solved else "",
        "more": _SOLVED * solved + _MORE * bool(terms),
        "version": __version__,
        "sensor": _comment(json.dumps(dict(coefficients.sensor), sort_keys=True)),
        "sha256": digest,
        "rate_low": f"{coefficients.valid.rate_dps[0]:g}",
        "rate_high": f"{coefficients.valid.rate_dps[1]:g}",
        "temp_low": f"{coefficients.valid.temp_c[0]:g}",
        "temp_high": f"{coefficients.valid.temp_c[1]:g}",
    }
    text = filled("\n".join([*parts, _END]), head).replace("PREFIX", prefix).replace("GUARD", prefix.upper())
    bench = tuple(term.name for term in coefficients.terms if not term.runtime)
    return Export(
        text, tuple(functions), tuple(t.name for t in terms), bench, digest, dict(coefficients.sensor)
    )


def _functions(
    coefficients: Coefficients, terms: tuple[Part, ...], kind: str, suffix: str
) -> tuple[str, str]:
    """C of the state, which both types share, and of the functions in one type."""
    surface = _DOUBLE if kind == "double" else _FLOAT
    pair = "@real@ gyro_dps, @real@ temp_c"
    source = TermSource("", "", pair, "gyro_dps, temp_c")
    solved = bool(terms) or coefficients.surface.direction == "input"
    if solved:
        source = term_source(coefficients.surface, terms, _double if kind == "double" else _float, kind)
    template = "\n".join(part for part in (surface, source.text, _FLAGS) if part)
    names = {
        "surface": "surface" if solved else "error",
        "parameters": source.parameters,
        "arguments": source.arguments,
    }
    values = names | _numbers(coefficients, kind) | {"real": kind, "f": suffix}
    return source.state, filled(template, values)


def _comment(text: str) -> str:
    """`text`, unable to end the comment that it stands in, or to begin another."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def _numbers(coefficients: Coefficients, kind: str) -> dict[str, str]:
    surface, valid = coefficients.surface, coefficients.valid
    number = _double if kind == "double" else _float
    values = {
        "rate_from": number(valid.rate_dps[0]),
        "rate_to": number(valid.rate_dps[1]),
        "temp_from": number(valid.temp_c[0]),
        "temp_to": number(valid.temp_c[1]),
        "bit_rate": str(FLAG_RATE),
        "bit_temp": str(FLAG_TEMPERATURE),
        "bit_finite": str(FLAG_NOT_FINITE),
    }
    if kind == "double":
        rows = [", ".join(_double(x) for x in row) for row in surface.coefficients_dps]
        return values | {
            "table": _rows(rows),
            "rate_center": _double(surface.rate_center_dps),
            "rate_scale": _double(surface.rate_scale_dps),
            "temp_center": _double(surface.temp_center_c),
            "temp_scale": _double(surface.temp_scale_c),
        }
    exact = power_of_two_surface(surface)
    rows = [
        ", ".join(f"{{{_float(x)}, {_float(x - np.float32(x))}}}" for x in row)
        for row in exact.coefficients_dps
    ]
    return values | {
        "table": _rows(rows),
        "rate_factor": _float(1.0 / exact.rate_scale_dps),
        "temp_center": _float(exact.temp_center_c),
        "temp_factor": _float(1.0 / exact.temp_scale_c),
    }


def _rows(rows: list[str]) -> str:
    return ",\n".join(f"        {{{row}}}" for row in rows)


def _double(value: float) -> str:
    """Shortest decimal that reads back as the same double."""
    return repr(float(value))


def _float(value: float) -> str:
    """Shortest decimal that reads back as the nearest float."""
    return f"{np.float32(value)!s}f"


def power_of_two_surface(surface: Surface) -> Surface:
    """The same surface, centred at zero rate and a temperature that a float holds, scaled by powers of two."""
    rate_scale = 2.0 ** ceil(log2(surface.rate_scale_dps))
    temp_scale = 2.0 ** ceil(log2(surface.temp_scale_c))
    temp_center = _CENTER_STEP_C * round(surface.temp_center_c / _CENTER_STEP_C)
    by_rate = _substitution(
        SHAPE[0], rate_scale / surface.rate_scale_dps, -surface.rate_center_dps / surface.rate_scale_dps
    )
    by_temp = _substitution(
        SHAPE[1],
        temp_scale / surface.temp_scale_c,
        (temp_center - surface.temp_center_c) / surface.temp_scale_c,
    )
    return Surface(
        by_rate.T @ surface.coefficients_dps @ by_temp,
        0.0,
        rate_scale,
        temp_center,
        temp_scale,
        surface.direction,
    )


def _substitution(size: int, factor: float, offset: float) -> Floats:
    """Matrix M with ``(factor x + offset)^i = sum_k M[i, k] x^k``."""
    return np.array(
        [
            [comb(i, k) * factor**k * offset ** (i - k) if k <= i else 0.0 for k in range(size)]
            for i in range(size)
        ]
    )


def write_header(export: Export, path: Path) -> None:
    """Write the header, wholly or not at all."""
    write_atomically(path, export.text)


_DOCUMENT = """\
/* Error surface of a calibrated gyro, written by gyrocal @version@. Do not edit: export again.
 *
 * Sensor        @sensor@
 * Coefficients  sha256 @sha256@
 * Terms         @terms@
 * Valid         @rate_low@ to @rate_high@ deg/s, @temp_low@ to @temp_high@ deg C
 *
 * error    error of the gyro at its output (deg/s) and temperature (deg C), deg/s
 * correct  corrected rate: output minus error, deg/s
 * flags    sum of 1: rate, 2: temperature outside the valid range, 4: not finite; 0 is good. What a term was
 *          fitted to is not looked at here; gyrocal apply flags that with 32
 *
@more@ * C99, @library@. Not for -ffast-math, which breaks the sums of two floats and the tests for NaN.
 * In float the surface is exact to its last digit; the corrected rate has the steps of a float
 * (7.6e-6 deg/s at 100 deg/s). Who integrates over hours adds up output and error apart.
 */"""

_SOLVED = """\
 * Where no rate has this output, error and correct are not a number.
"""

_MORE = """\
 * dt_s     time since the sample before, s (0 for the first); call error or correct once a sample
 * state    what the error remembers of earlier temperatures and rates; set all members to zero before the first sample
 * since_power_on_s   time since the gyro was switched on, s
 * supply_v   supply voltage, V; NAN where it is not read: then it counts as that of the recording
 * An argument that the terms do not need is left out.
 *
"""

_GUARD = """\
#ifndef GUARD_SURFACE_H
#define GUARD_SURFACE_H

@math@#include <stdint.h>

#ifdef __FAST_MATH__
#error "this header needs IEEE arithmetic: compile it without -ffast-math"
#endif
"""

_DOUBLE = """\
static inline double PREFIX_@surface@(double gyro_dps, double temp_c)
{
    static const double c[4][3] = {
@table@
    };
    const double u = (gyro_dps - (@rate_center@)) / @rate_scale@;
    const double v = (temp_c - (@temp_center@)) / @temp_scale@;
    double error = 0.0;
    int i;
    for (i = 3; i >= 0; i--) {
        error = error * u + (c[i][0] + v * (c[i][1] + v * c[i][2]));
    }
    return error;
}
"""

_FLOAT = """\
/* A number as the unevaluated sum of two floats. */
typedef struct {
    float hi, lo;
} PREFIX_pair;

static inline PREFIX_pair PREFIX_sum(float a, float b)
{
    PREFIX_pair r;
    float b_in_r;
    r.hi = a + b;
    b_in_r = r.hi - a;
    r.lo = (a - (r.hi - b_in_r)) + (b - b_in_r);
    return r;
}

/* The upper half of the digits, so that products of halves are exact. */
static inline float PREFIX_half(float a)
{
    union {
        float number;
        uint32_t bits;
    } x;
    x.number = a;
    x.bits &= UINT32_C(0xFFFFF000);
    return x.number;
}

static inline PREFIX_pair PREFIX_product(float a, float b)
{
    const float a_hi = PREFIX_half(a), a_lo = a - a_hi;
    const float b_hi = PREFIX_half(b), b_lo = b - b_hi;
    /* volatile: a compiler that fuses this product into the sum that follows would count its rounding twice */
    const volatile float product = a * b;
    PREFIX_pair r;
    r.hi = product;
    r.lo = ((a_hi * b_hi - r.hi) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo;
    return r;
}

/* a x + b */
static inline PREFIX_pair PREFIX_step(PREFIX_pair a, PREFIX_pair x, PREFIX_pair b)
{
    const PREFIX_pair p = PREFIX_product(a.hi, x.hi);
    const PREFIX_pair s = PREFIX_sum(p.hi, b.hi);
    return PREFIX_sum(s.hi, s.lo + (p.lo + a.hi * x.lo + a.lo * x.hi + b.lo));
}

static inline float PREFIX_@surface@f(float gyro_dps, float temp_c)
{
    static const PREFIX_pair c[4][3] = {
@table@
    };
    const PREFIX_pair t = PREFIX_sum(temp_c, -(@temp_center@));
    PREFIX_pair u, v, error = {0.0f, 0.0f};
    int i;
    u.hi = gyro_dps * @rate_factor@;
    u.lo = 0.0f;
    v.hi = t.hi * @temp_factor@;
    v.lo = t.lo * @temp_factor@;
    for (i = 3; i >= 0; i--) {
        const PREFIX_pair a = PREFIX_step(PREFIX_step(c[i][2], v, c[i][1]), v, c[i][0]);
        error = PREFIX_step(error, u, a);
    }
    return error.hi + error.lo;
}
"""

_FLAGS = """\
static inline @real@ PREFIX_correct@f@(@parameters@)
{
    return gyro_dps - PREFIX_error@f@(@arguments@);
}

static inline int PREFIX_flags@f@(@real@ gyro_dps, @real@ temp_c)
{
    int flags = 0;
    if (gyro_dps < @rate_from@ || gyro_dps > @rate_to@) {
        flags |= @bit_rate@;
    }
    if (temp_c < @temp_from@ || temp_c > @temp_to@) {
        flags |= @bit_temp@;
    }
    /* A number minus itself is zero unless it is infinite or not a number. */
    if (!(gyro_dps - gyro_dps <= 0) || !(temp_c - temp_c <= 0)) {
        flags |= @bit_finite@;
    }
    return flags;
}
"""

_END = """\
#endif
"""
