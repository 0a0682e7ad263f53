"""A drive log as `diagnose` looks at it: cumulative channels, and sums over equal bins with their coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.fusion.static_bias import static_bias
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot
from gyrocal.units import RAD_TO_DEG

Floats = NDArray[np.float64]

#: Bins in which encoders and gyro are compared: long beside the sampling, short beside a turn.
BIN_S = 1.0
#: A step of time above so many usual ones is a gap; bins that touch one are left out.
GAP_STEPS = 5.0
#: Longest delay that is looked for, either way, s.
MAX_DELAY_S = 1.0
#: Slower than this the robot stands, m/s.
STANDING_MPS = 0.01


@dataclass(frozen=True)
class DriveSeries:
    """Cumulative channels over the rows of a log, arrays of shape (n,).

    Attributes
    ----------
    encoder_deg, gyro_deg : heading by the encoders (nominal wheel separation) and by the gyro, from 0
    left_m, right_m : distance of each side, from 0
    temp_c : gyro temperature, NaN where there is none
    truth_x_m, truth_y_m, truth_heading_deg : position and heading, NaN where there is none
    usual_dt_s : median time step
    gaps_s : (begin, end) of each gap
    notes : what was found and done, in words
    """

    source: str
    t_s: Floats
    encoder_deg: Floats
    gyro_deg: Floats
    left_m: Floats
    right_m: Floats
    temp_c: Floats
    truth_x_m: Floats
    truth_y_m: Floats
    truth_heading_deg: Floats
    usual_dt_s: float
    gaps_s: tuple[tuple[float, float], ...]
    robot: Robot = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def distance_m(self) -> Floats:
        """Distance of the robot's centre, from 0 (paper eq. 6)."""
        return 0.5 * (self.left_m + self.right_m)

    @property
    def start_temp_c(self) -> float:
        """Gyro temperature at which its bias was last taken off: that of the rest, or of the first row; NaN: none."""
        known = np.isfinite(self.temp_c)
        rest = known & (self.t_s <= self.t_s[0] + self.robot.static_s)
        if not known.any():
            return float("nan")
        return float(np.mean(self.temp_c[rest])) if rest.any() else float(self.temp_c[known][0])

    @property
    def way_m(self) -> Floats:
        """Way of the wheels, forward or backward, their mean, from 0: what their noise grows with."""
        left, right = (np.abs(np.diff(w, prepend=w[:1])) for w in (self.left_m, self.right_m))
        return np.asarray(np.cumsum(0.5 * (left + right)))


@dataclass(frozen=True)
class Bins:
    """Sums over bins, arrays of shape (m,), and the coordinates of each bin."""

    width_s: float
    t_s: Floats
    encoder_deg: Floats
    gyro_deg: Floats
    left_m: Floats
    right_m: Floats
    way_m: Floats
    turn_rate_dps: Floats
    speed_mps: Floats
    acceleration_mps2: Floats
    heading_deg: Floats
    temp_c: Floats

    @property
    def distance_m(self) -> Floats:
        """Distance in the bin."""
        return 0.5 * (self.left_m + self.right_m)

    @property
    def curvature_per_m(self) -> Floats:
        """Turn rate over speed, rad/m; 0 where the robot stands."""
        turn = self.turn_rate_dps / RAD_TO_DEG
        moving = np.abs(self.speed_mps) > STANDING_MPS
        return np.divide(turn, self.speed_mps, out=np.zeros_like(turn), where=moving)


