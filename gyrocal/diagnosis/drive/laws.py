"""Laws of the heading difference: what each law of `gyrocal.physics.drive` adds to encoder turn minus gyro turn.

A further law is a row of `KINDS` and its column in `candidate_laws`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.series import SMOOTH_S, Bools, DriveSeries, Nodes, averaged, usual_step_s
from gyrocal.diagnosis.remarks import Said
from gyrocal.physics.drive import (
    BIAS_TEMPERATURE,
    GYRO_BIAS,
    GYRO_DELAY,
    SKID_SLIP,
    START_STOP_SLIP,
    WHEEL_ASYMMETRY,
    WHEEL_ECCENTRICITY,
    DriveConditions,
    DriveEffect,
)
from gyrocal.physics.slip import SLIP_LAWS
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]

#: Catalogue units in one SI unit of a coefficient (deg/s for rates of the gyro).
PER_SI = {"%": 1e2, "ppm": 1e6, "mdeg/s": 1e3, "mdeg/s per degC": 1e3, "s": 1.0, "s^2/m": 1.0}
#: Small enough for the laws that are not linear in their amplitude, SI.
_SMALL = 1e-3
#: Curvatures of half saturation that are tried.
HALF_CURVATURES = (0.1, 0.3, 1.0)
#: Lags with which a bias that comes with the motion is tried to follow it, s: at once, or as what was shaken or loaded settles.
MOVING_LAGS_S = (0.0, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
#: Names of these laws, each with its lag, and that without one.
MOVING = {f"moving_{lag_s:g}": lag_s for lag_s in MOVING_LAGS_S}
AT_ONCE = "moving_0"
#: Time constants with which a bias may settle after the start of a log, s: gyros warm up by themselves within minutes. A tenth of
#: a decade apart, so that what one lacks of the next is no law of its own.
SETTLING_S = (
    20.0,
    25.0,
    32.0,
    40.0,
    50.0,
    63.0,
    80.0,
    100.0,
    125.0,
    160.0,
    200.0,
    250.0,
    320.0,
    400.0,
    500.0,
    630.0,
    800.0,
    1000.0,
)
#: Names of these laws, each with its time.
SETTLING = {f"settling_{settling_s:g}": settling_s for settling_s in SETTLING_S}
#: A temperature that changes less tells nothing of the bias over it, degC.
_LEAST_TEMP_SPAN_C = 0.5
#: A bias at rest of its own is looked for where the log begins with a rest this long, s, or has one later.
_LEAST_REST_S = 5.0
#: Temperatures are means over so long, s, or a tenth of a short log: gyros have more inertia than that.
_TEMP_SMOOTH_S, _TEMP_SMOOTH_SHARE = 10.0, 0.1
#: Cells of the ground across the path, those looked at, after how long a robot has come back to one (five memories of the
#: track's wander), s, and how much it must turn in one, deg.
_ACROSS, _MOST_CELLS, _BACK_S, _TURNED_DEG = 6, 12, 20.0, 60.0
#: Waves over a drive in which wheels and track may change: what lasts for less of it is slip.
_SLOW = 4
#: Speeds for the shape of a law are means over this time, s: in a turn the outer wheel goes further and slips more, so
#: that a node's speed shares noise with the difference of its turns, and a slow robot's looks like slip by speed.
SPEED_SMOOTH_S = 0.5


@dataclass(frozen=True)
class Kind:
    """What is to be known of a law beside its column.

    Attributes
    ----------
    shown : str
        Its name among the estimates.
    figure, unit : str
        Of the gyro: its field of `Figures`, which is its key below ``gyro`` in the robot file too, and the unit of both; a law
        of the wheels without a unit is a share.
    group : str
        Laws of one group stand for each other: only one of them is taken.
    lag_s : float
        By which it follows the motion, or with which it settles after the start.
    said, said_below_zero : Said, optional
        What is said where it is named, whatever its size or below zero.
    """

    shown: str
    figure: str = ""
    unit: str = ""
    group: str = ""
    lag_s: float = 0.0
    said: Said | None = None
    said_below_zero: Said | None = None


_SHAKEN = Kind("gyro_bias_while_moving", "bias_moving_dps", "deg/s", "motion", said=Said.BIAS_WHILE_MOVING)
_SETTLES = Kind("gyro_bias_settling", "bias_settling_dps", "deg/s", "settling")
_SLIP = Kind(SKID_SLIP.id, group="slip", said_below_zero=Said.TURNS_INWARD)
#: Every law by its name in a fit.
KINDS: Mapping[str, Kind] = {
    "bias": Kind(GYRO_BIAS.id, "bias_dps", "deg/s"),
    "track": Kind("effective_track", said_below_zero=Said.TURNS_INWARD),
    "asymmetry": Kind(WHEEL_ASYMMETRY.id),
    "step": Kind("gyro_bias_in_motion", "bias_motion_dps", "deg/s", "motion", said=Said.BIAS_IN_MOTION),
    **{name: replace(_SHAKEN, lag_s=lag_s) for name, lag_s in MOVING.items()},
    **{name: replace(_SETTLES, lag_s=settling_s) for name, settling_s in SETTLING.items()},
    "jump": Kind("gyro_bias_jump", "bias_before_dps", "deg/s"),
    "slope": Kind(BIAS_TEMPERATURE.id, "bias_slope_dps_per_c", "deg/s per degC"),
    "delay": Kind(GYRO_DELAY.id, "delay_s", "s", said_below_zero=Said.ENCODERS_LATE),
    "slip_turn_rate": _SLIP,
    "slip_curvature": _SLIP,
    **{f"slip_saturating_{half:g}": _SLIP for half in HALF_CURVATURES},
    "spinning": Kind(START_STOP_SLIP.id, unit="s^2/m", group="spinning"),
    "wheel_cos": Kind(WHEEL_ECCENTRICITY.id),
    "wheel_sin": Kind(WHEEL_ECCENTRICITY.id),
}


def group_of(name: str) -> str:
    """The laws that stand for each other, of which only one is taken; of most there is but one."""
    return KINDS[name].group or name


def is_motion(name: str) -> bool:
    """Whether a law is of a bias that comes with the motion."""
    return KINDS[name].group == "motion"


def is_slip(name: str) -> bool:
    """Whether a law is of wheels that slip in turns."""
    return KINDS[name].group == "slip"


@dataclass(frozen=True)
class Law:
    """A law at fixed shape: `effect` and `shape` are of the catalogue, `column` is its turn in rad for one SI unit."""

    effect: str
    shape: Mapping[str, float]
    column: Floats


@dataclass(frozen=True)
class BiasLaws:
    """What the heading difference knows of the laws of the gyro's bias, and how the gyro's noise has moved that.

    Attributes
    ----------
    names : tuple of str
        Of p laws, the constant bias first.
    covariance : ndarray, shape (p, p)
        Of their coefficients.
    t_s : ndarray, shape (m,)
        Ends of the intervals.
    weights : ndarray, shape (p, m)
        What 1 rad that the gyro falls short by in each interval adds to each coefficient.
    """

    names: tuple[str, ...]
    covariance: Floats
    t_s: Floats
    weights: Floats

    def weights_between(self, edges_s: Floats) -> Floats:
        """Mean weights of the turns between edges, shape (p, cells)."""
        ends_s = np.concatenate([edges_s[:1], self.t_s])
        whole = np.cumsum(self.weights * np.diff(ends_s), axis=1)
        at_edges = [np.interp(edges_s, ends_s, [0.0, *one]) for one in whole]
        return np.asarray(np.diff(at_edges, axis=1) / np.diff(edges_s))


@dataclass(frozen=True)
class Frame:
    """What the laws are worked out on: smooth conditions, the gyro taken `ahead_s` later and over `window_s`.

    Attributes
    ----------
    conditions : DriveConditions
        Row by row. Turn rates are means over `SMOOTH_S` without the bias, zero where no wheel moves, and the wheels are put
        together from them and the mean distance: a law must share no noise with the difference that it explains.
    steady : DriveConditions
        The same with a speed averaged over longer, for what goes by speed.
    growing : DriveConditions
        The same with a speed averaged twice, for what goes by its changes: whole ticks come and go from row to row, and what of
        that rises would be a scale of the wheels.
    rate_rad_s : ndarray, shape (n,)
        Turn rate at the time of each row.
    """

    series: DriveSeries
    nodes: Nodes
    ahead_s: float
    window_s: float
    conditions: DriveConditions
    steady: DriveConditions
    growing: DriveConditions
    rate_rad_s: Floats

    @property
    def beyond(self) -> Bools:
        """Intervals of which the gyro, taken later, has not logged all: those at an end of the log."""
        t_s, rows, half_s = self.series.t_s, self.nodes.rows, 0.5 * self.window_s
        begins_s, ends_s = t_s[rows[:-1]] + self.ahead_s - half_s, t_s[rows[1:]] + self.ahead_s + half_s
        return np.asarray((begins_s < t_s[0]) | (ends_s > t_s[-1]))


def temperature_c(series: DriveSeries) -> Floats | None:
    """Gyro temperature row by row, averaged over 10 s, or a tenth of a short log; None where it is not known or hardly changes."""
    known = np.isfinite(series.temp_c)
    if not known.any() or np.ptp(series.temp_c[known]) < _LEAST_TEMP_SPAN_C:
        return None
    temp = np.interp(series.t_s, series.t_s[known], series.temp_c[known])
    whole = np.cumsum(temp * series.dt_s)
    smooth_s = min(_TEMP_SMOOTH_S, _TEMP_SMOOTH_SHARE * series.duration_s)
    begin = np.maximum(series.t_s - 0.5 * smooth_s, series.t_s[0])
    end = np.minimum(series.t_s + 0.5 * smooth_s, series.t_s[-1])
    return np.asarray(
        (np.interp(end, series.t_s, whole) - np.interp(begin, series.t_s, whole)) / (end - begin)
    )


def reference_temp_c(series: DriveSeries) -> float:
    """Temperature to which the constant bias belongs: that of the rest at the start, or the mean; NaN: unknown."""
    temp = temperature_c(series)
    if temp is None:
        known = np.isfinite(series.temp_c)
        return float(np.mean(series.temp_c[known])) if known.any() else float("nan")
    rest = ~series.moved
    return float(np.mean(temp[rest] if series.first_rest_s >= _LEAST_REST_S else temp))


def frame_of(series: DriveSeries, nodes: Nodes, ahead_s: float, window_s: float, bias_dps: float) -> Frame:
    """Smooth conditions of a log; `bias_dps` is taken off the turn rates."""
    t, dt_s = series.t_s, series.dt_s
    heading = averaged(t, series.gyro_rad, ahead_s, window_s) - DEG_TO_RAD * bias_dps * t
    way, temp = np.cumsum(series.step_m), temperature_c(series)

    def slope(at_s: Floats, channel: Floats, over_s: float) -> Floats:
        change = np.interp(at_s + 0.5 * over_s, t, channel) - np.interp(at_s - 0.5 * over_s, t, channel)
        # Where no wheel moves the gyro's rate is its noise, and a law of it would explain the difference perfectly.
        return np.where(series.quiet, 0.0, change / over_s)

    spread_s = max(SMOOTH_S, usual_step_s(t))
    # A row holds what happened since the one before.
    rate = slope(t - 0.5 * dt_s, heading, spread_s)
    across = 0.5 * series.robot.wheel_separation_m * rate

    def over(time_s: float, gone: Floats = way) -> DriveConditions:
        speed = slope(t - 0.5 * dt_s, gone, time_s)
        return DriveConditions(
            t, dt_s, (speed - across) * dt_s, (speed + across) * dt_s, RAD_TO_DEG * rate,
            series.robot.wheel_separation_m, temp,
        )  # fmt: skip

    long_s = max(spread_s, SPEED_SMOOTH_S)
    steady, growing = over(long_s), over(long_s, averaged(t, way, 0.0, long_s))
    return Frame(
        series, nodes, ahead_s, window_s, over(spread_s), steady, growing, slope(t, heading, spread_s)
    )


def difference(frame: Frame) -> Floats:
    """Encoder turn minus gyro turn over each interval, rad."""
    s = frame.series
    gyro = averaged(s.t_s, s.gyro_rad, frame.ahead_s, frame.window_s)
    return frame.nodes.between(s.encoder_rad - gyro)


def law(frame: Frame, effect: DriveEffect, where: Floats | None = None, **shape: float) -> Law:
    """One law of the catalogue at a small amplitude, divided by it; `where` weighs its rows."""
    size = _SMALL * PER_SI[effect.parameters[0].unit]
    by_speed = {SKID_SLIP: frame.steady, START_STOP_SLIP: frame.growing}
    conditions = by_speed.get(effect, frame.conditions)
    change, _ = effect.change(conditions, effect.complete({"amplitude": size, **shape}), None)
    turn = (change.encoder_yaw_rad - change.gyro_yaw_rad) / _SMALL
    return Law(effect.id, shape, frame.nodes.between(np.cumsum(turn if where is None else turn * where)))


def late(frame: Frame) -> Law:
    """A gyro that is late: what its turn lacks of each interval is the change of the rate over it."""
    return Law(GYRO_DELAY.id, {}, frame.nodes.between(frame.rate_rad_s))


def constant_laws(frame: Frame) -> dict[str, Law]:
    """Laws that every fit has: bias, and of a vehicle whose wheels differ the track and the wheels' asymmetry."""
    found = {"bias": law(frame, GYRO_BIAS)}
    if frame.series.differential:
        found["track"] = law(frame, SKID_SLIP, law=0.0, shape=0.0)
        found["asymmetry"] = law(frame, WHEEL_ASYMMETRY)
    return found


