"""What a robot file says of a log, and a robot file without what a drive is asked for anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from gyrocal.diagnosis.drive.reckoning import Figures, Floats
from gyrocal.diagnosis.drive.series import DriveSeries, measured_over_true
from gyrocal.fusion.robot import EncoderFigures, GyroFigures, RobotParameters, SlipFigures
from gyrocal.records.robot import Robot

#: Keys of the laws that every drive is asked for, but for these: the bias that a drive begins with, and scales, which stay
#: taken out of a log (`drive_series`) because one without a truth cannot tell them.
_ASKED = ("gyro.", "encoders.", "slip.")
_SCALES = {"gyro.scale", "gyro.asymmetry"}
_STAYS = frozenset(
    {
        f"gyro.{key}"
        for key in (
            *("bias_dps", "bias_dps_std", "repeatability_dps", "temp_c"),
            *("scale", "scale_std", "asymmetry", "asymmetry_std"),
        )
    }
    | {f"encoders.{side}_scale{std}" for side in ("left", "right") for std in ("", "_std")}
)


def _sides(scale: float, asymmetry: float) -> Floats:
    """Measured over true turns, to the left and to the right."""
    return measured_over_true(scale, asymmetry, np.array([1.0, -1.0]))


def filed(series: DriveSeries, robot: RobotParameters) -> Figures:
    """What a robot file takes out of a log on the robot, as far as the file that the log came with has not done so.

    Of a gyro that was calibrated it takes no bias, slope and scale.
    """
    out, gyro, wheels = series.robot.parameters, robot.gyro, robot.encoders
    raw, rate = 0.0 if series.calibrated else 1.0, 1.0 / (1.0 + series.gyro_scale)
    given_dps = out.gyro.bias_dps
    taken_out = _sides(series.gyro_scale, series.gyro_asymmetry)
    left, right = _sides(gyro.scale, gyro.asymmetry) / taken_out
    return Figures(
        bias_dps=raw * (given_dps + rate * (gyro.bias_dps - given_dps)),
        temp_c=gyro.temp_c,
        bias_motion_dps=rate * gyro.bias_motion_dps,
        bias_moving_dps=rate * gyro.bias_moving_dps,
        bias_moving_s=gyro.bias_moving_s,
        bias_slope_dps_per_c=raw * rate * gyro.bias_slope_dps_per_c,
        gyro_scale=raw * (0.5 * (left + right) - 1.0),
        gyro_asymmetry=raw * (left - right),
        left_scale=(1.0 + wheels.left_scale) / (1.0 + out.encoders.left_scale) - 1.0,
        right_scale=(1.0 + wheels.right_scale) / (1.0 + out.encoders.right_scale) - 1.0,
        delay_s=gyro.delay_s,
        track=robot.wheel_separation_m / series.robot.wheel_separation_m - 1.0,
        slip=robot.slip,
    )


def asked_anew(robot: Robot) -> Robot:
    """A robot file without the laws that every drive is asked for: they belong to what was fitted beside them."""

    def kept(section: str, figures: Any) -> dict[str, float]:
        return {
            key: value for key, value in asdict(figures).items() if f"{section}.{key}" in _STAYS & robot.given
        }

    gyro, encoders = robot.parameters.gyro, robot.parameters.encoders
    return replace(
        robot,
        parameters=replace(
            robot.parameters,
            gyro=GyroFigures(**kept("gyro", gyro)),
            encoders=EncoderFigures(**kept("encoders", encoders)),
            slip=SlipFigures(),
        ),
        given=frozenset(key for key in robot.given if key in _STAYS or not key.startswith(_ASKED)),
    )


def beyond_given(series: DriveSeries, keys: Mapping[str, float | str]) -> dict[str, float | str]:
    """Keys of a robot file for the log as it was read, from what was found with the given file's scales taken out of it."""
    out, found = series.robot.parameters, dict(keys)
    times = 1.0 + series.gyro_scale

    def scaled(key: str, change: float) -> None:
        if key in found:
            found[key] = change * (1.0 + float(found[key])) - 1.0

    for key in (k for k in found if k.startswith("gyro.bias_") and "_dps" in k):
        found[key] = times * float(found[key])
    if "gyro.bias_dps" in found:
        found["gyro.bias_dps"] = float(found["gyro.bias_dps"]) - series.gyro_scale * out.gyro.bias_dps
    if _SCALES & found.keys():
        sides = (float(found.get(key, 0.0)) for key in ("gyro.scale", "gyro.asymmetry"))
        left, right = _sides(series.gyro_scale, series.gyro_asymmetry) * _sides(*sides)
        both = {"gyro.scale": 0.5 * (left + right) - 1.0, "gyro.asymmetry": left - right}
        taken_out = series.gyro_scale or series.gyro_asymmetry
        found |= {key: float(value) for key, value in both.items() if key in found or taken_out}
    scaled("encoders.left_scale", 1.0 + out.encoders.left_scale)
    scaled("encoders.right_scale", 1.0 + out.encoders.right_scale)
    return found