def drive_series(
    source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None
) -> DriveSeries:
    """Cumulate a log; the gyro is calibrated first when coefficients and temperatures are there.

    Raises
    ------
    DataError
        Too short or without motion, or coefficients without a temperature in the log.
    """
    t_s = log.t_s
    dt_s = np.diff(t_s, prepend=t_s[0])
    if t_s.size < 100 or t_s[-1] - t_s[0] < 60.0:
        raise DataError(
            f"{source}: {t_s[-1] - t_s[0]:.0f} s are too short to compare encoders and gyro; log at least 60 s."
        )
    usual_dt_s = float(np.median(dt_s[1:]))
    gaps = np.flatnonzero(dt_s > GAP_STEPS * usual_dt_s)
    notes = [f"{gaps.size} gaps of more than {GAP_STEPS:g} usual steps are left out"] if gaps.size else []
    gyro_dps, said = _gyro(source, log, robot, coefficients)
    increments = {"left": log.left_m, "right": log.right_m, "gyro": gyro_dps * dt_s}
    for name, values in increments.items():
        empty = int(np.count_nonzero(~np.isfinite(values)))
        if empty:
            notes.append(f"{empty} rows without {name} count as no motion of that channel")
    left, right, gyro = (np.cumsum(np.nan_to_num(v)) for v in increments.values())
    if max(np.ptp(left), np.ptp(right)) < 1.0:
        raise DataError(f"{source}: the wheels move less than 1 m; there is nothing to compare.")
    return DriveSeries(
        source, t_s, (right - left) / robot.wheel_separation_m * RAD_TO_DEG, gyro, left, right, log.gyro_temp_c,
        log.truth_x_m, log.truth_y_m, log.truth_heading_deg, usual_dt_s, tuple((t_s[i - 1], t_s[i]) for i in gaps), robot, (*notes, *said),
    )  # fmt: skip


def _gyro(
    source: str, log: DriveBlock, robot: Robot, coefficients: Coefficients | None
) -> tuple[Floats, list[str]]:
    """Gyro as the navigator has it before any filter: calibrated, less the mean at rest."""
    gyro_dps, notes = log.gyro_dps, []
    if coefficients is not None:
        if not np.any(np.isfinite(log.gyro_temp_c)):
            raise DataError(
                f"{source}: has no gyro_temp_c, so coefficients cannot be applied. Leave --coefficients out."
            )
        gyro_dps = coefficients.correct(gyro_dps, log.gyro_temp_c)
        notes.append("the gyro was calibrated with the coefficients given")
    if robot.static_s <= 0:
        notes.append("the robot file states no rest at the start, so the gyro's static bias is in the data")
        return gyro_dps, notes
    bias = static_bias(log.t_s, log.left_m, log.right_m, gyro_dps, robot.static_s)
    notes.append(
        f"the mean at rest was taken off the gyro: {bias.bias_dps:.4g} ± {bias.std_error_dps:.2g} deg/s"
    )
    return gyro_dps - bias.bias_dps, notes


def bins_of(series: DriveSeries, delay_s: float, width_s: float = BIN_S) -> Bins:
    """Sums over bins of `width_s`, the gyro looked at `delay_s` earlier (positive: the encoders are late).

    Turn rate and heading are the gyro's. The same bins come for every delay.
    """
    t = series.t_s
    edges = np.arange(t[0] + MAX_DELAY_S, t[-1] - MAX_DELAY_S, width_s)
    begin, end = edges[:-1], edges[1:]
    keep = np.ones(begin.size, dtype=bool)
    for gap_begin, gap_end in series.gaps_s:
        keep &= (end + MAX_DELAY_S < gap_begin) | (begin - MAX_DELAY_S > gap_end)
    begin, end = begin[keep], end[keep]

    def sums(channel: Floats, shift_s: float = 0.0) -> Floats:
        return np.asarray(np.interp(end - shift_s, t, channel) - np.interp(begin - shift_s, t, channel))

    gyro = sums(series.gyro_deg, delay_s)
    left, right = sums(series.left_m), sums(series.right_m)
    speed = 0.5 * (left + right) / width_s
    known = np.isfinite(series.temp_c)
    middle = 0.5 * (begin + end)
    temp = np.interp(middle, t[known], series.temp_c[known]) if known.any() else np.full(middle.size, np.nan)
    half = sums(series.distance_m, -0.5 * width_s) - sums(series.distance_m, 0.5 * width_s)
    return Bins(
        width_s, middle, sums(series.encoder_deg), gyro, left, right, sums(series.way_m), gyro / width_s, speed, half / width_s**2,
        np.interp(middle - delay_s, t, series.gyro_deg), temp,
    )  # fmt: skip
