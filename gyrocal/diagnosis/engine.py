"""`diagnose`: from a recording to a verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.analysis import Analysis, analyse
from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.gate import Gate, gate
from gyrocal.diagnosis.given import simulated_residual, surface_change, temperature_alone, without_terms
from gyrocal.diagnosis.heldout import improvements
from gyrocal.diagnosis.hypotheses import TWINS, untestable
from gyrocal.diagnosis.improve import Refined, refine
from gyrocal.diagnosis.inputs import check_inputs
from gyrocal.diagnosis.locate import lack_of_fit, locate
from gyrocal.diagnosis.model_file import coefficients_of, surface_coefficients
from gyrocal.diagnosis.result import (
    Alternative,
    Diagnosis,
    Improvement,
    Located,
    NamedEffect,
    NoiseFigures,
    Rows,
)
from gyrocal.diagnosis.scatter import (
    Finding,
    clock_findings,
    outlier_findings,
    set_aside,
    step_findings,
    variance_places,
)
from gyrocal.diagnosis.search import Member
from gyrocal.diagnosis.sentences import sentences
from gyrocal.diagnosis.series import Series, series_of_run, set_means
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.diagnosis.untimed import by_data_set, where
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.records.run import Run, is_run_directory, read_run

Floats = NDArray[np.float64]

#: Evidence (nats) within which two laws explain the data alike: 20 to 1.
CLASS_NATS = 3.0


@dataclass(frozen=True)
class Options:
    """Choices of a diagnosis.

    Attributes
    ----------
    false_alarm_rate : float
        Family-wise rate at which an effect may be named where there is none.
    seed : int
        Of the Monte Carlo nulls and the bootstrap.
    heldout : bool
        Whether to measure the improvement on data left out (about half of the time it takes).
    """

    false_alarm_rate: float = 0.01
    seed: int = 0
    heldout: bool = True


def series_of(recording: Path | Run | DataSetTable) -> Series:
    """Rows of any recording that `diagnose` takes."""
    if isinstance(recording, Path):
        recording = read_run(recording) if is_run_directory(recording) else read_data_sets(recording)
    return series_of_run(recording) if isinstance(recording, Run) else series_of_table(recording)


def diagnose(
    recording: Path | Run | DataSetTable,
    coefficients: Coefficients | None = None,
    options: Options | None = None,
) -> Diagnosis:
    """Compare a recording with its simulated sequence and name the physics that is missing.

    Parameters
    ----------
    recording : Path, Run or DataSetTable
        A run directory, or a table of data sets (read it first where it is in counts).
    coefficients : Coefficients, optional
        The model to simulate from; without it the surface is fitted to the recording first.

    Raises
    ------
    InputError, DataError
        The recording cannot be read, or is too short to be examined.
    """
    options = options or Options()
    recorded = series_of(recording)
    notes = check_inputs(recorded, coefficients)
    whole = without_terms(recorded, coefficients)
    series, findings = set_aside(whole, recorded.gyro_dps)
    analysis = analyse(series, options.false_alarm_rate, options.seed)
    remaining = lack_of_fit(analysis, options.false_alarm_rate)
    decided = gate(analysis.members, remaining, analysis.search)
    located = locate(analysis, remaining, options.false_alarm_rate)
    findings += _sampling_findings(series, decided)
    scatter = variance_places(analysis, options.false_alarm_rate)
    refined = refine(analysis, decided)
    gains, total = improvements(analysis, refined, options.seed) if options.heldout else ({}, None)
    named = [_named(m, series, refined, gains.get(m.hypothesis.id)) for m in decided.named]
    effects = (*named, *map(_found, findings))
    scatter = _explained_scatter(scatter, decided, findings)
    refined, change = _against_given(series, analysis, refined, coefficients)
    walk = _walk_place(analysis, options.false_alarm_rate)
    everywhere = change + walk + located + [f.place for f in findings] + scatter
    verdict = _verdict(effects, decided, bool(remaining or change or walk), bool(scatter))
    diagnosis = Diagnosis(
        recording=whole.name,
        verdict=verdict,
        located=tuple(everywhere),
        effects=effects,
        not_testable=dict(series.untestable) | untestable(series),
        sentences=(),
        noise=_noise_figures(series, analysis),
        improvement=total,
        surface=coefficients or surface_coefficients(series, analysis, refined),
        improved=coefficients_of(series, analysis, refined, decided) if decided.named else None,
        rows=_rows(series, analysis, refined),
        notes=(*notes, *series.notes, *_remarks(analysis, decided)),
    )
    return replace(diagnosis, sentences=sentences(diagnosis))


def _sampling_findings(series: Series, decided: Gate) -> list[Finding]:
    truncated = "truncation" in [m.hypothesis.id for m in decided.named]
    return outlier_findings(series) + ([] if truncated else step_findings(series)) + clock_findings(series)


def _against_given(
    series: Series, analysis: Analysis, refined: Refined, coefficients: Coefficients | None
) -> tuple[Refined, list[Located]]:
    """The residual that the given model leaves, and whether its surface is still the gyro's."""
    if coefficients is None:
        return refined, []
    floor = float(np.sqrt(np.mean(set_means(series, refined.whole.left_dps)[1] ** 2)))
    change = surface_change(series, analysis, refined, coefficients, floor)
    residual = simulated_residual(series, coefficients)
    before = replace(refined.plain, left_dps=residual)
    return replace(refined, plain=before), [] if change is None else [change]


