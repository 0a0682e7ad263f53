"""A law beside everything else in a model: how well it does at any shape, whatever that of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws, likeliest
from gyrocal.diagnosis.model.intervals import Point
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.diagnosis.result import Estimate
from gyrocal.inference.additive import Component
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import SCALED_AT_DPS, Effect

Floats = NDArray[np.float64]

#: A law of two parameters is as probable as its amplitude to minus this power.
_FALLS = 2.0
#: Shapes of other laws are known to within this ratio, one standard deviation, before the record tells more of them.
_KNOWN_TO = 2.0
#: Derivatives by the logarithm of a shape, between values of this ratio to it.
_BY = 1.02


@dataclass(frozen=True)
class Scan:
    """A law beside everything else in a model: how well it does at any shape.

    The amplitude stays within the bounds that the catalogue gives; a shape that fits best beyond them loses by that.

    Attributes
    ----------
    surface : ndarray, shape (n, p)
        Orthonormal basis of the surface's free terms.
    score, precision : ndarray, shape (n,), (n, n)
        ``P y`` and ``P`` of the rest of the model (`Contrasts.precision`).
    kind : mapping
        Values of the parameters that are chosen from a few; without any the best of them at every shape.
    """

    effect: Effect
    laws: Laws
    surface: Floats
    score: Floats
    precision: Floats
    kind: Mapping[str, float] = field(default_factory=dict)

    def at(self, shape: Mapping[str, float]) -> Point:
        """The point at a shape; a parameter that is chosen from a few values, and not refined, has the best of them."""
        kinds = [{**shape, **kind} for kind in self.kinds(shape)]
        points = [self.of(self.laws.at(self.effect, kind), kind) for kind in kinds]
        return min(points, key=lambda p: p.loss)

    def kinds(self, shape: Mapping[str, float]) -> list[Mapping[str, float]]:
        """Values on the grid of the parameters that are not refined."""
        if self.kind:
            return [self.kind]
        search = self.effect.search
        choices = [n for n in shape if n not in search.refined]
        grid = [s for s in search.grid(self.laws.offer) if s.keys() >= {*choices}]
        kinds = {tuple(s[n] for n in choices) for s in grid}
        return [dict(zip(choices, kind, strict=True)) for kind in sorted(kinds)] or [{}]

    def of_kind(self, shape: Mapping[str, float]) -> Scan:
        """The same at the values that a shape has of the parameters that are not refined."""
        return replace(self, kind={n: x for n, x in shape.items() if n not in self.effect.search.refined})

    def of(self, columns: Floats, shape: Mapping[str, float]) -> Point:
        """The point of a law's columns at a shape; of a cosine's and a sine's amplitudes the root of the sum of squares counts, of others the first."""
        information = columns.T @ self.precision @ columns
        if np.trace(information) < np.sqrt(np.finfo(float).tiny):
            # Its inverse would overflow: it says nothing of an amplitude.
            return Point(0.0, 0.0, float("inf"))
        covariance = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        b = covariance @ (columns.T @ self.score)
        size, along = float(b[0]), np.eye(b.size)[0]
        if b.size == 2 and any(p.name == "phase_rad" for p in self.effect.parameters):
            size = float(np.hypot(*b))
            along = b / size
        std = float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
        loss = -float(columns.T @ self.score @ b)
        if not std:
            return Point(0.0, size, float("inf"))
        amplitude, lost = likeliest(self.effect, size, std)
        if sum(n in shape for n in self.effect.search.refined) > 1:
            # Of a peak between two rates the higher ones all fit.
            lost += 2.0 * rarity(amplitude, std)
        beyond = columns - self.surface @ (self.surface.T @ columns)
        unit_dps = float(np.sqrt(np.mean(np.sum(beyond**2, axis=1))))
        return Point(loss + lost, amplitude, std, unit_dps)

    def on_scale(self, law: Law) -> Estimate:
        """Second amplitude of a law that acts on the scale factor beside the bias, at 100 deg/s."""
        covariance = np.linalg.inv(law.columns.T @ self.precision @ law.columns)
        b = covariance @ (law.columns.T @ self.score)
        at = SCALED_AT_DPS / law.shape["rate_scale_dps"]
        unit = self.effect.parameter("amplitude").unit
        return Estimate.normal(at * float(b[1]), at * float(np.sqrt(covariance[1, 1])), unit)


def rarity(amplitude: float, std: float) -> float:
    """What an amplitude loses beforehand by its size, nats; one that is not known counts as its standard deviation."""
    return _FALLS * float(np.log(max(abs(amplitude), std)))


def free_of(law: Law) -> list[str]:
    """Parameters of the shape of a law of one amplitude that are not chosen from a few."""
    refined = CATALOGUE[law.effect].search.refined
    return [n for n in refined if law.shape.get(n, 0.0) > 0.0 and law.columns.shape[1] == 1]


def shapes_of_others(fitted: Fitted, law: Law, laws: Laws) -> list[Component]:
    """What is not known of the shapes of a model's other laws, to first order; instants, and laws that are spread, stay as they are."""
    found, solution = [], fitted.solve()
    for other in fitted.model.laws:
        if other.effect == law.effect or other.from_end or other.spread or other.mixture:
            continue
        effect, amplitude = CATALOGUE[other.effect], float(solution.amplitudes[other.name][0])
        for name in (n for n in free_of(other) if n != "at_s"):
            high, low = (
                laws.at(effect, {**other.shape, name: other.shape[name] * ratio})
                for ratio in (_BY, 1.0 / _BY)
            )
            slope = amplitude * np.log(_KNOWN_TO) / (2.0 * np.log(_BY)) * (high - low)
            found.append(Component(f"{name} of {other.name}", slope, held=1.0))
    return found


def scan_of(
    fitted: Fitted, law: Law, laws: Laws, without: Sequence[str], more: Sequence[Component] = ()
) -> Scan:
    """A law beside a model.

    Parameters
    ----------
    without : components that the law takes the place of
    more : what is not known of the model, each of variance one
    """
    effect, model = CATALOGUE[law.effect], fitted.model.without(without)
    # One law that was found in two blocks is one; plays and jumps may be several.
    several = effect.search.adds_up or "at_s" in law.shape
    same = [x.name for x in model.laws if x.name == law.name or (x.effect == law.effect and not several)]
    others = [c for c in model.all if c.name not in same]
    surface, _ = np.linalg.qr(model.design[:, model.flat])
    logs = {**fitted.fit.log_variance} | fitted.contrasts.logs(more, {c.name: 1.0 for c in more})
    score, p = fitted.contrasts.precision([*others, *more], logs)
    return Scan(effect, laws, surface, score, p)
