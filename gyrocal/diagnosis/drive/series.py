"""A drive log as the diagnosis looks at it: clean channels row by row, rests, ticks, and the nodes of the comparison."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import maximum_filter, median_filter, minimum_filter
from scipy.signal import lfilter

from gyrocal.diagnosis.drive.rests import moving_rows, refused_rest, still_rows
from gyrocal.diagnosis.drive.stamps import at_own_times
from gyrocal.diagnosis.remarks import Note, Remark, Said
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.inference.runs import runs_of
from gyrocal.navigation.channels import check_cells, check_speed, held
from gyrocal.navigation.fixes import no_fixes
from gyrocal.navigation.lost_ways import GAP_STEPS, lost_ways
from gyrocal.navigation.stuck_wheel import refuse_stuck, stuck_said, stuck_wheels
from gyrocal.navigation.survey import one_speed
from gyrocal.physics.drive import tick_wait_s
from gyrocal.records.drive import UNUSED_STEERING, DriveBlock
from gyrocal.records.robot import Robot
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG, STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Spacing of the comparison in motion and at rest, s: closer brings nothing, wider loses delays and small wheels.
NODE_S, REST_NODE_S = 0.1, 1.0
#: Share of the rows whose speed must be one that a vehicle has: single rows may be of a clock that jumped.
_FAST = 0.95
#: Rates for the laws are means over this time, s: a law must not carry the noise of what it explains.
SMOOTH_S = 0.15
#: Shorter drives, s and m, are refused: they tell neither bias nor track better than a robot file does.
_LEAST_S, _LEAST_M = 60.0, 1.0
#: A gyro's sample this far from the median of its neighbours, in robust standard deviations and in deg/s, is a spike.
_SPIKE_STDS, _SPIKE_DPS = 12.0, 2.0
#: No robot's turn rate changes faster, deg/s^2: a small one's by 200, a racing car's by some 1000. Within what it may change
#: by in a row the end of a turn looks like a spike (at 10 rows a second, to a median of five, by 20 deg/s), unless the
#: wheels, a row either side, turn by less than this share of it.
_QUICKEST_DPS2, _SHARED = 1000.0, 0.2
#: Multiples of a tick from which its size is told, and how far off they may lie.
_MULTIPLES, _OFF = (3, 10, 40, 200, 1000), 0.1
#: Share of the steps that must be few ticks, and of these share that must lie on whole ones.
_FEW_TICKS, _ON_TICKS = 0.05, 0.98
#: Steps below this are the file's rounding, m.
_LEAST_TICK_M = 1e-5


@dataclass(frozen=True)
class DriveSeries:
    """A drive log row by row, arrays of shape (n,).

    Attributes
    ----------
    t_s, dt_s : time of the row, and since the row before (0 in the first)
    left_m, right_m : distance of each side since the row before
    gyro_dps : mean rate since the row before, calibrated, spikes bridged
    temp_c, truth_x_m, truth_y_m, truth_heading_deg : NaN where there is none
    resting, gap : whether the robot stands for sure, and whether a gap in time ends here
    bridged : whether a wheel's distance is not known here, but made up from its speed before and after
    quiet, moved : whether no wheel moves about this row, and whether one has moved by now
    tick_m : size of a tick of the left and right wheel; 0 where it has none
    differential : whether the wheels differ at all, or one speed stands in both columns
    calibrated, gyro_scale, gyro_asymmetry : whether coefficients made the rate, and what of the robot file's scales is taken out of
        it; those of the wheels are taken out, too
    """

    source: str
    t_s: Floats
    dt_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    temp_c: Floats
    truth_x_m: Floats
    truth_y_m: Floats
    truth_heading_deg: Floats
    resting: Bools
    quiet: Bools
    moved: Bools
    gap: Bools
    bridged: Bools
    tick_m: tuple[float, float]
    differential: bool
    calibrated: bool
    gyro_scale: float
    gyro_asymmetry: float
    robot: Robot = field(repr=False)
    notes: tuple[Note, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def rested(self) -> bool:
        """Whether the rest that the robot file promises is in the log, as `replay` finds it."""
        static_s = self.robot.static_s
        refused = refused_rest(self.t_s, self.left_m, self.right_m, self.gyro_dps, static_s)
        return static_s > 0.0 and not refused

    @property
    def step_m(self) -> Floats:
        """Distance of the robot's centre in each row (paper eq. 6)."""
        return 0.5 * (self.left_m + self.right_m)

    @property
    def encoder_rad(self) -> Floats:
        """Heading by the encoders at the end of each row, by the robot file's wheel separation."""
        return np.asarray(np.cumsum(self.wheel_turn_rad))

    @property
    def gyro_rad(self) -> Floats:
        """Heading by the gyro at the end of each row; its rows are means over the time before."""
        return np.asarray(
            np.cumsum(self.over_gaps(DEG_TO_RAD * self.gyro_dps * self.dt_s, self.wheel_turn_rad))
        )

    @property
    def wheel_turn_rad(self) -> Floats:
        """Turn of each row by the encoders."""
        return (self.right_m - self.left_m) / self.robot.wheel_separation_m

    @property
    def counts_on(self) -> bool:
        """Whether the wheels count on in gaps, rather than that their way is lost with the rows: by the speeds beside them."""
        gaps, usual_s = np.flatnonzero(self.gap), usual_step_s(self.t_s)
        speed_mps = np.abs(self.step_m) / np.where(self.dt_s > 0, self.dt_s, usual_s)
        beside_mps = 0.5 * (speed_mps[gaps - 1] + speed_mps[np.minimum(gaps + 1, self.t_s.size - 1)])
        # Half way between that of the whole time and that of one row.
        half_way_m = beside_mps @ (0.5 * (self.dt_s[gaps] + usual_s))
        return bool(np.sum(np.abs(self.step_m[gaps])) > half_way_m)

    def over_gaps(self, gyro_rad: Floats, wheels_rad: Floats) -> Floats:
        """Turns of the rows by the gyro, over gaps in time by the wheels, which count there, too; as replay does."""
        return np.where(self.gap, wheels_rad, gyro_rad) if self.differential else gyro_rad

    def moving(self, lag_s: float) -> Floats:
        """How far whatever follows the motion with a lag has come, 0 at rest to 1, row by row."""
        # From the last tick to the next: a rest leaves out what it is not sure of.
        awake = still_rows(self.t_s, self.resting, tick_wait_s(max(self.tick_m)))
        moving = awake.astype(np.float64)
        if lag_s == 0.0:
            return moving
        keep = float(np.exp(-usual_step_s(self.t_s) / lag_s))
        later = np.append(True, self.dt_s[1:] > 0)
        followed = lfilter([1.0 - keep], [1.0, -keep], moving[later])
        return np.asarray(followed[np.cumsum(later) - 1])

    @property
    def first_rest_s(self) -> float:
        """How long the log stands at its start."""
        moving = np.flatnonzero(~self.resting)
        return float(self.t_s[moving[0]] - self.t_s[0]) if moving.size else self.duration_s

    @property
    def has_truth(self) -> bool:
        """Whether there are true positions."""
        return bool(np.any(np.isfinite(self.truth_x_m) & np.isfinite(self.truth_y_m)))


