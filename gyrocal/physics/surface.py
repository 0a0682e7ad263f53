"""The paper's error surface: third order in gyro output, second in temperature; twelve terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError

Floats = NDArray[np.float64]

#: Orders of the surface in gyro output and in temperature (paper eqs. 2 and 3).
RATE_ORDER = 3
TEMPERATURE_ORDER = 2
SHAPE = (RATE_ORDER + 1, TEMPERATURE_ORDER + 1)


@dataclass(frozen=True)
class Surface:
    """Error of the gyro, ``e = sum c[i][j] u^i v^j`` in deg/s (paper eqs. 2, 3 and 5, on scaled variables).

    ``u = (gyro_dps - rate_center_dps) / rate_scale_dps``, ``v = (temp_c - temp_center_c) / temp_scale_c``.
    Raw rate times deg C would have a condition number of 1e9; scaled it is about 25.

    Attributes
    ----------
    coefficients_dps : ndarray, shape (4, 3), deg/s
    """

    coefficients_dps: Floats
    rate_center_dps: float
    rate_scale_dps: float
    temp_center_c: float
    temp_scale_c: float

    def __post_init__(self) -> None:
        c = np.asarray(self.coefficients_dps, dtype=np.float64)
        if c.shape != SHAPE:
            msg = f"the surface has {SHAPE[0]} x {SHAPE[1]} coefficients, and {c.shape} were given"
            raise ValueError(msg)
        if not (self.rate_scale_dps > 0 and self.temp_scale_c > 0):
            msg = "the scales of rate and temperature must be positive"
            raise ValueError(msg)
        object.__setattr__(self, "coefficients_dps", c)

    def scaled(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> tuple[Floats, Floats]:
        """Scaled variables (u, v) of gyro output and temperature."""
        u = (np.asarray(gyro_dps, dtype=np.float64) - self.rate_center_dps) / self.rate_scale_dps
        v = (np.asarray(temp_c, dtype=np.float64) - self.temp_center_c) / self.temp_scale_c
        return u, v

    def error_dps(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Error at gyro output and temperature (broadcast together), deg/s."""
        u, v = self.scaled(gyro_dps, temp_c)
        c = self.coefficients_dps
        a = [c[i, 0] + v * (c[i, 1] + v * c[i, 2]) for i in range(SHAPE[0])]  # eq. 3
        return np.asarray(a[0] + u * (a[1] + u * (a[2] + u * a[3])))  # eq. 2

    def design(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Vandermonde matrix of eq. 5, shape (n, 12), row-major over (i, j)."""
        u, v = (np.atleast_1d(x) for x in self.scaled(gyro_dps, temp_c))
        powers = u[:, None] ** np.arange(SHAPE[0]), v[:, None] ** np.arange(SHAPE[1])
        return (powers[0][:, :, None] * powers[1][:, None, :]).reshape(u.size, SHAPE[0] * SHAPE[1])

    def slope_per_dps(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Derivative of the error by gyro output, (deg/s)/(deg/s)."""
        u, v = self.scaled(gyro_dps, temp_c)
        c = self.coefficients_dps
        a = [c[i, 0] + v * (c[i, 1] + v * c[i, 2]) for i in range(SHAPE[0])]
        return np.asarray((a[1] + u * (2 * a[2] + u * 3 * a[3])) / self.rate_scale_dps)

    def output_dps(self, rate_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Gyro output at a true rate: solves ``gyro - error(gyro) = rate`` by Newton's method.

        Raises
        ------
        DataError
            The surface is not invertible there (an error slope near 1): no physical gyro is like that.
        """
        rate = np.asarray(rate_dps, dtype=np.float64)
        # Where it runs off it says so below, in a sentence.
        with np.errstate(all="ignore"):
            gyro = rate + self.error_dps(rate, temp_c)
            for _ in range(30):
                miss = gyro - self.error_dps(gyro, temp_c) - rate
                slope = self.slope_per_dps(gyro, temp_c)
                gyro = gyro - miss / (1.0 - slope)
                if np.max(np.abs(miss), initial=0.0) < 1e-12 * max(1.0, self.rate_scale_dps):
                    # Beyond a turning point of the cubic there may be a root, and it is no output.
                    if np.all(slope < 1.0):
                        return np.asarray(gyro)
                    miss = np.where(slope < 1.0, miss, np.inf)
                    break
        every = np.broadcast_arrays(rate, np.asarray(temp_c, dtype=np.float64))
        raise self._refusal(every[0], every[1], miss)

    def _refusal(self, rate_dps: Floats, temp_c: Floats, miss_dps: Floats) -> DataError:
        size = np.where(np.isfinite(miss_dps), np.abs(miss_dps), np.inf).ravel()
        worst = int(np.argmax(size))
        return DataError(
            f"The error surface has no output for {rate_dps.ravel()[worst]:.4g} deg/s at {temp_c.ravel()[worst]:.4g} °C, "
            f"as no gyro's has (it was fitted within {self.rate_scale_dps:.4g} deg/s of {self.rate_center_dps:.4g}). Its "
            "coefficients are another gyro's, or come from an output of another sign or unit: fit again to sound data."
        )

    def to_json(self) -> dict[str, Any]:
        """The ``surface`` entry of the coefficient file, without its covariance."""
        return {
            "rate_order": RATE_ORDER,
            "temperature_order": TEMPERATURE_ORDER,
            "rate": {"center_dps": self.rate_center_dps, "scale_dps": self.rate_scale_dps},
            "temperature": {"center_c": self.temp_center_c, "scale_c": self.temp_scale_c},
            "coefficients_dps": self.coefficients_dps.tolist(),
        }
