"""Noise of a drive by maximum likelihood of the filter's own innovations, where the robot file is silent.

`gyrocal.diagnosis.drive.yaw` estimates the same levels in another way, and neither can serve for both. The diagnosis asks
for laws: it looks back and ahead, keeps every law free in the mean and takes no prior of the robot file for them. A
runtime must have the levels with which this very filter, its gates, its file and its rests describe the log.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from gyrocal.errors import DataError
from gyrocal.fusion import FilterNoise, Navigator, RobotParameters, Rows
from gyrocal.fusion.robot import SEPARATION_RELATIVE_STD
from gyrocal.inference.spread import white_at_rest
from gyrocal.physics.drive import TICK_WAITS_S
from gyrocal.records.robot import Robot
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPH_TO_DPS

Floats = NDArray[np.float64]

#: Noise that is estimated: figure -> its usual size on a wheeled robot and the spread of its logarithm.
USUAL: Mapping[str, tuple[float, float]] = {
    "wheel_slip_m_per_rt_m": (1e-3, 2.0),
    "turn_slip_deg_per_rt_deg": (0.1, 2.0),
    "tick_m": (5e-4, 2.0),
    "jitter_s": (2e-3, 2.0),
    "track_wander": (0.01, 2.0),
    "wheel_wander": (5e-4, 2.0),
    "flicker_dps": (math.nan, 0.7),  # by the angle random walk
}
#: A gyro's flicker in deg/h for each deg/sqrt(h) of its angle random walk (drive-report.md, section 1).
_FLICKER_BY_WALK = 25.0
#: Spread of the logarithm of an angle random walk of which nothing is known but its default.
_WALK_SPREAD = 1.5
#: Innovations of a filter that describes the log. On 210 second drives they were 0.98 to 1.02 and at most 0.06 in nine of
#: ten, and 7 were outside (a wheel out of true, a clock that drifts, a one-sided scale). Encoders that are smoothed or late
#: are far outside; the Husky's, with their window and delay taken out, still show 0.14, and the filter errs 1.4 times there.
NIS_RANGE, LAG1_LIMIT = (0.75, 1.33), 0.1
#: Innovations that are summed, some 10 s of driving: an error that comes back (a wheel that is loaded on a slope, by heading)
#: hides in each beneath the ticks, and not in their sum. How seldom those of a filter that describes the log are as large.
_SUMMED, _SELDOM = 100, 1e-3
_WALK = "angle_random_walk_deg_per_rt_h"
#: Shares of the bias that is thought possible beforehand, from which the rests of a log choose.
BIAS_SHARES = tuple(2.0**-k for k in range(6))
#: And multiples of it, for a file that is too sure.
_WIDER = (2.0, 4.0, 8.0, 16.0)
#: No noise figure is known better than this share of its value.
_FIRMEST = 0.05
#: Misfit of a filter whose path is no longer finite: more than that of any other.
_RUNAWAY = 1e12


def rest_walk(rows: Rows) -> float | None:
    """Angle random walk in deg/sqrt(h) from the rows at rest; None where they tell none."""
    moving = np.flatnonzero(np.abs(rows.left_m) + np.abs(rows.right_m) > 0.0)
    after = np.searchsorted(moving, np.arange(rows.t_s.size))
    ends = np.concatenate([[-math.inf], rows.t_s[moving], [math.inf]])
    rest = (rows.t_s - ends[after] > TICK_WAITS_S[1]) & (ends[after + 1] - rows.t_s > TICK_WAITS_S[1])
    rest &= np.isfinite(rows.gyro_dps)
    white = white_at_rest(rows.gyro_dps, rest, np.diff(rows.t_s, prepend=rows.t_s[0]))
    return white.per_rt_hz / DEG_PER_RT_H_TO_DPS_PER_RT_HZ if white is not None and white.sure else None


def fit_noise(
    rows: Rows, robot: Robot, navigator: Callable[..., Navigator], *, sides: bool = True
) -> RobotParameters:
    """The robot with its noise figures by maximum posterior likelihood on these rows.

    A figure that the file gives with a standard deviation is held by it, one without by a factor of e, and one that the
    file does not give by its usual size (`USUAL`). The angle random walk is the file's, or that of the rows at rest, or,
    where neither tells, one of the figures that are estimated.

    Parameters
    ----------
    navigator : callable
        Makes a navigator that starts at the first row, from what it is to be told of the robot and whether it filters.
    sides : bool
        Whether the rows have a distance of each side; of one speed nothing but the rests tells of noise.
    """
    parameters = robot.parameters
    walk = None if f"noise.{_WALK}" in robot.given else rest_walk(rows)
    if walk is not None:
        noise = replace(parameters.noise, angle_random_walk_deg_per_rt_h=walk)
        silent = "initial_std.gyro_bias_dps" not in robot.given
        std = replace(parameters.initial_std, gyro_bias_dps=None) if silent else parameters.initial_std
        parameters = replace(parameters, noise=noise, initial_std=std)
    if robot.static_s == 0.0:
        smaller = () if "initial_std.gyro_bias_dps" in robot.given else BIAS_SHARES[1:]
        parameters = _likely_bias(rows, parameters, navigator, (1.0, *_WIDER, *smaller))
    names, usual, spread = _priors(
        robot, parameters, open_walk=walk is None and f"noise.{_WALK}" not in robot.given
    )
    wide, usual_walk = _wide(parameters), _usual_walk(parameters)

    def told(logs: Floats, base: RobotParameters) -> RobotParameters:
        noise = dict(zip(names, np.exp(logs).tolist(), strict=True))
        # 1/f noise is usual for a white noise, so that one level is their ratio.
        noise["flicker_dps"] *= noise.get(_WALK, usual_walk) / usual_walk
        return replace(base, noise=replace(base.noise, **noise))

    def cost(logs: Floats) -> float:
        try:
            found = misfit(rows, navigator(told(logs, wide)))
        except DataError:
            # With such levels the filter runs away; with those that are chosen it must not, or replay says so.
            found = _RUNAWAY
        return float(np.sum(((logs - usual) / spread) ** 2)) + found

    if not sides:
        return told(usual, parameters)
    bounds = [(u - 3.0 * s, min(u + 3.0 * s, 0.0)) for u, s in zip(usual, spread, strict=True)]
    best = minimize(
        cost, usual, method="L-BFGS-B", bounds=bounds, options={"maxiter": 15, "eps": 1e-3, "ftol": 1e-6}
    )
    # Levels that were bent to innovations of another law are worth less than the usual ones.
    fitted = told(best.x, parameters)
    seen = whiteness(as_taken(_innovations(rows, navigator(fitted))[0], fitted.gate_sigma))
    return fitted if seen.describes else told(usual, parameters)


def _likely_bias(
    rows: Rows, parameters: RobotParameters, navigator: Callable[..., Navigator], shares: Sequence[float]
) -> RobotParameters:
    """The robot with the spread of its bias, of shares of the given, that makes the log's rests the likeliest.

    The empirical Bayes prior. Some drivers take the bias off and some do not, and on a hot day it is farther from that of
    the file than any switch-on before. The first rest turns the whole way before it by what it says of the bias: one no
    larger than its own error would make half of all paths worse, and one beyond its gate leaves the way as it is.
    """

    def told(share: float) -> RobotParameters:
        std, gyro = parameters.initial_std, parameters.gyro
        return replace(
            parameters,
            initial_std=replace(std, gyro_bias_dps=share * (std.gyro_bias_dps or 0.0)),
            gyro=replace(
                gyro,
                bias_dps_std=share * gyro.bias_dps_std,
                repeatability_dps=share * gyro.repeatability_dps,
            ),
        )

    return min(map(told, shares), key=lambda one: misfit(rows, navigator(one, filtering=False)))


def _usual_walk(parameters: RobotParameters) -> float:
    """The angle random walk that goes with the flicker; a file that gives none at all does not tell it."""
    return parameters.noise.angle_random_walk_deg_per_rt_h or FilterNoise().angle_random_walk_deg_per_rt_h


def _priors(
    robot: Robot, parameters: RobotParameters, *, open_walk: bool
) -> tuple[list[str], Floats, Floats]:
    """Names of the figures, their logarithms before the log is seen, and how firmly they hold."""
    flicker = _FLICKER_BY_WALK * _usual_walk(parameters) * DPH_TO_DPS
    usual, spread = [], []
    for name, (size, width) in USUAL.items():
        told = robot.noise[name]
        if f"noise.{name}" in robot.given and told > 0.0:
            usual.append(math.log(told))
            spread.append(min(max(robot.noise_std.get(name, told) / told, _FIRMEST), width))
        else:
            usual.append(math.log(flicker if math.isnan(size) else size))
            spread.append(width)
    names = list(USUAL)
    if open_walk:
        names.append(_WALK)
        usual.append(math.log(parameters.noise.angle_random_walk_deg_per_rt_h))
        spread.append(_WALK_SPREAD)
    return names, np.minimum(usual, 0.0), np.array(spread)


def _wide(parameters: RobotParameters) -> RobotParameters:
    """The same with a wide geometry, so that a wrong one does not swell the noise."""
    std = parameters.initial_std
    wide = replace(
        std,
        right_scale=max(std.right_scale, 0.01),
        left_scale=max(std.left_scale, 0.01),
        wheel_separation_m=max(
            std.wheel_separation_m or 0.0, SEPARATION_RELATIVE_STD * parameters.wheel_separation_m
        ),
    )
    return replace(parameters, initial_std=wide)


def misfit(rows: Rows, navigator: Navigator) -> float:
    """Minus twice the log likelihood of the innovations, but for a constant; what the gate takes counts as its edge."""
    normalised, sigma = _innovations(rows, navigator)
    squared = normalised**2
    edge = navigator.robot.gate_sigma**2
    # Beyond the gate it grows as a logarithm does, so that a slip does not swell the noise.
    bounded = np.where(squared <= edge, squared, edge * (1.0 + np.log(np.maximum(squared, edge) / edge)))
    return float(np.sum(bounded + 2.0 * np.log(sigma)))


def _innovations(rows: Rows, navigator: Navigator) -> tuple[Floats, Floats]:
    """Innovations over their deviations, and the deviations in deg, at the nodes."""
    out = navigator.run(rows.t_s, rows.left_m, rows.right_m, rows.gyro_dps, rows.temp_c, rows.smooth_dps)
    seen = np.isfinite(out.innovation_deg)
    sigma = out.innovation_sigma_deg[seen]
    return out.innovation_deg[seen] / sigma, sigma


@dataclass(frozen=True)
class Whiteness:
    """Normalised innovations as a whole.

    Attributes
    ----------
    nis, lag1 : float
        Mean square and the correlation of neighbours; NaN where there are none.
    slow : float
        Mean square of the sums of `_SUMMED` neighbours over the root of that; NaN where there are fewer.
    sums : int
        How many there are.
    """

    nis: float
    lag1: float
    slow: float
    sums: int

    @property
    def describes(self) -> bool:
        """Whether they are those of a filter that describes the log."""
        white = NIS_RANGE[0] < self.nis < NIS_RANGE[1] and abs(self.lag1) < LAG1_LIMIT
        return bool(white and (not self.sums or self.slow * self.sums < chi2.isf(_SELDOM, self.sums)))


def as_taken(normalised: Floats, gate_sigma: float) -> Floats:
    """Normalised innovations as the filter takes them: one beyond its gate is a slip, and counts as the gate's edge.

    So a filter that gates a few bumps describes the log, and one that gates every hundredth row does not.
    """
    return np.clip(normalised, -gate_sigma, gate_sigma)


def summed(normalised: Floats) -> tuple[Floats, Floats]:
    """Sums of `_SUMMED` neighbours over the root of that, and the innovations that are left for the next one."""
    whole = normalised.size // _SUMMED * _SUMMED
    return normalised[:whole].reshape(-1, _SUMMED).sum(axis=1) / math.sqrt(_SUMMED), normalised[whole:]


def whiteness(normalised: Floats) -> Whiteness:
    """How white normalised innovations are."""
    if normalised.size == 0:
        return Whiteness(math.nan, math.nan, math.nan, 0)
    square, sums = float(normalised @ normalised), summed(normalised)[0]
    slow = float(np.mean(sums**2)) if sums.size else math.nan
    lag1 = float(normalised[1:] @ normalised[:-1]) / square if square > 0 else math.nan
    return Whiteness(square / normalised.size, lag1, slow, sums.size)
