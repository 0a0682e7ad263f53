"""What a law of the rate does between the rates of a plan, which nobody knows: over all shapes that it may have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.laws.estimates import likely_shapes, moved
from gyrocal.diagnosis.model.layers import Fitted
from gyrocal.physics.rate import MECHANICAL_RESONANCE, SATURATION

#: Laws of which a few rates leave open what they do between them.
_BETWEEN_RATES = (MECHANICAL_RESONANCE.id, SATURATION.id)
#: So many models stand for all: their mean is off by less than a twentieth of what the models scatter by.
_STAND_FOR_ALL = 400

Weighted = tuple[float, Fitted]


def over_shapes(near: Sequence[Weighted], laws: Laws) -> list[Weighted]:
    """Models with their weights, each with the shapes that its laws of the rate may have in place of one."""
    found = [*near]
    for effect in _BETWEEN_RATES:
        found = _over_shapes_of(found, effect, laws)
    return sampled(found, _STAND_FOR_ALL)


def _over_shapes_of(near: Sequence[Weighted], effect: str, laws: Laws) -> list[Weighted]:
    own = [next((x for x in f.model.laws if x.effect == effect), None) for _, f in near]
    first = next(((f, law) for (_, f), law in zip(near, own, strict=True) if law is not None), None)
    if first is None:
        return [*near]
    shapes = likely_shapes(*first, laws)
    found: list[Weighted] = []
    for (weight, fitted), law in zip(near, own, strict=True):
        if law is None:
            found.append((weight, fitted))
        elif fitted is first[0]:
            found += [(weight * share, model) for share, _, model in shapes]
        else:
            found += [(weight * share, moved(fitted, law, shape, laws)) for share, shape, _ in shapes]
    return found


def sampled(near: Sequence[Weighted], most: int) -> list[Weighted]:
    """A systematic sample of models, each with the weight that it stands for; all of them where they are no more than `most`."""
    if len(near) <= most:
        return [*near]
    reach = np.cumsum([weight for weight, _ in near])
    drawn = np.searchsorted(reach, reach[-1] * (np.arange(most) + 0.5) / most)
    which, times = np.unique(drawn, return_counts=True)
    return [(float(reach[-1] * n / most), near[k][1]) for k, n in zip(which, times, strict=True)]