def _remarks(analysis: Analysis, decided: Gate) -> list[str]:
    """Bias over temperature, why names were withheld, and what speaks against those given all the same."""
    series = analysis.setup.series
    found = [*temperature_alone(analysis), *decided.reasons]
    for member in decided.named:
        name = member.hypothesis.id
        for rival, loss in member.rivals:
            if rival not in CATALOGUE and loss < CLASS_NATS and "another" not in rival:
                odds = "as well as" if loss < 0.05 else f"{np.exp(loss):.2g} times worse than"
                found.append(
                    f"A pattern that is not in the catalogue ({rival.strip('()')}) explains the data {odds} {name}."
                )
        if name == "warm_up" and series.since_power_on_s is None:
            found.append(
                "warm_up: the record does not say when the gyro was switched on; its amplitude is that at the beginning of the record."
            )
    return found


def _walk_place(analysis: Analysis, level: float) -> list[Located]:
    """A bias that wanders farther than 1/f noise does is a departure too, though no law."""
    if not analysis.levels.walk or analysis.walk_p > level:
        return []
    series = analysis.setup.series
    wandered = 1e3 * analysis.levels.walk * float(np.sqrt(np.ptp(series.t_s)))
    region = f"everywhere (the bias walks at random, by {wandered:.2g} mdeg/s over the record)"
    return [Located(series.time_coordinate, "variance", region, analysis.walk_p, 1.0, True)]


def _verdict(effects: tuple[NamedEffect, ...], decided: Gate, remaining: bool, scatter: bool) -> str:
    unnamed = bool(decided.withheld) or remaining or scatter
    if effects:
        return "partly_explained" if unnamed else "explained"
    return "unexplained" if unnamed else "consistent"


def _explained_scatter(scatter: list[Located], decided: Gate, findings: list[Finding]) -> list[Located]:
    """Scatter that a named effect brings with it is no excess of its own."""
    names = {m.hypothesis.id for m in decided.named} | {f.effect for f in findings}
    if names & {"bursts", "mechanical_resonance", "quantisation", "truncation", "dead_zone"}:
        return [
            replace(s, remains=False)
            for s in scatter
            if s.coordinate not in ("rate", "data_set_index", "time")
        ]
    return scatter


def _named(member: Member, series: Series, refined: Refined, improvement: Improvement | None) -> NamedEffect:
    effect = CATALOGUE[member.hypothesis.id]
    nearest: dict[str, float] = {}
    for e, loss in member.rivals:
        if e in CATALOGUE and loss < CLASS_NATS:
            nearest.setdefault(e, loss)
    rivals = [
        Alternative(e, float(np.exp(min(loss, 50.0))), CATALOGUE[e].statement) for e, loss in nearest.items()
    ]
    parameters = by_data_set(series, refined.parameters[effect.id])
    alike: tuple[str, ...] = TWINS.get(effect.id, ())
    if effect.id == "dead_zone" and "table_angle" in series.untestable:
        # A table at rest keeps one phase of what turns with it, and nobody has logged which.
        alike = ("earth_rate_tilt", *TWINS["earth_rate_tilt"])
    twins = [Alternative(e, 1.0, CATALOGUE[e].statement) for e in alike]
    return NamedEffect(
        effect.id,
        effect.family,
        where(effect.statement, parameters),
        parameters,
        member.p_value,
        (*twins, *rivals),
        improvement,
        effect.runtime,
    )


def _found(finding: Finding) -> NamedEffect:
    effect = CATALOGUE[finding.effect]
    return NamedEffect(
        effect.id, effect.family, finding.statement, finding.parameters, finding.p_value, (), None, False
    )


def _noise_figures(series: Series, analysis: Analysis) -> NoiseFigures:
    levels = analysis.levels
    white = levels.white * analysis.setup.model.typical_white
    walk = None
    if np.all(series.averaging_s > 0):
        walk = 60.0 * levels.white * float(np.median(series.white_std_dps * np.sqrt(series.averaging_s)))
    # The processes are a decade apart, so that one takes the share of B^2/(2 pi f), which
    # IEEE 952 gives for both signs of the frequency, over a decade.
    flicker = levels.flicker_dps / np.sqrt(np.log(10.0) / np.pi) * 3600.0
    wander = levels.walk * 3600.0 * 60.0 if levels.walk and series.has_time else None
    return NoiseFigures(white, walk, float(flicker), 1e6 * levels.jitter, wander)


def _rows(series: Series, analysis: Analysis, refined: Refined) -> Rows:
    def known(values: Floats | None) -> Floats:
        return np.full(len(series), np.nan) if values is None else values

    return Rows(
        t_s=series.t_s,
        rate_dps=series.rate_dps,
        temp_c=series.temp_c,
        temp_rate_c_per_min=series.temp_rate_c_per_min,
        set_index=series.set_index,
        is_set=series.is_set,
        before_dps=refined.plain.left_dps,
        after_dps=refined.named.left_dps,
        white_std_dps=analysis.levels.white * series.white_std_dps,
        angle_deg=known(series.angle_deg),
        supply_v=known(series.supply_v),
        since_power_on_s=known(conditions_of(series).since_power_on_s),
        since_set_s=known(series.since_set_s),
        step_dps=known(series.step_dps),
        effect_dps=refined.effects_dps,
    )
