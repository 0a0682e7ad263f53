"""What is known of a robot's bias, track and wheels before a drive, and how far a drive widens that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gyrocal.diagnosis.drive.laws import is_slip
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.weighing import Gram
from gyrocal.fusion.robot import BIAS_STD_DPS
from gyrocal.physics.drive import GYRO_SCALE

#: What the difference of the wheels changes by from one drive to the next, relative: standard deviation.
ASYMMETRY_CHANGES = 3e-4
#: A gyro that reads less by more than the robot file grants, in its standard deviations, may be tilted as well.
_TILT_STDS = 3.0
#: And a track that is off by more than these of what is granted and what the drive knows together is another than the file's.
_OFF_STDS = 3.0


def known_before(series: DriveSeries) -> dict[str, tuple[float, float]]:
    """What the robot file knows of bias, track and asymmetry: mean and standard deviation of each.

    Where it promises a rest, its figure of the bias is of what is left after that.
    """
    std, rests = series.robot.initial_std, series.robot.static_s > 0
    return {
        "track": (0.0, max(std["wheel_separation_m"] / series.robot.wheel_separation_m, 1e-6)),
        "asymmetry": (0.0, max(float(np.hypot(std["left_scale"], std["right_scale"])), 1e-6)),
        "bias": (
            series.robot.parameters.gyro.bias_dps,
            max(std["gyro_bias_dps"], BIAS_STD_DPS if rests else 1e-9),
        ),
    }


def widened(
    series: DriveSeries, known: Mapping[str, tuple[float, float]], free: Gram, chosen: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """What is known beforehand, each as far off as the drive makes likeliest where that is more than was granted.

    Held to what is granted, a bias that is larger would become wheels that differ, and wheels that differ more a bias. What a
    robot file itself says of the bias holds, but for a rest that it promises, which takes the bias off whatever that is. A track
    stands for nothing else, and what is granted of it holds unless the drive contradicts it: one that hardly tells it is off by a
    third at times.
    """
    found = dict(known)
    says = "initial_std.gyro_bias_dps" in series.robot.given and series.robot.static_s == 0
    for name, (mean, std) in known.items():
        if name not in chosen or (name == "bias" and says):
            continue
        # Held to a track that is not its own, a robot seems to slip.
        beside = [n for n in chosen if name != "track" or not is_slip(n)]
        values, covariance = free.knowing({n: k for n, k in known.items() if n != name}).solve(beside)
        at = beside.index(name)
        likeliest = (values[at] - mean) ** 2 - covariance[at, at]
        if name == "track" and likeliest + covariance[at, at] < _OFF_STDS**2 * (std**2 + covariance[at, at]):
            continue
        found[name] = (mean, float(np.sqrt(max(likeliest, std**2))))
    return found


def may_be_tilted(series: DriveSeries, gyro_scale: float) -> bool:
    """Whether a scale of the gyro may be as well that it stands at a tilt, where it lacks a share of every turn."""
    return gyro_scale < -_TILT_STDS * series.robot.initial_std[GYRO_SCALE.id]
