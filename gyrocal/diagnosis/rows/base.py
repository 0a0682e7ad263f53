"""The simulated sequence: what the error surface alone predicts for a recording, and its regression columns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.visited import temperatures_told
from gyrocal.errors import DataError
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: How a coefficient is expected to change with temperature, as a share of full scale over the temperatures of a record. At
#: one temperature alone nothing tells of it, and a wild guess would bend the surface at which the model is linearised. Only
#: that first surface is held by it; the model of the layers has all coefficients free.
_CHANGE_WITH_TEMPERATURE = 0.05
#: A coefficient that is told from the others only by temperatures that are this near to each other is not, degC.
_TOLD_APART_C = 0.1


@dataclass(frozen=True)
class Base:
    """Surface, simulated sequence and columns of a recording.

    Attributes
    ----------
    surface : Surface
    residual_dps : ndarray, shape (n,)
        Recording minus simulated sequence.
    design : ndarray, shape (n, p)
        Columns of the surface's coefficients that the record can carry, at the simulated output.
    terms : ndarray of int, shape (p,)
        Which of the 12 coefficients those are (row-major over rate and temperature order).
    """

    surface: Surface
    residual_dps: Floats
    design: Floats
    terms: Ints


def carried_terms(series: Series) -> Ints:
    """Coefficients that the rates and temperatures of a record can tell apart, shape (p,)."""
    rates = np.unique(np.round(series.rate_dps, 3)).size
    rate_order = min(SHAPE[0], rates)
    temp_order = min(SHAPE[1], temperatures_told(series.temp_c))
    # Few rows have something left to see in only beside fewer terms.
    while temp_order > 1 and 3 * rate_order * temp_order > 2 * len(series):
        temp_order -= 1
    i, j = np.divmod(np.arange(SHAPE[0] * SHAPE[1]), SHAPE[1])
    return _apart(series, np.flatnonzero((i < rate_order) & (j < temp_order)))


def _apart(series: Series, terms: Ints) -> Ints:
    """Those of some coefficients, the lower orders first, whose columns are more than a mixture of the others'.

    Rates and temperatures may be many, and every other rate visited at one temperature alone.
    """
    surface = blank_surface(series)
    design = surface.design(series.rate_dps, series.temp_c)
    apart = _TOLD_APART_C / surface.temp_scale_c
    i, j = np.divmod(terms, SHAPE[1])
    basis = np.empty((len(series), 0))
    kept: list[int] = []
    for k in terms[np.lexsort((j, i + j))].tolist():
        column = design[:, k] / np.linalg.norm(design[:, k - k % SHAPE[1]])
        left = column - basis @ (basis.T @ column)
        size, power = float(np.linalg.norm(left)), k % SHAPE[1]
        if size > (apart**power if power else np.sqrt(np.finfo(float).eps)):
            basis = np.column_stack([basis, left / size])
            kept.append(k)
    return np.array(sorted(kept), dtype=np.int64)


def blank_surface(series: Series) -> Surface:
    """A surface of zeros whose scales span the record."""
    scale = float(np.max(np.abs(series.rate_dps))) or 100.0
    low, high = float(series.temp_c.min()), float(series.temp_c.max())
    return Surface(np.zeros(SHAPE), 0.0, scale, (low + high) / 2, max((high - low) / 2, 1.0))


def with_coefficients(surface: Surface, terms: Ints, values: Floats) -> Surface:
    """The surface with some of its coefficients replaced."""
    c = surface.coefficients_dps.ravel().copy()
    c[terms] = values
    return replace(surface, coefficients_dps=c.reshape(SHAPE))


def simulate(series: Series, surface: Surface, terms: Ints | None = None) -> Base:
    """Recording minus what `surface` predicts at the recorded rates and temperatures."""
    terms = carried_terms(series) if terms is None else terms
    output = surface.output_dps(series.rate_dps, series.temp_c)
    design = surface.output_design(series.rate_dps, series.temp_c)[:, terms]
    return Base(surface, series.gyro_dps - output, design, terms)


def fit_surface(series: Series) -> Base:
    """Surface by weighted least squares in gyro output (paper eq. 5): the start of everything else.

    The first round takes the recorded output for the regressors, as the paper does, which holds however nonlinear
    the gyro is; in the others they are evaluated at the predicted output, which is not noisy.
    """
    surface, terms = blank_surface(series), carried_terms(series)
    weight = 1.0 / series.white_std_dps
    scale_dps = float(np.max(np.abs(series.rate_dps))) or 100.0
    stiff = np.diag((terms % SHAPE[1] > 0) / (_CHANGE_WITH_TEMPERATURE * scale_dps))

    def moved(design: Floats, left_dps: Floats) -> Surface:
        now = surface.coefficients_dps.ravel()[terms]
        step = np.linalg.lstsq(
            np.concatenate([design * weight[:, None], stiff]),
            np.concatenate([left_dps * weight, -stiff @ now]),
            rcond=None,
        )[0]
        return with_coefficients(surface, terms, now + step)

    own = series.gyro_dps
    at_own = surface.design(own, series.temp_c)[:, terms]
    first = surface = moved(at_own, own - series.rate_dps)
    try:
        for _ in range(4):
            base = simulate(series, surface, terms)
            surface = moved(base.design, base.residual_dps)
        return simulate(series, surface, terms)
    except DataError:
        # Between the temperatures at which the record turns the surface may be anything, with no output either.
        left_dps = series.gyro_dps - series.rate_dps - first.error_dps(own, series.temp_c)
        return Base(first, left_dps, at_own, terms)
