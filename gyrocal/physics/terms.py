"""Terms of a coefficient file as a robot evaluates them, and the inverse of a gyro that has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import CoefficientError, InputError
from gyrocal.physics.c_text import CMemory, Number
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.effect import ROBOT_CHANNELS, Effect, Floats
from gyrocal.physics.smooth import SmoothTerm, smooth_term
from gyrocal.physics.surface import Surface

#: Step of the rate for the slope of the terms, as a share of the rate scale: no corner of a law is within it, but by chance.
_SLOPE_STEP = 1e-8

#: A term's error in deg/s, and its memory for the next block, as functions of the true rate.
AtRate = Callable[[Floats], tuple[Floats, Memory]]


class Part(Protocol):
    """What the runtime needs of a term, named (`RuntimeTerm`) or not (`smooth.SmoothTerm`)."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def channels(self) -> frozenset[str]:
        """Fields of the conditions that it cannot do without."""
        ...

    @property
    def has_memory(self) -> bool:
        """Whether it depends on earlier samples."""
        ...

    @property
    def remembers_rates(self) -> bool:
        """Whether it depends on earlier rates."""
        ...

    @property
    def linked(self) -> bool:
        """Whether `rows` are rows of the joint covariance of surface and terms; else they are its own alone."""
        ...

    @property
    def rows(self) -> Floats:
        """Covariance of its k parameters, shape (k, k), or (k, m) where it is linked."""
        ...

    def c_laws(self, number: Number, memory: CMemory) -> tuple[list[str], tuple[str, ...]]:
        """C expressions that add up to its error (`c_text`), and the functions that they call."""
        ...

    def at(self, c: Conditions, surface: Surface, memory: Memory) -> AtRate:
        """The term under these conditions, of whose ``rate_dps`` it remembers what it has to."""
        ...

    def tangent(
        self, c: Conditions, surface: Surface, error_dps: Floats, memory: Memory
    ) -> tuple[Floats, Memory]:
        """Derivatives of its error by its k parameters, shape (n, k), and a memory of their own."""
        ...

    def by_surface(self, c: Conditions, surface: Surface, memory: Memory) -> Floats | float:
        """Derivative of its error by the coefficients of a surface that it acts through, shape (n, 12); 0: through none."""
        ...

    def beyond(self, c: Conditions, tangent: Floats) -> NDArray[np.bool_]:
        """Which samples lie outside what it was fitted to, shape (n,)."""
        ...


@dataclass(frozen=True)
class RuntimeTerm:
    """An effect, the values of its parameters, and how uncertain they are.

    Attributes
    ----------
    relative_sigma : float
        Standard deviation of the amplitude over the amplitude.
    covariance : mapping
        Parameter to its covariance with the twelve coefficients of the surface, and then with every parameter
        that has such an entry (terms in the order of the file, names sorted); empty where the file has none.
    seen_from_s : float
        Time since power-on at which the record began that showed it.
    """

    effect: Effect
    parameters: Mapping[str, float]
    relative_sigma: float
    covariance: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    seen_from_s: float = 0.0

    @property
    def name(self) -> str:
        """The effect's id."""
        return self.effect.id

    @property
    def channels(self) -> frozenset[str]:
        """What the effect needs."""
        return frozenset(self.effect.needs)

    @property
    def has_memory(self) -> bool:
        """Whether it depends on earlier samples."""
        return self.effect.has_memory

    @property
    def remembers_rates(self) -> bool:
        """Whether it depends on earlier rates, and on that of the moment through them alone."""
        return self.effect.has_memory and "rate_dps" in self.effect.needs

    @property
    def linked(self) -> bool:
        """Whether the file has its covariance with the surface."""
        return bool(self.covariance)

    @property
    def rows(self) -> Floats:
        """Of the parameters in `covariance`; without it, of the amplitude as a share of itself."""
        if not self.covariance:
            return np.array([[self.relative_sigma**2]])
        return np.array(list(self.covariance.values()))

    def c_laws(self, number: Number, memory: CMemory) -> tuple[list[str], tuple[str, ...]]:
        """The effect's C; CoefficientError where it has none."""
        c = self.effect.c_text
        if c is None:
            raise CoefficientError(
                f"The coefficients hold the term {self.name}, which cannot be written in C: the surface alone would "
                "be wrong. Use gyrocal.fusion.Compensator on the robot, or export the coefficients from before "
                "diagnose."
            )
        return [c.law(self.parameters, number, memory)], c.helpers

    def at(self, c: Conditions, surface: Surface, memory: Memory) -> AtRate:
        """The effect's law with these parameters."""
        if self.remembers_rates:
            solved = self.effect.error_dps(c, self.parameters, surface, memory)
            return lambda rate: solved
        return lambda rate: self.effect.error_dps(replace(c, rate_dps=rate), self.parameters, surface, memory)

    def tangent(
        self, c: Conditions, surface: Surface, error_dps: Floats, memory: Memory
    ) -> tuple[Floats, Memory]:
        """Exact for amplitudes, by a step of a thousandth for others, each of which remembers its own course."""
        if not self.covariance:
            return error_dps[:, None], None
        columns: list[Floats] = []
        after: list[Memory] = []
        for k, name in enumerate(self.covariance):
            value, course = self.parameters[name], memory[k] if memory else None
            if self.effect.parameter(name).linear and value != 0.0:
                columns.append(error_dps / value)
            else:
                step = 1e-3 * (abs(value) or 1.0)
                stepped = {**self.parameters, name: value + step}
                ahead, course = self.effect.error_dps(c, stepped, surface, course)
                columns.append((ahead - error_dps) / step)
            after.append(course)
        return np.column_stack(columns), after

    def by_surface(self, c: Conditions, surface: Surface, memory: Memory) -> Floats | float:
        """The effect's own."""
        law = self.effect.by_surface
        return 0.0 if law is None else law(c, self.parameters, surface, memory)

    def beyond(self, c: Conditions, tangent: Floats) -> NDArray[np.bool_]:
        """Before the record began that showed how it settles; else a law holds beyond, as far as the surface does."""
        if not self.seen_from_s:
            return np.zeros(len(tangent), dtype=np.bool_)
        return np.asarray(c.need("since_power_on_s") < self.seen_from_s)


