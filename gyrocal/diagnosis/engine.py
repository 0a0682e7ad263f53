"""`diagnose`: from a recording to a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.groups import distinct
from gyrocal.diagnosis.answer.at_rest import temperature_alone
from gyrocal.diagnosis.answer.correction import correction, doubtful, with_drifts
from gyrocal.diagnosis.answer.effects import layers_of, named_effects, open_laws, places_of_table
from gyrocal.diagnosis.answer.fresh_run import gain_on_a_fresh_run, need_rates, no_file
from gyrocal.diagnosis.answer.given import simulated_residual, surface_change, with_terms, without_terms
from gyrocal.diagnosis.answer.locate import coordinate_of, located, unnamed
from gyrocal.diagnosis.answer.residual import Residuals, residuals
from gyrocal.diagnosis.answer.rounding import beyond_rounding
from gyrocal.diagnosis.answer.staircase import staircase
from gyrocal.diagnosis.answer.surface import surface_alone, with_undetermined
from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.laws.at_rows import untestable
from gyrocal.diagnosis.laws.in_place import passes
from gyrocal.diagnosis.model.edges import told
from gyrocal.diagnosis.model.layers import Fitted
from gyrocal.diagnosis.model.parts import FLICKER
from gyrocal.diagnosis.model.within import strange_turns
from gyrocal.diagnosis.names.ways import strange_ways
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import (
    Diagnosis,
    Improvement,
    Located,
    NamedEffect,
    NoiseFigures,
    Rows,
    UnnamedPart,
    Verdict,
)
from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.inputs import check_inputs
from gyrocal.diagnosis.rows.means import angle_random_walk
from gyrocal.diagnosis.rows.scatter import (
    Finding,
    clock_findings,
    outlier_findings,
    step_findings,
    variance_places,
)
from gyrocal.diagnosis.rows.series import Series, series_of_run
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.rows.visited import LEAST_SPAN_C
from gyrocal.diagnosis.sweeps.changes import DRIFTS
from gyrocal.diagnosis.sweeps.strays import far_off, set_aside, stray_findings, without
from gyrocal.diagnosis.sweeps.unclocked import ask_for_times
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.inference.whitening import NoiseLevels, NoiseModel, estimate_levels, look_for_walk
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.kernels import PAUSE_S, PAUSE_STEPS
from gyrocal.physics.lacking import Reason
from gyrocal.physics.rate import DEAD_ZONE, FIT_DIRECTION, REFERENCE_RATE_ERROR, SAGNAC_SINE, TRUNCATION
from gyrocal.physics.surface import RATE_ORDER
from gyrocal.physics.terms import Term
from gyrocal.physics.thermal import RATE_HEATING, SHUPE, SMOOTHING_S
from gyrocal.physics.timewise import SCALE_DRIFT, SCALE_STEP, WARM_UP
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.records.run import Run, is_run_directory, read_run
from gyrocal.units import DPS_TO_DPH, MDPS, S_PER_H, S_PER_MIN

Floats = NDArray[np.float64]

#: A walk is taken in at this rate of false alarms at the most: the processes that stand for 1/f noise follow it to
#: some percent only, and a long record would have a walk make up for that.
_WALK_LEVEL = 1e-6
#: What is less probable than this is not said to be open.
_SURE = 0.05
#: Laws of a table that change the scale factor, whatever the temperature.
_OF_SCALE = (SCALE_DRIFT.id, SCALE_STEP.id, REFERENCE_RATE_ERROR.id)
#: A file is written from so many rows on. Of 12 files from made-up tables of 12 to 29 rows with one effect 3 made another run
#: worse, each with a probability of gain of more than 0.99.
_ENOUGH_ROWS = 30


@dataclass(frozen=True)
class Options:
    """Choices of a diagnosis.

    Attributes
    ----------
    false_alarm_rate : float
        Family-wise rate of patterns within a data set, places and parts without a name where there is nothing; a law has a
        name by its evidence, `gyrocal.diagnosis.laws.at_rows.GAIN`, whatever this is.
    seed : int
        Of the bootstrap.
    heldout : bool
        Whether to measure the layers on data left out.
    """

    false_alarm_rate: float = 0.01
    seed: int = 0
    heldout: bool = True


def series_of(
    recording: Path | Run | DataSetTable | Series, partner: Run | DataSetTable | None = None
) -> Series:
    """Rows of any recording that `diagnose` takes; `partner`: what it is compared with."""
    if isinstance(recording, Series):
        return recording
    if isinstance(recording, Path):
        recording = read_run(recording) if is_run_directory(recording) else read_data_sets(recording)
    if isinstance(recording, Run):
        return series_of_run(recording)
    return series_of_table(recording, partner if isinstance(partner, DataSetTable) else None)


def diagnose(
    recording: Path | Run | DataSetTable | Series,
    coefficients: Coefficients | None = None,
    options: Options | None = None,
) -> Diagnosis:
    """Compare a recording with its simulated sequence, correct what stays with the gyro, and name the physics.

    Parameters
    ----------
    recording : Path, Run, DataSetTable or Series
        A run directory, or a table of data sets (read it first where it is in counts); or rows made elsewhere.
    coefficients : Coefficients, optional
        The model to simulate from; without it the surface is fitted to the recording first.

    Raises
    ------
    InputError, DataError
        The recording cannot be read, or is too short to be examined.
    """
    level = (options := options or Options()).false_alarm_rate
    notes = check_inputs(recorded := series_of(recording), coefficients)
    whole = without_terms(recorded, coefficients)
    series, found, findings, lost = _taken_apart(whole, recorded.gyro_dps, level, coefficients)
    withheld = doubtful(found)
    surface, improved = surface_alone(found), correction(found, withheld)
    steps = layers_of(found, level) if options.heldout else []
    stairs = staircase(found, steps, surface.surface, options.seed)
    parts, layered = (*unnamed(found, level, withheld), *open_laws(found, level)), named_effects(found)
    written, why_not = _written(found, improved, surface, stairs.total, (layered, parts))
    parts = tuple(replace(p, corrected=p.corrected and written is not None) for p in parts)
    findings += _sampling(series, [*layered, *map(_found, findings)])
    names = [*layered, *map(_found, findings)]
    left = residuals(found, series, surface)
    far = far_off(series, left.after_dps)
    noise, levels, walk = _noise(series, left)
    scatter = variance_places(series, noise, levels, left.after_dps + left.wandering_dps, level)
    scatter = walk + _explained_scatter(scatter, names)
    change = None if coefficients is None else surface_change(found, coefficients, improved)
    strange = strange_turns(found.series, level) + strange_ways(series, left.after_dps, surface.surface)
    names = [replace(e, improvement=stairs.each.get(e.effect, e.improvement)) for e in names]
    places = [*places_of_table(found), *(f.place for f in findings)]
    everywhere = [*filter(None, [change]), *located(found, level), *strange, *places, *scatter]
    of_file = _of_file(found, withheld, (layered, parts), written, why_not)
    lacking = bool(parts or strange or scatter or change or far) or any(e.share < 1.0 for e in names)
    return Diagnosis(
        recording=whole.name,
        verdict=_verdict(names, lacking),
        located=tuple(sorted(everywhere, key=lambda place: place.p_value)),
        effects=tuple(names),
        not_testable=_not_testable(series, names),
        sentences=(),
        noise=_noise_figures(series, noise, levels),
        improvement=stairs.total,
        surface=coefficients or surface,
        improved=None if written is None else with_terms(written, coefficients),
        rows=_rows(series, left, coefficients, levels),
        notes=(*notes, *series.notes, *lost, *far, *of_file),
        layers=stairs.layers,
        unnamed=parts,
    )


def _beside(found: Examination, coefficients: Coefficients | None) -> Examination:
    """What was found beside a file to simulate from: that the error is a cubic of the true rate, of a sine or not, is none where the file's is already."""
    if coefficients is None or coefficients.surface.direction != "input":
        return found
    return replace(found, naming=replace(found.naming, input_gain=0.0), sine_nats=0.0)


