"""Whether a coefficient file makes another run of the same gyro better than the surface alone does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gyrocal.calibration.checks import no_rate_text
from gyrocal.calibration.groups import distinct
from gyrocal.diagnosis.means import Means
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Improvement
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.surface import RATE_ORDER, TEMPERATURE_ORDER
from gyrocal.physics.terms import joint_covariance, sensitivity, solve_rate

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Runs that the probability is a mean over: their rates change it by a few hundredths.
_RUNS = 4
#: Of their rates: the same record gives the same file.
_SEED = 30


def chance_of_gain(improved: Coefficients, surface: Coefficients, means: Means) -> float:
    """Probability that `improved` errs less than `surface` on a run through the same temperatures, at rates from all of the range.

    At those that were visited alone a file may be sure, and guess between them.

    Where the two differ by `d` and the improved rate errs by `e`, of the covariance that its file states, the square of
    the error falls by ``d (d - 2 e)``, which is normal.
    """
    rng = np.random.default_rng(_SEED)
    t_s, since_s = means.t_s, means.t_s - means.t_s[0]
    outputs = float(means.gyro_dps.min()), float(means.gyro_dps.max())
    chances = []
    for _ in range(_RUNS):
        channels = t_s, rng.uniform(*outputs, len(means)), means.temp_c, since_s, means.supply_v
        d = Compensator(surface).correct(*channels) - Compensator(improved).correct(*channels)
        d = np.where(np.isfinite(d), d, 0.0)
        spread = 2.0 * _sigma_of_sum(
            d,
            improved,
            Conditions(t_s, channels[1], means.temp_c, since_power_on_s=since_s, supply_v=means.supply_v),
        )
        chances.append(norm.cdf(float(d @ d) / spread) if spread > 0.0 else 0.5)
    return float(np.mean(chances))


def without_rate(coefficients: Coefficients, means: Means) -> Ints:
    """Rows of the means whose output no rate gives."""
    since_s = means.t_s - means.t_s[0]
    rate_dps = Compensator(coefficients).correct(
        means.t_s, means.gyro_dps, means.temp_c, since_s, means.supply_v
    )
    return np.flatnonzero(~np.isfinite(rate_dps))


def need_rates(name: str, surface: Coefficients, means: Means) -> None:
    """Refuse a recording in which nothing was found and whose surface gives some outputs no rate: it says nothing of the gyro.

    Raises
    ------
    DataError
        With where, and what to do.
    """
    lost = without_rate(surface, means)
    if lost.size:
        text = no_rate_text(lost.size, float(means.rate_dps[lost[0]]), float(means.temp_c[lost[0]]))
        raise DataError(f"{name}: by the fitted surface {text}. Record smaller rates, or leave these out.")


def no_file(improved: Coefficients, means: Means, chance: float, left_out: Improvement | None) -> Remark:
    """Why no file is written where a gain is not sure: what the recording lacks, else what the gain itself says.

    Parameters
    ----------
    chance : probability of a gain
    left_out : what the model gained on data left out, where that was asked
    """
    if (lost := without_rate(improved, means)).size:
        first = {"rate_dps": float(means.rate_dps[lost[0]]), "temp_c": float(means.temp_c[lost[0]])}
        return Remark(Said.NO_INVERSE, {"count": int(lost.size), **first})
    rates, temps = distinct(means.rate_dps), distinct(means.temp_c)
    facts = {
        "chance": chance,
        "rates": rates if rates <= RATE_ORDER + 1 else 0,
        "temps": temps if temps <= TEMPERATURE_ORDER + 1 else 0,
        "one_way": bool(means.rate_dps.min() >= 0.0 or means.rate_dps.max() <= 0.0),
        "no_gain": left_out is not None and left_out.logloss_interval_95[0] <= 0.0,
    }
    return Remark(Said.NO_SURE_GAIN, facts)


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
    by_row = sensitivity(surface, terms, tangents, solved, c, blank)
    # An output that no rate gives has no derivative either.
    along = weights @ np.where(weights[:, None] != 0.0, by_row, 0.0)
    return float(
        np.sqrt(max(float(along @ joint_covariance(coefficients.covariance_dps2, terms) @ along), 0.0))
    )
