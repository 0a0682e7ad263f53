"""Calibration without a table: whole turns between rests, the angle as reference.

Turned by hand on a mark, or spun in place by the robot: each turn ends where the mark says, so its angle is a whole
multiple of the mark's. What the gyro integrates to, less the bias of the rests around it, over that angle is the
scale factor. A stop that is a little off its mark is wrong for the turn before and, with the other sign, for the
turn after: the errors of neighbouring turns are tied, and many turns in one direction share only two stops.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from gyrocal.calibration.datasets import at_the_rail
from gyrocal.errors import DataError
from gyrocal.inference.rounding import least_noise, mean_error
from gyrocal.units import NORMAL_95, plural

Floats = NDArray[np.float64]

#: Length of the means in which rest is looked for, s, and how long a rest must last at the least.
WINDOW_S = 0.5
LEAST_REST_S = 2.0
#: Levels that are tried: at rest, and some slow turns at a constant rate.
_LEVELS = 4
#: Left out on either side of a rest, s: the hand is not yet off, or already on.
_MARGIN_S = 0.3
#: A rest departs from the level at rest by no more than this many standard deviations of a mean, nor by this much, deg/s.
_REST_SIGMA, _REST_DPS = 6.0, 0.2
#: A quarter of the absolute values of a standard normal lie below this.
_QUARTER = 0.31864
#: A turn whose angle is further than this share of the mark's from a multiple of it is not taken for one.
_OFF_MARK = 0.2
_SATURATED = "saturated: samples stand at the recording's extreme value"
#: Scatter of the stops that is weighed, deg: uniform in its logarithm, and none.
_STOPS_DEG = np.concatenate([[0.0], np.geomspace(1e-3, 10.0, 60)])


@dataclass(frozen=True)
class Rest:
    """A time at rest: its ends in s, the mean output and the standard error of white noise, deg/s."""

    start_s: float
    end_s: float
    mean_dps: float
    std_error_dps: float


@dataclass(frozen=True)
class Turn:
    """What lies between two rests.

    Attributes
    ----------
    angle_deg : what the gyro integrates to, less the bias of the rests around it
    std_deg : of that, from the gyro's white noise and a bias that walks between the rests as it does from rest to rest
    true_deg : the multiple of the mark's angle next to it
    used : False where `angle_deg` is too far from any multiple, or the gyro at its rail; `remark` says so
    """

    start_s: float
    end_s: float
    angle_deg: float
    std_deg: float
    true_deg: float
    peak_dps: float
    used: bool
    remark: str = ""


@dataclass(frozen=True)
class Figure:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class TurnCalibration:
    """Scale factor from whole turns.

    Attributes
    ----------
    scale : scale factor error, output over true less 1, ppm, the mean of both directions
    other_scales_ppm : what it would be if the turns were by more marks than counted, and by fewer; None where none are fewer
    asymmetry : counter-clockwise less clockwise, ppm; None with turns in one direction only
    bias : mean of the rests, deg/s; its interval from their scatter and from what rounding may hide
    stop_std_deg : how well the stops are on their marks, estimated from the turns themselves
    """

    scale: Figure
    other_scales_ppm: tuple[float, float | None]
    asymmetry: Figure | None
    bias: Figure
    stop_std_deg: float
    rests: tuple[Rest, ...]
    turns: tuple[Turn, ...]


def calibrate_turns(t_s: Floats, gyro_dps: Floats, mark_deg: float = 360.0) -> TurnCalibration:
    """Scale factor, asymmetry and bias from a log of rests and whole turns.

    Parameters
    ----------
    t_s, gyro_dps : ndarray, shape (n,), increasing times and output
    mark_deg : every turn ends at a multiple of this angle

    Raises
    ------
    DataError
        No rests, fewer than three turns between them, or no turn near a multiple of `mark_deg`.
    """
    dt_s = np.diff(t_s, prepend=t_s[0] - float(np.median(np.diff(t_s))))
    step_dps = _step(gyro_dps)
    rests = find_rests(t_s, gyro_dps)
    turns = _turns(t_s, gyro_dps, dt_s, rests, mark_deg)
    used = [turn.used for turn in turns]
    if sum(used) < 3:
        raise DataError(_too_few(rests, turns, mark_deg))
    at_rest = [gyro_dps[(t_s >= r.start_s) & (t_s < r.end_s)] for r in rests]
    noise_dps = least_noise([np.unique(x, return_counts=True) for x in at_rest], step_dps)
    hidden_dps = mean_error(step_dps, math.hypot(noise_dps, step_dps / math.sqrt(12.0)))
    scale, asymmetry, stop_std_deg = _fit(turns, hidden_dps)
    return TurnCalibration(
        scale,
        _other_scales(scale, turns, mark_deg),
        asymmetry,
        _bias(rests, hidden_dps),
        stop_std_deg,
        tuple(rests),
        tuple(turns),
    )


def _other_scales(scale: Figure, turns: list[Turn], mark_deg: float) -> tuple[float, float | None]:
    """Scale factor errors by which the next other counts of marks, more and fewer, fit all turns as well."""
    # All counts change by one factor, and stay whole.
    marks = math.gcd(*(round(turn.true_deg / mark_deg) for turn in turns if turn.used))
    factor = 1e6 + scale.value
    return factor * marks / (marks + 1) - 1e6, factor * marks / (marks - 1) - 1e6 if marks > 1 else None


def _too_few(rests: list[Rest], turns: list[Turn], mark_deg: float) -> str:
    count = sum(turn.used for turn in turns)
    said = (
        f"{len(rests)} {plural(len(rests), '[rest|rests]')} of {LEAST_REST_S:g} s or more and {count} "
        f"{plural(count, '[turn|turns]')} by a multiple of {mark_deg:g} deg {plural(len(rests), '[is|are]')} found, and three "
        "turns are wanted: stand still between the turns, and give the angle of the mark"
    )
    if any(turn.remark == _SATURATED for turn in turns):
        return f"{said}. Some turns are {_SATURATED}: turn more slowly."
    others = [f"{turn.angle_deg:.0f}" for turn in turns if not turn.used]
    shown = ", ".join(others[:4]) + (", ..." if len(others) > 4 else "")
    return f"{said}. By the gyro it turned by {shown} deg." if others else f"{said}."


def find_rests(t_s: Floats, gyro_dps: Floats) -> list[Rest]:
    """Times at rest: where means over `WINDOW_S` stay at one level.

    The level is that which most of the quiet ones share, or one nearer to zero that comes again as often: a slow turn may
    last longer than all rests together.
    """
    window = ((t_s - t_s[0]) / WINDOW_S).astype(np.int64)
    n = np.bincount(window)
    sums = np.bincount(window, weights=gyro_dps)
    full = n > 0.5 * np.median(n[n > 0])
    means = np.divide(sums, n, out=np.full(n.size, np.nan), where=full)
    # Turning changes the output too; at rest, what is left between neighbours is the noise: the lower half of them.
    noise_dps = float(np.percentile(np.abs(np.diff(gyro_dps)), 25)) / (_QUARTER * math.sqrt(2.0))
    std_error = noise_dps / math.sqrt(float(np.median(n[full])))
    near = max(_REST_SIGMA * std_error, _REST_DPS)
    left, found, level = full.copy(), list[Rest](), np.inf
    for _ in range(_LEVELS):
        if not left.any():
            break
        other = _densest(means[left])
        quiet = full & (np.abs(means - other) < near)
        rests = _rests_where(quiet, t_s, gyro_dps)
        if abs(other) < abs(level) and len(rests) >= max(len(found) - 1, min(len(found), 2)):
            found, level = rests, other
        left &= ~quiet
    return found


def _rests_where(quiet: NDArray[np.bool_], t_s: Floats, gyro_dps: Floats) -> list[Rest]:
    """Stretches of quiet windows that are long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(np.int8), [0]])))
    rests, step_dps = [], _step(gyro_dps)
    for first, last in edges.reshape(-1, 2):
        start, end = t_s[0] + first * WINDOW_S + _MARGIN_S, t_s[0] + last * WINDOW_S - _MARGIN_S
        inside = (t_s >= start) & (t_s < end)
        if (last - first) * WINDOW_S >= LEAST_REST_S and np.count_nonzero(inside) > 2:
            x = gyro_dps[inside]
            # What a step of the output hides at rest, it adds in the turn: a twelfth of its square.
            error = math.hypot(float(np.std(np.diff(x))) / math.sqrt(2.0), step_dps / math.sqrt(12.0))
            error /= math.sqrt(x.size)
            rests.append(Rest(float(start), float(end), float(np.mean(x)), error))
    return rests


