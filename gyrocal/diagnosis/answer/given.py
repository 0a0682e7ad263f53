"""A model that was given: what it explains already, and whether it still holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.smooth import SmoothTerm, columns_of
from gyrocal.physics.terms import Term, joint_covariance

Floats = NDArray[np.float64]

#: A surface has changed where the evidence is this strong and the change is above the noise of a data set.
_CHANGED_P = 1e-4


def without_terms(series: Series, coefficients: Coefficients | None) -> Series:
    """The recording less what the coefficient file has in its terms already."""
    if coefficients is None or not coefficients.terms:
        return series
    c = conditions_of(series)
    added = np.zeros(len(series))
    for term in coefficients.terms:
        if isinstance(term, SmoothTerm):
            added = added + columns_of(c, term.frame, term.columns)[0] @ term.coefficients_dps
        elif term.runtime:
            added = added + term.error_dps(c, coefficients.surface)
    return replace(series, gyro_dps=series.gyro_dps - added)


def with_terms(found: Coefficients, coefficients: Coefficients | None) -> Coefficients:
    """A file of what was found beside the terms of another, with these: how they go with the surface is known of the other's alone."""
    if coefficients is None:
        return found
    joint = joint_covariance(coefficients.covariance_dps2, coefficients.runtime_terms())
    first = coefficients.covariance_dps2.shape[0]
    kept: list[Term | SmoothTerm] = []
    for term in coefficients.terms:
        if isinstance(term, Term):
            bare = {n: {k: x for k, x in p.items() if k != "covariance"} for n, p in term.parameters.items()}
            kept.append(replace(term, parameters=bare))
        elif term.runtime:
            own = slice(first, first + len(term.columns))
            kept.append(replace(term, covariance_dps2=joint[own, own]))
        else:
            kept.append(term)
        first += len(term.part().rows) if term.runtime else 0
    return replace(found, terms=(*found.terms, *kept))


def simulated_residual(series: Series, coefficients: Coefficients) -> Floats:
    """Recording minus the sequence that the given surface predicts, deg/s, shape (n,)."""
    return np.asarray(series.gyro_dps - coefficients.surface.output_dps(series.rate_dps, series.temp_c))


def surface_change(found: Examination, coefficients: Coefficients, fitted: Coefficients) -> Located | None:
    """Whether the given surface is still that of the gyro: compared with the one found here, beside everything else.

    Both covariances count. A significant change below the noise of a data set is not worth a word.
    """
    means = found.whole.model.means
    rate, temp = means.rate_dps, means.temp_c
    here = fitted.surface.output_design(rate, temp)
    given = coefficients.surface.output_design(rate, temp)
    change_dps = coefficients.surface.output_dps(rate, temp) - fitted.surface.output_dps(rate, temp)
    carried = carried_terms(means.series)
    to_here = np.linalg.pinv(here[:, carried])
    change = to_here @ change_dps
    over = to_here @ given
    covariance = fitted.covariance_dps2[np.ix_(carried, carried)]
    covariance = covariance + over @ coefficients.covariance_dps2 @ over.T
    sets = means.is_set if means.is_set.any() else ~means.is_set
    rms = float(np.sqrt(np.mean(change_dps[sets] ** 2)))
    inverse = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    p = float(chi2.sf(change @ inverse @ change, carried.size))
    if p > _CHANGED_P or rms < float(np.sqrt(found.whole.fit.variance["white"])):
        return None
    where = "rate" if np.ptp(rate) > 0 else "temperature"
    return Located(where, "mean", p, 1.0, target="surface", rms_dps=rms)
