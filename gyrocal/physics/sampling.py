"""Effects of sampling: output steps, the sample clock, isolated bad samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect, Floats, Parameter, amplitude, choice, memoryless, shape
from gyrocal.physics.hiding import Hiding
from gyrocal.physics.kernels import normal, uniform
from gyrocal.physics.search import Search
from gyrocal.physics.surface import Surface
from gyrocal.units import MDPS, PPM

#: Two samples nearer than this are the same sample, s.
_SAME_TIME_S = 1e-6


def _quantisation(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    step_dps = MDPS * p["amplitude"]
    if c.gyro_dps is None or step_dps == 0.0:
        return np.zeros(len(c))
    return np.asarray(np.rint(c.gyro_dps / step_dps) * step_dps - c.gyro_dps)


def _time_base(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(PPM * p["amplitude"] * c.rate_dps)


def _bursts(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    window = np.floor(c.t_s / p["duration_s"])
    inside = uniform(p["seed"], 101, window) < p["share"]
    return np.asarray(MDPS * p["amplitude"] * inside * normal(p["seed"], 51, c.t_s / _SAME_TIME_S))


QUANTISATION = Effect(
    id="quantisation",
    family="sampling",
    equation="output rounded to steps q: no mean error, variance q^2/12",
    statement="The output comes in coarse steps, which adds noise of a step over the root of twelve.",
    parameters=(Parameter("amplitude", "mdeg/s", 0.0, 10000.0, 3.05, False, "step q of the output"),),
    needs=("rate_dps",),
    seen_in="rate",
    looks_like=(),
    reference="IEEE Std 952, quantisation noise (Allan slope -1)",
    runtime=False,
    error_dps=memoryless(_quantisation),
    acts_on="converter",
    search=Search(by_columns=False, scatters=True),
    hiding=Hiding(free_size=False, always_there=True),
)

TIME_BASE = Effect(
    id="time_base",
    family="sampling",
    equation="e = k w, k the relative error of the sample clock",
    statement="The sample clock is off by a factor, which scales an output that is an angle per sample.",
    parameters=(amplitude("ppm", 100000.0, 1000.0, "clock too slow by"),),
    needs=("t_s", "rate_dps"),
    seen_in="rate",
    looks_like=(),
    reference="Riley, NIST SP 1065 (clocks)",
    runtime=False,
    error_dps=memoryless(_time_base),
    search=Search(by_columns=False),
    hiding=Hiding(free_size=False),
)

BURSTS = Effect(
    id="bursts",
    family="sampling",
    equation="e = k n in a share of all time windows, n normal",
    statement="Bursts of noise disturb single samples or a single data set (slip ring, mislabelled data).",
    parameters=(
        amplitude("mdeg/s", 1e6, 50.0, "standard deviation inside a burst"),
        shape("share", "1", 0.0, 1.0, 0.005, "share of time inside bursts"),
        shape("duration_s", "s", 0.001, 3600.0, 0.5, "length of a burst"),
        choice("seed", "1", 0.0, 2.0**52, 1.0, "which draw"),
    ),
    needs=("t_s",),
    seen_in="data_set_index",
    looks_like=(),
    reference="vibration and knocks on the bench",
    runtime=False,
    error_dps=memoryless(_bursts),
    search=Search(by_columns=False, scatters=True),
    hiding=Hiding(free_size=False),
)

EFFECTS = (QUANTISATION, TIME_BASE, BURSTS)
