"""Terms of a coefficient file as effects that a robot evaluates, and the inverse of a gyro that has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np

from gyrocal.errors import CoefficientError, InputError
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.effect import Conditions, Effect, Floats, Memory
from gyrocal.physics.surface import Surface

#: The rate at which effects are evaluated is solved to this, deg/s, in at most so many rounds.
_TOLERANCE_DPS = 1e-11
_ROUNDS = 60

#: Channels of `Conditions` that a robot has.
ROBOT_CHANNELS = frozenset({"t_s", "rate_dps", "temp_c", "since_power_on_s"})


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
    """

    effect: Effect
    parameters: Mapping[str, float]
    relative_sigma: float
    covariance: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


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


def solve_rate(
    surface: Surface,
    terms: Sequence[RuntimeTerm],
    memories: Sequence[Memory],
    gyro_dps: Floats,
    c: Conditions,
) -> tuple[Floats, list[Floats], list[Memory]]:
    """Rate that gave the output `gyro_dps`: ``w = (g - e) - S(g - e, T)`` with ``e = sum e(w, T, ...)``.

    Solved by iteration, each sample for itself: who has converged stays as he is, so that neighbours in a
    block cannot change him.

    Parameters
    ----------
    memories : what the call before returned; None for each term at the start
    c : Conditions, whose ``rate_dps`` is not read

    Returns
    -------
    rate_dps : ndarray, shape (n,); NaN where nothing solves it
    errors_dps : a list with each term's share, shape (n,)
    memories : for the next block
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a wild sample diverges to NaN, alone
        rate = gyro_dps - surface.error_dps(gyro_dps, c.temp_c)
        if not terms:
            return rate, [], []
        errors, after = [np.zeros(rate.shape) for _ in terms], list(memories)
        moving = np.ones(rate.shape, dtype=bool)
        for _ in range(_ROUNDS):
            now = replace(c, rate_dps=rate)
            new = [
                t.effect.error_dps(now, t.parameters, surface, m)
                for t, m in zip(terms, memories, strict=True)
            ]
            errors = [np.where(moving, e, old) for (e, _), old in zip(new, errors, strict=True)]
            after = [memory for _, memory in new]
            alone = gyro_dps - np.sum(errors, axis=0)
            before, rate = rate, np.where(moving, alone - surface.error_dps(alone, c.temp_c), rate)
            moving &= np.abs(rate - before) > _TOLERANCE_DPS
            if not moving.any():
                break
    return np.where(moving, np.nan, rate), errors, after


def joint_covariance(surface_covariance: Floats, terms: Sequence[RuntimeTerm]) -> Floats:
    """Covariance of the coefficients of the surface and of all parameters that have one, in this order.

    Raises
    ------
    CoefficientError
        The entries differ in length.
    """
    rows = [row for term in terms for row in term.covariance.values()]
    first = surface_covariance.shape[0]
    if any(len(row) != first + len(rows) for row in rows):
        raise CoefficientError(
            f"A term's covariance has not the {first + len(rows)} numbers of surface and terms. Diagnose again."
        )
    joint = np.zeros((first + len(rows), first + len(rows)))
    joint[:first, :first] = surface_covariance
    if rows:
        joint[first:] = rows
        joint[:first, first:] = joint[first:, :first].T
    return joint


def gradients(
    surface: Surface,
    terms: Sequence[RuntimeTerm],
    memories: Sequence[Memory],
    errors_dps: Sequence[Floats],
    c: Conditions,
) -> tuple[Floats, list[Memory]]:
    """Derivatives of the terms' errors by the parameters that have a covariance, shape (n, m), and memories.

    Exact for amplitudes, by a step of a thousandth for the others, each of which remembers a course of its own.
    """
    columns: list[Floats] = []
    after: list[Memory] = []
    for term, error in zip(terms, errors_dps, strict=True):
        for name in term.covariance:
            value = term.parameters[name]
            memory = memories[len(after)]
            if term.effect.parameter(name).linear and value != 0.0:
                columns.append(error / value)
            else:
                step = 1e-3 * (abs(value) or 1.0)
                stepped = {**term.parameters, name: value + step}
                ahead, memory = term.effect.error_dps(c, stepped, surface, memory)
                columns.append((ahead - error) / step)
            after.append(memory)
    return np.column_stack(columns) if columns else np.empty((len(c), 0)), after
