"""What the truth's own noise makes of the distance between a path and it, and what it hides of a difference."""

from __future__ import annotations

import numpy as np

from gyrocal.diagnosis.drive.reckoning import Complexes, Floats
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.units import NORMAL_95

#: Stretches of time that rows of the truth are summed over: its wandering error hardly changes within one.
_STRETCHES = 400


def truth_floor(
    truth: TruthAnswer, t_s: Floats, at_m: Complexes, apart_m: Complexes, rms_m: tuple[float, float]
) -> tuple[float, float]:
    """Position rms that the truth's own error gives a perfect path laid on it, and the least difference seen, m.

    The second is what the difference of two rms errors exceeds once in 20 times by the truth's own error: to first order
    their mean squares differ by twice its mean product with what the paths are apart. NaN where no path was laid on the truth.

    Parameters
    ----------
    t_s, at_m, apart_m : ndarray, shape (n,)
        Times of rows with truth, its positions (x + iy), and by how much the two paths differ there.
    rms_m : the rms errors of the two paths
    """
    if truth.levels is None:
        return float("nan"), float("nan")
    white, wander = np.exp(truth.levels.logs[1:3])
    edges = np.linspace(t_s[0], t_s[-1], _STRETCHES + 1)
    stretch = np.clip(np.searchsorted(edges, t_s, side="right") - 1, 0, _STRETCHES - 1)
    at_s = 0.5 * (edges[1:] + edges[:-1])
    fade = np.exp(-np.abs(at_s[:, None] - at_s[None, :]) / truth.levels.wander_s)

    def variance(along: Complexes) -> float:
        """Of the truth's error along a direction in the space of all rows, per axis."""
        summed = np.bincount(stretch, along.real, _STRETCHES) + 1j * np.bincount(
            stretch, along.imag, _STRETCHES
        )
        return float(white * np.vdot(along, along).real + wander * (summed.conj() @ fade @ summed).real)

    # Laying on takes a shift of both axes and a turn.
    rows = t_s.size
    arms = 1j * (at_m - at_m.mean())
    shift, turn = np.full(rows, 1.0 / np.sqrt(rows), dtype=complex), arms / np.linalg.norm(arms)
    left = 2.0 * rows * (white + wander) - 2.0 * variance(shift) - variance(turn)
    seen_m = NORMAL_95 * 2.0 * np.sqrt(variance(apart_m)) / rows / sum(rms_m)
    return float(np.sqrt(max(left, 0.0) / rows)), float(seen_m)
