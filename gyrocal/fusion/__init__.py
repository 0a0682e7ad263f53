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
from gyrocal.fusion.navigator import STATES, Counts, NavigationState, Navigator, Trajectory
from gyrocal.fusion.robot import FilterNoise, InitialStd, RobotParameters

__all__ = [
    "STATES",
    "Coefficients",
    "Compensator",
    "Corrected",
    "Counts",
    "FilterNoise",
    "InitialStd",
    "NavigationState",
    "Navigator",
    "Noise",
    "RobotParameters",
    "Term",
    "Trajectory",
    "Valid",
    "load_coefficients",
    "parse_coefficients",
]
