"""Tables whose cubic in the rate may be a sine's: higher odd orders are then expected where the sine has them.

An open loop puts out the sine of its phase. The cubic tells the phase, and the phase the fifth order and all beyond. Errors of
single rates of a table hide these, so that without the sine a file guesses at the largest rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws, effects_of
from gyrocal.diagnosis.model.layers import NEGLIGIBLE, PHASE, Law, OpenLoop
from gyrocal.diagnosis.model.parts import EACH_RATE, EVENLY, ODD
from gyrocal.diagnosis.names.naming import Naming
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.rate import SAGNAC_SINE
from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]

#: Phases at the largest rate that are open loops', rad: below, the cubic is less than 1 % of the range, which gyros have that are
#: none; above, the output hardly rises with the rate. Without the sine the cubic is of either sign and of any size from a tenth of
#: that to ten times it.
_PHASES_RAD, _SIZES = (0.25, 1.45), (0.1, 10.0)
#: Open loops among the gyros on this bench, to one that is none: most that bend so much are fiber-optic ones without feedback.
_ODDS = 3.0
#: A gyro's own cubic beside that of its sine, as a share of it: one standard deviation. The answer is the same from 0.05 to 0.2.
_OWN_CUBIC = 0.1
#: Ratio of a phase to the next one that is tried.
_NEXT = 1.01


def with_open_loop(near: Sequence[Candidate]) -> list[Candidate]:
    """Models of a table with a sine in place of their shapes that are odd in the rate; none where the cubic is no sine's.

    They pay nothing for it: neither do the shapes. That the cubic is one that a sine has is in their favour.

    Parameters
    ----------
    near : models to average over, the best first
    """
    of_rate = {effect.id for effect in effects_of(ODD)}
    plain = [c for c in near if not of_rate & {law.effect for law in c.fitted.model.laws}]
    sine = _of_cubic(plain[0]) if plain else None
    return [] if sine is None else [_beside(c, sine) for c in plain]


def slope_of(c: Candidate) -> Floats | None:
    """Slope of the output over the rate at the rows, of the sine that the cubic of a model is one of; None where it is none's."""
    sine, rate_dps = _of_cubic(c), c.fitted.model.means.rate_dps
    return None if sine is None else np.cos(sine.phase_rad_per_dps * rate_dps)


def _beside(c: Candidate, sine: OpenLoop) -> Candidate:
    model = c.fitted.model
    shapes = model.of_block(ODD)
    rest = model.without(shapes)
    fitted = c.fitted.refit(replace(rest.with_components(sine.component), open_loop=sine))
    return replace(c, fitted=fitted, score=c.score + fitted.nll - c.fitted.nll - in_favour())


def phase_of(near: Sequence[tuple[float, Candidate]]) -> Estimate:
    """The Sagnac phase of models with the sine, and their weights."""
    told = []
    for weight, c in near:
        sine, solution = c.fitted.model.open_loop, c.fitted.solve()
        if sine is not None:
            at, by = solution.starts[PHASE], sine.phase_rad_per_dps * sine.spread
            off, variance = float(solution.amplitudes[PHASE][0]), float(solution.covariance[at, at])
            told.append((weight, sine.phase_rad_per_dps + by * off, by**2 * variance))
    weights, phases, variances = np.array(told).T
    mean = float(weights @ phases / weights.sum())
    variance = float(weights @ (variances + (phases - mean) ** 2) / weights.sum())
    return Estimate.normal(mean, float(np.sqrt(variance)), "rad per deg/s")


