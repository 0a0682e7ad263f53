"""Effects of the table angle: once or a few times a turn, constant in size or growing with rate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect, Floats, amplitude, choice, count, memoryless
from gyrocal.physics.fold import on_turn_with_rate
from gyrocal.physics.offer import table_turns
from gyrocal.physics.search import Search, with_phase
from gyrocal.physics.surface import Surface
from gyrocal.units import ARCSEC_TO_DEG, DEG_TO_RAD, MDPS

#: Periods a turn that are looked for: of a centre, an oval, and the gears and poles of drives.
_HARMONICS = 6
_PHASE = choice("phase_rad", "rad", -2 * np.pi, 2 * np.pi, 0.0, "table angle of the maximum")


def _once_a_turn(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    return np.asarray(MDPS * p["amplitude"] * c.turned(1.0, -p["phase_rad"]))


def _eccentricity(c: Conditions, p: Mapping[str, float], surface: Surface | None) -> Floats:
    # The reference reads too fast where its angle error grows: gyro minus reference is then too small.
    k = round(p["harmonic"])
    epsilon_rad = p["amplitude"] * ARCSEC_TO_DEG * DEG_TO_RAD
    return np.asarray(-epsilon_rad * k * c.rate_dps * c.turned(k, p["phase_rad"]))


EARTH_RATE_TILT = Effect(
    id="earth_rate_tilt",
    family="angle, constant",
    equation="e = k cos(theta - phi), k = Omega_E cos(latitude) sin(tilt)",
    statement="The table's axis is off vertical and turns the gyro through the horizontal part of the Earth's rate.",
    parameters=(amplitude("mdeg/s", 4.2, 0.5, "horizontal Earth rate on the input axis"), _PHASE),
    needs=("angle_deg",),
    seen_in="table_angle",
    looks_like=("magnetic", "g_sensitivity"),
    reference="IEEE Std 952, Earth rate on a tilted table",
    runtime=False,
    error_dps=memoryless(_once_a_turn),
    search=Search(columns=with_phase, requires=(table_turns,)),
)

MAGNETIC = Effect(
    id="magnetic",
    family="angle, constant",
    equation="e = k B_h cos(theta - phi)",
    statement="The coil turns in the Earth's magnetic field (Faraday effect).",
    parameters=(amplitude("mdeg/s", 30.0, 1.0, "bias in the horizontal field"), _PHASE),
    needs=("angle_deg",),
    seen_in="table_angle",
    looks_like=("earth_rate_tilt", "g_sensitivity"),
    reference="Hotate and Tabe: drift of a fiber gyro by the Faraday effect",
    runtime=False,
    error_dps=memoryless(_once_a_turn),
    search=Search(
        columns=with_phase,
        requires=(table_turns,),
        twin_of="earth_rate_tilt",
        told_apart={
            "earth_rate_tilt": "turn the bench by 90 degrees, or put a magnet beside the gyro: the line follows "
            "the field, not the bench"
        },
    ),
)

G_SENSITIVITY = Effect(
    id="g_sensitivity",
    family="angle, constant",
    equation="e = k g sin(tilt) cos(theta - phi)",
    statement="Gravity across a tilted table changes the bias once a turn (MEMS).",
    parameters=(amplitude("mdeg/s", 100.0, 1.0, "bias by gravity across the tilted table"), _PHASE),
    needs=("angle_deg",),
    seen_in="table_angle",
    looks_like=("earth_rate_tilt", "magnetic"),
    reference="IEEE Std 952, acceleration sensitivity",
    runtime=False,
    error_dps=memoryless(_once_a_turn),
    search=Search(
        columns=with_phase,
        requires=(table_turns,),
        twin_of="earth_rate_tilt",
        told_apart={
            "earth_rate_tilt": "tilt the table by another, known angle: gravity and earth rate grow with it by "
            "different known amounts",
            "magnetic": "tilt the table by another, known angle: only gravity follows",
        },
    ),
)

TABLE_ECCENTRICITY = Effect(
    id="table_eccentricity",
    family="angle, with rate",
    equation="reference angle off by eps sin(k theta + phi): e = -eps k w cos(k theta + phi), k = 1, 2, ...",
    statement="The table's angle reference is off centre, or its gear or motor pulls, so that the reference rate is wrong once or a few times a turn.",
    parameters=(
        amplitude("arcsec", 3600.0, 5.0, "error of the reference angle"),
        count("harmonic", 1.0, 64.0, 1.0, "periods a turn"),
        choice("phase_rad", "rad", -2 * np.pi, 2 * np.pi, 0.0, "phase phi"),
    ),
    needs=("angle_deg", "rate_dps"),
    seen_in="table_angle",
    looks_like=("earth_rate_tilt",),
    reference="kinematics of a table off its centre",
    runtime=False,
    error_dps=memoryless(_eccentricity),
    acts_on="reference",
    search=Search(
        grid=lambda offer: [{"harmonic": float(k)} for k in range(1, _HARMONICS + 1)],
        columns=with_phase,
        requires=(table_turns,),
    ),
    fold=on_turn_with_rate,
)

EFFECTS = (EARTH_RATE_TILT, MAGNETIC, G_SENSITIVITY, TABLE_ECCENTRICITY)
