"""Errors of single rates of which a few are far larger than the others: heavy tails in place of one variance.

One variance for all rates that a few have raised lets every rate err as much, and what is smooth in the rate follows the
few. Each error is normal with a variance of its own, all of them from one law of heavy tails: a scale mixture, with an
inverse gamma distribution of one degree of freedom for the variances (Cauchy's law of the errors).

References
----------
Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989): the t distribution as a scale mixture.
Jaakkola and Jordan, Stat. Comput. 10 (2000): a bound of the evidence from the distributions of such scales.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, gammaln

from gyrocal.diagnosis.model.layers import Fitted, Law, Model
from gyrocal.diagnosis.model.parts import EACH_RATE
from gyrocal.inference.additive import Component, Solution
from gyrocal.physics.rate import REFERENCE_RATE_ERROR
from gyrocal.units import PPM

Floats = NDArray[np.float64]

#: Degrees of freedom of the law of the errors: the fewest that are usual, of the heaviest tails.
_FREEDOM = 1.0
#: Rounds of the variances by turns with what they are a part of, and what a round must gain, nats.
_ROUNDS, _GAINS = 20, 0.1
#: Rates whose errors are told, at most.
_MOST_SAID = 3


def with_tails(full: Model, fitted: Fitted) -> tuple[Model, Fitted]:
    """The model and its fit with heavy tails of the errors of single rates, where they are the likelier account.

    Parameters
    ----------
    full : the model of all components, of which the fit has those that are alive
    """
    plain = fitted.model.components.get(EACH_RATE)
    if plain is None or plain.columns is None:
        return full, fitted
    best, here = fitted, fitted
    share, level, before = np.ones(plain.columns.shape[1]), 1.0, np.inf
    for _ in range(_ROUNDS):
        # The fitted variance is that of all errors on the average, `level` times the one that is common to them.
        excess = level * share * _excess(here)
        share = (_FREEDOM + excess) / (_FREEDOM + 1.0)
        level = float(np.mean(share))
        share /= level
        tailed = Component(EACH_RATE, plain.columns * np.sqrt(share), toll=float(np.sum(toll(excess))))
        here = here.refit(here.model.with_components(tailed))
        best = min(best, here, key=lambda f: f.nll)
        if here.nll > before - _GAINS:
            break
        before = here.nll
    return full.with_components(best.model.components[EACH_RATE]), best


def size_ppm(fitted: Fitted) -> float:
    """Standard deviation of the errors of single rates, relative to each."""
    scale_dps = fitted.model.basis.frame.rate_scale_dps
    return float(np.sqrt(fitted.fit.variance[EACH_RATE])) / scale_dps / PPM


def of_a_table(fitted: Fitted) -> bool:
    """Whether a table errs by as little: what is more, as about the edges of a dead zone, is the gyro's."""
    (size, *_) = REFERENCE_RATE_ERROR.parameters
    return size_ppm(fitted) < size.high


def is_beyond_a_table(fitted: Fitted, laws: Sequence[Law]) -> bool:
    """Whether laws make more of some rate than a table errs by, as a dead zone does of small ones."""
    (size, *_) = REFERENCE_RATE_ERROR.parameters
    amplitudes, rate_dps = fitted.solve().amplitudes, np.abs(fitted.model.means.felt_dps)
    added_dps = np.sum([law.columns @ amplitudes[law.name] for law in laws], axis=0)
    return bool(np.any((np.abs(added_dps) > size.high * PPM * rate_dps) & (rate_dps > 0.0)))


def largest(fitted: Fitted) -> list[tuple[float, float, float]]:
    """The rates with the largest errors, deg/s, with these and their standard deviations, ppm."""
    columns, means = np.asarray(fitted.model.components[EACH_RATE].columns), fitted.model.means
    solution = fitted.solve()
    errors, stds = _amplitudes(solution)
    rows = np.argmax(np.abs(columns), axis=0)
    to_ppm = np.diag(columns[rows]) / means.felt_dps[rows] / PPM
    told = np.column_stack([np.abs(means.rate_dps[rows]), errors * to_ppm, stds * np.abs(to_ppm)])
    order = np.argsort(-np.abs(told[:, 1]))[:_MOST_SAID]
    return [(rate, error, std) for rate, error, std in told[order].tolist()]


def _amplitudes(solution: Solution) -> tuple[Floats, Floats]:
    """Amplitudes of the columns, and their standard deviations."""
    found, first = solution.amplitudes[EACH_RATE], solution.starts[EACH_RATE]
    return found, np.sqrt(np.diag(solution.covariance)[first : first + found.size])


def _excess(fitted: Fitted) -> Floats:
    """Expected square of each column's amplitude over its variance, shape (sizes of rate,)."""
    found, stds = _amplitudes(fitted.solve())
    return np.asarray((found**2 + stds**2) / fitted.fit.variance[EACH_RATE])


def toll(excess: Floats) -> Floats:
    """What the scale of each error costs beside a model that has it as given, nats: an upper bound.

    Parameters
    ----------
    excess : ndarray
        Expected square of each error over the variance that is common to all.
    """
    before, after = 0.5 * _FREEDOM, 0.5 * (_FREEDOM + 1.0)
    rate = 0.5 * (_FREEDOM + excess)
    from_prior = (
        (after - before) * digamma(after)
        - gammaln(after)
        + gammaln(before)
        + before * np.log(rate / before)
        + after * (before - rate) / rate
    )
    return np.asarray(from_prior + 0.5 * (np.log(after) - digamma(after)))
