"""A drive against true positions, headings or both: scales of gyro and wheels, bias, lever arm, by generalised least squares.

The error of a reckoned path is no noise of single positions: an error of the heading moves all that follows. The path
is linearised, and its covariance is what the gyro's noise (white, 1/f, walk) and the wheels' slip make of it, beside a
truth whose own noise is white and wandering; what the heading difference knows of the laws of the bias comes in as further
rows, whose errors are in part the noise of the same gyro.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from gyrocal.diagnosis.drive.laws import (
    AT_ONCE,
    MOVING,
    BiasLaws,
)
from gyrocal.diagnosis.drive.nameless import is_odd
from gyrocal.diagnosis.drive.path_laid import (
    ALONE,
    MODEL_STD,
    SCALE,
    SCALES,
    TIMES,
    Laid,
    Levels,
    laid_on_truth,
    rates_of,
    reckoned,
)
from gyrocal.diagnosis.drive.path_noise import (
    Knots,
    cell_edges_s,
)
from gyrocal.diagnosis.drive.path_problem import PathProblem, beside_uneven, oddities, one_sided, spins
from gyrocal.diagnosis.drive.path_strangers import BIAS_PARTS, ONE_SIZE, SPINNING, path_strangers
from gyrocal.diagnosis.drive.reckoning import Complexes, Figures, Floats, Reckoned, reckon, since_last
from gyrocal.diagnosis.drive.series import NODE_S, DriveSeries, Ints, between_rows
from gyrocal.diagnosis.drive.yaw import YawNoise
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

#: A scale is believed at so many standard deviations: at two, drives without any got worse by it.
BELIEVED = 3.8
#: Knots that the truth is averaged to, as the cost grows with their cube, and how many a path is laid on at the least.
_MOST_KNOTS, _LEAST_KNOTS = 150, 12
#: Truth that spans less of the drive, or a path that spans less of its own size, is none: a receiver that was off or stuck.
_LEAST_SHARE, _LEAST_SIZE = 0.2, 0.01
#: How often a path is laid anew beside turns that differ from side to side.
_ROUNDS = 4
#: A path that misses the truth by more than this share of its size is laid on its mirror image too; that it is mirrored
#: takes this gain, twice the log likelihood, and a miss so many times smaller.
_ODD, _MIRRORED_BY, _MIRRORED_BETTER = 0.03, 60.0, 3.0
Uneven = Literal["asked", "shown", "held"]
#: What a gyro's turns to the one side are usually off by more than those to the other, of its scale's error: half the difference.
UNEVEN = 0.2


#: Where a truth has its sensor, m, and how late it is, s.
_SENSOR = ("lever_ahead", "lever_left", "clock")


@dataclass(frozen=True)
class TruthAnswer:
    """What the truth says.

    Attributes
    ----------
    values, stds : mapping
        Laws of the bias by their names in `KINDS`, ``bias`` always (beyond what was taken out), ``gyro_scale``,
        ``wheel_scale`` (relative), ``lever_ahead``, ``lever_left`` (m), ``clock`` (s, the truth is late), ``course`` (s, the
        way goes where its heading will point so much later: of a gyro that is late, or steps along their last heading), and
        ``mounting`` (rad, where there are headings), `SPINNING` where there are positions, and `ONE_SIZE` where turns to the
        left and to the right are off by different shares: half the difference, right less left.
    covariance : ndarray, shape (2, 2)
        Of `SCALES`.
    of_laws : ndarray, shape (p, p)
        Covariance of the laws of the bias that the heading difference knows, in the order of `BiasLaws.names`.
    odd : mapping
        Coordinate -> p-value of structure that nothing here explains.
    surest : float
        Logarithm of the least of these, which may be less than a float holds.
    mirrored : bool
        The truth follows the path in a mirror only.
    loss : float
        Minus twice the restricted log-likelihood of what was taken out of the path beforehand.
    levels : Levels, optional
        Noise of truth and way.
    bias_moves_dps : float
        How far the bias lies from its mean over the drive (rms), where it is not the same all along; ``bias`` is the mean then.
    one_way : mapping
        Twice the log of how much likelier a scale of the turns one way is than one of all, and than that and a law of the motion.
    or_moving_dps : (float, float), optional
        A bias in motion, and its standard deviation, that may have made what `ONE_SIZE` stands for.
    or_uneven : (float, float), optional
        `ONE_SIZE`, and its standard deviation, that may have made what a bias in motion stands for.
    """

    values: Mapping[str, float]
    stds: Mapping[str, float]
    covariance: Floats
    of_laws: Floats
    odd: Mapping[str, float]
    surest: float = 0.0
    mirrored: bool = False
    loss: float = 0.0
    levels: Levels | None = None
    bias_moves_dps: float = 0.0
    one_way: Mapping[str, float] = field(default_factory=dict)
    or_moving_dps: tuple[float, float] | None = None
    or_uneven: tuple[float, float] | None = None

    @property
    def one_size(self) -> float:
        """`ONE_SIZE` where the truth shows it, and else 0."""
        return self.values.get(ONE_SIZE, 0.0)

    def told(self, name: str) -> float:
        """A figure in its standard deviations; 0 where the truth is mirrored or says nothing of it."""
        return self.values[name] / self.stds[name] if name in self.values and not self.mirrored else 0.0

    def shows(self, name: str) -> bool:
        """Whether it says of a scale more than was known beforehand: headings say nothing of the way."""
        return not self.mirrored and self.stds[name] < 0.5 * SCALE

    def believed(self, name: str) -> bool:
        """Whether a scale is sure: far from zero for the noise."""
        return abs(self.told(name)) > BELIEVED

    @property
    def sensor(self) -> dict[str, tuple[float, float]]:
        """Of ``lever_ahead``, ``lever_left`` and ``clock`` what is sure, each with its standard deviation."""
        return {n: (self.values[n], self.stds[n]) for n in _SENSOR if self.believed(n)}

    def seen(self, path: Reckoned) -> Complexes:
        """Positions of a path as the truth has them, shape (n,): where on the robot its sensor is, and as late."""
        ahead, left, late_s = (self.sensor.get(n, (0.0, 0.0))[0] for n in _SENSOR)
        at_m = path.at_m + (ahead + 1j * left) * np.exp(1j * path.heading_rad)
        if late_s == 0.0:
            return np.asarray(at_m)
        x_m, y_m = (between_rows(path.t_s - late_s, path.t_s, x) for x in (at_m.real, at_m.imag))
        return np.asarray(x_m + 1j * y_m)


def _rows(series: DriveSeries) -> Ints:
    """Rows at which a path is worked out: those of the truth, of gaps, and two each `NODE_S`, however fast the log is.

    Of one each, starts in which wheels spin are told a tenth worse.
    """
    known = np.isfinite(series.truth_x_m + series.truth_y_m) | np.isfinite(series.truth_heading_deg)
    kept = known | series.gap | np.append(series.gap[1:], True)
    cell = np.floor((series.t_s - series.t_s[0]) / (0.5 * NODE_S) + 1e-9)
    kept[0] = True
    return np.flatnonzero(kept | (np.diff(cell, append=np.inf) > 0))


def _knots(
    series: DriveSeries, kept: Ints, base: Reckoned, laws: Mapping[str, Floats], told: int
) -> Knots | None:
    position, headings = (series.truth_x_m + 1j * series.truth_y_m)[kept], series.truth_heading_deg[kept]
    rows = np.flatnonzero(np.isfinite(position if series.has_truth else headings))
    if rows.size < _LEAST_KNOTS or np.ptp(base.t_s[rows]) < _LEAST_SHARE * series.duration_s:
        return None
    t = base.t_s[rows]
    width = np.ptp(t) / min(_MOST_KNOTS, rows.size)
    at = np.unique(np.floor((t - t[0]) / width), return_inverse=True)[1].astype(np.int64)
    count = np.bincount(at).astype(np.float64)
    edges_s = cell_edges_s(base.t_s, count.size)
    knots = Knots(rows, at, count, base.t_s, None, None, laws, told, edges_s)
    heading = None
    if np.all(np.isfinite(headings[rows])):
        # As a difference to the gyro's heading, so that nothing wraps within a knot.
        apart = DEG_TO_RAD * headings - base.heading_rad
        apart[rows] = np.unwrap(apart[rows])
        heading = knots.mean(apart)
    where = knots.mean(position) if series.has_truth else None
    return replace(knots, t_s=knots.mean(base.t_s), position=where, heading=heading)


def ask_truth(
    series: DriveSeries,
    figures: Figures,
    laws: BiasLaws,
    noise: YawNoise,
    alone: Sequence[str] = (),
    near: TruthAnswer | None = None,
    *,
    bias_changes: bool = False,
    uneven_turns: float = 0.0,
    uneven: Uneven = "asked",
) -> TruthAnswer | None:
    """Lay the path on the truth; None where there is none, or too little of it.

    Parameters
    ----------
    figures, laws
        What the heading difference has found, taken out first, and how well it knows the laws of the bias.
    alone : sequence of str
        Laws of `ALONE` that are asked for beside them, of which it knows nothing.
    near, bias_changes : TruthAnswer, bool, optional
        Of nearly the same path: its levels of noise are begun from, and it is as mirrored; and whether each part of the drive has a
        bias of its own.
    uneven_turns : float
        By what share the gyro's turns may be off to the one side and the other way to the other, as far as is known otherwise.
    uneven : str
        Whether that they are has to be shown, has been beside more laws, or they are held where `near` has them.
    """
    levels = None if near is None else near.levels
    kept, whole = _rows(series), rates_of(series, [*laws.names, *alone], figures.bias_before_s)
    base = reckon(series, figures).at_rows(kept)
    over_s = np.maximum(base.dt_s, 1e-9)
    rates = {n: since_last(rate * series.dt_s, kept) / over_s for n, rate in whole.items()}
    knots = _knots(series, kept, base, rates, len(laws.names))
    if knots is None:
        return None
    if knots.position is not None and np.std(knots.position) < _LEAST_SIZE * np.std(base.at_m):
        return None
    one_size = 0.0 if near is None else near.one_size
    for _ in range(1 if uneven == "held" else _ROUNDS):
        laid = laid_on_truth(knots, base, laws, noise, levels, one_size)
        shown = uneven == "shown" and one_size != 0.0
        answer = _answer(
            knots, base, laid, figures, uneven_turns, bias_changes=bias_changes, uneven_shown=shown
        )
        if abs(answer.one_size - one_size) <= answer.stds.get(ONE_SIZE, 0.0):
            break
        # About a path that it bends far nothing is as it is about the right one.
        one_size = answer.one_size
    if knots.position is None:
        return answer
    mirrored = near is not None and near.mirrored
    miss = laid.miss_m(knots)
    if near is None and miss > _ODD * float(np.std(knots.position)):
        other = replace(knots, position=np.conj(knots.position), heading=None)
        turned = laid_on_truth(other, base, laws, noise)
        plain = laid_on_truth(replace(knots, heading=None), base, laws, noise)
        mirrored = plain.loss - turned.loss > _MIRRORED_BY and miss > _MIRRORED_BETTER * turned.miss_m(other)
    # What a path misses of its mirror image is no structure of the drive.
    return replace(answer, mirrored=True, odd={}, surest=0.0) if mirrored else answer


def _answer(
    knots: Knots,
    base: Reckoned,
    laid: Laid,
    figures: Figures,
    uneven_turns: float,
    *,
    bias_changes: bool,
    uneven_shown: bool,
) -> TruthAnswer:
    state, problem, logs = laid.state, laid.problem, laid.levels.logs
    blocks = path_strangers(knots, reckoned(knots, base, state))
    if state.one_size:
        # It has been taken out for the sake of the path alone.
        residual = problem.residual + state.one_size * blocks["turn_rate"][ONE_SIZE]
        problem = replace(problem, residual=residual)
    odd: Mapping[str, float] = oddities(problem, blocks, logs)
    if spins(problem, blocks, odd, logs):
        problem = problem.with_columns({SPINNING: blocks["acceleration"].pop(SPINNING)})
        odd = oddities(problem, blocks, logs)
    one_way = _one_way(problem, blocks, laid, figures)
    usual = max(UNEVEN * abs(state.values["gyro_scale"]), uneven_turns, MODEL_STD)
    problem, odd, left = beside_uneven(problem, blocks, odd, logs, usual, shown=uneven_shown)
    shown = [ONE_SIZE] if ONE_SIZE in problem.columns and ONE_SIZE not in problem.known else []
    beside: dict[str, Floats] = {}
    for coordinate, more in blocks.items():
        beside |= more if is_odd(left[coordinate]) else {}
        if bias_changes:
            beside |= {n: column for n, column in more.items() if n in BIAS_PARTS}
    # A scale must hold beside whatever else is in the path.
    problem = problem.with_columns(beside)
    solved = problem.solve(logs)
    values, covariance = solved.values, solved.covariance
    names = list(problem.columns)
    for name in SCALES:
        covariance[names.index(name), names.index(name)] += (SCALE if name in state.held else MODEL_STD) ** 2
    found = {n: float(v) + state.values.get(n, 0.0) for n, v in zip(names, values, strict=True)}
    stds = {n: float(np.sqrt(covariance[k, k])) for k, n in enumerate(names)}
    spinning = blocks.get("acceleration", {}).get(SPINNING)
    if spinning is not None:
        wider = problem.with_columns({SPINNING: spinning})
        found[SPINNING], stds[SPINNING] = wider.told(SPINNING, logs)
    # Parts that the truth does not show by itself are noise.
    parts = [n for n in names if n in BIAS_PARTS and is_odd(left.get("time", 0.0))]
    moves_dps = RAD_TO_DEG * bias_moves(*_of(parts, names, values, covariance)) if parts else 0.0
    every = (*knots.laws, *SCALES, SPINNING, *shown, "lever_ahead", "lever_left", *TIMES, "mounting")
    told = [n for n in every if n in found]
    return TruthAnswer(
        {n: found[n] for n in told},
        {n: stds[n] for n in told},
        _of(SCALES, names, values, covariance)[1],
        _of([*knots.laws][: knots.told], names, values, covariance)[1],
        {c: float(np.exp(p)) for c, p in odd.items()},
        surest=min(odd.values(), default=0.0),
        loss=laid.loss,
        levels=laid.levels,
        bias_moves_dps=moves_dps,
        one_way=one_way,
    )


def _one_way(
    problem: PathProblem, blocks: Mapping[str, Mapping[str, Floats]], laid: Laid, figures: Figures
) -> dict[str, float]:
    """`TruthAnswer.one_way`; `figures` have what was taken out of the path."""
    size = blocks.get("turn_rate", {}).get(ONE_SIZE)
    if size is None:
        return {}
    in_motion = {"step": figures.bias_motion_dps, **dict.fromkeys(MOVING, figures.bias_moving_dps)}
    whole = {n: v + in_motion.get(n, 0.0) for n, v in laid.state.values.items()}
    tried = ("", *(n for n in whole if n in in_motion))
    std, logs = ALONE[AT_ONCE], laid.levels.logs
    return {n: one_sided(problem, size, logs, whole, n, std if n else 1.0) for n in tried}


def _of(
    some: Sequence[str], names: Sequence[str], values: Floats, covariance: Floats
) -> tuple[Floats, Floats]:
    """Values of some, and their covariance."""
    at = [names.index(n) for n in some]
    return values[at], covariance[np.ix_(at, at)]


def bias_moves(parts: Floats, covariance: Floats) -> float:
    """By how much the bias of the parts of a drive differs (rms), less what their own errors make of that.

    Weighed by what the truth tells of them: beside columns of the heading it tells next to nothing of some mixtures.

    Parameters
    ----------
    parts, covariance : of all parts but the last, the mean of all being zero
    """
    precision = np.linalg.inv(covariance)
    beyond = float(parts @ precision @ parts) - parts.size
    spread = np.eye(parts.size) - 1.0 / (parts.size + 1)
    return float(np.sqrt(max(beyond, 0.0) / np.trace(precision @ spread)))
