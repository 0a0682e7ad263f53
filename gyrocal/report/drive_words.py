"""A drive's diagnosis in plain sentences, and its tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrocal.diagnosis.drive.engine import DriveDiagnosis, Shown
from gyrocal.diagnosis.drive.estimates import DriveEstimate
from gyrocal.diagnosis.drive.findings import undecided
from gyrocal.diagnosis.drive.laws import KINDS
from gyrocal.diagnosis.drive.places import left_out
from gyrocal.diagnosis.drive.sides import ASYMMETRY
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Alternative, Diagnosis, Estimate, Located, NamedEffect
from gyrocal.physics.drive import GYRO_BIAS, GYRO_SCALE
from gyrocal.records.robot import Robot
from gyrocal.report.page import Table
from gyrocal.report.remarks import remark_words, statement
from gyrocal.report.words import listed, part_words, region_words, times_text
from gyrocal.units import NORMAL_95, p_equals

#: Evidence that tells nothing apart.
_ALIKE = 3.0
#: Slips of a wheel of which each has its place in the sentence.
_SLIPS = 4
#: Metres below which an estimate is not worth a sentence, and how many get one.
_LEAST_M, _MOST = 0.001, 5
#: Two paths that are nowhere farther apart are one.
_SAME_PATH_M = 1e-4
#: Figures that a robot file says what they may be off by, and for which something usual is taken where it does not.
_GRANTS = ("gyro_bias_dps", GYRO_SCALE.id, "wheel_separation_m", "left_scale", "right_scale")
_PATHS = {
    "gyro": "along the gyro's heading",
    "encoders": "along the encoders' heading",
    "truth": "of the truth's own frame",
}


def drive_sentences(found: DriveDiagnosis) -> tuple[str, ...]:
    """What there is to say of a drive, in order."""
    diagnosis = found.diagnosis
    lines = [_first_sentence(found)]
    lines += [_effect_sentence(e) for e in diagnosis.effects]
    lines += [_shown_sentence(s) + _wrong_with(s) for s in found.shown]
    left = [place for place in diagnosis.located if place.remains]
    off = _bias_granted(found.series.robot)
    if found.series.robot.static_s > 0:
        off = "the rest at the start takes it off"
    if any(isinstance(n, Remark) and n.said is Said.NO_REST for n in found.diagnosis.notes):
        off = "no rest takes it off"
    withheld = found.robot is not None and found.robot.parameters.gyro.scale == 0.0
    lines += _estimate_sentences(
        found.estimates,
        taken_off=off,
        nameless=bool(left),
        scale_withheld=withheld,
        granted=_granted(found.series.robot),
    )
    if slips := left_out(found.yaw):
        largest = sorted(slips, key=lambda x: -abs(x.turn_deg))[:_SLIPS]
        first = ", ".join(f"{x.turn_deg:+.2g} deg at {x.from_s:.2f} s" for x in largest)
        rest = f" and {len(slips) - _SLIPS} lesser ones" if len(slips) > _SLIPS else ""
        lines.append(
            "Intervals in which a wheel may have slipped, gyro or clock jumped, or a hand turned the robot, are left out of all fits: "
            f"{first}{rest} (all in diagnosis.json)"
        )
    if left:
        places = "; ".join(_place(place) for place in left)
        lines.append(f"Unexplained, without a name: {places}")
    if undecided(found.yaw, diagnosis.effects):
        percent = 100.0 * found.yaw.estimate("track")[0]
        lines.append(
            f"By the encoders the robot turns {percent:+.3g} % against the gyro: the wheel separation, both wheels' scale or the "
            "gyro's may be off by that, which this log cannot tell apart"
        )
    if not found.series.differential:
        lines.append(
            "The log has one speed for both wheels: rests tell the gyro's bias and true positions its scale and that of "
            "the speed; of track, wheels and delay nothing can be said"
        )
    lines += _inseparable(found)
    with_deviation = next((k for k, line in enumerate(lines) if "±" in line), None)
    if with_deviation is not None:
        lines[with_deviation] += " (±: one standard deviation, here and below)"
    return tuple(lines)


def _granted(robot: Robot) -> str:
    """What figures may be off by without being told, and who says so."""
    says = [f"initial_std.{key}" in robot.given for key in _GRANTS]
    if all(says):
        return "what the robot file grants"
    if not any(says):
        return "what is usual where the robot file says nothing"
    return "what the robot file grants, or what is usual where it says nothing"


def _bias_granted(robot: Robot) -> str:
    """That a bias is within what was allowed for it."""
    if "initial_std.gyro_bias_dps" in robot.given:
        return "the robot file grants as much"
    return f"as much is usual: the robot file says nothing, and {robot.initial_std['gyro_bias_dps']:g} deg/s is taken"


def _place(place: Located) -> str:
    what = "scatter" if place.statistic == "variance" else "structure"
    where = place.coordinate.replace("_", " ")
    return f"{what} over {where}, {region_words(place)} ({p_equals(place.p_value)})"


def _first_sentence(found: DriveDiagnosis) -> str:
    if not found.series.differential and not found.diagnosis.effects:
        return "The vehicle logs no turn of its wheels, so that encoders and gyro cannot be compared."
    if found.diagnosis.verdict == "partly_explained" and not any(p.remains for p in found.diagnosis.located):
        return (
            "The log departs from the robot file; the physics named below explains it, and so does what it could also "
            "be, which this log cannot tell from it."
        )
    return {
        "consistent": f"Encoders and gyro agree within their noise and {_granted(found.series.robot)}.",
        "explained": "The log departs from the robot file, and the physics named below explains it.",
        "partly_explained": "The log departs from the robot file; the physics named below explains a part of it.",
        "unexplained": "The log departs from the robot file, and no effect of the catalogue explains it.",
    }[found.diagnosis.verdict]


def _effect_sentence(effect: NamedEffect) -> str:
    others = [_other(a) for a in effect.alternatives]
    rest = f"; it could also be {', '.join(others)}" if others else ""
    return f"{effect.effect}: {statement(effect).rstrip('.')}, here {_value(effect.parameters['amplitude'])}{rest}"


def _other(a: Alternative) -> str:
    if 1 / _ALIKE < a.evidence_ratio < _ALIKE:
        return f"{a.effect} (about as well)"
    if a.evidence_ratio < 1.0:
        return f"{a.effect} (likelier: {times_text(-np.log(a.evidence_ratio))} to 1 for it)"
    return f"{a.effect} ({a.evidence_ratio:.2g} to 1 against it)"


def _wrong_with(shown: Shown) -> str:
    if not shown.wrong:
        return ""
    return f". Of {shown.log}: {'; '.join(remark_words(note) for note in shown.wrong)}"


def _shown_sentence(shown: Shown) -> str:
    part = part_words(shown.log, shown.from_share)
    if shown.apart_m < _SAME_PATH_M:
        those = "those do" if shown.from_share else "what was found does"
        return f"On {part}, nothing is put to the test: {those} not move the path along the gyro's heading"
    if not np.isfinite(shown.before_m):
        return f"On {part} the path along the gyro's heading moves by {shown.apart_m:.2g} m rms; there is no truth to say whether for the better"
    before, after = f"{shown.before_m:.3g}", f"{shown.after_m:.3g} m rms"
    better = "falls" if shown.after_m <= shown.before_m else "rises"
    moves = f"{better} from {before} to {after}" if after != f"{before} m rms" else f"stays at {after}"
    said = f"On {part} the position error along the gyro's heading {moves}"
    if not np.isfinite(shown.truth_m):
        return said
    own = f"a perfect path would be off by about {shown.truth_m:.2g} m rms, which is the truth's own error"
    if abs(shown.after_m - shown.before_m) >= shown.seen_m:
        return f"{said}; {own}"
    return f"{said}, which tells nothing: {own}, and it hides differences of less than {shown.seen_m:.2g} m"


def _estimate_sentences(
    estimates: tuple[DriveEstimate, ...],
    *,
    taken_off: str,
    nameless: bool,
    scale_withheld: bool,
    granted: str,
) -> list[str]:
    """What the log says of every figure that matters: those that stand out with what they cost, then those that may be nothing."""
    said = [e for e in estimates if e.path != "truth" and e.metres >= _LEAST_M][:_MOST]
    jumps, uneven = (any(e.name == n for e in estimates) for n in (KINDS["jump"].shown, ASYMMETRY))
    lines, nothing = [], []
    for e in said:
        figure = f"{e.name.replace('_', ' ')} {_pair(e.value, e.std)} {e.unit}"
        remark = "" if e.named else _why_unnamed(nameless, granted)
        if e.name == KINDS["jump"].shown:
            remark = "; no robot file holds it"
        elif e.name == GYRO_SCALE.id and e.named and scale_withheld:
            remark = "; not in the robot file, for what is left over the turns may be a tilt's, which the next drive need not have"
        elif e.name == ASYMMETRY:
            remark = "; the robot file has it, and the catalogue no name for it"
        elif e.name == GYRO_SCALE.id and not e.named and uneven:
            remark = "; the robot file has it beside the asymmetry"
        elif e.name == GYRO_BIAS.id and not e.named:
            remark = f"; {taken_off}"
            remark = "; that after its jump" if jumps else remark
        elif not e.named and abs(e.value) < NORMAL_95 * e.std:
            nothing.append(figure)
            continue
        lines.append(f"{figure}: left in, it moves the path {_PATHS[e.path]} by {e.metres:.2g} m rms{remark}")
    if nothing:
        lines.append(f"Within their uncertainty of nothing: {listed(nothing)}")
    return lines


def _why_unnamed(nameless: bool, granted: str) -> str:
    if nameless:
        return "; not named, for what is left without a name may be what moves it"
    return f"; not named, too near its uncertainty or to {granted}"


def _inseparable(found: DriveDiagnosis) -> list[str]:
    """Estimates that this log cannot tell apart, from their correlation."""
    yaw = found.yaw
    std = np.sqrt(np.maximum(np.diag(yaw.covariance), 1e-300))
    correlation = yaw.covariance / np.outer(std, std)
    lines = []
    names = [KINDS[n].shown.replace("_", " ") for n in yaw.chosen]
    for i, one in enumerate(names):
        for j in range(i):
            if abs(correlation[i, j]) > 0.95 and names[j] != one:
                pair = f"{names[j]} and {one}"
                lines.append(f"This drive hardly tells {pair} apart (correlation {correlation[i, j]:.2f})")
    return lines


def _decimals(std: float) -> int:
    """Decimals that show two digits of a standard deviation."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 9)) if std > 0 and np.isfinite(std) else 3