def _taken_apart(
    whole: Series, output_dps: Floats, level: float, coefficients: Coefficients | None
) -> tuple[Series, Examination, list[Finding], list[Remark]]:
    """The rows that tell of the surface, what they were taken apart into, what the others tell, and what rounding hides."""
    series, findings, gross = set_aside(whole, output_dps)
    found, lost = beyond_rounding(_beside(examine(series, level), coefficients))
    findings += stray_findings(whole, gross.joined(found.strays))
    return without(series, found.strays.numbers), found, findings, lost


def _written(
    found: Examination,
    improved: Coefficients,
    surface: Coefficients,
    left_out: Improvement | None,
    what: tuple[list[NamedEffect], tuple[UnnamedPart, ...]],
) -> tuple[Coefficients | None, list[Remark]]:
    """The correction, where it has more than the surface and makes another run better; else why it is not written."""
    (layered, parts), means = what, found.model.means
    if not (layered or parts):
        need_rates(found.series.name, surface, means)
        # What models have that are nearly as good would move the surface for a reason that nobody can tell.
        return None, []
    if (rows := len(found.series)) < _ENOUGH_ROWS:
        return None, [Remark(Said.TOO_FEW_TO_WRITE, {"rows": rows, "enough": _ENOUGH_ROWS})]
    if not (layered or any(p.corrected for p in parts) or found.candidates):
        return None, []
    if 1 < (rates := distinct(means.rate_dps)) <= RATE_ORDER:
        return None, [Remark(Said.TOO_FEW_RATES, {"rates": rates, "enough": RATE_ORDER + 1})]
    if (
        not parts
        and {e.effect for e in layered} == {FIT_DIRECTION.id}
        and surface.surface.direction == "input"
    ):
        return None, [Remark(Said.INPUT_ALREADY, {"alone": True})]
    gain = gain_on_a_fresh_run(improved, surface, means)
    if not gain.is_enough:
        return None, [no_file(improved, means, gain.chance, left_out)]
    return with_undetermined(with_drifts(improved, found), means), []


