"""Drive logs through the runtime: the paper's four conditions, in one pass each and bounded memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.fusion import (
    Coefficients,
    Navigator,
)
from gyrocal.navigation.align import (
    PositionErrors,
    align_headings,
    align_positions,
    align_start,
    heading_errors,
    position_errors,
)
from gyrocal.navigation.channels import check
from gyrocal.navigation.empty_cells import LONGEST_S, bridged
from gyrocal.navigation.equip import DriveSource, aligned, equip
from gyrocal.navigation.fixes import no_fixes
from gyrocal.navigation.judge import Judgement, judge, left_to_gyro
from gyrocal.navigation.lost_ways import FEWEST, lost_ways
from gyrocal.navigation.observability import Observability, observability
from gyrocal.navigation.sanity import truth_fault, truth_part_fault, turned_deg
from gyrocal.navigation.survey import Survey, survey
from gyrocal.navigation.track import CONDITIONS, Condition, Recorder, Track
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot
from gyrocal.units import plural

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Rows of a trajectory that are kept, at most; the filter itself takes every row.
KEPT_ROWS = 20_000
#: A robot that turned less than this in all has no direction.
_DIRECTION_DEG = 180.0
#: A calibration that covers less than the rest of the log is refused rather than extrapolated.
MAX_OUTSIDE_SHARE = 0.5


@dataclass(frozen=True)
class LogReplay:
    """A log in every condition that is possible; `notes` says what is not, and why.

    `observability` says, for each condition with the filter, which constants this log can tell apart, and `judgements` whether the filter describes the log; `truth` holds x, y, heading at the kept rows, shape (k, 3), NaN where the log has none.
    """

    name: str
    direction: str
    survey: Survey
    t_s: Floats
    truth: Floats
    tracks: tuple[Track, ...]
    observability: Mapping[str, Observability]
    notes: tuple[str, ...]
    judgements: Mapping[str, Judgement]
    kind: str

    def track(self, condition_id: str) -> Track | None:
        """The track of a condition, None where that was not possible."""
        return next((t for t in self.tracks if t.condition.id == condition_id), None)


def replay_log(
    source: DriveSource,
    robot: Robot,
    coefficients: Coefficients | None = None,
    *,
    kind: str = "model",
    method: str | None = None,
    returns: bool = False,
    power_on_t_s: float | None = None,
) -> LogReplay:
    """Replay one log in all conditions that it allows.

    Parameters
    ----------
    coefficients : Coefficients, optional
        None: only the conditions without calibration.
    kind : {'model', 'paper'}
        Which filter (`Navigator`), and with the model the bias of every rest without it too. Noise that the robot
        file does not give is estimated on the log for the model.
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
    source, found, added = _completed(source)
    notes = [*check(found, robot.wheel_separation_m), *found.notes(), *added]
    conditions = _possible(found, robot, coefficients, notes)
    equipped = {
        c.calibrated: equip(
            source,
            robot,
            kind,
            coefficients if c.calibrated else None,
            power_on_t_s,
            sides=not found.speed_only,
        )
        for c in conditions
    }
    navigators = [equipped[c.calibrated].navigator(filtering=c.filtering) for c in conditions]
    t_s, truth, recorders = _run(source, robot, navigators, found)
    tracks = {}
    for condition, navigator, recorder in zip(conditions, navigators, recorders, strict=True):
        tracks[condition] = recorder.track(condition, equipped[condition.calibrated].rest)
        _check_validity(found, navigator, notes)
    truth = _mended(truth, next(iter(tracks.values())), t_s, notes)
    judgements = _judge(tracks, kind)
    _check_truth(found, next(iter(tracks.values())), t_s, truth)
    compared = tuple(_compare(track, truth, found, method, returns) for track in tracks.values())
    notes += [leap for track in compared if (leap := _leap_said(track, t_s, truth))]
    said, seen = tuple(dict.fromkeys(notes)), _seen(compared)
    direction = _direction(compared[0])
    return LogReplay(source.name, direction, found, t_s, truth, compared, seen, said, judgements, kind)


