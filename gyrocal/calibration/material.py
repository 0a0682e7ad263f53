"""A recording corrected with coefficients, and what is left tested: the material of a report's figures and tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg

from gyrocal.calibration.checks import MOST_DATA_SETS
from gyrocal.calibration.choice import bias_model, fit_chosen
from gyrocal.calibration.coarsen import coarsen
from gyrocal.calibration.corrected import Examined, Floats, Timeline, read_course
from gyrocal.calibration.datasets import DataSets, Recording, load_recording
from gyrocal.calibration.fit import TERMS
from gyrocal.calibration.noise import NoiseFigures, noise_figures
from gyrocal.calibration.provenance import check_sensor, naming, refuse_compensated
from gyrocal.calibration.residuals import ScatterByRate, find_outliers, scatter_by_rate
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients, load_coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.inference.scatter import Scatter
from gyrocal.physics.surface import TEMPERATURE_ORDER

#: Share done, 0 to 1, and what is being done.
Progress = Callable[[float, str], None]

#: Seed of the permutation test: the same recording gives the same report.
_SEED = 2100
#: Long logs at one rate are averaged to this many data sets.
_MOST_AT_ONE_RATE = 600


@dataclass(frozen=True)
class Material:
    """Everything that figures and tables are made of.

    Attributes
    ----------
    reasons : dict
        Why a data set is marked, by its row.
    before_dps, after_dps : float
        Error about the best single scale factor and bias (about the mean at one rate), and residual, both rms.
    own : bool
        The coefficients were fitted to this recording.
    one_rate : bool
        The recording is at a single rate: bias over temperature, no surface.
    """

    recording: Recording
    coefficients: Coefficients
    data: Examined
    reasons: dict[int, str]
    timeline: Timeline | None
    tested: ScatterByRate | None
    noise: NoiseFigures
    before_dps: float
    after_dps: float
    own: bool
    one_rate: bool
    notes: tuple[str, ...]


def gather(
    source: Path, coefficient_file: Path, counts_per_dps: float | None, force_sensor: bool, progress: Progress
) -> Material:
    """Read a recording and coefficients, correct the one with the other, and test what is left.

    Raises
    ------
    InputError, DataError, CoefficientError
        Bad files, compensated rates, or coefficients of another sensor.
    """
    progress(0.0, "reading")
    coefficients = load_coefficients(coefficient_file)
    recording = load_recording(source, counts_per_dps)
    with naming(coefficient_file):
        return examine(recording, coefficients, None, force_sensor, progress)


def examine(
    recording: Recording,
    coefficients: Coefficients,
    known: Scatter | None,
    force_sensor: bool,
    progress: Progress,
) -> Material:
    """What `gather` does with what was read; `known` is the scatter of a fit to just this recording, if there is one."""
    source = recording.source
    notes = recording.notes + check_sensor(coefficients.sensor, recording.sensor, source, force=force_sensor)
    if recording.run is not None:
        refuse_compensated(recording.run)
    one_rate = float(np.ptp(recording.sets.rate_dps)) == 0.0
    sets, block = coarsen(recording.sets, _MOST_AT_ONE_RATE if one_rate else MOST_DATA_SETS)
    if block > 1:
        notes += (f"{len(recording.sets)} rows were averaged in blocks of {block} neighbours",)
    progress(0.1, "correcting")
    compensator = Compensator(coefficients)
    corrected, timeline, more = _corrected(recording, sets, compensator)
    progress(0.2, "scatter and outliers")
    terms = TEMPERATURE_ORDER + 1 if one_rate else TERMS
    if len(sets) <= terms:
        raise DataError(
            f"{source}: holds {len(sets)} data sets, too few to judge {terms} terms by. "
            "Report the recording that the coefficients were fitted to, or record more rates and temperatures; what a record "
            f"at rest says of noise and bias is gyrocal noise {source}."
        )
    scatter = (
        known or fit_chosen(sets, recording.rest, model=bias_model(sets) if one_rate else None).fit.scatter
    )
    reasons = _reasons(sets, scatter)
    marked = np.zeros(len(sets), dtype=bool)
    marked[list(reasons)] = True
    residual = corrected - sets.rate_dps
    own = coefficients.provenance.get("source_sha256") == recording.sha256
    data = Examined(sets, residual, residual_covariance(sets, scatter, coefficients, own=own), marked)
    tested = scatter_by_rate(sets, residual, np.random.default_rng(_SEED))
    progress(0.25, "Allan deviation")
    return Material(
        recording=recording,
        coefficients=coefficients,
        data=data,
        reasons=reasons,
        timeline=timeline,
        tested=tested,
        noise=noise_figures(recording),
        before_dps=_rms_about_line(sets, 0 if one_rate else 1),
        after_dps=float(np.sqrt(np.mean(residual**2))),
        own=own,
        one_rate=one_rate,
        notes=notes + more,
    )


def _corrected(
    recording: Recording, sets: DataSets, compensator: Compensator
) -> tuple[Floats, Timeline | None, tuple[str, ...]]:
    """Corrected mean of each data set, the course of the run, and notes on terms that were not applied."""
    surface = compensator.coefficients.surface
    corrected = surface.rate_dps(sets.gyro_dps, sets.temp_c)
    notes = tuple(
        f"the term {effect} belongs to the bench and is not taken away from the gyro"
        for effect in compensator.not_applied
    )
    if recording.run is not None:
        timeline, means = read_course(recording.run, compensator if compensator.terms else None)
        corrected = np.array([means.get(int(s), c) for s, c in zip(sets.segment, corrected, strict=True)])
        return corrected, timeline, notes
    short = [
        term.name
        for term in compensator.terms
        if "since_power_on_s" in term.channels or (term.has_memory and not sets.timed)
    ]
    if short:
        notes += (
            f"{', '.join(short)} of the coefficients cannot be evaluated on this table, which lacks times; "
            "the surface alone is applied",
        )
    elif compensator.terms:
        t_s = sets.t_s if sets.timed else np.zeros(len(sets))
        corrected = np.asarray(compensator.correct(t_s, sets.gyro_dps, sets.temp_c))
    return corrected, None, notes


def _reasons(sets: DataSets, scatter: Scatter) -> dict[int, str]:
    """Why data sets are marked: outliers with their distance, unsettled ones by their outcome."""
    outliers, _, _ = find_outliers(sets, scatter)
    reasons = {o.row: f"{o.reason} ({o.sigmas:+.1f} sigma)" for o in outliers}
    for row in np.flatnonzero(sets.outcome != "ok").tolist():
        reasons[row] = "; ".join(filter(None, (str(sets.outcome[row]), reasons.get(row, ""))))
    return reasons


def residual_covariance(sets: DataSets, scatter: Scatter, coefficients: Coefficients, *, own: bool) -> Floats:
    """Covariance of the residuals, shape (n, n), (deg/s)^2.

    A fit has taken from its own data what looks like its terms, drift common to all included: the scatter loses the
    part that generalised least squares follows. To other data the uncertainty of the coefficients is added.
    """
    if not own:
        design = coefficients.sensitivity(sets.gyro_dps, sets.temp_c)
        return np.asarray(scatter.matrix + design @ coefficients.covariance_dps2 @ design.T)
    lower = linalg.cholesky(scatter.matrix, lower=True)
    q = linalg.qr(linalg.solve_triangular(lower, scatter.design, lower=True), mode="economic")[0]
    followed = lower @ q
    return np.asarray(scatter.matrix - followed @ followed.T)


def _rms_about_line(sets: DataSets, order: int) -> float:
    line = np.polynomial.polynomial.polyvander(sets.gyro_dps, order)
    off = sets.error_dps - line @ np.linalg.lstsq(line, sets.error_dps, rcond=None)[0]
    return float(np.sqrt(np.mean(off**2)))
