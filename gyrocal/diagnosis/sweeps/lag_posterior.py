"""Share and time constant of a coil's lag in a table: their joint posterior over all that they may be.

The two are traded for one another, and a search on a grid knows neither's interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.diagnosis.model.intervals import holding, of_geometric, of_mass
from gyrocal.diagnosis.model.parts import SURFACE
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.diagnosis.sweeps.coil import LAG_BOUNDS_S
from gyrocal.physics.thermal import THERMAL_LAG

Floats = NDArray[np.float64]

#: Grid of the posterior: several times closer than that of the search.
_SHARES, _LAGS_S = np.linspace(-1.0, 1.0, 81), np.geomspace(*LAG_BOUNDS_S, 60)


def lag_estimates(candidates: Sequence[tuple[float, Candidate]]) -> dict[str, Estimate]:
    """Parameters of the lag: the values of the models that are averaged over, and 95 % of the posterior.

    Parameters
    ----------
    candidates : models with a lag of the coil, with their weights
    """
    weights = np.array([w for w, _ in candidates])
    coils = np.array([c.coil for _, c in candidates], dtype=np.float64)
    share, tau_s = weights @ coils / weights.sum()
    changes = dict.fromkeys(c.changes for _, c in candidates)
    posterior = np.zeros((_LAGS_S.size, _SHARES.size))
    for change in changes:
        same = [(w, c) for w, c in candidates if c.changes == change]
        posterior += sum(w for w, _ in same) * _posterior(same[0][1])
    shares = of_mass(_SHARES, posterior.sum(axis=0))
    lags_s = of_geometric(_LAGS_S, posterior.sum(axis=1))
    return {
        "amplitude": Estimate.spanning(float(share), holding(shares, float(share)), "1"),
        "tau_s": Estimate.spanning(float(tau_s), holding(lags_s, float(tau_s)), "s"),
    }


def _posterior(candidate: Candidate) -> Floats:
    """Over time constants and shares, at the variances of a model; its sum is one."""
    model, variance = candidate.fitted.model, candidate.fitted.fit.variance
    part = model.shrunk
    noise = np.zeros((len(model.means), len(model.means)))
    for c in model.all:
        if c.covariance is not None:
            noise += variance[c.name] * c.covariance
        elif c.columns is not None and (part is None or c.name != part.name):
            noise += variance[c.name] * (c.columns @ c.columns.T)
    lower = linalg.cholesky(noise, lower=True)
    y = linalg.solve_triangular(lower, model.error_dps, lower=True)
    free = len(model.flat)
    columns, weight, prior = list(model.flat), np.ones(free), np.zeros(free)
    if part is not None:
        columns += [SURFACE.index(c) for c in part.columns]
        weight = np.array([*weight, *part.weights])
        prior = np.array([*prior, *np.full(len(part.columns), 1.0 / variance[part.name])])
    here = _whitened(lower, replace(model.basis, coil=None).surface(), columns, weight)
    log = np.empty((_LAGS_S.size, _SHARES.size))
    to_there = _SHARES[:, None, None]
    to_here = 1.0 - to_there
    for i, tau_s in enumerate(_LAGS_S.tolist()):
        there = _whitened(lower, replace(model.basis, coil=(1.0, tau_s)).surface(), columns, weight)
        across = here.T @ there
        information = to_here**2 * (here.T @ here) + to_there**2 * (there.T @ there) + np.diag(prior)
        information += to_here * to_there * (across + across.T)
        root = np.linalg.cholesky(information)
        b = to_here * (here.T @ y)[:, None] + to_there * (there.T @ y)[:, None]
        log[i] = 0.5 * np.sum(np.linalg.solve(root, b) ** 2, axis=(1, 2))
        log[i] -= np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        log[i] += THERMAL_LAG.search.nats_before({"tau_s": tau_s})
    found = np.exp(log - log.max())
    return np.asarray(found / found.sum())


def _whitened(lower: Floats, design: Floats, columns: list[int], weight: Floats) -> Floats:
    return np.asarray(linalg.solve_triangular(lower, design[:, columns] * weight, lower=True))
