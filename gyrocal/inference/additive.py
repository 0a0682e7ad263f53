"""An additive Gaussian model whose variances are estimated together, by restricted maximum likelihood.

``y = X b + sum_k Z_k a_k + n``, with `b` unknown (flat), ``a_k ~ N(0, s_k I)`` and noise ``n ~ N(0, sum_j s_j V_j)``.
Every variance may become zero: that is the whole guard against taking too much.

References
----------
Patterson and Thompson, Biometrika 58 (1971): likelihood of error contrasts.
Harville, J. Am. Stat. Assoc. 72 (1977): derivatives.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.inference.newton import descend
from gyrocal.inference.restricted import JITTER, Likelihood, Part, climb

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Bounds of the logarithm of a variance, relative to that of the record.
_LOW, _HIGH = -34.0, 1.0
#: Where a variance starts that nothing is known of.
START = -4.0
#: A part that has died in an earlier fit starts this far below at the most, or it could not come back.
_REVIVED = -7.0
#: Logarithms at which a component is tried that may be there or not.
_TRIED = np.linspace(-16.0, 4.0, 26)
#: Directions of a record that a fit looks at.
MOST_DIRECTIONS = 300
#: Of these, directions beside the span, which tell of the level of the noise.
_BESIDE = 40
#: Of these directions: the same record gives the same fit.
_SEED = 20
#: Singular values below this share of the largest are rounding.
_SAME_DIRECTION = 1e-9
#: Columns of which the flat ones lack no more than this share tell of no variance: what is left is rounding, or how a ramp of
#: the temperature is not quite straight, and an amplitude by it would be absurd elsewhere.
_BEYOND_FLAT = 1e-4
#: Information on the logarithm of a variance that a record tells nothing of: a factor of e^2 either way.
_VAGUE = 0.25
#: A column of less than this share of the information of others is the model's own, but for rounding.
_TELLS_NOTHING = 1e-9
#: Columns that LAPACK turns at a time.
_BLOCK = 64


@dataclass(frozen=True)
class Component:
    """A part of the model: columns with independent amplitudes of one variance, or a covariance of the rows.

    Attributes
    ----------
    name : str
    columns : ndarray, shape (n, q); None where `covariance` is given
    covariance : ndarray, shape (n, n)
    held : float, optional
        Its variance, in the unit of the record squared, where that is not to be estimated.
    expected : bool
        Whether it is believed however large it is: what every record of the kind has.
    toll : float
        What it costs beside its variance to have been given the shape that it has, nats.
    """

    name: str
    columns: Floats | None = None
    covariance: Floats | None = None
    held: float | None = None
    expected: bool = False
    toll: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Estimated variances.

    Attributes
    ----------
    log_variance : mapping
        Component to the natural logarithm of its variance relative to the record's, for a component of mean
        diagonal one.
    variance : mapping
        Component to its variance, in the square of the record's unit and for the columns as given.
    nll : float
        Negative log of the evidence under flat coefficients of `X`, nats.
    """

    log_variance: Mapping[str, float]
    variance: Mapping[str, float]
    nll: float


