"""Shape of a pattern within data sets: where it fits best, and how far it may be from there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from gyrocal.diagnosis.intervals import (
    Point,
    Profile,
    amplitude_interval,
    profile_interval,
    shapes_within,
)
from gyrocal.physics.effect import Effect
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]

#: The interval of a shape is sought within this ratio of the best.
_REACH = 9.0


@dataclass(frozen=True)
class ShapeWithin:
    """A pattern beside the others that were found: how well it does at any shape.

    Attributes
    ----------
    columns : callable
        Columns at a shape, freed of the means of the sets, weighted by the white noise.
    left, others : ndarray, shape (rows,), (rows, q)
        What the other patterns leave of the record, and an orthonormal basis of them.
    inflation : float
        Variance of the amplitude from the scatter between sets, over that of white noise.
    """

    effect: Effect
    columns: Callable[[Mapping[str, float]], Floats]
    left: Floats
    others: Floats
    inflation: float = 1.0

    def at(self, shape: Mapping[str, float]) -> Point:
        """At a shape; of two amplitudes their size counts."""
        x = self.columns(shape)
        x = x - self.others @ (self.others.T @ x)
        covariance = np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
        b = covariance @ (x.T @ self.left)
        size = float(np.linalg.norm(b)) if b.size > 1 else float(b[0])
        along = b / size if size else np.ones(b.size)
        std = float(np.sqrt(self.inflation * along @ covariance @ along))
        return Point(-float(b @ x.T @ self.left) / self.inflation, size, std or float("inf"))

    def intervals(
        self, shape: Mapping[str, float], amplitudes: Floats, covariance: Floats, dof: float
    ) -> tuple[dict[str, Profile], Profile]:
        """Of each parameter of the shape, and of the amplitude, which is traded against them.

        Parameters
        ----------
        amplitudes, covariance, dof : at `shape`, from the scatter between the sets
        """
        along = amplitudes / np.linalg.norm(amplitudes)
        std = float(np.sqrt(along @ covariance @ along)) * float(student.ppf(0.975, dof)) / NORMAL_95
        beside = replace(self, inflation=(std / self.at(shape).std) ** 2)
        profiles, points = {}, [beside.at(shape)]
        for name in beside.free(shape):
            known = self.effect.parameter(name)
            loss = partial(beside._loss, shape, name)
            own = profile_interval(loss, shape[name], _REACH, (known.low, known.high))
            profiles[name] = own
            points += [beside.at({**shape, name: float(x)}) for x in shapes_within(own.interval)]
        return profiles, amplitude_interval(points)

    def free(self, shape: Mapping[str, float]) -> list[str]:
        """Parameters that are refined."""
        return [n for n in self.effect.search.refined if shape.get(n, 0.0) > 0.0]

    def _loss(self, shape: Mapping[str, float], name: str, value: float) -> float:
        return self.at({**shape, name: value}).loss
