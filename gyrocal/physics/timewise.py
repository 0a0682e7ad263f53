"""Effects of time: since power-on, slow drifts, steps at an instant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.c_text import CMemory, CText, Number
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import (
    Effect,
    Floats,
    amplitude,
    choice,
    memoryless,
    of_scale,
    shape,
    where_it_acts,
    where_it_acts_c,
)
from gyrocal.physics.fold import scale_on_time
from gyrocal.physics.offer import Offer, begins_warm, rates_differ, table_turns
from gyrocal.physics.search import Search, scales
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS, PPM, S_PER_H

#: Instants of a jump of the bias that are tried from the first; a scan of all of them adds the likely ones.
_JUMP_NET = 48

#: A drift is straight, slows down or grows.
POWERS = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
#: Ageing goes with the logarithm of time, straight until its knee, which is at so much of the record.
KNEES = (0.003, 0.01, 0.03, 0.1, 0.3)
#: Evidence that it starts with beside a power of time, nats: it is like a warm-up, which more gyros have.
AGEING_NATS = -2.0
_POWER = shape("power", "1", 0.2, 3.0, 1.0, "1: steady; below 1 it slows down; above 1 it grows")
_KNEE = shape(
    "knee_s",
    "s",
    0.0,
    1e7,
    0.0,
    "above 0 it ages: with the logarithm of time, whatever the power, straight until about then",
)
_FROM = choice("from_s", "s", -1e10, 1e10, 0.0, "instant from which it counts, on the record's clock")
_AT = shape("at_s", "s", -1e10, 1e10, 3600.0, "instant of the step, on the record's clock")


def _warm_up(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    settling = MDPS * p["amplitude"] * np.exp(-c.need("since_power_on_s") / p["tau_s"])
    return np.asarray(where_it_acts(c, p, settling))


def growth(t_s: Floats, p: Mapping[str, float]) -> Floats:
    """Growth of a drift since ``from_s``, 1 after an hour: with a power of time, or with its logarithm where it ages.

    What has aged since some time before ``from_s`` has the same law with a later knee.

    Parameters
    ----------
    t_s : ndarray, shape (n,)
        Time on the record's clock.
    p : mapping
        Its ``from_s`` (else the clock's zero), and its ``power`` or, of ageing, its ``knee_s``.
    """
    knee_s, since_s = p.get("knee_s", 0.0), t_s - p.get("from_s", 0.0)
    if not knee_s:
        return np.asarray(np.sign(since_s) * np.abs(since_s / S_PER_H) ** p["power"])
    return np.asarray(np.sign(since_s) * np.log1p(np.abs(since_s) / knee_s) / np.log1p(S_PER_H / knee_s))


def _bias_drift(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * growth(c.t_s, p))


def _scale_drift(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(PPM * p["amplitude"] * growth(c.t_s, p) * c.rate_dps)


def _bias_step(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * c.since(p["at_s"]))


def _scale_step(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(PPM * p["amplitude"] * c.rate_dps * c.since(p["at_s"]))


def _net(offer: Offer) -> list[dict[str, float]]:
    return [{"at_s": float(x)} for x in np.linspace(*offer.t_s, _JUMP_NET + 2)[1:-1]]


def _powers(offer: Offer) -> list[dict[str, float]]:
    # What ages since the record began is hardly told from a warm-up of two time constants: only the search of a table weighs
    # it against warm-ups of many.
    return [power_shape(power, offer) for power in POWERS]


def power_shape(power: float, offer: Offer) -> dict[str, float]:
    """Shape of a drift with a power of time in a record: on a clock of another origin every power would be straight."""
    return {"power": power} if offer.from_zero else {"power": power, "from_s": offer.t_s[0]}


def _between_turns(offer: Offer) -> list[dict[str, float]]:
    # Before the first turns and after the last it is a scale factor for the whole record, which the surface has.
    return [{"at_s": float(x)} for x in offer.turn_starts_s]


def _warm_up_c(p: Mapping[str, float], n: Number, memory: CMemory) -> str:
    return where_it_acts_c(p, n, f"{n(MDPS * p['amplitude'])} * exp@f@(-since_power_on_s / {n(p['tau_s'])})")


WARM_UP = Effect(
    id="warm_up",
    family="time",
    equation="e = k exp(-(t - t_on)/tau); of the scale factor times w/(100 deg/s)",
    statement="The bias, or the scale factor, settles exponentially after power-on.",
    parameters=(
        amplitude("mdeg/s", 100000.0, 10.0, "bias at power-on"),
        shape("tau_s", "s", 60.0, 7200.0, 1200.0, "time constant"),
        of_scale(),
    ),
    needs=("since_power_on_s",),
    seen_in="time_since_power_on",
    looks_like=("bias_drift",),
    reference="IEEE Std 952, warm-up time",
    runtime=True,
    error_dps=memoryless(_warm_up),
    search=Search(grid=scales(120.0, 7200.0, 12), refined=("tau_s",), requires=(begins_warm,), adds_up=True),
    c_text=CText(_warm_up_c),
)

BIAS_DRIFT = Effect(
    id="bias_drift",
    family="time",
    equation="e = k t^p, or k ln(1 + t/t_k) / ln(1 + 1 h/t_k)",
    statement="The bias drifts slowly, all the run long (ageing, rate ramp).",
    parameters=(amplitude("mdeg/s/h", 100000.0, 1.0, "drift in the first hour"), _POWER, _KNEE, _FROM),
    needs=("t_s",),
    seen_in="time",
    looks_like=("warm_up", "thermal_hysteresis"),
    reference="IEEE Std 952, rate ramp",
    runtime=False,
    error_dps=memoryless(_bias_drift),
    search=Search(grid=_powers, refined=("power", "knee_s")),
)

SCALE_DRIFT = Effect(
    id="scale_drift",
    family="time",
    equation="e = k t^p w, or k w ln(1 + t/t_k) / ln(1 + 1 h/t_k)",
    statement="The scale factor drifts slowly, all the run long.",
    parameters=(amplitude("ppm/h", 100000.0, 50.0, "drift in the first hour"), _POWER, _KNEE, _FROM),
    needs=("t_s", "rate_dps"),
    seen_in="time",
    looks_like=("scale_step", "thermal_lag"),
    reference="wavelength of the source",
    runtime=False,
    error_dps=memoryless(_scale_drift),
    search=Search(grid=_powers, refined=("power", "knee_s"), requires=(table_turns, rates_differ)),
    fold=scale_on_time,
)

BIAS_STEP = Effect(
    id="bias_step",
    family="time",
    equation="e = k for t >= t_1",
    statement="The bias jumps at an instant.",
    parameters=(amplitude("mdeg/s", 100000.0, 5.0, "jump"), _AT),
    needs=("t_s",),
    seen_in="time",
    looks_like=("bias_drift",),
    reference="changes in level",
    runtime=False,
    error_dps=memoryless(_bias_step),
    search=Search(grid=_net, refined=("at_s",)),
)

SCALE_STEP = Effect(
    id="scale_step",
    family="time",
    equation="e = k w for t >= t_1",
    statement="The scale factor jumps at an instant: gears, a re-mount, a restart.",
    parameters=(amplitude("ppm", 100000.0, 300.0, "jump"), _AT),
    needs=("t_s", "rate_dps"),
    seen_in="time",
    looks_like=("bias_step", "scale_drift"),
    reference="changes in level",
    runtime=False,
    error_dps=memoryless(_scale_step),
    search=Search(grid=_between_turns, refined=("at_s",), requires=(table_turns, rates_differ)),
    fold=scale_on_time,
)

EFFECTS = (WARM_UP, BIAS_DRIFT, SCALE_DRIFT, BIAS_STEP, SCALE_STEP)
