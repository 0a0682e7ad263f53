"""`diagnose` on drive logs: encoders against gyro, both against the truth, and what it means in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrocal.diagnosis.drive.beside_truth import beside_truth, told_from_nothing
from gyrocal.diagnosis.drive.checks import (
    Found,
    follows_in_mirror,
    missing_rows,
    uneven_clock,
    wrong_gyro,
    wrong_truth,
)
from gyrocal.diagnosis.drive.estimates import DriveEstimate, estimates_of
from gyrocal.diagnosis.drive.filed import filed
from gyrocal.diagnosis.drive.findings import (
    OfTruth,
    joint_estimate,
    named_effects,
    not_testable,
    of_truth,
    verdict,
)
from gyrocal.diagnosis.drive.heldout import improvements
from gyrocal.diagnosis.drive.improved import believed_bias, figures_of, improved_robot
from gyrocal.diagnosis.drive.laws import KINDS, is_motion
from gyrocal.diagnosis.drive.places import instants, left_out, places
from gyrocal.diagnosis.drive.reckoning import Complexes, Figures, Floats, laid_on, reckon
from gyrocal.diagnosis.drive.rests import refused_rest
from gyrocal.diagnosis.drive.search import YawAnswer, examine_yaw
from gyrocal.diagnosis.drive.series import DriveSeries, drive_series, rough_bias_dps
from gyrocal.diagnosis.drive.sides import evened, uneven_gyro
from gyrocal.diagnosis.drive.stamps import without_time
from gyrocal.diagnosis.drive.truth import BELIEVED, TruthAnswer
from gyrocal.diagnosis.drive.visible import truth_floor
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis, Estimate
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.drive import UNIT_OR_SIGN
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.files import finite
from gyrocal.records.robot import Robot

#: Part of a single log with truth from which figures are fitted to be shown on the rest.
_FITTED = 0.6


@dataclass(frozen=True)
class Shown:
    """Paths before and after on a part of a log, or on a log, that the figures were not fitted to.

    Attributes
    ----------
    log : name of another log; empty for this one
    from_share : part of the log, from its start, that is not in it
    before, after, truth : positions x + iy, m, laid on the truth where there is one; truth is NaN where it is not
    before_m, after_m : rms distance from the truth; NaN without truth
    apart_m : rms distance between the two paths
    truth_m : rms that the truth's own error would give a perfect path; NaN where it is not known
    seen_m : difference between before and after from which on this truth shows one (95 %); NaN likewise
    wrong : what is wrong with another log, and taken as if it were right
    """

    log: str
    from_share: float
    before: Complexes
    after: Complexes
    truth: Complexes
    before_m: float
    after_m: float
    apart_m: float
    truth_m: float = float("nan")
    seen_m: float = float("nan")
    wrong: tuple[Remark, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Entry of ``position_error``."""
        known = np.isfinite(self.before_m)
        return {
            "log": self.log or None,
            "from_share": self.from_share,
            "before_rms_m": self.before_m if known else None,
            "after_rms_m": self.after_m if known else None,
            "apart_rms_m": self.apart_m,
            "truth_rms_m": finite(self.truth_m),
            "least_seen_m": finite(self.seen_m),
        }


@dataclass(frozen=True)
class DriveDiagnosis:
    """The diagnosis, with what its pictures and its robot file need."""

    diagnosis: Diagnosis
    series: DriveSeries
    yaw: YawAnswer
    truth: TruthAnswer | None
    estimates: tuple[DriveEstimate, ...]
    robot: Robot | None
    shown: tuple[Shown, ...]


@dataclass(frozen=True)
class Examined:
    """One log, or a part of it, fitted."""

    series: DriveSeries
    yaw: YawAnswer
    truth: TruthAnswer | None
    parts: dict[str, OfTruth]
    figures: Figures
    checks: list[Found]
    notes: list[Remark]


