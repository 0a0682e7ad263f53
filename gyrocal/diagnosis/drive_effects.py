"""Effects on the robot as columns of the difference between the encoders' heading and the gyro's, bin by bin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive_series import MAX_DELAY_S, Bins, DriveSeries, bins_of
from gyrocal.diagnosis.result import Located
from gyrocal.physics.drive import DRIVE_EFFECTS, DriveEffect

Floats = NDArray[np.float64]

EFFECTS: Mapping[str, DriveEffect] = {effect.id: effect for effect in DRIVE_EFFECTS}

_DELAY_STEP_S = 0.02
_EXPONENTS = (0.0, 0.5, 1.0, 1.5, 2.0)
_TURN_DPS = 30.0
_MIN_TEMP_SPAN_C = 0.5
#: A robot that turns less than this in all has not seen enough headings to tell them apart.
_LEAST_HEADING_DEG = 180.0


@dataclass(frozen=True)
class Candidate:
    """A law at one value of its nonlinear parameters; `scale` turns its coefficient into the catalogue's amplitude."""

    effect: str
    shape: Mapping[str, float]
    columns: Floats
    scale: float


def slip_column(bins: Bins, exponent: float) -> Floats:
    """``skid_slip`` of one: what the encoders add in turns, deg a bin."""
    return np.asarray(bins.gyro_deg * (np.abs(bins.turn_rate_dps) / _TURN_DPS) ** exponent)


def delay_slope(series: DriveSeries, delay_s: float) -> Floats:
    """Change of the gyro's yaw in each bin by a second of delay, deg/s."""
    half = _DELAY_STEP_S
    later, earlier = bins_of(series, delay_s + half), bins_of(series, delay_s - half)
    return np.asarray((later.gyro_deg - earlier.gyro_deg) / (2 * half))


def law(series: DriveSeries, bins: Bins, effect: str, shape: Mapping[str, float]) -> Candidate:
    """One law on given bins."""
    match effect:
        case "gyro_delay":
            column = bins_of(series, shape["delay_s"]).gyro_deg - bins.gyro_deg
            return Candidate(effect, shape, column[:, None], 1.0)
        case "skid_slip":
            return Candidate(effect, shape, slip_column(bins, shape["exponent"])[:, None], 100.0)
        case "wheel_asymmetry":
            return Candidate(effect, shape, _asymmetry(series, bins)[:, None], 100.0)
        case "gyro_bias":
            return Candidate(effect, shape, np.full((bins.t_s.size, 1), -bins.width_s), 1e3)
        case "bias_temperature":
            warmer = bins.temp_c - series.start_temp_c
            return Candidate(effect, shape, (-bins.width_s * warmer)[:, None], 1e3)
    raise ValueError(f"{effect} is no law of a heading difference")


def candidates(series: DriveSeries, bins: Bins, delay_s: float) -> dict[str, list[Candidate]]:
    """Laws to try beside a model whose gyro is looked at `delay_s` earlier; effect -> its family of shapes."""
    delays = np.arange(-MAX_DELAY_S, MAX_DELAY_S + 1e-9, 2 * _DELAY_STEP_S)
    shapes: dict[str, list[dict[str, float]]] = {
        "gyro_delay": [{"delay_s": float(d)} for d in delays if abs(d - delay_s) > _DELAY_STEP_S],
        "skid_slip": [{"exponent": n} for n in _EXPONENTS],
        "wheel_asymmetry": [{}],
        "gyro_bias": [{}],
    }
    if temperature_span_c(bins) >= _MIN_TEMP_SPAN_C:
        shapes["bias_temperature"] = [{}]
    return {
        effect: [law(series, bins, effect, shape) for shape in family] for effect, family in shapes.items()
    }


def temperature_span_c(bins: Bins) -> float:
    """How far the gyro's temperature goes; 0 where it is not known."""
    return float(np.ptp(bins.temp_c)) if np.all(np.isfinite(bins.temp_c)) else 0.0


def _asymmetry(series: DriveSeries, bins: Bins) -> Floats:
    """``wheel_asymmetry`` of one: right wheel larger by a half, left smaller by a half."""
    return np.asarray(np.rad2deg(bins.distance_m / series.robot.wheel_separation_m))


def _hats(x: Floats, count: int) -> Floats:
    """Piecewise-linear curves over `x` with knots at its quantiles, the constant left out; shape (n, knots - 1)."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
    if knots.size < 3:
        return np.zeros((x.size, 0))
    hats = np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)
    return np.asarray(np.delete(hats, int(np.argmax(hats.sum(axis=0))), axis=1))


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of formats.md: its value in each bin, its unit, and curves over it that no mechanism explains."""

    name: str
    unit: str
    values: Floats
    columns: Floats


def coordinates(series: DriveSeries, bins: Bins, delay_s: float) -> list[Coordinate]:
    """Generic curves over every coordinate of a drive."""
    heading = np.deg2rad(bins.heading_deg)
    turns = (
        np.stack([f(k * heading) for k in (1, 2) for f in (np.cos, np.sin)], axis=1)
        * bins.distance_m[:, None]
    )
    lags = [delay_s + d for d in (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0) if abs(delay_s + d) <= MAX_DELAY_S]
    lead = np.stack([bins_of(series, lag).gyro_deg - bins.gyro_deg for lag in lags], axis=1)
    curves: list[tuple[str, str, Floats, Callable[[Floats], Floats]]] = [
        ("turn_rate", "deg/s", bins.turn_rate_dps, lambda x: _hats(x, 7)),
        ("curvature", "rad/m", bins.curvature_per_m, lambda x: _hats(x, 6)),
        ("speed", "m/s", bins.speed_mps, lambda x: _hats(x, 5)),
        ("acceleration", "m/s^2", bins.acceleration_mps2, lambda x: _hats(x, 5)),
        ("heading", "deg", bins.heading_deg % 360.0, lambda _: turns),
        ("delay", "s", np.abs(delay_slope(series, delay_s)), lambda _: lead),
        ("time", "s", bins.t_s - series.t_s[0], lambda x: _hats(x, 9)),
    ]
    if np.ptp(bins.heading_deg) < _LEAST_HEADING_DEG:
        curves = [curve for curve in curves if curve[0] != "heading"]
    return [Coordinate(name, unit, values, columns(values)) for name, unit, values, columns in curves]


def region(coordinate: Coordinate, curve: Floats) -> str:
    """Where on its coordinate a fitted curve, shape (n,), has most of its energy, in words."""
    if coordinate.name == "delay":
        return "where the turn rate changes"
    x = coordinate.values
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, 7)))
    if edges.size < 2:
        return f"{coordinate.name} {x[0]:.3g} {coordinate.unit}"
    cell = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
    energy = np.bincount(cell, curve**2, edges.size - 1)
    k = int(np.argmax(energy))
    return f"{coordinate.name} {edges[k]:.3g} to {edges[k + 1]:.3g} {coordinate.unit}"


def strongest_first(found: list[Located]) -> tuple[Located, ...]:
    """Places by their share of the excess."""
    return tuple(sorted(found, key=lambda place: -np.nan_to_num(place.share)))