def drive_series(
    source: str,
    log: DriveBlock,
    robot: Robot,
    coefficients: Coefficients | None,
    *,
    noisy_rests: bool = True,
) -> DriveSeries:
    """Prepare a log; the gyro is calibrated first where coefficients are given. `noisy_rests` as in `rests.moving_rows`.

    Raises
    ------
    DataError
        Too short or without motion, or coefficients without a temperature in the log.
    """
    _check_length(source, log.t_s)
    log, notes = at_own_times(log)
    if (lost := lost_ways([log], usual_step_s(log.t_s))) is not None:
        (log,) = lost.completed([log])
        notes.append(Remark(Said.WAYS_ADDED, {"way_m": lost.way_m}))
    _check_channels(source, log)
    dt_s = np.diff(log.t_s, prepend=log.t_s[0])
    gap = dt_s > GAP_STEPS * usual_step_s(log.t_s)
    notes += _gaps_said(log.t_s, dt_s, gap)
    if np.isfinite(log.steering_deg).any():
        notes.append(UNUSED_STEERING)
    of_gyro = robot.parameters.gyro
    scale, asymmetry = (of_gyro.scale, of_gyro.asymmetry) if coefficients is None else (0.0, 0.0)
    gyro, said = _gyro(source, log, robot, coefficients, scale, asymmetry)
    log, stuck = _without_stuck(source, log, robot, gyro * dt_s)
    (left, right), told = _wheels(log, robot, dt_s)
    bridged = ~np.isfinite(log.left_m + log.right_m)
    _check_way(source, log, left, right, dt_s)
    (x_m, y_m, heading_deg), wild = _truth(log, left, right)
    ticks = tick_size(left[~bridged]), tick_size(right[~bridged])
    moving, rests = moving_rows(log.t_s, dt_s, (left, right), ticks, gyro, noisy_rests=noisy_rests)
    return DriveSeries(
        source=source,
        t_s=log.t_s,
        dt_s=dt_s,
        left_m=left,
        right_m=right,
        gyro_dps=gyro,
        temp_c=log.gyro_temp_c,
        truth_x_m=x_m,
        truth_y_m=y_m,
        truth_heading_deg=heading_deg,
        resting=still_rows(log.t_s, moving, tick_wait_s(max(ticks))),
        quiet=still_rows(log.t_s, moving, SMOOTH_S),
        moved=np.cumsum(moving) > 0,
        gap=gap,
        bridged=bridged,
        tick_m=ticks,
        differential=not (log.speed_only or one_speed(log.left_m, log.right_m)),
        calibrated=coefficients is not None,
        gyro_scale=scale,
        gyro_asymmetry=asymmetry,
        robot=robot,
        notes=(*log.notes, *notes, *stuck, *told, *wild, *rests, *said),
    )


