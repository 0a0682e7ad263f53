"""`gyrocal turn` and `gyrocal umbmark`: logs and squares to figures in words, tables, JSON and a picture."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gyrocal.calibration.figure import interval_said, number
from gyrocal.calibration.turns import Figure as Figured
from gyrocal.calibration.turns import Floats, TurnCalibration, calibrate_turns
from gyrocal.errors import DataError, InputError
from gyrocal.navigation.umbmark import Umbmark, umbmark
from gyrocal.records.csvio import read_columns, read_header, require_columns
from gyrocal.records.gyro_log import GyroChoice, iterate_gyro_log
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.robot import read_robot
from gyrocal.report import style
from gyrocal.units import plural

_CURVE_POINTS = 6000
_SQUARES = ("direction", "x_m", "y_m")


@dataclass(frozen=True)
class TurnReport:
    """A calibration by turns, the samples behind it, and what was left out of them."""

    found: TurnCalibration
    t_s: Floats
    gyro_dps: Floats
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """``gyrocal-turns/1``."""
        return {"schema": "gyrocal-turns/1", **asdict(self.found), "notes": list(self.notes)}


def examine_turns(log: Path, mark_deg: float, choice: GyroChoice | None = None) -> TurnReport:
    """Read a log of samples and calibrate by its turns.

    Raises
    ------
    InputError, DataError
        A log that cannot be read, or without three turns between rests.
    """
    blocks = list(iterate_gyro_log(log, choice))
    numbers = np.concatenate([np.full(len(b), b.segment) for b in blocks])
    t_s, gyro = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("t_s", "gyro_dps"))
    notes = [note for block in blocks for note in block.notes]
    longest = np.bincount(numbers).argmax()
    if np.any(numbers != longest):
        beyond = int(np.count_nonzero(numbers != longest))
        notes.append(
            plural(beyond, f"{beyond} [sample|samples] beyond a step of the clock [is|are] left out")
        )
    missing = ~np.isfinite(gyro)
    if np.any(missing & (numbers == longest)):
        empty = int(np.count_nonzero(missing & (numbers == longest)))
        notes.append(plural(empty, f"{empty} empty [sample is|samples are] bridged by the next one"))
    use = (numbers == longest) & ~missing
    if np.count_nonzero(use) < 2:
        raise DataError(f"{log}: has no samples to look for turns in.")
    try:
        found = calibrate_turns(t_s[use], gyro[use], mark_deg)
    except DataError as error:
        raise DataError(f"{log}: {error}") from error
    return TurnReport(found, t_s[use], gyro[use], tuple(notes))


def turn_sentence(found: TurnCalibration) -> str:
    """The answer in one sentence."""
    used = sum(turn.used for turn in found.turns)
    parts = [
        f"{used} turns between {len(found.rests)} {plural(len(found.rests), '[rest|rests]')}: scale factor error {_said(found.scale)}"
    ]
    if found.asymmetry is not None:
        parts.append(f"asymmetry {_said(found.asymmetry)}")
    parts.append(f"bias {_said(found.bias)}")
    parts.append(f"the stops are off their marks by {found.stop_std_deg:.2g} deg")
    return ", ".join(parts) + "."


def _said(figure: Figured) -> str:
    return f"{number(figure.value)} {figure.unit} ({interval_said(figure.low, figure.high)})"


def turn_rows(found: TurnCalibration) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows of the table of turns."""
    rows: list[tuple[str, ...]] = [
        (
            f"{t.start_s:.1f}",
            f"{t.end_s:.1f}",
            f"{t.angle_deg:.3f}",
            f"{t.true_deg:.0f}",
            f"{t.peak_dps:.0f}",
            t.remark or "used",
        )
        for t in found.turns
    ]
    return ("from s", "to s", "gyro deg", "true deg", "fastest deg/s", ""), rows