def candidate_laws(frame: Frame) -> dict[str, Law]:
    """Laws that a log may hold besides; only those that it can show."""
    series, found = frame.series, {}
    if series.first_rest_s >= _LEAST_REST_S:
        found["step"] = law(frame, GYRO_BIAS, where=series.moved.astype(np.float64))
    # Without a later rest it is the step, and with the shortest that one may be denied.
    if np.any(series.resting & series.moved):
        for name, lag_s in MOVING.items():
            found[name] = law(frame, GYRO_BIAS, where=series.moving(lag_s))
    temp = frame.conditions.temp_c
    if temp is not None:
        slope = law(frame, BIAS_TEMPERATURE)
        # The law counts from the first row, the constant bias belongs to the reference temperature.
        away = float(temp[0]) - reference_temp_c(series)
        found["slope"] = Law(slope.effect, slope.shape, slope.column + away * law(frame, GYRO_BIAS).column)
    if series.differential:
        found["delay"] = late(frame)
        found["spinning"] = law(frame, START_STOP_SLIP)
        found["slip_turn_rate"] = law(frame, SKID_SLIP, law=0.0, shape=1.0)
        found["slip_curvature"] = law(frame, SKID_SLIP, law=float(SLIP_LAWS.index("curvature")), shape=1.0)
        saturating = float(SLIP_LAWS.index("curvature_saturating"))
        for half in HALF_CURVATURES:
            found[f"slip_saturating_{half:g}"] = law(frame, SKID_SLIP, law=saturating, shape=half)
    return found


