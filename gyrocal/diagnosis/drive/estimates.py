"""Every figure that a drive tells, named or not, with the metres that it costs if it is not taken out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrocal.diagnosis.drive.findings import (
    OfTruth,
    joint_estimate,
    left_of_track,
    told_estimate,
    unexpected_bias,
)
from gyrocal.diagnosis.drive.laws import AT_ONCE, KINDS, PER_SI, SETTLING, is_motion
from gyrocal.diagnosis.drive.path_laid import ALONE, SCALES
from gyrocal.diagnosis.drive.reckoning import Figures, cost_m, reckon, rest_mean_dps
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.sides import ASYMMETRY, uneven_gyro
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.physics.drive import START_STOP_SLIP
from gyrocal.records.files import finite
from gyrocal.units import NORMAL_95, RAD_TO_DEG


@dataclass(frozen=True)
class DriveEstimate:
    """One figure of a drive, named or not.

    Attributes
    ----------
    value, std : in `unit`
    metres : rms position error over this log if it is not taken out; NaN where it moves no position
    path : the path that it moves: ``gyro`` (distance along the gyro's heading), ``encoders`` or ``truth``
    """

    name: str
    value: float
    std: float
    unit: str
    metres: float
    path: str
    named: bool

    def to_json(self) -> dict[str, Any]:
        """Entry of ``estimates``."""
        half = NORMAL_95 * self.std
        entry: dict[str, Any] = finite(
            {
                "name": self.name,
                "value": float(self.value),
                "std": float(self.std),
                "unit": self.unit,
                "interval_95": [float(self.value - half), float(self.value + half)],
                "metres": float(self.metres),
                "path": self.path,
                "named": self.named,
            }
        )
        return entry


def estimates_of(
    series: DriveSeries,
    yaw: YawAnswer,
    truth: TruthAnswer | None,
    parts: Mapping[str, OfTruth],
    figures: Figures,
) -> tuple[DriveEstimate, ...]:
    """Every figure of a drive by the metres that it costs, the dearest first."""
    rest = rest_mean_dps(series)
    started = replace(figures, bias_dps=figures.bias_dps if rest is None else rest[0], bias_from_rest=False)
    found = [*_of_gyro(series, yaw, truth, parts, started), *_of_encoders(series, yaw, truth, parts)]
    if truth is not None:
        of_truth = {"lever_ahead": "m", "lever_left": "m", "clock": "s", "course": "s", "mounting": "rad"}
        for name, unit in of_truth.items():
            if name in truth.values:
                value, std, shown = truth.values[name], truth.stds[name], unit
                if name == "mounting":
                    value, std, shown = RAD_TO_DEG * value, RAD_TO_DEG * std, "deg"
                metres = abs(value) if unit == "m" else float("nan")
                found.append(DriveEstimate(f"truth_{name}", value, std, shown, metres, "truth", named=False))
    return tuple(sorted(found, key=lambda e: -np.nan_to_num(e.metres, nan=-1.0)))


def _of_gyro(
    series: DriveSeries,
    yaw: YawAnswer,
    truth: TruthAnswer | None,
    parts: Mapping[str, OfTruth],
    figures: Figures,
) -> list[DriveEstimate]:
    """Figures that move the path along the gyro's heading."""
    found = []
    for name, kind in KINDS.items():
        told = None
        if name == "bias":
            told = (*joint_estimate(yaw, truth, "bias"), unexpected_bias(series, yaw, truth) is not None)
        elif kind.figure and name in parts:
            told = (parts[name].value, parts[name].std, True)
        elif kind.figure and name in yaw.laws and name == yaw.spokesman(name):
            if name in yaw.chosen:
                known = told_estimate(yaw, truth, name)
            elif name == "jump" or name in SETTLING:
                # At the best of all instants, or time constants, it is no estimate.
                continue
            else:
                known = _beyond(yaw, truth, name)
                if known[1] > ALONE.get(AT_ONCE if is_motion(name) else name, np.inf):
                    # No less was known of it before the drive.
                    continue
            told = (*known, name in yaw.named)
        if told is not None:
            value, std, named = told
            metres = cost_m(series, figures, kind.figure, value)
            # A jump is what comes after less what was before it.
            value = -value if name == "jump" else value
            found.append(DriveEstimate(kind.shown, value, std, kind.unit, metres, "gyro", named))
    for name in SCALES:
        scale = parts.get(name)
        if scale is None and truth is not None and truth.shows(name):
            scale = OfTruth(truth.values[name], truth.stds[name])
        if scale is not None:
            metres = cost_m(series, figures, name, scale.value)
            percent = (100 * scale.value, 100 * scale.std, "%")
            found.append(DriveEstimate(name, *percent, metres, "gyro", name in parts))
    if (uneven := uneven_gyro(truth)) is not None:
        percent = (100 * uneven[0], 100 * uneven[1], "%")
        metres = cost_m(series, figures, ASYMMETRY, uneven[0])
        found.append(DriveEstimate(ASYMMETRY, *percent, metres, "gyro", named=False))
    return found


def _beyond(yaw: YawAnswer, truth: TruthAnswer | None, name: str) -> tuple[float, float]:
    """Value and standard deviation of a law that is not in the fit, by whichever of encoders and truth knows it better."""
    (value,), ((variance,),) = yaw.beyond([name])
    by_encoders = float(value), float(np.sqrt(max(variance, 0.0)))
    if truth is None or truth.mirrored or truth.stds.get(name, np.inf) > by_encoders[1]:
        return by_encoders
    return truth.values[name], truth.stds[name]


def _of_encoders(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None, parts: Mapping[str, OfTruth]
) -> list[DriveEstimate]:
    """Figures that move the path along the encoders' heading."""
    found = []
    path = reckon(series, Figures())
    rows = yaw.model.frame.nodes.rows
    for name in yaw.chosen:
        if KINDS[name].figure or name == "wheel_sin":
            continue
        value, std = joint_estimate(yaw, truth, name)
        if name == "spinning" and START_STOP_SLIP.id in parts:
            value, std = parts[START_STOP_SLIP.id].value, parts[START_STOP_SLIP.id].std
        if name == "track":
            left = left_of_track(value, std, parts)
            value, std = left.value, left.std
        turn = value * yaw.laws[name].column
        if name == "wheel_cos":
            other, _ = joint_estimate(yaw, truth, "wheel_sin")
            turn = turn + other * yaw.laws["wheel_sin"].column
            value = float(np.hypot(value, other))
        heading = np.interp(np.arange(series.t_s.size), rows, np.concatenate([[0.0], np.cumsum(turn)]))
        metres = float(np.sqrt(np.mean(np.abs(path.moved_by(heading, np.zeros(heading.size))) ** 2)))
        # A ratio of turns that may be another's is no track's.
        named = name in (parts if name == "track" else yaw.named)
        unit = KINDS[name].unit or "%"
        value, std = PER_SI[unit] * value, PER_SI[unit] * std
        found.append(DriveEstimate(KINDS[name].shown, value, std, unit, metres, "encoders", named))
    return found