def write_turns(report: TurnReport, out: Path) -> None:
    """JSON and picture into the new directory `out`."""
    check_output(out)
    figure = turn_picture(report)
    files: dict[str, bytes | str] = {
        "turns.json": json.dumps(report.to_json(), indent=1) + "\n",
        "turns.png": style.render(figure, "png"),
        "turns.svg": style.render(figure, "svg"),
    }
    write_directory(out, files)


@style.styled
def turn_picture(report: TurnReport) -> Figure:
    """The log with its rests and turns, and what each turn is off."""
    found = report.found
    figure = style.new_figure(style.TWO_COLUMNS_IN, 4.2)
    above, below = figure.subplots(2, 1, height_ratios=(1.4, 1.0))
    step = max(1, report.t_s.size // _CURVE_POINTS)
    above.plot(report.t_s[::step], report.gyro_dps[::step], color=style.INK, linewidth=0.5)
    for rest in found.rests:
        above.axvspan(rest.start_s, rest.end_s, color=style.SKY, alpha=0.3, linewidth=0)
    for turn in found.turns:
        above.annotate(
            style.minus(f"{turn.true_deg:+.0f}°" if turn.used else "?"),
            (0.5 * (turn.start_s + turn.end_s), 0.0),
            fontsize=6,
            ha="center",
            color=style.BLUE if turn.used else style.ORANGE,
        )
    above.set_xlabel("time, s")
    above.set_ylabel("output, deg/s")
    style.say_in_figure(above, "shaded: rests")
    used = [t for t in found.turns if t.used]
    true = np.array([t.true_deg for t in used])
    off = np.array([t.angle_deg - t.true_deg for t in used])
    below.errorbar(true, off, yerr=[2 * t.std_deg for t in used], fmt="o", color=style.BLUE)
    ends = np.array([true.min(), 0.0, true.max()])
    slope, half = found.scale.value * 1e-6, (found.asymmetry.value * 0.5e-6 if found.asymmetry else 0.0)
    below.plot(ends, slope * ends + half * np.abs(ends), color=style.ORANGE)
    below.set_xlabel("true angle of the turn, deg (counter-clockwise positive)")
    below.set_ylabel("gyro less true, deg")
    return figure


def examine_squares(runs: Path, robot: Path, side_m: float, seed: int) -> Umbmark:
    """Read return errors and correct the robot file's figures.

    Parameters
    ----------
    runs : CSV with ``direction, x_m, y_m``: +1 counter-clockwise, -1 clockwise; measured less believed end position

    Raises
    ------
    InputError, ProfileError, DataError
        A file that cannot be read, another direction, or too few runs.
    """
    header = read_header(runs)
    require_columns(runs, header, _SQUARES, _SQUARES)
    table = read_columns(runs, header)
    points = np.column_stack([table["x_m"], table["y_m"]])
    for row, values in enumerate(np.column_stack([table["direction"], points])):
        if abs(values[0]) != 1.0 or not np.isfinite(values).all():
            shown = ", ".join(f"{v:g}" for v in values)
            raise InputError(
                f"{runs}, line {row + 2}: holds {shown}; wanted are a direction of 1 or -1 and two distances in metres."
            )
    ccw = table["direction"] > 0
    return umbmark(points[~ccw], points[ccw], side_m, read_robot(robot).wheel_separation_m, seed)


def square_rows(found: Umbmark) -> list[tuple[str, str, str, str]]:
    """Figure, value, interval, and where it goes."""
    listed = (
        ("wheel diameters, right over left", found.wheel_ratio, ""),
        ("wheel separation, true over assumed", found.track_ratio, ""),
        ("left_scale", found.left_scale, "[encoders] of the robot file"),
        ("right_scale", found.right_scale, "[encoders] of the robot file"),
        ("wheel_separation_m", found.wheel_separation_m, "robot file"),
    )
    return [(name, f"{e.value:.6g}", f"{e.low:.6g} to {e.high:.6g}", where) for name, e, where in listed]
