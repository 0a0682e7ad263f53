"""What a law leaves where a gyro obeys it only nearly.

It changes with temperature; the corners of one of the rate are round; what acts on the bias acts on the scale factor too.
None of this has a name of its own. It tells how far a law goes that nobody has written down exactly, so that what it
leaves is neither held against it nor taken for a second effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import hermite_e
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import RATE_ORDER
from gyrocal.physics.timewise import BIAS_DRIFT

Floats = NDArray[np.float64]

#: How far a law may be smeared over the rate: standard deviations as shares of the largest rate.
_SMEARED = (0.02, 0.05, 0.1, 0.2)
#: Rates that a smeared law is the mean of.
_NODES = 9
#: A law worth less beside the misfits of the others only mends these, nats. Of 110 laws with a name on 98 recordings, and of
#: laws of their tables' searches, three were worth 0.0 to 3.7 there, none of which was there; alone they had seemed worth 12 to 72.
_MENDING = 4.0
#: Ratio of a shape to one next to it, by which it is known what a change of the shape does.
_NEXT = 1.05


def changing(fitted: Fitted, own: Sequence[Law], laws: Laws) -> Fitted:
    """The model whose laws of the rate among some may change with temperature, in size and in shape: each is the same law."""
    return _beside(fitted, {law.name: _by_temperature(law, fitted, laws) for law in own if _of_rate(law)})


def with_misfit(fitted: Fitted, own: Sequence[Law], laws: Laws) -> Fitted:
    """The model whose laws among some may hold only nearly: what is left of this is no misfit of theirs."""
    return _beside(fitted, {law.name: _misfit(law, fitted, laws) for law in own})


def without_mending(fitted: Fitted, held: Mapping[str, Sequence[str]], laws: Laws) -> Fitted:
    """The model less the laws that only mend what others leave which nearly hold.

    Of several the first to go is the one without which the others do best.

    Parameters
    ----------
    held : names of the laws in question, each with the components that stand for the same
    """
    while True:
        left: dict[str, float] = {}
        for law in fitted.model.laws:
            if law.name in held and any(other.effect != law.effect for other in fitted.model.laws):
                own = held[law.name]
                alone = fitted.refit(fitted.model.without(own)) if own else fitted
                says, nll = _beyond_others(alone, law, laws)
                left |= {law.name: nll} if says < _MENDING else {}
        if not left:
            return fitted
        fitted = fitted.refit(fitted.model.without_laws([min(left, key=left.__getitem__)]))


def _beyond_others(fitted: Fitted, law: Law, laws: Laws) -> tuple[float, float]:
    """What a law explains beyond what those of other effects would if they nearly held, and what these leave, nats."""
    others = [other for other in fitted.model.laws if other.effect != law.effect]
    nearly = with_misfit(fitted, others, laws)
    without = nearly.model.without_laws([law.name])
    # Misfits that died beside the law do not come back by themselves.
    nll = min(start.refit(without).nll for start in (fitted, nearly))
    return nll - nearly.nll, nll


def _of_rate(law: Law) -> bool:
    return CATALOGUE[law.effect].family == RATE_ORDER.family


def _beside(fitted: Fitted, misfits: Mapping[str, Floats]) -> Fitted:
    if not misfits:
        return fitted
    more = [Component(f"misfit of {n}", columns) for n, columns in misfits.items()]
    return fitted.refit(fitted.model.with_components(*more))


def _misfit(law: Law, fitted: Fitted, laws: Laws) -> Floats:
    """What a law gains where it holds only nearly, shape (n, q)."""
    effect, model = CATALOGUE[law.effect], fitted.model
    scale_dps = model.basis.frame.rate_scale_dps
    if _of_rate(law):
        round_off = [_smeared(law, share * scale_dps, laws) - law.columns for share in _SMEARED]
        return np.column_stack([_by_temperature(law, fitted, laws), *round_off])
    found = [law.columns * _warmth(fitted)]
    # A step or drift of the scale factor has a name of its own.
    if not law.goes_by_rate and (effect.family != BIAS_DRIFT.family or effect.runtime):
        found.append(law.columns * (model.means.rate_dps / scale_dps)[:, None])
    return np.column_stack(found)


def _warmth(fitted: Fitted) -> Floats:
    frame = fitted.model.basis.frame
    return ((fitted.model.means.temp_c - frame.temp_center_c) / frame.temp_scale_c)[:, None]


def _by_temperature(law: Law, fitted: Fitted, laws: Laws) -> Floats:
    """What a law of the rate gains where its size and its shape follow the temperature, shape (n, q)."""
    effect, warmth = CATALOGUE[law.effect], _warmth(fitted)
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
