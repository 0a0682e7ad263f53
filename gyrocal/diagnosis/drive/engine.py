"""`diagnose` on drive logs: encoders against gyro, both against the truth, and what it means in metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from gyrocal.diagnosis.drive.checks import Found, missing_rows, uneven_clock, wrong_gyro, wrong_truth
from gyrocal.diagnosis.drive.filed import filed
from gyrocal.diagnosis.drive.findings import (
    OUT,
    OfTruth,
    joint_estimate,
    named_effects,
    not_testable,
    of_truth,
    spinning,
    told_estimate,
    verdict,
)
from gyrocal.diagnosis.drive.heldout import improvements
from gyrocal.diagnosis.drive.improved import (
    DriveEstimate,
    believed_bias,
    estimates_of,
    figures_of,
    improved_robot,
)
from gyrocal.diagnosis.drive.jumps import chance, instant_of_p
from gyrocal.diagnosis.drive.laws import AT_ONCE, KINDS
from gyrocal.diagnosis.drive.motions import AS_LIKELY, settling_beats
from gyrocal.diagnosis.drive.nameless import STRANGER_P
from gyrocal.diagnosis.drive.path_laid import ALONE, SCALES
from gyrocal.diagnosis.drive.places import instants, left_out, places
from gyrocal.diagnosis.drive.reckoning import Complexes, Figures, Floats, laid_on, reckon
from gyrocal.diagnosis.drive.search import GAIN, YawAnswer, examine_yaw
from gyrocal.diagnosis.drive.series import DriveSeries, drive_series
from gyrocal.diagnosis.drive.sides import sides_of
from gyrocal.diagnosis.drive.truth import TruthAnswer, ask_truth
from gyrocal.diagnosis.drive.visible import truth_floor
from gyrocal.diagnosis.intervals import RISE_INSTANT_95
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis, Estimate
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.drive import GYRO_SCALE, UNIT_OR_SIGN
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.files import finite
from gyrocal.records.robot import Robot
from gyrocal.units import NORMAL_95

#: Laws of the bias that a truth may show where the encoders alone do not.
_BY_TRUTH = ("slope", "step", AT_ONCE)
#: Instants at which a truth is asked for a jump of the bias first, and how often three times as closely about the likeliest.
_INSTANTS, _CLOSER = 8, 3
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
        not_testable=not_testable(series, yaw, truth),
        sentences=(),
        noise=None,
        improvement=total,
        surface=coefficients,
        improved=None,
        rows=None,
        notes=(*series.notes, *found.notes),
        drive={
            "estimates": [e.to_json() for e in estimates],
            "position_error": [s.to_json() for s in shown],
            "left_out": [x.to_json() for x in left_out(yaw)],
        },
    )
    return DriveDiagnosis(diagnosis, series, yaw, truth, estimates, better, tuple(shown))


def examine(source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None) -> Examined:
    """Fit one log, or a part of it.

    Raises
    ------
    DataError
        As `diagnose_drive`.
    """
    series, unit = wrong_gyro(drive_series(source, log, robot, coefficients))
    series, notes = wrong_truth(series)
    yaw, truth = _told_from_nothing(series, *_beside_truth(series, examine_yaw(series)))
    checks = [f for f in (unit, missing_rows(log.t_s)) if f is not None]
    if truth is not None and truth.mirrored:
        seen = Remark(Said.TRUTH_MIRRORED)
        # Where no wheel tells which way the gyro turned, the wrong sign may be its.
        if series.differential:
            notes.append(seen)
        else:
            checks.append(Found(UNIT_OR_SIGN.id, Estimate.exact(-1.0, "1"), seen))
    parts = of_truth(yaw, truth)
    notes += instants(yaw, truth)
    clock = uneven_clock(log.t_s)
    return Examined(
        series,
        yaw,
        truth,
        parts,
        figures_of(series, yaw, parts, truth),
        checks,
        [*notes, *([clock] if clock else [])],
    )


def _beside_truth(series: DriveSeries, yaw: YawAnswer) -> tuple[YawAnswer, TruthAnswer | None]:
    """Laws of the heading difference with those that the truth, where there is one, denies or adds, and what it says."""
    yaw, truth = _undenied(series, yaw, _asked(series, yaw))
    if "spinning" in yaw.chosen and spinning(yaw, truth) is None:
        # No wheel goes less far while it drives, nor spins in turns alone.
        yaw = yaw.without(["spinning"], "acceleration")
    if truth is None or truth.mirrored:
        return yaw, truth
    yaw, truth = _jump_at_its_instant(series, yaw, truth)
    # First what the next drive has, too: a jump bends a path much as any of these does.
    yaw, truth = _with_laws(series, yaw, truth)
    jumping, told = _with_jump(series, yaw, truth)
    if jumping is not yaw:
        yaw, truth = _with_laws(series, jumping, told)
    if "jump" in yaw.chosen:
        truth = _scales_beside_the_course(series, yaw, truth)
    return _wheels_beside_structure(_wheels_beside(yaw, truth), truth), truth


def _told_from_nothing(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> tuple[YawAnswer, TruthAnswer | None]:
    """Without names of laws whose 95 % interval holds zero, the least sure first: encoders and truth together may say less."""
    while True:
        sure = {n: told_estimate(yaw, truth, n) for n in yaw.named if n != "wheel_cos"}
        stds = {n: abs(value) / std for n, (value, std) in sure.items() if std > 0.0}
        least = min(stds, key=lambda n: stds[n], default="")
        if not least or stds[least] >= NORMAL_95:
            return yaw, truth
        yaw = yaw.gaining({**yaw.named, least: 0.0})
        truth = truth and (_asked(series, yaw, truth) or truth)


def _scales_beside_the_course(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> TruthAnswer:
    """With scales that hold beside a bias of each part of the drive, of which one jump need not be the whole course."""
    freed = _asked(series, yaw, truth, bias_changes=True)
    if freed is None:
        return truth
    of_scales = {n: freed.values[n] for n in SCALES}
    stds = {n: freed.stds[n] for n in SCALES}
    return replace(
        truth,
        values={**truth.values, **of_scales},
        stds={**truth.stds, **stds},
        covariance=freed.covariance,
    )


def _with_laws(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> tuple[YawAnswer, TruthAnswer]:
    """With laws of the bias that encoders and truth show together; beside one speed the truth is asked for them anyway."""
    if not series.differential:
        return yaw, truth
    while True:
        tried = [
            (_with_truth(series, yaw, truth, n), n)
            for n in _BY_TRUTH
            if n in yaw.laws and n not in yaw.chosen and n not in yaw.uneven
        ]
        (gain, found), name = max(tried, key=lambda one: one[0][0], default=((0.0, None), ""))
        if found is None or gain < GAIN:
            return yaw, truth
        for other in (n for n in yaw.named if KINDS[n].figure.startswith("bias") and n != "jump"):
            # What was taken first may have stood for this one.
            less = yaw.less([other]).with_law(name, gain)
            alone = _asked(series, less, truth)
            if alone is not None and _with_truth(series, less, alone, other)[0] < GAIN:
                return less, alone
        yaw, truth = yaw.with_law(name, gain), found


def _wheels_beside(yaw: YawAnswer, truth: TruthAnswer) -> YawAnswer:
    """With what wheels that differ gain beside the bias that the truth shows: they may have stood for it."""
    if "asymmetry" not in yaw.named:
        return yaw
    value, std = joint_estimate(yaw, truth, "asymmetry")
    return yaw.gaining({**yaw.named, "asymmetry": (value / std) ** 2})


def _wheels_beside_structure(yaw: YawAnswer, truth: TruthAnswer) -> YawAnswer:
    """With what laws of the wheels gain beside what the truth shows the surest that has no name.

    An error of the gyro that is none of the catalogue, as of turns one way, is in the heading difference too, and looks
    like wheels there.
    """
    surest = min(truth.odd, key=lambda c: truth.odd[c], default="")
    if not surest or truth.odd[surest] >= STRANGER_P:
        return yaw
    beside = [*yaw.chosen, *(n for n in yaw.gram.names if n.startswith(f"{surest}:"))]
    of_wheels = [n for n in yaw.named if n in ("track", "asymmetry") or KINDS[n].group == "slip"]
    gains = {n: yaw.told.added([b for b in beside if b != n], [n]) for n in of_wheels}
    return yaw.gaining({n: gains.get(n, gain) for n, gain in yaw.named.items()})


def _with_jump(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer) -> tuple[YawAnswer, TruthAnswer]:
    """With a jump of the bias that the truth shows where the encoders do not, where it is the time that is oddest.

    A path that such a jump has bent is laid anew for each instant: small errors about a wrong path would not tell it.
    """
    surest = min(truth.odd.values(), default=1.0)
    # Wheels that change bend the path in the mean of both.
    if "jump" in yaw.chosen or yaw.changed or surest >= STRANGER_P or truth.odd["time"] > surest:
        return yaw, truth
    whole_s = float(series.t_s[0]), float(series.t_s[-1])
    best_s, span_s = _likeliest_instant(series, yaw, truth, whole_s)
    wider = yaw.with_jump(instant_of_p(best_s, span_s, truth.odd["time"]))
    found = _asked(series, wider, truth)
    if found is None or found.odd["time"] < truth.odd["time"]:
        return yaw, truth
    # Time may be odd by something else, of which the best instant explains as little as any.
    value, std = joint_estimate(wider, found, "jump")
    return (wider, found) if chance((value / std) ** 2) < STRANGER_P else (yaw, truth)


def _jump_at_its_instant(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer
) -> tuple[YawAnswer, TruthAnswer]:
    """With the jump that the encoders show at the instant, of those they leave open, that is the truth's.

    A path that jumps some seconds early is bent by degrees, and the truth would have jump and scales be others for it.
    """
    if "jump" not in yaw.chosen:
        return yaw, truth
    shape, without = yaw.laws["jump"].shape, yaw.less(["jump"])
    best_s, span_s = _likeliest_instant(series, without, truth, (shape["earliest_s"], shape["latest_s"]))
    jumping = without.with_jump(instant_of_p(best_s, span_s, yaw.strangers["time"][2]))
    found = _asked(series, jumping, truth)
    return (yaw, truth) if found is None or found.loss >= truth.loss else (jumping, found)


def _likeliest_instant(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, within_s: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """When a jump of the bias fits the truth best, and the 95 % interval of that, s."""
    losses: dict[float, float] = {}

    def look(instants_s: Iterable[float]) -> float:
        for at_s in instants_s:
            losses[at_s] = _loss_with_jump(series, yaw, truth, at_s)
        return min(losses, key=lambda at_s: losses[at_s])

    step_s = (within_s[1] - within_s[0]) / _INSTANTS
    best_s = look(within_s[0] + step_s * (k + 0.5) for k in range(_INSTANTS))
    for _ in range(_CLOSER):
        step_s /= 3.0
        best_s = look([best_s + step_s * k for k in (-2, -1, 1, 2)])
    likely_s = [at_s for at_s, loss in losses.items() if loss < losses[best_s] + RISE_INSTANT_95]
    # The next instant that was looked at is outside.
    return best_s, (max(min(likely_s) - step_s, within_s[0]), min(max(likely_s) + step_s, within_s[1]))


def _loss_with_jump(series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, at_s: float) -> float:
    """Loss of the path with a bias that jumps at an instant; infinite where the log says nothing of such a jump."""
    jumping = yaw.jumping(at_s)
    told = series.t_s[0] < at_s < series.t_s[-1] and jumping.estimate("jump")[1] > 0.0
    found = _asked(series, jumping, truth) if told else None
    return np.inf if found is None else found.loss


def _taken_out(series: DriveSeries, yaw: YawAnswer) -> Figures:
    """What the encoders know, before the truth is asked."""
    return replace(figures_of(series, yaw, {}, None), bias_from_rest=False)


def _asked(
    series: DriveSeries, yaw: YawAnswer, near: TruthAnswer | None = None, *, bias_changes: bool = False
) -> TruthAnswer | None:
    laws = yaw.bias_laws
    groups = {KINDS[n].group or n for n in laws.names}
    alone = [] if series.differential else [n for n in ALONE if (KINDS[n].group or n) not in groups]
    figures, noise = _taken_out(series, yaw), yaw.model.noise
    # Be it the gyro's or the wheels'.
    uneven = sides_of(yaw).sure
    return ask_truth(
        series, figures, laws, noise, alone, near, bias_changes=bias_changes, uneven_turns=uneven
    )


def _undenied(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer | None
) -> tuple[YawAnswer, TruthAnswer | None]:
    """Without laws of the motion that the truth speaks against.

    What a wheel does can look like a bias that comes with the motion. The path by the gyro that is laid on the truth has no
    wheel in its headings. Without a truth, a wheel that does something over its speed is likelier to have done this, too.
    """
    of_motion = [n for n in yaw.named if KINDS[n].group == "motion"]
    if not of_motion:
        return yaw, truth
    other = yaw.without(of_motion, "speed")
    if truth is None or truth.mirrored:
        return (other if "speed" in yaw.odd else yaw), truth
    instead = _asked(series, other)
    return (other, instead) if instead is not None and _denied(truth, instead) else (yaw, truth)


def _denied(truth: TruthAnswer, without: TruthAnswer) -> bool:
    """Whether a truth speaks against a law: it fits the path better without."""
    return bool(truth.loss - without.loss > 2.0 * np.log(OUT))


def _with_truth(
    series: DriveSeries, yaw: YawAnswer, truth: TruthAnswer, name: str
) -> tuple[float, TruthAnswer | None]:
    """What another law of the bias gains by encoders and truth together, and what the truth says beside it.

    Structure without a name has to be explained by it, and better than by itself. A scale of the gyro that is less sure
    beside it than the law is beside the scale may have stood for it, as on a path that turns one way.
    """
    if KINDS[name].group and any(KINDS[n].group == KINDS[name].group for n in yaw.chosen):
        return 0.0, None
    if KINDS[name].group == "motion" and settling_beats(yaw.told, yaw.fitted, name, GAIN):
        return 0.0, None
    wider = yaw.with_law(name, 0.0)
    found = _asked(series, wider, truth)
    if found is None or min(found.odd.values(), default=1.0) < STRANGER_P or _denied(found, truth):
        return 0.0, None
    (both, both_std), (own, own_std) = joint_estimate(wider, found, name), wider.estimate(name)
    gain = yaw.told.added(yaw.chosen, [name]) + (both / both_std) ** 2 - (own / own_std) ** 2
    # On loops a scale of the turns one way looks like one of all turns and a bias in motion that happen to fit each other.
    if truth.one_way.get("", 0.0) > AS_LIKELY and found.one_way.get(name, -np.inf) > -AS_LIKELY:
        return 0.0, None
    beside = found.told(GYRO_SCALE.id) ** 2
    if truth.believed(GYRO_SCALE.id) and gain > max(beside, 2.0 * np.log(OUT)):
        gain += truth.told(GYRO_SCALE.id) ** 2 - beside
    # Encoders whose difference to the gyro changes with time, as of a wheel that grows, would have it taken for a bias.
    structure = min(*truth.odd.values(), yaw.strangers["time"][2], 1.0)
    better = structure >= STRANGER_P or stats.chi2.sf(gain, 1) < structure
    return (gain, found) if better else (0.0, None)


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
        series = wrong_truth(wrong_gyro(drive_series(name, other, robot, coefficients))[0])[0]
        before, after = (filed(series, one.parameters) for one in (robot, better))
        shown.append(_compared(series, before, after, name))
    if others or not found.series.has_truth or found.truth is None or found.truth.mirrored:
        return shown
    split = int(np.searchsorted(log.t_s, log.t_s[0] + _FITTED * (log.t_s[-1] - log.t_s[0])))
    try:
        part = examine(found.series.source, cut(log, slice(0, split)), robot, coefficients)
    except DataError:
        return shown
    by_part = improved_robot(part.series, part.yaw, part.truth, part.parts, part.figures) or robot
    before, after = (filed(found.series, one.parameters) for one in (robot, by_part))
    if robot.static_s == 0 and not found.series.calibrated:
        # One switch-on: the bias is that of the first part.
        after = replace(after, bias_dps=believed_bias(part.yaw, part.truth))
    rest_of_it = _compared(found.series, before, after, from_row=split)
    return [*shown, _beside_its_noise(rest_of_it, found.truth, found.series.t_s[split:])]


def _beside_its_noise(shown: Shown, truth: TruthAnswer, t_s: Floats) -> Shown:
    """A comparison with what the noise of its truth lets be seen of it."""
    known = np.isfinite(shown.truth)
    if not np.isfinite(shown.before_m):
        return shown
    apart, rms_m = (shown.before - shown.after)[known], (shown.before_m, shown.after_m)
    truth_m, seen_m = truth_floor(truth, t_s[known], shown.truth[known], apart, rms_m)
    return replace(shown, truth_m=truth_m, seen_m=seen_m)


def _compared(
    series: DriveSeries, before: Figures, after: Figures, name: str = "", from_row: int = 0
) -> Shown:
    share = _FITTED if from_row else 0.0
    truth = (series.truth_x_m + 1j * series.truth_y_m)[from_row:]
    paths = [reckon(series, figures).at_m[from_row:] for figures in (before, after)]
    if np.count_nonzero(np.isfinite(truth)) < 3:
        apart = float(np.sqrt(np.mean(np.abs(paths[0] - paths[1]) ** 2)))
        return Shown(name, share, paths[0], paths[1], truth, float("nan"), float("nan"), apart)
    (one, first), (two, second) = (laid_on(path, truth) for path in paths)
    apart = float(np.sqrt(np.mean(np.abs(one - two) ** 2)))
    return Shown(name, share, one, two, truth, first, second, apart)