def _of_file(
    found: Examination,
    withheld: list[str],
    what: tuple[list[NamedEffect], tuple[UnnamedPart, ...]],
    written: Coefficients | None,
    why_not: list[Remark],
) -> list[Remark]:
    """What is to be known of the correction: what is not in it, in which state it is, and what of it is open.

    Parameters
    ----------
    why_not : why it is not written
    """
    layered, parts = what
    edges = [Remark(Said.EDGE, facts) for facts in told(found.naming.fitted)]
    remarks = [
        *temperature_alone(found),
        *_not_logged(found.series, layered),
        *ask_for_times(found.series, [e.effect for e in layered]),
        *edges,
        *_before_sine(found, layered),
        *_wandering(found.naming.fitted),
    ]
    if why_not:
        return [*remarks, *why_not]
    seen = {p.coordinate for p in parts}
    coordinates = dict.fromkeys(coordinate_of(b, found.series) for b in withheld)
    remarks += [Remark(Said.NOT_WRITTEN, {"coordinate": c}) for c in coordinates if c in seen]
    again = found.comes_again
    held = () if written is None else [t.effect for t in written.terms if isinstance(t, Term)]
    warming = WARM_UP.seen_in in seen or WARM_UP.id in {*held, *(n.law.effect for n in found.naming.named)}
    if warming and _SURE < again < 1.0 - _SURE:
        remarks.append(Remark(Said.OPEN_SINCE_POWER_ON, {"again": again}))
    if written is None:
        return remarks
    of_input = written.surface.direction == "input" and any(e.effect == FIT_DIRECTION.id for e in layered)
    return [
        *remarks,
        *([Remark(Said.INPUT_ALREADY, {"alone": False})] if of_input else []),
        *_laws_written(layered, written),
        *_later_on_a_robot(found.series, written),
        *_also_written(layered, parts, written),
        *_held(found, layered),
    ]


def _before_sine(found: Examination, layered: Sequence[NamedEffect]) -> list[Remark]:
    """Named laws that change the scale factor before the sine of an open loop."""
    means = found.model.means
    effects = [e.effect for e in layered if e.effect in _OF_SCALE]
    at = int(np.argmax(np.abs(means.rate_dps)))
    share = float(np.broadcast_to(means.slope, len(means))[at])
    facts = {"effects": effects, "rate_dps": float(abs(means.rate_dps[at])), "share": share}
    return [Remark(Said.BEFORE_SINE, facts)] if effects and share != 1.0 else []


def _wandering(fitted: Fitted) -> list[Remark]:
    """What is taken for 1/f noise, where it is more than all other noise."""
    solution = fitted.solve()
    slow = [curve for name, curve in solution.random.items() if name.startswith(FLICKER)]
    wandered = np.sum(slow, axis=0) if slow else np.zeros(len(fitted.model.means))
    slow_dps, fast_dps = (float(np.sqrt(np.mean(x**2))) for x in (wandered, solution.left - wandered))
    if slow_dps <= fast_dps:
        return []
    return [Remark(Said.WANDERS, {"slow_mdps": slow_dps / MDPS, "fast_mdps": fast_dps / MDPS})]


