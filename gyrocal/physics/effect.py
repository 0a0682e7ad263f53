"""What an effect is: one small object that the bench injects, `diagnose` proposes and the runtime compensates.

How effects and surface compose, everywhere in gyrocal: effects add to the output of a gyro that has the surface
alone, ``g = g0 + sum e(w, T, ...)`` with ``g0 - S(g0, T) = w``. So the surface is a function of ``g - e``, and
``w = (g - e) - S(g - e, T)``. The difference to ``S(g, T)`` is the effect times the slope of the surface, about
one percent of the effect, and matters for the strong ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError, InputError
from gyrocal.physics.c_text import CText, Number
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.fold import BY_COORDINATE, Fold, FoldAxis
from gyrocal.physics.hiding import Hiding
from gyrocal.physics.lacking import Lack, Reason, Why
from gyrocal.physics.offer import Offer
from gyrocal.physics.search import Search, Shape
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: The families of physics.md: the level of naming that is almost always right.
FAMILIES = (
    "thermal transient",
    "time",
    "rate shape",
    "temperature shape",
    "angle, constant",
    "angle, with rate",
    "step",
    "supply",
    "sampling",
)

#: Step of a coefficient of the surface by which a law is seen to go with it: of a thousandth of what a surface has.
_COEFFICIENT_STEP_DPS = 1e-5


#: Channels of `Conditions` that a robot has.
ROBOT_CHANNELS = frozenset({"t_s", "rate_dps", "temp_c", "since_power_on_s", "supply_v"})


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: unit, physical bounds, and the size that is usual for an RD2100-class gyro.

    `linear`: the error is proportional to it. The linear strength is always called ``amplitude``.
    `choice`: another value may describe the same error, so that no interval is held against a known one.
    `whole`: it is a whole number.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float
    linear: bool
    meaning: str
    choice: bool = False
    whole: bool = False


class Response(Protocol):
    """The law of an effect over one block of samples.

    Blocks follow each other in time; feeding a record in any split gives the same numbers as feeding it whole.
    """

    def __call__(
        self, c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
    ) -> tuple[Floats, Memory]: ...


class BySurface(Protocol):
    """Derivatives of an effect that acts through the surface by the surface's coefficients, shape (n, 12)."""

    def __call__(self, c: Conditions, p: Mapping[str, float], surface: Surface, memory: Memory) -> Floats: ...


#: A law without memory.
Law = Callable[[Conditions, Mapping[str, float], Surface | None], Floats]


def by_differences(law: Law) -> BySurface:
    """The derivatives of a law without memory, by a step of each coefficient."""

    def derivatives(c: Conditions, p: Mapping[str, float], surface: Surface, memory: Memory) -> Floats:
        first, found = law(c, p, surface), []
        for k in range(surface.coefficients_dps.size):
            moved = surface.coefficients_dps.copy()
            moved.ravel()[k] += _COEFFICIENT_STEP_DPS
            found.append(
                (law(c, p, replace(surface, coefficients_dps=moved)) - first) / _COEFFICIENT_STEP_DPS
            )
        return np.column_stack(found)

    return derivatives


def memoryless(law: Law) -> Response:
    """The response of a law that looks at each sample alone."""

    def response(
        c: Conditions, p: Mapping[str, float], surface: Surface | None, memory: Memory
    ) -> tuple[Floats, Memory]:
        return law(c, p, surface), None

    return response


def need_surface(surface: Surface | None, effect: str) -> Surface:
    """The surface, for an effect that acts through it."""
    if surface is None:
        raise DataError(f"{effect} acts through the error surface, and none was given. Fit one first.")
    return surface


