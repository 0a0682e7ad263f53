"""The heading by the encoders against that by the gyro: its difference, and the levels of its noise, in one state space.

An interval's difference of turns is, with the states of `_Sources.field`,

    y_k = e_k - e_(k-1) - (g_1 + g_2 + g_3 + r) dt + o dphi + q ds / D + laws + w_k

e is the error of ticks and clock, which does not accumulate; g are three Gauss-Markov biases of equal strength (1/f
noise), r a random walk of the bias, o the wandering of the effective track, q that of the wheels' difference (slip that
lasts); w is what accumulates: angle random walk, wheel slip, slip in turns. At rest nothing but the gyro speaks, so rests
are rows like all others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.drive.laws import Frame, difference, slow_changes
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.inference.markov import Given, MarkovField, restricted_maximum
from gyrocal.inference.spread import white_at_rest
from gyrocal.physics.drive import FLICKER_TAUS_S, WANDER_TAU_S
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DEG_TO_RAD, DPH_TO_DPS, STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: 1/f noise, as the Allan deviation shows it, that is usual for an angle random walk of one deg/sqrt(h), deg/h: one log
#: cannot measure it.
_FLOOR_DPH_PER_ARW = 25.0
#: The same as Gauss-Markov parts a decade apart: each has the variance h ln 10 of a decade of the density h / f, whose
#: Allan variance is 2 h ln 2.
_FLICKER_PER_FLOOR = float(np.sqrt(np.log(10.0) / (2.0 * np.log(2.0))))
#: Walk of the bias, in standard deviations of the 1/f noise over its longest memory.
_WALK_PER_FLICKER = 0.3
#: Standard deviations of the levels' logarithms beforehand: of most no more is known than their size, while 1/f noise seldom
#: is far from what is usual.
SPREAD = dict.fromkeys(
    ("slip_m_per_rt_m", "turn", "tick_m", "track_wander", "wheel_wander", "jitter_s", "arw_dps_per_rt_hz"),
    1.5,
) | {"flicker_dps": 0.7, "track_wander_s": 1.0, "wheel_wander_s": 1.0}
#: Levels of which it is told how well the log knows them.
_TOLD_LEVELS = ("slip_m_per_rt_m", "turn", "flicker_dps")
_WALK = "angle_random_walk_deg_per_rt_h"
#: Where the search for the levels begins: wander of track and wheels, jitter of the clock, and an encoder without ticks.
_USUAL_TRACK_WANDER, _USUAL_WHEEL_WANDER, _USUAL_JITTER_S, _USUAL_TICK_M = 0.003, 3e-4, 2e-4, 2e-4
#: Standard deviations above what is usual at which the search begins for levels that others may hide.
_SEEN = 1.5
#: No wheel is read closer than this, m; what is left of its error's variance where it stands. Less would drown in rounding.
_LEAST_TICK_M, _STILL = 1e-6, 1e-5
#: Weight under the noise, of the largest, below which a mixture of columns is nothing but rounding.
_TOLD = 1e-9
#: An interval that says nothing: a gap, a spinning wheel, rad^2.
LEFT_OUT = 1.0
#: Share of the usual speed, and of the usual difference of the sides, below which wheels creep.
_CREEPING = 0.1
#: Robust standard deviations from which on a wheel spins or the gyro spikes, and neighbours that go with it.
_FAR, NEIGHBOURS = 5.0, 2
#: Share of the rows that a median is worth of a scale (its efficiency under a normal law), and of what an interval says that
#: columns leave it at the least.
_MEDIAN_TELLS, _FOLLOWED = 0.37, 1e-6
#: Intervals at rest that tell how widely they scatter, and how often those that stand out are looked for anew.
_FEWEST, _CLEARED = 10, 4


@dataclass(frozen=True)
class YawNoise:
    """Noise levels of encoders and gyro.

    Attributes
    ----------
    arw_dps_per_rt_hz : angle random walk
    slip_m_per_rt_m : of each wheel
    turn : slip in turns, rad per sqrt(rad)
    tick_m : standard deviation of the difference of the two distances that does not accumulate
    flicker_dps : of each of the three Gauss-Markov biases; the walk follows it
    track_wander, track_wander_s : of the effective track, relative, and its memory
    wheel_wander, wheel_wander_s : slip of one wheel against the other that lasts, of the way, and its memory
    jitter_s : of the clock between encoders and gyro
    """

    arw_dps_per_rt_hz: float
    slip_m_per_rt_m: float
    turn: float
    tick_m: float
    flicker_dps: float
    track_wander: float
    track_wander_s: float
    wheel_wander: float
    wheel_wander_s: float
    jitter_s: float

    @property
    def walk_dps_per_rt_s(self) -> float:
        """Random walk of the bias."""
        return _WALK_PER_FLICKER * self.flicker_dps / float(np.sqrt(FLICKER_TAUS_S[-1]))


def usual_flicker_dps(arw_dps_per_rt_hz: float) -> float:
    """1/f noise that goes with an angle random walk, of each Gauss-Markov bias."""
    floor_dps = _FLOOR_DPH_PER_ARW * DPH_TO_DPS * arw_dps_per_rt_hz / DEG_PER_RT_H_TO_DPS_PER_RT_HZ
    return _FLICKER_PER_FLOOR * floor_dps


def usual_noise(series: DriveSeries) -> YawNoise:
    """Noise to begin with: the gyro's white noise from its rows at rest, the rest from robot file and ticks."""
    given = series.robot.noise
    arw, _ = _white(series)
    tick = float(np.hypot(*series.tick_m)) / np.sqrt(12.0)
    return YawNoise(
        max(arw, 1e-6),
        max(given["wheel_slip_m_per_rt_m"], 1e-5),
        max(given["turn_slip_deg_per_rt_deg"] * np.sqrt(DEG_TO_RAD), 1e-5),
        tick if tick > 0 else _USUAL_TICK_M,
        usual_flicker_dps(max(arw, 1e-6)),
        _USUAL_TRACK_WANDER,
        WANDER_TAU_S,
        _USUAL_WHEEL_WANDER,
        WANDER_TAU_S,
        _USUAL_JITTER_S,
    )


