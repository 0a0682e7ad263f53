"""May a name be given? Only where the named model leaves nothing structured behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gyrocal.diagnosis.locate import Place
from gyrocal.diagnosis.search import Member, related

#: What a named effect leaves on its own coordinate may be this share of what it explains; more, and the shape is not its own.
_LEFT_SHARE = 0.05
#: So many laws of the catalogue for one coordinate are a patchwork, not physics.
_PATCHWORK = 3
#: Coordinates that all change slowly in one recording, so that a pattern in one is half a pattern in another.
_SLOW = {
    "time",
    "time_since_power_on",
    "data_set_index",
    "temperature",
    "temperature_rate",
    "temperature_branch",
}


@dataclass(frozen=True)
class Gate:
    """Which members carry a name.

    Attributes
    ----------
    named, withheld : tuple of Member
        Withheld: laws of the catalogue that fit but leave structure behind, and strangers.
    reasons : tuple of str
        Why a name was withheld, one sentence each.
    """

    named: tuple[Member, ...]
    withheld: tuple[Member, ...]
    reasons: tuple[str, ...]


def gate(members: Sequence[Member], remaining: Sequence[Place]) -> Gate:
    """Give or withhold the names of a model, given the lack of fit that it leaves."""
    named: list[Member] = []
    withheld: list[Member] = []
    reasons: list[str] = []
    for member in members:
        h = member.hypothesis
        if not h.in_catalogue:
            withheld.append(member)
            reasons.append(
                f"A pattern that is not in the catalogue lives in {_words(h.coordinate)}: {h.id.strip('()')}."
            )
            continue
        reason = _why_withheld(member, members, remaining)
        if reason is None:
            named.append(member)
        else:
            withheld.append(member)
            reasons.append(reason)
    return Gate(tuple(named), tuple(withheld), tuple(reasons))


def _why_withheld(member: Member, members: Sequence[Member], remaining: Sequence[Place]) -> str | None:
    h = member.hypothesis
    near = [m for m in members if related(m.hypothesis.coordinate, h.coordinate)]
    if sum(m.hypothesis.in_catalogue for m in near) >= _PATCHWORK:
        return f"{h.id} is not named: it takes {len(near)} laws to follow what is in {_words(h.coordinate)}."
    for m in members:
        alike = m in near or {m.hypothesis.coordinate, h.coordinate} <= _SLOW
        if alike and not m.hypothesis.in_catalogue and m.gain > member.gain:
            return (
                f"{h.id} is not named: a stronger pattern that is not in the catalogue lives in "
                f"{_words(m.hypothesis.coordinate)}, and may be what it follows."
            )
    left = max((p.excess for p in remaining if related(p.coordinate, h.coordinate)), default=0.0)
    if left > _LEFT_SHARE * member.gain:
        return (
            f"{h.id} comes nearest, but it is not named: it leaves structure in {_words(h.coordinate)} "
            f"({left / (left + member.gain):.0%} of what is there)."
        )
    return None


def _words(coordinate: str) -> str:
    return coordinate.replace("_", " ")
