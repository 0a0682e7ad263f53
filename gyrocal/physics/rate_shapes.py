"""Shapes that are tried of the effects of the rate, and the columns in which some of them are linear."""

from __future__ import annotations

import numpy as np

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Floats
from gyrocal.physics.offer import SMALL_DPS, Offer
from gyrocal.physics.search import Shape, Unit
from gyrocal.physics.surface import Surface
from gyrocal.units import PPM

#: Two commanded rates nearer than this are the same rate.
SAME_RATE_DPS = 1e-3

#: Sizes of rate that two orders of one parity need: beside those of the surface, and with some left to check them.
_SIZES_FOR_PAIRS = 6

#: What a dead zone swallows: what stands at the input at rest, every small input, of larger ones less and less (lock-in), or
#: of larger ones as much as of the largest small one (a dead band).
AT_REST, SMALL, LOCKED, BAND = 0.0, 1.0, 2.0, 3.0

#: A peak of a resonance: that of one mode in a sweep, and one without its tails, as where a drive dwells on some rates about it.
PEAKS = (0.0, 1.0)


def loses(shape: Shape) -> bool:
    """Whether a dead zone takes from any input, and gives none; that at rest is of the sign of what stood there."""
    return shape["form"] != AT_REST


def dead_widths(offer: Offer) -> list[dict[str, float]]:
    """Half widths of a dead zone between the slow rates, in each form that they tell apart."""
    small = offer.sizes_dps[offer.sizes_dps <= SMALL_DPS]
    if small.size == 0 or small[0] > 0.01:
        return []
    widths = (small[:-1] + small[1:]) / 2 if small.size > 1 else np.empty(0)
    last = small[-1] * 1.05 + 0.05 if small.size > 1 else 0.05
    # Two inputs within the zone, or one and the rest, are the same to any form; without any, a dead band is a truncation.
    forms, moving = [AT_REST], np.count_nonzero(small > 0)
    if moving or offer.continuous:
        forms += [BAND] if moving <= 2 else [SMALL, LOCKED, BAND]
    return [{"width_dps": float(x), "form": form} for form in forms for x in (*widths, last)]


def rate_or_output(offer: Offer) -> list[dict[str, float]]:
    """Of the sign of the rate, and of that of the output."""
    return [{"of_output": 0.0}, {"of_output": 1.0}]


def phases(offer: Offer) -> list[dict[str, float]]:
    """Phases of a sine, as shares of a radian at the largest rate."""
    full = offer.largest_rate_dps
    return [{"phase_rad_per_dps": x / full} for x in (0.2, 0.5, 0.8, 1.2, 1.6)] if full else []


def knees(offer: Offer) -> list[dict[str, float]]:
    """Knees near the end of the range, sharp and soft."""
    full = offer.largest_rate_dps
    return [
        {"knee_dps": float(x) * full, "softness_dps": soft * full}
        for soft in (0.0, 0.02, 0.04)
        for x in np.linspace(0.45, 0.95, 11)
    ]


def sides(offer: Offer) -> list[dict[str, float]]:
    """A scale factor that changes with the sign of the rate at once, or over a part of the range.

    Over more than an eighth of it the change is an even order of the rate.
    """
    full = offer.largest_rate_dps
    return [{"softness_dps": soft * full} for soft in (0.0, 0.03, 0.06, 0.125)]


def orders(offer: Offer) -> list[dict[str, float]]:
    """Single orders above the cubic, and pairs: the fifth beside the fourth, and two even or odd ones, as of a polynomial of either kind."""
    scale = {"scale_dps": offer.largest_rate_dps or 1.0}
    single = [{"order": order, **scale} for order in (4.0, 5.0, 6.0)]
    alike = ((6.0, 4.0), (7.0, 5.0)) if offer.sizes_dps.size > _SIZES_FOR_PAIRS else ()
    return [*single, *({"order": n, "order_2": m, **scale} for n, m in ((5.0, 4.0), *alike))]


def order_columns(unit_dps: Unit, c: Conditions, given: Shape, surface: Surface | None) -> Floats:
    """A column for each order."""
    orders = [given[name] for name in ("order", "order_2") if name in given]
    return np.column_stack([unit_dps(c, {**given, "order": order}, surface) for order in orders])


def resonances(offer: Offer) -> list[dict[str, float]]:
    """Peaks of either form at each size of rate, narrow to wide."""
    return [
        {
            "center_dps": float(center),
            "width_dps": width * offer.largest_rate_dps,
            "form": form,
            "scatter": 0.0,
        }
        for form in PEAKS
        # At the largest rate a peak would be no more than a bend.
        for center in offer.sizes_dps[offer.sizes_dps > 0][:-1]
        for width in (0.02, 0.06, 0.12)
    ]


def each_rate(unit_dps: Unit, c: Conditions, given: Shape, surface: Surface | None) -> Floats:
    """A column for each size of rate, with an error of 1 ppm there."""
    size = np.round(np.abs(c.rate_dps), 3)
    sizes = np.unique(size[size > 0])
    each = [np.where(np.abs(np.abs(c.rate_dps) - s) < SAME_RATE_DPS, c.rate_dps * PPM, 0.0) for s in sizes]
    return np.column_stack(each) if each else np.zeros((len(c), 1))
