"""How a blind trial hides an effect: what it draws its parameters from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gyrocal.physics.offer import Offer


class Draw(Protocol):
    """All parameters of an effect at random for a record, from their usual values; the size of its amplitude comes later."""

    def __call__(
        self, usual: Mapping[str, float], offer: Offer, rng: np.random.Generator, /
    ) -> dict[str, float]: ...


#: What a parameter is drawn from by its name: its usual value, what the record offers, random numbers.
_BY_NAME: Mapping[str, Callable[[float, Offer, np.random.Generator], float]] = {
    "tau_s": lambda usual, offer, rng: usual * float(np.exp(rng.uniform(-0.6, 0.6))),
    "width_c": lambda usual, offer, rng: usual * float(np.exp(rng.uniform(-0.5, 0.5))),
    "phase_rad": lambda usual, offer, rng: float(rng.uniform(-np.pi, np.pi)),
    "phase_rad_per_dps": lambda usual, offer, rng: float(rng.uniform(0.3, 0.8)) / float(offer.sizes_dps[-1]),
    "at_s": lambda usual, offer, rng: float(offer.t_s[0] + rng.uniform(0.25, 0.75) * offer.span_s),
    "harmonic": lambda usual, offer, rng: float(rng.integers(1, 3)),
    "knee_dps": lambda usual, offer, rng: float(rng.uniform(0.55, 0.85)) * float(offer.sizes_dps[-1]),
    "center_dps": lambda usual, offer, rng: float(rng.choice(_between(offer))),
    "seed": lambda usual, offer, rng: float(rng.integers(1, 2**31)),
}


def _between(offer: Offer) -> list[float]:
    """Sizes of rate between rest and the largest."""
    return [size for size in offer.sizes_dps.tolist() if 0 < size < offer.sizes_dps[-1]]


def usual_draw(usual: Mapping[str, float], offer: Offer, rng: np.random.Generator) -> dict[str, float]:
    """Each parameter by its name; one that says nothing by it has its usual value."""
    return {
        name: _BY_NAME[name](value, offer, rng) if name in _BY_NAME else value
        for name, value in usual.items()
    }


@dataclass(frozen=True)
class Hiding:
    """How a blind trial hides an effect.

    Attributes
    ----------
    draw : Draw
    free_size : bool
        Whether a strength is drawn for it; otherwise its size is what it is.
    own_zero : bool
        Whether the finder counts its amplitude from where the trial does, so that the two can be compared.
    always_there : bool
        Whether every virtual run has it, so that to name it is no false alarm.
    """

    draw: Draw = usual_draw
    free_size: bool = True
    own_zero: bool = True
    always_there: bool = False
