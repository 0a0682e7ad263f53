"""What other programs take of a calibration: Kalibr's noise figures, bias over temperature for PX4 and ArduPilot.

They take a part only: none of them has an error surface over the rate, and none has terms with a memory. What is left
out is said in the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from gyrocal import __version__
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD, DPH_TO_DPS, S_PER_H

Floats = NDArray[np.float64]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

#: Both autopilots evaluate a cubic of temperature.
_ORDER = 3
_GRID = 61
#: ArduPilot's fixed reference temperature, and the factor by which its parameters are scaled.
_ARDUPILOT_C, _ARDUPILOT_SCALE = 35.0, 1e6
#: MAVLink's types of a parameter, as ground stations write them.
_FLOAT, _INTEGER = 9, 6


@dataclass(frozen=True)
class BiasCubic:
    """Output at zero rate over temperature, rad/s: rising powers of (T - reference_c)."""

    reference_c: float
    coefficients: tuple[float, ...]
    misfit_dps: float


def bias_cubic(file: Coefficients, reference_c: float | None = None) -> BiasCubic:
    """Cubic through the output at zero rate, by least squares over the calibrated temperatures."""
    low, high = file.valid.temp_c
    reference = 0.5 * (low + high) if reference_c is None else reference_c
    temp_c = np.linspace(low, high, _GRID)
    bias_dps = file.surface.output_dps(np.zeros(_GRID), temp_c)
    powers = np.vander(temp_c - reference, _ORDER + 1, increasing=True)
    # Columns of very different size: scaled before they are solved.
    size = np.max(np.abs(powers), axis=0)
    size[size == 0] = 1.0
    c = np.linalg.lstsq(powers / size, bias_dps, rcond=None)[0] / size
    misfit = float(np.max(np.abs(powers @ c - bias_dps)))
    return BiasCubic(reference, tuple(float(x) * DEG_TO_RAD for x in c), misfit)


def kalibr(file: Coefficients, rate_hz: float | None) -> str:
    """Text of an ``imu.yaml`` of Kalibr: noise density and random walk of the gyro.

    Raises
    ------
    DataError
        The record at rest carries no angle random walk, or no sample rate is known.
    """
    noise = file.figures.get("noise", {})
    walk, drift = noise.get("angle_random_walk", {}), noise.get("rate_random_walk", {})
    if walk.get("value") is None and file.noise.angle_random_walk_deg_per_rt_h is not None:
        walk = {"value": file.noise.angle_random_walk_deg_per_rt_h[0]}
    rate = rate_hz or file.sensor.get("sample_rate_hz")
    if walk.get("value") is None:
        _refuse("an angle random walk")
    if rate is None:
        raise DataError("Kalibr wants a sample rate, and these coefficients have none: give --rate-hz.")
    density = walk["value"] * DEG_PER_RT_H_TO_DPS_PER_RT_HZ * DEG_TO_RAD
    return "\n".join(
        [
            *_head(file, "#"),
            "# The accelerometer's figures are not measured on this bench.",
            f"gyroscope_noise_density: {density:.6e}    # rad/s/sqrt(Hz), angle random walk {walk['value']:.4g} deg/sqrt(h)",
            _random_walk(drift),
            f"update_rate: {float(rate):g}    # Hz",
            "",
        ]
    )


def _random_walk(drift: Mapping[str, Any]) -> str:
    """Kalibr's line of the rate random walk; to be filled in by hand where the coefficients say nothing of it."""
    resolved = drift.get("value") is not None
    per_rt_h = drift["value"] if resolved else drift.get("at_most")
    if per_rt_h is None:
        return (
            "# gyroscope_random_walk: these coefficients say nothing of it. Kalibr wants it: fit a run with an hour at rest\n"
            "# (static_allan), or fill in the data sheet's, in rad/s^2/sqrt(Hz)."
        )
    # deg/h/sqrt(h) to rad/s^2/sqrt(Hz).
    diffusion = per_rt_h * DPH_TO_DPS / S_PER_H**0.5 * DEG_TO_RAD
    bound = "" if resolved else ": not resolved, its 95 % bound"
    return (
        f"gyroscope_random_walk: {diffusion:.6e}    # rad/s^2/sqrt(Hz), rate random walk {per_rt_h:.4g} "
        f"deg/h/sqrt(h){bound}"
    )


def _refuse(what: str) -> NoReturn:
    msg = f"Kalibr wants {what}, and these coefficients have none: fit a run with an hour at rest (static_allan)."
    raise DataError(msg)


def px4(file: Coefficients, axis: Axis, instance: int) -> str:
    """Parameters of PX4's thermal compensation of one gyro axis, as a ground station loads them."""
    cubic = bias_cubic(file)
    number, sign = _axis(axis)
    low, high = file.valid.temp_c
    values: dict[str, tuple[float, int]] = {
        "TC_G_ENABLE": (1, _INTEGER),
        f"TC_G{instance}_TREF": (cubic.reference_c, _FLOAT),
        f"TC_G{instance}_TMIN": (low, _FLOAT),
        f"TC_G{instance}_TMAX": (high, _FLOAT),
    }
    for power, c in enumerate(cubic.coefficients):
        values[f"TC_G{instance}_X{power}_{number}"] = (sign * c, _FLOAT)
    lines = [*_head(file, "#"), *_left_out(cubic, "#", f"Set TC_G{instance}_ID to the id of your sensor.")]
    lines += [f"1\t1\t{name}\t{value:.9g}\t{kind}" for name, (value, kind) in values.items()]
    return "\n".join(lines) + "\n"


def ardupilot(file: Coefficients, axis: Axis, instance: int) -> str:
    """Parameters of ArduPilot's temperature calibration of one gyro axis; `instance` counts from 0."""
    cubic = bias_cubic(file, _ARDUPILOT_C)
    number, sign = _axis(axis)
    low, high = file.valid.temp_c
    prefix = f"INS_TCAL{instance + 1}"
    lines = [
        *_head(file, "#"),
        *_left_out(cubic, "#", "The constant is the autopilot's own, taken at rest at start-up."),
    ]
    lines += [f"{prefix}_ENABLE,1", f"{prefix}_TMIN,{low:.6g}", f"{prefix}_TMAX,{high:.6g}"]
    for power, c in enumerate(cubic.coefficients[1:], start=1):
        lines.append(f"{prefix}_GYR{power}_{'XYZ'[number]},{sign * c * _ARDUPILOT_SCALE:.9g}")
    return "\n".join(lines) + "\n"


def _axis(axis: Axis) -> tuple[int, float]:
    return "xyz".index(axis[-1]), -1.0 if axis.startswith("-") else 1.0


def _head(file: Coefficients, mark: str) -> list[str]:
    sensor: Mapping[str, Any] = file.sensor
    who = " ".join(str(sensor[key]).replace("\n", " ") for key in ("model", "serial") if sensor.get(key))
    return [f"{mark} {who or 'gyro'}, from gyrocal {__version__}"]


def _left_out(cubic: BiasCubic, mark: str, more: str) -> list[str]:
    return [
        f"{mark} Bias over temperature, within {cubic.misfit_dps * 1e3:.2g} mdeg/s of that of the file. The scale factor, its nonlinearity",
        f"{mark} and terms with a memory have no place in this autopilot and are left out. {more}",
    ]
