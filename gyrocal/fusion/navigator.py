"""The navigator: from wheel distances, gyro rate and temperature to a pose with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_RATE, FLAG_TEMPERATURE, Coefficients
from gyrocal.fusion.robot import RobotParameters
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]

#: The nine states in the paper's order (eq. 12): pose by encoders, errors of S_R, S_L and D, heading by the gyro,
#: errors of B_s and B_rb. An error is the assumed figure (0, 0, the robot file's D, 1, 0) minus the truth.
STATES = (
    "x_m",
    "y_m",
    "heading_deg",
    "right_scale_error",
    "left_scale_error",
    "wheel_separation_error_m",
    "gyro_heading_deg",
    "gyro_scale_error",
    "gyro_bias_error_dps",
)

# Place of each of STATES in the compiled loop, and its unit there.
_PLACE = np.array([0, 1, 2, 4, 5, 6, 3, 7, 8])
_UNIT = np.array([1.0, 1.0, RAD_TO_DEG, 1.0, 1.0, 1.0, RAD_TO_DEG, 1.0, RAD_TO_DEG])


@dataclass(frozen=True)
class Counts:
    """What happened since the navigator was made, in rows.

    Attributes
    ----------
    rows, updates : int
        Rows taken, and measurements psi - phi made.
    gated : int
        Innovations beyond the gate, each taken as a slip of the wheels.
    gaps : int
        Time steps far above the running median: heading from the encoders.
    duplicates, repeated : int
        Rows with the time of the row before: no gyro, no update; of these, rows equal to it in all: ignored.
    no_encoders : int
        A distance is not finite: last speed held, heading from the gyro.
    no_gyro : int
        Rate or temperature is not finite: heading from the encoders; with none either, the last rate is held.
    no_temperature : int
        Of the rows of a calibrated gyro: temperature not finite, the last one was held.
    outside_rate, outside_temperature : int
        Outside the valid range of the calibration; the surface was used all the same.
    """

    rows: int = 0
    updates: int = 0
    gated: int = 0
    gaps: int = 0
    duplicates: int = 0
    repeated: int = 0
    no_encoders: int = 0
    no_gyro: int = 0
    no_temperature: int = 0
    outside_rate: int = 0
    outside_temperature: int = 0


@dataclass(frozen=True)
class NavigationState:
    """Where the robot is after one step (x forward, y left, counter-clockwise; REP 103).

    `states` and `std` follow `STATES`; the innovation is NaN where nothing was measured; without the filter `std`
    and innovation are NaN.
    """

    t_s: float
    x_m: float
    y_m: float
    heading_deg: float
    states: Floats
    std: Floats
    innovation_deg: float
    innovation_sigma_deg: float


@dataclass(frozen=True)
class Trajectory:
    """A `NavigationState` for every row; arrays of shape (n,), `states` and `std` (n, 9) in the order of `STATES`.

    Attributes
    ----------
    heading_deg : ndarray, deg
        Heading that the position follows, not wrapped: of the filter, or of the gyro alone.
    flags : ndarray of int
        `Coefficients.flags` of each row; zeros without a calibration.
    counts : Counts
        Since the navigator was made, at the end of this block.
    """

    t_s: Floats
    x_m: Floats
    y_m: Floats
    heading_deg: Floats
    states: Floats
    std: Floats
    innovation_deg: Floats
    innovation_sigma_deg: Floats
    flags: NDArray[np.int64]
    counts: Counts

    def __len__(self) -> int:
        return int(self.t_s.size)


class Navigator:
    """Dead reckoning of a robot, row by row (`step`) or block by block (`run`), through one compiled loop.

    Order of operations: the calibration first (gyro minus its error at output and temperature), then minus the static
    bias, which therefore is the mean of *compensated* rates at rest (`compensate`, `static_bias`).

    Parameters
    ----------
    robot : RobotParameters
    coefficients : Coefficients, optional
        Calibration of the gyro. With it the filter does not estimate the scale factor; without it, it does.
    filtering : bool
        False: orientation from the gyro alone, distance from the encoders.
    static_bias_dps : float
        Subtracted from every (compensated) rate.
    estimate_scale : bool, optional
        Overrides whether the filter estimates the scale factor.
    """

    def __init__(
        self,
        robot: RobotParameters,
        coefficients: Coefficients | None = None,
        *,
        filtering: bool = True,
        static_bias_dps: float = 0.0,
        estimate_scale: bool | None = None,
    ) -> None:
        # numba takes a while to load, and who only reads coefficients needs none of it.
        from gyrocal.fusion import filter as loop

        if not math.isfinite(static_bias_dps):
            raise DataError(f"static bias is {static_bias_dps} deg/s; take it from a record at rest.")
        self.robot = robot
        self.coefficients = coefficients
        self.filtering = filtering
        self.static_bias_dps = static_bias_dps
        self.estimate_scale = coefficients is None if estimate_scale is None else estimate_scale
        self.t_s = math.nan
        self._loop = loop
        self._noise = _squared_noise(robot)
        self._nav = np.zeros(loop.NAVIGATION_SIZE)
        self._nav[[loop.RIGHT, loop.LEFT, loop.SCALE]] = 1.0
        self._nav[loop.WIDTH] = robot.wheel_separation_m
        self._u = np.eye(len(STATES))
        self._d = _initial_variance(robot, self.estimate_scale)
        self._counts = np.zeros(8, dtype=np.int64)
        self._flagged = np.zeros(3, dtype=np.int64)
        self._temp_c = math.nan

    @property
    def counts(self) -> Counts:
        """What happened so far."""
        rows, updates, gated, gaps, duplicates, repeated, no_encoders, no_gyro = self._counts.tolist()
        return Counts(
            rows, updates, gated, gaps, duplicates, repeated, no_encoders, no_gyro, *self._flagged.tolist()
        )

    @property
    def covariance(self) -> Floats:
        """Covariance of the nine errors in the order and units of `STATES`, shape (9, 9)."""
        p = (self._u * self._d) @ self._u.T
        return p[np.ix_(_PLACE, _PLACE)] * np.outer(_UNIT, _UNIT)

    def compensate(self, gyro_dps: ArrayLike, temp_c: ArrayLike | None) -> tuple[Floats, NDArray[np.int64]]:
        """Rates by the calibration, without the static bias, and the flags of each row."""
        gyro = np.array(gyro_dps, dtype=np.float64, ndmin=1)
        if self.coefficients is None:
            return gyro, np.zeros(gyro.size, dtype=np.int64)
        if temp_c is None:
            raise DataError("a calibration needs the gyro's temperature, and the log has none: replay without it.")
        temp = np.broadcast_to(np.asarray(temp_c, dtype=np.float64), gyro.shape)
        held = self._hold_temperature(temp)
        flags = self.coefficients.flags(gyro, held)
        flags = np.where(np.isfinite(temp), flags, flags | FLAG_NOT_FINITE)
        self._flagged += [
            np.count_nonzero(~np.isfinite(temp)),
            np.count_nonzero(flags & FLAG_RATE),
            np.count_nonzero(flags & FLAG_TEMPERATURE),
        ]
        return self.coefficients.correct(gyro, held), flags

    def _hold_temperature(self, temp_c: Floats) -> Floats:
        finite = np.isfinite(temp_c)
        if finite.all() and temp_c.size:
            self._temp_c = float(temp_c[-1])
            return temp_c
        last = np.maximum.accumulate(np.where(finite, np.arange(temp_c.size), -1))
        held = np.where(last >= 0, temp_c[last], self._temp_c)
        if held.size:
            self._temp_c = float(held[-1])
        return held

    def run(
        self,
        t_s: ArrayLike,
        left_m: ArrayLike,
        right_m: ArrayLike,
        gyro_dps: ArrayLike,
        temp_c: ArrayLike | None = None,
    ) -> Trajectory:
        """Take the next block of rows; blocks of any size give the same numbers.

        Parameters
        ----------
        t_s, left_m, right_m, gyro_dps, temp_c : array_like, shape (n,)
            Time, distances of the wheels since the row before, gyro output, gyro temperature.

        Raises
        ------
        DataError
            Time is not finite or goes back; the states are no longer finite.
        """
        t = np.array(t_s, dtype=np.float64, ndmin=1)
        start = self.t_s if math.isfinite(self.t_s) or not t.size else float(t[0])
        return self._run(t, np.diff(t, prepend=start), left_m, right_m, gyro_dps, temp_c)

    def step(
        self, dt_s: float, left_m: float, right_m: float, gyro_dps: float, temp_c: float | None = None
    ) -> NavigationState:
        """Take one row, `dt_s` after the row before; the very first has ``dt_s = 0``."""
        t = np.array([(self.t_s if math.isfinite(self.t_s) else 0.0) + dt_s])
        block = self._run(t, np.array([dt_s], dtype=np.float64), left_m, right_m, gyro_dps, temp_c)
        return NavigationState(
            float(t[0]),
            float(block.x_m[0]),
            float(block.y_m[0]),
            float(block.heading_deg[0]),
            block.states[0],
            block.std[0],
            float(block.innovation_deg[0]),
            float(block.innovation_sigma_deg[0]),
        )

    def _run(
        self, t: Floats, dt: Floats, left: ArrayLike, right: ArrayLike, gyro: ArrayLike, temp: ArrayLike | None
    ) -> Trajectory:
        wrong = np.flatnonzero(~(dt >= 0.0))
        if wrong.size:
            row = int(self._counts[self._loop.ROWS]) + int(wrong[0])
            raise DataError(
                f"row {row}: the time step is {dt[wrong[0]]:g} s; times must be finite and in order: sort or mend the log."
            )
        rate, flags = self.compensate(gyro, temp)
        rate = (rate - self.static_bias_dps) * DEG_TO_RAD
        distances = [np.array(d, dtype=np.float64, ndmin=1) for d in (left, right)]
        rows = dt.size
        if any(a.shape != dt.shape for a in (rate, *distances)):
            raise DataError("time, distances and gyro differ in their number of rows: give one value of each a row.")
        track = np.empty((rows, 9 if self.filtering else 4))
        variance = np.empty((rows if self.filtering else 0, 9))
        innovation = np.full((rows, 2), np.nan)
        # An empty block must not be mistaken for one without a filter, nor change anything.
        if rows:
            self._loop.navigate(
                self._nav,
                self._u,
                self._d,
                self._noise,
                dt,
                *distances,
                rate,
                track,
                variance,
                innovation,
                self._counts,
            )
            self.t_s = float(t[-1])
        if not np.isfinite(self._nav[:9]).all():
            raise DataError("the navigation states are no longer finite: check units and scale of distances and gyro.")
        return self._trajectory(t, track, variance, innovation, flags)

    def _trajectory(
        self, t: Floats, track: Floats, variance: Floats, innovation: Floats, flags: NDArray[np.int64]
    ) -> Trajectory:
        states = np.full((t.size, len(STATES)), np.nan)
        std = np.full_like(states, np.nan)
        states[:, [0, 1, 2, 6]] = track[:, :4] * _UNIT[[0, 1, 2, 6]]
        heading = states[:, 6]
        if self.filtering:
            heading = states[:, 2]
            states[:, [3, 4]] = 1.0 / track[:, [4, 5]] - 1.0
            states[:, 5] = self.robot.wheel_separation_m - track[:, 6]
            states[:, 7] = 1.0 - track[:, 7]
            states[:, 8] = -track[:, 8] * RAD_TO_DEG
            std = np.sqrt(variance[:, _PLACE]) * _UNIT
        return Trajectory(
            t,
            states[:, 0],
            states[:, 1],
            heading,
            states,
            std,
            innovation[:, 0] * RAD_TO_DEG,
            np.sqrt(innovation[:, 1]) * RAD_TO_DEG,
            flags,
            self.counts,
        )


def _initial_variance(robot: RobotParameters, estimate_scale: bool) -> Floats:
    """Diagonal of the first P in the order and units of the compiled loop."""
    s = robot.initial_std
    scale = s.gyro_scale if estimate_scale else 0.0
    by_states = np.array(
        [
            s.x_m,
            s.y_m,
            s.heading_deg,
            s.right_scale,
            s.left_scale,
            s.wheel_separation_m,
            s.gyro_heading_deg,
            scale,
            s.gyro_bias_dps,
        ]
    )
    variance = np.empty(len(STATES))
    variance[_PLACE] = (by_states / _UNIT) ** 2
    return variance


def _squared_noise(robot: RobotParameters) -> Floats:
    """Noise figures of the compiled loop: variances in metres, radians and seconds."""
    n = robot.noise
    walk = n.angle_random_walk_deg_per_rt_h * DEG_PER_RT_H_TO_DPS_PER_RT_HZ * DEG_TO_RAD
    # Turning by a radian is turning by 57.3 deg, so deg^2/deg times pi/180 is rad^2/rad.
    turn = n.turn_slip_deg_per_rt_deg * math.sqrt(DEG_TO_RAD)
    bias, heading = n.bias_walk_dps_per_rt_s * DEG_TO_RAD, n.heading_noise_deg * DEG_TO_RAD
    figures = [n.wheel_slip_m_per_rt_m, turn, walk, bias, heading, robot.gate_sigma]
    return np.array([f * f for f in figures] + [robot.gap_factor])