def _white(series: DriveSeries) -> tuple[float, float]:
    """The gyro's white noise, dps per sqrt(Hz), and the standard deviation of its logarithm; 0 where a rest or the robot file tells it."""
    seen = white_at_rest(series.gyro_dps, series.resting, series.dt_s)
    if seen is not None and seen.sure:
        return seen.per_rt_hz, 0.0
    told = DEG_PER_RT_H_TO_DPS_PER_RT_HZ * series.robot.noise[_WALK]
    if f"noise.{_WALK}" in series.robot.given or not series.differential:
        return told, 0.0
    return (told, SPREAD["arw_dps_per_rt_hz"]) if seen is None else (seen.per_rt_hz, seen.log_std)


@dataclass(frozen=True)
class _Sources:
    """What noise of each level does in the intervals of a log, whatever the levels are; arrays of shape (m,) and (m, 3).

    Attributes
    ----------
    turn, turned : turn of the robot, and its turns to either side together, rad
    way, ahead : of both wheels together, and of the robot, m
    unseen : square of what the gyro turns meanwhile, rad^2
    fade : what is left of the parts of the 1/f noise
    """

    separation_m: float
    dt_s: Floats
    moving: NDArray[np.bool_]
    turn: Floats
    turned: Floats
    way: Floats
    ahead: Floats
    unseen: Floats
    fade: Floats

    @classmethod
    def of(cls, frame: Frame) -> _Sources:
        """Of a log."""
        nodes, series = frame.nodes, frame.series
        yaw_rad = frame.conditions.gyro_yaw_rad
        return cls(
            series.robot.wheel_separation_m,
            nodes.dt_s,
            ~nodes.resting,
            nodes.between(np.cumsum(yaw_rad)),
            # From left to right and back within an interval is a way, too.
            nodes.between(np.cumsum(np.abs(yaw_rad))),
            nodes.between(np.cumsum(np.abs(series.left_m) + np.abs(series.right_m))),
            nodes.between(np.cumsum(0.5 * (series.left_m + series.right_m))),
            nodes.between(series.gyro_rad) ** 2,
            np.exp(-nodes.dt_s[:, None] / FLICKER_TAUS_S),
        )

    @cached_property
    def _seen(self) -> tuple[Floats, Floats]:
        """Weights of the states before and after an interval in its observation."""
        one, zero, dt = np.ones_like(self.dt_s), np.zeros_like(self.dt_s), self.dt_s
        before = np.column_stack([-one, zero, zero, zero, zero, zero, zero])
        return before, np.column_stack([one, -dt, -dt, -dt, -dt, self.turn, self.ahead / self.separation_m])

    @cached_property
    def _waiting(self) -> NDArray[np.bool_]:
        """Where a wheel between two ticks keeps its error but for what the robot turns meanwhile.

        Were it drawn anew, the waits about each rest would say that there is none, and half a tick in a slow turn would
        look like slip.
        """
        return np.asarray(self.way == 0.0)

    @cached_property
    def _rate_square(self) -> Floats:
        rate = np.divide(self.turn, self.dt_s, out=np.zeros_like(self.dt_s), where=self.dt_s > 0)
        return np.asarray(rate**2)

    @cached_property
    def _faded(self) -> Floats:
        return 1.0 - self.fade**2

    def field(self, noise: YawNoise, left_out: Floats) -> MarkovField:
        """The states e, g_1, g_2, g_3, r, o, q of the log at these levels."""
        tick = (max(noise.tick_m, _LEAST_TICK_M) / self.separation_m) ** 2
        unsteady = tick + noise.jitter_s**2 * self._rate_square
        flicker, walk = ((DEG_TO_RAD * x) ** 2 for x in (noise.flicker_dps, noise.walk_dps_per_rt_s))
        levels = np.array([flicker] * 3 + [noise.track_wander**2, noise.wheel_wander**2])
        keep, push = np.empty((2, self.dt_s.size, 7))
        keep[:, 0], keep[:, 1:4], keep[:, 4] = self._waiting, self.fade, 1.0
        keep[:, 5:] = np.exp(-self.dt_s[:, None] / [noise.track_wander_s, noise.wheel_wander_s])
        held = _STILL * unsteady + self.moving * self.unseen
        push[:, 0], push[:, 4] = np.where(self._waiting, held, unsteady), walk * self.dt_s
        push[:, 1:4], push[:, 5:] = levels[:3] * self._faded, levels[3:] * (1.0 - keep[:, 5:] ** 2)
        white = (DEG_TO_RAD * noise.arw_dps_per_rt_hz) ** 2 * self.dt_s
        slipping = (noise.slip_m_per_rt_m / self.separation_m) ** 2 * self.way + noise.turn**2 * self.turned
        start = np.array([unsteady.max(), *levels[:3], 1e-4 * flicker + 1e-20, *levels[3:]])
        whole = white + slipping * self.moving + left_out + 1e-18
        return MarkovField(start, keep, np.maximum(push, 1e-24), *self._seen, whole)