class Contrasts:
    """The record freed of its flat columns: all that the variances can be learned from.

    Parameters
    ----------
    y : ndarray, shape (n,)
    flat : ndarray, shape (n, p)
        Columns of unknown coefficients, of full rank.
    span : ndarray, shape (n, q), optional
        Of a long record only as many directions are looked at as a fit can be paid for: those of these columns
        first. Every choice of directions has a true likelihood; what is left out tells of the noise alone.
    whole : ndarray, shape (n, k), optional
        Columns of which nothing is left out: flat ones of models to come.
    like : Contrasts, optional
        Of another model of the record, with which this one is compared: it looks in the same directions, and its
        variances are in the same unit.
    """

    def __init__(
        self,
        y: Floats,
        flat: Floats,
        span: Floats | None = None,
        whole: Floats | None = None,
        like: Contrasts | None = None,
    ) -> None:
        self.y, self.flat = y, flat
        self.kept: Floats | None = None
        if like is not None:
            self.kept = like.kept
        elif span is not None and y.size > MOST_DIRECTIONS:
            self.kept = _directions(flat if whole is None else whole, span)
        seen = flat if self.kept is None else self.kept.T @ flat
        self._reflectors, self._tau = linalg.qr(seen / np.linalg.norm(seen, axis=0), mode="raw")[0]
        left = self._contrasts_of(y[:, None])[:, 0]
        own_unit = float(np.sqrt(np.mean(left**2))) or 1.0
        self.unit: float = own_unit if like is None else like.unit
        self._left = left / self.unit
        # With this the likelihood is the evidence under flat coefficients, comparable between flat columns.
        self._flat = float(np.linalg.slogdet(seen.T @ seen)[1]) / 2.0
        self._parts: dict[int, tuple[Component, Part]] = {}
        # Components in the directions that are looked in, which contrasts of other flat columns share.
        self._looked_at: dict[int, tuple[Component, Floats]] = {} if like is None else like._looked_at

    def part(self, component: Component) -> Part:
        """A component in the space of contrasts; kept, since models share most of them."""
        known = self._parts.get(id(component))
        if known is None or known[0] is not component:
            known = (component, self._projected(component))
            self._parts[id(component)] = known
        return known[1]

    def _projected(self, component: Component) -> Part:
        if component.columns is not None:
            factor = self._contrasts_of(component.columns)
            scale = float(np.sum(factor**2)) / factor.shape[0]
            whole = float(np.sum(component.columns**2)) / factor.shape[0]
            if scale < _BEYOND_FLAT**2 * whole:
                factor, scale = np.zeros_like(factor), whole
            factor = factor / np.sqrt(scale or 1.0)
            return Part(component.name, factor, None, scale or 1.0, component.expected)
        first = self.flat.shape[1]
        matrix = self._turned(self._turned(self._seen(component), "T").T, "T")[first:, first:]
        scale = float(np.trace(matrix)) / matrix.shape[0]
        whole = float(np.trace(np.asarray(component.covariance))) / matrix.shape[0]
        if scale < _BEYOND_FLAT**2 * whole:
            matrix, scale = np.zeros_like(matrix), whole
        return Part(component.name, None, matrix / (scale or 1.0), scale or 1.0, component.expected)

    def _seen(self, component: Component) -> Floats:
        """A covariance of the rows in the directions that are looked in."""
        covariance = np.asarray(component.covariance)
        if self.kept is None:
            return covariance
        known = self._looked_at.get(id(component))
        if known is None or known[0] is not component:
            known = (component, self.kept.T @ covariance @ self.kept)
            self._looked_at[id(component)] = known
        return known[1]

    def _turned(self, columns: Floats, way: Literal["N", "T"]) -> Floats:
        """Columns from contrasts, flat directions first (``N``), or to them (``T``)."""
        room = _BLOCK * columns.shape[1]
        found, _, _ = linalg.lapack.dormqr("L", way, self._reflectors, self._tau, columns, room)
        return np.asarray(found)

    def _contrasts_of(self, columns: Floats) -> Floats:
        """Columns in the space of contrasts, shape (m, q)."""
        seen = columns if self.kept is None else self.kept.T @ columns
        return self._turned(seen, "T")[self.flat.shape[1] :]

    def _rows_of(self, contrasts: Floats) -> Floats:
        """Columns in the space of contrasts as rows of the record, shape (n, q)."""
        padded = np.concatenate([np.zeros((self.flat.shape[1], contrasts.shape[1])), contrasts])
        seen = self._turned(padded, "N")
        return seen if self.kept is None else self.kept @ seen

    def fit(
        self,
        components: Sequence[Component],
        start: Mapping[str, float] | None = None,
    ) -> Fit:
        """Variances of the largest posterior, from `start` (logarithms) where it knows a component."""
        likelihood = Likelihood([self.part(c) for c in components], self._left)
        known = start or {}
        lowest = [START if c.expected else START + _REVIVED for c in components]
        first = np.array(
            [max(known.get(c.name, START), low) for c, low in zip(components, lowest, strict=True)]
        )
        bounds = np.tile([_LOW, _HIGH], (len(components), 1))
        for k, c in enumerate(components):
            if c.held is not None:
                bounds[k] = self.logs([c], {c.name: c.held})[c.name]
        found, there = descend(likelihood.at, climb(likelihood, first, bounds), bounds)
        found = np.where(there.idle, bounds[:, 0], found)
        logs = {c.name: float(x) for c, x in zip(components, found, strict=True)}
        return Fit(logs, self.variances(components, logs), there.value + self._beside(components))

    def variances(self, components: Sequence[Component], logs: Mapping[str, float]) -> dict[str, float]:
        """Variances in the unit of the record squared, from relative logarithms."""
        return {c.name: float(np.exp(logs[c.name])) * self.unit**2 / self.part(c).scale for c in components}

    def logs(self, components: Sequence[Component], variances: Mapping[str, float]) -> dict[str, float]:
        """Relative logarithms of variances in the unit of the record squared, none below the least that a fit finds."""
        shares = {c.name: variances[c.name] * self.part(c).scale / self.unit**2 for c in components}
        return {name: float(np.log(max(share, np.exp(_LOW)))) for name, share in shares.items()}

    def beyond(self, columns: Floats) -> Floats:
        """Columns freed of the flat ones, shape (n, q)."""
        return self._rows_of(self._contrasts_of(columns))

    def nll(self, components: Sequence[Component], logs: Mapping[str, float]) -> float:
        """Negative restricted log-likelihood at given variances."""
        likelihood = Likelihood([self.part(c) for c in components], self._left)
        value = likelihood.at(np.array([logs[c.name] for c in components])).value
        return value + self._beside(components)

    def expected(
        self, components: Sequence[Component], logs: Mapping[str, float], names: Collection[str]
    ) -> dict[str, float]:
        """Relative logarithms of variances, those of some components as they are to be expected, the others at their best.

        The likeliest variance of a component is often none at all, where a good deal would do nearly as well: it says nothing
        of what the component may add. Beforehand any standard deviation is as likely, but for the prior of `restricted`
        (Gelman, Bayesian Anal. 1, 2006).
        """
        likelihood = Likelihood([self.part(c) for c in components], self._left)
        best = np.array([logs[c.name] for c in components])
        found = dict(logs)
        for k, c in enumerate(components):
            if c.name in names:
                values = np.array(
                    [likelihood.at(np.where(np.arange(best.size) == k, x, best)).value for x in _TRIED]
                )
                weight = np.exp(values.min() - values + 0.5 * _TRIED)
                found[c.name] = max(float(np.log(weight @ np.exp(_TRIED) / weight.sum())), logs[c.name])
        return found

    def _beside(self, components: Sequence[Component]) -> float:
        """What a negative log-likelihood in the own unit lacks, nats."""
        return self._left.size * float(np.log(self.unit)) + self._flat + sum(c.toll for c in components)

    def precision(self, components: Sequence[Component], logs: Mapping[str, float]) -> tuple[Floats, Floats]:
        """``(P y, P)``: what a scan for further columns needs, shapes (n,) and (n, n).

        A column x raises the log-likelihood by up to ``(x' P y)^2 / (2 x' P x)``.
        """
        likelihood = Likelihood([self.part(c) for c in components], self._left)
        inverse = likelihood.inverse(np.array([logs[c.name] for c in components]))
        whole = self._rows_of(self._rows_of(inverse).T) / self.unit**2
        return whole @ self.y, whole


