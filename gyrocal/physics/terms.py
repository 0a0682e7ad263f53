"""Terms of a coefficient file as effects that a robot evaluates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gyrocal.errors import CoefficientError, InputError
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.effect import Effect

#: Channels of `Conditions` that a robot has.
ROBOT_CHANNELS = frozenset({"t_s", "rate_dps", "temp_c", "since_power_on_s"})


@dataclass(frozen=True)
class RuntimeTerm:
    """An effect, the values of its parameters, and the relative standard deviation of its amplitude."""

    effect: Effect
    parameters: Mapping[str, float]
    relative_sigma: float


def runtime_term(effect_id: str, parameters: Mapping[str, Mapping[str, Any]]) -> RuntimeTerm:
    """A term (``value``, ``std``, ``unit`` of each parameter), checked against the catalogue.

    Raises
    ------
    CoefficientError
        An effect or parameter that this program does not know, a value out of bounds, another unit, or an
        effect that a robot cannot evaluate.
    """
    try:
        effect = find_effect(effect_id)
        values = effect.complete({name: float(entry["value"]) for name, entry in parameters.items()})
        sigma = float(parameters.get("amplitude", {}).get("std") or 0.0)
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
    return RuntimeTerm(effect, values, sigma / amplitude if amplitude else 0.0)
