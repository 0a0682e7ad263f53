"""The navigator: from wheel distances, gyro rate and temperature to a pose with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_RATE, FLAG_TEMPERATURE, Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.fusion.robot import RobotParameters
from gyrocal.physics.drive import tick_wait_s
from gyrocal.physics.slip import SLIP_LAWS
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD

Floats = NDArray[np.float64]

#: The bias of a rest is where the model starts; the rows of the rest then settle it.
_REST_STD_DPS = 0.05
_NOT_FINITE = "position or heading would no longer be finite: check units and scale of distances and gyro. What was given is left out, and the navigator stays as it was."
_NO_NUMBER = "time step and readings are numbers; give NaN for a reading that is missing."
#: Spacing of the model's nodes, s, where the encoders are not smoothed over longer.
NODE_S = 0.1

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
    """Where the robot was (x forward, y left, counter-clockwise; REP 103): shape (n,).

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
    drift_m: Any  # deviation of position but for the scales' part, which no filter lessens; NaN in the paper's filter
    flags: Any  # `Coefficients.flags`; zeros without a calibration
    counts: Counts  # since the navigator was made, at the last row


class Row:
    """One row of a `Trajectory`, from `step`: the same names, single numbers and arrays of nine; no counts."""

    __slots__ = ("_heading", "_values", "flags", "t_s")

    def __init__(self, t_s: float, values: Floats, heading: int, flags: int) -> None:
        self.t_s, self._values, self._heading, self.flags = t_s, values, heading, flags

    @property
    def x_m(self) -> float:
        """Forward."""
        return float(self._values[0, 0])

    @property
    def y_m(self) -> float:
        """To the left."""
        return float(self._values[0, 1])

    @property
    def heading_deg(self) -> float:
        """What the position follows."""
        return float(self._values[0, self._heading])

    @property
    def states(self) -> Floats:
        """In the order of `STATES`."""
        return self._values[0, :9]

    @property
    def std(self) -> Floats:
        """Standard deviations of `states`."""
        return self._values[0, 9:18]

    @property
    def innovation_deg(self) -> float:
        """Before the update; NaN where nothing was measured."""
        return float(self._values[0, 18])

    @property
    def innovation_sigma_deg(self) -> float:
        """What the filter expects of it."""
        return float(self._values[0, 19])


