"""Slip in turns: by how much the effective wheel separation of a robot grows with how it turns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.units import DEG_TO_RAD

Floats = NDArray[np.float64]

#: The customary turn rate in the amplitude of `skid_slip`, deg/s.
_TURN_DPS = 30.0
#: The laws of `skid_slip`; its parameter ``law`` counts them.
SLIP_LAWS = ("turn_rate", "curvature", "curvature_saturating")
#: The law of curvature is taken no further than this: half the separation over the radius, 1 is a standing wheel.
_TIGHTEST = 3.0


def slip_shape(
    law: str, turn_rate_dps: Floats, speed_mps: Floats, wheel_separation_m: float, shape: float
) -> Floats:
    """By how much, of its amplitude, the effective wheel separation is widened: the shapes of `skid_slip`.

    Parameters
    ----------
    law : str
        One of `SLIP_LAWS`: by turn rate, by curvature (half the separation over the radius of the turn), or by
        curvature that saturates.
    turn_rate_dps, speed_mps : ndarray, shape (n,)
        True turn rate and speed of the robot's centre, of either sign.
    shape : float
        Power of the turn rate over 30 deg/s, or the curvature at which half of the saturation is reached; the
        law of curvature has none.

    Returns
    -------
    ndarray, shape (n,)
        1 is the amplitude; 0 at rest, but for a power of 0, which is a track that is wrong alike in all turns.
    """
    if law not in SLIP_LAWS:
        raise InputError(f"There is no slip law {law!r}. Known: {', '.join(SLIP_LAWS)}.")
    return np.asarray(widened(SLIP_LAWS.index(law), turn_rate_dps, speed_mps, wheel_separation_m, shape))


def widened(law: int, turn_rate_dps: Any, speed_mps: Any, wheel_separation_m: float, shape: float) -> Any:
    """`slip_shape` of a law by its number, for arrays or, in a compiled loop, single figures."""
    turning = abs(turn_rate_dps)
    if law == 0:
        return (turning / _TURN_DPS) ** shape
    across, along = 0.5 * wheel_separation_m * DEG_TO_RAD * turning, abs(speed_mps)
    whole = across + shape * along if law == 2 else np.maximum(along, across / _TIGHTEST)
    return across / (whole + (whole == 0.0))
