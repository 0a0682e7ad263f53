"""Whether a law that earned its name holds all through a drive: one that does not has the name of something else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.laws import SETTLING, Law, is_motion
from gyrocal.diagnosis.drive.levels import GAIN, STRANGER_P
from gyrocal.diagnosis.drive.nameless import GainTest, odder
from gyrocal.diagnosis.drive.weighing import Evidence, Gram, evidence, weighed_of
from gyrocal.diagnosis.drive.yaw import NEIGHBOURS, YawModel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Parts of a drive in which a named law must be the same.
_PARTS = 24
#: Intervals that are looked at for an event, of those in which a law says most.
_TELLING = 6
#: By what share of itself a delay must grow within a drive to be that of a clock, and no gyro's.
_GROWS = 0.5


def uneven(
    model: YawModel, laws: Mapping[str, Law], chosen: Sequence[str], named: Mapping[str, float]
) -> dict[str, GainTest]:
    """Named laws that change between the parts of a drive: the test of each.

    A law that was taken for another one, of a patch of ground or of a wheel that sticks at times, holds in some parts
    and not in others. Parts of equal weight, so that each could show it.
    """
    found = {}
    tried = [n for n in named if not n.startswith("wheel_")]
    for name in tried:
        column = laws[name].column
        weight = np.cumsum(column**2)
        part = np.minimum((_PARTS * weight / weight[-1]).astype(np.int64), _PARTS - 1)
        # A bias that settles does so at rest as well: it is no change of what the motion adds.
        settling = [n for n in laws if n in SETTLING and is_motion(name) and n not in chosen]
        beside = [*chosen, *settling]
        columns = {n: laws[n].column for n in beside}
        more = {f"{name}:{k}": np.where(part == k, column, 0.0) for k in range(1, _PARTS)}
        gain = evidence(model, columns | more).added(beside, list(more))
        test = GainTest.of(gain, len(more))
        test = test._replace(p_value=len(tried) * test.p_value)
        if test.p_value < STRANGER_P:
            found[name] = test
    return found


def outlasting(
    model: YawModel, laws: Mapping[str, Law], chosen: Sequence[str], named: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, GainTest]]:
    """Named laws whose mean is beyond what the parts of the drive differ by, and those of all that change between these."""
    changing = uneven(model, laws, chosen, named)
    return {n: g for n, g in named.items() if n not in changing or outlasts(g, changing[n])}, changing


def outlasts(gain: float, changing: GainTest) -> bool:
    """Whether a law that changes between the parts of a drive has a mean beyond what these differ by.

    Of a law that comes and goes, as over patches of ground, some mean is left on any path, and on the next one another.
    """
    return bool(stats.f.sf(gain * changing.columns / changing.gain, 1, changing.columns) < STRANGER_P)


def events(
    model: YawModel,
    columns: Mapping[str, Floats],
    known: Mapping[str, tuple[float, float]],
    named: Mapping[str, float],
) -> Ints:
    """Intervals without which a named law loses its name, and most of what it gains: one event is no law.

    On a circle at one speed scale, bias and wheels differ by how it begins and ends alone; a clock that is late there makes
    all of them of any size, each the opposite of another.

    Parameters
    ----------
    columns : of all laws that are fitted and of what has no name
    known : what is known of coefficients beforehand
    """
    tried = [n for n in named if n in columns and not n.startswith("wheel_")]
    if not tried:
        return np.zeros(0, dtype=np.int64)
    gram, weighed = weighed_of(model, columns)
    # A rest tells of the gyro as often as it has intervals: of these an event takes one.
    moving = np.flatnonzero(~model.frame.nodes.resting)
    telling = {n: _telling(model, columns, gram, weighed, n) for n in tried}
    single = {
        k: {k, *moving[np.abs(moving - k) <= NEIGHBOURS].tolist()}
        for intervals in telling.values()
        for k in intervals
    }
    impulses = {
        f"at:{j}": np.eye(1, model.y.size, j)[0]
        for j in sorted({j for near in single.values() for j in near})
    }
    beside = evidence(model, {**columns, **impulses}).knowing(known)
    found = []
    for name, intervals in telling.items():
        others = [n for n in columns if n != name]
        whole = beside.added(others, [name])
        for k in intervals:
            left = beside.added([*others, *(f"at:{j}" for j in single[k])], [name])
            if left < min(GAIN, 0.5 * whole):
                found.append(k)
    return np.unique(np.array(found, dtype=np.int64))


def _telling(
    model: YawModel, columns: Mapping[str, Floats], gram: Gram, weighed: Floats, name: str
) -> list[int]:
    """The intervals in which a law says most beside the other columns."""
    at, others = [*columns].index(name), [n for n in columns if n != name]
    left = model.y - np.column_stack([columns[n] for n in others]) @ gram.solve(others)[0]
    beyond = weighed[:, at] - np.delete(weighed, at, axis=1) @ gram.nearest(name, others)
    return [int(k) for k in np.argsort(-np.abs(beyond * left))[:_TELLING]]


def undenied(
    model: YawModel,
    told: Evidence,
    laws: Mapping[str, Law],
    fitted: Sequence[str],
    named: Mapping[str, float],
    odd: Mapping[str, GainTest],
) -> tuple[dict[str, float], dict[str, GainTest]]:
    """Named laws less those that the log itself speaks against, and tests by coordinate with what these gained there.

    A delay that grows is of a clock; track or wheels that are others from an instant on are of what happened then; and turns
    that differ more from place to place than they do in the mean are of the ground: on another path their mean is another.
    """
    denied = {n: ("time", GainTest.of(named[n])) for n in named if f"time:{n}" in fitted}
    grown = "delay" in named and odd["delay"].p_value < STRANGER_P
    # Gains go by mean squares, and that of a line from -1/2 to 1/2 is a twelfth.
    if grown and 12.0 * odd["delay"].gain > _GROWS**2 * named["delay"]:
        denied["delay"] = ("delay", odd["delay"])
    of_turns = [n for n in fitted if n == "track" or n.startswith("slip_")]
    if any(n in named for n in of_turns):
        values = dict(zip(fitted, told.own.solve(fitted)[0], strict=True))
        slipped = np.sum([values[n] * laws[n].column for n in of_turns], axis=0)
        if np.linalg.norm(slipped) < model.noise.track_wander * np.linalg.norm(laws["track"].column):
            denied |= {n: ("turn_rate", GainTest.of(named[n])) for n in of_turns if n in named}
    left = dict(odd)
    for coordinate, test in denied.values():
        left = odder(left, coordinate, test)
    return {n: gain for n, gain in named.items() if n not in denied}, left