def _check_length(source: str, t_s: Floats) -> None:
    if t_s.size < 100 or t_s[-1] - t_s[0] < _LEAST_S:
        long = float(t_s[-1] - t_s[0]) if t_s.size else 0.0
        raise DataError(
            f"{source}: {long:.0f} s are too short to compare encoders and gyro; log at least {_LEAST_S:g} s."
        )


def _check_channels(source: str, log: DriveBlock) -> None:
    no_gyro, no_wheel = (
        int(np.count_nonzero(~np.isfinite(v))) for v in (log.gyro_dps, log.left_m + log.right_m)
    )
    gyro_dps, temp_c = (v[np.isfinite(v)] for v in (log.gyro_dps, log.gyro_temp_c))
    check_cells(source, log.t_s.size, no_gyro, no_wheel, gyro_dps, temp_c)


def _check_way(source: str, log: DriveBlock, left_m: Floats, right_m: Floats, dt_s: Floats) -> None:
    if max(np.abs(left_m).sum(), np.abs(right_m).sum()) < _LEAST_M:
        raise DataError(f"{source}: the wheels move less than 1 m; there is nothing to compare.")
    # Of each side: of a robot on the spot both together go nowhere.
    speed_mps = 0.5 * (np.abs(left_m) + np.abs(right_m))[dt_s > 0] / dt_s[dt_s > 0]
    check_speed(source, float(np.quantile(speed_mps, _FAST)), speed_only=log.speed_only)


def _gaps_said(t_s: Floats, dt_s: Floats, gap: Bools) -> list[Remark]:
    if not gap.any():
        return []
    longest = int(np.argmax(dt_s))
    facts = {"longest_s": float(dt_s[longest]), "at_s": float(t_s[longest] - dt_s[longest])}
    return [Remark(Said.GAPS, {"count": int(gap.sum()), "steps": GAP_STEPS, **facts})]


