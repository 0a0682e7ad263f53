"""Drive logs through the runtime: the paper's four conditions, in one pass each and bounded memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.fusion import (
    Coefficients,
    Compensator,
    Counts,
    FilterNoise,
    InitialStd,
    Navigator,
    RobotParameters,
    StaticBias,
    Trajectory,
    static_bias,
)
from gyrocal.navigation.align import (
    Alignment,
    PositionErrors,
    align_positions,
    align_start,
    position_errors,
)
from gyrocal.navigation.observability import Observability, observability
from gyrocal.navigation.survey import Survey, check, survey
from gyrocal.records.drive import DriveBlock, cut, join
from gyrocal.records.robot import Robot

Floats = NDArray[np.float64]

#: Rows of a trajectory that are kept, at most; the filter itself takes every row.
KEPT_ROWS = 20_000
#: A robot that turned less than this in all has no direction.
_DIRECTION_DEG = 180.0
#: A calibration that covers less than the rest of the log is refused rather than extrapolated.
MAX_OUTSIDE_SHARE = 0.5


@dataclass(frozen=True)
class Condition:
    """One of the paper's four ways to navigate."""

    id: str
    label: str
    calibrated: bool
    filtering: bool


CONDITIONS = (
    Condition("uncalibrated", "no calibration, no filter", False, False),
    Condition("uncalibrated_filter", "no calibration, filter", False, True),
    Condition("calibrated", "calibration, no filter", True, False),
    Condition("calibrated_filter", "calibration, filter", True, True),
)


@dataclass(frozen=True)
class DriveSource:
    """A drive log that can be read more than once: `blocks()` starts from the beginning."""

    name: str
    blocks: Callable[[], Iterator[DriveBlock]]


@dataclass(frozen=True)
class Track:
    """A log navigated in one condition, at the kept rows.

    Attributes
    ----------
    x_m, y_m, heading_deg : ndarray, shape (k,)
        Start at the origin along +x (REP 103).
    states, std : ndarray, shape (k, 9)
        In the order of `gyrocal.fusion.STATES`; NaN without the filter.
    innovation_deg, innovation_sigma_deg : ndarray, shape (k,)
    covariance : ndarray, shape (9, 9)
        Of the state errors at the end.
    nis, nis_rows : float, int
        Mean of the squared normalised innovations over all rows (1 when consistent), and how many there were.
    alignment, errors : None where there is no truth
    """

    condition: Condition
    x_m: Floats
    y_m: Floats
    heading_deg: Floats
    states: Floats
    std: Floats
    innovation_deg: Floats
    innovation_sigma_deg: Floats
    covariance: Floats
    counts: Counts
    nis: float
    nis_rows: int
    bias: StaticBias | None
    alignment: Alignment | None = None
    errors: PositionErrors | None = None


@dataclass(frozen=True)
class LogReplay:
    """A log in every condition that is possible; `notes` says what is not, and why.

    `observability` says, for each condition with the filter, which constants this log can tell apart; `truth` holds x, y, heading at the kept rows, shape (k, 3), NaN where the log has none.
    """

    name: str
    direction: str
    survey: Survey
    t_s: Floats
    truth: Floats
    tracks: tuple[Track, ...]
    observability: Mapping[str, Observability]
    notes: tuple[str, ...]

    def track(self, condition_id: str) -> Track | None:
        """The track of a condition, None where that was not possible."""
        return next((t for t in self.tracks if t.condition.id == condition_id), None)


def parameters_of(robot: Robot) -> RobotParameters:
    """What the filter takes, from the robot file."""
    return RobotParameters(
        robot.wheel_separation_m, InitialStd(**robot.initial_std), FilterNoise(**robot.noise)
    )


