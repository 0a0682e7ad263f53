"""The whole fit: checks, surface, what is left, noise, cross-validation, and the coefficient file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gyrocal
from gyrocal.calibration.checks import MOST_DATA_SETS, check_bias, check_rounding, check_surface, no_rate_text
from gyrocal.calibration.choice import PAPER, Choice, ChosenFit, bias_model, fit_chosen
from gyrocal.calibration.coarsen import coarsen
from gyrocal.calibration.crossval import CrossValidation
from gyrocal.calibration.datasets import DataSets, Recording, load_recording
from gyrocal.calibration.figures import BeforeAfter, merit_figures
from gyrocal.calibration.fit import SurfaceFit, Weights, rms
from gyrocal.calibration.noise import NoiseFigures, noise_figures
from gyrocal.calibration.provenance import refuse_compensated
from gyrocal.calibration.residuals import (
    Outlier,
    ScatterByRate,
    StructureTest,
    find_outliers,
    scatter_by_rate,
    structure_tests,
)
from gyrocal.errors import DataError, InputError
from gyrocal.fusion.coefficients import Coefficients, Noise, Valid
from gyrocal.inference.scatter import PARTS
from gyrocal.physics.surface import Direction
from gyrocal.records.datasets import nominal_scales
from gyrocal.units import DPS_TO_DPH, plural

Floats = NDArray[np.float64]

#: A bias over temperature says nothing about the scale factor: it holds this near to the rate it was taken at, deg/s.
BIAS_REACH_DPS = 1.0
#: Permutations of the scatter test are drawn with this seed, so that the same recording gives the same file.
_SEED = 952
_MOST_BLOCKS = 600
#: White noise of the samples that is so many times what is left cannot be it: of 8 degrees of freedom chance leaves a third
#: once in a thousand times.
_CONTRADICTED = 3.0


@dataclass(frozen=True)
class FitConfig:
    """What to fit and how.

    Attributes
    ----------
    exclude : tuple of int
        Segment ids (row numbers of a table, counted from 1) that the user leaves out.
    weights, direction : str, optional
        Chosen by the error left out where they are not given.
    force : bool
        Fit data that are doubtful (saturated, stuck, coarse temperature); what is missing stays an error.
    paper : bool
        The paper's twelve terms in the gyro's output, whatever does better.
    """

    counts_per_dps: float | None = None
    weights: Weights | None = None
    bias_only: bool = False
    exclude: tuple[int, ...] = ()
    force: bool = False
    direction: Direction | None = None
    paper: bool = False


@dataclass(frozen=True)
class Calibration:
    """A calibration and all that is known about it.

    Attributes
    ----------
    before_dps : float
        Standard deviation of the error about the best single scale factor and bias (for a bias: about its mean).
    after_dps, ols_dps : float
        Root mean square of the residual, of the fit and of the paper's equal weights.
    sample_floor_dps : float or None
        What the noise of the samples alone leaves in the means.
    outliers, structure
        Structure is tested without the outliers of the mean; the fit has them in, unless excluded by the user.
    choice : Choice
        Direction, terms and weights, and why.
    cross_validation, cross_validation_ols
        Of the weights used, and of equal weights.
    merit : dict
        Figures of merit before compensation, and of what is left on data left out.
    """

    recording: Recording
    config: FitConfig
    fit: SurfaceFit
    choice: Choice
    before_dps: float
    after_dps: float
    ols_dps: float
    sample_floor_dps: float | None
    outliers: tuple[Outlier, ...]
    structure: tuple[StructureTest, ...]
    scatter_by_rate: ScatterByRate | None
    cross_validation: tuple[CrossValidation, ...]
    cross_validation_ols: tuple[CrossValidation, ...]
    noise: NoiseFigures
    merit: dict[str, BeforeAfter]
    excluded_by_user: tuple[int, ...]
    notes: tuple[str, ...]
    coefficients: Coefficients

    @property
    def factor(self) -> float:
        """Error before over error after."""
        return self.before_dps / max(self.after_dps, np.finfo(float).tiny)

    @property
    def structured(self) -> tuple[str, ...]:
        """Coordinates in which the residual holds structure."""
        return tuple(test.coordinate for test in self.structure if test.structured)


def configs(paths: Sequence[Path], counts_per_dps: float | None) -> list[FitConfig]:
    """How to fit each of several recordings: the nominal scale belongs to the tables that are in counts.

    Raises
    ------
    InputError
        A scale is given, and no table is in counts.
    """
    return [FitConfig(scale) for scale in nominal_scales(paths, counts_per_dps)]


def calibrate(path: Path, config: FitConfig) -> Calibration:
    """Read a recording, check it, fit it, and look at what is left.

    Raises
    ------
    InputError
        A bad file, or an excluded id that the recording does not have.
    DataError
        Data that cannot carry the fit, or that were compensated already.
    """
    recording = load_recording(path, config.counts_per_dps)
    if recording.run is not None:
        refuse_compensated(recording.run)
    sets = _without(recording, config.exclude)
    notes = list(recording.notes) + _notes_on(recording, sets)
    if config.bias_only:
        sets, more = _at_one_rate(recording, sets)
        notes += more
        notes += check_bias(recording, sets)
    else:
        sets, block = coarsen(sets, MOST_DATA_SETS)
        notes += [_averaged_note(len(recording.sets), block)] if block > 1 else []
        notes += check_surface(recording, sets, force=config.force, paper=config.paper)
    try:
        chosen = fit_chosen(
            sets,
            recording.rest,
            model=bias_model(sets) if config.bias_only else PAPER if config.paper else None,
            direction=config.direction,
            weights=config.weights,
        )
    except np.linalg.LinAlgError as error:
        raise DataError(
            f"{recording.source}: the scatter of the data sets cannot be told from their digits: nearly all agree to the last "
            "one. Write rates, outputs and temperatures with more digits."
        ) from error
    notes += check_rounding(recording, chosen.fit, force=config.force)
    return _assess(recording, config, chosen, tuple(notes))


def _without(recording: Recording, exclude: tuple[int, ...]) -> DataSets:
    sets = recording.sets
    unknown = sorted(set(exclude) - set(sets.segment.tolist()))
    if unknown:
        raise InputError(
            f"{recording.source}: has no data set {unknown[0]} to exclude (ids run from {sets.segment.min()} to {sets.segment.max()})."
        )
    return sets.select(~np.isin(sets.segment, exclude)) if exclude else sets


def _notes_on(recording: Recording, sets: DataSets) -> list[str]:
    masked, notes = recording.masked, []
    for count, what in (
        (masked.bad_status, "[sample of bad status is|samples of bad status are] left out"),
        (masked.non_finite, "[sample that is not finite is|samples that are not finite are] left out"),
        (masked.saturated, "[sample stands|samples stand] at the recording's extreme value"),
    ):
        notes += [f"{count} {plural(count, what)}"] if count else []
    notes += [
        f"segment {e.segment} ({e.rate_dps:+.4g} deg/s, {e.temp_c:.1f} °C) is left out: {e.reason}"
        for e in recording.excluded
    ]
    unsettled = sets.segment[sets.outcome == "unsettled"]
    if unsettled.size:
        listed = ", ".join(str(i) for i in unsettled[:12]) + (", ..." if unsettled.size > 12 else "")
        are = plural(unsettled.size, "data [set is|sets are]")
        notes.append(f"{unsettled.size} {are} marked unsettled and used ({listed})")
    if not sets.timed:
        notes.append("times are unknown: the order of the data sets stands for them in the uncertainties")
    return notes


def _averaged_note(rows: int, block: int) -> str:
    return f"{rows} rows were averaged in blocks of {block} neighbours at the same rate"


def _at_one_rate(recording: Recording, sets: DataSets) -> tuple[DataSets, list[str]]:
    """The data sets that a bias over temperature is taken from: all of one rate, or those at rest among many."""
    notes = []
    if np.ptp(sets.rate_dps) > 0:
        rest = np.abs(sets.rate_dps) < 1e-6
        if not rest.any():
            raise DataError(
                f"{recording.source}: holds several rates and none is zero. "
                "Fit the surface without --bias-only, or record at rest."
            )
        notes.append(f"the bias is taken from the {int(rest.sum())} data sets at rest of {len(sets)}")
        sets = sets.select(rest)
    elif sets.rate_dps[0] != 0:
        notes.append(
            f"the only rate is {sets.rate_dps[0]:+.4g} deg/s: its scale factor error is within the bias"
        )
    coarse, block = coarsen(sets, _MOST_BLOCKS)
    notes += [_averaged_note(len(sets), block)] if block > 1 else []
    notes.append("a bias over temperature: every term in the rate is zero and unknown, not known to be zero")
    return coarse, notes


def _assess(
    recording: Recording, config: FitConfig, chosen: ChosenFit, notes: tuple[str, ...]
) -> Calibration:
    fit, sets = chosen.fit, chosen.fit.sets
    _need_rates(recording, fit)
    outliers, kept, scatter = find_outliers(sets, fit.scatter)
    line = np.polynomial.polynomial.polyvander(sets.gyro_dps, 0 if config.bias_only else 1)
    before = sets.error_dps - line @ np.linalg.lstsq(line, sets.error_dps, rcond=None)[0]
    known = np.isfinite(sets.mean_variance_dps2)
    valid = _valid(recording, config, sets, kept)
    noise = noise_figures(recording)
    calibration = Calibration(
        recording=recording,
        config=config,
        fit=fit,
        choice=chosen.choice,
        before_dps=rms(before),
        after_dps=rms(fit.residual_dps),
        ols_dps=rms(fit.ols_residual_dps),
        sample_floor_dps=float(np.sqrt(np.mean(sets.mean_variance_dps2[known]))) if known.all() else None,
        outliers=outliers,
        structure=structure_tests(sets.select(kept), scatter),
        scatter_by_rate=scatter_by_rate(sets, fit.residual_dps, np.random.default_rng(_SEED)),
        cross_validation=chosen.left_out,
        cross_validation_ols=chosen.equal,
        noise=noise,
        merit=merit_figures(fit, next((v.error_dps for v in chosen.left_out if v.left_out == "time"), None)),
        excluded_by_user=tuple(sorted(config.exclude)),
        notes=(
            *notes,
            *_too_noisy(fit),
            *_narrowed(valid, _valid(recording, config, sets, np.ones_like(kept))),
        ),
        coefficients=_coefficients(recording, config, chosen, noise, valid),
    )
    coefficients = replace(calibration.coefficients, figures=_figures(calibration))
    return replace(calibration, coefficients=coefficients)


def _valid(recording: Recording, config: FitConfig, sets: DataSets, kept: NDArray[np.bool_]) -> Valid:
    """Range of output and temperature that the `kept` of the fitted sets cover, to their last row or sample, averaged or not."""
    rows = recording.sets
    lows_and_highs = recording.reach
    if lows_and_highs is None:
        lows_and_highs = np.stack([rows.gyro_dps, rows.gyro_dps, rows.temp_c, rows.temp_c], axis=1)
    # A bias is taken from one of the rates.
    fitted = (rows.rate_dps >= sets.rate_dps.min()) & (rows.rate_dps <= sets.rate_dps.max())
    starts = np.flatnonzero(np.isin(rows.segment, sets.segment))
    believed = kept[np.searchsorted(starts, np.arange(len(rows)), side="right") - 1]
    lows_and_highs = lows_and_highs[fitted & believed & ~np.isin(rows.segment, config.exclude)]
    low, _, temp_low, _ = (float(v) for v in lows_and_highs.min(axis=0))
    _, high, _, temp_high = (float(v) for v in lows_and_highs.max(axis=0))
    if config.bias_only:
        low, high = low - BIAS_REACH_DPS, high + BIAS_REACH_DPS
    return Valid((low, high), (temp_low, temp_high))


def _narrowed(valid: Valid, with_outliers: Valid) -> list[str]:
    """Says it where outliers alone would have widened what the coefficients are valid for."""
    if valid == with_outliers:
        return []
    (low, high), (cold, warm) = with_outliers.rate_dps, with_outliers.temp_c
    return [
        f"outliers are not counted in the valid range, which would go from {low:+.4g} to {high:+.4g} deg/s and {cold:.1f} to "
        f"{warm:.1f} °C by them: a misread one would vouch for what was never visited"
    ]


def _need_rates(recording: Recording, fit: SurfaceFit) -> None:
    """Refuse a surface by which some outputs have no rate: the output stands still or falls while the rate grows."""
    lost = ~np.isfinite(fit.residual_dps)
    if not lost.any():
        return
    sets, count = fit.sets, int(lost.sum())
    k = int(np.flatnonzero(lost)[0])
    text = no_rate_text(count, float(sets.rate_dps[k]), float(sets.temp_c[k]))
    raise DataError(
        f"{recording.source}: by the fitted surface {text}. Record smaller rates, or ask gyrocal diagnose."
    )


def _too_noisy(fit: SurfaceFit) -> list[str]:
    """Says it where the samples are said to scatter by more than the means do: the columns contradict each other."""
    floor_dps = float(np.sqrt(np.mean(fit.sets.mean_variance_dps2)))
    free = max(len(fit.sets) - int(fit.terms.sum()), 1)
    residual_dps = float(np.sqrt(np.sum(fit.residual_dps**2) / free))
    if not floor_dps > _CONTRADICTED * residual_dps:  # NaN where it is not known
        return []
    return [
        f"gyro_std_dps over the root of n says that a mean is off by {floor_dps * DPS_TO_DPH:.3g} deg/h rms, and all that is left is "
        f"{residual_dps * DPS_TO_DPH:.3g}: check these columns"
    ]


def _coefficients(
    recording: Recording, config: FitConfig, chosen: ChosenFit, noise: NoiseFigures, valid: Valid
) -> Coefficients:
    fit = chosen.fit
    provenance: dict[str, Any] = {
        "software": f"gyrocal {gyrocal.__version__}",
        "source": recording.source.name,
        "source_sha256": recording.sha256,
        "fit": "bias over temperature" if config.bias_only else "surface",
        "weights": chosen.choice.weights,
        "model": str(chosen.choice.model),
        "model_chosen_because": chosen.choice.reason,
        "counts_per_dps": recording.counts_per_dps,
        "excluded_by_user": sorted(config.exclude),
        "forced": config.force,
        "data_sets": len(fit.sets),
        "unsettled": int(np.count_nonzero(fit.sets.outcome == "unsettled")),
        "left_out": [{"segment": e.segment, "reason": e.reason} for e in recording.excluded],
        "samples": recording.n_samples,
        "samples_masked": {
            "bad_status": recording.masked.bad_status,
            "non_finite": recording.masked.non_finite,
            "saturated": recording.masked.saturated,
        },
        "created_utc": recording.run.created_utc if recording.run else None,
    }
    return Coefficients(
        sensor=recording.sensor,
        surface=fit.surface,
        covariance_dps2=0.5 * (fit.covariance_dps2 + fit.covariance_dps2.T),
        valid=valid,
        noise=Noise(noise.angle_random_walk_deg_per_rt_h, noise.bias_instability_deg_per_h),
        provenance=provenance,
    )


def _figures(c: Calibration) -> dict[str, Any]:
    """The ``figures`` entry: merit of the gyro, and how well the fit describes it."""
    scatter = c.fit.scatter
    return {
        "gyro": {
            name: {"before": pair.before.to_json(), "after": pair.after.to_json()}
            for name, pair in c.merit.items()
        },
        "noise": {name: figure.to_json() for name, figure in c.noise.figures.items()},
        "fit": {
            "error_before_rms_dps": c.before_dps,
            "error_after_rms_dps": c.after_dps,
            "error_after_rms_dps_equal_weights": c.ols_dps,
            "sample_noise_floor_dps": c.sample_floor_dps,
            "condition": c.fit.condition,
            "half_width_95_dps": c.fit.half_width_dps().tolist(),
            "left_out_rms_dps": {v.left_out: v.rms_dps for v in c.cross_validation},
            "left_out_rms_dps_equal_weights": {v.left_out: v.rms_dps for v in c.cross_validation_ols},
            "outliers": [o.segment for o in c.outliers],
            "structure_p_values": {t.coordinate: t.p_holm for t in c.structure},
            "scatter": {
                "independent_dps": scatter.white_dps,
                "flicker_per_decade_dps": scatter.flicker_dps,
                "rate_jitter_ppm": scatter.jitter * 1e6,
                # A step is a second, or a data set where times are unknown.
                "walk_per_root_step_dps": scatter.walk_dps,
                "seen": dict(zip(PARTS, scatter.seen.tolist(), strict=True)),
                "timed": scatter.timed,
                "rest_s": scatter.rest.span_s if scatter.rest else 0.0,
            },
        },
    }
