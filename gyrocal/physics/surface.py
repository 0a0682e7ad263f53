"""The paper's error surface: third order in gyro output (or in the true rate), second in temperature; twelve terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError
from gyrocal.physics.inverse import crossing

Floats = NDArray[np.float64]

Direction = Literal["output", "input"]

#: Orders of the surface in gyro output and in temperature (paper eqs. 2 and 3).
RATE_ORDER = 3
TEMPERATURE_ORDER = 2
SHAPE = (RATE_ORDER + 1, TEMPERATURE_ORDER + 1)
#: Rounds in which a rate is found near enough for what remembers it; more would not do for an open loop beyond its peak.
NEAR_ROUNDS = 3


@dataclass(frozen=True)
class Surface:
    """Error of the gyro, ``e = sum c[i][j] u^i v^j`` in deg/s (paper eqs. 2, 3 and 5, on scaled variables).

    ``u = (x - rate_center_dps) / rate_scale_dps``, ``v = (temp_c - temp_center_c) / temp_scale_c``, where x is
    the gyro's output, as in the paper, or its input, the true rate. Raw rate times deg C would have a condition
    number of 1e9; scaled it is about 25.

    Attributes
    ----------
    coefficients_dps : ndarray, shape (4, 3), deg/s
    direction : str
        ``"output"``: ``output = rate + S(output, T)``; ``"input"``: ``output = rate + S(rate, T)``.
    """

    coefficients_dps: Floats
    rate_center_dps: float
    rate_scale_dps: float
    temp_center_c: float
    temp_scale_c: float
    direction: Direction = "output"

    def __post_init__(self) -> None:
        c = np.asarray(self.coefficients_dps, dtype=np.float64)
        if c.shape != SHAPE:
            msg = f"the surface has {SHAPE[0]} x {SHAPE[1]} coefficients, and {c.shape} were given"
            raise ValueError(msg)
        if not (self.rate_scale_dps > 0 and self.temp_scale_c > 0):
            msg = "the scales of rate and temperature must be positive"
            raise ValueError(msg)
        if self.direction not in ("output", "input"):
            msg = f"the direction is {self.direction!r}; output or input is wanted"
            raise ValueError(msg)
        object.__setattr__(self, "coefficients_dps", c)

    def scaled(self, x_dps: ArrayLike, temp_c: ArrayLike) -> tuple[Floats, Floats]:
        """Scaled variables (u, v) of the surface's own rate and of temperature."""
        u = (np.asarray(x_dps, dtype=np.float64) - self.rate_center_dps) / self.rate_scale_dps
        v = (np.asarray(temp_c, dtype=np.float64) - self.temp_center_c) / self.temp_scale_c
        return u, v

    def error_dps(self, x_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Error at the surface's own rate (by `direction`) and temperature (broadcast together), deg/s."""
        u, v = self.scaled(x_dps, temp_c)
        c = self.coefficients_dps
        a = [c[i, 0] + v * (c[i, 1] + v * c[i, 2]) for i in range(SHAPE[0])]  # eq. 3
        return np.asarray(a[0] + u * (a[1] + u * (a[2] + u * a[3])))  # eq. 2

    def design(self, x_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Vandermonde matrix of eq. 5, shape (n, 12), row-major over (i, j)."""
        u, v = (np.atleast_1d(x) for x in self.scaled(x_dps, temp_c))
        powers = u[:, None] ** np.arange(SHAPE[0]), v[:, None] ** np.arange(SHAPE[1])
        return (powers[0][:, :, None] * powers[1][:, None, :]).reshape(u.size, SHAPE[0] * SHAPE[1])

    def slope_per_dps(self, x_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Derivative of the error by the surface's own rate, (deg/s)/(deg/s)."""
        u, v = self.scaled(x_dps, temp_c)
        c = self.coefficients_dps
        a = [c[i, 0] + v * (c[i, 1] + v * c[i, 2]) for i in range(SHAPE[0])]
        return np.asarray((a[1] + u * (2 * a[2] + u * 3 * a[3])) / self.rate_scale_dps)

    def rate_and_output_dps(self, x_dps: Floats, temp_c: Floats) -> tuple[Floats, Floats]:
        """True rate and gyro output that belong to a value of the surface's own rate."""
        error = self.error_dps(x_dps, temp_c)
        return (x_dps - error, x_dps) if self.direction == "output" else (x_dps, x_dps + error)

    def solve_own_dps(self, gyro_dps: Floats, miss_dps: Callable[[Floats], Floats]) -> Floats:
        """The surface's own rate where `miss_dps` of it vanishes, shape (n,); NaN where it nowhere does.

        It is looked for where the surface was fitted, and a little beyond (`crossing`), beginning at the output.
        """
        low, high = (
            np.full(gyro_dps.shape, self.rate_center_dps + side * self.rate_scale_dps) for side in (-1, 1)
        )
        return crossing(miss_dps, low, high, gyro_dps)

    def rate_dps(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """True rate at a gyro output; NaN where no rate has this output."""
        gyro, temp = np.broadcast_arrays(np.asarray(gyro_dps, float), np.asarray(temp_c, float))
        if self.direction == "output":
            return np.asarray(gyro - self.error_dps(gyro, temp))
        g, t = gyro.ravel(), temp.ravel()
        return self.solve_own_dps(g, lambda x: x + self.error_dps(x, t) - g).reshape(gyro.shape)

    def near_rate_dps(self, gyro_dps: Floats, temp_c: Floats) -> Floats:
        """True rate at a gyro output, shape (n,), without solving for it: to 1 % of the error where that is a fifth of the rate."""
        if self.direction == "output":
            return self.rate_dps(gyro_dps, temp_c)
        rate = gyro_dps
        for _ in range(NEAR_ROUNDS):
            rate = gyro_dps - self.error_dps(rate, temp_c)
        return rate

    def error_at_output_dps(self, gyro_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Error at a gyro output, output minus rate, deg/s; NaN where no rate has this output."""
        return np.asarray(np.asarray(gyro_dps, float) - self.rate_dps(gyro_dps, temp_c))

    def output_dps(self, rate_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Gyro output at a true rate.

        Raises
        ------
        DataError
            The surface is not invertible there (an error slope near 1): no physical gyro is like that.
        """
        rate, temp = np.broadcast_arrays(np.asarray(rate_dps, float), np.asarray(temp_c, float))
        if self.direction == "input":
            return np.asarray(rate + self.error_dps(rate, temp))
        w, t = rate.ravel(), temp.ravel()
        gyro = self.solve_own_dps(w, lambda x: x - self.error_dps(x, t) - w)
        if not np.isfinite(gyro).all():
            raise self._refusal(w, t, np.isfinite(gyro))
        return gyro.reshape(rate.shape)

    def output_design(self, rate_dps: Floats, temp_c: Floats) -> Floats:
        """Derivatives of the output at true rates by the coefficients, shape (n, 12)."""
        if self.direction == "input":
            return self.design(rate_dps, temp_c)
        output = self.output_dps(rate_dps, temp_c)
        return self.design(output, temp_c) / (1.0 - self.slope_per_dps(output, temp_c))[:, None]

    def _refusal(self, rate_dps: Floats, temp_c: Floats, solved: NDArray[np.bool_]) -> DataError:
        first = int(np.flatnonzero(~solved)[0])
        return DataError(
            f"The error surface has no output for {rate_dps[first]:.4g} deg/s at {temp_c[first]:.4g} °C, "
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
        } | ({} if self.direction == "output" else {"direction": self.direction})