def _not_logged(series: Series, layered: Sequence[NamedEffect]) -> list[Remark]:
    """Named laws that remember the temperature, of a table whose temperature changed in pauses of the log."""
    remember = [
        e.effect
        for e in layered
        if CATALOGUE[e.effect].family == SHUPE.family and e.effect != RATE_HEATING.id
    ]
    if not (series.is_table and series.has_time and remember):
        return []
    step_s = np.diff(series.t_s)
    paused = step_s > max(PAUSE_S, PAUSE_STEPS * float(np.median(step_s)))
    changed_c = np.where(paused, np.abs(np.diff(series.temp_c)), 0.0)
    unseen = changed_c > LEAST_SPAN_C
    if not unseen.any():
        return []
    longest_min, most_c = float(step_s[unseen].max() / S_PER_MIN), float(changed_c.max())
    facts = {"effects": remember, "pauses": int(unseen.sum()), "longest_min": longest_min, "most_c": most_c}
    return [Remark(Said.NOT_LOGGED_MEANWHILE, facts)]


def _also_written(
    layered: Sequence[NamedEffect], parts: Sequence[UnnamedPart], written: Coefficients
) -> list[Remark]:
    """Laws of the file that nothing was said of: those of models that are nearly as likely as the one that is told."""
    mentioned = {e.effect for e in layered} | {a.effect for e in layered for a in e.alternatives}
    mentioned |= {effect for part in parts for effect in part.nearest}
    # A zone stands for a cut, and the sine of an open loop is told by itself.
    mentioned |= {SAGNAC_SINE.id, FIT_DIRECTION.id, DEAD_ZONE.id}
    more = dict.fromkeys(t.effect for t in written.terms if isinstance(t, Term) and t.effect not in mentioned)
    return [Remark(Said.ALSO_WRITTEN, {"effects": [*more]})] if more else []


def _laws_written(layered: Sequence[NamedEffect], written: Coefficients) -> list[Remark]:
    """Named laws of the rate that a robot could evaluate and the correction lacks; the sine that it has."""
    held = {e.effect for e in layered if _mostly_held(e, written)}
    if written.surface.direction == "input":
        held.add(FIT_DIRECTION.id)
    if any(term.name == DEAD_ZONE.id for term in written.terms):
        held.add(TRUNCATION.id)
    mine = [e.effect for e in layered if e.runtime and e.family == DEAD_ZONE.family]
    lacking = [Remark(Said.LAW_NOT_WRITTEN, {"effect": e}) for e in mine if e not in held]
    return [*lacking, *_sines(written)]


def _later_on_a_robot(series: Series, written: Coefficients) -> list[Remark]:
    """What laws of the temperature's rate leave at run time, where it is that of the course up to then and not of the whole one."""
    if series.is_table:
        return []
    known = conditions_of(series)
    by_then, effects, late_dps = replace(known, temp_rate_c_per_s=None), list[str](), np.zeros(len(series))
    for term in written.terms:
        if isinstance(term, Term):
            left_dps = term.error_dps(known, written.surface) - term.error_dps(by_then, written.surface)
            effects += [term.effect] if left_dps.any() else []
            late_dps += left_dps
    if not effects:
        return []
    facts = {"effects": effects, "late_s": SMOOTHING_S, "late_dps": float(np.sqrt(np.mean(late_dps**2)))}
    return [Remark(Said.LATER_ON_A_ROBOT, facts)]


def _not_testable(series: Series, names: Sequence[NamedEffect]) -> dict[str, Reason]:
    """What the record cannot show, but for what was named all the same, from what stands for it."""
    shown = {CATALOGUE[e.effect].seen_in for e in names}
    missing = {what: why for what, why in series.untestable.items() if what not in shown}
    return missing | untestable(series, {e.effect for e in names})


def _mostly_held(named: NamedEffect, written: Coefficients) -> bool:
    """Whether a correction has at least half of a law, by the least amplitude that it may have."""
    laws = [t for t in written.terms if isinstance(t, Term) and t.effect == named.effect]
    held = sum(float(law.parameters["amplitude"]["value"]) for law in laws)
    known = named.parameters.get("amplitude")
    least = 0.0 if known is None else float(np.nanmin(np.abs([known.value, *known.interval_95])))
    return bool(laws) and abs(held) >= 0.5 * least


def _held(found: Examination, layered: Sequence[NamedEffect]) -> list[Remark]:
    """Named laws of what passes whose last state the correction has; of a drift of a table it has the mean."""
    lost = found.comes_again == 0.0
    passing = [e.effect for e in layered if passes(CATALOGUE[e.effect]) or (lost and e.effect == WARM_UP.id)]
    drifting = [e for e in passing if found.ranked and e in DRIFTS]
    held = [e for e in passing if e not in drifting]
    said = {Said.STATE_AT_END: held, Said.MEAN_OF_DRIFT: drifting}
    return [Remark(what, {"effects": effects}) for what, effects in said.items() if effects]