def _without_stuck(
    source: str, log: DriveBlock, robot: Robot, gyro_deg: Floats
) -> tuple[DriveBlock, tuple[str, ...]]:
    """The log without what a wheel's counter says while it is stuck, and what is said of that."""
    if log.speed_only:
        return log, ()
    stuck = stuck_wheels(log.t_s, log.left_m, log.right_m, gyro_deg, robot.wheel_separation_m)
    refuse_stuck(source, stuck, float(log.t_s[-1] - log.t_s[0]))

    def known(side: str, way_m: Floats) -> Floats:
        for wheel in stuck:
            within = (log.t_s > wheel.since_s) & (log.t_s <= wheel.until_s)
            way_m = np.where(within & (wheel.side == side), np.nan, way_m)
        return way_m

    without = replace(log, left_m=known("left", log.left_m), right_m=known("right", log.right_m))
    return without, stuck_said(stuck, bridged=True)


def _wheels(log: DriveBlock, robot: Robot, dt_s: Floats) -> tuple[list[Floats], list[Remark]]:
    """Distances of the left and the right wheel without the robot file's scales; of empty rows by the speeds beside them."""
    found, notes = list[Floats](), list[Remark]()
    wheels = robot.parameters.encoders
    read = {"left": (log.left_m, wheels.left_scale), "right": (log.right_m, wheels.right_scale)}
    for name, (read_m, scale) in read.items():
        step_m = read_m / (1.0 + scale)
        known = np.isfinite(step_m)
        told = known & (dt_s > 0)
        if not known.all() and told.any():
            notes.append(Remark(Said.EMPTY_WHEEL, {"count": int(np.count_nonzero(~known)), "wheel": name}))
            speed_mps = np.interp(log.t_s, log.t_s[told], step_m[told] / dt_s[told])
            step_m = np.where(known, step_m, speed_mps * dt_s)
        found.append(np.nan_to_num(step_m))
    return found, notes


def _truth(log: DriveBlock, left_m: Floats, right_m: Floats) -> tuple[list[Floats], tuple[str, ...]]:
    """True positions and headings, none where a fix is none, and what is said of these."""
    way_m = np.cumsum(0.5 * np.abs(left_m + right_m))
    none, said = no_fixes(log.t_s, log.truth_x_m, log.truth_y_m, way_m)
    return [np.where(none, np.nan, x) for x in (log.truth_x_m, log.truth_y_m, log.truth_heading_deg)], said


def _gyro(
    source: str,
    log: DriveBlock,
    robot: Robot,
    coefficients: Coefficients | None,
    scale: float,
    asymmetry: float,
) -> tuple[Floats, list[Remark]]:
    """The gyro, calibrated where there are coefficients, without the robot file's scales about its bias, empty rows and spikes bridged by their neighbours."""
    gyro_dps, notes = log.gyro_dps, []
    if coefficients is not None:
        if not np.any(np.isfinite(log.gyro_temp_c)):
            raise DataError(
                f"{source}: has no gyro_temp_c, so coefficients cannot be applied. Leave --coefficients out."
            )
        gyro_dps = Compensator(coefficients).correct(log.t_s, gyro_dps, held(log.gyro_temp_c))
        notes.append(Remark(Said.CALIBRATED))
    given_dps = robot.parameters.gyro.bias_dps
    if scale or asymmetry:
        off_dps = gyro_dps - given_dps
        gyro_dps = given_dps + off_dps / measured_over_true(scale, asymmetry, off_dps)
    known = np.isfinite(gyro_dps)
    if np.ptp(gyro_dps[known]) == 0:
        raise DataError(
            f"{source}: gyro_dps is {gyro_dps[known][0]:g} in every row; the gyro is stuck or was not logged. Check its cable."
        )
    gyro_dps, bridged = _bridged(log.t_s, gyro_dps)
    notes += bridged
    off = gyro_dps - median_filter(gyro_dps, 5, mode="nearest")
    limit = max(_SPIKE_STDS * STDS_PER_MAD * float(np.median(np.abs(off))), _SPIKE_DPS)
    spikes = (np.abs(off) > limit) & ~_turns(log, robot, off)
    if spikes.any():
        largest = float(np.abs(off).max())
        notes.append(Remark(Said.GYRO_SPIKES, {"count": int(spikes.sum()), "largest_dps": largest}))
        gyro_dps = np.where(spikes, gyro_dps - off, gyro_dps)
    return gyro_dps, notes


