"""Mix-ups of a drive log, found before anything is fitted: units and signs of gyro and truth, missing rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.series import DriveSeries, Floats, usual_step_s
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate
from gyrocal.errors import DataError
from gyrocal.navigation.lost_ways import LACKS_A_ROW, rows_missing
from gyrocal.navigation.sanity import (
    AGAINST_GYRO,
    UNITS,
    backwards_fault,
    clockwise,
    degrees_fault,
    gyro_fault,
    heading_fault,
    in_radians,
    mirror_fault,
    truth_part_fault,
    truth_unit_m,
    turn_part_fault,
    turns_against,
    way_fault,
)
from gyrocal.physics.drive import DROPPED_SAMPLES, UNIT_OR_SIGN
from gyrocal.units import DPH_TO_DPS, RAD_TO_DEG

#: A factor this near to a wrong unit (on a log scale: a factor of 3) is one; nothing physical comes near.
_UNIT_FACTOR = 3.0
#: Turns are compared over windows of this length; below this share of common variance they are not of one robot.
_WINDOW_S, _COMMON = 5.0, 0.25
#: Above this share they are, whatever else is wrong with a wheel.
_SURELY_COMMON = 0.7
#: Share of missing rows that is worth a name.
_LOST = 1e-3
#: Steps shorter than this share of the usual one are doubles; time stamps that scatter by more than this share are uneven.
_DOUBLE, _UNEVEN = 0.2, 0.05


@dataclass(frozen=True)
class Found:
    """An effect that a check has found."""

    effect: str
    amplitude: Estimate
    seen: Remark


def wrong_gyro(series: DriveSeries) -> tuple[DriveSeries, Found | None]:
    """The log with the gyro in deg/s, counter-clockwise, and what was wrong; None where nothing is.

    The ratio of gyro to encoder turns over windows, by the reduced major axis, which no side's noise bends.

    Raises
    ------
    DataError
        In a part of the log one of them is in another unit.
    """
    if not series.differential:
        return series, None
    wheels_deg, gyro_deg = RAD_TO_DEG * series.encoder_rad, RAD_TO_DEG * series.gyro_rad
    fault = turn_part_fault(series.t_s, wheels_deg, gyro_deg, ("the encoders", "gyro_dps"))
    if fault is not None:
        raise DataError(f"{series.source}: {fault}")
    edges = np.arange(series.t_s[0], series.t_s[-1], _WINDOW_S)
    encoder, gyro = (np.diff(np.interp(edges, series.t_s, v)) for v in (series.encoder_rad, series.gyro_rad))
    e, g = encoder - np.median(encoder), gyro - np.median(gyro)
    see, sgg, seg = float(e @ e), float(g @ g), float(e @ g)
    if min(see, sgg) <= 0 or seg**2 < _COMMON * see * sgg:
        return _wrong_wheel(series, edges, g)
    ratio = float(np.sign(seg) * np.sqrt(sgg / see))
    units = ((RAD_TO_DEG, "rad/s"), (1.0 / RAD_TO_DEG, "twice"), (DPH_TO_DPS, "deg/h"), (1.0, ""))
    factor, unit = min(units, key=lambda unit: abs(np.log(abs(ratio) * unit[0])))
    right_way = not unit and ratio > 0
    if right_way or not 1 / _UNIT_FACTOR < abs(ratio) * factor < _UNIT_FACTOR:
        return series, None
    std = abs(ratio) * float(np.sqrt(max(1.0 - seg**2 / (see * sgg), 0.0) / max(e.size - 2, 1)))
    amplitude = Estimate.normal(ratio, std, "1")
    right = replace(series, gyro_dps=series.gyro_dps * factor * float(np.sign(ratio)))
    if not unit and follows_in_mirror(right) and not follows_in_mirror(series):
        right = replace(series, left_m=series.right_m, right_m=series.left_m, tick_m=series.tick_m[::-1])
        return right, Found(UNIT_OR_SIGN.id, amplitude, Remark(Said.WHEELS_SWAPPED))
    seen = Remark(Said.GYRO_COLUMN, {"unit": unit, "inverted": ratio < 0})
    return right, Found(UNIT_OR_SIGN.id, amplitude, seen)


def follows_in_mirror(series: DriveSeries) -> bool:
    """Whether there is a truth, and it follows the gyro's path in a mirror only."""
    known = np.isfinite(series.truth_x_m + series.truth_y_m)
    if not known.any():
        return False
    at = reckon(series, Figures()).at_m[known]
    told = np.column_stack([series.truth_x_m, series.truth_y_m])[known]
    return mirror_fault(np.column_stack([at.real, at.imag]), told) is not None


