"""UMBmark: wheel scales and track of a robot from squares driven in both directions.

Borenstein and Feng, Measurement and Correction of Systematic Odometry Errors in Mobile Robots, IEEE Transactions on
Robotics and Automation 12(6), 869-880 (1996). A square of side L is driven several times each way; at the end the
robot's true position is measured, less the one that its odometry believes: the return error. Unequal wheels bend the
straight legs, the same way round in both directions; a wrong track turns every corner by too much or too little. The
mean return errors of the two directions tell them apart. How long both wheels are together they do not tell: that stays as
the robot file has it, and an error of it goes into the track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.fusion.robot import RobotParameters

Floats = NDArray[np.float64]

#: Runs in each direction below which a mean has no honest scatter.
LEAST_RUNS = 3
_DRAWS = 20_000
#: Newton steps, each of which leaves a few per cent; no corner and no leg is off by more, rad.
_STEPS, _MOST_RAD = 4, 0.6


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Umbmark:
    """What the squares tell.

    Attributes
    ----------
    wheel_ratio : E_d, right wheel diameter over left, beside what the robot file has of them
    track_ratio : E_b, true wheel separation over the one of the robot file
    left_scale, right_scale : wheel scales for the robot file, in place of those in use: measured = (1 + S) true (paper eq. 7)
    wheel_separation_m : for the robot file
    before_m : E_max,syst: the larger distance of the two mean return errors from the start
    """

    wheel_ratio: Estimate
    track_ratio: Estimate
    left_scale: Estimate
    right_scale: Estimate
    wheel_separation_m: Estimate
    before_m: float


def umbmark(cw_m: Floats, ccw_m: Floats, side_m: float, robot: RobotParameters, seed: int = 0) -> Umbmark:
    """Corrections from return errors, in the frame of the start: x along the first leg, y to the left of it.

    Parameters
    ----------
    cw_m, ccw_m : ndarray, shape (n, 2)
        Return errors (measured less believed) of clockwise and counter-clockwise runs.
    side_m : side of the square
    robot : whose odometry was driven and believed, with its wheel scales and separation
    seed : of the draws behind the intervals (means of n runs are Student t about theirs)

    Raises
    ------
    DataError
        Fewer than `LEAST_RUNS` in a direction, or errors so large that the method's small angles do not hold.
    """
    for name, runs in (("clockwise", cw_m), ("counter-clockwise", ccw_m)):
        if len(runs) < LEAST_RUNS:
            msg = f"{len(runs)} {name} runs are given, and {LEAST_RUNS} are wanted in each direction (UMBmark takes five): drive more."
            raise DataError(msg)
    mean_cw, mean_ccw = cw_m.mean(axis=0), ccw_m.mean(axis=0)
    before = float(max(np.hypot(*mean_cw), np.hypot(*mean_ccw)))
    if before > 0.35 * side_m:
        msg = f"The mean return error is {before:.2f} m on a square of {side_m:g} m, too much for small angles: check side, units and signs, correct what is gross, and drive again."
        raise DataError(msg)
    rng = np.random.default_rng([seed, 17])
    centre = _corrections(mean_cw[None], mean_ccw[None], side_m, robot)
    drawn = _corrections(_means(rng, cw_m), _means(rng, ccw_m), side_m, robot)
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    wheels, track, left, right, separation = (
        Estimate(float(c), float(a), float(b)) for c, a, b in zip(centre[0], low, high, strict=True)
    )
    return Umbmark(wheels, track, left, right, separation, before)


def _means(rng: np.random.Generator, runs: Floats) -> Floats:
    """Draws of the true mean: each coordinate a t about the mean of the runs, shape (_DRAWS, 2)."""
    n = len(runs)
    error = runs.std(axis=0, ddof=1) / math.sqrt(n)
    return np.asarray(runs.mean(axis=0) + error * rng.standard_t(n - 1, (_DRAWS, 2)))


def _corrections(cw_m: Floats, ccw_m: Floats, side_m: float, robot: RobotParameters) -> Floats:
    """E_d, E_b, left and right scale, separation, shape (m, 5).

    A corner that falls short by alpha and a leg that bends by beta end a square at -2 L alpha and 2 L beta off, to
    first order, with the signs that follow; both coordinates are averaged, as the reference recommends. Here that is
    a step of Newton's: what the square so bent still leaves is corrected again, for to first order the track alone is
    wrong by a tenth of its correction, several times its scatter.
    """
    alpha = beta = np.zeros(len(cw_m))
    for _ in range(_STEPS):
        x_cw, y_cw = (cw_m - _end(-1, alpha, beta, side_m)).T
        x_ccw, y_ccw = (ccw_m - _end(1, alpha, beta, side_m)).T
        alpha = alpha - (x_cw + x_ccw + y_cw - y_ccw) / (8.0 * side_m)
        beta = beta - (x_cw - x_ccw + y_cw + y_ccw) / (8.0 * side_m)
        alpha, beta = (np.clip(angle, -_MOST_RAD, _MOST_RAD) for angle in (alpha, beta))
    track = (0.5 * np.pi) / (0.5 * np.pi - alpha)
    separation = robot.wheel_separation_m * track
    bend = beta * separation / side_m  # separation over the radius of the bent leg
    ratio = (1.0 + 0.5 * bend) / (1.0 - 0.5 * bend)
    left = (1.0 + robot.encoders.left_scale) * 0.5 * (ratio + 1.0) - 1.0
    right = (1.0 + robot.encoders.right_scale) * 0.5 * (1.0 / ratio + 1.0) - 1.0
    return np.column_stack([ratio, track, left, right, separation])


def _end(direction: int, alpha: Floats, beta: Floats, side_m: float) -> Floats:
    """Where a square of bent legs and wrong corners ends, shape (m, 2)."""
    leg = side_m * np.sinc(0.5 * beta / np.pi) * np.exp(0.5j * beta)
    turn = np.exp(1j * (beta + direction * (0.5 * np.pi - alpha)))
    end = leg * (1.0 + turn + turn**2 + turn**3)
    return np.column_stack([end.real, end.imag])