def _step(gyro_dps: Floats) -> float:
    """The least that the output changes by, deg/s."""
    moved = np.abs(np.diff(gyro_dps))
    return float(np.min(moved, where=moved > 0.0, initial=np.inf))


def _walk(rests: list[Rest]) -> float:
    """How fast the bias walks, (deg/s)^2/s, by what the rests differ beyond their noise."""
    steps = [
        ((b.mean_dps - a.mean_dps) ** 2 - a.std_error_dps**2 - b.std_error_dps**2)
        / (0.5 * (b.start_s + b.end_s - a.start_s - a.end_s))
        for a, b in itertools.pairwise(rests)
    ]
    return max(float(np.mean(steps)), 0.0) if steps else 0.0


def _densest(x: Floats) -> float:
    """The level around which values lie closest: the half-sample mode (Robertson and Cryer, 1974)."""
    x = np.sort(x)
    while x.size > 3:
        half = (x.size + 1) // 2
        widths = x[half - 1 :] - x[: x.size - half + 1]
        i = int(np.argmin(widths))
        x = x[i : i + half]
    return float(np.mean(x))


def _turns(t_s: Floats, gyro_dps: Floats, dt_s: Floats, rests: list[Rest], mark_deg: float) -> list[Turn]:
    turns, walk = [], _walk(rests)
    saturated = _saturated(t_s, gyro_dps, rests)
    for (before, after), clipped in zip(itertools.pairwise(rests), saturated, strict=True):
        # From the middle of one rest to the middle of the next, so that nothing of the turn is cut off.
        start, end = 0.5 * (before.start_s + before.end_s), 0.5 * (after.start_s + after.end_s)
        inside = (t_s > start) & (t_s <= end)
        share = (t_s[inside] - start) / (end - start)
        bias = before.mean_dps + share * (after.mean_dps - before.mean_dps)
        rate = gyro_dps[inside] - bias
        angle = float(np.sum(rate * dt_s[inside]))
        length = end - start
        bias_std = 0.5 * length * math.hypot(before.std_error_dps, after.std_error_dps)
        noise = before.std_error_dps**2 * (before.end_s - before.start_s)
        true = mark_deg * round(angle / mark_deg)
        near = true != 0.0 and abs(angle - true) <= _OFF_MARK * mark_deg
        remark = "" if near else f"{angle:.1f} deg is not near a multiple of {mark_deg:g} deg"
        remark = _SATURATED if clipped else remark
        turns.append(
            Turn(
                before.end_s,
                after.start_s,
                angle,
                math.sqrt(bias_std**2 + noise * length + walk * length**3 / 12.0),
                true,
                float(np.max(np.abs(rate))),
                not remark,
                remark,
            )
        )
    return turns


