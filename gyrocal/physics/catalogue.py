"""All effects by id: the bench table of physics.md, and what other packages add to it."""

from __future__ import annotations

from gyrocal.errors import InputError
from gyrocal.extensions import extended
from gyrocal.physics import angle, disturbance, rate, sampling, thermal, timewise
from gyrocal.physics.drive import DRIVE_CATALOGUE
from gyrocal.physics.effect import Described, Effect

CATALOGUE: dict[str, Effect] = extended(
    "gyrocal.effects",
    Effect,
    {
        effect.id: effect
        for family in (angle, rate, thermal, timewise, disturbance, sampling)
        for effect in family.EFFECTS
    },
)

for _name, _effect in CATALOGUE.items():
    if _effect.id != _name:
        raise InputError(
            f"The effect {_effect.id} is added under the name {_name}. Its package must use its id."
        )


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


def described(effect_id: str) -> Described:
    """What is said of an effect of the bench or of the robot, for who only has its id; InputError without one."""
    return DRIVE_CATALOGUE[effect_id] if effect_id in DRIVE_CATALOGUE else find_effect(effect_id)


def twins_of(effect_id: str) -> tuple[str, ...]:
    """Effects that are looked for as `effect_id`: of exactly the same law, so that no data tell them apart."""
    return tuple(e.id for e in CATALOGUE.values() if e.search.twin_of == effect_id)


def as_large(effect_id: str, amplitude: float) -> tuple[str, ...]:
    """Of an effect and its twins those that may have an amplitude of this size; all of them where none may."""
    alike = (effect_id, *twins_of(effect_id))
    return tuple(e for e in alike if amplitude <= CATALOGUE[e].parameter("amplitude").high) or alike


def law_of(effect_id: str) -> str:
    """The effect that is looked for in the stead of `effect_id`: itself, or the first of its twins."""
    return CATALOGUE[effect_id].search.twin_of or effect_id
