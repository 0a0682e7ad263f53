"""The surface alone: what stands in the answer for the gyro before anything was found.

Over data sets it is the one that `gyrocal fit` would choose: direction, terms and weights by the error left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.checks import MOST_DATA_SETS
from gyrocal.calibration.choice import bias_model, fit_chosen, rms_over_temperature, shift_by_left_out
from gyrocal.calibration.coarsen import coarsen
from gyrocal.calibration.datasets import DataSets
from gyrocal.diagnosis.answer.correction import file_without_surface
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.model.layers import Fitted
from gyrocal.diagnosis.model.parts import EACH_RATE, SURFACE, design_at, legendre_to_powers, passing
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.means import Means
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.inference.additive import Component, solve
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]

#: With fewer data sets than this for each term nothing can be left out to choose by.
_SETS_A_TERM = 2


def surface_alone(found: Examination) -> Coefficients:
    """The error surface of a recording without anything beside it."""
    fitted = found.whole
    means = fitted.model.means
    rows = np.flatnonzero(means.is_set)
    carried = carried_terms(means.series)
    # The orders of the temperature at one rate are a bias over temperature.
    at_one_rate = bool(np.all(carried < SHAPE[1]))
    if rows.size < _SETS_A_TERM * carried.size or not (at_one_rate or carried.size == len(SURFACE)):
        return _under_noise_found(fitted)
    sets = coarsen(_data_sets(means).select(rows), MOST_DATA_SETS)[0]
    chosen = fit_chosen(sets, model=bias_model(sets, carried.size - 1) if at_one_rate else None).fit
    return replace(
        file_without_surface(fitted), surface=chosen.surface, covariance_dps2=chosen.covariance_dps2
    )


def _data_sets(means: Means) -> DataSets:
    """Rows of the means as `gyrocal fit` takes them; what it would not use of them is unknown."""
    n, series = len(means), means.series
    unknown = np.full(n, np.nan)
    # Where the noise of a sample is known, that of the mean is; a table that says nothing of it has rows that are all alike.
    white = means.white_dps if series.states_noise else unknown
    return DataSets(
        rate_dps=means.rate_dps,
        gyro_dps=means.gyro_dps,
        temp_c=means.temp_c,
        gyro_std_dps=white,
        n=np.ones(n),
        gyro_peak_dps=unknown,
        t_s=means.t_s if series.has_time else unknown,
        duration_s=means.to_s - means.from_s,
        temp_rate_c_per_min=means.spread(series.temp_rate_c_per_min),
        averaging_s=unknown,
        segment=means.set_index + 1,
        outcome=np.full(n, "ok"),
        kind=np.full(n, "rate"),
        reference=np.full(n, "given"),
    )


def _under_noise_found(fitted: Fitted) -> Coefficients:
    """Of a record that does not carry all twelve terms: those that it carries, under the noise that was found."""
    model, frame = fitted.model, fitted.model.basis.frame
    means = model.means
    carried = carried_terms(means.series)
    kept = {EACH_RATE, *(c.name for c in passing(means, frame) if c.covariance is not None)}
    noise = [c for n, c in model.components.items() if n in kept]
    columns = design_at(means.gyro_dps, means.temp_c, frame)[:, carried]
    solution = solve(means.error_dps, columns, noise, fitted.fit.variance)
    gain = legendre_to_powers()[:, carried]
    c = gain @ solution.flat
    # Where the bias wanders its level is known for an instant only: the surface takes the mean of the recording.
    c[0] += float(np.mean(solution.left))
    covariance = gain @ solution.covariance[: carried.size, : carried.size] @ gain.T
    # What the surface leaves beyond the noise the file errs by, too.
    left = means.error_dps - columns @ solution.flat
    noise_dps2 = sum(fitted.fit.variance[n.name] * _spread_of(n) for n in noise)
    covariance[0, 0] += max(float(np.mean(left**2 - noise_dps2)), 0.0)
    surface = Surface(c.reshape(SHAPE), 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c)
    alone = replace(file_without_surface(fitted), surface=surface, covariance_dps2=covariance)
    return with_undetermined(alone, means)


def with_undetermined(file: Coefficients, means: Means) -> Coefficients:
    """A file with what the terms may be that the temperatures of a record do not tell from the others, and that are nothing in its surface.

    A bend between two temperatures may be as large as what differs from the one to the other.
    """
    surface = file.surface
    kept = np.isin(np.arange(len(SURFACE)), carried_terms(means.series))
    own_dps = means.rate_dps if surface.direction == "input" else means.gyro_dps
    columns = surface.design(own_dps, means.temp_c)
    shift = rms_over_temperature(surface, columns) * shift_by_left_out(columns, kept)
    return replace(file, covariance_dps2=file.covariance_dps2 + shift @ shift.T)


def _spread_of(component: Component) -> Floats:
    """Variance of each row by a component of variance one, shape (n,)."""
    if component.columns is not None:
        return np.asarray(np.sum(component.columns**2, axis=1))
    return np.diag(np.asarray(component.covariance))
