"""Cross-validation by whole temperatures, whole rates and stretches of time: what the surface says about data it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from gyrocal.calibration.fit import SurfaceFit, Weights, gls_gain, rms
from gyrocal.calibration.groups import left_out_groups
from gyrocal.inference.scatter import projection

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A direction of the left-out block that the rest says this little about is not predicted by it.
_DETERMINED = 1e-9


@dataclass(frozen=True)
class CrossValidation:
    """Errors of prediction with whole groups left out.

    Attributes
    ----------
    left_out : str
        ``rate``, ``temperature`` or ``time``.
    folds : int
    error_dps : ndarray, shape (n,)
        Error of each corrected rate by the surface of all others; NaN where the rest cannot carry the surface.
    rms_dps : float or None
        None when a fold cannot be predicted: too few levels.
    """

    left_out: str
    folds: int
    error_dps: Floats
    rms_dps: float | None


def cross_validate(fit: SurfaceFit, weights: Weights | None = None) -> tuple[CrossValidation, ...]:
    """Leave out whole temperatures, whole rates, and twelfths in time order.

    Parameters
    ----------
    weights : {"gls", "ols"}, optional
        Those of the fit when not given. The covariance stays that of the whole recording.
    """
    sets = fit.sets
    matrix = fit.scatter.matrix if (weights or fit.weights) == "gls" else np.eye(len(sets))
    p, _ = projection(matrix, fit.design)
    gain = gls_gain(matrix, fit.design)
    # The fit rests on predicted outputs; what corrects a rate is the output that was measured.
    measured, unit = fit.design, np.ones(len(sets))
    if fit.surface.direction == "output":
        measured = fit.surface.design(sets.gyro_dps, sets.temp_c)[:, fit.terms]
    else:
        unit = 1.0 + fit.surface.slope_per_dps(sets.rate_dps, sets.temp_c)
    return tuple(
        _leave_out(name, g, p, gain, measured, sets.error_dps, unit)
        for name, g in left_out_groups(sets).items()
        if np.unique(g).size > 1
    )


def _leave_out(
    name: str, groups: Ints, p: Floats, gain: Floats, design: Floats, error_dps: Floats, unit: Floats
) -> CrossValidation:
    """Fits without each group, from the whole fit: a data set of its own unknown offset is a data set left out."""
    py = p @ error_dps
    coefficients = gain @ error_dps
    scale = np.diag(p).mean()
    errors = np.full(error_dps.size, np.nan)
    labels = np.unique(groups)
    for label in labels:
        rows = np.flatnonzero(groups == label)
        inner = p[np.ix_(rows, rows)]
        values, vectors = linalg.eigh(inner)
        if values[0] < _DETERMINED * scale:
            continue
        offset = vectors @ ((vectors.T @ py[rows]) / values)
        wrong = error_dps[rows] - design[rows] @ (coefficients - gain[:, rows] @ offset)
        errors[rows] = wrong / unit[rows]
    whole = bool(np.isfinite(errors).all())
    return CrossValidation(name, int(labels.size), errors, rms(errors) if whole else None)
