"""All effects by id: the bench table of physics.md."""

from __future__ import annotations

from gyrocal.errors import InputError
from gyrocal.physics import angle, disturbance, rate, sampling, thermal, timewise
from gyrocal.physics.effect import Effect

CATALOGUE: dict[str, Effect] = {
    effect.id: effect
    for family in (angle, rate, thermal, timewise, disturbance, sampling)
    for effect in family.EFFECTS
}


def find_effect(effect_id: str) -> Effect:
    """The effect called `effect_id`.

    Raises
    ------
    InputError
        There is none; the message lists the ids that there are.
    """
    try:
        return CATALOGUE[effect_id]
    except KeyError:
        raise InputError(
            f"There is no effect {effect_id!r} in the catalogue. Known: {', '.join(sorted(CATALOGUE))}."
        ) from None
