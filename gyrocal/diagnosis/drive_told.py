"""What the truth settles: scales that are named, series corrected for them, and which twin of a law remains possible."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive import LEVEL_OF_A_CHECK, YawFit
from gyrocal.diagnosis.drive_checks import NEGLIGIBLE, Found
from gyrocal.diagnosis.drive_effects import EFFECTS
from gyrocal.diagnosis.drive_noise import YawNoise
from gyrocal.diagnosis.drive_rests import white_rate_dps_rt_s
from gyrocal.diagnosis.drive_series import STANDING_MPS, DriveSeries
from gyrocal.diagnosis.drive_truth import TruthFit, Walks, truth_fit
from gyrocal.diagnosis.result import Alternative, Estimate
from gyrocal.records.robot import BIAS_STD_AFTER_REST_DPS
from gyrocal.units import DEG_TO_RAD

Floats = NDArray[np.float64]

#: Evidence against a twin beyond which it is not listed any more, and the largest that is claimed.
_OUT, _MOST = 100.0, 1e6
#: Evidence against the slip from which on a twin is named instead.
_PREFERRED = 1.0 / 3.0
#: Standard deviations apart at which two estimates of one bias contradict each other.
_APART = 4.0
_ASTRAY = "the truth's positions do not follow the path (mirrored, swapped, or of another drive?), so they were left aside"
_SCALES = ("wheel_scale", "gyro_scale")
_BIASES = ("gyro_bias", "bias_temperature")
_UNIT = {"wheel_scale": ("%", 100.0), "gyro_scale": ("ppm", 1e6)}


@dataclass(frozen=True)
class Told:
    """The truth's fit, and the scales that it names: relative errors, of `_SCALES`."""

    fit: TruthFit | None
    scales: Mapping[str, float]
    note: str = ""

    def spread(self) -> float:
        """Standard deviation that the named scales leave in the ratio of encoders' and gyro's heading."""
        if self.fit is None or not self.scales:
            return 0.0
        stds = [self.fit.stds[n] if n in self.scales else 0.0 for n in _SCALES]
        return float(
            np.sqrt(max(stds[0] ** 2 + stds[1] ** 2 - 2 * self.fit.correlation * stds[0] * stds[1], 0.0))
        )


def ask_truth(series: DriveSeries, fit: YawFit) -> Told:
    """Lay the path onto the truth; a scale is named where nothing else lives in the path."""
    told = truth_fit(
        _steadied(series, fit), fit.model.delay_s, _walks(series, fit.noise, fit), LEVEL_OF_A_CHECK
    )
    if told is not None and not told.follows:
        return Told(None, {}, _ASTRAY)
    if told is None or told.places:
        return Told(told, {})
    named = {
        n: told.values[n] / (1.0 - told.values[n])
        for n in _SCALES
        if told.p_values.get(n, 1.0) <= LEVEL_OF_A_CHECK and abs(told.values[n]) > NEGLIGIBLE
    }
    return Told(told, named)


def _steadied(series: DriveSeries, fit: YawFit) -> DriveSeries:
    """The gyro without the bias and the drift by temperature that were named; what is left of a bias the path tells."""
    slopes = {n: 1e-3 * fit.parameters[n]["amplitude"].value for n in _BIASES if n in fit.parameters}
    drift = np.full(series.t_s.size, slopes.get("gyro_bias", 0.0))
    known = np.isfinite(series.temp_c)
    if "bias_temperature" in slopes and known.any():
        temp = np.interp(series.t_s, series.t_s[known], series.temp_c[known])
        drift = drift + slopes["bias_temperature"] * (temp - series.start_temp_c)
    turned = np.cumsum(drift * np.diff(series.t_s, prepend=series.t_s[0]))
    return replace(series, gyro_deg=series.gyro_deg - turned)


def _walks(series: DriveSeries, noise: YawNoise, fit: YawFit) -> Walks:
    """Dead reckoning's noise as the gyro's rows and the heading difference show it."""
    heading = (DEG_TO_RAD * white_rate_dps_rt_s(series)) ** 2
    bins, way = fit.bins, fit.bins.way_m
    moving = way > STANDING_MPS * bins.width_s
    per_m = noise.std_deg[moving] ** 2 / way[moving] if moving.any() else np.array([1.0])
    distance = (DEG_TO_RAD * 0.5 * series.robot.wheel_separation_m) ** 2 * float(np.median(per_m))
    bias = series.robot.initial_std.get("gyro_bias_dps", BIAS_STD_AFTER_REST_DPS)
    # A wheel that turned too far by d turns the heading by d over the separation and moves the centre by half of d.
    half_m = 0.5 * DEG_TO_RAD * series.robot.wheel_separation_m
    begin = bins.t_s[noise.slips] - 0.5 * bins.width_s - series.t_s[0]
    slips = tuple(
        (float(t), float(t + bins.width_s), float(half_m * abs(d)))
        for t, d in zip(begin, noise.slip_deg, strict=True)
    )
    return Walks(max(heading, 1e-14), max(distance, 1e-12), max(bias, 1e-4), slips)


def corrected(series: DriveSeries, scales: Mapping[str, float]) -> DriveSeries:
    """The log with the named scales taken out."""
    wheels, gyro = (1.0 + scales.get(name, 0.0) for name in _SCALES)
    return replace(
        series,
        encoder_deg=series.encoder_deg / wheels,
        left_m=series.left_m / wheels,
        right_m=series.right_m / wheels,
        gyro_deg=series.gyro_deg / gyro,
    )


