"""Least squares under noise of several sources: their levels by restricted maximum likelihood, tests by Satterthwaite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, stats

Floats = NDArray[np.float64]

#: Levels may go so far from where the search begins, natural logarithm of the variance.
_REACH = 16.0
#: A source whose level hardly changes the likelihood is taken as known (its curvature, nats per squared logarithm).
_FLAT = 1e-3
_STEPS = 60


@dataclass(frozen=True)
class Source:
    """A source of noise: its covariance (n, n) at a level of one, and what is known of the level (a variance).

    `spread` is the standard deviation of the logarithm of `level`; infinite: nothing is known, the search begins there.
    """

    name: str
    covariance: Floats = field(repr=False)
    level: float
    spread: float = np.inf


@dataclass(frozen=True)
class Fit:
    """Generalised least squares under the levels found.

    Attributes
    ----------
    values, covariance : ndarray, shapes (p,) and (p, p)
    levels : ndarray, shape (sources,)
        Variance of each source.
    projection : ndarray, shape (n, n)
        ``P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1``.
    weighted : ndarray, shape (n,)
        ``P y``.
    """

    values: Floats
    covariance: Floats
    levels: Floats
    log_likelihood: float
    projection: Floats = field(repr=False)
    weighted: Floats = field(repr=False)
    _gradients: Floats = field(repr=False)
    _uncertainty: Floats = field(repr=False)

    def freedom(self, contrast: Floats) -> float:
        """Degrees of freedom of the variance of a contrast, shape (p,), by Satterthwaite."""
        variance = float(contrast @ self.covariance @ contrast)
        slope = np.einsum("i,kij,j->k", contrast, self._gradients, contrast)
        spread = float(slope @ self._uncertainty @ slope)
        return float(np.clip(2.0 * variance**2 / max(spread, 1e-300), 2.0, 1e4))

    def excess(self, columns: Floats) -> tuple[float, int]:
        """p-value that columns (n, k) belong in the model, and how many of them are new to it."""
        length = np.sqrt(np.maximum(np.einsum("ij,ik,jk->k", self.projection, columns, columns), 0.0))
        used = columns[:, length > 1e-9 * (np.max(length, initial=0.0) or 1.0)]
        if not used.shape[1]:
            return 1.0, 0
        score, information = used.T @ self.weighted, used.T @ self.projection @ used
        size = np.sqrt(np.diag(information))
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        kept = values > 1e-8
        turned = (vectors[:, kept].T @ (score / size)) ** 2 / values[kept]
        k, rest = int(kept.sum()), self.weighted.size - self.values.size
        return float(stats.f.sf(turned.sum() / k, k, max(rest - k, 1))), k


class _Likelihood:
    """Minus the penalised restricted log-likelihood over the logarithms of the levels, with its gradient."""

    def __init__(self, y: Floats, columns: Floats, sources: Sequence[Source]) -> None:
        self.y, self.columns = y, columns
        self.parts = [s.covariance for s in sources]
        self.centre = np.log([s.level for s in sources])
        self.weight = np.array([0.0 if np.isinf(s.spread) else s.spread**-2 for s in sources])

    def projection(self, logs: Floats) -> tuple[Floats, Floats, Floats, float]:
        """P, V^-1 X, (X' V^-1 X)^-1 and the logarithms of the determinants."""
        total = np.zeros_like(self.parts[0])
        for level, part in zip(np.exp(logs), self.parts, strict=True):
            total += level * part
        diagonal, info = np.diag_indices_from(total), 1
        while info:  # once, but for levels so unlike that the sum is singular to the last digit
            total[diagonal] *= 1.0 + 1e-10
            total[diagonal] += (info - 1) * 1e-12 * float(np.mean(total[diagonal]))
            factor, info = linalg.lapack.dpotrf(total, lower=1, clean=1)
        inverse, _ = linalg.lapack.dpotri(factor, lower=1)
        inverse += np.tril(inverse, -1).T
        weighed = inverse @ self.columns
        information = self.columns.T @ weighed
        small = np.linalg.inv(information)
        determinants = 2.0 * float(np.sum(np.log(np.diag(factor)))) + float(np.linalg.slogdet(information)[1])
        return inverse - weighed @ small @ weighed.T, weighed, small, determinants

    def __call__(self, logs: Floats) -> tuple[float, Floats]:
        p, _, _, determinants = self.projection(logs)
        weighted = p @ self.y
        away = logs - self.centre
        value = 0.5 * (determinants + float(self.y @ weighted) + float(self.weight @ away**2))
        traces = np.array([np.vdot(part, p) for part in self.parts])
        squares = np.array([weighted @ (part @ weighted) for part in self.parts])
        return value, 0.5 * np.exp(logs) * (traces - squares) + self.weight * away


def fit(y: Floats, columns: Floats, sources: Sequence[Source], start: Floats | None = None) -> Fit:
    """Fit `columns` (n, p), of full rank and of like size, to `y` (n,) under the sources' noise.

    `start`: levels, shape (sources,), where the search begins; otherwise the sources' own.
    """
    likelihood = _Likelihood(y, columns, sources)
    low, high = likelihood.centre - _REACH, likelihood.centre + _REACH
    begin = likelihood.centre if start is None else np.clip(np.log(start), low, high)
    found = optimize.minimize(
        likelihood, begin, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": _STEPS, "ftol": 1e-7},
    )  # fmt: skip
    logs = found.x
    projection, weighed, small, _ = likelihood.projection(logs)
    weighted = projection @ y
    levels = np.exp(logs)
    # Average information of the logarithms (Gilmour, Thompson and Cullis 1995), with what was known beforehand.
    pulled = np.stack(
        [level * (part @ weighted) for level, part in zip(levels, likelihood.parts, strict=True)]
    )
    information = 0.5 * pulled @ projection @ pulled.T + np.diag(likelihood.weight)
    information += _FLAT * np.eye(levels.size)
    gradients = np.stack(
        [
            small @ (level * (weighed.T @ part @ weighed)) @ small
            for level, part in zip(levels, likelihood.parts, strict=True)
        ]
    )
    values = small @ (weighed.T @ y)
    return Fit(
        values, small, levels, -float(found.fun), projection, weighted, gradients, np.linalg.inv(information)
    )
