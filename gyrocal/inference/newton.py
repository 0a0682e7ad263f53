"""The minimum of a negative log-likelihood over logarithms of variances, by Newton's steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Floats = NDArray[np.float64]

#: What is still to be gained when the steps end, nats.
SETTLED = 1e-3
#: The most steps, and the longest one of a logarithm.
_STEPS, _LONGEST = 60, 4.0
#: By how much steps are shortened at first, what a step must bring of what the bend promises, and by how much they are
#: lengthened at the most and shortened then (Marquardt, J. SIAM 11, 1963; between them Nielsen, IMM-REP-1999-05).
_DAMPED, _KEPT, _LONGER, _SHORTER = 1e-3, 1e-4, 0.2, 8.0
#: Added to the bend, as a share of its largest: what tells of nothing must not go anywhere.
_STIFF = 1e-10


class Point(Protocol):
    """A function at some logarithms, shape (k,)."""

    @property
    def value(self) -> float:
        """What it is there."""

    @property
    def slope(self) -> Floats:
        """Of the value, shape (k,)."""

    @property
    def bend(self) -> Floats:
        """Of the value, or what stands for it, shape (k, k): nowhere negative."""


P = TypeVar("P", bound=Point)


def descend(at: Callable[[Floats], P], logs: Floats, bounds: Floats) -> tuple[Floats, P]:
    """Logarithms of the nearest minimum, and the function there.

    A variance that dies goes towards nothing by ever the longest step.

    Parameters
    ----------
    at : callable
        The function; LinAlgError where it is none.
    logs : ndarray, shape (k,)
        Where to begin.
    bounds : ndarray, shape (k, 2)
    """
    (low, high), here, damped = bounds.T, at(logs), _DAMPED
    for _ in range(_STEPS):
        slope, bend = here.slope, here.bend
        free = (low < high) & ~((logs <= low) & (slope > 0.0)) & ~((logs >= high) & (slope < 0.0))
        own = np.diag(bend)[free]
        stiff = np.diag(damped * (own + _DAMPED) + _STIFF * np.max(own, initial=1.0))
        step = np.zeros_like(logs)
        step[free] = -linalg.solve(bend[np.ix_(free, free)] + stiff, slope[free], assume_a="pos")
        step = np.clip(logs + np.clip(step, -_LONGEST, _LONGEST), low, high) - logs
        downhill = -float(slope @ step)
        if 0.0 <= downhill < SETTLED:
            break
        # Of a step that was cut short what the slope and the bend promise may be a loss.
        promised = downhill - 0.5 * float(step @ bend @ step)
        there = _tried(at, logs + step) if promised > 0.0 else None
        kept = -np.inf if there is None else (here.value - there.value) / promised
        if there is not None and kept >= _KEPT:
            logs, here = logs + step, there
            damped *= float(np.clip(1.0 - (2.0 * kept - 1.0) ** 3, _LONGER, 2.0))
        else:
            damped = max(_SHORTER * damped, _DAMPED)
    return logs, here


def _tried(at: Callable[[Floats], P], logs: Floats) -> P | None:
    """The function there; None where it is none."""
    try:
        return at(logs)
    except linalg.LinAlgError:
        return None