def told_as_sine(naming: Naming, laws: Laws, near: Sequence[tuple[float, Candidate]]) -> Naming:
    """What was named of a table whose models have the sine: it stands in the place of laws that are taken for one, as a gain that rises at the end.

    Those were named before errors of single rates had made room for the sine.
    """
    odd = [n for n in naming.named if n.block in (ODD, EACH_RATE) and naming.fitted.model.holds(n.law)]
    taken = [n for n in odd if n.law.effect in SAGNAC_SINE.looks_like]
    if not taken:
        return naming
    shape = {"phase_rad_per_dps": phase_of(near).value}
    law = Law(SAGNAC_SINE.id, shape, laws.at(SAGNAC_SINE, shape))
    rest = naming.fitted.model.without_laws([n.law.name for n in taken])
    sine = replace(taken[0], law=law, rivals={})
    named = (*(n for n in naming.named if n not in taken), sine)
    return replace(naming, fitted=naming.fitted.refit(rest.with_laws(law)), named=named)


def in_favour() -> float:
    """How much more probable the sine is than anything with a cubic of this sign and size, nats: the cubic goes with the phase's square."""
    anything = 2.0 * (2.0 * np.log(_PHASES_RAD[1] / _PHASES_RAD[0]) + np.log(_SIZES[1] / _SIZES[0]))
    by_sine = 2.0 * np.log(_PHASES_RAD[1] / _PHASES_RAD[0])
    return float(np.log(_ODDS * anything / by_sine))


def _of_cubic(c: Candidate) -> OpenLoop | None:
    """The sine that has the cubic of a model; None where none has, or its higher orders are lost in the noise."""
    model, means = c.fitted.model, c.fitted.model.means
    scale, solution = model.basis.frame.rate_scale_dps, c.fitted.solve()
    cubic_dps = model.legendre(solution)[SHAPE[1] * (SHAPE[0] - 1)]
    phases = np.geomspace(*_PHASES_RAD, 400) / scale
    sines = np.column_stack([_sine(EVENLY * scale, phase) for phase in phases])
    # As smooth parts are freed of the surface.
    cubics = legendre.legfit(EVENLY, sines, SHAPE[0] - 1)[-1]
    if not cubics.min() < cubic_dps < cubics.max():
        return None
    phase = float(np.interp(-cubic_dps, -cubics, phases))
    sine_dps = _sine(means.rate_dps, phase)
    orders = np.vander(means.rate_dps / scale, SHAPE[0])
    beyond_dps = sine_dps - orders @ np.linalg.lstsq(orders, sine_dps, rcond=None)[0]
    if np.max(np.abs(beyond_dps)) < NEGLIGIBLE * np.std(solution.left):
        return None
    # The cubic goes with the square of the phase.
    return OpenLoop(phase, sine_dps, _by_phase(means.rate_dps, phase)[:, None], 0.5 * _OWN_CUBIC)


def given_back(sine: OpenLoop, phase: float, scale_dps: float) -> tuple[Floats, Floats]:
    """What the surface gives back in a file with another phase than the model's, and its derivative by the phase, shape (4,) each.

    The model is a straight line in the phase, the file has the sine itself: the cubic would be off by the square of the difference.
    Powers of the scaled rate from 0 on.
    """
    rate_dps, known = EVENLY * scale_dps, sine.phase_rad_per_dps
    line = _by_phase(rate_dps, known) / known
    off = _sine(rate_dps, phase) - _sine(rate_dps, known) - (phase - known) * line
    slope = _by_phase(rate_dps, phase) / phase - line
    powers = np.polynomial.polynomial.polyfit(EVENLY, np.column_stack([off, slope]), SHAPE[0] - 1)
    return np.asarray(powers[:, 0]), np.asarray(powers[:, 1])


def _sine(rate_dps: Floats, phase: float) -> Floats:
    here = Conditions(np.zeros_like(rate_dps), rate_dps, np.zeros_like(rate_dps))
    return SAGNAC_SINE.unit_dps(here, {"phase_rad_per_dps": phase}, None)


def _by_phase(rate_dps: Floats, phase: float) -> Floats:
    """Derivative by the logarithm of the phase."""
    return np.asarray(
        (_sine(rate_dps, phase * _NEXT) - _sine(rate_dps, phase / _NEXT)) / (2.0 * np.log(_NEXT))
    )
