"""What a diagnosis leaves for use: the surface alone, and the surface with the named physics in its terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.base import raised
from gyrocal.diagnosis.gate import Gate
from gyrocal.diagnosis.improve import Refined, Solved
from gyrocal.diagnosis.intervals import NORMAL_95
from gyrocal.diagnosis.series import Series
from gyrocal.fusion.coefficients import Coefficients, Noise, Term, Valid
from gyrocal.physics.catalogue import CATALOGUE


def surface_coefficients(series: Series, analysis: Analysis, refined: Refined) -> Coefficients:
    """The surface alone, fitted by generalised least squares, as a coefficient file."""
    return _coefficients(series, analysis, refined.plain, ())


def coefficients_of(series: Series, analysis: Analysis, refined: Refined, decided: Gate) -> Coefficients:
    """The surface that was fitted beside the named physics, which stands in its terms.

    What only the bench can evaluate (a drift since the run began, a jump) is not in what a robot takes off: the
    surface then stands for the gyro as it was on average over the recording (`bench_only_mean`).
    """
    terms = []
    for member in decided.named:
        effect = CATALOGUE[member.hypothesis.id]
        parameters = {
            name: {"value": e.value, "std": e.std, "unit": e.unit} | _covariance(refined, effect.id, name)
            for name, e in refined.file_parameters[effect.id].items()
        }
        second = {
            name: parameters.pop(f"{name}_2") for name in ("amplitude", "order") if f"{name}_2" in parameters
        }
        terms.append(Term(effect.id, parameters, effect.runtime))
        if second:
            terms.append(Term(effect.id, {**parameters, **second}, effect.runtime))
    solved = refined.named
    for key, effect_dps in refined.effects_dps.items():
        if not CATALOGUE[key].runtime:
            solved = replace(solved, surface=raised(solved.surface, *bench_only_mean(series, effect_dps)))
    return _coefficients(series, analysis, solved, terms)


def bench_only_mean(series: Series, effect_dps: NDArray[np.float64]) -> tuple[float, float]:
    """Constant (deg/s) and share of the rate that an effect has on average over the data sets of a recording."""
    rows = np.flatnonzero(series.is_set) if series.is_set.any() else np.arange(len(series))
    weight = 1.0 / series.white_std_dps[rows]
    X = np.column_stack([np.ones(rows.size), series.rate_dps[rows]]) * weight[:, None]
    constant, share = np.linalg.lstsq(X, effect_dps[rows] * weight, rcond=None)[0]
    return float(constant), float(share)


def _coefficients(series: Series, analysis: Analysis, solved: Solved, terms: Sequence[Term]) -> Coefficients:
    return Coefficients(
        sensor={"model": series.sensor_model},
        surface=solved.surface,
        covariance_dps2=solved.covariance_dps2,
        valid=_valid(series),
        noise=_noise(series, analysis),
        terms=tuple(terms),
        provenance={"recording": series.name, "by": "diagnose"},
    )


def _covariance(refined: Refined, effect: str, name: str) -> dict[str, Sequence[float]]:
    row = refined.joint.get((effect, name))
    return {} if row is None else {"covariance": row}


def _valid(series: Series) -> Valid:
    return Valid(
        (float(series.gyro_dps.min()), float(series.gyro_dps.max())),
        (float(series.temp_c.min()), float(series.temp_c.max())),
    )


def _noise(series: Series, analysis: Analysis) -> Noise:
    if not np.all(series.averaging_s > 0):
        return Noise()
    walk = analysis.levels.white * float(np.median(series.white_std_dps * np.sqrt(series.averaging_s)))
    spread = NORMAL_95 / np.sqrt(2.0 * len(series))
    return Noise(
        angle_random_walk_deg_per_rt_h=(60 * walk, 60 * walk * (1 - spread), 60 * walk * (1 + spread))
    )