def diagnose_drive(
    source: str,
    log: DriveBlock,
    robot: Robot,
    coefficients: Coefficients | None = None,
    others: Sequence[tuple[str, DriveBlock]] = (),
) -> DriveDiagnosis:
    """Diagnose a drive log, and show what it gained on other logs of the same robot or on the rest of this one.

    Parameters
    ----------
    coefficients : Coefficients, optional
        Calibrates the gyro first; the log must have its temperature then.
    others : sequence of (name, log)
        Drives that nothing is fitted to.

    Raises
    ------
    DataError
        The log is too short, does not move, or lacks a channel that was asked for.
    """
    found = examine(source, log, robot, coefficients)
    series, yaw, truth = found.series, found.yaw, found.truth
    effects = named_effects(series, yaw, truth, found.parts, found.checks)
    total, each = improvements(yaw, [e.effect for e in effects])
    effects = [replace(e, improvement=each.get(e.effect)) for e in effects]
    located = places(series, yaw, truth, effects)
    estimates = estimates_of(series, yaw, truth, found.parts, found.figures)
    better = improved_robot(series, yaw, truth, found.parts, found.figures)
    shown = _shown(found, better or robot, coefficients, others, log)
    diagnosis = Diagnosis(
        recording=source,
        verdict=verdict(effects, located),
        located=tuple(located),
        effects=tuple(effects),
        not_testable=not_testable(series, yaw, truth, [e.effect for e in effects]),
        sentences=(),
        noise=None,
        improvement=total,
        surface=coefficients,
        improved=None,
        rows=None,
        notes=(*series.notes, *found.notes, *_own_slip(robot, better)),
        drive={
            "estimates": [e.to_json() for e in estimates],
            "position_error": [s.to_json() for s in shown],
            "left_out": [x.to_json() for x in left_out(yaw)],
        },
    )
    return DriveDiagnosis(diagnosis, series, yaw, truth, estimates, better, tuple(shown))


def _own_slip(given: Robot, better: Robot | None) -> list[Remark]:
    """What a law of slip is in the improved file, whose track it widens: the estimates are of the track that was given."""
    if better is None or not (slip := better.parameters.slip).amplitude:
        return []
    separation_m = better.parameters.wheel_separation_m
    if separation_m == given.parameters.wheel_separation_m:
        return []
    facts = {"law": slip.law, "percent": 100.0 * slip.amplitude, "separation_m": separation_m}
    return [Remark(Said.SLIP_OF_OWN_TRACK, facts)]


def examine(source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None) -> Examined:
    """Fit one log, or a part of it.

    Raises
    ------
    DataError
        As `diagnose_drive`.
    """
    found = _examined(source, log, robot, coefficients, noisy_rests=True)
    noisy = any(isinstance(n, Remark) and n.said is Said.STANDS for n in found.series.notes)
    in_motion = any(n in KINDS and is_motion(n) for n in (*found.yaw.named, *found.parts))
    if not noisy or found.truth is None or not (in_motion or found.truth.one_size):
        return found
    # Where the gyro is not as such rests have it the vehicle may creep there, in even bends.
    without = _examined(source, log, robot, coefficients, noisy_rests=False)
    bias, std = joint_estimate(without.yaw, without.truth, "bias")
    if abs(bias - rough_bias_dps(found.series)) < BELIEVED * std:
        return found
    return replace(without, notes=[*without.notes, Remark(Said.CREEPS)])


def _examined(
    source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None, *, noisy_rests: bool
) -> Examined:
    prepared = drive_series(source, log, robot, coefficients, noisy_rests=noisy_rests)
    series, unit = wrong_gyro(prepared)
    series, notes = wrong_truth(series)
    yaw, truth = told_from_nothing(series, *beside_truth(series, examine_yaw(series)))
    uneven = uneven_gyro(truth)
    if uneven is not None and series.differential:
        yaw, truth = _beside_even(series, yaw, truth, uneven[0])
    checks = [f for f in (unit, missing_rows(log.t_s, int(without_time(log).sum()))) if f is not None]
    if truth is not None and truth.mirrored:
        seen = Remark(Said.TRUTH_MIRRORED)
        # Where no wheel tells which way the gyro turned, the wrong sign may be its.
        if series.differential:
            notes.append(seen)
        else:
            checks.append(Found(UNIT_OR_SIGN.id, Estimate.exact(-1.0, "1"), seen))
    parts = of_truth(yaw, truth)
    refused = refused_rest(log.t_s, log.left_m, log.right_m, log.gyro_dps, robot.static_s)
    notes += [*instants(yaw, truth), *([Remark(Said.NO_REST, {"why": refused})] if refused else [])]
    if truth is not None and truth.sensor:
        notes.append(Remark(Said.TRUTH_SENSOR, dict(truth.sensor)))
    clock = uneven_clock(series.t_s)
    return Examined(
        series,
        yaw,
        truth,
        parts,
        figures_of(series, yaw, parts, truth),
        checks,
        [*notes, *([clock] if clock else [])],
    )


