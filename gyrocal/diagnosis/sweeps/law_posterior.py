"""Parameters of a law of a table over all the models that may be.

What a coil's lag is not, a step of the scale factor is, and how far a time constant scatters is hardly told: the profile of
one model knows neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from gyrocal.diagnosis.model.intervals import TAILS, Interval, holding, of_geometric
from gyrocal.diagnosis.model.layers import Law
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.sweeps.candidates import Candidate

Floats = NDArray[np.float64]

#: Ends between which a quantile is looked for, in standard deviations of the widest model.
_FAR = 10.0


def posterior_of(
    candidates: Sequence[tuple[float, Candidate]], law: Law, known: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Parameters of a law, with the value of one model and the intervals of all.

    Of a time constant that scatters both intervals are those of all models; else the amplitude's is wide enough for its own
    model and for all the others.

    Parameters
    ----------
    candidates : models that are averaged over, with their weights
    known : the parameters in the best of them
    """
    scatters = bool(law.spread) and not law.from_end
    weights, amplitudes, stds, shapes = [], [], [], []
    for weight, c in candidates:
        own = next((x for x in c.fitted.model.laws if _same(x, law, known)), None)
        if own is None:
            continue
        solution = c.fitted.solve()
        at = solution.starts[own.name]
        weights.append(weight)
        amplitudes.append(float(solution.amplitudes[own.name][0]))
        stds.append(float(np.sqrt(solution.covariance[at, at])))
        shapes.append(own.shape.get("tau_s", np.nan))
    if not weights or known["amplitude"].at_bound:
        return dict(known)
    share, mean, std = np.array(weights) / np.sum(weights), np.array(amplitudes), np.array(stds)
    inside = [known["amplitude"].value] if scatters else known["amplitude"].interval_95
    found = {"amplitude": _spanning(known["amplitude"], _quantiles(share, mean, std), inside)}
    if scatters:
        tau_s = known["tau_s"]
        found["tau_s"] = _spanning(tau_s, _between(share, np.array(shapes)), [tau_s.value])
    return {**known, **found}


def _spanning(known: Estimate, of_all: Interval, inside: Sequence[float]) -> Estimate:
    for value in inside:
        of_all = holding(of_all, value)
    return Estimate.spanning(known.value, of_all, known.unit)


def _same(one: Law, other: Law, known: Mapping[str, Estimate]) -> bool:
    """Whether it is the same law: a step at any instant at which that may have been, a drift of the same course, another at any shape."""
    if one.effect != other.effect or one.shape.get("of_scale") != other.shape.get("of_scale"):
        return False
    if "at_s" in known:
        low, high = known["at_s"].interval_95
        return low <= one.shape["at_s"] <= high
    return not other.from_end or one.shape == other.shape


def _quantiles(share: Floats, mean: Floats, std: Floats) -> tuple[float, float]:
    """Ends of the interval of a mixture of normal distributions."""
    ends = float(np.min(mean - _FAR * std)), float(np.max(mean + _FAR * std))

    def beyond(x: float, tail: float) -> float:
        return float(share @ ndtr((x - mean) / std)) - tail

    low, high = (float(brentq(beyond, *ends, args=(tail,))) for tail in TAILS)
    return low, high


def _between(share: Floats, values: Floats) -> tuple[float, float]:
    """The same of values on a geometric grid, each of which stands for half of the way to the next."""
    each, place = np.unique(values, return_inverse=True)
    if each.size < 2:
        return float(each[0]), float(each[0])
    return of_geometric(each, np.bincount(place, share).astype(np.float64))