def _completed(source: DriveSource) -> tuple[DriveSource, Survey, list[str]]:
    """The log with what it lacks in few rows, what it holds then, and what is said of it."""
    found = survey(source.name, source.blocks())
    lost = lost_ways(source.blocks(), found.usual_dt_s) if found.leaps >= FEWEST else None
    if lost is None and not found.bad_gyro + found.bad_encoder:
        return source, found, []

    def blocks() -> Iterator[DriveBlock]:
        return bridged(source.blocks() if lost is None else lost.completed(source.blocks()))

    whole = survey(source.name, blocks())
    said = [str(lost)] if lost is not None else []
    filled = (found.bad_gyro - whole.bad_gyro, found.bad_encoder - whole.bad_encoder)
    if any(filled):
        gyro, wheels = (f"{n} {plural(n, '[row|rows]')}" for n in filled)
        said.append(
            f"empty cells are bridged by those beside them, of the gyro in {gyro} and of the wheels in {wheels}; stretches over {LONGEST_S:g} s stay empty"
        )
    # What is said of the log's own cells, and held against them, is of those alone.
    own = replace(
        whole,
        bad_gyro=found.bad_gyro,
        bad_encoder=found.bad_encoder,
        longest_extreme=found.longest_extreme,
        held_s=found.held_s,
    )
    return replace(source, blocks=blocks), own, said


def _mended(truth: Floats, track: Track, t_s: Floats, notes: list[str]) -> Floats:
    """The truth without fixes that cannot be, and with headings along the course of its positions; both go into the notes."""
    way_m = np.cumsum(np.hypot(np.diff(track.x_m, prepend=0.0), np.diff(track.y_m, prepend=0.0)))
    none, said = no_fixes(t_s, truth[:, 0], truth[:, 1], way_m)
    notes.extend(said)
    truth = np.where(none[:, None], np.nan, truth)
    off_deg = turned_deg(track.pose, truth)
    if off_deg:
        notes.append(
            f"the truth's heading is {abs(off_deg):.0f} deg to the {'left' if off_deg > 0.0 else 'right'} of the course of its own positions, "
            "all along: it is turned back by that (state it in a mapping with --columns, or turn the sensor)"
        )
    return np.asarray(truth - np.array([0.0, 0.0, off_deg]))


def _leap_said(track: Track, t_s: Floats, truth: Floats) -> str | None:
    """That a rest took back a path which began without a bias, and the error before, where the error told at the end is less than the leap."""
    leap, known = track.leap, np.flatnonzero(np.isfinite(truth[:, 0] + truth[:, 1]))
    if (
        leap is None
        or track.bias
        or not track.alignment
        or not track.errors
        or leap.way_m < track.errors.end_m
    ):
        return None
    k = known[min(int(np.searchsorted(t_s[known], leap.t_s)), known.size - 1)]
    x, y = track.alignment.apply(np.array([leap.x_m, track.x_m[k]]), np.array([leap.y_m, track.y_m[k]]))
    before, after = np.hypot(truth[k, 0] - x, truth[k, 1] - y)
    return (
        f"{track.condition.label}: at t_s = {leap.t_s:.1f} the robot stands, which tells the gyro's bias, and the path before is taken back by it: the pose leaps by "
        f"{leap.way_m:.3g} m and {leap.turn_deg:.3g} deg. Its error there is {before:.3g} m before that, as a robot on its way has it, and {after:.3g} m after"
    )


def _possible(
    found: Survey, robot: Robot, coefficients: Coefficients | None, notes: list[str]
) -> list[Condition]:
    """The conditions that log and calibration allow; what is missing goes into the notes."""
    if robot.static_s == 0.0:
        left_to = (
            "nothing but a rest on the way takes its error off"
            if found.speed_only
            else "its error is left to the filter, and without it to the rests on the way"
        )
        notes.append(
            f"static_s = 0: the robot does not stand at the start, so no static bias was taken; {left_to}"
        )
    if coefficients is not None and found.temp_rows == 0:
        notes.append(
            "the log has no gyro temperature, so the calibration cannot be used: only the conditions without it"
        )
    usable = coefficients is not None and found.temp_rows > 0
    if found.speed_only:
        notes.append(
            "the log has one speed and no sides, which tell nothing of turns: the heading is the gyro's alone, without the filter"
        )
    return [c for c in CONDITIONS if (usable or not c.calibrated) and not (found.speed_only and c.filtering)]