@dataclass(frozen=True)
class YawModel:
    """Noise of a log, and which intervals say nothing.

    Attributes
    ----------
    y : ndarray, shape (m,)
        Encoder turn minus gyro turn, rad.
    left_out : ndarray, shape (m,)
        Variance added to gaps and outliers, rad^2.
    outliers : ndarray
        Intervals where a wheel spun or the gyro spiked.
    log_std : mapping
        Standard deviation of the logarithm of wheel slip, slip in turns and 1/f noise, as far as the log was asked for
        them, by their fields of `YawNoise`.
    """

    frame: Frame
    y: Floats
    noise: YawNoise
    usual: YawNoise
    left_out: Floats
    outliers: Ints
    log_std: Mapping[str, float]

    @property
    def white(self) -> Floats:
        """Variance of what accumulates in each interval, rad^2."""
        return self._sources.field(self.noise, self.left_out).noise

    @cached_property
    def _sources(self) -> _Sources:
        return _Sources.of(self.frame)

    def given(self, columns: Floats, flicker_dps: float | None = None) -> Given:
        """Columns under the noise, at a level of 1/f noise of one's own where one is given."""
        noise = self.noise if flicker_dps is None else replace(self.noise, flicker_dps=flicker_dps)
        return self._sources.field(noise, self.left_out).given(columns)


