"""Questions about the model that was given, and about bias over temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.gram import project, tail
from gyrocal.diagnosis.improve import Refined
from gyrocal.diagnosis.model_file import bench_only_mean
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.series import Series
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.catalogue import find_effect

Floats = NDArray[np.float64]

#: A surface has changed where the evidence is this strong and the change is above the noise of a data set.
_CHANGED_P = 1e-4


def without_terms(series: Series, coefficients: Coefficients | None) -> Series:
    """The recording less the physics that the coefficient file has in its terms already.

    The mean of what only the bench can evaluate is in the surface of the file (`coefficients_of`).
    """
    if coefficients is None or not coefficients.terms:
        return series
    c = conditions_of(series)
    added = np.zeros(len(series))
    for term in coefficients.terms:
        effect = find_effect(term.effect)
        values = effect.typical() | {name: float(p["value"]) for name, p in term.parameters.items()}
        error_dps = effect.error_dps(c, values, coefficients.surface, None)[0]
        if not effect.runtime:
            constant, share = bench_only_mean(series, error_dps)
            error_dps = error_dps - constant - share * series.rate_dps
        added = added + error_dps
    return replace(series, gyro_dps=series.gyro_dps - added)


def simulated_residual(series: Series, coefficients: Coefficients) -> Floats:
    """Recording minus the sequence that the given surface predicts, deg/s, shape (n,)."""
    return np.asarray(series.gyro_dps - coefficients.surface.output_dps(series.rate_dps, series.temp_c))


def surface_change(
    series: Series, analysis: Analysis, refined: Refined, coefficients: Coefficients, floor_dps: float
) -> Located | None:
    """Whether the given surface is still that of the gyro: compared with the one fitted here.

    Both covariances count. A significant change below `floor_dps` (noise of a data set) is not worth a word.
    """
    base = analysis.setup.base
    output = base.surface.output_dps(series.rate_dps, series.temp_c)
    given = coefficients.surface.design(output, series.temp_c)
    here = base.surface.design(output, series.temp_c)[:, base.terms]
    # Both are the same polynomials in differently scaled variables.
    to_here = np.linalg.lstsq(here, given, rcond=None)[0]
    change = to_here @ coefficients.surface.coefficients_dps.ravel()
    change = change - refined.whole.surface.coefficients_dps.ravel()[base.terms]
    own = refined.whole.covariance_dps2[np.ix_(base.terms, base.terms)]
    covariance = own + to_here @ coefficients.covariance_dps2 @ to_here.T
    rms = float(np.sqrt(np.mean((here @ change)[series.is_set] ** 2))) if series.is_set.any() else 0.0
    inverse = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    p = float(chi2.sf(change @ inverse @ change, base.terms.size))
    if p > _CHANGED_P or rms < floor_dps:
        return None
    where = "rate" if np.ptp(series.rate_dps) > 0 else "temperature"
    region = (
        f"everywhere: the error surface itself is not the one given ({1e3 * rms:.3g} mdeg/s rms); fit again"
    )
    return Located(where, "mean", region, p, 1.0, False)


def temperature_alone(analysis: Analysis) -> tuple[str, ...]:
    """For a record at one rate: is bias a function of temperature alone? Empty where that is no question."""
    series = analysis.setup.series
    if np.ptp(series.rate_dps) > 0 or np.ptp(series.temp_c) < 10.0:
        return ()
    curve = [b.columns for b in analysis.setup.blocks if b.coordinate == "temperature"]
    history = [
        b.columns
        for b in analysis.setup.blocks
        if b.coordinate in ("temperature_rate", "temperature_branch", "time", "data_set_index")
    ]
    if not curve or not history:
        return ()
    rest = project(analysis.gram, np.concatenate([analysis.setup.surface_columns, *curve]))
    p = min(1.0, len(history) * min(tail(*rest.block(columns)) for columns in history))
    X = np.column_stack([analysis.setup.base.design, *(analysis.setup.columns[:, k] for k in curve)])
    left = (
        analysis.setup.base.residual_dps
        - X @ np.linalg.lstsq(X, analysis.setup.base.residual_dps, rcond=None)[0]
    )
    gap = _branch_gap(series, left)
    if p < 1e-3 or analysis.levels.walk:
        apart = (
            ""
            if gap is None
            else f"; heating and cooling differ by {1e3 * gap:.3g} mdeg/s rms at the same temperature"
        )
        return (
            "Bias is not a function of temperature alone: after any smooth curve of temperature "
            f"{1e3 * float(np.std(left)):.3g} mdeg/s rms are left that follow time or the history of temperature{apart}.",
        )
    return ("Bias is a function of temperature alone, as far as this record can tell.",)


def _branch_gap(series: Series, left: Floats) -> float | None:
    """Difference between heating and cooling at the same temperature, rms over the temperatures of both, deg/s."""
    edges = np.linspace(series.temp_c.min(), series.temp_c.max(), 21)
    bins = np.clip(np.searchsorted(edges, series.temp_c, side="right") - 1, 0, 19)
    means = []
    for up in (series.temp_rate_c_per_min > 0.1, series.temp_rate_c_per_min < -0.1):
        count = np.bincount(bins[up], minlength=20)
        total = np.bincount(bins[up], weights=left[up], minlength=20)
        means.append(np.where(count >= 5, total / np.maximum(count, 1), np.nan))
    gap = means[0] - means[1]
    return float(np.sqrt(np.nanmean(gap**2))) if np.isfinite(gap).any() else None