def _saturated(t_s: Floats, gyro_dps: Floats, rests: list[Rest]) -> list[bool]:
    """Whether the gyro stands at its rail between each two rests."""
    if len(rests) < 2:
        return []
    stretches = [(rest.start_s, rest.end_s) for rest in rests]
    stretches += [(before.end_s, after.start_s) for before, after in itertools.pairwise(rests)]
    outputs = [gyro_dps[(t_s >= start) & (t_s <= end)] for start, end in stretches]
    lows_and_highs = np.array([(x.min(), x.max()) for x in outputs])
    counts = [
        (np.count_nonzero(x == low), np.count_nonzero(x == high))
        for x, (low, high) in zip(outputs, lows_and_highs, strict=True)
    ]
    hit = at_the_rail(lows_and_highs, np.array(counts), np.array([x.size for x in outputs]))[0]
    return [bool(x) for x in hit[len(rests) :]]


def _fit(turns: list[Turn], hidden_dps: float) -> tuple[Figure, Figure | None, float]:
    """Scale and asymmetry by generalised least squares; the scatter of the stops by its posterior.

    Neighbouring turns share a stop, so the covariance of the differences of angles is tridiagonal. By how much rounding
    may make every rest wrong, `hidden_dps`, every turn is wrong for as long as it lasts.
    """
    used = np.flatnonzero([turn.used for turn in turns])
    true = np.array([turns[i].true_deg for i in used])
    y = np.array([turns[i].angle_deg - turns[i].true_deg for i in used])
    own = np.array([turns[i].std_deg for i in used]) ** 2
    rounded = hidden_dps * np.array([turns[i].end_s - turns[i].start_s for i in used])
    known = np.diag(own) + np.outer(rounded, rounded)
    D = np.zeros((len(turns), len(turns) + 1))
    D[np.arange(len(turns)), np.arange(len(turns))] = -1.0
    D[np.arange(len(turns)), np.arange(len(turns)) + 1] = 1.0
    stops = (D @ D.T)[np.ix_(used, used)]
    both = np.any(true > 0) and np.any(true < 0) and true.size >= 4
    X = np.column_stack([true, np.abs(true)]) if both else true[:, None]
    fits = [_gls(X, y, known + s**2 * stops) for s in _STOPS_DEG]
    logs = np.array([fit[2] for fit in fits])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    stop_std = float(np.sqrt(np.sum(weight * _STOPS_DEG**2)))
    scale = _mixture(1e6, weight, [(c[0], v[0]) for c, v, _ in fits])
    asymmetry = _mixture(2e6, weight, [(c[1], v[1]) for c, v, _ in fits]) if both else None
    return scale, asymmetry, stop_std