def _directions(whole: Floats, span: Floats) -> Floats:
    """All directions of `whole`, the strongest of a span, and some beside them, shape (n, MOST_DIRECTIONS)."""
    first, sizes, _ = linalg.svd(_normalised(whole), full_matrices=False)
    first = first[:, sizes > _SAME_DIRECTION * sizes[0]]
    room = MOST_DIRECTIONS - _BESIDE - first.shape[1]
    left = linalg.svd(_normalised(span), full_matrices=False)[0][:, : max(room, 0)]
    beside = np.random.default_rng(_SEED).standard_normal((whole.shape[0], _BESIDE))
    chosen, _ = linalg.qr(np.concatenate([first, left, beside], axis=1), mode="economic")
    return np.ascontiguousarray(chosen)


def _normalised(columns: Floats) -> Floats:
    return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


@dataclass(frozen=True)
class Solution:
    """Amplitudes at given variances: best linear unbiased prediction, with its covariance.

    Attributes
    ----------
    flat : ndarray, shape (p,)
    amplitudes : mapping
        Component to the amplitudes of its columns.
    covariance : ndarray, shape (p + q, p + q)
        Of flat coefficients and of the amplitudes of `order`, in this order; the error of the prediction.
    order : tuple of str
    left : ndarray, shape (n,)
        What flat columns and all components with columns leave.
    random : mapping
        Component to its predicted values at the rows, shape (n,), for those that are given by a covariance.
    """

    flat: Floats
    amplitudes: Mapping[str, Floats]
    covariance: Floats
    order: tuple[str, ...]
    left: Floats
    random: Mapping[str, Floats]

    @property
    def starts(self) -> dict[str, int]:
        """Component to the place of its first amplitude in `covariance`."""
        sizes = [len(self.flat), *(len(self.amplitudes[name]) for name in self.order)]
        return dict(zip(self.order, np.cumsum(sizes).tolist(), strict=False))


