"""What a law of the rate leaves where a gyro obeys it only nearly: it changes with temperature, and its corners are round.

None of this has a name of its own. It tells how far a law goes that nobody has written down exactly, so that what it
leaves is neither held against it nor taken for a second effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import hermite_e
from numpy.typing import NDArray

from gyrocal.diagnosis.laws import Laws
from gyrocal.diagnosis.layers import Fitted, Law
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import RATE_ORDER

Floats = NDArray[np.float64]

#: How far a law may be smeared over the rate: standard deviations as shares of the largest rate.
_SMEARED = (0.02, 0.05, 0.1, 0.2)
#: Rates that a smeared law is the mean of.
_NODES = 9
#: Ratio of a shape to one next to it, by which it is known what a change of the shape does.
_NEXT = 1.05


def changing(fitted: Fitted, own: Sequence[Law], laws: Laws) -> Fitted:
    """The model whose laws of the rate among some may change with temperature, in size and in shape: each is the same law."""
    return _beside(fitted, {law.name: _by_temperature(law, fitted, laws) for law in _of_rate(own)})


def with_misfit(fitted: Fitted, own: Sequence[Law], laws: Laws) -> Fitted:
    """The same, whose corners may be round as well: what is left of this is no misfit of theirs."""
    width_dps = fitted.model.basis.frame.rate_scale_dps
    misfits = {}
    for law in _of_rate(own):
        round_off = [_smeared(law, share * width_dps, laws) - law.columns for share in _SMEARED]
        misfits[law.name] = np.column_stack([_by_temperature(law, fitted, laws), *round_off])
    return _beside(fitted, misfits)


def _of_rate(own: Sequence[Law]) -> list[Law]:
    return [law for law in own if CATALOGUE[law.effect].family == RATE_ORDER.family]


def _beside(fitted: Fitted, misfits: Mapping[str, Floats]) -> Fitted:
    if not misfits:
        return fitted
    more = {f"misfit of {n}": Component(f"misfit of {n}", columns) for n, columns in misfits.items()}
    return fitted.refit(replace(fitted.model, components={**fitted.model.components, **more}))


def _by_temperature(law: Law, fitted: Fitted, laws: Laws) -> Floats:
    """What a law gains where its size and its shape follow the temperature, shape (n, q)."""
    effect, frame = CATALOGUE[law.effect], fitted.model.basis.frame
    warmth = ((fitted.model.means.temp_c - frame.temp_center_c) / frame.temp_scale_c)[:, None]
    found = [law.columns * warmth]
    for name in effect.search.refined:
        if law.shape.get(name, 0.0) > 0.0:
            more, less = (
                laws.at(effect, {**law.shape, name: law.shape[name] * x}) for x in (_NEXT, 1.0 / _NEXT)
            )
            found.append((more - less) / (2.0 * np.log(_NEXT)) * warmth)
    return np.column_stack(found)


def _smeared(law: Law, width_dps: float, laws: Laws) -> Floats:
    """A law as its mean over rates that scatter by a width, shape (n, q)."""
    away, weight = hermite_e.hermegauss(_NODES)
    rate_dps = laws.conditions.rate_dps
    moved = [replace(laws.conditions, rate_dps=rate_dps + width_dps * x) for x in away]
    at_each = [replace(laws, conditions=c).at(CATALOGUE[law.effect], law.shape) for c in moved]
    return np.average(at_each, axis=0, weights=weight)
