"""From the findings in a drive log to a verdict: names with their families and rivals, held-out gain, sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis import robust
from gyrocal.diagnosis.drive import BLOCK_S, LEVEL_OF_A_CHECK, Model, YawFit, explain, refitted
from gyrocal.diagnosis.drive_checks import (
    Found,
    eccentric_wheel,
    ticks,
    time_stamps,
    wheel_scale,
    wrong_unit,
)
from gyrocal.diagnosis.drive_effects import EFFECTS, coordinates, temperature_span_c
from gyrocal.diagnosis.drive_series import DriveSeries, bins_of, drive_series
from gyrocal.diagnosis.result import Alternative, Diagnosis, Improvement, Located, NamedEffect
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot

Floats = NDArray[np.float64]

_FOLDS = 10
_BOOTSTRAP = 2000
#: Physics that gives the same columns, so that a heading difference cannot tell it from the name; 1 : 1.
_TWINS = {
    "skid_slip": ("gyro_scale", "robot_tilt"),
    "gyro_bias": ("earth_rate",),
    "wheel_scale": ("encoder_overcount", "start_stop_slip"),
}
#: Places of effects found by checks of their own: coordinate and region.
_PLACES = {
    "wheel_eccentricity": ("wheel_angle", "once a turn of the wheel"),
    "wheel_scale": ("speed", "wherever the robot moves"),
    "dropped_samples": ("time", "at the gaps"),
    "timestamp_jitter": ("time", "all along"),
    "unit_or_sign": ("turn_rate", "all turns"),
    "encoder_quantisation": ("speed", "all along"),
}
#: Findings about the logging itself: they are named, but say nothing of an excess in the heading difference.
_OF_THE_LOG = ("encoder_quantisation", "dropped_samples", "timestamp_jitter")


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
    series = drive_series(source, log, robot, coefficients)
    factor, unit = wrong_unit(series)
    series = replace(series, gyro_deg=series.gyro_deg * factor)
    scale = wheel_scale(series, LEVEL_OF_A_CHECK)
    if scale is not None:
        # A scale of both wheels turns the encoders' heading too, and must not be taken for slip.
        series = _rescaled(series, 1.0 + scale.parameters["amplitude"].value / 100.0)
    fit = explain(series, seed)
    slip = fit.law_deg.get("skid_slip", np.zeros(fit.bins.t_s.size))
    ratio = 1.0 + float(np.sum(slip * fit.bins.gyro_deg) / np.sum(fit.bins.gyro_deg**2))
    others = [
        unit,
        eccentric_wheel(series, fit.model.delay_s, ratio, LEVEL_OF_A_CHECK),
        scale,
    ]
    found = [f for f in (*others, ticks(log), *time_stamps(log, series.usual_dt_s)) if f is not None]
    total, gains = _improvements(series, fit, seed)
    effects = tuple(_named(fit, name, gains.get(name)) for name in fit.model.names())
    effects += tuple(_found(f) for f in found)
    located = (*fit.places, *(_place(f) for f in found))
    diagnosis = Diagnosis(
        recording=source,
        verdict=_verdict(effects, fit.places),
        located=located,
        effects=effects,
        not_testable=_not_testable(series, fit),
        sentences=(),
        noise=None,
        improvement=total,
        surface=coefficients,
        improved=None,
        rows=None,
        notes=series.notes,
    )
    return DriveDiagnosis(replace(diagnosis, sentences=_sentences(diagnosis, fit, series)), series, fit)


def _rescaled(series: DriveSeries, scale: float) -> DriveSeries:
    return replace(
        series,
        encoder_deg=series.encoder_deg / scale,
        left_m=series.left_m / scale,
        right_m=series.right_m / scale,
    )


def _verdict(effects: Sequence[NamedEffect], places: Sequence[Located]) -> str:
    physics = [e for e in effects if e.effect not in _OF_THE_LOG]
    remains = any(place.remains for place in places)
    if physics:
        return "partly_explained" if remains else "explained"
    return "unexplained" if remains else "consistent"


def _named(fit: YawFit, name: str, improvement: Improvement | None) -> NamedEffect:
    effect = EFFECTS[name]
    shape = fit.parameters[name].get("exponent")
    # A slip that grows with the turn rate is not what a scale factor does.
    twins = _TWINS.get(name, ()) if shape is None or shape.value == 0.0 else ()
    alternatives = [Alternative(t, 1.0, EFFECTS[t].statement) for t in twins]
    alternatives += [Alternative(e, r, EFFECTS[e].statement) for e, r in fit.rivals.get(name, {}).items()]
    return NamedEffect(
        name, effect.family, effect.statement, fit.parameters[name], fit.p_values[name], tuple(alternatives),
        improvement, effect.runtime,
    )  # fmt: skip


def _found(found: Found) -> NamedEffect:
    effect = EFFECTS[found.effect]
    twins = tuple(Alternative(t, 1.0, EFFECTS[t].statement) for t in _TWINS.get(found.effect, ()))
    return NamedEffect(
        found.effect,
        effect.family,
        found.sentence,
        found.parameters,
        found.p_value,
        twins,
        None,
        effect.runtime,
    )


def _place(found: Found) -> Located:
    coordinate, where = _PLACES[found.effect]
    return Located(coordinate, "mean", where, found.p_value, float("nan"))


def _improvements(
    series: DriveSeries, fit: YawFit, seed: int
) -> tuple[Improvement | None, dict[str, Improvement]]:
    """Held-out gain of all named effects together, and of each when it is left out of them."""
    names = fit.model.names()
    if not names:
        return None, {}
    without = {
        name: replace(fit.model, delayed=False, delay_s=0.0)
        if name == "gyro_delay"
        else replace(fit.model, members=tuple(m for m in fit.model.members if m.effect != name))
        for name in names
    }
    bins = fit.bins
    fold = np.arange(bins.t_s.size) * _FOLDS // bins.t_s.size
    after = _heldout(series, fit.model, fold)
    floor = _floor_dps(series, fit)
    total = _improvement(fit.before_deg, after, bins.width_s, floor, seed)
    each = {
        name: _improvement(_heldout(series, model, fold), after, bins.width_s, floor, seed)
        for name, model in without.items()
    }
    return total, each


def _heldout(series: DriveSeries, model: Model, fold: NDArray[np.int64]) -> Floats:
    """What a model leaves in bins that its coefficients and its delay were not fitted to, deg a bin."""
    left = np.empty(fold.size)
    for k in range(_FOLDS):
        moved = refitted(series, model, fold != k)
        bins = bins_of(series, moved.delay_s)
        y = bins.encoder_deg - bins.gyro_deg
        columns = np.hstack([np.zeros((y.size, 0)), *(m.columns for m in moved.members)])
        values = np.linalg.lstsq(columns[fold != k], y[fold != k], rcond=None)[0]
        left[fold == k] = (y - columns @ values)[fold == k]
    return left


def _floor_dps(series: DriveSeries, fit: YawFit) -> float:
    """What is left when curves over every coordinate are fitted beside the named effects, deg/s."""
    curves = [c.columns for c in coordinates(series, fit.bins, fit.model.delay_s)]
    columns = np.hstack(curves)
    left = fit.after_deg - columns @ np.linalg.lstsq(columns, fit.after_deg, rcond=None)[0]
    rank = int(np.linalg.matrix_rank(columns))
    return float(np.sqrt(left @ left / max(left.size - rank, 1))) / fit.bins.width_s


def _improvement(before: Floats, after: Floats, width_s: float, floor: float, seed: int) -> Improvement:
    """Drop of rms and of Gaussian log-loss, by a paired bootstrap of blocks."""
    starts = robust.block_starts(before.size, round(BLOCK_S / width_s))
    squares = np.stack([np.add.reduceat(x**2, starts) for x in (before, after)])
    counts = np.diff(starts, append=before.size)
    rng = np.random.default_rng([seed, 99])
    drawn = rng.integers(0, starts.size, size=(_BOOTSTRAP, starts.size))
    rms = np.sqrt(squares[:, drawn].sum(axis=2) / counts[drawn].sum(axis=1)) / width_s
    drops = np.quantile(rms[0] - rms[1], [0.025, 0.975])
    # Log-loss of a Gaussian whose spread is the residual's own, a block's worth of bins at a time.
    nats = np.log(rms) * float(np.mean(counts))
    gains = np.quantile(nats[0] - nats[1], [0.025, 0.975])
    rms_before, rms_after = (float(np.sqrt(np.mean(x**2))) / width_s for x in (before, after))
    excess = rms_before**2 - floor**2
    removed = (rms_before**2 - rms_after**2) / excess if excess > 0 else float("nan")
    per_block = 0.5 * float(np.mean(counts))
    return Improvement(
        rms_before, rms_after, floor, (float(drops[0]), float(drops[1])),
        per_block * (1 + np.log(2 * np.pi * rms_before**2)), per_block * (1 + np.log(2 * np.pi * rms_after**2)),
        (float(gains[0]), float(gains[1])), float(np.clip(removed, -np.inf, 1.0)),
        f"tenths of the log in turn, yaw rate in bins of {width_s:g} s",
    )  # fmt: skip


def _not_testable(series: DriveSeries, fit: YawFit) -> dict[str, str]:
    """Effects that this log cannot show, with the reason."""
    reasons = {
        "gyro_scale": "from heading differences alone it cannot be told from the effective wheel separation; calibrate the gyro on a bench",
        "robot_tilt": "the log has no inclination",
        "earth_rate": "it cannot be told from a gyro bias",
        "start_stop_slip": "it changes distances, and the truth's positions are too coarse for that",
    }
    if temperature_span_c(fit.bins) < 0.5:
        reasons["bias_temperature"] = "the log has no gyro temperature, or it hardly changes"
    if not np.any(np.isfinite(series.truth_x_m)):
        without = "the log has no true positions to compare distances with"
        reasons |= dict.fromkeys(("wheel_scale", "encoder_overcount", "start_stop_slip"), without)
    else:
        reasons["encoder_overcount"] = "the truth's positions do not resolve single bumps"
    return reasons


def _sentences(diagnosis: Diagnosis, fit: YawFit, series: DriveSeries) -> tuple[str, ...]:
    """What there is to say, plainly, in order."""
    said = {
        "consistent": "Encoders and gyro agree within their noise.",
        "explained": "Encoders and gyro disagree, and the physics named below explains it.",
        "partly_explained": "Encoders and gyro disagree; the physics named below explains a part of it.",
        "unexplained": "Encoders and gyro disagree, and no effect of the catalogue explains it.",
    }
    lines = [said[diagnosis.verdict]]
    lines += [_effect_sentence(e) for e in diagnosis.effects]
    for place in diagnosis.located:
        if place.remains:
            lines.append(
                f"Structure remains in {place.coordinate.replace('_', ' ')}: {place.region} (p = {place.p_value:.2g})"
            )
        elif place.statistic == "variance":
            lines.append(
                f"The scatter changes with {place.coordinate.replace('_', ' ')}, most at {place.region}"
            )
    gain = diagnosis.improvement
    if gain is not None:
        low, high = gain.interval_95
        lines.append(
            f"On data left out the difference of the yaw rates falls from {gain.heldout_rms_before_dps:.3g} to "
            f"{gain.heldout_rms_after_dps:.3g} deg/s rms (drop {low:.3g} to {high:.3g} at 95 %), where curves over every "
            f"coordinate would leave {gain.noise_floor_dps:.3g}"
        )
    drift = [float(np.ptp(np.cumsum(x))) for x in (fit.before_deg, fit.after_deg)]
    lines.append(
        f"Over {series.duration_s:.0f} s and {series.distance_m[-1]:.0f} m the encoders' heading wanders {drift[0]:.3g} deg from "
        f"the gyro's, and {drift[1]:.3g} deg once the named effects are taken out"
    )
    return tuple(lines)


def _effect_sentence(effect: NamedEffect) -> str:
    amplitude = effect.parameters["amplitude"]
    low, high = amplitude.interval_95
    interval = "" if np.isnan(low) else f" (95 %: {low:.3g} to {high:.3g})"
    statement = effect.statement
    if effect.effect == "gyro_delay" and amplitude.value < 0:
        statement = "The encoders' counts arrive later than the gyro's rate (a negative delay)."
    if effect.effect == "skid_slip" and amplitude.value < 0:
        statement = "In turns the encoders see less than the gyro: the robot turns as if its wheels stood closer together than the robot file says."
    others = [a.effect for a in effect.alternatives]
    rest = f"; this log cannot tell it from {', '.join(others)}" if others else ""
    return f"{effect.effect}: {statement.rstrip('.')}: {amplitude.value:.4g} {amplitude.unit}{interval}{rest}"
