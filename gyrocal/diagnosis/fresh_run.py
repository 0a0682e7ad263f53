"""Whether a coefficient file makes another run of the same gyro better than the surface alone does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gyrocal.diagnosis.means import Means
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.terms import joint_covariance, sensitivity, solve_rate

Floats = NDArray[np.float64]

#: Orders of the rates that the probability is a mean over: they change it by a few hundredths.
_RUNS = 4
#: Of these orders: the same record gives the same file.
_SEED = 30


def chance_of_gain(improved: Coefficients, surface: Coefficients, means: Means) -> float:
    """Probability that `improved` errs less than `surface` on a run through the same temperatures, its rates in any order.

    Where the two differ by `d` and the improved rate errs by `e`, of the covariance that its file states, the square of
    the error falls by ``d (d - 2 e)``, which is normal.
    """
    rng = np.random.default_rng(_SEED)
    t_s, since_s = means.t_s, means.t_s - means.t_s[0]
    chances = []
    for _ in range(_RUNS):
        channels = t_s, rng.permutation(means.gyro_dps), means.temp_c, since_s, means.supply_v
        d = Compensator(surface).correct(*channels) - Compensator(improved).correct(*channels)
        d = np.where(np.isfinite(d), d, 0.0)
        spread = 2.0 * _sigma_of_sum(
            d,
            improved,
            Conditions(t_s, channels[1], means.temp_c, since_power_on_s=since_s, supply_v=means.supply_v),
        )
        chances.append(norm.cdf(float(d @ d) / spread) if spread > 0.0 else 0.5)
    return float(np.mean(chances))


def _sigma_of_sum(weights: Floats, coefficients: Coefficients, c: Conditions) -> float:
    """Standard deviation, by the calibration, of a weighted sum of corrected rates; `c.rate_dps` is the output, deg/s."""
    surface, terms = coefficients.surface, coefficients.runtime_terms()
    blank: list[Memory] = [None] * len(terms)
    solved = solve_rate(surface, terms, blank, c.rate_dps, c)
    at_rate = replace(c, rate_dps=solved.rate_dps)
    tangents = [
        term.tangent(at_rate, surface, error, None)[0]
        for term, error in zip(terms, solved.errors_dps, strict=True)
    ]
    along = weights @ sensitivity(surface, terms, tangents, solved, c, blank)
    return float(
        np.sqrt(max(float(along @ joint_covariance(coefficients.covariance_dps2, terms) @ along), 0.0))
    )
