"""Whether a coefficient file makes another run of the same gyro better than the surface alone does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gyrocal.calibration.checks import no_rate_text
from gyrocal.calibration.groups import distinct
from gyrocal.diagnosis.model.parts import since_on
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Improvement
from gyrocal.diagnosis.rows.means import Means
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

#: A file is written that makes another run of the gyro better with more than this probability. It is one under the model: of
#: 36 tables by the project's own generator none that was written was worse; of 25 by another hand, whose laws are others, 4
#: were, all of which had been given more than 0.99, before smooth parts stood beside the laws. Of 126 files from runs by
#: three authors 14 had less, of which 8 made another run worse and 5 better; of the 112 others 7 did, all of one author. Since
#: slow rates count, six of a fourth author's had less: one was worse (323 to 571 deg/h), five better.
_SURELY_BETTER = 0.8
#: Or one that errs less than this share of what the surface does: of five such files with less probability four erred by a
#: factor of 0.09 to 0.87 less, one by 1.08 more; of twelve others of less probability eight made another run worse.
_MUCH_BETTER = 0.75


@dataclass(frozen=True)
class Gain:
    """What a file may be expected to gain over the surface alone on another run.

    Attributes
    ----------
    chance : float
        Probability that it errs less.
    error_ratio : float
        Root mean square of its error, by that of the surface: 1 where nothing is to be gained.
    """

    chance: float
    error_ratio: float

    @property
    def is_enough(self) -> bool:
        """Whether the file is worth writing."""
        return self.chance > _SURELY_BETTER or self.error_ratio < _MUCH_BETTER


def gain_on_a_fresh_run(improved: Coefficients, surface: Coefficients, means: Means) -> Gain:
    """What `improved` gains over `surface` on a run through the same temperatures, at rates from all of the range.

    At those that were visited alone a file may be sure, and guess between them. Every second output is drawn evenly over the
    logarithm of its size: robots turn slowly for most of the time, and what is lost in a dead zone is lost there.

    Where the two differ by `d` and the improved rate errs by `e`, of the covariance that its file states, the square of
    the error falls by ``d (d - 2 e)``, which is normal.
    """
    rng = np.random.default_rng(_SEED)
    t_s, since_s = means.t_s, since_on(means)
    chances, own, its = [], 0.0, 0.0
    for _ in range(_RUNS):
        channels = t_s, _outputs(means, rng), means.temp_c, since_s, means.supply_v
        d = Compensator(surface).correct(*channels) - Compensator(improved).correct(*channels)
        d = np.where(np.isfinite(d), d, 0.0)
        c = Conditions(t_s, channels[1], means.temp_c, since_power_on_s=since_s, supply_v=means.supply_v)
        by_row, covariance = _uncertainty(improved, c)
        # An output that no rate gives has no derivative either.
        by_row = np.where((d != 0.0)[:, None] & np.isfinite(by_row), by_row, 0.0)
        along, square = d @ by_row, float(d @ d)
        spread = 2.0 * float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
        chances.append(norm.cdf(square / spread) if spread > 0.0 else 0.5)
        own += max(float(np.sum((by_row @ covariance) * by_row)), 0.0)
        its += square
    return Gain(float(np.mean(chances)), float(np.sqrt(own / (own + its))) if its > 0.0 else 1.0)


def _outputs(means: Means, rng: np.random.Generator) -> Floats:
    """Outputs within those of a record, in turn evenly over all of them and over the logarithm of their size, shape (n,)."""
    low, high = float(means.gyro_dps.min()), float(means.gyro_dps.max())
    drawn = rng.uniform(low, high, len(means))
    sizes = np.abs(means.rate_dps[means.rate_dps != 0.0])
    if sizes.size:
        least, share = float(sizes.min()), rng.uniform(size=len(means))
        ends = np.where(drawn < 0.0, low, high)
        slow = np.sign(ends) * least * np.maximum(np.abs(ends) / least, 1.0) ** share
        drawn[1::2] = slow[1::2]
    return drawn


def without_rate(coefficients: Coefficients, means: Means) -> Ints:
    """Rows of the means whose output no rate gives."""
    channels = means.t_s, means.gyro_dps, means.temp_c, since_on(means), means.supply_v
    rate_dps = Compensator(coefficients).correct(*channels)
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
        "surface_alone": not improved.terms,
    }
    return Remark(Said.NO_SURE_GAIN, facts)


def _uncertainty(coefficients: Coefficients, c: Conditions) -> tuple[Floats, Floats]:
    """Derivatives of the corrected rates by all parameters, shape (n, p), and their covariance; `c.rate_dps` is the output, deg/s."""
    surface, terms = coefficients.surface, coefficients.runtime_terms()
    blank: list[Memory] = [None] * len(terms)
    solved = solve_rate(surface, terms, blank, c.rate_dps, c)
    at_rate = replace(c, rate_dps=solved.rate_dps)
    tangents = [
        term.tangent(at_rate, surface, error, None)[0]
        for term, error in zip(terms, solved.errors_dps, strict=True)
    ]
    by_row = sensitivity(surface, terms, tangents, solved, c, blank)
    return by_row, joint_covariance(coefficients.covariance_dps2, terms)
