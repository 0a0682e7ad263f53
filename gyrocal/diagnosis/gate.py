"""May a name be given? Only where the named model leaves nothing structured behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.locate import Place
from gyrocal.diagnosis.search import Member, Search, related

#: What a named effect leaves on its own coordinate may be this share of what it explains; more, and the shape is not its own.
_LEFT_SHARE = 0.05
#: A name whose size changes by a larger share when the patterns without a name are taken out leans on them.
_LEANS = 0.5
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


def gate(members: Sequence[Member], remaining: Sequence[Place], search: Search) -> Gate:
    """Give or withhold the names of a model, given the lack of fit that it leaves in `search`."""
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
        reason = _why_withheld(member, members, remaining, search)
        if reason is None:
            named.append(member)
        else:
            withheld.append(member)
            reasons.append(reason)
    return Gate(tuple(named), tuple(withheld), tuple(reasons))


def _why_withheld(
    member: Member, members: Sequence[Member], remaining: Sequence[Place], search: Search
) -> str | None:
    h = member.hypothesis
    near = [m for m in members if related(m.hypothesis.coordinate, h.coordinate)]
    if sum(m.hypothesis.in_catalogue for m in near) >= _PATCHWORK:
        return f"{h.id} is not named: it takes {len(near)} laws to follow what is in {_words(h.coordinate)}."
    strangers = [m for m in members if not m.hypothesis.in_catalogue and _alike(m, member)]
    if strangers:
        strongest = max(strangers, key=lambda m: m.gain)
        place = _words(strongest.hypothesis.coordinate)
        if strongest.gain > member.gain:
            return (
                f"{h.id} is not named: a stronger pattern that is not in the catalogue lives in {place}, "
                "and may be what it follows."
            )
        if _leans(member, members, strangers, search):
            return f"{h.id} is not named: its size hangs on a pattern that is not in the catalogue and lives in {place}."
    left = max((p.excess for p in remaining if related(p.coordinate, h.coordinate)), default=0.0)
    if left > _LEFT_SHARE * member.gain:
        return (
            f"{h.id} comes nearest, but it is not named: it leaves structure in {_words(h.coordinate)} "
            f"({left / (left + member.gain):.0%} of what is there)."
        )
    return None


def _alike(a: Member, b: Member) -> bool:
    """Whether two members may stand for one another."""
    places = {a.hypothesis.coordinate, b.hypothesis.coordinate}
    return related(a.hypothesis.coordinate, b.hypothesis.coordinate) or places <= _SLOW


def _leans(member: Member, members: Sequence[Member], strangers: Sequence[Member], search: Search) -> bool:
    """Whether a member is another size without the strangers around it."""
    others = [m for m in members if m is not member]
    beside = _amplitudes(member, search, others)
    alone = _amplitudes(member, search, [m for m in others if m not in strangers])
    size = max(float(np.linalg.norm(alone)), float(np.linalg.norm(beside)))
    return float(np.linalg.norm(beside - alone)) > _LEANS * size


def _amplitudes(member: Member, search: Search, others: Sequence[Member]) -> NDArray[np.float64]:
    given = search.given(others)
    inner = given.gram[np.ix_(member.columns, member.columns)]
    return np.asarray(np.linalg.lstsq(inner, given.score[member.columns], rcond=1e-9)[0])


def _words(coordinate: str) -> str:
    return coordinate.replace("_", " ")
