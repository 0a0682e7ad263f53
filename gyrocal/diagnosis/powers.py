"""From products of Legendre polynomials, in which a fit is well conditioned, to the powers of a surface."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from gyrocal.physics.surface import SHAPE

Floats = NDArray[np.float64]


def legendre_to_powers() -> Floats:
    """Coefficients of ``u^i v^j`` from those of ``P_i(u) P_j(v)``, row-major, shape (12, 12)."""
    powers = [np.pad(legendre.leg2poly(np.eye(n + 1)[n]), (0, SHAPE[0] - n - 1)) for n in range(SHAPE[0])]
    rate = np.array(powers).T
    return np.kron(rate, rate[: SHAPE[1], : SHAPE[1]])
