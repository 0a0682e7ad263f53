"""The runtime that a robot imports. numpy alone; numba speeds it up where it is installed."""

from gyrocal.fusion.coefficients import (
    Coefficients,
    Noise,
    Term,
    Valid,
    load_coefficients,
    parse_coefficients,
)

__all__ = ["Coefficients", "Noise", "Term", "Valid", "load_coefficients", "parse_coefficients"]
