"""Amplitude and time constant of a law whose time constant scatters, in a table: over all the models that may be.

How far it scatters is hardly told, and what it was before the record began hangs on that; a profile of one model knows neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from gyrocal.diagnosis.candidates import Candidate
from gyrocal.diagnosis.intervals import TAILS, holding, of_geometric
from gyrocal.diagnosis.layers import Law
from gyrocal.diagnosis.result import Estimate

Floats = NDArray[np.float64]

#: Ends between which a quantile is looked for, in standard deviations of the widest model.
_FAR = 10.0


def posterior_of(
    candidates: Sequence[tuple[float, Candidate]], law: Law, known: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Parameters of a law of a spread time constant, with the value of one model and the intervals of all.

    Parameters
    ----------
    candidates : models that are averaged over, with their weights
    known : the parameters in the best of them
    """
    weights, amplitudes, stds, shapes = [], [], [], []
    for weight, c in candidates:
        own = next((x for x in c.fitted.model.laws if _same(x, law)), None)
        if own is None:
            continue
        solution = c.fitted.solve()
        at = solution.starts[own.name]
        weights.append(weight)
        amplitudes.append(float(solution.amplitudes[own.name][0]))
        stds.append(float(np.sqrt(solution.covariance[at, at])))
        shapes.append(own.shape["tau_s"])
    if not weights or known["amplitude"].at_bound:
        return dict(known)
    share, mean, std = np.array(weights) / np.sum(weights), np.array(amplitudes), np.array(stds)
    amplitude, tau_s = known["amplitude"], known["tau_s"]
    of_all = _quantiles(share, mean, std), _between(share, np.array(shapes))
    return {
        **known,
        "amplitude": Estimate.spanning(amplitude.value, holding(of_all[0], amplitude.value), amplitude.unit),
        "tau_s": Estimate.spanning(tau_s.value, holding(of_all[1], tau_s.value), tau_s.unit),
    }


def _same(one: Law, other: Law) -> bool:
    return one.effect == other.effect and one.shape.get("of_scale") == other.shape.get("of_scale")


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
