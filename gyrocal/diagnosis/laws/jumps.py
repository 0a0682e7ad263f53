"""Jumps of the bias and of the scale factor at an instant.

A walk, 1/f noise and anything smooth can follow a jump from afar, and would be taken for it where the instant is
missed. So every boundary between rows is tried, beside all of them: what they can follow is no jump.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws
from gyrocal.diagnosis.model.blocks import REPLACED
from gyrocal.diagnosis.model.layers import WANDERING_BIAS, WANDERING_SCALE, Fitted, Law
from gyrocal.diagnosis.rows.means import Means
from gyrocal.diagnosis.rows.visited import steps_of_scale
from gyrocal.inference.additive import Component, gains
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.timewise import BIAS_DRIFT, BIAS_STEP, SCALE_DRIFT, SCALE_STEP
from gyrocal.units import MDPS, PPM

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: What each kind of jump is compared with, once it is found.
_SLOW = {BIAS_STEP.id: BIAS_DRIFT, SCALE_STEP.id: SCALE_DRIFT}
#: What wanders where each kind of jump may be.
_WANDERS = {BIAS_STEP.id: WANDERING_BIAS, SCALE_STEP.id: WANDERING_SCALE}
#: Rows on either side of a jump: fewer are a stray data set.
_FEWEST_ROWS = 3
#: Instants within the rows beside a boundary, and how often they are taken closer.
_WITHIN, _ZOOMS = 9, 3


@dataclass(frozen=True)
class Jump:
    """A jump that was found: its evidence, how much worse a drift is (nats), and how many instants were tried."""

    law: Law
    gain: float
    rivals: Mapping[str, float]
    trials: int


def with_jumps(fitted: Fitted, passes: Sequence[Component], laws: Laws) -> tuple[Fitted, list[Jump]]:
    """The model with the jumps that are there.

    Parameters
    ----------
    passes : what passes, that may have died in `fitted` and is to stand beside each jump
        What does not wander does not jump either.
    """
    found: list[Jump] = []
    kinds = [effect for effect, names in _WANDERS.items() if any(c.name in names for c in passes)]
    wide = fitted.refit(fitted.model.with_components(*passes))
    while True:
        tried = [best_jump(wide, laws, effect) for effect in kinds]
        jumped = [(wide.nll - new.nll, new, count) for new, count in (t for t in tried if t is not None)]
        jumped = [j for j in jumped if j[0] > GAIN + 0.5 * np.log(j[2])]
        if not jumped:
            break
        gain, new, count = max(jumped, key=lambda j: j[0])
        found.append(Jump(new.model.laws[-1], gain, _rivals(wide, new, laws), count))
        wide = new
    if not found:
        return fitted, []
    stays = {*fitted.model.components, *(c.name for c in passes)}
    kept = {n: c for n, c in wide.model.components.items() if n in stays}
    model = replace(wide.model, components=kept)
    return Fitted(model.alive(wide.fit), wide.fit, wide.contrasts), found


def boundaries(means: Means, effect: str) -> Ints:
    """Rows at whose beginning a jump may be, shape (m,)."""
    rows = np.arange(_FEWEST_ROWS, len(means) - _FEWEST_ROWS)
    if effect == BIAS_STEP.id:
        return rows
    # Before the first turns and after the last it is a scale factor for the whole record, which the surface has.
    turning = np.flatnonzero(means.rate_dps != 0.0)
    return np.intersect1d(turning[2:-1], steps_of_scale(means, _FEWEST_ROWS))


def best_jump(fitted: Fitted, laws: Laws, effect: str) -> tuple[Fitted, int] | None:
    """The model with the jump that gains most, and the number of instants."""
    means = fitted.model.means
    rows = boundaries(means, effect)
    if rows.size == 0:
        return None
    score, p = fitted.contrasts.precision(fitted.model.all, fitted.fit.log_variance)
    unit = MDPS * np.ones(len(means)) if effect == BIAS_STEP.id else PPM * means.rate_dps
    most = CATALOGUE[effect].parameter("amplitude").high
    later = np.where(np.arange(len(means))[:, None] >= rows, unit[:, None], 0.0)
    row = int(rows[int(np.argmax(gains(later, score, p, most)))])
    between_s, reach_s = float(means.from_s[row]), float(means.to_s[row] - means.from_s[row - 1]) / 2.0
    at_s = between_s
    for _ in range(_ZOOMS):
        instants = np.concatenate([[between_s, at_s], np.linspace(at_s - reach_s, at_s + reach_s, _WITHIN)])
        near = [laws.at(CATALOGUE[effect], {"at_s": float(at)})[:, 0] for at in instants]
        gained = gains(np.column_stack(near), score, p, most)
        best = int(np.argmax(gained))
        # Of a jump in the gap between two rows the means tell no instant within one of them.
        best = best if gained[best] > gained[0] + 2.0 * REPLACED else 0
        at_s, reach_s = float(instants[best]), 2.0 * reach_s / (_WITHIN - 1)
    law = Law(effect, {"at_s": at_s}, near[best][:, None])
    found = fitted.refit(fitted.model.with_laws(law))
    # At rates that hardly turn a scale factor could be anything, and take what another law leaves of them.
    possible = abs(float(found.solve().amplitudes[law.name][0])) < most
    return (found, int(rows.size)) if possible else None


def _rivals(wide: Fitted, jumped: Fitted, laws: Laws) -> dict[str, float]:
    """How much worse a drift explains the same, nats."""
    drift = _SLOW[jumped.model.laws[-1].effect]
    law = Law(drift.id, {}, laws.at(drift, {}))
    drifting = wide.refit(wide.model.with_laws(law))
    return {drift.id: drifting.nll - jumped.nll}