def _pair(value: float, std: float) -> str:
    d = _decimals(std)
    return f"{value:.{d}f} ± {std:.{d}f}"


def _value(e: Estimate) -> str:
    """Value, unit and interval, all rounded to the same decimal."""
    unit = "" if e.unit == "1" else f" {e.unit}"
    if np.isnan(e.interval_95[0]):
        return f"{e.value:.4g}{unit}"
    d = _decimals(e.std)
    return f"{e.value:.{d}f}{unit} (95 %: {e.interval_95[0]:.{d}f} to {e.interval_95[1]:.{d}f})"


def drive_tables(diagnosis: Diagnosis) -> list[Table]:
    """All estimates of a drive by the metres that they cost, and the position errors before and after."""
    if diagnosis.drive is None:
        return []
    estimates = [
        (
            e["name"],
            _cell(e, "value"),
            _cell(e, "std"),
            e["unit"],
            _cell(e, "metres"),
            _PATHS[e["path"]],
            "yes" if e["named"] else "",
        )
        for e in diagnosis.drive["estimates"]
    ]
    errors = [
        (
            part_words(e["log"], e["from_share"]),
            _cell(e, "before_rms_m"),
            _cell(e, "after_rms_m"),
            _cell(e, "apart_rms_m"),
            _cell(e, "truth_rms_m"),
            _cell(e, "least_seen_m"),
        )
        for e in diagnosis.drive["position_error"]
    ]
    return [
        _table(
            "estimates",
            "Every estimate, by the metres it costs",
            ("Figure", "Value", "Std", "Unit", "Cost, m rms", "Path", "Named"),
            estimates,
            "Cost: rms position error over this log if the figure is not taken out. What is not named does not stand out "
            "of the noise, or lies within what the robot file grants (where it says nothing: what is usual). Std: one standard deviation.",
        ),
        _table(
            "position_error",
            "Position error on what the figures were not fitted to",
            (
                "Part",
                "Before, m rms",
                "After, m rms",
                "Paths apart, m rms",
                "The truth's own, m rms",
                "Seen from, m",
            ),
            errors,
            "The truth's own: what its error would give a perfect path, as this log shows it. Seen from: "
            "a smaller difference between before and after is as likely its noise (95 %).",
        ),
    ]


def _table(name: str, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], note: str) -> Table:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return Table(name, title, columns, rows, text.getvalue(), note if rows else "")


def _cell(row: Mapping[str, Any], key: str) -> str:
    return "-" if row[key] is None else f"{row[key]:.3g}"