def contradicted(told: Told, fit: YawFit) -> frozenset[str]:
    """Laws of the gyro's bias that the truth speaks against."""
    named = fit.parameters.get("gyro_bias", {}).get("amplitude")
    if named is None or told.fit is None or "gyro_bias" not in told.fit.values:
        return frozenset()
    # The path was laid with the named bias taken out.
    apart = abs(told.fit.values["gyro_bias"])
    limit = _APART * float(np.hypot(1e-3 * named.std, told.fit.stds["gyro_bias"]))
    return frozenset({"gyro_bias"}) if apart > limit else frozenset()


def scales_found(told: Told) -> list[Found]:
    """The named scales as findings, with what else they could be."""
    found: list[Found] = []
    if told.fit is None:
        return found
    fit = told.fit
    seen = "positions and headings" if fit.headings else "positions"
    for name in told.scales:
        unit, factor = _UNIT[name]
        half = float(stats.t.ppf(0.975, fit.freedoms[name])) * fit.stds[name]
        value, low, high = (v / (1.0 - v) for v in (fit.values[name] + x for x in (0.0, -half, half)))
        std = fit.stds[name] / (1.0 - fit.values[name]) ** 2
        estimate = Estimate(factor * value, factor * std, unit, (factor * low, factor * high))
        others = {
            "wheel_scale": ("encoder_overcount",) if value > 0 else (),
            "gyro_scale": ("robot_tilt",) if value < 0 else (),
        }
        text = (
            f"{EFFECTS[name].statement.rstrip('.')}: seen against the truth's {seen}, which the reckoned path misses by "
            f"{fit.nominal_m:.2g} m rms as logged and by {fit.miss_m:.2g} m with scales and bias taken out"
        )
        alternatives = tuple(Alternative(o, 1.0, EFFECTS[o].statement) for o in others[name])
        found.append(Found(name, {"amplitude": estimate}, fit.p_values[name], text, alternatives))
    return found


def twins_of_slip(told: Told, widening: float) -> tuple[Alternative, ...]:
    """What else makes the encoders see more in turns by the relative `widening`, with the truth's evidence against it."""
    needed = {"gyro_scale": -widening, "wheel_scale": widening / (1.0 + widening)}
    twins = []
    for name, value in needed.items():
        ratio = 1.0 if name not in told.scales else _MOST
        if told.fit is not None and name in told.fit.values and name not in told.scales:
            away = told.fit.values[name] - np.array([0.0, value])
            logs = np.asarray(stats.t.logpdf(away / told.fit.stds[name], told.fit.freedoms[name]))
            ratio = float(np.exp(np.clip(logs[0] - logs[1], -np.log(_MOST), np.log(_MOST))))
        if ratio <= _OUT:
            twins.append(Alternative(name, ratio, EFFECTS[name].statement))
            if name == "gyro_scale" and widening > 0:
                # A tilted gyro sees less of a turn, never more.
                twins.append(Alternative("robot_tilt", ratio, EFFECTS["robot_tilt"].statement))
    return tuple(twins)


def better_name(
    slip: Mapping[str, Estimate], twins: tuple[Alternative, ...]
) -> tuple[str, Mapping[str, Estimate], tuple[Alternative, ...]]:
    """A slip by the name that the truth prefers to it, where it does, with its parameters and what is left of its twins."""
    best = min(twins, key=lambda a: a.evidence_ratio, default=None)
    if best is None or best.evidence_ratio > _PREFERRED or best.effect not in _UNIT:
        return "skid_slip", slip, twins
    unit, factor = _UNIT[best.effect]
    amplitude = slip["amplitude"]

    def as_scale(percent: float) -> float:
        ratio = 1.0 + percent / 100.0
        return factor * (1.0 / ratio - 1.0 if best.effect == "gyro_scale" else ratio - 1.0)

    low, high = sorted(as_scale(x) for x in amplitude.interval_95)
    std = (high - low) / (amplitude.interval_95[1] - amplitude.interval_95[0]) * amplitude.std
    estimate = Estimate(as_scale(amplitude.value), std, unit, (low, high))
    others = [
        replace(a, evidence_ratio=a.evidence_ratio / best.evidence_ratio) for a in twins if a is not best
    ]
    slipped = Alternative("skid_slip", 1.0 / best.evidence_ratio, EFFECTS["skid_slip"].statement)
    return (
        best.effect,
        {"amplitude": estimate},
        tuple(a for a in (slipped, *others) if a.evidence_ratio <= _OUT),
    )


def widened(told: Told, slip: Mapping[str, Estimate]) -> tuple[Mapping[str, Estimate], float]:
    """Parameters of a slip with what the named scales leave open, and the p-value that is left of it."""
    amplitude = slip["amplitude"]
    more = 100.0 * (1.0 + amplitude.value / 100.0) * told.spread()
    if more == 0.0:
        return slip, 0.0
    std = float(np.hypot(amplitude.std, more))
    stretch = std / amplitude.std if amplitude.std > 0 else 1.0
    low, high = (amplitude.value + stretch * (x - amplitude.value) for x in amplitude.interval_95)
    p_value = float(2 * stats.norm.sf(abs(amplitude.value) / std))
    return dict(slip) | {"amplitude": Estimate(amplitude.value, std, amplitude.unit, (low, high))}, p_value