class Navigator:
    """Dead reckoning of a robot, row by row (`step`) or block by block (`run`), through one compiled loop.

    The calibration corrects the gyro first, then the static bias is subtracted: that is the mean of *compensated*
    rates at rest (`static_bias`).

    What the robot file knows of the gyro's bias, slope and scale is of its raw output: a calibration stands in their
    place, and only the step of the bias in motion holds beside it. `static_bias_dps` replaces the file's bias, and
    `static_temp_c`, the temperature of that rest, the one where it holds. Delay and encoder window are the business
    of `gyrocal.fusion.Aligner`, which comes before.

    Parameters
    ----------
    kind : {'model', 'paper'}
        The drive model (`gyrocal.fusion.model`), or the paper's nine states and its white measurement noise.
    filtering : bool
        False: orientation from the gyro alone, distance from the encoders; with the model, bias from every rest, which also takes back
        what it did to the path before: where the bias was not known, a robot that stands leaps, by metres after a long way.
    estimate_scale : bool, optional
        In the paper's filter: whether the gyro's scale factor is estimated; None: where there are no `coefficients`.
    power_on_t_s : float, optional
        When the gyro was switched on, for calibrations that know its warm-up.
    start_t_s : float
        Time from which `step` counts its `dt_s`, on the clock of `power_on_t_s`: that of the first row. `run` has it from its times.
    """

    def __init__(
        self, robot: RobotParameters, coefficients: Coefficients | None = None, *, kind: str = "model",
        filtering: bool = True, static_bias_dps: float | None = None, static_temp_c: float | None = None,
        estimate_scale: bool | None = None, power_on_t_s: float | None = None, start_t_s: float = 0.0,
    ) -> None:  # fmt: skip
        # numba takes a while to load, and who only reads coefficients needs none of it.
        from gyrocal.fusion import filter as paper
        from gyrocal.fusion import model

        if kind not in ("model", "paper"):
            raise DataError(f"there is no filter {kind!r}; kind is 'model' or 'paper'.")
        if static_bias_dps is not None and not math.isfinite(static_bias_dps):
            raise DataError(f"the static bias is {static_bias_dps} deg/s; take it from a record at rest.")
        self.robot, self.coefficients, self.filtering, self.kind = robot, coefficients, filtering, kind
        loop = model if kind == "model" else paper
        self.t_s, self._start_t_s, self._loop, self._unit = math.nan, start_t_s, loop, np.array(paper.UNIT)
        self._compensator = None if coefficients is None else Compensator(coefficients)
        self._power_on_t_s, self._temp_c = power_on_t_s, math.nan
        self._figures = _figures(robot, coefficients is not None, static_bias_dps, static_temp_c)
        nav = np.zeros(loop.MEMORY_SIZE)
        constants = [paper.WIDTH, paper.RIGHT, paper.LEFT, paper.SCALE]
        nav[constants] = self._figures[paper.FILE_WIDTH : paper.FILE_SCALE + 1]
        nav[paper.LAST_TEMP] = self._figures[paper.TEMP]
        self._out = np.full((1, paper.COLUMNS), math.nan)
        self._heading = 2 if filtering and kind == "paper" else 6
        std = np.array(astuple(robot.initial_std)) / paper.UNIT
        if kind == "model":
            std[STATES.index("gyro_bias_error_dps")] = DEG_TO_RAD * _bias_std_dps(robot, static_bias_dps)
            matrix = model.initial_covariance(std, self._figures)
        else:
            matrix = np.eye(paper.MATRIX_ROWS, 9)
            matrix[paper.D, paper.PLACE] = std**2
            if not (coefficients is None if estimate_scale is None else estimate_scale):
                matrix[paper.D, paper.SCALE] = 0.0
        # All that rows change lies in one piece, so that a row that is refused is quickly undone.
        self._state = np.concatenate([nav, matrix.ravel(), np.zeros(paper.COUNTS_SIZE + 3)])
        self._kept = self._state.copy()
        ends = np.cumsum([nav.size, matrix.size, paper.COUNTS_SIZE])
        self._nav, flat, counts, flagged = np.split(self._state, ends)
        self._matrix = flat.reshape(matrix.shape)
        self._counts, self._flagged = counts.view(np.int64), flagged.view(np.int64)

    @property
    def counts(self) -> Counts:
        """What happened so far."""
        return Counts(*self._counts.tolist(), *self._flagged.tolist())

    @property
    def covariance(self) -> Floats:
        """Covariance of (estimate - truth) of `STATES`, in their units, shape (9, 9)."""
        # What is left of a constant's error is the truth of `STATES` minus its estimate: the other sign.
        unit = np.array([1, 1, 1, -1, -1, -1, 1, -1, -1]) * self._unit
        found = self._loop.covariance(self._nav, self._matrix, self._figures)
        return np.asarray(found * np.outer(unit, unit))

    def run(
        self, t_s: ArrayLike, left_m: ArrayLike, right_m: ArrayLike, gyro_dps: ArrayLike,
        temp_c: ArrayLike | None = None, smooth_dps: ArrayLike = 0.0,
    ) -> Trajectory:  # fmt: skip
        """Take the next rows, arrays of shape (n,); a log in blocks of any size gives the same numbers.

        `left_m` and `right_m` are the distances of the wheels since the row before, `gyro_dps` is the raw output.
        `smooth_dps` is what smoothing the gyro as the encoders are smoothed would add (`Aligner`), for the model.
        DataError where time is not finite or goes back, lengths differ, or the result would no longer be finite; the navigator
        then stays as it was before these rows.
        """
        t = np.array(t_s, dtype=np.float64, ndmin=1)
        dt = np.diff(t, prepend=t[:1] if math.isnan(self.t_s) else self.t_s)
        return self._run(t, dt, left_m, right_m, gyro_dps, temp_c, smooth_dps)

    def step(
        self, dt_s: float, left_m: float, right_m: float, gyro_dps: float, temp_c: float | None = None,
        smooth_dps: float = 0.0,
    ) -> Row:  # fmt: skip
        """Take one row, `dt_s` after the row before (0 for the very first); the same numbers as by `run`.

        A reading that is missing is NaN. DataError as from `run`; the navigator then stays as it was before the row.
        """
        try:
            dt_s, left_m, right_m, gyro_dps = float(dt_s), float(left_m), float(right_m), float(gyro_dps)
            warm, smooth_dps = math.nan if temp_c is None else float(temp_c), float(smooth_dps)
        except (TypeError, ValueError):
            raise DataError(f"row {self._counts[0]}: {_NO_NUMBER}") from None
        if not 0.0 <= dt_s < math.inf:
            self._refuse_time(np.array([dt_s]))
        self._keep()
        t, flags = dt_s + (self.t_s if self.t_s == self.t_s else self._start_t_s), 0
        if self._compensator is not None:
            rates, flagged = self._compensate(np.array([t]), np.array([gyro_dps]), temp_c)
            gyro_dps, flags = float(rates[0]), int(flagged[0])
        finite = self._loop.step(
            self._nav, self._matrix, self._figures, self._counts, dt_s, left_m, right_m, gyro_dps, warm, smooth_dps,
            self._out, self.filtering,
        )  # fmt: skip
        if not finite:
            self._undo()
        self.t_s = t
        return Row(self.t_s, self._out.copy(), self._heading, flags)

    def _keep(self) -> None:
        """Note all that rows change, the memory of the calibration too."""
        self._kept[:] = self._state
        self._memory = self._temp_c, [] if self._compensator is None else self._compensator.memories

    def _undo(self) -> NoReturn:
        """Go back to what was kept, and refuse what came since."""
        self._state[:] = self._kept
        self._temp_c, memories = self._memory
        if self._compensator is not None:
            self._compensator.memories = memories
        raise DataError(_NOT_FINITE)

    def _refuse_time(self, dt: Floats) -> None:
        k = int(np.argmin((dt >= 0.0) & np.isfinite(dt)))
        msg = f"row {self._counts[0] + k}: the time step is {dt[k]:g} s; times must be finite and in order: mend the log."
        raise DataError(msg)

    def _run(
        self, t: Floats, dt: Floats, left: ArrayLike, right: ArrayLike, gyro: ArrayLike, temp: ArrayLike | None,
        smooth: ArrayLike,
    ) -> Trajectory:  # fmt: skip
        if not (dt >= 0.0).all() or np.isinf(dt).any():
            self._refuse_time(dt)
        left, right, gyro = (np.array(a, dtype=np.float64, ndmin=1) for a in (left, right, gyro))
        if not left.shape == right.shape == gyro.shape == t.shape:
            msg = "time, distances and gyro differ in their number of rows: give one of each in a row."
            raise DataError(msg)
        self._keep()
        rate, flags = self._compensate(t, gyro, temp)
        warm = np.array(np.broadcast_to(math.nan if temp is None else temp, t.shape), dtype=np.float64)
        added = np.array(np.broadcast_to(smooth, t.shape), dtype=np.float64)
        out = np.empty((t.size, self._out.shape[1]))
        carried = (self._nav, self._matrix, self._figures, self._counts)
        self._loop.navigate(*carried, dt, left, right, rate, warm, added, out, self.filtering)
        if not (np.isfinite(self._nav[:9]).all() and np.isfinite(self._matrix).all()):
            self._undo()
        self.t_s = float(t[-1]) if t.size else self.t_s
        states, std = out[:, : len(STATES)], out[:, len(STATES) : 2 * len(STATES)]
        x, y, heading = (states[:, k] for k in (0, 1, self._heading))
        z, sigma, drift = out[:, 2 * len(STATES) :].T
        return Trajectory(t, x, y, heading, states, std, z, sigma, drift, flags, self.counts)

    def _compensate(
        self, t: Floats, gyro: Floats, temp_c: ArrayLike | None
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Rates by the calibration, a missing temperature held at the last one; and flags."""
        if self._compensator is None or self.coefficients is None:
            return gyro, np.zeros(gyro.size, dtype=np.int64)
        if temp_c is None:
            raise DataError("the file needs the gyro's temperature; the log has none: replay without it.")
        temp = np.append(self._temp_c, np.broadcast_to(np.asarray(temp_c, dtype=np.float64), gyro.shape))
        finite = np.isfinite(temp)
        temp = temp[np.maximum.accumulate(np.where(finite, np.arange(temp.size), 0))]
        self._temp_c = float(temp[-1])
        since = None if self._power_on_t_s is None else t - self._power_on_t_s
        flags = self.coefficients.flags(gyro, temp[1:]) | np.where(finite[1:], 0, FLAG_NOT_FINITE)
        counted = [~finite[1:], flags & FLAG_RATE, flags & FLAG_TEMPERATURE]
        self._flagged += [np.count_nonzero(rows) for rows in counted]
        return self._compensator.correct(t, gyro, temp[1:], since), flags


def _figures(
    robot: RobotParameters, calibrated: bool, static_bias_dps: float | None, static_temp_c: float | None
) -> Floats:
    """Figures of the compiled loops: variances in metres, radians and seconds, limits, and what the file knows."""
    noise, gyro, wheels, slip = robot.noise, robot.gyro, robot.encoders, robot.slip
    walk = noise.angle_random_walk_deg_per_rt_h * DEG_PER_RT_H_TO_DPS_PER_RT_HZ
    # Turning by a radian is turning by 57.3 deg: deg^2/deg times pi/180 is rad^2/rad.
    turn = noise.turn_slip_deg_per_rt_deg / math.sqrt(DEG_TO_RAD)
    in_radians = [DEG_TO_RAD * v for v in (turn, walk, noise.bias_walk_dps_per_rt_s, noise.heading_noise_deg)]
    squared = np.array([noise.wheel_slip_m_per_rt_m, *in_radians, robot.gate_sigma]) ** 2
    raw = 0.0 if calibrated else 1.0
    bias = static_bias_dps if static_bias_dps is not None else raw * gyro.bias_dps
    temp = gyro.temp_c if static_temp_c is None else static_temp_c
    known = [robot.gap_factor, bias, raw * gyro.bias_slope_dps_per_c, temp]
    known += [gyro.bias_motion_dps, gyro.bias_moving_dps, gyro.bias_moving_s, tick_wait_s(noise.tick_m)]
    scales = [1.0 / (1.0 + s) for s in (wheels.right_scale, wheels.left_scale, raw * gyro.scale)]
    sided = 0.5 * raw * gyro.asymmetry * scales[-1]
    scales += [1.0 / (1.0 + sided), 1.0 / (1.0 - sided)]
    # A tick is rounded evenly, on both wheels.
    ticks = noise.tick_m**2 / 6.0 / robot.wheel_separation_m**2
    of_bias = (gyro.bias_motion_dps_std, gyro.bias_moving_dps_std, raw * gyro.bias_slope_dps_per_c_std)
    wandering = [noise.track_wander**2, noise.wheel_wander**2, noise.track_wander_s, noise.wheel_wander_s]
    spreads = [*(DEG_TO_RAD * v for v in of_bias), raw * robot.gyro_scale_std, robot.way_std]
    model = [max(NODE_S, wheels.window_s), ticks, noise.jitter_s**2, (noise.flicker_dps * DEG_TO_RAD) ** 2]
    model += [*wandering, *(v * v for v in spreads)]
    law = [float(SLIP_LAWS.index(slip.law)), slip.amplitude, slip.shape]
    return np.concatenate([squared, known, [robot.wheel_separation_m, *scales], model, law])


def _bias_std_dps(robot: RobotParameters, static_bias_dps: float | None) -> float:
    """What is known of the bias at the start."""
    if static_bias_dps is not None:
        return _REST_STD_DPS
    known = math.hypot(robot.gyro.bias_dps_std, robot.gyro.repeatability_dps)
    return known or float(robot.initial_std.gyro_bias_dps or 0.0)