def solve(
    y: Floats, flat: Floats, components: Sequence[Component], variance: Mapping[str, float]
) -> Solution:
    """Amplitudes and their covariance at given variances (Henderson's mixed-model equations, in row space)."""
    noise = sum(
        (variance[c.name] * c.covariance for c in components if c.covariance is not None),
        np.zeros((y.size, y.size)),
    )
    parts = [c for c in components if c.columns is not None]
    stacked = np.concatenate([flat, *(c.columns for c in parts if c.columns is not None)], axis=1)
    prior = np.concatenate(
        [
            np.zeros(flat.shape[1]),
            *(np.full(c.columns.shape[1], variance[c.name]) for c in parts if c.columns is not None),
        ]
    )
    z = stacked[:, flat.shape[1] :]
    v = noise + (z * prior[flat.shape[1] :]) @ z.T
    v[np.diag_indices_from(v)] += JITTER * np.trace(v) / len(v)
    factor = linalg.cho_factor(v, lower=True, overwrite_a=True)
    vx = linalg.cho_solve(factor, flat)
    information = flat.T @ vx
    b = linalg.solve(information, vx.T @ y, assume_a="pos")
    p = flat.shape[1]
    # Error of the prediction: D - D Z'P Z D for the amplitudes, (X'V^-1X)^-1 for the flat ones, and across.
    vz = linalg.cho_solve(factor, z)
    inverse = linalg.inv(information)
    d = prior[p:]
    across = -inverse @ (vx.T @ z) * d
    zpz = z.T @ vz - (z.T @ vx) @ inverse @ (vx.T @ z)
    covariance = np.zeros((p + d.size, p + d.size))
    covariance[:p, :p] = inverse
    covariance[:p, p:] = across
    covariance[p:, :p] = across.T
    covariance[p:, p:] = np.diag(d) - d[:, None] * zpz * d
    a = d * (vz.T @ (y - flat @ b))
    ends = np.cumsum([0, *(c.columns.shape[1] for c in parts if c.columns is not None)])
    amplitudes = {c.name: a[i:j] for c, i, j in zip(parts, ends[:-1], ends[1:], strict=True)}
    weighted = linalg.cho_solve(factor, y - flat @ b)
    random = {
        c.name: variance[c.name] * (c.covariance @ weighted) for c in components if c.covariance is not None
    }
    return Solution(b, amplitudes, covariance, tuple(c.name for c in parts), y - flat @ b - z @ a, random)


def precision(
    y: Floats, flat: Floats, components: Sequence[Component], variance: Mapping[str, float]
) -> tuple[Floats, Floats]:
    """``(P y, P)`` of all rows at given variances, shapes (n,) and (n, n): what leaving rows out needs."""
    p = _freed(flat, components, variance)[0]
    return p @ y, p


def gains(columns: Floats, score: Floats, p: Floats, most: float = np.inf) -> Floats:
    """Twice the log-likelihood that each column gains by itself beside a model, shape (m,).

    Parameters
    ----------
    columns : ndarray, shape (n, m)
    score, p : of the model, as `Contrasts.precision` gives them
    most : amplitude that a column has at the most
    """
    information = np.einsum("ij,ij->j", columns, p @ columns)
    enough = information > _TELLS_NOTHING * np.max(information, initial=0.0)
    information = np.where(enough, information, 1.0)
    pull = columns.T @ score
    amplitude = np.clip(pull / information, -most, most)
    return np.where(enough, amplitude * (2.0 * pull - amplitude * information), 0.0)


def _freed(
    flat: Floats, components: Sequence[Component], variance: Mapping[str, float]
) -> tuple[Floats, Floats]:
    """``P = V^-1 (1 - X G)`` and ``G = (X' V^-1 X)^-1 X' V^-1``, shapes (n, n) and (p, n)."""
    v = np.zeros((len(flat), len(flat)))
    for c in components:
        v += variance[c.name] * adds(c)
    v[np.diag_indices_from(v)] += JITTER * np.trace(v) / len(v)
    inverse = linalg.inv(v)
    vx = inverse @ flat
    gain = linalg.solve(flat.T @ vx, vx.T, assume_a="pos")
    return inverse - vx @ gain, gain


def adds(component: Component) -> Floats:
    """What a component of unit variance adds to the covariance of the rows."""
    if component.columns is not None:
        return np.asarray(component.columns @ component.columns.T)
    return np.asarray(component.covariance)


def widened(
    y: Floats,
    flat: Floats,
    components: Sequence[Component],
    variance: Mapping[str, float],
    solution: Solution,
) -> Floats:
    """Covariance of a solution with that of the variances, which are estimates themselves, shape as its own.

    First order in the logarithms of the variances, whose covariance is the inverse of their expected information
    (Kackar and Harville, J. Am. Stat. Assoc. 79, 1984).
    """
    p, gain = _freed(flat, components, variance)
    score = p @ y
    size = len(components)
    information, pulls = np.zeros((size, size)), np.zeros((y.size, size))
    weighted: list[Floats] = []
    for k, c in enumerate(components):
        added = variance[c.name] * adds(c)
        pulls[:, k] = added @ score
        weighted.append(p @ added)
        information[k, : k + 1] = [0.5 * np.sum(w * weighted[k].T) for w in weighted]
    information += np.tril(information, -1).T
    information[np.diag_indices_from(information)] += _VAGUE
    spread = linalg.inv(information)
    moved = [-gain @ pulls]
    for k, c in enumerate(components):
        if c.columns is not None:
            change = -variance[c.name] * (c.columns.T @ (p @ pulls))
            change[:, k] += solution.amplitudes[c.name]
            moved.append(change)
    slopes = np.concatenate(moved)
    return np.asarray(solution.covariance + slopes @ spread @ slopes.T)
