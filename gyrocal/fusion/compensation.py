"""Compensation with everything that a coefficient file holds: the surface, and the physics that `diagnose` added."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import CoefficientError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_TERM, Coefficients
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.terms import Solution, joint_covariance, sensitivity, solve_rate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Corrected:
    """Corrected rates, their standard deviations by the calibration, deg/s, and flags; shape (n,)."""

    rate_dps: Floats
    sigma_dps: Floats
    flags: NDArray[np.int64]


class Compensator:
    """Corrects a stream of samples; blocks of any size, and single samples, give the same numbers.

    Effects add to the output of a gyro that has the surface alone (`solve_rate`). Feed samples in time order.

    Attributes
    ----------
    terms : tuple of Part
    not_applied : tuple of str
        Terms that a robot does not see: effects of the bench (``runtime: false``).
    memories : list
        What the terms remember of the samples so far; each block makes a new one.

    CoefficientError for a term that this program does not know, or that a robot cannot evaluate.
    """

    def __init__(self, coefficients: Coefficients) -> None:
        self.coefficients = coefficients
        self.terms = coefficients.runtime_terms()
        self.not_applied = tuple(term.name for term in coefficients.terms if not term.runtime)
        self._covariance = joint_covariance(coefficients.covariance_dps2, self.terms)
        self.memories: list[Memory] = [None] * len(self.terms)
        self._courses: list[Memory] = [None] * len(self.terms)

    def correct(
        self, t_s: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike,
        since_power_on_s: ArrayLike | None = None, supply_v: ArrayLike | None = None,
    ) -> Any:  # fmt: skip
        """Corrected rate, deg/s; scalars in, float out. NaN where there is no solution or no finite input.

        A supply that is not read (NaN) counts as that of the recording. CoefficientError where a term needs the time since
        power-on, and it was not given.
        """
        gyro, c = self._channels(t_s, gyro_dps, temp_c, since_power_on_s, supply_v)
        rate = self._solve(gyro, c).rate_dps
        return float(rate[0]) if np.ndim(gyro_dps) == 0 else rate

    def evaluate(
        self, t_s: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike,
        since_power_on_s: ArrayLike | None = None, supply_v: ArrayLike | None = None,
    ) -> Corrected:  # fmt: skip
        """`correct`, with standard deviations and the flags of `Coefficients.flags`.

        The standard deviation is that of the rate by the uncertainty of surface and terms: their joint covariance
        where the file has it, otherwise that of each term by itself. The noise of the sample is not in it.
        """
        gyro, c = self._channels(t_s, gyro_dps, temp_c, since_power_on_s, supply_v)
        before = self.memories
        solved = self._solve(gyro, c)
        at_rate = replace(c, rate_dps=solved.rate_dps)
        surface, flags = self.coefficients.surface, self.coefficients.flags(gyro, c.temp_c)
        flags = flags | np.where(np.isfinite(solved.rate_dps), 0, FLAG_NOT_FINITE)
        tangents = []
        with np.errstate(over="ignore", invalid="ignore"):
            for k, (term, error) in enumerate(zip(self.terms, solved.errors_dps, strict=True)):
                tangent, self._courses[k] = term.tangent(at_rate, surface, error, self._courses[k])
                tangents.append(tangent)
                flags = flags | FLAG_TERM * term.beyond(at_rate, tangent)
            by = sensitivity(surface, self.terms, tangents, solved, c, before)
            sigma = np.sqrt(np.maximum(((by @ self._covariance) * by).sum(axis=1), 0.0))
        return Corrected(solved.rate_dps, sigma, flags)

    def _channels(self, *channels: ArrayLike | None) -> tuple[Floats, Conditions]:
        missing = [t.name for t in self.terms if "since_power_on_s" in t.channels]
        if channels[3] is None and missing:
            raise CoefficientError(
                f"The coefficients hold {missing[0]}, which needs the time since power-on: give it, or remove the term."
            )
        given = (np.atleast_1d(np.asarray(np.nan if x is None else x, dtype=float)) for x in channels)
        t, gyro, temp, since, supply = np.broadcast_arrays(*given)
        return gyro, Conditions(t, gyro, temp, since_power_on_s=since, supply_v=supply)

    def _solve(self, gyro: Floats, c: Conditions) -> Solution:
        solved = solve_rate(self.coefficients.surface, self.terms, self.memories, gyro, c)
        self.memories = solved.memories
        return solved