def settling_laws(frame: Frame) -> dict[str, Law]:
    """A bias that settles after the start, where a rest there may have seen another one than the drive, or a temperature may stand for it.

    Of no name, for no robot file holds them: that gyros warm up by themselves may be all that a step of the bias stands for,
    or one that goes with a temperature that rises all the time.
    """
    if frame.series.first_rest_s < _LEAST_REST_S and frame.conditions.temp_c is None:
        return {}
    columns = {n: law(frame, GYRO_BIAS, where=settling(frame.series, s)).column for n, s in SETTLING.items()}
    return {n: Law(BIAS_TEMPERATURE.id, {}, column) for n, column in columns.items()}


def settling(series: DriveSeries, settling_s: float) -> Floats:
    """What is left in each row of a bias that settles after the start of a log."""
    return np.asarray(np.exp(-(series.t_s - series.t_s[0]) / settling_s))


def jump(frame: Frame, at_s: float) -> Law:
    """A bias that is another one until an instant."""
    one = law(frame, GYRO_BIAS, where=(frame.series.t_s < at_s).astype(np.float64))
    return replace(one, shape={"until_s": at_s})


def wheel_laws(frame: Frame, side: float, radius_m: float) -> tuple[Law, Law]:
    """A wheel out of true, cosine and sine."""
    first, second = (
        law(frame, WHEEL_ECCENTRICITY, side=side, wheel_radius_m=radius_m, phase_rad=phase)
        for phase in (0.0, 0.5 * np.pi)
    )
    return first, second


