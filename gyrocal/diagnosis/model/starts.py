"""Fits of the whole model: from where they start, which components tell of what, and what of it is alive."""

from __future__ import annotations

from gyrocal.diagnosis.model.layers import Fitted, Model, fit_model
from gyrocal.diagnosis.model.parts import EACH_RATE, PASSING
from gyrocal.inference.additive import Component

#: Where variances start that are to be tried last.
_LOW_START = -9.0


def draws_of(full: Model) -> Component | None:
    """The component of an error of each rate, where the record has rates enough."""
    return next((c for n, c in full.components.items() if PASSING.get(n) == EACH_RATE), None)


def wandering(full: Model) -> list[Component]:
    """What passes and is random in time: the bias and the scale factor, and noise."""
    stays = {p.name for p in full.parts}
    return [c for n, c in full.components.items() if n not in stays and PASSING.get(n) != EACH_RATE]


def fit_anyhow(model: Model) -> Fitted:
    """The best of three fits: from equal shares, from what passes, and from what stays.

    A scale factor that wanders and one that remembers the temperature follow each other, and whichever came first stays.
    """
    staying = {p.name: _LOW_START for p in model.parts if p.block != "surface"}
    passing = {n: _LOW_START for n, b in PASSING.items() if b != EACH_RATE}
    return min((fit_model(model, start) for start in (None, staying, passing)), key=lambda f: f.nll)


def alive(fitted: Fitted) -> Fitted:
    """The same less what has died."""
    return Fitted(fitted.model.alive(fitted.fit), fitted.fit, fitted.contrasts)