def replay_log(
    source: DriveSource,
    robot: Robot,
    coefficients: Coefficients | None = None,
    *,
    method: str | None = None,
    returns: bool = False,
    power_on_t_s: float | None = None,
) -> LogReplay:
    """Replay one log in all conditions that it allows.

    Parameters
    ----------
    coefficients : Coefficients, optional
        None: only the conditions without calibration.
    method : {'start', 'positions'}, optional
        How truth and estimate are aligned; None: by the start pose where the truth has headings there.
    returns : bool
        The robot came back to its start: without truth, that alone tells the return error.
    power_on_t_s : float, optional
        When the gyro was switched on, on the log's clock; some calibrations need it.

    Raises
    ------
    DataError
        The log's channels cannot be right (`survey.check`), no rest where the robot file says there is one, or a
        calibration that this log leaves for most of its rows.
    """
    found = survey(source.name, source.blocks())
    check(found, robot.wheel_separation_m)
    notes = list(found.notes())
    usable = _calibration_usable(found, coefficients, notes)
    conditions = [c for c in CONDITIONS if usable or not c.calibrated]
    biases = _biases(source, robot, conditions, coefficients, power_on_t_s, notes)
    navigators = [
        Navigator(
            parameters_of(robot),
            coefficients if c.calibrated else None,
            filtering=c.filtering,
            static_bias_dps=b.bias_dps if (b := biases[c.calibrated]) else 0.0,
            power_on_t_s=power_on_t_s,
        )
        for c in conditions
    ]
    t_s, truth, recorders = _run(source, navigators, found)
    tracks = []
    for condition, navigator, recorder in zip(conditions, navigators, recorders, strict=True):
        track = recorder.track(condition, navigator, biases[condition.calibrated])
        _check_validity(found, navigator, notes)
        tracks.append(_compare(track, truth, found, method, returns))
    return LogReplay(
        source.name,
        _direction(tracks[0]),
        found,
        t_s,
        truth,
        tuple(tracks),
        _seen(robot, tracks),
        tuple(dict.fromkeys(notes)),
    )


def _calibration_usable(found: Survey, coefficients: Coefficients | None, notes: list[str]) -> bool:
    if coefficients is None:
        return False
    if found.temp_rows == 0:
        notes.append(
            "the log has no gyro temperature, so the calibration cannot be used: only the conditions without it"
        )
        return False
    return True


def _head(source: DriveSource, static_s: float, notes: list[str]) -> DriveBlock | None:
    """Rows of the rest at the start; None where the robot file says that there is none."""
    if static_s == 0.0:
        notes.append(
            "static_s = 0: the robot does not stand at the start, so no static bias was taken; its error is left to the filter"
        )
        return None
    parts: list[DriveBlock] = []
    for block in source.blocks():
        start_s = parts[0].t_s[0] if parts else block.t_s[0]
        rows = int(np.searchsorted(block.t_s, start_s + static_s, side="right"))
        parts.append(cut(block, slice(rows)))
        if rows < len(block):
            break
    return join(parts)


def _held(values: Floats) -> Floats:
    """The last finite value in the place of those that are not, as the navigator does with a missing temperature."""
    return values[np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), 0))]


def _biases(
    source: DriveSource,
    robot: Robot,
    conditions: list[Condition],
    coefficients: Coefficients | None,
    power_on_t_s: float | None,
    notes: list[str],
) -> dict[bool, StaticBias | None]:
    """Static bias of the raw rates (False) and of the compensated ones (True), as far as the conditions need them."""
    head = _head(source, robot.static_s, notes)
    biases: dict[bool, StaticBias | None] = {}
    for calibrated in sorted({c.calibrated for c in conditions}):
        if head is None:
            biases[calibrated] = None
            continue
        rate = head.gyro_dps
        if calibrated and coefficients is not None:
            since_s = None if power_on_t_s is None else head.t_s - power_on_t_s
            rate = Compensator(coefficients).correct(head.t_s, rate, _held(head.gyro_temp_c), since_s)
        try:
            biases[calibrated] = static_bias(head.t_s, head.left_m, head.right_m, rate, robot.static_s)
        except DataError as error:
            raise DataError(f"{source.name}: {error}") from error
    return biases


def _seen(robot: Robot, tracks: list[Track]) -> dict[str, Observability]:
    parameters = parameters_of(robot)
    return {
        t.condition.id: observability(
            parameters, t.covariance, t.heading_deg, estimate_scale=not t.condition.calibrated
        )
        for t in tracks
        if t.condition.filtering
    }


def _run(
    source: DriveSource, navigators: list[Navigator], found: Survey
) -> tuple[Floats, Floats, list[_Recorder]]:
    """All conditions over the log, block by block."""
    stride = math.ceil(found.rows / KEPT_ROWS)
    truth_stride = max(1, math.ceil(found.truth_rows / KEPT_ROWS))
    recorders = [_Recorder() for _ in navigators]
    kept: list[Floats] = []
    row = truth_row = 0
    for block in source.blocks():
        index = np.arange(row, row + len(block))
        with_truth = np.isfinite(block.truth_x_m + block.truth_y_m)
        order = truth_row + np.cumsum(with_truth) - 1
        wanted = (order % truth_stride == 0) | (order == found.truth_rows - 1)
        keep = (index % stride == 0) | (index == found.rows - 1) | (with_truth & wanted)
        columns = (block.t_s, block.truth_x_m, block.truth_y_m, block.truth_heading_deg)
        kept.append(np.stack(columns)[:, keep])
        for navigator, recorder in zip(navigators, recorders, strict=True):
            recorder.add(
                navigator.run(block.t_s, block.left_m, block.right_m, block.gyro_dps, block.gyro_temp_c),
                keep,
            )
        row += len(block)
        truth_row += int(np.count_nonzero(with_truth))
    t_s, *truth = np.concatenate(kept, axis=1)
    return t_s, np.stack(truth, axis=1), recorders