def _mixture(unit: float, weight: Floats, fits: list[tuple[float, float]]) -> Figure:
    """Mean and central 95 % of a mixture of normals: what is not known of the stops widens the interval."""
    mean, std = np.array([m for m, _ in fits]), np.sqrt([v for _, v in fits])

    def below(x: float, share: float) -> float:
        return float(weight @ stats.norm.cdf((x - mean) / std)) - share

    reach = float(np.max(np.abs(mean)) + 40.0 * np.max(std))
    low, high = (float(brentq(below, -reach, reach, args=(share,))) for share in (0.025, 0.975))
    return Figure(unit * float(weight @ mean), unit * low, unit * high, "ppm")


def _gls(X: Floats, y: Floats, V: Floats) -> tuple[Floats, Floats, float]:
    """Coefficients, their variances, and the restricted log-likelihood (Patterson and Thompson, 1971)."""
    L = np.linalg.cholesky(V)
    A, b = np.linalg.solve(L, X), np.linalg.solve(L, y)
    N = A.T @ A
    c = np.linalg.solve(N, A.T @ b)
    rest = b - A @ c
    log = -0.5 * float(rest @ rest) - float(np.sum(np.log(np.diag(L)))) - 0.5 * float(np.linalg.slogdet(N)[1])
    return c, np.diag(np.linalg.inv(N)), log


def _bias(rests: list[Rest], hidden_dps: float) -> Figure:
    means = np.array([rest.mean_dps for rest in rests])
    half = float(stats.t.ppf(0.975, means.size - 1) * np.std(means, ddof=1) / math.sqrt(means.size))
    half = math.hypot(half, NORMAL_95 * hidden_dps)
    mean = float(np.mean(means))
    return Figure(mean, mean - half, mean + half, "deg/s")
