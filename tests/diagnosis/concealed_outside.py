"""Effects that no catalogue has, with the coordinates under which each is rightly located.

`SEEN` was at hand while the finder was made; `UNSEEN` was written after, to see how far the finder generalises.
"""

from __future__ import annotations

import numpy as np

from tests.diagnosis.concealed_effects import Drawn, Maker, case_slope
from tests.diagnosis.concealed_world import Floats, World

Table = dict[str, tuple[Maker, tuple[str, ...]]]


def hvac_period(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    period, phase = rng.uniform(1500, 4500), rng.uniform(0, 2 * np.pi)
    return 1e-3 * np.sin(2 * np.pi * w.t_s / period + phase), {"period_s": period}


def temperature_bump(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    centre, width = rng.uniform(5, 40), rng.uniform(2, 5)
    return 1e-3 * np.exp(-(((w.case_c - centre) / width) ** 2)), {"temp_c": centre}


def glass_transition(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    centre, width = rng.uniform(5, 35), rng.uniform(1, 3)
    return 1e-3 * np.tanh((w.case_c - centre) / width), {"temp_c": centre}


def temperature_ripple(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    period, phase = rng.uniform(5, 12), rng.uniform(0, 2 * np.pi)
    return 1e-3 * np.sin(2 * np.pi * w.case_c / period + phase), {"period_c": period}


def three_per_rev(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    phase = rng.uniform(0, 2 * np.pi)
    return 1e-3 * np.cos(3 * np.deg2rad(w.angle_deg) + phase), {}


def warm_angle(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    phase = rng.uniform(0, 2 * np.pi)
    return 1e-3 * np.cos(np.deg2rad(w.angle_deg) + phase) * (w.case_c - 20.0) / 30.0, {}


def one_sided_bump(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    rates = sorted({p.rate_dps for p in w.pieces if 15 <= abs(p.rate_dps) <= 90})
    centre = float(rng.choice(rates))
    return 1e-3 * np.exp(-(((w.rate_dps - centre) / 6.0) ** 2)), {"rate_dps": centre}


def supply_times_rate(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-4 * (w.supply_v - 12.0) * w.rate_dps, {}


def box_in_time(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    start, length = rng.uniform(0.2, 0.6) * w.t_s[-1], rng.uniform(1200, 3600)
    return 1e-3 * ((w.t_s > start) & (w.t_s < start + length)).astype(float), {
        "t_s": float(start),
        "length_s": length,
    }


def telegraph(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """A bias that jumps between two levels every ten minutes or so."""
    flips = np.cumsum(rng.exponential(700.0, 100))
    return 1e-3 * np.asarray(np.searchsorted(flips, w.t_s) % 2, dtype=float), {}


def square_root_of_time(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * np.sqrt(w.t_s / 3600.0), {}


def rectified_slope(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * np.abs(case_slope(w)), {}


def sawtooth_in_set(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """Starts anew with every rate segment and does not decay."""
    out = np.zeros(w.t_s.size)
    for p in w.pieces:
        if p.kind == "rate":
            out[p.start : p.stop] = np.linspace(-1, 1, p.stop - p.start) * np.sign(p.step_dps)
    return 1e-3 * out, {}


def exponential_in_temperature(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * np.exp(rng.choice([-1.0, 1.0]) * (w.case_c - 20.0) / rng.uniform(5, 7)), {}


def kink_in_time(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """A drift that begins in the middle of the run."""
    at = rng.uniform(0.4, 0.7) * w.t_s[-1]
    return 1e-3 * np.maximum(w.t_s - at, 0.0) / 3600.0, {"at_s": float(at)}


def chirp(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """A beat that becomes faster: periods of an hour down to ten minutes."""
    s = w.t_s / w.t_s[-1]
    cycles = w.t_s[-1] / 3600.0 * s * (1 + 2.5 * s)
    return 1e-3 * np.sin(2 * np.pi * cycles + rng.uniform(0, 2 * np.pi)), {}


def asymmetry_with_temperature(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-5 * np.abs(w.rate_dps) * (w.case_c - 20.0) / 30.0, {}


def cogging(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """Five times a turn, as large at every rate."""
    phase = rng.uniform(0, 2 * np.pi)
    return 1e-3 * np.cos(5 * np.deg2rad(w.angle_deg) + phase), {}


def scale_bump_in_time(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    at, width = rng.uniform(0.3, 0.7) * w.t_s[-1], rng.uniform(900, 2500)
    return 1e-5 * w.rate_dps * np.exp(-(((w.t_s - at) / width) ** 2)), {"at_s": float(at)}


def cubed_slope(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """No linear part: a gradient that saturates the other way round."""
    slope = case_slope(w)
    return 1e-3 * (slope**3 - slope * np.mean(slope**4) / np.mean(slope**2)), {}


def last_rate(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """The bias of a data set remembers the rate of the one before."""
    out, before = np.zeros(w.t_s.size), 0.0
    for p in w.pieces:
        out[p.start : p.stop] = before
        before = p.rate_dps
    return 1e-5 * out, {}


def random_walk(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    steps = rng.normal(size=w.t_s.size // 600 + 2)
    return 1e-3 * np.interp(w.t_s, np.arange(steps.size) * 60.0, np.cumsum(steps)), {}


#: Effects outside the catalogue, and the coordinates of formats.md under any of which it is rightly located.
SEEN: Table = {
    "hvac_period": (hvac_period, ("time",)),
    "temperature_bump": (temperature_bump, ("temperature",)),
    "glass_transition": (glass_transition, ("temperature",)),
    "temperature_ripple": (temperature_ripple, ("temperature",)),
    "three_per_rev": (three_per_rev, ("table_angle",)),
    "warm_angle": (warm_angle, ("table_angle",)),
    "one_sided_bump": (one_sided_bump, ("rate",)),
    "supply_times_rate": (supply_times_rate, ("supply",)),
    "box_in_time": (box_in_time, ("time",)),
    "telegraph": (telegraph, ("time",)),
    "square_root_of_time": (square_root_of_time, ("time", "time_since_power_on")),
    "rectified_slope": (rectified_slope, ("temperature_rate",)),
    "sawtooth_in_set": (sawtooth_in_set, ("time_since_step",)),
}

UNSEEN: Table = {
    "exponential_in_temperature": (exponential_in_temperature, ("temperature",)),
    "kink_in_time": (kink_in_time, ("time", "time_since_power_on")),
    "chirp": (chirp, ("time",)),
    "asymmetry_with_temperature": (asymmetry_with_temperature, ("rate", "temperature")),
    "cogging": (cogging, ("table_angle",)),
    "scale_bump_in_time": (scale_bump_in_time, ("time",)),
    "cubed_slope": (cubed_slope, ("temperature_rate",)),
    "last_rate": (last_rate, ("time_since_step",)),
    "random_walk": (random_walk, ("time",)),
}

OUTSIDE: Table = SEEN | UNSEEN
