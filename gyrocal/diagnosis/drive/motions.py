"""Laws of a bias that comes with the motion: which of them a log holds, where it tells little of the lag."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.laws import KINDS
from gyrocal.diagnosis.drive.yaw import Evidence

Floats = NDArray[np.float64]


def of_motion(laws: Iterable[str]) -> list[str]:
    """Laws of a bias that comes with the motion: they differ by the lag alone."""
    return [n for n in laws if KINDS[n].group == "motion"]


def likely_motions(told: Evidence, chosen: Sequence[str], motions: Sequence[str]) -> tuple[Floats, Floats]:
    """How likely each law of the motion is in place of that which is chosen, and its coefficient then."""
    beside = [n for n in chosen if KINDS[n].group != "motion"]
    gains = np.array([told.added(beside, [n]) for n in motions])
    likely = np.exp(0.5 * (gains - gains.max()))
    values = np.array([told.own.solve([*beside, n])[0][-1] for n in motions])
    return likely / likely.sum(), values


def middling(told: Evidence, chosen: Sequence[str], motions: Sequence[str]) -> list[str]:
    """With that law of the motion, of those that are as likely as not, whose bias is nearest to the mean of all.

    A later rest that is short tells little of the lag, and of the bias only together with that.
    """
    taken = next((n for n in chosen if n in motions), None)
    if taken is None:
        return list(chosen)
    likely, values = likely_motions(told, chosen, motions)
    away = np.where(likely >= 0.5 * likely.max(), np.abs(values - likely @ values), np.inf)
    return [motions[int(np.argmin(away))] if n == taken else n for n in chosen]
