"""`gyrocal turn` and `gyrocal umbmark`: logs and squares to figures in words, tables, JSON and a picture."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import gyrocal
from gyrocal.calibration.figure import interval_said, number
from gyrocal.calibration.turns import Figure as Figured
from gyrocal.calibration.turns import Floats, TurnCalibration
from gyrocal.navigation.umbmark import Umbmark
from gyrocal.report import style
from gyrocal.report.page import Page, Picture, Table, render_page
from gyrocal.units import plural

_CURVE_POINTS = 6000
#: Scale factor errors up to this are those of gyros: a few percent for MEMS, some more by how they are mounted.
_LIKELY_PPM = 1e5
#: Which bias is meant: a gyro whose bias walks has one for each rest.
_BIAS = "mean bias of the rests"


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


def turn_sentence(found: TurnCalibration) -> str:
    """The answer in one sentence."""
    used = sum(turn.used for turn in found.turns)
    parts = [
        f"{used} turns between {len(found.rests)} {plural(len(found.rests), '[rest|rests]')}: scale factor error {_said(found.scale)}"
    ]
    if found.asymmetry is not None:
        parts.append(f"asymmetry {_said(found.asymmetry)}")
    parts.append(f"{_BIAS} {_said(found.bias)}")
    parts.append(f"the stops are off their marks by {found.stop_std_deg:.2g} deg")
    return ", ".join(parts) + "."


def count_sentence(found: TurnCalibration) -> str:
    """What the scale factor error is if the marks are miscounted, and whether these turns leave that open."""
    more, fewer = found.other_scales_ppm
    others = " or ".join(f"{other * 1e-4:+.3g} %" for other in (more, fewer) if other is not None)
    text = f"How many marks a turn passes is counted by the gyro: by another count the scale factor error is {others}, or further off."
    if any(other is not None and abs(other) < _LIKELY_PPM for other in (more, fewer)):
        text += " These turns do not tell which: turn by fewer marks, too."
    return text


def _said(figure: Figured) -> str:
    return f"{number(figure.value, 0.5 * (figure.high - figure.low))} {figure.unit} ({interval_said(figure.low, figure.high)})"


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


def turn_files(report: TurnReport) -> dict[str, bytes | str]:
    """Name to contents of what `gyrocal turn --out` writes."""
    figure = turn_picture(report)
    png = style.render(figure, "png")
    return {
        "turns.html": render_page(turn_page(report, png)),
        "turns.json": json.dumps(report.to_json(), indent=1) + "\n",
        "turns.png": png,
        "turns.svg": style.render(figure, "svg"),
    }


def turn_page(report: TurnReport, png: bytes) -> Page:
    """The page: figures, picture, the turns one by one, and what was left out."""
    found = report.found
    figures = [("scale factor error", found.scale), ("asymmetry", found.asymmetry), (_BIAS, found.bias)]
    used = len([turn for turn in found.turns if turn.used])
    return Page(
        title="A gyro turned on a mark",
        verdict=turn_sentence(found),
        key_figures=[(name, "turn both ways for it" if f is None else _said(f)) for name, f in figures],
        remarks=[
            "The bias is the mean of what the gyro says at the rests, earth rate within it; where it walks from rest to rest, that "
            "of another time is another.",
            count_sentence(found),
        ],
        pictures=[
            Picture("turns", "Rests and turns", "Above the log, below what each turn is off; 95 % bars.", png)
        ],
        tables=[Table("turns", f"{used} turns used", *turn_rows(found), csv="")],
        quality=report.notes,
        provenance={"Software": f"gyrocal {gyrocal.__version__}"},
        beside="turns.json holds everything with all digits.",
    )


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


def square_rows(found: Umbmark) -> list[tuple[str, str, str, str]]:
    """Figure, value, interval, and where it goes."""
    listed = (
        ("wheel diameters, right over left, beside the file's", found.wheel_ratio, ""),
        ("wheel separation, true over assumed", found.track_ratio, ""),
        ("left_scale", found.left_scale, "[encoders] of the robot file, in its place"),
        ("right_scale", found.right_scale, "[encoders] of the robot file, in its place"),
        ("wheel_separation_m", found.wheel_separation_m, "robot file, in its place"),
    )
    return [(name, f"{e.value:.6g}", f"{e.low:.6g} to {e.high:.6g}", where) for name, e, where in listed]


#: What squares cannot tell, and every figure of them rests on.
SQUARES_TAKE = (
    "The mean of the two wheel scales is the robot file's: squares tell their ratio alone, and an error of the mean goes into the "
    "separation, beyond its interval. Measure it along a straight line."
)
