"""From the findings in a drive log to a verdict: names with their families and rivals, held-out gain, sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive import LEVEL_OF_A_CHECK, LEVEL_OF_LAWS, Question, YawFit
from gyrocal.diagnosis.drive_checks import Found, eccentric_wheel, of_the_log, wrong_unit
from gyrocal.diagnosis.drive_effects import EFFECTS, strongest_first, temperature_span_c
from gyrocal.diagnosis.drive_heldout import explain_with_gain
from gyrocal.diagnosis.drive_noise import ISOLATED, slip_times, yaw_noise
from gyrocal.diagnosis.drive_series import DriveSeries, bins_of, drive_series
from gyrocal.diagnosis.drive_told import (
    Told,
    ask_truth,
    better_name,
    contradicted,
    corrected,
    scales_found,
    twins_of_slip,
    widened,
)
from gyrocal.diagnosis.result import Alternative, Diagnosis, Estimate, Improvement, Located, NamedEffect
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot

Floats = NDArray[np.float64]

#: The most that the Earth's turn adds to a gyro, mdeg/s: a larger bias is none of it.
_EARTH_MDPS = 4.2
#: Places of effects found by checks of their own: coordinate and region.
_PLACES = {
    "wheel_eccentricity": ("wheel_angle", "once a turn of the wheel"),
    "wheel_scale": ("speed", "wherever the robot moves"),
    "gyro_scale": ("turn_rate", "all turns"),
    "dropped_samples": ("time", "at the gaps"),
    "timestamp_jitter": ("time", "all along"),
    "unit_or_sign": ("turn_rate", "all turns"),
    "encoder_quantisation": ("speed", "all along"),
}
#: Findings about the logging itself: they are named, but say nothing of an excess in the heading difference.
_OF_THE_LOG = ("encoder_quantisation", "dropped_samples", "timestamp_jitter")
#: Evidence that tells nothing apart.
_ALIKE = 3.0
#: A scale known no better than this (relative) counts as not testable.
_BLUNT = 0.02


@dataclass(frozen=True)
class DriveDiagnosis:
    """The diagnosis, with what its pictures need."""

    diagnosis: Diagnosis
    series: DriveSeries
    fit: YawFit


def diagnose_drive(
    source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None = None, seed: int = 0
) -> DriveDiagnosis:
    """Diagnose a drive log: encoders against gyro, and both against the truth where there is one.

    Parameters
    ----------
    coefficients : Coefficients, optional
        Calibrates the gyro first; the log must have its temperature then.

    Raises
    ------
    DataError
        The log is too short, does not move, or lacks a channel that was asked for.
    """
    logged = drive_series(source, log, robot, coefficients)
    factor, unit = wrong_unit(logged)
    nominal = replace(logged, gyro_deg=logged.gyro_deg * factor)
    answer = _answer(nominal, seed)
    fit, told = answer.fit, answer.told
    wheel = eccentric_wheel(answer.series, fit.model.delay_s, _ratio(fit), LEVEL_OF_A_CHECK)
    of_log, remarks = of_the_log(log, nominal.usual_dt_s, fit, robot.wheel_separation_m)
    found = [f for f in (unit, wheel, *scales_found(told), *of_log) if f is not None]
    effects = tuple(_named(answer, name) for name in fit.model.names()) + tuple(_found(f) for f in found)
    if len(effects) == 1 and effects[0].effect in told.scales:
        effects = (replace(effects[0], improvement=answer.total),)
    taken = {place.coordinate for place in answer.places}
    located = (*answer.places, *(p for p in map(_place, found) if p.coordinate not in taken))
    diagnosis = Diagnosis(
        recording=source,
        verdict=_verdict(effects, located),
        located=located,
        effects=effects,
        not_testable=_not_testable(nominal, fit, told),
        sentences=(),
        noise=None,
        improvement=answer.total,
        surface=coefficients,
        improved=None,
        rows=None,
        notes=(*nominal.notes, *remarks, *([told.note] if told.note else [])),
    )
    said = _sentences(diagnosis, answer)
    return DriveDiagnosis(replace(diagnosis, sentences=said), nominal, fit)


@dataclass(frozen=True)
class _Answer:
    """What encoders, gyro and truth say together.

    Attributes
    ----------
    series : DriveSeries
        The log with the scales taken out that the truth names.
    total, gains : improvements of all named laws, and of each
    refused : laws that fit and do not help on data left out
    slip_p_value : of a slip beside the named scales, 0 where there are none
    """

    series: DriveSeries
    fit: YawFit
    told: Told
    total: Improvement | None
    gains: Mapping[str, Improvement]
    refused: tuple[str, ...]
    places: tuple[Located, ...]
    slip_p_value: float


def _answer(nominal: DriveSeries, seed: int) -> _Answer:
    asked = Question.of(nominal, yaw_noise(nominal))
    fit, total, gains, refused = explain_with_gain(asked, nominal, seed)
    first = fit
    told = ask_truth(nominal, fit)
    series, banned = corrected(nominal, told.scales), contradicted(told, fit)
    slip_p_value = 0.0
    if told.scales or banned:
        asked = replace(Question.of(series, yaw_noise(series)), banned=banned)
        fit, total, gains, refused = explain_with_gain(asked, nominal, seed)
    if told.scales and "skid_slip" in fit.parameters:
        parameters, slip_p_value = widened(told, fit.parameters["skid_slip"])
        if slip_p_value <= LEVEL_OF_LAWS:
            fit = replace(fit, parameters=fit.parameters | {"skid_slip": dict(parameters)})
        else:
            # What the truth leaves open of the scales is enough to make encoders and gyro agree.
            series = replace(series, encoder_deg=series.encoder_deg / _ratio(fit))
            asked = replace(Question.of(series, yaw_noise(series)), banned=banned | {"skid_slip"})
            fit, total, gains, refused = explain_with_gain(asked, nominal, seed)
    bare = bins_of(nominal, 0.0)
    fit = replace(fit, before_deg=bare.encoder_deg - bare.gyro_deg)
    places = list(fit.places)
    if fit is not first:
        now = {(p.coordinate, p.statistic) for p in places}
        places += [replace(p, remains=False) for p in first.places if (p.coordinate, p.statistic) not in now]
    places += [] if told.fit is None else told.fit.places
    places += _homes(fit, {p.coordinate for p in places})
    places = list(strongest_first(places))
    return _Answer(series, fit, told, total, gains, refused, tuple(places), slip_p_value)


def _ratio(fit: YawFit) -> float:
    """Encoder yaw over gyro yaw in turns, by the slip that was named."""
    slip = fit.law_deg.get("skid_slip")
    return (
        1.0
        if slip is None
        else 1.0 + float(slip @ fit.bins.gyro_deg / (fit.bins.gyro_deg @ fit.bins.gyro_deg))
    )


def _homes(fit: YawFit, taken: set[str]) -> list[Located]:
    """Where named laws live, if the tests over whole coordinates, blunter than those of one law, did not say so."""
    bare, found = float(np.sum(fit.before_deg**2)), []
    for name in fit.model.names():
        coordinate = EFFECTS[name].seen_in
        if coordinate not in taken:
            share = min(float(np.sum(fit.law_deg[name] ** 2)) / bare, 1.0)
            found.append(Located(coordinate, "mean", "where its law is", fit.p_values[name], share))
            taken.add(coordinate)
    return found


def _verdict(effects: Sequence[NamedEffect], places: Sequence[Located]) -> str:
    remains = any(place.remains for place in places)
    if effects:
        return "partly_explained" if remains else "explained"
    return "unexplained" if remains else "consistent"


def _named(answer: _Answer, law: str) -> NamedEffect:
    fit, name = answer.fit, law
    parameters: Mapping[str, Estimate] = fit.parameters[law]
    alternatives, p_value = [], fit.p_values[law]
    if law == "gyro_bias" and min(map(abs, parameters["amplitude"].interval_95)) < _EARTH_MDPS:
        alternatives.append(Alternative("earth_rate", 1.0, EFFECTS["earth_rate"].statement))
    if law == "skid_slip":
        p_value = max(p_value, answer.slip_p_value)
        # A slip that grows with the turn rate is not what a scale factor does.
        if parameters["exponent"].value == 0.0:
            twins = twins_of_slip(answer.told, parameters["amplitude"].value / 100.0)
            name, parameters, twins = better_name(parameters, twins)
            alternatives += twins
    alternatives += [Alternative(e, r, EFFECTS[e].statement) for e, r in fit.rivals.get(law, {}).items()]
    effect = EFFECTS[name]
    return NamedEffect(
        name, effect.family, effect.statement, parameters, p_value, tuple(alternatives), answer.gains.get(law),
        effect.runtime,
    )  # fmt: skip


def _found(found: Found) -> NamedEffect:
    effect = EFFECTS[found.effect]
    return NamedEffect(
        found.effect,
        effect.family,
        found.sentence,
        found.parameters,
        found.p_value,
        found.alternatives,
        None,
        effect.runtime,
    )


def _place(found: Found) -> Located:
    coordinate, where = _PLACES[found.effect]
    return Located(coordinate, "mean", where, found.p_value, float("nan"))


def _not_testable(series: DriveSeries, fit: YawFit, told: Told) -> dict[str, str]:
    """Effects that this log cannot show, with the reason."""
    reasons = {
        "robot_tilt": "the log has no inclination",
        "earth_rate": "it cannot be told from a gyro bias",
        "start_stop_slip": "it changes distances for moments only, which nothing in the log resolves",
        "encoder_overcount": "single bumps cannot be told from the wheels' noise, nor many of them from a scale of the wheels",
    }
    if temperature_span_c(fit.bins) < 0.5:
        reasons["bias_temperature"] = "the log has no gyro temperature, or it hardly changes"
    if told.fit is None:
        reasons["gyro_scale"] = (
            "from heading differences alone it cannot be told from the effective wheel separation; "
            "calibrate the gyro on a bench"
        )
        reasons["wheel_scale"] = "the log has no true positions, or too few, to compare distances with"
        return reasons
    for name, what in (("gyro_scale", "turns"), ("wheel_scale", "way")):
        std = told.fit.stds.get(name)
        if std is None or std > _BLUNT:
            known = "not at all" if std is None else f"to {100 * std:.2g} % only"
            reasons[name] = f"with this truth and so few {what} it is known {known}"
    return reasons


def _sentences(diagnosis: Diagnosis, answer: _Answer) -> tuple[str, ...]:
    """What there is to say, plainly, in order."""
    fit, series = answer.fit, answer.series
    lines = [_first_sentence(diagnosis, answer)]
    lines += [_effect_sentence(e) for e in diagnosis.effects]
    lines += _slip_sentences(fit)
    for place in diagnosis.located:
        where = place.coordinate.replace("_", " ")
        if place.remains and not place.region.startswith(ISOLATED):
            lines.append(f"Structure remains in {where}: {place.region} (p = {place.p_value:.2g})")
        elif place.statistic == "variance":
            lines.append(
                f"The scatter changes with {where} beyond what way and turn make, most at {place.region}"
            )
    lines += [
        f"{name} would fit, but does not lessen the error on data left out, and is not named"
        for name in answer.refused
    ]
    lines += _truth_sentences(answer.told)
    gain = diagnosis.improvement
    if gain is not None:
        low, high = gain.interval_95
        lines.append(
            f"On data left out the difference of the yaw rates falls from {gain.heldout_rms_before_dps:.3g} to "
            f"{gain.heldout_rms_after_dps:.3g} deg/s rms (drop {low:.3g} to {high:.3g} at 95 %), where curves over every "
            f"coordinate would leave {gain.noise_floor_dps:.3g}"
        )
    drift = [float(np.ptp(np.cumsum(x))) for x in (fit.before_deg, fit.after_deg)]
    after = (
        f", and {drift[1]:.3g} deg once the named effects are taken out"
        if fit.model.names() or answer.told.scales
        else ""
    )
    lines.append(
        f"Over {series.duration_s:.0f} s and {np.sum(np.abs(np.diff(series.distance_m))):.0f} m the encoders' heading wanders "
        f"{drift[0]:.3g} deg from the gyro's{after}"
    )
    return tuple(lines)


def _first_sentence(diagnosis: Diagnosis, answer: _Answer) -> str:
    """Whether encoders and gyro agree, and whether what is named explains it."""
    said = {
        "consistent": "Encoders and gyro agree within their noise.",
        "explained": "Encoders and gyro disagree, and the physics named below explains it.",
        "partly_explained": "Encoders and gyro disagree; the physics named below explains a part of it.",
        "unexplained": "Encoders and gyro disagree, and no effect of the catalogue explains it.",
    }[diagnosis.verdict]
    if any(e.effect not in _OF_THE_LOG for e in diagnosis.effects):
        return said
    remains = [place for place in answer.fit.places if place.remains]
    exceptions = []
    if remains and all(place.region.startswith(ISOLATED) for place in remains):
        exceptions.append("isolated slips")
    elif remains:
        return said
    if answer.told.fit is not None and answer.told.fit.places:
        exceptions.append("the path that they make departs from the truth's")
    but = f", but for what follows: {', and '.join(exceptions)}" if exceptions else ""
    of_log = "; what is named below lies in the log itself" if diagnosis.effects else ""
    return f"Encoders and gyro agree within their noise{but}{of_log}."


def _slip_sentences(fit: YawFit) -> list[str]:
    """Isolated slips, with the largest."""
    noise = fit.noise
    if not noise.slips.size:
        return []
    times = slip_times(fit.bins, noise)
    largest = float(noise.slip_deg[np.argmax(np.abs(noise.slip_deg))])
    listed = ", ".join(f"{t:.0f}" for t in times[:10]) + " s" + (" and later" if len(times) > 10 else "")
    return [
        f"Isolated slips of a wheel (or spikes of the gyro): {len(times)}, at t = {listed}; the encoders' heading jumps from "
        f"the gyro's by up to {abs(largest):.2g} deg; these seconds are left out of all fits"
    ]


def _truth_sentences(told: Told) -> list[str]:
    """What the truth says of the scales, named or not."""
    if told.fit is None:
        return []
    parts = []
    for name, what in (("wheel_scale", "the distances"), ("gyro_scale", "the gyro's scale")):
        if name in told.fit.values:
            left = 1.0 - told.fit.values[name]
            value, std = 100 * (1.0 / left - 1.0), 100 * told.fit.stds[name] / left**2
            decimals = _decimals(std)
            parts.append(f"{what} off by {value:.{decimals}f} ± {std:.{decimals}f} %")
    seen = "positions and headings" if told.fit.headings else "positions"
    return [f"Against the truth's {seen}: {', '.join(parts)}"] if parts else []


def _decimals(std: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 9)) if std > 0 and np.isfinite(std) else 3


def _value(e: Estimate) -> str:
    """Value, unit and interval, all rounded to the same decimal."""
    unit = "" if e.unit == "1" else f" {e.unit}"
    if np.isnan(e.interval_95[0]):
        return f"{e.value:.4g}{unit}"
    d = _decimals(e.std)
    return f"{e.value:.{d}f}{unit} (95 %: {e.interval_95[0]:.{d}f} to {e.interval_95[1]:.{d}f})"


def _effect_sentence(effect: NamedEffect) -> str:
    amplitude = effect.parameters["amplitude"]
    statement = effect.statement
    if effect.effect == "gyro_delay" and amplitude.value < 0:
        statement = "The encoders' counts arrive later than the gyro's rate (a negative delay)."
    if effect.effect == "skid_slip" and amplitude.value < 0:
        statement = "In turns the encoders see less than the gyro: the robot turns as if its wheels stood closer together than the robot file says."
    others = [_other(a) for a in effect.alternatives]
    rest = f"; it could also be {', '.join(others)}" if others else ""
    return f"{effect.effect}: {statement.rstrip('.')}: {_value(amplitude)}{rest}"


def _other(a: Alternative) -> str:
    if a.evidence_ratio == 1.0:
        return f"{a.effect} (equally well)"
    if 1 / _ALIKE < a.evidence_ratio < _ALIKE:
        return f"{a.effect} (about as well)"
    if a.evidence_ratio > 1.0:
        return f"{a.effect} ({a.evidence_ratio:.2g} to 1 against it)"
    return f"{a.effect} ({1 / a.evidence_ratio:.2g} to 1 for it)"
