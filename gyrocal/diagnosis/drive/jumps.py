"""A bias that jumps within a drive and stays: when, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.laws import Frame, Law, jump
from gyrocal.diagnosis.drive.levels import STRANGER_P
from gyrocal.diagnosis.drive.motions import AS_LIKELY, mean_gain, of_change
from gyrocal.diagnosis.drive.series import Nodes
from gyrocal.diagnosis.drive.weighing import Evidence, evidence
from gyrocal.diagnosis.drive.yaw import YawModel
from gyrocal.diagnosis.model.intervals import RISE_INSTANT_95

Floats = NDArray[np.float64]

#: Instants of a drive at which the bias may jump, and how many about the likeliest are looked at again.
_INSTANTS, _CLOSER = 40, 16
#: What a wheel that is another one changes.
_OF_WHEELS = ("track", "asymmetry")


@dataclass(frozen=True)
class Instant:
    """When a bias jumps, s, the 95 % interval of that, and twice the log likelihood that it gains."""

    at_s: float
    earliest_s: float
    latest_s: float
    gain: float

    @property
    def shape(self) -> dict[str, float]:
        """Of a law that holds until then."""
        return {"until_s": self.at_s, "earliest_s": self.earliest_s, "latest_s": self.latest_s}

    @property
    def p_value(self) -> float:
        """Chance of the gain at the best of all instants where no bias jumps."""
        return chance(self.gain)


def chance(gain: float) -> float:
    """Chance of a gain at the best of all instants where no bias jumps."""
    return min(_INSTANTS * float(stats.chi2.sf(gain, 1)), 1.0)


def instant_of_p(at_s: float, span_s: tuple[float, float], p_value: float) -> Instant:
    """An instant that something else shows, with the gain of such a chance."""
    return Instant(at_s, *span_s, float(stats.chi2.isf(max(p_value, 1e-300) / _INSTANTS, 1)))


def within_motion(nodes: Nodes) -> tuple[float, float]:
    """Span of a drive with some motion before it and after it, s.

    A bias that is another one in the rest at an end of a drive comes with the motion, or is what slow wheels do.
    """
    moved_s = np.cumsum(np.where(nodes.resting, 0.0, nodes.dt_s))
    begin, end = np.searchsorted(moved_s, moved_s[-1] * np.array([1.0, _INSTANTS - 1.0]) / _INSTANTS)
    return float(nodes.t_s[begin]), float(nodes.t_s[end])


def _likeliest(
    begin_s: float, end_s: float, apart_s: float, gains: Callable[[Floats], Floats], least: float = -np.inf
) -> Instant | None:
    """The likeliest instant of a jump by what each gains, to `apart_s`; None where it may be chance, or one at any gains less than `least`."""
    step_s = (end_s - begin_s) / _INSTANTS
    instants_s = np.asarray(begin_s + step_s * (np.arange(_INSTANTS) + 0.5), dtype=np.float64)
    gained = gains(instants_s)
    if chance(float(gained.max())) >= STRANGER_P or mean_gain(gained) < least:
        return None
    # Wheels that are others a second before they are tell so much against the law that it takes less than there is.
    while step_s > apart_s:
        closer_s = instants_s[np.argmax(gained)] + step_s * np.linspace(-1.0, 1.0, _CLOSER + 1)
        closer_s = closer_s[(closer_s > begin_s) & (closer_s < end_s)]
        instants_s, gained = np.append(instants_s, closer_s), np.append(gained, gains(closer_s))
        step_s *= 2.0 / _CLOSER
    order = np.argsort(instants_s)
    asked_s = np.concatenate([[begin_s], instants_s[order], [end_s]])
    likely = np.flatnonzero(gained[order] > gained.max() - RISE_INSTANT_95) + 1
    # The next instants that were asked on either side are outside.
    ends_s = float(asked_s[likely[0] - 1]), float(asked_s[likely[-1] + 1])
    return Instant(float(instants_s[np.argmax(gained)]), *ends_s, float(gained.max()))


def jump_of(
    model: YawModel,
    free: Evidence,
    laws: Mapping[str, Law],
    chosen: Sequence[str],
    known: Mapping[str, tuple[float, float]],
) -> dict[str, Law]:
    """A bias that jumps and stays, at the likeliest instant, if that is hardly chance.

    Where track or wheels that are others from some instant on are likelier, these instead, at theirs: a law of no name, for
    no robot file holds it, beside which whatever might have stood for it is to be weighed. They are asked where the bias may
    jump, or `free` shows that something goes with the time.

    Returns
    -------
    dict of str to Law
        One by the name ``jump``, or one or two by ``time:`` and the name of a wheel's law, or none.
    """
    nodes, columns = model.frame.nodes, {n: laws[n].column for n in chosen}

    def until(name: str, at_s: float) -> Floats:
        return np.where(nodes.t_s < at_s, laws[name].column, 0.0)

    def likeliest(name: str, beside: Sequence[str] = chosen, least: float = -np.inf) -> Instant | None:
        def gains(instants_s: Floats) -> Floats:
            of = {f"{name}:{k}": until(name, t) for k, t in enumerate(instants_s.tolist())}
            # Held to what is known of it, a figure that is off from that would be taken for another one until the end.
            told = evidence(model, columns | of).knowing(less(known, name))
            return np.array([told.added(beside, [n]) for n in of], dtype=np.float64)

        return _likeliest(*within_motion(nodes), float(np.median(nodes.dt_s)), gains, least)

    def instead() -> Instant | None:
        """A jump that a law of the bias stands for, which then tells of no jump beside it."""
        if not (changing_laws := of_change(chosen)):
            return None
        others = [n for n in chosen if n not in changing_laws]
        told = evidence(model, columns).knowing(less(known, "bias"))
        taken = told.added(others, chosen)
        found = likeliest("bias", others, taken + AS_LIKELY)
        return found and replace(found, gain=found.gain - taken)

    with_time = [n for n in free.own.names if n.startswith("time:")]
    changing = bool(stats.chi2.sf(free.added(chosen, with_time), len(with_time)) < STRANGER_P)
    found = {"bias": likeliest("bias") or instead()}
    if found["bias"] is not None or changing:
        found |= {n: likeliest(n) for n in _OF_WHEELS if n in laws}
    likely = {n: x for n, x in found.items() if x is not None}
    if not likely:
        return {}
    name = max(likely, key=lambda n: likely[n].gain)
    if name == "bias":
        return {"jump": law_at(model.frame, likely[name])}
    return _wheels_until(model, laws, chosen, name, likely[name])


def _wheels_until(
    model: YawModel, laws: Mapping[str, Law], chosen: Sequence[str], name: str, instant: Instant
) -> dict[str, Law]:
    """Track or wheels that are others from an instant on, and the other of the two where it changes then, too."""
    until = model.frame.nodes.t_s < instant.at_s
    both = {n: np.where(until, laws[n].column, 0.0) for n in _OF_WHEELS}
    columns = {n: laws[n].column for n in chosen}
    told = evidence(model, columns | {f"time:{n}": x for n, x in both.items()})
    # A wheel that is another one turns the robot further, too.
    more = [
        n
        for n in both
        if n != name and stats.chi2.sf(told.added([*chosen, f"time:{name}"], [f"time:{n}"]), 1) < STRANGER_P
    ]
    return {f"time:{n}": replace(laws[n], shape=instant.shape, column=both[n]) for n in (name, *more)}


def less(known: Mapping[str, tuple[float, float]], name: str) -> dict[str, tuple[float, float]]:
    """What is known beforehand of all other laws."""
    return {n: k for n, k in known.items() if n != name}


def law_at(frame: Frame, instant: Instant) -> Law:
    """The law of a bias that is another one until an instant."""
    return replace(jump(frame, instant.at_s), shape=instant.shape)