@dataclass(frozen=True)
class Term:
    """Physics that `diagnose` added to the surface: an effect of the catalogue with its parameters.

    Attributes
    ----------
    parameters : mapping
        Each parameter's ``value``, ``std`` and ``unit``, and its ``covariance`` (as in `RuntimeTerm`) if known.
    runtime : bool
        Whether a robot takes it off.
    seen_from_s : float
        As of `RuntimeTerm`.
    """

    effect: str
    parameters: Mapping[str, Mapping[str, Any]]
    runtime: bool
    seen_from_s: float = 0.0

    @property
    def name(self) -> str:
        """The effect's id."""
        return self.effect

    def part(self) -> Part:
        """The term as a robot evaluates it; CoefficientError where it cannot (`runtime_term`)."""
        return replace(runtime_term(self.effect, self.parameters), seen_from_s=self.seen_from_s)

    def error_dps(self, c: Conditions, surface: Surface) -> Floats:
        """Its error over a whole record whose true rates are known, of the bench or not, shape (n,)."""
        effect = find_effect(self.effect)
        values = effect.typical() | {name: float(p["value"]) for name, p in self.parameters.items()}
        return effect.error_dps(c, values, surface, None)[0]

    def to_json(self) -> dict[str, Any]:
        """The entry of the coefficient file's ``terms``."""
        entry = {"effect": self.effect, "parameters": dict(self.parameters), "runtime": self.runtime}
        return entry | ({"seen_since_power_on_from_s": self.seen_from_s} if self.seen_from_s else {})


def read_term(entry: Mapping[str, Any]) -> Term | SmoothTerm:
    """An entry of the coefficient file's ``terms``; KeyError, TypeError or ValueError where it is none."""
    if entry["effect"] is None:
        return smooth_term(entry)
    seen_from_s = float(entry.get("seen_since_power_on_from_s", 0.0))
    return Term(entry["effect"], dict(entry["parameters"]), bool(entry["runtime"]), seen_from_s)


def runtime_term(effect_id: str, parameters: Mapping[str, Mapping[str, Any]]) -> RuntimeTerm:
    """A term (``value``, ``std``, ``unit`` of each parameter), checked against the catalogue.

    Raises
    ------
    CoefficientError
        An effect or parameter that this program does not know, a value without sense, another unit, or an
        effect that a robot cannot evaluate.
    """
    try:
        effect = find_effect(effect_id)
        values = effect.typical() | {name: _value(effect, name, entry) for name, entry in parameters.items()}
        sigma = float(parameters.get("amplitude", {}).get("std") or 0.0)
        covariance = {
            name: tuple(float(x) for x in parameters[name]["covariance"])
            for name in sorted(parameters)
            if "covariance" in parameters[name]
        }
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise CoefficientError(
            f"The coefficients' term {effect_id!r} cannot be evaluated ({error}). Update gyrocal or diagnose again."
        ) from error
    for name, entry in parameters.items():
        wanted = effect.parameter(name).unit
        if entry.get("unit", wanted) != wanted:
            raise CoefficientError(
                f"Term {effect_id}: {name} is in {entry['unit']!r}, and {wanted!r} is wanted. Diagnose again."
            )
    lacking = [channel for channel in effect.needs if channel not in ROBOT_CHANNELS]
    if lacking or not effect.runtime:
        reason = f"it needs {lacking[0]}" if lacking else "it belongs to the bench"
        raise CoefficientError(
            f"Term {effect_id} is marked runtime, and a robot cannot evaluate it: {reason}. Mark it runtime: false."
        )
    amplitude = abs(values["amplitude"])
    return RuntimeTerm(effect, values, sigma / amplitude if amplitude else 0.0, covariance)


