"""Effects of what is around the gyro: rate steps and supply."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.effect import MDPS, Conditions, Effect, Floats, amplitude, memoryless, shape
from gyrocal.physics.surface import Surface

#: The customary step of rate in the amplitude of `step_response`, deg/s.
_STEP_DPS = 10.0


def _step_response(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    since_s, step_dps = c.need("since_step_s"), c.need("step_dps")
    ringing = np.cos(2.0 * np.pi * p["frequency_hz"] * since_s + p["phase_rad"])
    decay = np.where(since_s >= 0.0, np.exp(-np.maximum(since_s, 0.0) / p["tau_s"]), 0.0)
    return np.asarray(MDPS * p["amplitude"] * step_dps / _STEP_DPS * decay * ringing)


def _supply(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * (c.need("supply_v") - p["nominal_v"]))


STEP_RESPONSE = Effect(
    id="step_response",
    family="step",
    equation="e = k (dw/10) exp(-t/tau) cos(2 pi f t + phi), t since the step dw",
    statement="After a change of rate the output rings or creeps before it settles (bandwidth, servo of the table).",
    parameters=(
        amplitude("mdeg/s per 10 deg/s", 10000.0, 5.0, "size at the step"),
        shape("tau_s", "s", 0.01, 600.0, 3.0, "decay time"),
        shape("frequency_hz", "Hz", 0.0, 100.0, 0.0, "frequency of the ringing; 0: exponential"),
        shape("phase_rad", "rad", -2 * np.pi, 2 * np.pi, 0.0, "phase"),
    ),
    needs=("since_step_s", "step_dps"),
    seen_in="time_since_step",
    looks_like=(),
    reference="second-order step response; physics-report.md G11",
    runtime=False,
    error_dps=memoryless(_step_response),
)

SUPPLY_VOLTAGE = Effect(
    id="supply_voltage",
    family="supply",
    equation="e = k (V - V0)",
    statement="The bias follows the supply voltage.",
    parameters=(
        amplitude("mdeg/s/V", 1000.0, 1.0, "bias per volt"),
        shape("nominal_v", "V", 0.0, 60.0, 12.0, "nominal supply V0"),
    ),
    needs=("supply_v",),
    seen_in="supply",
    looks_like=(),
    reference="IEEE Std 952, supply sensitivity; physics-report.md G17",
    runtime=False,
    error_dps=memoryless(_supply),
)

EFFECTS = (STEP_RESPONSE, SUPPLY_VOLTAGE)
