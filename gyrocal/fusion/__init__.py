"""The runtime that a robot imports. numpy alone; numba speeds it up where it is installed."""

from gyrocal.fusion.coefficients import (
    Coefficients,
    Noise,
    Term,
    Valid,
    load_coefficients,
    parse_coefficients,
)
from gyrocal.fusion.compensation import Compensator, Corrected
from gyrocal.fusion.navigator import STATES, Counts, Navigator, Trajectory
from gyrocal.fusion.robot import FilterNoise, InitialStd, RobotParameters
from gyrocal.fusion.static_bias import StaticBias, static_bias

__all__ = [
    "STATES", "Coefficients", "Compensator", "Corrected", "Counts", "FilterNoise", "InitialStd", "Navigator", "Noise",
    "RobotParameters", "StaticBias", "Term", "Trajectory", "Valid", "load_coefficients", "parse_coefficients",
    "static_bias",
]  # fmt: skip
