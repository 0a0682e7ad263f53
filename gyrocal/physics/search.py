"""How `diagnose` looks for an effect: shapes to try, columns to regress on, what it needs and what it is mistaken for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.offer import Offer, Requirement
from gyrocal.physics.surface import Surface
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: Values of the parameters that shape an effect; the amplitude is not among them.
Shape = Mapping[str, float]
#: Shapes to try with a record that offers so much; none where it can show none of them.
Grid = Callable[[Offer], Sequence[Shape]]


#: An effect at unit amplitude for a shape, through a surface, shape (n,), deg/s.
Unit = Callable[[Conditions, Shape, Surface | None], Floats]


class Columns(Protocol):
    """Columns in which an effect of a given shape is linear, at unit amplitude, shape (n, k), deg/s."""

    def __call__(self, unit_dps: Unit, c: Conditions, shape: Shape, surface: Surface | None, /) -> Floats: ...


def one_column(unit_dps: Unit, c: Conditions, shape: Shape, surface: Surface | None) -> Floats:
    """The law itself."""
    return unit_dps(c, shape, surface)[:, None]


def with_phase(unit_dps: Unit, c: Conditions, shape: Shape, surface: Surface | None) -> Floats:
    """Cosine and sine of a law with a phase: amplitude and phase become linear."""
    return np.column_stack(
        [unit_dps(c, {**shape, "phase_rad": phase}, surface) for phase in (0.0, -np.pi / 2)]
    )


def no_shape(offer: Offer) -> list[dict[str, float]]:
    """The grid of a law that has an amplitude and nothing else."""
    return [{}]


def of_either_sign(shape: Shape) -> bool:
    """No shape has a sign that the bounds of the amplitude do not have."""
    return False


def scales(low: float, high: float, count: int) -> Grid:
    """Time constants from `low` to `high` seconds, evenly in the logarithm, below the length of the record."""

    def grid(offer: Offer) -> list[dict[str, float]]:
        return [{"tau_s": float(x)} for x in np.geomspace(low, high, count) if x < offer.span_s]

    return grid


@dataclass(frozen=True)
class Search:
    """How an effect is looked for.

    Attributes
    ----------
    grid : Grid
        Shapes that are tried.
    columns : Columns
        What is regressed on at a shape.
    refined : tuple of str
        Parameters of shape that are refined between the points of the grid; the others are what the grid says.
    bounded : tuple of str
        Of these, those that stay within what the grid spans: beyond it the law becomes another.
    requires : tuple of Requirement
        Needs beyond the channels and the coordinate in which the effect is seen.
    twin_of : str
        The effect of exactly the same law that is looked for in its stead; empty: none.
    limit_of : str
        The effect whose law becomes this one at an end of its shape: both together are one mechanism; empty: none.
    told_apart : mapping
        Another effect to what a hand must do to tell the two apart, where no profile can.
    prior_nats : float
        Evidence it starts with. What claims no mechanism starts below a law.
    usual : mapping
        Parameter of its shape to the ends between which 95 % of what is built lie; its logarithm is taken for normal.
    rare : mapping
        Parameter of its shape to the evidence, nats, that it loses where that is not zero.
    natural : tuple of float, optional
        The amplitude that physics leads one to expect, and the standard deviation of its logarithm about that: without it
        a shape that does next to nothing beyond the surface may have any amplitude.
    one_sign : callable
        Whether the amplitude at a shape is positive by its nature, where it is not at all of them.
    draws : bool
        The amplitudes of its columns are independent draws of one size, not parameters each.
    by_columns : bool
        Whether it is found by its columns; otherwise a test of its own on the samples finds it.
    scatters : bool
        Whether it widens the scatter of the rows as well as their mean.
    adds_up : bool
        Several of it, of different shapes, are one effect.
    in_part : bool
        A robot undoes it only in part: while names are looked for the smooth parts stay in the model that stand for it.
    accounts_for : tuple of str
        Effects that need not be named beside it: they are a part of it.
    """

    grid: Grid = no_shape
    columns: Columns = one_column
    refined: tuple[str, ...] = ()
    bounded: tuple[str, ...] = ()
    requires: tuple[Requirement, ...] = ()
    twin_of: str = ""
    limit_of: str = ""
    told_apart: Mapping[str, str] = field(default_factory=dict)
    prior_nats: float = 0.0
    usual: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rare: Mapping[str, float] = field(default_factory=dict)
    natural: tuple[float, float] | None = None
    one_sign: Callable[[Shape], bool] = of_either_sign
    draws: bool = False
    by_columns: bool = True
    scatters: bool = False
    adds_up: bool = False
    in_part: bool = False
    accounts_for: tuple[str, ...] = ()

    def most(self, name: str, offer: Offer) -> float:
        """The largest value that a parameter of shape has on the grid."""
        return max(shape[name] for shape in self.grid(offer))

    def nats_before(self, given: Shape) -> float:
        """Evidence that it starts with at some shape: less for one that is unusual."""
        lost = 0.0
        for name, ends in self.usual.items():
            low, high = np.log(ends)
            off = (np.log(given[name]) - 0.5 * (low + high)) / ((high - low) / (2.0 * NORMAL_95))
            lost += 0.5 * float(off**2)
        lost += sum(nats for name, nats in self.rare.items() if given.get(name, 0.0) != 0.0)
        return self.prior_nats - lost