def _turns(log: DriveBlock, robot: Robot, off_dps: Floats) -> Bools:
    """Where a short excursion of the gyro may be a turn of the robot."""
    dt_s = np.diff(log.t_s, prepend=log.t_s[0])
    step_s = usual_step_s(log.t_s)
    possible = np.abs(off_dps) < _QUICKEST_DPS2 * step_s
    if log.speed_only:
        return np.asarray(possible)
    apart_m = np.nan_to_num(log.right_m) - np.nan_to_num(log.left_m)
    turn_dps = apart_m / robot.wheel_separation_m / np.where(dt_s > 0, dt_s, step_s) / DEG_TO_RAD
    spread_dps = maximum_filter(turn_dps, 3, mode="nearest") - minimum_filter(turn_dps, 3, mode="nearest")
    return np.asarray(possible & (spread_dps > _SHARED * np.abs(off_dps)))


def _bridged(t_s: Floats, gyro_dps: Floats) -> tuple[Floats, list[Remark]]:
    """The gyro with empty rows interpolated: a turn goes on where a sample is lost."""
    known = np.isfinite(gyro_dps)
    if known.all():
        return gyro_dps, []
    bridged = Remark(Said.GYRO_BRIDGED, {"count": int(np.count_nonzero(~known))})
    return np.interp(t_s, t_s[known], gyro_dps[known]), [bridged]


def measured_over_true(scale: float, asymmetry: float, rate_dps: Floats) -> Floats:
    """Measured over true turns of a gyro whose sides differ, by the sign of each rate."""
    return np.asarray(1.0 + scale + 0.5 * asymmetry * np.sign(rate_dps))


def usual_step_s(t_s: Floats) -> float:
    """Usual time between rows; one at the time of the row before is no step."""
    dt_s = np.diff(t_s)
    return float(np.median(dt_s[dt_s > 0]))


def tick_size(step_m: Floats) -> float:
    """Distance of a tick of one wheel: all its steps are whole multiples of it; 0 where they are not.

    Small steps tell it, by least squares: the file's rounding hides it in single ones.
    """
    moved = np.abs(step_m[np.abs(step_m) > 1e-9])
    if moved.size < 50:
        return 0.0
    values, counts = np.unique(np.round(moved, 7), return_counts=True)
    common = values[counts >= max(2, 1e-4 * moved.size)]
    if common.size < 2:
        return 0.0
    # A slow wheel shows single ticks, a fast one only that its steps are a tick apart.
    first = [float(common[0]) / part for part in (1, 2, 3)] + [float(np.min(np.diff(common)))]
    for tick in first:
        for reach in _MULTIPLES:
            near = moved[moved < (reach + 0.5) * tick]
            times = np.round(near / tick)
            if times.any():
                tick = float(times @ near / (times @ times))
        near = moved[moved < (_MULTIPLES[-1] + 0.5) * tick]
        off = np.abs(near / tick - np.round(near / tick))
        if (
            tick > _LEAST_TICK_M
            and near.size > _FEW_TICKS * moved.size
            and np.quantile(off, _ON_TICKS) < _OFF
        ):
            return tick
    return 0.0


@dataclass(frozen=True)
class Nodes:
    """Rows between which encoders and gyro are compared; arrays of shape (m,), one entry an interval.

    Attributes
    ----------
    rows : ndarray, shape (m + 1,)
        Row of each node; interval k lies between nodes k and k + 1.
    t_s : when the interval ends
    dt_s : how long it is
    resting : whether the robot stands in the whole interval
    broken : whether a gap lies in the interval, or a row of which a wheel says nothing
    """

    rows: Ints
    t_s: Floats
    dt_s: Floats
    resting: Bools
    broken: Bools

    def between(self, cumulated: Floats) -> Floats:
        """Change of a cumulated channel, one value a row, over each interval."""
        return np.asarray(np.diff(cumulated[self.rows], axis=0))


