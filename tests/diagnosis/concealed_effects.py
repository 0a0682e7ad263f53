"""What the concealed recordings hide: effects of the catalogue.

Each is a function of the world and a random generator that returns the error at unit size on the fine grid, and
what it drew at random. Own physics, in the time domain: nothing here is shared with gyrocal.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.diagnosis.concealed_world import STEP_S, Floats, World, first_order

Drawn = dict[str, float]
Maker = Callable[[World, np.random.Generator], tuple[Floats, Drawn]]

ARCSEC = 1.0 / 3600.0


def case_slope(w: World) -> Floats:
    """Slope of the case temperature, deg C per minute."""
    return np.gradient(w.case_c, STEP_S) * 60.0


def shupe(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * case_slope(w), {}


def shupe_gradient(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    tau = rng.uniform(180, 720)
    return 1e-3 * (w.case_c - first_order(w.case_c, tau, w.case_c[0])), {"tau_s": tau}


def thermal_hysteresis(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """Three play operators in parallel, as a mechanism with backlash."""
    out = np.zeros(w.t_s.size)
    coarse = w.case_c[::10].tolist()
    widths = rng.uniform(2, 10, 3)
    for width, weight in zip(widths, rng.uniform(0.5, 1.5, 3), strict=True):
        position, track = coarse[0], []
        for temp in coarse:
            if temp - position > width:
                position = temp - width
            elif position - temp > width:
                position = temp + width
            track.append(position - temp)
        out += weight * np.interp(np.arange(out.size), np.arange(0, out.size, 10), track)
    return 1e-3 * out, {"width_c": float(widths.mean())}


def warm_up(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    tau = float(np.exp(rng.uniform(np.log(400), np.log(3000))))
    return 1e-3 * np.exp(-w.t_s / tau), {"tau_s": tau}


def _age(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    power = rng.uniform(0.8, 1.2)
    return (w.t_s / 3600.0) ** power, {"power": power}


def bias_drift(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    age, drawn = _age(w, rng)
    return 1e-3 * age, drawn


def scale_drift(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    age, drawn = _age(w, rng)
    return 1e-6 * age * w.rate_dps, drawn


def _after(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    at = rng.uniform(0.2, 0.8) * w.t_s[-1]
    return (w.t_s >= at).astype(float), {"at_s": float(at)}


def bias_step(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    later, drawn = _after(w, rng)
    return 1e-3 * later, drawn


def scale_step(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    later, drawn = _after(w, rng)
    return 1e-6 * later * w.rate_dps, drawn


def scale_asymmetry(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-6 * np.where(w.rate_dps > 0, w.rate_dps, 0.0), {}


def dead_zone(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """The vertical earth rate is lost while the table stands."""
    return -1e-3 * np.exp(-((w.rate_dps / 0.5) ** 4)), {}


def sagnac_sine(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    kappa = rng.uniform(0.003, 0.008)
    return np.sin(kappa * w.rate_dps) / kappa - w.rate_dps, {"phase_rad_per_dps": kappa}


def saturation(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    knee, soft = rng.uniform(55, 85), rng.uniform(2, 6)
    excess = soft * np.logaddexp(0.0, (np.abs(w.rate_dps) - knee) / soft)
    return -1e-3 * np.sign(w.rate_dps) * excess, {"knee_dps": knee}


def rate_order(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    x = w.rate_dps / 100.0
    mix = rng.uniform(0, 2 * np.pi)
    return 1e-3 * (np.cos(mix) * x**4 + np.sin(mix) * x**5), {"mix_rad": mix}


def temperature_order(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * np.sinh((w.case_c - 20.0) / 12.0), {}


def step_response(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """A damped oscillator kicked by each change of rate, integrated with small steps from the arrival on."""
    omega, damping = rng.uniform(1.0, 2.5), rng.uniform(0.1, 0.35)
    kicks = np.array([p.step_dps / 10.0 for p in w.pieces])
    x, v = kicks.copy(), np.zeros(kicks.size)
    sub = 20
    h = STEP_S / sub
    longest = 400
    track = np.empty((longest, kicks.size))
    for i in range(longest):
        total = np.zeros(kicks.size)
        for _ in range(sub):
            v = v + h * (-2 * damping * omega * v - omega**2 * x)
            x = x + h * v
            total += x
        track[i] = total / sub
    out = np.zeros(w.t_s.size)
    # The table arrives a second before a rate segment begins; ramps begin with the step itself.
    for k, p in enumerate(w.pieces):
        late = 10 if p.kind == "rate" else 0
        n = min(p.stop - p.start, longest - late)
        out[p.start : p.start + n] = track[late : late + n, k]
    return 1e-3 * out, {"omega_rad_s": omega, "damping": damping}


def mechanical_resonance(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    rates = sorted({abs(p.rate_dps) for p in w.pieces if 20 <= abs(p.rate_dps) <= 90})
    centre, width = float(rng.choice(rates)) + rng.uniform(-2, 2), rng.uniform(3, 6)
    return 1e-3 / (1.0 + ((np.abs(w.rate_dps) - centre) / width) ** 2), {
        "center_dps": centre,
        "width_dps": width,
    }


def supply_voltage(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    return 1e-3 * (w.supply_v - 12.0), {}


def reference_rate_error(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    sizes = sorted({abs(p.rate_dps) for p in w.pieces})
    wrong = np.interp(np.abs(w.rate_dps), sizes, rng.normal(size=len(sizes)))
    return -1e-6 * wrong * w.rate_dps, {}


def table_eccentricity(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """The reference is read off centre: its angle is wrong by a sine, its rate by the difference of that sine."""
    k, phase = int(rng.integers(1, 3)), rng.uniform(0, 2 * np.pi)
    half = 0.5 * STEP_S * w.rate_dps

    def misread(angle_deg: Floats) -> Floats:
        return np.sin(k * np.deg2rad(angle_deg) + phase)

    late, early = misread(w.angle_deg + half), misread(w.angle_deg - half)
    return -ARCSEC * (late - early) / STEP_S, {"harmonic": k, "phase_rad": phase}


def once_per_turn(w: World, rng: np.random.Generator) -> tuple[Floats, Drawn]:
    """Horizontal earth rate, field or gravity on a tilted or unshielded gyro: a vector turned by the table."""
    phase = rng.uniform(0, 2 * np.pi)
    east, north = np.cos(phase), np.sin(phase)
    angle = np.deg2rad(w.angle_deg)
    return 1e-3 * (east * np.cos(angle) + north * np.sin(angle)), {"phase_rad": phase}


_OF_BENCH: tuple[Maker, ...] = (
    shupe,
    shupe_gradient,
    thermal_hysteresis,
    warm_up,
    bias_drift,
    scale_drift,
    bias_step,
    scale_step,
    scale_asymmetry,
    dead_zone,
    sagnac_sine,
    saturation,
    rate_order,
    temperature_order,
    step_response,
    mechanical_resonance,
    supply_voltage,
    reference_rate_error,
    table_eccentricity,
)
CATALOGUE: dict[str, Maker] = {f.__name__: f for f in _OF_BENCH}
CATALOGUE |= dict.fromkeys(("earth_rate_tilt", "magnetic", "g_sensitivity"), once_per_turn)

#: Need the surface, or act on the output itself: made in `concealed_bench`.
OF_SURFACE = ("thermal_lag", "fit_direction", "truncation")
OF_OUTPUT = ("quantisation", "time_base", "bursts")