def _value(effect: Effect, name: str, entry: Mapping[str, Any]) -> float:
    """An estimate may lie outside what is usual; it must only be a number with which the law makes sense."""
    value = float(entry["value"])
    if not isfinite(value) or (effect.parameter(name).low > 0 >= value):
        raise ValueError(f"{name} is {value:g}")
    return value


@dataclass(frozen=True)
class Solution:
    """The rate that gave an output; arrays of shape (n,), NaN where nothing solves it.

    Attributes
    ----------
    rate_dps : true rate
    own_dps : the surface's own rate (by its direction)
    errors_dps : each term's error
    memories : what each term hands to the next block
    """

    rate_dps: Floats
    own_dps: Floats
    errors_dps: list[Floats]
    memories: list[Memory]


def solve_rate(
    surface: Surface, terms: Sequence[Part], memories: Sequence[Memory], gyro_dps: Floats, c: Conditions
) -> Solution:
    """Rate w that gave the output `gyro_dps`: ``g = g0 + sum e(w, T, ...)``, g0 the output by the surface alone.

    Parameters
    ----------
    memories : what the call before returned; None for each term at the start
    c : Conditions, whose ``rate_dps`` is the output: terms that remember rates take what the surface alone makes of it
    """
    c = _as_remembered(surface, terms, c)
    at = [term.at(c, surface, memory) for term, memory in zip(terms, memories, strict=True)]

    def miss_dps(own: Floats) -> Floats:
        rate, output = surface.rate_and_output_dps(own, c.temp_c)
        return np.asarray(output + sum(term(rate)[0] for term in at) - gyro_dps)

    with np.errstate(over="ignore", invalid="ignore"):  # a wild sample overflows to NaN, alone
        explicit = surface.direction == "output" and not terms
        own = gyro_dps if explicit else surface.solve_own_dps(gyro_dps, miss_dps)
        rate, _ = surface.rate_and_output_dps(own, c.temp_c)
        last = [term(rate) for term in at]
    return Solution(rate, own, [error for error, _ in last], [memory for _, memory in last])


def _as_remembered(surface: Surface, terms: Sequence[Part], c: Conditions) -> Conditions:
    """Conditions with rates by the surface alone in place of the output, where a term remembers rates: terms change them by little."""
    if not any(term.remembers_rates for term in terms):
        return c
    return replace(c, rate_dps=surface.near_rate_dps(c.rate_dps, c.temp_c))


def joint_covariance(surface_covariance: Floats, terms: Sequence[Part]) -> Floats:
    """Covariance of the coefficients of the surface and of all parameters of the terms, in this order.

    Raises
    ------
    CoefficientError
        The rows of the terms that are linked differ in length.
    """
    first = surface_covariance.shape[0]
    ends = first + np.cumsum([len(term.rows) for term in terms], dtype=int)
    places = [np.arange(end - len(term.rows), end) for end, term in zip(ends, terms, strict=True)]
    own = [place for place, term in zip(places, terms, strict=True) if term.linked]
    shared = np.concatenate([np.arange(first), *own])
    joint = np.zeros((int(ends[-1]) if terms else first,) * 2)
    joint[:first, :first] = surface_covariance
    for term, place in zip(terms, places, strict=True):
        if term.linked and term.rows.shape[1] != shared.size:
            raise CoefficientError(
                f"A term's covariance has not the {shared.size} numbers of surface and terms. Diagnose again."
            )
        across = shared if term.linked else place
        joint[np.ix_(place, across)] = term.rows
        joint[np.ix_(across, place)] = term.rows.T
    return joint


def sensitivity(
    surface: Surface,
    terms: Sequence[Part],
    tangents: Sequence[Floats],
    solved: Solution,
    c: Conditions,
    at: Sequence[Memory],
) -> Floats:
    """Derivatives of the solved rate by the coefficients of the surface and the parameters of the terms.

    From ``g = g0(x) + e(w(x))`` at a fixed output. Shape (n, 12 + m).

    Parameters
    ----------
    c, at : the conditions and the memories with which the block was solved
    """
    there = replace(c, rate_dps=solved.rate_dps)
    c = _as_remembered(surface, terms, c)
    slope = surface.slope_per_dps(solved.own_dps, c.temp_c)
    step = _SLOPE_STEP * surface.rate_scale_dps
    each = list(zip(terms, at, strict=True))
    ahead = [term.at(c, surface, memory)(solved.rate_dps + step)[0] for term, memory in each]
    terms_slope = (sum(ahead) - sum(solved.errors_dps)) / step
    design = surface.design(solved.own_dps, c.temp_c)
    through = sum((term.by_surface(there, surface, memory) for term, memory in each), np.zeros_like(design))
    shares = np.column_stack([np.empty((len(c), 0)), *tangents])
    if surface.direction == "input":
        whole = 1.0 + slope + terms_slope
    else:
        whole = 1.0 + terms_slope * (1.0 - slope)
        through, shares = (1.0 - slope)[:, None] * through, (1.0 - slope)[:, None] * shares
    return np.asarray(-np.column_stack([design + through, shares]) / whole[:, None])