def nodes_of(series: DriveSeries, spacing_s: float = NODE_S) -> Nodes:
    """Nodes at most every `spacing_s` in motion and `REST_NODE_S` at rest, always on a row.

    A rest is three intervals where it is long enough for them: what a law says of it does not hang on one.
    """
    since = series.t_s - series.t_s[0]
    step_s = np.full(since.size, spacing_s)
    for rest in runs_of(np.flatnonzero(series.resting)):
        length_s = since[min(rest[-1] + 1, since.size - 1)] - since[rest[0]]
        step_s[rest] = np.clip(length_s / 3.0, spacing_s, max(REST_NODE_S, spacing_s))
    # Half a nanosecond keeps a row that lies on a border of the grid on one side of it.
    key = 2 * np.floor(since / step_s + 1e-9).astype(np.int64) + series.resting
    ends = np.flatnonzero(np.diff(key, append=-1) != 0)
    rows = np.unique(np.concatenate([[0], ends]))
    gaps = np.concatenate([[0], np.cumsum(series.gap | series.bridged)])
    return Nodes(
        rows,
        series.t_s[rows[1:]],
        np.diff(series.t_s[rows]),
        series.resting[rows[1:]] & series.resting[np.minimum(rows[:-1] + 1, series.t_s.size - 1)],
        (gaps[rows[1:] + 1] - gaps[rows[:-1] + 1]) > 0,
    )


def between_rows(at_s: Floats, t_s: Floats, cumulated: Floats) -> Floats:
    """A cumulated channel at other times, by a cubic in each row, and over a gap by a straight line; shape of `at_s`.

    On a straight line half way through a row of a slow log a heading lacks what the rate has changed over the row, an eighth
    of it times the row's time: far more than noise.
    """
    straight = np.asarray(np.interp(at_s, t_s, cumulated))
    steps_s = np.diff(t_s)
    if np.any(steps_s <= 0.0):
        return straight
    row = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, steps_s.size - 1)
    curved = CubicHermiteSpline(t_s, cumulated, np.gradient(cumulated, t_s))
    inside = (at_s >= t_s[0]) & (at_s <= t_s[-1]) & (steps_s[row] < GAP_STEPS * usual_step_s(t_s))
    return np.where(inside, curved(at_s), straight)


def averaged(t_s: Floats, cumulated: Floats, ahead_s: float, window_s: float) -> Floats:
    """A cumulated channel at ``t_s + ahead_s``, averaged over a window about that time; shape (n,)."""
    at = t_s + ahead_s
    if window_s <= 0.0:
        return between_rows(at, t_s, cumulated)
    # The integral of a channel that is linear between its rows, on a grid fine enough to be so itself.
    fine_s = min(window_s / 8.0, usual_step_s(t_s))
    grid = np.arange(t_s[0] - window_s, t_s[-1] + window_s + fine_s, fine_s)
    values = between_rows(grid, t_s, cumulated)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * fine_s)])
    half = 0.5 * window_s
    ends = np.clip(np.stack([at - half, at + half]), grid[0], grid[-1])
    upper, lower = np.interp(ends[1], grid, whole), np.interp(ends[0], grid, whole)
    return np.asarray((upper - lower) / window_s)


def rough_bias_dps(series: DriveSeries) -> float:
    """Bias of the gyro at its rests; of a drive without, by where the encoders' heading ends."""
    if series.resting.any():
        return float(np.mean(series.gyro_dps[series.resting]))
    if not series.differential:
        return 0.0
    return float(RAD_TO_DEG * (series.gyro_rad[-1] - series.encoder_rad[-1]) / series.duration_s)
