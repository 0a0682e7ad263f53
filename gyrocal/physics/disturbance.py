"""Effects of what is around the gyro: rate steps and supply."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.c_text import ABOVE, CMemory, CText, Number
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect, Floats, amplitude, choice, memoryless, shape
from gyrocal.physics.hiding import Hiding, usual_draw
from gyrocal.physics.offer import Offer, steps_of_rate
from gyrocal.physics.search import Search, Shape, Unit, one_column, with_phase
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS

#: The customary step of rate in the amplitude of `step_response`, deg/s.
_STEP_DPS = 10.0


def _step_response(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    since_s, step_dps = c.need("since_step_s"), c.need("step_dps")
    decay = complex(1.0 / p["tau_s"], 2.0 * np.pi * p["frequency_hz"])
    begin_s = np.maximum(since_s, 0.0)
    averaged: Floats | float = 1.0
    if c.row_s is not None:
        # No row begins before the step: of what decays within a long one most would be told of it all.
        begin_s = np.maximum(since_s - 0.5 * c.row_s, 0.0)
        averaged = -np.expm1(-decay * c.row_s) / (decay * c.row_s)
    left = np.exp(-decay * begin_s - 1j * p["phase_rad"]) * averaged
    return np.asarray(MDPS * p["amplitude"] * step_dps / _STEP_DPS * np.where(since_s >= 0.0, left.real, 0.0))


def above_usual(c: Conditions, usual_v: float) -> Floats:
    """Supply above the usual one, V, which counts for it where nobody reads it."""
    if c.supply_v is None:
        return np.zeros(len(c))
    return np.where(np.isfinite(c.supply_v), c.supply_v - usual_v, 0.0)


def above_usual_c(number: Number, usual_v: float) -> str:
    """The same as C, which calls `ABOVE`."""
    return f"PREFIX_above@f@(supply_v, {number(usual_v)})"


def _supply(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * above_usual(c, p["nominal_v"]))


def _supply_c(p: Mapping[str, float], number: Number, memory: CMemory) -> str:
    return f"{number(MDPS * p['amplitude'])} * {above_usual_c(number, p['nominal_v'])}"


def _at_usual_supply(offer: Offer) -> list[dict[str, float]]:
    return [{} if offer.supply_v is None else {"nominal_v": offer.supply_v}]


def _creep_and_ringing(offer: Offer) -> list[dict[str, float]]:
    """Creeps, and ringing over frequencies and dampings (a servo rings a few times, not for ever)."""
    creep = [{"tau_s": float(t), "frequency_hz": 0.0} for t in (0.3, 0.7, 1.5, 3.0, 6.0)]
    ring = [
        {"tau_s": float(1.0 / (2 * np.pi * f * damping)), "frequency_hz": float(f)}
        for f in np.geomspace(0.1, 4.2, 32)
        for damping in (0.1, 0.25, 0.6)
    ]
    return creep + [s for s in ring if 0.15 < s["tau_s"] < 12.0]


def _step_columns(unit_dps: Unit, c: Conditions, given: Shape, surface: Surface | None) -> Floats:
    # A creep has no phase.
    return (with_phase if given["frequency_hz"] > 0.0 else one_column)(unit_dps, c, given, surface)


def _draw_step(usual: Mapping[str, float], offer: Offer, rng: np.random.Generator) -> dict[str, float]:
    p = usual_draw(usual, offer, rng)
    if rng.random() < 0.5:
        return p | {"frequency_hz": float(rng.uniform(0.2, 0.8))}
    return p | {"frequency_hz": 0.0, "phase_rad": 0.0}


STEP_RESPONSE = Effect(
    id="step_response",
    family="step",
    equation="e = k (dw/10) exp(-t/tau) cos(2 pi f t + phi), t since the step dw",
    statement="After a change of rate the output rings or creeps before it settles (bandwidth, servo of the table).",
    parameters=(
        amplitude("mdeg/s per 10 deg/s", 10000.0, 5.0, "size at the step"),
        shape("tau_s", "s", 0.01, 600.0, 3.0, "decay time"),
        choice("frequency_hz", "Hz", 0.0, 100.0, 0.0, "frequency of the ringing; 0: exponential"),
        choice("phase_rad", "rad", -2 * np.pi, 2 * np.pi, 0.0, "phase"),
    ),
    needs=("since_step_s", "step_dps"),
    seen_in="time_since_step",
    looks_like=(),
    reference="second-order step response",
    runtime=False,
    error_dps=memoryless(_step_response),
    search=Search(
        grid=_creep_and_ringing,
        columns=_step_columns,
        refined=("tau_s", "frequency_hz"),
        requires=(steps_of_rate,),
    ),
    # The data set that a bench records begins after the step.
    hiding=Hiding(_draw_step, own_zero=False),
)

SUPPLY_VOLTAGE = Effect(
    id="supply_voltage",
    family="supply",
    equation="e = k (V - V0)",
    statement="The bias follows the supply voltage.",
    parameters=(
        amplitude("mdeg/s/V", 1000.0, 1.0, "bias per volt"),
        choice("nominal_v", "V", 0.0, 60.0, 12.0, "nominal supply V0"),
    ),
    needs=("supply_v",),
    seen_in="supply",
    looks_like=(),
    reference="IEEE Std 952, supply sensitivity",
    runtime=True,
    error_dps=memoryless(_supply),
    search=Search(grid=_at_usual_supply),
    c_text=CText(_supply_c, (ABOVE,)),
)

EFFECTS = (STEP_RESPONSE, SUPPLY_VOLTAGE)
