"""Compensation with everything that a coefficient file holds: the surface, and the physics that `diagnose` added."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import CoefficientError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, Coefficients
from gyrocal.physics.effect import Conditions, Memory
from gyrocal.physics.terms import gradients, joint_covariance, runtime_term, solve_rate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Corrected:
    """Corrected rates, standard deviations of the error that was taken away, deg/s, and flags; shape (n,)."""

    rate_dps: Floats
    sigma_dps: Floats
    flags: NDArray[np.int64]


class Compensator:
    """Corrects a stream of samples; blocks of any size, and single samples, give the same numbers.

    Effects add to the output of a gyro that has the surface alone (`solve_rate`). Feed samples in time order.

    Attributes
    ----------
    terms : tuple of RuntimeTerm
    not_applied : tuple of str
        Effects of the bench (``runtime: false``), which a robot does not see.

    Raises
    ------
    CoefficientError
        A term that this program does not know, or that a robot cannot evaluate.
    """

    def __init__(self, coefficients: Coefficients) -> None:
        self.coefficients = coefficients
        self.terms = tuple(
            runtime_term(term.effect, term.parameters) for term in coefficients.terms if term.runtime
        )
        self.not_applied = tuple(term.effect for term in coefficients.terms if not term.runtime)
        self._covariance = joint_covariance(coefficients.covariance_dps2, self.terms)
        self._memories: list[Memory] = [None] * len(self.terms)
        self._tangents: list[Memory] = [None] * sum(len(term.covariance) for term in self.terms)

    def correct(
        self,
        t_s: ArrayLike,
        gyro_dps: ArrayLike,
        temp_c: ArrayLike,
        since_power_on_s: ArrayLike | None = None,
    ) -> Any:
        """Corrected rate, deg/s; scalars in, float out. NaN where there is no solution or no finite input.

        Raises
        ------
        CoefficientError
            A term needs the time since power-on, and it was not given.
        """
        rate, _ = self._solve(*self._channels(t_s, gyro_dps, temp_c, since_power_on_s))
        return float(rate[0]) if np.ndim(gyro_dps) == 0 else rate

    def evaluate(
        self,
        t_s: ArrayLike,
        gyro_dps: ArrayLike,
        temp_c: ArrayLike,
        since_power_on_s: ArrayLike | None = None,
    ) -> Corrected:
        """`correct`, with standard deviations and the flags of `Coefficients.flags`.

        The standard deviation is that of the predicted error: covariance of surface and terms where the file has
        it, otherwise the uncertainty of each amplitude by itself. The noise of the sample is not in it.
        """
        gyro, c = self._channels(t_s, gyro_dps, temp_c, since_power_on_s)
        rate, errors = self._solve(gyro, c)
        surface = self.coefficients.surface
        with np.errstate(over="ignore", invalid="ignore"):
            slopes, self._tangents = gradients(
                surface, self.terms, self._tangents, errors, replace(c, rate_dps=rate)
            )
            design = np.column_stack([surface.design(gyro - sum(errors), c.temp_c), slopes])
            variance = ((design @ self._covariance) * design).sum(axis=1)
            for error, term in zip(errors, self.terms, strict=True):
                if not term.covariance:
                    variance = variance + (error * term.relative_sigma) ** 2
            sigma = np.sqrt(np.maximum(variance, 0.0))
        flags = self.coefficients.flags(gyro, c.temp_c) | np.where(np.isfinite(rate), 0, FLAG_NOT_FINITE)
        return Corrected(rate, sigma, flags)

    def _channels(
        self, t_s: ArrayLike, gyro_dps: ArrayLike, temp_c: ArrayLike, since_power_on_s: ArrayLike | None
    ) -> tuple[Floats, Conditions]:
        missing = [t.effect.id for t in self.terms if "since_power_on_s" in t.effect.needs]
        if since_power_on_s is None and missing:
            raise CoefficientError(
                f"The coefficients hold {missing[0]}, which needs the time since power-on: give it, or remove the term."
            )
        given = (t_s, gyro_dps, temp_c, np.nan if since_power_on_s is None else since_power_on_s)
        t, gyro, temp, since = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(x, dtype=float)) for x in given)
        )
        return gyro, Conditions(t, gyro, temp, since_power_on_s=since)

    def _solve(self, gyro: Floats, c: Conditions) -> tuple[Floats, list[Floats]]:
        rate, errors, self._memories = solve_rate(
            self.coefficients.surface, self.terms, self._memories, gyro, c
        )
        return rate, errors


def correct_without_history(coefficients: Coefficients, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Any:
    """Corrected rate from output and temperature alone; refuses terms that need more."""
    compensator = Compensator(coefficients)
    for term in compensator.terms:
        if term.effect.has_memory or "since_power_on_s" in term.effect.needs:
            raise CoefficientError(
                f"The coefficients hold {term.effect.id}, which depends on time: use gyrocal.fusion.Compensator."
            )
    return compensator.correct(0.0, gyro_dps, temp_c)
