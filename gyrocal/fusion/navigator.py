"""The navigator: from wheel distances, gyro rate and temperature to a pose with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_RATE, FLAG_TEMPERATURE, Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.fusion.robot import RobotParameters
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD

Floats = NDArray[np.float64]

#: The nine states in the paper's order (eq. 12): pose by encoders, errors of S_R, S_L and D, heading by the gyro,
#: errors of B_s and B_rb. An error is the assumed figure (0, 0, the robot file's D, 1, 0) minus the truth.
STATES = (
    "x_m", "y_m", "heading_deg", "right_scale_error", "left_scale_error", "wheel_separation_error_m",
    "gyro_heading_deg", "gyro_scale_error", "gyro_bias_error_dps",
)  # fmt: skip


@dataclass(frozen=True)
class Counts:
    """What happened since the navigator was made, in rows."""

    rows: int = 0
    updates: int = 0  # measurements psi - phi
    gated: int = 0  # of these, beyond the gate: taken as a slip of the wheels
    gaps: int = 0  # time step far above the running median: heading from the encoders
    duplicates: int = 0  # time of the row before: distances count, gyro and filter do not
    repeated: int = 0  # of these, equal to the row before in all: ignored
    no_encoders: int = 0  # a distance is not finite: last speed held, heading from the gyro
    no_gyro: int = 0  # rate not finite: heading from the encoders, or else the last rate held
    no_temperature: int = 0  # not finite while a calibration needs it: the last one held
    outside_rate: int = 0  # outside the valid range of the calibration, which was used all the same
    outside_temperature: int = 0


@dataclass(frozen=True)
class Trajectory:
    """Where the robot was (x forward, y left, counter-clockwise; REP 103): shape (n,), or () from `step`.

    `states` and `std` have another axis, of 9, in the order of `STATES`; without the filter the errors stay zero
    and `std` and innovation are NaN.
    """

    t_s: Any
    x_m: Any
    y_m: Any
    heading_deg: Any  # what the position follows, not wrapped: of the filter, or of the gyro alone
    states: Any
    std: Any
    innovation_deg: Any  # psi - phi before the update; NaN where nothing was measured
    innovation_sigma_deg: Any  # what the filter expects of it
    flags: Any  # `Coefficients.flags`; zeros without a calibration
    counts: Counts  # since the navigator was made, at the last row


class Navigator:
    """Dead reckoning of a robot, row by row (`step`) or block by block (`run`), through one compiled loop.

    The calibration corrects the gyro first, then the static bias is subtracted: that is the mean of *compensated*
    rates at rest (`static_bias`).

    With `coefficients` the filter does not estimate the scale factor, without them it does (`estimate_scale`
    overrides). Without `filtering`: orientation from the gyro alone, distance from the encoders. `power_on_t_s`, when
    the gyro was switched on, is for calibrations that know its warm-up.
    """

    def __init__(
        self, robot: RobotParameters, coefficients: Coefficients | None = None, *, filtering: bool = True,
        static_bias_dps: float = 0.0, estimate_scale: bool | None = None, power_on_t_s: float | None = None,
    ) -> None:  # fmt: skip
        # numba takes a while to load, and who only reads coefficients needs none of it.
        from gyrocal.fusion import filter as loop

        if not math.isfinite(static_bias_dps):
            raise DataError(f"the static bias is {static_bias_dps} deg/s; take it from a record at rest.")
        self.robot, self.coefficients, self.filtering = robot, coefficients, filtering
        self.t_s, self._loop = math.nan, loop
        self._compensator = None if coefficients is None else Compensator(coefficients)
        self._power_on_t_s, self._temp_c = power_on_t_s, math.nan
        self._counts, self._flagged = np.zeros(loop.COUNTS_SIZE, dtype=np.int64), np.zeros(3, dtype=np.int64)
        self._nav = np.zeros(loop.NAVIGATION_SIZE)
        self._nav[[loop.RIGHT, loop.LEFT, loop.SCALE]] = 1.0
        self._nav[loop.WIDTH] = robot.wheel_separation_m
        self._figures = _figures(robot, static_bias_dps)
        self._matrix = np.eye(loop.MATRIX_ROWS, 9)
        self._matrix[loop.D, loop.PLACE] = (np.array(astuple(robot.initial_std)) / loop.UNIT) ** 2
        if not (coefficients is None if estimate_scale is None else estimate_scale):
            self._matrix[loop.D, loop.SCALE] = 0.0

    @property
    def counts(self) -> Counts:
        """What happened so far."""
        return Counts(*self._counts.tolist(), *self._flagged.tolist())

    @property
    def covariance(self) -> Floats:
        """Covariance of (estimate - truth) of `STATES`, in their units, shape (9, 9)."""
        # What is left of a constant's error is the truth of `STATES` minus its estimate: the other sign.
        sign = np.array([1, 1, 1, -1, -1, -1, 1, -1, -1])
        rows = self._matrix[self._loop.PLACE, :] * (sign * self._loop.UNIT)[:, None]
        half = rows * np.sqrt(self._matrix[self._loop.D])
        return np.asarray(half @ half.T)

    def run(
        self, t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, gyro_dps: ArrayLike,
        temp_c: ArrayLike | None = None,
    ) -> Trajectory:  # fmt: skip
        """Take the next rows, arrays of shape (n,); a log in blocks of any size gives the same numbers.

        `left_m` and `right_m` are the distances of the wheels since the row before, `gyro_dps` is the raw output.
        DataError where time is not finite or goes back, lengths differ, or the result is no longer finite.
        """
        t = np.array(t_s, dtype=np.float64, ndmin=1)
        dt = np.diff(t, prepend=t[:1] if math.isnan(self.t_s) else self.t_s)
        return self._run(t, dt, left_m, right_m, gyro_dps, temp_c)

    def step(
        self, dt_s: float, left_m: float, right_m: float, gyro_dps: float, temp_c: float | None = None
    ) -> Trajectory:
        """Take one row, `dt_s` after the row before (0 for the very first); returns that row, without an axis."""
        t = np.array([dt_s if math.isnan(self.t_s) else self.t_s + dt_s])
        row = self._run(t, np.array([float(dt_s)]), left_m, right_m, gyro_dps, temp_c)
        return Trajectory(**{k: v if k == "counts" else v[0] for k, v in vars(row).items()})

    def _run(
        self, t: Floats, dt: Floats, left: ArrayLike, right: ArrayLike, gyro: ArrayLike, temp: ArrayLike | None
    ) -> Trajectory:  # fmt: skip
        if not (dt >= 0.0).all() or np.isinf(dt).any():
            k = int(np.argmin((dt >= 0.0) & np.isfinite(dt)))
            msg = f"row {self._counts[0] + k}: the time step is {dt[k]:g} s; times must be finite and in order: mend the log."
            raise DataError(msg)
        left, right, gyro = (np.array(a, dtype=np.float64, ndmin=1) for a in (left, right, gyro))
        if not left.shape == right.shape == gyro.shape == t.shape:
            msg = "time, distances and gyro differ in their number of rows: give one of each in a row."
            raise DataError(msg)
        rate, flags = self._compensate(t, gyro, temp)
        states, nothing = np.empty((t.size, 9)), np.broadcast_to(math.nan, (t.size, 9))
        std, innovation = nothing, nothing[:, :2]
        outputs = (states, states, states)
        if self.filtering:
            std, innovation = np.empty((t.size, 9)), np.empty((t.size, 2))
            outputs = (states, std, innovation)
        carried = (self._nav, self._matrix, self._figures, self._counts)
        self._loop.navigate(*carried, dt, left, right, rate, *outputs, self.filtering)
        if not np.isfinite(self._nav[:9]).all():
            msg = "position or heading is no longer finite: check units and scale of distances and gyro."
            raise DataError(msg)
        self.t_s = float(t[-1]) if t.size else self.t_s
        x, y, heading = (states[:, k] for k in (0, 1, 2 if self.filtering else 6))
        return Trajectory(
            t, x, y, heading, states, std, innovation[:, 0], innovation[:, 1], flags, self.counts
        )

    def _compensate(
        self, t: Floats, gyro: Floats, temp_c: ArrayLike | None
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Rates by the calibration, a missing temperature held at the last one; and flags."""
        if self._compensator is None or self.coefficients is None:
            return gyro, np.zeros(gyro.size, dtype=np.int64)
        if temp_c is None:
            msg = "a calibration needs the gyro's temperature, and the log has none: replay without it."
            raise DataError(msg)
        temp = np.append(self._temp_c, np.broadcast_to(np.asarray(temp_c, dtype=np.float64), gyro.shape))
        finite = np.isfinite(temp)
        temp = temp[np.maximum.accumulate(np.where(finite, np.arange(temp.size), 0))]
        self._temp_c = float(temp[-1])
        since = None if self._power_on_t_s is None else t - self._power_on_t_s
        flags = self.coefficients.flags(gyro, temp[1:]) | np.where(finite[1:], 0, FLAG_NOT_FINITE)
        counted = [~finite[1:], flags & FLAG_RATE, flags & FLAG_TEMPERATURE]
        self._flagged += [np.count_nonzero(rows) for rows in counted]
        return self._compensator.correct(t, gyro, temp[1:], since), flags


def _figures(robot: RobotParameters, static_bias_dps: float) -> Floats:
    """Figures of the compiled loop: variances in metres, radians and seconds, and limits."""
    slip, turn, walk, bias_walk, heading = astuple(robot.noise)
    walk *= DEG_PER_RT_H_TO_DPS_PER_RT_HZ
    # Turning by a radian is turning by 57.3 deg: deg^2/deg times pi/180 is rad^2/rad.
    in_radians = [turn / math.sqrt(DEG_TO_RAD), walk, bias_walk, heading]
    squared = np.array([slip, *(DEG_TO_RAD * v for v in in_radians), robot.gate_sigma]) ** 2
    return np.append(squared, [robot.gap_factor, static_bias_dps, robot.wheel_separation_m])
