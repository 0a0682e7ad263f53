"""Dead reckoning of a log with the figures of a robot: encoder distance along the gyro's heading, and its errors in m."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.laws import reference_temp_c, settling, temperature_c
from gyrocal.diagnosis.drive.series import Bools, DriveSeries, Ints, between_rows, measured_over_true
from gyrocal.fusion.robot import SlipFigures
from gyrocal.physics.slip import slip_shape
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class Figures:
    """What is taken out of a log before it is reckoned; all zero is the log as it is.

    Attributes
    ----------
    bias_dps, temp_c : constant bias, and the temperature that it belongs to
    bias_motion_dps : added from the first motion on
    bias_moving_dps, bias_moving_s : follows the motion, with a lag
    bias_before_dps, bias_before_s : added until an instant of the log, s
    bias_settling_dps, bias_settling_s : added at the start of the log, from where on it fades with this time constant
    bias_slope_dps_per_c : bias by temperature
    gyro_scale, left_scale, right_scale : measured = (1 + scale) times true
    gyro_asymmetry : scale of turns to the left less that of those to the right; `gyro_scale` is their mean
    delay_s : the gyro is late; below 0: the encoders are
    track, slip : effective track over the robot file's, less one, and how it widens, for turns that the gyro has not seen
    bias_from_rest : the mean of the rest at the start stands for `bias_dps` where there is one
    """

    bias_dps: float = 0.0
    temp_c: float = float("nan")
    bias_motion_dps: float = 0.0
    bias_moving_dps: float = 0.0
    bias_moving_s: float = 0.0
    bias_before_dps: float = 0.0
    bias_before_s: float = 0.0
    bias_settling_dps: float = 0.0
    bias_settling_s: float = np.inf
    bias_slope_dps_per_c: float = 0.0
    gyro_scale: float = 0.0
    gyro_asymmetry: float = 0.0
    left_scale: float = 0.0
    right_scale: float = 0.0
    delay_s: float = 0.0
    track: float = 0.0
    slip: SlipFigures = field(default_factory=SlipFigures)
    bias_from_rest: bool = True

    def but(self, name: str, value: float) -> Figures:
        """The same with another value of one figure; ``wheel_scale`` stands for both wheels."""
        names = ("left_scale", "right_scale") if name == "wheel_scale" else (name,)
        changed: dict[str, Any] = dict.fromkeys(names, value)
        return replace(self, **changed)


@dataclass(frozen=True)
class Reckoned:
    """A reckoned drive, row by row: time, heading at the end of each row, steps and positions x + iy.

    Attributes
    ----------
    rolled_m : how far a wheel has rolled, forth or back: each is off by itself, on the spot too
    gap : whether the turn of a row is one that the gyro has not seen
    track_m : distance of the wheels that have seen it in its place; 0 where they do not differ
    counts_on : whether they have, and its way too, or both are lost
    """

    t_s: Floats
    dt_s: Floats
    heading_rad: Floats
    way_m: Floats
    rolled_m: Floats
    steps_m: Complexes
    gap: Bools
    track_m: float
    counts_on: bool

    @property
    def at_m(self) -> Complexes:
        """Positions at the end of each row."""
        return np.asarray(np.cumsum(self.steps_m))

    def at_rows(self, rows: Ints) -> Reckoned:
        """The same at the ends of some rows, each with the way and the turn since the one before."""
        return replace(
            self,
            t_s=self.t_s[rows],
            dt_s=since_last(self.dt_s, rows),
            heading_rad=self.heading_rad[rows],
            way_m=since_last(self.way_m, rows),
            rolled_m=since_last(self.rolled_m, rows),
            steps_m=np.diff(self.at_m[rows], prepend=0.0),
            gap=self.gap[rows],
        )

    def moved_by(self, heading_rad: Floats, way_m: Floats) -> Complexes:
        """Change of the positions by small errors of the headings, and of the ways of the rows, shape (n,)."""
        direction = np.exp(1j * middle(self.heading_rad))
        return np.asarray(np.cumsum(1j * middle(heading_rad) * self.steps_m + way_m * direction))


def since_last(steps: Floats, rows: Ints) -> Floats:
    """Sums of steps over the rows since the one before, in each of some rows."""
    return np.asarray(np.diff(np.cumsum(steps)[rows], prepend=0.0))


def middle(heading: Floats) -> Floats:
    """Heading half way through each row, from those at their ends."""
    return np.asarray(0.5 * (heading + np.concatenate([heading[:1], heading[:-1]])))


def chords(way_m: Floats, heading_rad: Floats, dt_s: Floats, gap: Bools) -> Complexes:
    """Steps of rows, each an arc of this length: over a gap it may be far from straight.

    More of a row in which the robot speeds up in a turn lies towards its end, and of one in which the turn grows less of the turn
    has come by its middle: the first moves the step to the side of the turn by (a dt^2)(w dt)/12, the second the other way by
    v dt (b dt^2)/12, which on slow logs, turn by turn, is as much as ways that are off by (w dt)^2/24.
    """
    turned = np.diff(heading_rad, prepend=heading_rad[0])
    aside_m = (_gained(way_m, dt_s) * turned - way_m * _gained(turned, dt_s)) / 12.0
    along_m = way_m * np.sinc(turned / (2.0 * np.pi))
    return np.asarray((along_m + 1j * np.where(gap, 0.0, aside_m)) * np.exp(1j * middle(heading_rad)))


def _gained(steps: Floats, dt_s: Floats) -> Floats:
    """How much the steps of rows grow from the beginning of each to its end, by those before and after."""
    speed = np.divide(steps, dt_s, out=np.zeros_like(steps), where=dt_s > 0)
    return np.asarray(0.5 * (np.append(speed[1:], speed[-1:]) - np.append(speed[:1], speed[:-1])) * dt_s)


def rest_mean_dps(series: DriveSeries) -> tuple[float, float] | None:
    """Mean rate of the rest that the robot file promises, and its mean temperature; None where there is none."""
    rest = (series.t_s - series.t_s[0] <= series.robot.static_s) & ~series.moved
    if series.robot.static_s <= 0 or np.sum(series.dt_s[rest]) < 0.5 * series.robot.static_s:
        return None
    temp = temperature_c(series)
    return float(np.mean(series.gyro_dps[rest])), float("nan") if temp is None else float(np.mean(temp[rest]))


def reckon(series: DriveSeries, figures: Figures) -> Reckoned:
    """Reckon a log with the errors in `figures` taken out of it, each channel brought to the time of the earlier one."""
    rest = rest_mean_dps(series) if figures.bias_from_rest else None
    bias, at_c = rest if rest is not None else (figures.bias_dps, figures.temp_c)
    before = figures.bias_before_dps * (series.t_s < figures.bias_before_s)
    before = before + figures.bias_settling_dps * settling(series, figures.bias_settling_s)
    if rest is not None:
        # The rest at the start has seen it.
        before = before - np.mean(before[series.t_s - series.t_s[0] <= series.robot.static_s])
    rate = series.gyro_dps - bias - before - figures.bias_motion_dps * series.moved
    if figures.bias_moving_dps:
        rate = rate - figures.bias_moving_dps * series.moving(figures.bias_moving_s)
    temp = temperature_c(series)
    if temp is not None and figures.bias_slope_dps_per_c:
        rate = rate - figures.bias_slope_dps_per_c * (
            temp - (at_c if np.isfinite(at_c) else reference_temp_c(series))
        )
    left, right = series.left_m / (1.0 + figures.left_scale), series.right_m / (1.0 + figures.right_scale)
    way, rolled = 0.5 * (left + right), 0.5 * (np.abs(left) + np.abs(right))
    scale = measured_over_true(figures.gyro_scale, figures.gyro_asymmetry, rate)
    by_gyro = DEG_TO_RAD * rate * series.dt_s / scale
    heading = np.cumsum(series.over_gaps(by_gyro, _by_wheels(series, figures, right - left, way)))
    t = series.t_s
    if figures.delay_s > 0:
        heading = between_rows(t + figures.delay_s, t, heading)
    elif figures.delay_s < 0:
        whole = between_rows(t - figures.delay_s, t, np.cumsum(way))
        way = np.diff(whole, prepend=0.0)
    track_m = series.robot.wheel_separation_m * (1.0 + figures.track) if series.differential else 0.0
    steps = chords(way, heading, series.dt_s, series.gap)
    return Reckoned(t, series.dt_s, heading, way, rolled, steps, series.gap, track_m, series.counts_on)


def _by_wheels(series: DriveSeries, figures: Figures, across_m: Floats, way_m: Floats) -> Floats:
    """Turns of the rows by the wheels, rad."""
    track_m, slip = series.robot.wheel_separation_m * (1.0 + figures.track), figures.slip
    over_s = np.maximum(series.dt_s, 1e-9)
    turned = whole = across_m / track_m
    # How much they slip goes by the turn itself.
    for _ in range(4 if slip.amplitude else 0):
        rate_dps = RAD_TO_DEG * turned / over_s
        wider = slip_shape(slip.law, rate_dps, way_m / over_s, track_m, slip.shape)
        turned = whole / (1.0 + slip.amplitude * wider)
    return np.asarray(turned)


def cost_m(series: DriveSeries, figures: Figures, name: str, value: float) -> float:
    """Metres that one figure costs if it is not taken out beside the others: rms over the log from a common start."""
    one, other = (reckon(series, figures.but(name, v)).at_m for v in (value, 0.0))
    return float(np.sqrt(np.mean(np.abs(one - other) ** 2)))


def laid_on(at_m: Complexes, truth_m: Complexes) -> tuple[Complexes, float]:
    """Positions turned and shifted onto the truth by least squares, and their rms distance from it, m."""
    known = np.isfinite(truth_m)
    a, b = at_m[known], truth_m[known]
    inner = complex(np.vdot(a - a.mean(), b - b.mean()))
    turn = inner / abs(inner) if abs(inner) > 0 else 1.0 + 0.0j
    laid = turn * (at_m - a.mean()) + b.mean()
    return np.asarray(laid), float(np.sqrt(np.mean(np.abs(laid[known] - b) ** 2)))