@dataclass(frozen=True)
class Described:
    """What is said of every effect, on the bench or on the robot.

    Attributes
    ----------
    id : str
        Its name in every file.
    equation, statement, reference : str
        The law; what it is, in one plain sentence for a user; where it is written.
    needs : tuple of str
        Channels (fields of the conditions) without which it cannot be seen.
    seen_in : str
        Coordinate of formats.md where its residual has structure.
    looks_like : tuple of str
        Ids that the same data may not tell apart.
    runtime : bool
        Whether a robot can evaluate it (from gyro, temperature and its history, time since power-on, supply).
    """

    id: str
    family: str
    equation: str
    statement: str
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...]
    seen_in: str
    looks_like: tuple[str, ...]
    reference: str
    runtime: bool

    def typical(self) -> dict[str, float]:
        """The usual size of each parameter."""
        return {p.name: p.typical for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """The parameter called `name`."""
        for p in self.parameters:
            if p.name == name:
                return p
        known = ", ".join(p.name for p in self.parameters)
        raise InputError(f"Effect {self.id} has no parameter {name!r}; it has {known}.")

    def complete(self, given: Mapping[str, float]) -> dict[str, float]:
        """All parameters: those given, checked, and the usual size of the rest.

        Raises
        ------
        InputError
            An unknown name, or a value that is not finite or outside its physical bounds.
        """
        for name, value in given.items():
            p = self.parameter(name)
            if not p.low <= value <= p.high:
                msg = f"Effect {self.id}: {name} is {value:g} {p.unit}; allowed is {p.low:g} to {p.high:g}."
                raise InputError(msg)
            if p.whole and value != round(value):
                raise InputError(f"Effect {self.id}: {name} is {value:g}; a whole number is wanted.")
        return self.typical() | {name: float(value) for name, value in given.items()}


@dataclass(frozen=True)
class Effect(Described):
    """An effect on the bench: all that is known of it.

    Attributes
    ----------
    error_dps : Response
        ``(error in deg/s, memory)`` of a block; `memory` None at the start.
    has_memory : bool
        Whether the error depends on earlier samples.
    acts_on : str
        What it changes: the gyro's own output; the reference, whose servo follows its encoder, so that the true
        rate bears the error; or the converter, which comes last and takes the place of the unit's own bits.
    search : Search
        How `diagnose` looks for it.
    hiding : Hiding
        How a blind trial draws it.
    fold : Fold, optional
        The coordinate on which its residual is folded; by `seen_in` where it has none of its own.
    c_text : CText, optional
        Its law as C; None: there is none.
    by_surface : BySurface, optional
        How it goes with the surface that it acts through.
    """

    error_dps: Response = field(repr=False)
    has_memory: bool = False
    acts_on: Literal["gyro", "reference", "converter"] = "gyro"
    search: Search = field(default_factory=Search, repr=False)
    hiding: Hiding = field(default_factory=Hiding, repr=False)
    fold: Fold | None = field(default=None, repr=False)
    c_text: CText | None = field(default=None, repr=False)
    by_surface: BySurface | None = field(default=None, repr=False)

    def positive(self, shape: Shape) -> bool:
        """Whether the amplitude is positive by its nature."""
        return self.parameter("amplitude").low >= 0.0 or self.search.one_sign(shape)

    def unit_dps(self, c: Conditions, shape: Shape, surface: Surface | None) -> Floats:
        """Its error at unit amplitude, shape (n,), deg/s; what `shape` does not say has its usual size."""
        return self.error_dps(c, {**self.typical(), **shape, "amplitude": 1.0}, surface, None)[0]

    def columns(self, c: Conditions, shape: Shape, surface: Surface | None) -> Floats:
        """Columns at unit amplitude in which it is linear, shape (n, k), deg/s."""
        return self.search.columns(self.unit_dps, c, shape, surface)

    def why_not(self, offer: Offer) -> Reason | None:
        """Why a record cannot show it; None if it can."""
        reasons = (offer.why_unseen(self.seen_in), *(need(offer) for need in self.search.requires))
        lacking = (
            Lack(Why.NO_CHANNEL, {"channel": need}) for need in self.needs if need not in offer.channels
        )
        return next((reason for reason in (*reasons, *lacking) if reason is not None), None)

    def fold_axis(self, c: Conditions, p: Mapping[str, float], error_dps: Floats) -> FoldAxis:
        """Where rows lie on its coordinate, given its parameters and what it adds to them, shape (n,), deg/s."""
        return (self.fold or BY_COORDINATE[self.seen_in])(c, p, error_dps)


def amplitude(
    unit: str, bound: float, typical: float, meaning: str, *, linear: bool = True, positive: bool = False
) -> Parameter:
    """The strength of an effect, of either sign unless it is positive by its nature."""
    return Parameter("amplitude", unit, 0.0 if positive else -bound, bound, typical, linear, meaning)


def shape(name: str, unit: str, low: float, high: float, typical: float, meaning: str) -> Parameter:
    """A parameter in which the error is not linear."""
    return Parameter(name, unit, low, high, typical, False, meaning)


def choice(name: str, unit: str, low: float, high: float, typical: float, meaning: str) -> Parameter:
    """A parameter of shape of which another value may describe the same error: a phase, an order, a draw."""
    return Parameter(name, unit, low, high, typical, False, meaning, choice=True)


def count(name: str, low: float, high: float, typical: float, meaning: str) -> Parameter:
    """A choice of a whole number."""
    return Parameter(name, "1", low, high, typical, False, meaning, choice=True, whole=True)


#: Rate at which the amplitude of an effect on the scale factor is what it adds, deg/s.
SCALED_AT_DPS = 100.0


def of_scale() -> Parameter:
    """What an effect of the bias has that the scale factor may show as well."""
    return count("of_scale", 0.0, 1.0, 0.0, "1: it acts on the scale factor, at 100 deg/s by its amplitude")


def where_it_acts(c: Conditions, p: Mapping[str, float], error_dps: Floats) -> Floats:
    """An error of the bias, or of the scale factor instead (`of_scale`)."""
    return error_dps * (c.rate_dps / SCALED_AT_DPS) if p["of_scale"] else error_dps


def where_it_acts_c(p: Mapping[str, float], n: Number, error: str) -> str:
    """The same as C."""
    return f"{error} * (w / {n(SCALED_AT_DPS)})" if p["of_scale"] else error