def _sines(written: Coefficients) -> list[Remark]:
    """What is to be said of the sine of an open loop, whose phase is told by its largest rate."""
    scale_dps = written.surface.rate_scale_dps
    laws = [term for term in written.terms if isinstance(term, Term) and term.effect == SAGNAC_SINE.id]
    phases = [law.parameters["phase_rad_per_dps"] for law in laws]
    # Of a law at a share of its own the phase was not fitted with the cubic.
    phases = [phase for phase in phases if phase["std"] > 0.0]
    sines = [{"phase_rad": scale_dps * p["value"], "std_rad": scale_dps * p["std"]} for p in phases]
    return [Remark(Said.SINE_WRITTEN, {"rate_dps": scale_dps, **sine}) for sine in sines]


def _sampling(series: Series, names: Sequence[NamedEffect]) -> list[Finding]:
    """What single samples and their times tell, but for what a named effect brings with it."""
    accounted = {a for e in names for a in CATALOGUE[e.effect].search.accounts_for}
    found = [*outlier_findings(series), *step_findings(series), *clock_findings(series)]
    return [f for f in found if f.effect not in accounted]


def _verdict(names: list[NamedEffect], lacking: bool) -> Verdict:
    if names:
        return "partly_explained" if lacking else "explained"
    return "unexplained" if lacking else "consistent"


def _explained_scatter(scatter: list[Located], names: list[NamedEffect]) -> list[Located]:
    """Scatter that a named effect brings with it is no excess of its own."""
    if not any(CATALOGUE[e.effect].search.scatters for e in names):
        return scatter
    return [s for s in scatter if s.coordinate not in ("rate", "data_set_index", "time")]


def _found(finding: Finding) -> NamedEffect:
    effect = CATALOGUE[finding.effect]
    return NamedEffect(
        effect.id, effect.family, finding.parameters, finding.p_value, (), None, False, seen=finding.seen
    )


def _noise(series: Series, left: Residuals) -> tuple[NoiseModel, NoiseLevels, list[Located]]:
    """Levels of the noise of what is left, and where the bias wanders farther than 1/f noise does: it is no law."""
    model = NoiseModel(series)
    here = left.surface.surface.design(series.gyro_dps, series.temp_c)[:, carried_terms(series)]
    y = left.after_dps + left.wandering_dps
    still = estimate_levels(model, y, here)
    levels, p = look_for_walk(model, y, here, still)
    if p > _WALK_LEVEL or not levels.walk:
        return model, still.levels, []
    # Of a record whose 1/f noise a walk stands for it would go farther than all that is left.
    wandered = min(levels.walk * float(np.sqrt(np.ptp(series.t_s))), float(np.sqrt(np.mean(y**2))))
    place = Located(series.time_coordinate, "variance", p, 1.0, True, target="walk", rms_dps=wandered)
    return model, levels, [place]


def _noise_figures(series: Series, model: NoiseModel, levels: NoiseLevels) -> NoiseFigures:
    walk = angle_random_walk(series)
    # The processes are a decade apart, so that one takes the share of B^2/(2 pi f), which
    # IEEE 952 gives for both signs of the frequency, over a decade.
    flicker = levels.flicker_dps / np.sqrt(np.log(10.0) / np.pi) * DPS_TO_DPH
    wander = levels.walk * DPS_TO_DPH * S_PER_H**0.5 if levels.walk and series.has_time else None
    return NoiseFigures(
        levels.white * model.typical_white, walk and walk[0], float(flicker), 1e6 * levels.jitter, wander
    )


def _rows(series: Series, left: Residuals, coefficients: Coefficients | None, levels: NoiseLevels) -> Rows:
    def known(values: Floats | None) -> Floats:
        return np.full(len(series), np.nan) if values is None else values

    before = left.before_dps if coefficients is None else simulated_residual(series, coefficients)
    return Rows(
        t_s=series.t_s,
        rate_dps=series.rate_dps,
        temp_c=series.temp_c,
        temp_rate_c_per_min=series.temp_rate_c_per_min,
        set_index=series.set_index,
        is_set=series.is_set,
        before_dps=before,
        after_dps=left.after_dps,
        white_std_dps=levels.white * series.white_std_dps,
        angle_deg=known(series.angle_deg),
        supply_v=known(series.supply_v),
        since_power_on_s=known(conditions_of(series).since_power_on_s),
        since_set_s=known(series.since_set_s),
        step_dps=known(series.step_dps),
        effect_dps=left.effects_dps,
    )