def strangers(frame: Frame) -> dict[str, Floats]:
    """Columns of no name, one block for each coordinate: what no law of the catalogue does; coordinate -> (m, k)."""
    c, series = frame.conditions, frame.series
    if not series.differential:
        return {}
    turn, way = c.gyro_yaw_rad, c.distance_m
    speed, even = (
        np.divide(smooth.distance_m, c.dt_s, out=np.zeros_like(way), where=c.dt_s > 0)
        for smooth in (frame.steady, frame.growing)
    )
    share = (c.t_s - c.t_s[0]) / series.duration_s - 0.5
    heading = np.cumsum(turn)
    acceleration = np.gradient(even, c.t_s) if np.all(np.diff(c.t_s) > 0) else np.zeros_like(even)
    growth = acceleration * np.sign(even)
    delay = late(frame).column
    moving = np.abs(speed) > 0
    edges = np.quantile(np.abs(speed[moving]), [1 / 3, 2 / 3]) if moving.any() else np.zeros(2)
    steps = [np.abs(speed) > edge for edge in edges]
    rows = {
        # Each wheel's scale in two steps of the speed.
        "speed": [x * step for x in (c.left_m, c.right_m) for step in steps] + [way * np.abs(speed)],
        "time": [turn * share, way * share, way * share**2],
        # A wheel's way and what a gyro lacks of a turn, as on a slope, and what a field of the earth adds to a gyro.
        "heading": [f(heading) * way for f in (np.cos, np.sin)]
        + [f(2 * heading) * turn for f in (np.cos, np.sin)]
        + [f(heading) * c.dt_s for f in (np.cos, np.sin)],
        "turn_rate": [turn * (turn > 0), turn * c.gyro_dps, turn * c.gyro_dps**2],
        # Wheels that slide as they brake beside those that spin, which have a name.
        "acceleration": [
            acceleration * c.dt_s,
            np.abs(acceleration) * way,
            growth * way,
            turn * np.maximum(-growth, 0.0),
        ],
    }
    ground = by_place(c.t_s, heading, way, turn)
    if ground:
        rows["place"] = ground
    found = {name: frame.nodes.between(np.cumsum(np.stack(v, axis=1), axis=0)) for name, v in rows.items()}
    at = (frame.nodes.t_s - c.t_s[0]) / series.duration_s - 0.5
    return found | {"delay": (delay * at)[:, None]}


