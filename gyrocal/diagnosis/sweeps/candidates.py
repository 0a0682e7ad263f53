"""Models of a table that a search has fitted: the best of each kind, and those that a file is the mean of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from gyrocal.diagnosis.model.layers import Fitted
from gyrocal.diagnosis.model.parts import Coil
from gyrocal.diagnosis.sweeps.changes import Change
from gyrocal.physics.timewise import WARM_UP

#: Models within this of the best one are averaged.
AVERAGED_NATS = 4.0


@dataclass(frozen=True)
class Candidate:
    """A model of a table.

    Attributes
    ----------
    score : float
        Its negative log evidence with what its laws pay, nats.
    stands_for : float
        Logarithm of how many models as likely it stands for in a mean, nats.
    """

    coil: Coil
    changes: tuple[Change, ...]
    fitted: Fitted
    score: float
    stands_for: float = 0.0

    @property
    def effects(self) -> set[str]:
        """Its laws beside the coil's lag."""
        return {change.effect for change in self.changes}

    @property
    def kinds(self) -> tuple[bool, frozenset[str]]:
        """Its laws, whatever their shapes, with a coil's lag or without."""
        return self.coil is None, frozenset(self.effects)

    def without(self, dead: Sequence[str]) -> Candidate:
        """The same less components that add nothing to it."""
        return replace(self, fitted=replace(self.fitted, model=self.fitted.model.without(dead)))

    @property
    def warms_up(self) -> bool:
        """Whether a warm-up is among its laws of time."""
        return WARM_UP.id in self.effects

    @property
    def is_open_loop(self) -> bool:
        """Whether the sine of an open loop is in its output."""
        return self.fitted.model.open_loop is not None


def best_of_each(ranked: Sequence[Candidate]) -> list[Candidate]:
    """The best of each set of laws, with a coil's lag or without."""
    found: dict[object, Candidate] = {}
    for c in ranked:
        found.setdefault(c.kinds, c)
    return [*found.values()]


def standing_for_all(derived: Sequence[Candidate], ranked: Sequence[Candidate]) -> list[Candidate]:
    """Models that were made of the best of each kind alone, as one for every shape that it has in a search.

    Else what a search has at many shapes outweighs in the mean what is likelier at each of them.
    """
    shapes: dict[object, list[float]] = {}
    for c in ranked:
        shapes.setdefault(c.kinds, []).append(c.score)
    count = {kinds: float(np.logaddexp.reduce(min(own) - np.array(own))) for kinds, own in shapes.items()}
    return [replace(c, stands_for=count.get(c.kinds, 0.0)) for c in derived]


def sine_nats(candidates: Sequence[Candidate]) -> float:
    """How much likelier models with the sine of an open loop are together than those without; 0 where either are none."""
    with_it = np.array([c.is_open_loop for c in candidates], dtype=np.bool_)
    nats = np.array([c.stands_for - c.score for c in candidates])
    if with_it.all() or not with_it.any():
        return 0.0
    return float(np.logaddexp.reduce(nats[with_it]) - np.logaddexp.reduce(nats[~with_it]))


def averaged(candidates: Sequence[Candidate]) -> list[tuple[float, Candidate]]:
    """The models worth averaging over, with their weights.

    With a warm-up or without, as most of the weight is: a robot that need not know when it was switched on shall not
    have to. With the sine of an open loop or without: a phase has no mean with none.
    """
    least = min(c.score - c.stands_for for c in candidates)
    near = [c for c in candidates if c.score - c.stands_for < least + AVERAGED_NATS]
    weight = np.exp([least + c.stands_for - c.score for c in near])
    for has in (attrgetter("warms_up"), attrgetter("is_open_loop")):
        with_it = np.array([has(c) for c in near], dtype=np.bool_)
        kept = np.flatnonzero(with_it == (weight @ with_it > 0.5 * weight.sum()))
        near, weight = [near[k] for k in kept], weight[kept]
    return [*zip((weight / weight.sum()).tolist(), near, strict=True)]