def _judge(tracks: dict[Condition, Track], kind: str) -> dict[str, Judgement]:
    """Judge every filter by the gyro alone; the model's heading is left to the gyro where that is better."""
    found = {}
    for condition, track in tracks.items():
        if condition.filtering:
            alone = next(
                t for c, t in tracks.items() if c.calibrated == condition.calibrated and not c.filtering
            )
            found[condition.id] = judge(alone, track)
            if kind == "model" and found[condition.id].left_to_gyro:
                tracks[condition] = left_to_gyro(alone, track)
    return found


def _seen(tracks: tuple[Track, ...]) -> dict[str, Observability]:
    return {
        t.condition.id: observability(t.covariance_before, t.covariance, t.heading_deg)
        for t in tracks
        if t.condition.filtering
    }


def _run(
    source: DriveSource, robot: Robot, navigators: list[Navigator], found: Survey
) -> tuple[Floats, Floats, list[Recorder]]:
    """All conditions over the log, block by block."""
    every, positions, headings = (_Thinned(n) for n in (found.rows, found.truth_rows, found.truth_headings))
    recorders = [Recorder(navigator) for navigator in navigators]
    kept: list[Floats] = []
    for rows, truth in aligned(source, robot.parameters):
        keep = every.of(np.ones(rows.t_s.size, dtype=np.bool_))
        keep = keep | positions.of(np.isfinite(truth[:, 0] + truth[:, 1]))
        keep = keep | headings.of(np.isfinite(truth[:, 2]))
        kept.append(np.column_stack([rows.t_s, truth])[keep])
        for navigator, recorder in zip(navigators, recorders, strict=True):
            recorder.add(
                navigator.run(
                    rows.t_s, rows.left_m, rows.right_m, rows.gyro_dps, rows.temp_c, rows.smooth_dps
                ),
                keep,
            )
    t_s, *known = np.concatenate(kept).T
    return t_s, np.stack(known, axis=1), recorders


class _Thinned:
    """Of rows of one kind, which come block by block, at most `KEPT_ROWS` at even spacing, and the last."""

    def __init__(self, rows: int) -> None:
        self._rows, self._seen = rows, 0

    def of(self, known: Bools) -> Bools:
        """Which rows of the next block are kept; `known` are those of the kind."""
        order = self._seen + np.cumsum(known) - 1
        self._seen += int(np.count_nonzero(known))
        spacing = max(1, math.ceil(self._rows / KEPT_ROWS))
        return np.asarray(known & ((order % spacing == 0) | (order == self._rows - 1)))


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
    """The track with its alignment and errors of positions and headings, as far as there is truth or a return."""
    track = _compare_positions(track, truth, found, method, returns)
    rows = np.flatnonzero(np.isfinite(truth[:, 2]))
    if rows.size < 3:
        return track
    own, told = track.heading_deg[rows], truth[rows, 2]
    alignment = track.alignment or align_headings(own, told)
    return replace(
        track, alignment=alignment, heading_errors=heading_errors(own + alignment.rotation_deg, told)
    )


def _compare_positions(
    track: Track, truth: Floats, found: Survey, method: str | None, returns: bool
) -> Track:
    rows = np.flatnonzero(np.isfinite(truth[:, 0] + truth[:, 1]))
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
        alignment = align_start(track.pose[rows[0]], truth[rows[0]])
    else:
        alignment = align_positions(track.pose[rows, :2], truth[rows, :2])
    aligned = np.stack(alignment.apply(track.x_m[rows], track.y_m[rows]), axis=1)
    errors = position_errors(aligned, truth[rows, :2], found.distance_m)
    return replace(track, alignment=alignment, errors=errors)


def _check_truth(found: Survey, track: Track, t_s: Floats, truth: Floats) -> None:
    fault = truth_part_fault(t_s, track.pose, truth) or truth_fault(track.pose, truth)
    if fault:
        raise DataError(f"{found.source}: {fault}")


def _direction(track: Track) -> str:
    turned_deg = float(track.heading_deg[-1] - track.heading_deg[0])
    if abs(turned_deg) < _DIRECTION_DEG:
        return "mixed"
    return "ccw" if turned_deg > 0 else "cw"