@dataclass(frozen=True)
class NoiseSearch:
    """The noise of a log with columns free in the mean, looked for once for each choice of intervals that are left out.

    Attributes
    ----------
    y : ndarray, shape (m,)
        Encoder turn minus gyro turn, rad.
    columns : ndarray, shape (m, k)
        Free in the mean, independent of each other under the noise that is usual.
    left_out : ndarray, shape (m,)
        Variance added to gaps and wherever else nothing is known of the robot, rad^2.
    """

    frame: Frame
    y: Floats
    usual: YawNoise
    columns: Floats
    left_out: Floats
    _sources: _Sources
    _known: dict[bytes, tuple[YawNoise, dict[str, float]]] = field(default_factory=dict)

    def without(self, left_out: Floats, outliers: Ints) -> YawModel:
        """The noise where some intervals are left out."""
        key = left_out.tobytes()
        if key not in self._known:
            self._known[key] = _levels(self.frame, self._sources, self.y, self.columns, self.usual, left_out)
        noise, log_std = self._known[key]
        return YawModel(self.frame, self.y, noise, self.usual, left_out, outliers, log_std)


def noise_search(frame: Frame, means: Sequence[Floats]) -> NoiseSearch:
    """The search for the noise of a log with columns, and slow changes, free in the mean."""
    usual = usual_noise(frame.series)
    # Between the rest at the start and the first tick nobody knows whether the robot moves, and with it its bias.
    starting = ~frame.nodes.resting & ~frame.series.moved[frame.nodes.rows[:-1]]
    unknown = frame.nodes.broken | starting | _creeping(frame) | frame.beyond
    left_out = np.where(unknown, LEFT_OUT, 0.0)
    if not frame.series.differential:
        left_out = np.where(frame.nodes.resting, left_out, LEFT_OUT)
    sources = _Sources.of(frame)
    columns = _independent(np.column_stack([*means, *slow_changes(frame)]), sources.field(usual, left_out))
    return NoiseSearch(frame, difference(frame), usual, columns, left_out, sources)


def yaw_model(search: NoiseSearch, events: Ints) -> YawModel:
    """Estimate the noise, then again without the intervals that stand out.

    Parameters
    ----------
    events : ndarray, shape (e,)
        Intervals that are known to, beside those that are found.
    """
    left_out = search.left_out
    model = search.without(left_out, np.zeros(0, dtype=np.int64))
    score = _scores(model, search.columns)
    found = [events, _outliers(model, score), _turned_by_hand(model, score)]
    for _ in range(_CLEARED):
        outliers = np.unique(np.concatenate([model.outliers, *found]))
        if outliers.size == model.outliers.size:
            break
        near = np.clip(outliers[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1), 0, left_out.size - 1)
        left_out = left_out.copy()
        left_out[near.ravel()] = LEFT_OUT
        # From the start again: with the outliers the fit may have gone astray for good.
        model = search.without(left_out, outliers)
        found = [_turned_by_hand(model, _scores(model, search.columns))]
    return _with_usual_flicker(model)


def _creeping(frame: Frame) -> NDArray[np.bool_]:
    """Intervals in which wheels set off or come to stand: what motion adds to a bias may begin and end at any speed of these.

    Slow wheels err by nothing, and by the shape of its edges alone a bias in motion would be sure. A robot that turns on the
    spot has slow wheels, too, and is in full motion: it is slow in its turn as well where it creeps.
    """
    nodes = frame.nodes
    # Wheels that jump by themselves creep no more than those of a robot that goes on do.
    smooth, own = (np.abs(x.left_m) + np.abs(x.right_m) for x in (frame.steady, frame.series))
    between_s = np.where(nodes.dt_s > 0, nodes.dt_s, np.inf)
    speed_mps = nodes.between(np.cumsum(np.maximum(smooth, own))) / between_s
    apart_mps = np.abs(nodes.between(np.cumsum(frame.series.right_m - frame.series.left_m))) / between_s
    moving = ~nodes.resting
    if not moving.any():
        return moving
    usual_mps = float(np.median(speed_mps[moving]))
    turning_mps = float(np.sqrt(np.mean(apart_mps[moving] ** 2)))
    return np.asarray(moving & (speed_mps < _CREEPING * usual_mps) & (apart_mps <= _CREEPING * turning_mps))


def _with_usual_flicker(model: YawModel) -> YawModel:
    """The model with what is usual for the white noise that was found."""
    flicker_dps = usual_flicker_dps(model.noise.arw_dps_per_rt_hz)
    return replace(model, usual=replace(model.usual, flicker_dps=flicker_dps))