class _Recorder:
    """Kept rows of one condition, and sums over all rows."""

    def __init__(self) -> None:
        self._parts: list[list[Floats]] = []
        self._nis_sum, self._nis_rows = 0.0, 0

    def add(self, t: Trajectory, keep: NDArray[np.bool_]) -> None:
        arrays = (
            t.x_m,
            t.y_m,
            t.heading_deg,
            t.states,
            t.std,
            t.innovation_deg,
            t.innovation_sigma_deg,
        )
        self._parts.append([a[keep] for a in arrays])
        nis = (t.innovation_deg / t.innovation_sigma_deg) ** 2
        measured = np.isfinite(nis)
        self._nis_sum += float(nis[measured].sum())
        self._nis_rows += int(np.count_nonzero(measured))

    def track(self, condition: Condition, navigator: Navigator, bias: StaticBias | None) -> Track:
        """What was recorded."""
        x, y, heading, states, std, z, sigma = (
            np.concatenate(parts) for parts in zip(*self._parts, strict=True)
        )
        nis = self._nis_sum / self._nis_rows if self._nis_rows else math.nan
        return Track(
            condition,
            x,
            y,
            heading,
            states,
            std,
            z,
            sigma,
            navigator.covariance,
            navigator.counts,
            nis,
            self._nis_rows,
            bias,
        )


def _check_validity(found: Survey, navigator: Navigator, notes: list[str]) -> None:
    coefficients, counts = navigator.coefficients, navigator.counts
    if coefficients is None:
        return
    outside = max(counts.outside_temperature, counts.outside_rate)
    if outside == 0:
        return
    valid = coefficients.valid
    covers = (
        f"{valid.rate_dps[0]:g}..{valid.rate_dps[1]:g} deg/s, {valid.temp_c[0]:g}..{valid.temp_c[1]:g} deg C"
    )
    if outside > MAX_OUTSIDE_SHARE * found.rows:
        msg = f"{found.source}: {outside} of {found.rows} rows lie outside what the calibration covers ({covers}); the log spans {found.gyro_dps[0]:.3g}..{found.gyro_dps[1]:.3g} deg/s, {found.temp_c[0]:.3g}..{found.temp_c[1]:.3g} deg C. Calibrate over that range, or replay without --coefficients."
        raise DataError(msg)
    notes.append(
        f"{outside} rows lie outside what the calibration covers ({covers}); the surface is extrapolated there"
    )


def _compare(track: Track, truth: Floats, found: Survey, method: str | None, returns: bool) -> Track:
    """The track with its alignment and errors, where there is truth or a return to compare with."""
    rows = np.flatnonzero(np.isfinite(truth[:, 0] + truth[:, 1]))
    estimate = np.stack([track.x_m, track.y_m, track.heading_deg], axis=1)
    if rows.size < 3:
        if not returns:
            return track
        end_m = math.hypot(track.x_m[-1] - track.x_m[0], track.y_m[-1] - track.y_m[0])
        return replace(track, errors=PositionErrors(0, math.nan, math.nan, end_m, end_m))
    start_known = bool(np.isfinite(truth[rows[0], 2]))
    if method == "start" and not start_known:
        msg = f"{found.source}: the truth has no heading at its first row, so the start pose is unknown; align by positions."
        raise DataError(msg)
    if method == "start" or (method is None and start_known):
        alignment = align_start(estimate[rows[0]], truth[rows[0]])
    else:
        alignment = align_positions(estimate[rows, :2], truth[rows, :2])
    aligned = np.stack(alignment.apply(track.x_m[rows], track.y_m[rows]), axis=1)
    errors = position_errors(aligned, truth[rows, :2], found.distance_m)
    return replace(track, alignment=alignment, errors=errors)


def _direction(track: Track) -> str:
    turned_deg = float(track.heading_deg[-1] - track.heading_deg[0])
    if abs(turned_deg) < _DIRECTION_DEG:
        return "mixed"
    return "ccw" if turned_deg > 0 else "cw"