def _wrong_wheel(series: DriveSeries, edges_s: Floats, turned: Floats) -> tuple[DriveSeries, Found | None]:
    """The log with the wheel turned round that counts backwards, and that; None where neither does.

    `turned` is what the gyro turns between the edges, about its median. With one wheel's sign wrong, the sum of the two
    distances is the turn, and the sign of that tells which.
    """
    both = np.diff(np.interp(edges_s, series.t_s, np.cumsum(series.left_m + series.right_m)))
    both = both - np.median(both)
    sbb, sgg, sbg = float(both @ both), float(turned @ turned), float(both @ turned)
    if min(sbb, sgg) <= 0 or sbg**2 < _SURELY_COMMON * sbb * sgg:
        return series, None
    side = "left" if sbg > 0 else "right"
    right = replace(series, left_m=-series.left_m) if sbg > 0 else replace(series, right_m=-series.right_m)
    seen = Remark(Said.WHEEL_SIGN, {"side": side})
    return right, Found(UNIT_OR_SIGN.id, Estimate.exact(-1.0, "1"), seen)


def wrong_truth(series: DriveSeries) -> tuple[DriveSeries, list[Remark]]:
    """The log with the truth in metres and degrees, and what was wrong with it.

    Raises
    ------
    DataError
        By the truth the gyro is in rad/s (where the wheels tell turns, `wrong_gyro` has seen it), or the way is in another
        unit, or something is in a part of the log.
    """
    notes: list[Remark] = []
    path = reckon(series, Figures())
    path_deg = np.column_stack([path.at_m.real, path.at_m.imag, RAD_TO_DEG * path.heading_rad])
    told = np.column_stack([series.truth_x_m, series.truth_y_m, series.truth_heading_deg])
    known = np.isfinite(told[:, 0] + told[:, 1])
    fault = truth_part_fault(series.t_s, path_deg, told)
    if fault is None and known.any():
        fault = degrees_fault(path_deg[known, :2], told[known, :2])
    if fault is None:
        fault = gyro_fault(path_deg, told)
    if fault is not None:
        raise DataError(f"{series.source}: {fault}")
    if in_radians(path_deg[:, 2], series.truth_heading_deg):
        notes.append(Remark(Said.TRUTH_RADIANS))
        series = replace(series, truth_heading_deg=RAD_TO_DEG * series.truth_heading_deg)
    if not series.has_truth:
        if turns_against(path_deg[:, 2], series.truth_heading_deg):
            if not series.differential:
                raise DataError(f"{series.source}: {AGAINST_GYRO}")
            # By the wheels the gyro's sign is right.
            notes.append(Remark(Said.TRUTH_CLOCKWISE))
            series = replace(series, truth_heading_deg=90.0 - series.truth_heading_deg)
        return series, notes
    own = path_deg[known, :2]
    unit_m = truth_unit_m(own, told[known, :2])
    if unit_m != 1.0:
        notes.append(Remark(Said.TRUTH_UNIT, {"times": 1 / unit_m, "unit": UNITS[unit_m]}))
        series = replace(series, truth_x_m=unit_m * series.truth_x_m, truth_y_m=unit_m * series.truth_y_m)
    told = np.column_stack([series.truth_x_m, series.truth_y_m, series.truth_heading_deg])
    fault = way_fault(own, told[known, :2])
    if fault is not None:
        raise DataError(f"{series.source}: {fault}")
    if mirror_fault(own, told[known, :2]) is None:
        if clockwise(path_deg, told):
            notes.append(Remark(Said.TRUTH_CLOCKWISE))
            series = replace(series, truth_heading_deg=90.0 - series.truth_heading_deg)
        elif fault := backwards_fault(path_deg, told) or heading_fault(path_deg, told):
            raise DataError(f"{series.source}: {fault}")
    return series, notes


def missing_rows(t_s: Floats, late: int = 0) -> Found | None:
    """Rows that the logger lost, told by the gaps in time.

    Parameters
    ----------
    late : rows that have the time of another one, and are missed at their own
    """
    steps = np.diff(t_s)
    usual = usual_step_s(t_s)
    lost = rows_missing(t_s, usual) - late
    if lost <= _LOST * steps.size:
        return None
    share = 100.0 * lost / (lost + steps.size + 1)
    facts = {"count": lost, "percent": share, "longest_s": float(steps.max())}
    return Found(DROPPED_SAMPLES.id, Estimate.exact(share, "%"), Remark(Said.MISSING_ROWS, facts))


def uneven_clock(t_s: Floats) -> Remark | None:
    """Unsteady time stamps; None where they are steady."""
    steps = np.diff(t_s)
    usual = usual_step_s(t_s)
    regular = steps[(steps > _DOUBLE * usual) & (steps < LACKS_A_ROW * usual)]
    jitter_s = float(np.std(regular) / np.sqrt(2.0)) if regular.size else 0.0
    if jitter_s <= _UNEVEN * usual:
        return None
    return Remark(Said.UNEVEN_CLOCK, {"jitter_ms": 1e3 * jitter_s, "usual_ms": 1e3 * usual})