def _independent(columns: Floats, field: MarkovField) -> Floats:
    """Columns of the same span that have nothing in common under the noise of a field.

    Laws that differ by a lag alone do so by a millionth of their weight, and less than arithmetic tells is left out.
    """
    gram = field.given(columns).gram
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    weight, axes = np.linalg.eigh(gram / np.outer(size, size))
    told = weight > _TOLD * weight[-1]
    return np.asarray(columns / size @ axes[:, told] / np.sqrt(weight[told]))


def _levels(
    frame: Frame, sources: _Sources, y: Floats, columns: Floats, usual: YawNoise, left_out: Floats
) -> tuple[YawNoise, dict[str, float]]:
    """Levels of the noise, and the standard deviation of the logarithm of each of `_TOLD_LEVELS`."""
    spreads = SPREAD | {"arw_dps_per_rt_hz": _white(frame.series)[1]}
    names = [n for n in SPREAD if spreads[n] > 0]
    if not frame.series.differential:
        names = ["flicker_dps"]

    def noise_of(logs: Floats) -> YawNoise:
        found = replace(usual, **{n: float(np.exp(x)) for n, x in zip(names, logs, strict=True)})
        # 1/f noise is usual for a white noise, so that one level is their ratio.
        times = found.arw_dps_per_rt_hz / usual.arw_dps_per_rt_hz
        return replace(found, flicker_dps=times * found.flicker_dps)

    prior = np.log([getattr(usual, n) for n in names])
    spread = np.array([spreads[n] for n in names])
    # From a level that is lost beneath the others the search sees no slope.
    first = prior + spread * [_SEEN * (n in ("track_wander", "wheel_wander", "jitter_s")) for n in names]
    told = [n for n in _TOLD_LEVELS if n in names]
    logs, stds = restricted_maximum(
        lambda logs: sources.field(noise_of(logs), left_out),
        y,
        columns,
        prior,
        spread,
        first,
        [names.index(n) for n in told],
    )
    left = dict(zip(told, stds.tolist(), strict=True))
    # A log cannot measure its 1/f noise, and the variance of a bias goes by the square: taken as its mean over all levels
    # that are possible, not as that of the likeliest one.
    logs[names.index("flicker_dps")] += left["flicker_dps"] ** 2
    return noise_of(logs), left


def _outliers(model: YawModel, score: Floats) -> Ints:
    """Intervals in motion that stand out.

    Those of several speeds have heavier tails than a normal law: the scale is their own.
    """
    moving = ~model.frame.nodes.resting & (model.left_out == 0)
    if not moving.any():
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(moving & (score > _FAR * STDS_PER_MAD * float(np.median(score[moving]))))


def _turned_by_hand(model: YawModel, score: Floats) -> Ints:
    """Intervals at rest in which the gyro turns as in no other, none less than half as much as the most.

    A robot that is turned while its wheels stand has no gyro of another bias. What this does to the noise hides what is
    less, and makes more of what is nothing: it is looked at again without.
    """
    resting = model.frame.nodes.resting & (model.left_out == 0)
    if np.count_nonzero(resting) < _FEWEST:
        return np.zeros(0, dtype=np.int64)
    score = np.where(resting, score, 0.0)
    scale = STDS_PER_MAD * float(np.median(score[resting]))
    # So few intervals tell their own scale to a few degrees of freedom.
    far = float(stats.t.isf(stats.norm.sf(_FAR), _MEDIAN_TELLS * np.count_nonzero(resting)))
    least = max(far * scale, 0.5 * float(score.max()))
    return np.flatnonzero(score > least)


def _scores(model: YawModel, columns: Floats) -> Floats:
    """How far each interval is from what all others say of it, in standard deviations under the noise; 0 where they say nothing."""
    given = model.given(np.column_stack([columns, model.y]))
    weighed, gram, alone = given.inverse(), given.gram[:-1], given.inverse_diagonal()
    inverse = np.linalg.pinv(gram[:, :-1], hermitian=True)
    off = np.abs(weighed[:, -1] - weighed[:, :-1] @ inverse @ gram[:, -1])
    # Of an interval that columns follow wherever it lies nothing is left to be looked at.
    left = alone - np.einsum("ij,jk,ik->i", weighed[:, :-1], inverse, weighed[:, :-1])
    told = left > _FOLLOWED * alone
    return np.where(told, off / np.sqrt(np.where(told, left, 1.0)), 0.0)