def _beside_even(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None, asymmetry: float
) -> tuple[YawAnswer, TruthAnswer | None]:
    """With the wheels as they are beside a gyro of even sides, where the truth shows those of its own beside them, too."""
    of_wheels = examine_yaw(evened(series, yaw, asymmetry))
    found = told_from_nothing(series, *beside_truth(series, of_wheels))
    return (yaw, truth) if uneven_gyro(found[1]) is None else found


def _shown(
    found: Examined,
    better: Robot,
    coefficients: Coefficients | None,
    others: Sequence[tuple[str, DriveBlock]],
    log: DriveBlock,
) -> list[Shown]:
    """Before and after on what was not fitted: other logs, or the last part of this one; by the robot files as they are."""
    shown, robot = [], found.series.robot
    for name, other in others:
        series, wrong = _righted(name, other, robot, coefficients)
        before, after = (filed(series, one.parameters) for one in (robot, better))
        shown.append(replace(_compared(series, before, after, found.truth, name), wrong=wrong))
    if others or not found.series.has_truth or found.truth is None or found.truth.mirrored:
        return shown
    split = int(np.searchsorted(log.t_s, log.t_s[0] + _FITTED * (log.t_s[-1] - log.t_s[0])))
    try:
        part = examine(found.series.source, cut(log, slice(0, split)), robot, coefficients)
    except DataError:
        return shown
    by_part = improved_robot(part.series, part.yaw, part.truth, part.parts, part.figures) or robot
    before, after = (filed(found.series, one.parameters) for one in (robot, by_part))
    if not found.series.rested and not found.series.calibrated:
        # One switch-on: the bias is that of the first part.
        after = replace(after, bias_dps=believed_bias(part.yaw, part.truth))
    rest_of_it = _compared(found.series, before, after, part.truth, from_row=split)
    return [*shown, _beside_its_noise(rest_of_it, found.truth, found.series.t_s[split:])]


def _righted(
    name: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None
) -> tuple[DriveSeries, tuple[Remark, ...]]:
    """Another log with what is wrong with it put right, or left out, and that."""
    series, unit = wrong_gyro(drive_series(name, log, robot, coefficients))
    series, notes = wrong_truth(series)
    wrong = [*([unit.seen] if unit else []), *notes]
    if follows_in_mirror(series):
        nothing = np.full(series.t_s.size, np.nan)
        series = replace(series, truth_x_m=nothing, truth_y_m=nothing)
        wrong.append(Remark(Said.TRUTH_MIRRORED))
    return series, tuple(wrong)


def _beside_its_noise(shown: Shown, truth: TruthAnswer, t_s: Floats) -> Shown:
    """A comparison with what the noise of its truth lets be seen of it."""
    known = np.isfinite(shown.truth)
    if not np.isfinite(shown.before_m):
        return shown
    apart, rms_m = (shown.before - shown.after)[known], (shown.before_m, shown.after_m)
    truth_m, seen_m = truth_floor(truth, t_s[known], shown.truth[known], apart, rms_m)
    return replace(shown, truth_m=truth_m, seen_m=seen_m)


def _compared(
    series: DriveSeries,
    before: Figures,
    after: Figures,
    seen_by: TruthAnswer | None,
    name: str = "",
    from_row: int = 0,
) -> Shown:
    """Two paths of a log laid on its truth, as a sensor sees them of which another part or log has told where it is."""
    share = _FITTED if from_row else 0.0
    truth = (series.truth_x_m + 1j * series.truth_y_m)[from_row:]
    reckoned = [reckon(series, figures) for figures in (before, after)]
    paths = [(p.at_m if seen_by is None else seen_by.seen(p))[from_row:] for p in reckoned]
    if np.count_nonzero(np.isfinite(truth)) < 3:
        apart = float(np.sqrt(np.mean(np.abs(paths[0] - paths[1]) ** 2)))
        return Shown(name, share, paths[0], paths[1], truth, float("nan"), float("nan"), apart)
    (one, first), (two, second) = (laid_on(path, truth) for path in paths)
    apart = float(np.sqrt(np.mean(np.abs(one - two) ** 2)))
    return Shown(name, share, one, two, truth, first, second, apart)
