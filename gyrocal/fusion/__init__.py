"""The runtime that a robot imports. numpy alone; numba speeds it up where it is installed."""

from gyrocal.fusion.aligner import Aligner, Rows
from gyrocal.fusion.coefficients import (
    Coefficients,
    Noise,
    Valid,
    load_coefficients,
    parse_coefficients,
)
from gyrocal.fusion.compensation import Compensator, Corrected
from gyrocal.fusion.navigator import STATES, Counts, Navigator, Row, Trajectory
from gyrocal.fusion.robot import (
    EncoderFigures,
    FilterNoise,
    GyroFigures,
    InitialStd,
    RobotParameters,
    SlipFigures,
)
from gyrocal.fusion.static_bias import StaticBias, static_bias
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.terms import Term

__all__ = [
    "STATES", "Aligner", "Coefficients", "Compensator", "Corrected", "Counts", "EncoderFigures", "FilterNoise",
    "GyroFigures", "InitialStd", "Navigator", "Noise", "RobotParameters", "Row", "Rows", "SlipFigures", "SmoothTerm",
    "StaticBias", "Term", "Trajectory", "Valid", "load_coefficients", "parse_coefficients", "static_bias",
]  # fmt: skip
