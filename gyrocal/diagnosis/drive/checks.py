"""Mix-ups of a drive log, found before anything is fitted: units and signs of gyro and truth, missing rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.series import DriveSeries, Floats
from gyrocal.diagnosis.result import Estimate
from gyrocal.units import RAD_TO_DEG

_NONE = (float("nan"), float("nan"))
#: A factor this near to a wrong unit (on a log scale: a factor of 3) is one; nothing physical comes near.
_UNIT_FACTOR = 3.0
_WINDOW_S = 5.0
#: Share of missing rows that is worth a name, and a step of time in usual ones from which a row is missing.
_LOST, _STEP = 1e-3, 1.8
#: Stretches of the truth that tell its unit, m by the encoders, and how many of them.
_STRETCH_M, _STRETCHES = 2.0, 5


@dataclass(frozen=True)
class Found:
    """An effect that a check has found, in words."""

    effect: str
    amplitude: Estimate
    sentence: str


def wrong_gyro(series: DriveSeries) -> tuple[DriveSeries, Found | None]:
    """The log with the gyro in deg/s, counter-clockwise, and what was wrong; None where nothing is.

    The ratio of gyro to encoder turns over windows, by the total least-squares line, which no side's noise bends.
    """
    if not series.differential:
        return series, None
    edges = np.arange(series.t_s[0], series.t_s[-1], _WINDOW_S)
    encoder, gyro = (np.diff(np.interp(edges, series.t_s, v)) for v in (series.encoder_rad, series.gyro_rad))
    e, g = encoder - np.median(encoder), gyro - np.median(gyro)
    see, sgg, seg = float(e @ e), float(g @ g), float(e @ g)
    if min(see, sgg) <= 0 or seg**2 < 0.25 * see * sgg:
        return series, None
    ratio = float(np.sign(seg) * np.sqrt(sgg / see))
    units = ((RAD_TO_DEG, "in rad/s"), (1.0 / RAD_TO_DEG, "converted to degrees twice"), (1.0, ""))
    factor, what = min(units, key=lambda unit: abs(np.log(abs(ratio) * unit[0])))
    turned = "with the sign inverted, or left and right wheel are swapped" if ratio < 0 else ""
    said = " and ".join(text for text in (what, turned) if text)
    if not said or not 1 / _UNIT_FACTOR < abs(ratio) * factor < _UNIT_FACTOR:
        return series, None
    std = abs(ratio) * float(np.sqrt(max(1.0 - seg**2 / (see * sgg), 0.0) / max(e.size - 2, 1)))
    amplitude = Estimate(ratio, std, "1", (ratio - 1.96 * std, ratio + 1.96 * std))
    sentence = f"The gyro column is {said} (its turns over those of the encoders)."
    right = replace(series, gyro_dps=series.gyro_dps * factor * float(np.sign(ratio)))
    return right, Found("unit_or_sign", amplitude, sentence)


def wrong_truth(series: DriveSeries) -> tuple[DriveSeries, list[str]]:
    """The log with the truth in metres and degrees, and what was wrong with it."""
    notes: list[str] = []
    if not series.has_truth:
        return series, notes
    factor = _truth_factor(series)
    if factor != 1.0:
        notes.append(
            f"the truth's positions are {1 / factor:g} times too large: they are taken in {'millimetres' if factor < 1 else 'kilometres'}"
        )
        series = replace(series, truth_x_m=factor * series.truth_x_m, truth_y_m=factor * series.truth_y_m)
    heading = series.truth_heading_deg
    known = np.flatnonzero(np.isfinite(heading))
    if known.size > 20:
        gyro = RAD_TO_DEG * series.gyro_rad[known]
        ratios = []
        for unit in (1.0, RAD_TO_DEG):
            steps = np.diff(unit * heading[known])
            ratios.append(float(np.median(np.abs((steps - np.diff(gyro) + 180.0) % 360.0 - 180.0))))
        if (
            np.max(np.abs(heading[known])) < 2 * np.pi + 0.1
            and np.ptp(gyro) > 60.0
            and ratios[1] < 0.5 * ratios[0]
        ):
            notes.append("the truth's heading is in radians: it is taken as such")
            series = replace(series, truth_heading_deg=RAD_TO_DEG * heading)
    return series, notes


def _truth_factor(series: DriveSeries) -> float:
    """What brings the truth's positions to metres, by the lengths of stretches: 1, 1/1000 or 1000."""
    at = reckon(series, Figures()).at_m
    truth = series.truth_x_m + 1j * series.truth_y_m
    rows = np.flatnonzero(np.isfinite(truth))
    way = np.cumsum(np.abs(series.step_m))[rows]
    marks = rows[np.searchsorted(way, np.arange(way[0], way[-1], _STRETCH_M), side="left")]
    if marks.size < _STRETCHES:
        return 1.0
    own, told = np.abs(np.diff(at[marks])), np.abs(np.diff(truth[marks]))
    moved = own > 0.3 * _STRETCH_M
    if np.count_nonzero(moved) < _STRETCHES or np.median(told[moved]) <= 0:
        return 1.0
    ratio = float(np.median(told[moved] / own[moved]))
    nearest = min((1.0, 1e3, 1e-3), key=lambda unit: abs(np.log(ratio / unit)))
    return 1.0 / nearest if abs(np.log(ratio / nearest)) < np.log(_UNIT_FACTOR) else 1.0


def missing_rows(t_s: Floats) -> Found | None:
    """Rows that the logger lost, told by the gaps in time."""
    steps = np.diff(t_s)
    usual = float(np.median(steps))
    lost = int(np.sum(np.round(steps[steps > _STEP * usual] / usual) - 1)) if usual > 0 else 0
    if lost <= _LOST * steps.size:
        return None
    share = 100.0 * lost / (lost + steps.size + 1)
    text = f"About {lost} rows are missing ({share:.2g} % of the log, the longest gap {steps.max():.3g} s)."
    return Found("dropped_samples", Estimate(share, float("nan"), "%", _NONE), text)


def uneven_clock(t_s: Floats) -> str | None:
    """Unsteady time stamps, in words."""
    steps = np.diff(t_s)
    usual = float(np.median(steps))
    regular = steps[(steps > 0.2 * usual) & (steps < _STEP * usual)]
    jitter_s = float(np.std(regular) / np.sqrt(2.0)) if regular.size else 0.0
    if jitter_s <= 0.05 * usual:
        return None
    return f"time stamps scatter by {1e3 * jitter_s:.2g} ms about an even clock of {1e3 * usual:.3g} ms"