def slow_changes(frame: Frame) -> list[Floats]:
    """Wheels and track that are others from one part of a drive to the next: too slowly for noise, and of no name."""
    c, series = frame.conditions, frame.series
    if not series.differential:
        return []
    share = (c.t_s - c.t_s[0]) / series.duration_s
    waves = [np.cos(np.pi * k * share) for k in range(1, _SLOW + 1)]
    rows = [x * wave for x in (c.gyro_yaw_rad, c.distance_m) for wave in waves]
    return [frame.nodes.between(np.cumsum(row)) for row in rows]


def by_place(t_s: Floats, heading_rad: Floats, way_m: Floats, turn_rad: Floats) -> list[Floats]:
    """Turns in each cell of the ground to which the robot comes back, less their share of all turns.

    A track that wanders is another one each time; that of a patch of ground is the same.
    """
    at = np.cumsum(way_m * np.exp(1j * heading_rad))
    side_m = max(float(np.ptp(at.real)), float(np.ptp(at.imag)), 1e-9) / _ACROSS
    column, row = (np.floor((x - x.min()) / side_m).astype(np.int64) for x in (at.real, at.imag))
    cell = column * (2 * _ACROSS) + row
    turned = {}
    for one in np.unique(cell):
        inside = cell == one
        come_s = t_s[np.flatnonzero(np.diff(inside.astype(np.int64), prepend=0) == 1)]
        turns_rad = float(np.sum(np.abs(turn_rad[inside])))
        if np.any(np.diff(come_s) > _BACK_S) and turns_rad > DEG_TO_RAD * _TURNED_DEG:
            turned[one] = turns_rad
    whole_rad = max(float(np.sum(np.abs(turn_rad))), 1e-9)
    most = sorted(turned, key=lambda one: -turned[one])[:_MOST_CELLS]
    return [turn_rad * ((cell == one) - turned[one] / whole_rad) for one in most]
