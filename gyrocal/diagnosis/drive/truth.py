"""A drive against true positions, headings or both: scales of gyro and wheels, bias, lever arm, by generalised least squares.

The error of a reckoned path is no noise of single positions: an error of the heading moves all that follows. The path
is linearised, and its covariance is what the gyro's noise (white, 1/f, walk) and the wheels' slip make of it, beside a
truth whose own noise is white and wandering; what the heading difference knows of the laws of the bias comes in as further
rows, whose errors are in part the noise of the same gyro.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrocal.diagnosis.drive.laws import (
    AT_ONCE,
    MOVING,
    BiasLaws,
    reference_temp_c,
    temperature_c,
)
from gyrocal.diagnosis.drive.nameless import STRANGER_P
from gyrocal.diagnosis.drive.path_gaps import first_turns
from gyrocal.diagnosis.drive.path_noise import (
    WANDERS_S,
    Knots,
    cell_edges_s,
    path_noise,
    stacked,
)
from gyrocal.diagnosis.drive.path_problem import PathProblem, beside_uneven, oddities, one_sided, spins
from gyrocal.diagnosis.drive.path_strangers import BIAS_PARTS, ONE_SIZE, SPINNING, path_strangers
from gyrocal.diagnosis.drive.reckoning import Figures, Floats, Reckoned, chords, reckon
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.yaw import YawNoise
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

#: A scale is believed at so many standard deviations: at two, drives without any got worse by it.
BELIEVED = 3.8
#: What time stamps and straight steps between rows are worth, and the quartz of a clock: no scale is known better, relative.
_MODEL_STD = 3e-5
#: Knots that the truth is averaged to, as the cost grows with their cube, and how many a path is laid on at the least.
_MOST_KNOTS, _LEAST_KNOTS = 150, 12
#: Truth that spans less of the drive, or a path that spans less of its own size, is none: a receiver that was off or stuck.
_LEAST_SHARE, _LEAST_SIZE = 0.2, 0.01
#: What is thought possible beforehand: scales, clock of the truth and course against heading (s), lever arm (m).
_SCALE, _CLOCK_S, _LEVER_M = 0.2, 0.3, 1.0
#: What a path against a truth has that is no law of the bias and no scale.
_TIMES = ("clock", "course")
#: Laws of the bias, by their names in `KINDS`, that the truth may tell beside its mean, and what is thought possible of each on a
#: vehicle of one speed: slope (deg/s per degC), and what is added in motion (deg/s).
ALONE = {"slope": 0.02, AT_ONCE: 0.2}
#: Parts of the drive over which the path is laid first: over the whole, a heading may be wrong by turns.
_HORIZONS = (0.06, 0.12, 0.25, 0.5, 1.0)
#: Levels' logarithms beforehand: the truth's are free, those of dead reckoning are known from the heading difference.
_FREE, _WAY_FREE = 4.0, 1.0
#: A path that misses the truth by more than this share of its size is laid on its mirror image too; that it is mirrored
#: takes this gain, twice the log likelihood, and a miss so many times smaller.
_ODD, _MIRRORED_BY, _MIRRORED_BETTER = 0.03, 60.0, 3.0
#: What a gyro's turns to the one side are usually off by more than those to the other, of its scale's error: half the difference.
UNEVEN = 0.2
#: Scales that the truth alone tells apart.
SCALES = ("gyro_scale", "wheel_scale")


@dataclass(frozen=True)
class _Levels:
    """Logarithms of the levels of noise, and the memory of what wanders in the truth."""

    logs: Floats
    wander_s: float


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
    mirrored : bool
        The truth follows the path in a mirror only.
    loss : float
        Minus twice the restricted log-likelihood of what was taken out of the path beforehand.
    levels : _Levels, optional
        Noise of truth and way.
    bias_moves_dps : float
        How far the bias lies from its mean over the drive (rms), where it is not the same all along; ``bias`` is the mean then.
    one_way : mapping
        Twice the log of how much likelier a scale of the turns one way is than one of all, and than that and a law of the motion.
    """

    values: Mapping[str, float]
    stds: Mapping[str, float]
    covariance: Floats
    of_laws: Floats
    odd: Mapping[str, float]
    mirrored: bool = False
    loss: float = 0.0
    levels: _Levels | None = None
    bias_moves_dps: float = 0.0
    one_way: Mapping[str, float] = field(default_factory=dict)

    def told(self, name: str) -> float:
        """A figure in its standard deviations; 0 where the truth is mirrored or says nothing of it."""
        return self.values[name] / self.stds[name] if name in self.values and not self.mirrored else 0.0

    def shows(self, name: str) -> bool:
        """Whether it says of a scale more than was known beforehand: headings say nothing of the way."""
        return not self.mirrored and self.stds[name] < 0.5 * _SCALE

    def believed(self, name: str) -> bool:
        """Whether a scale is sure: far from zero for the noise."""
        return abs(self.told(name)) > BELIEVED


def _knots(series: DriveSeries, reckoned: Reckoned, laws: Mapping[str, Floats], told: int) -> Knots | None:
    position, headings = series.truth_x_m + 1j * series.truth_y_m, series.truth_heading_deg
    rows = np.flatnonzero(np.isfinite(position if series.has_truth else headings))
    if rows.size < _LEAST_KNOTS or np.ptp(series.t_s[rows]) < _LEAST_SHARE * series.duration_s:
        return None
    t = series.t_s[rows]
    width = np.ptp(t) / min(_MOST_KNOTS, rows.size)
    at = np.unique(np.floor((t - t[0]) / width), return_inverse=True)[1].astype(np.int64)
    count = np.bincount(at).astype(np.float64)
    edges_s = cell_edges_s(series.t_s, count.size)
    knots = Knots(rows, at, count, series.t_s, None, None, laws, told, edges_s)
    heading = None
    if np.all(np.isfinite(headings[rows])):
        # As a difference to the gyro's heading, so that nothing wraps within a knot.
        apart = DEG_TO_RAD * headings - reckoned.heading_rad
        apart[rows] = np.unwrap(apart[rows])
        heading = knots.mean(apart)
    where = knots.mean(position) if series.has_truth else None
    return replace(knots, t_s=knots.mean(series.t_s), position=where, heading=heading)


def _rates(series: DriveSeries, laws: Iterable[str], jump_s: float) -> dict[str, Floats]:
    """What one unit of some laws of the bias adds to the rate in each row, of those that a log could hold."""
    temp = temperature_c(series)
    found: dict[str, Floats] = {}
    for name in laws:
        if name == "bias":
            found[name] = np.ones(series.t_s.size)
        elif name == "slope" and temp is not None:
            found[name] = temp - reference_temp_c(series)
        elif name == "step":
            found[name] = series.moved.astype(np.float64)
        elif name in MOVING and series.resting.any():
            found[name] = series.moving(MOVING[name])
        elif name == "jump":
            found[name] = (series.t_s < jump_s).astype(np.float64)
    return {name: series.over_gaps(rate, np.zeros(rate.size)) for name, rate in found.items()}


@dataclass(frozen=True)
class _State:
    """Where the linearisation stands: parameters, direction of the frame, and turns that the gyro's noise and gaps have made.

    Without the latter every path of a noisy gyro would be too long: a heading that strays by 2 deg shortens by 0.06 %.
    `held` are scales that the truth does not tell from its lever arm: they had run away.
    """

    values: Mapping[str, float]
    turn: float
    strayed: Floats
    held: frozenset[str] = frozenset()


def _reckoned(knots: Knots, base: Reckoned, state: _State) -> Reckoned:
    v = state.values
    turned = np.zeros(base.t_s.size)
    for name, rate in knots.laws.items():
        turned = turned + v[name] * np.cumsum(rate * base.dt_s)
    heading = base.heading_rad / (1.0 + v["gyro_scale"]) - DEG_TO_RAD * turned + state.turn
    cells = knots.edges_s.size - 1
    turns = np.concatenate([[0.0], np.cumsum(state.strayed[:cells])])
    in_gaps = np.zeros(base.t_s.size)
    in_gaps[base.gap] = state.strayed[cells:]
    heading = heading + np.interp(base.t_s, knots.edges_s, turns) + np.cumsum(in_gaps)
    # The truth is of an earlier time.
    at_s, whole = base.t_s - v["clock"], np.cumsum(base.way_m / (1.0 + v["wheel_scale"]))
    course = np.interp(at_s + v["course"], base.t_s, heading)
    heading, whole = (np.interp(at_s, base.t_s, x) for x in (heading, whole))
    way = np.diff(whole, prepend=whole[0])
    return replace(base, heading_rad=heading, way_m=way, steps_m=chords(way, course))


def _columns(knots: Knots, path: Reckoned) -> dict[str, Floats]:
    """What each parameter does to positions and headings, ``name -> (rows,)``."""
    at, heading = path.at_m, path.heading_rad
    flat, k = np.zeros(knots.count.size), knots.count.size
    ahead = np.exp(1j * heading)
    speed = np.divide(path.steps_m, path.dt_s, out=np.zeros_like(path.steps_m), where=path.dt_s > 0)
    turning = np.gradient(heading) / np.maximum(np.gradient(path.t_s), 1e-9)
    one = np.ones(k, dtype=np.complex128)

    def by(heading_rad: Floats, way_m: Floats) -> Floats:
        return stacked(knots, knots.mean(path.moved_by(heading_rad, way_m)), knots.mean(heading_rad))

    nothing = np.zeros(at.size)
    columns = {
        "turn": by(np.ones(at.size), nothing),
        "clock": stacked(knots, -knots.mean(speed), -knots.mean(turning)),
        "gyro_scale": by(-(heading - heading[0]), nothing),
        "wheel_scale": by(nothing, -path.way_m),
    }
    for at_told, (name, rate) in enumerate(knots.laws.items()):
        law = by(-DEG_TO_RAD * np.cumsum(rate * path.dt_s), nothing)
        columns[name] = law + stacked(knots, 0.0 * one, flat, np.arange(knots.told) == at_told)
    if knots.position is not None:
        columns |= {
            "course": stacked(knots, knots.mean(path.moved_by(turning, nothing)), flat),
            "east": stacked(knots, one, flat),
            "north": stacked(knots, 1j * one, flat),
            "lever_ahead": stacked(knots, knots.mean(ahead), flat),
            "lever_left": stacked(knots, knots.mean(1j * ahead), flat),
        }
        if knots.heading is not None:
            columns["mounting"] = stacked(knots, 0.0 * one, np.ones(k))
    return columns


def _problem(
    knots: Knots, base: Reckoned, state: _State, laws: BiasLaws, noise: YawNoise, wander_s: float
) -> PathProblem:
    path = _reckoned(knots, base, state)
    at = knots.mean(path.at_m)
    apart = at if knots.position is None else knots.position - at
    headings = np.zeros(knots.count.size)
    if knots.heading is not None:
        headings = knots.heading - knots.mean(path.heading_rad - base.heading_rad)
        headings = headings - 2 * np.pi * np.round(np.median(headings) / (2 * np.pi))
    v = state.values
    known = {
        **{name: (-v[name], _MODEL_STD if name in state.held else _SCALE) for name in SCALES},
        **{name: (-v[name], _CLOCK_S) for name in _TIMES},
        "lever_ahead": (0.0, _LEVER_M),
        "lever_left": (0.0, _LEVER_M),
        **{name: (-v[name], ALONE[name]) for name in knots.laws if name not in laws.names},
    }
    spread = path_noise(knots, path, noise, laws, wander_s)
    residual = stacked(knots, apart, headings, -np.array([v[name] for name in laws.names]))
    # As noise about zero again; what is known beforehand has not been moved.
    residual[: -knots.told] += spread.turned[: -knots.told] @ state.strayed
    return PathProblem(residual, _columns(knots, path), known, spread)


def _levels(problem: PathProblem, first: Floats) -> Floats:
    return problem.likeliest(first, np.array([_WAY_FREE, *[_FREE] * (first.size - 1)]))


def _first_levels(knots: Knots) -> Floats:
    """Levels from neighbouring knots: a path is smooth, noise is not."""
    if knots.position is not None and knots.count.size > 4:
        second = knots.position[2:] - 2 * knots.position[1:-1] + knots.position[:-2]
        # The median of two squared normals is 1.386 of one's variance; a second difference has six times the variance.
        white = float(np.median(np.abs(second) ** 2) / 1.386 / 6.0 * np.median(knots.count))
    else:
        white = 1e-4
    white = float(np.clip(white, 1e-8, 1.0))
    logs = [0.0, np.log(white), np.log(0.1 * white)]
    headings = [np.log(DEG_TO_RAD**2), np.log(0.1 * DEG_TO_RAD**2)]
    return np.array([*logs, *headings] if knots.heading is not None else logs)


@dataclass(frozen=True)
class _Laid:
    """A path laid on the truth: where the linearisation stands, and the problem, levels and loss there."""

    state: _State
    problem: PathProblem
    levels: _Levels
    loss: float

    @property
    def left(self) -> Floats:
        """Rows that the best coefficients leave."""
        return self.problem.left(self.problem.solve(self.levels.logs).values)

    def miss_m(self, knots: Knots) -> float:
        """Rms distance that is left between path and truth, m."""
        k = knots.count.size
        return float(np.sqrt(np.mean(self.left[:k] ** 2 + self.left[k : 2 * k] ** 2)))


def _laid(
    knots: Knots,
    base: Reckoned,
    laws: BiasLaws,
    noise: YawNoise,
    near: _Levels | None = None,
    held: frozenset[str] = frozenset(),
) -> _Laid:
    """Gauss and Newton over growing parts of the drive, then levels and path in turn; levels `near` others once.

    A scale that runs away, as on a circle the wheels' do with the lever arm, is held where it was.
    """
    begun = near or _Levels(_first_levels(knots), WANDERS_S[1])
    logs, wander_s = begun.logs, begun.wander_s
    wanders_s, rounds = ((wander_s,), (2,)) if near else (WANDERS_S, (0, 2))
    reach = knots.t_s - knots.t_s[0]
    counts = [
        int(np.count_nonzero(reach <= max(horizon * reach[-1], np.sort(reach)[min(5, reach.size - 1)])))
        for horizon in _HORIZONS
    ]
    state = replace(_first_state(knots, base, noise, counts[0]), held=held)
    for horizon, count in zip(_HORIZONS, counts, strict=True):
        last, near_by = horizon == _HORIZONS[-1], knots.first(count)
        for round_ in range(4 if last else 2):
            part = _problem(near_by, base, state, laws, noise, wander_s)
            if last and round_ in rounds:
                first = logs if round_ else _first_levels(knots)
                tried = {w: replace(part, noise=part.noise.remembering(knots, w)) for w in wanders_s}
                fitted = {w: _levels(one, first) for w, one in tried.items()}
                wander_s = min(tried, key=lambda w: tried[w].solve(fitted[w]).loss)
                part, logs = tried[wander_s], fitted[wander_s]
            solved = part.solve(logs)
            step = dict(zip(part.columns, solved.values, strict=True))
            sought = {n: v + step.get(n, 0.0) for n, v in state.values.items()}
            moved = {n: float(np.clip(v, -0.5, 0.5)) for n, v in sought.items()}
            state = replace(state, values=moved, turn=state.turn + step["turn"])
            if last:
                state = replace(state, strayed=part.noise.strayed(part.left(solved.values), logs))
    astray = held | {n for n in SCALES if moved[n] != sought[n]}
    if astray != held:
        return _laid(knots, base, laws, noise, near, astray)
    levels = _Levels(logs, wander_s)
    return _Laid(state, _problem(knots, base, state, laws, noise, wander_s), levels, solved.loss)


def _first_state(knots: Knots, base: Reckoned, noise: YawNoise, count: int) -> _State:
    """Direction of the frame by the first knots of a drive, and turns in its gaps by the parts between them."""
    turn, in_gaps = 0.0, np.zeros(np.count_nonzero(base.gap))
    if knots.position is not None:
        at = knots.mean(base.at_m)
        a, b = at[:count] - at[:count].mean(), knots.position[:count] - knots.position[:count].mean()
        turn = float(np.angle(np.vdot(a, b)))
        white_m2 = float(np.exp(_first_levels(knots)[1]))
        in_gaps = first_turns(base, knots.rows, knots.count, (at, knots.position), turn, white_m2, noise)
    elif knots.heading is not None:
        turn = float(np.mean(knots.heading[:count]))
    values = dict.fromkeys((*SCALES, *_TIMES, *knots.laws), 0.0)
    return _State(values, turn, np.concatenate([np.zeros(knots.edges_s.size - 1), in_gaps]))


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
) -> TruthAnswer | None:
    """Lay the path on the truth; None where there is none, or too little of it.

    Parameters
    ----------
    figures : Figures
        What the heading difference has found, taken out first.
    laws : BiasLaws
        How well that knows the laws of the bias.
    alone : sequence of str
        Laws of `ALONE` that are asked for beside them, of which it knows nothing.
    near : TruthAnswer, optional
        Of nearly the same path: its levels of noise are begun from, and it is as mirrored.
    bias_changes : bool
        Whether the bias of each part of the drive is free.
    uneven_turns : float
        By what share the gyro's turns may be off to the one side and the other way to the other, as far as is known otherwise.
    """
    levels = None if near is None else near.levels
    base = reckon(series, figures)
    rates = _rates(series, [*laws.names, *alone], figures.bias_before_s)
    knots = _knots(series, base, rates, len(laws.names))
    if knots is None:
        return None
    if knots.position is None:
        laid = _laid(knots, base, laws, noise, levels)
        return _answer(knots, base, laid, figures, uneven_turns, bias_changes=bias_changes)
    if np.std(knots.position) < _LEAST_SIZE * np.std(base.at_m):
        return None
    laid = _laid(knots, base, laws, noise, levels)
    mirrored = near is not None and near.mirrored
    miss = laid.miss_m(knots)
    if near is None and miss > _ODD * float(np.std(knots.position)):
        other = replace(knots, position=np.conj(knots.position), heading=None)
        turned = _laid(other, base, laws, noise)
        plain = _laid(replace(knots, heading=None), base, laws, noise)
        mirrored = plain.loss - turned.loss > _MIRRORED_BY and miss > _MIRRORED_BETTER * turned.miss_m(other)
    answer = _answer(knots, base, laid, figures, uneven_turns, bias_changes=bias_changes)
    # What a path misses of its mirror image is no structure of the drive.
    return replace(answer, mirrored=True, odd={}) if mirrored else answer


def _answer(
    knots: Knots, base: Reckoned, laid: _Laid, figures: Figures, uneven_turns: float, *, bias_changes: bool
) -> TruthAnswer:
    state, problem, logs = laid.state, laid.problem, laid.levels.logs
    blocks = path_strangers(knots, _reckoned(knots, base, state))
    odd: Mapping[str, float] = oddities(problem, blocks, logs)
    if spins(problem, blocks, odd, logs):
        problem = problem.with_columns({SPINNING: blocks["acceleration"].pop(SPINNING)})
        odd = oddities(problem, blocks, logs)
    one_way = _one_way(problem, blocks, laid, figures)
    usual = max(UNEVEN * abs(state.values["gyro_scale"]), uneven_turns, _MODEL_STD)
    problem, odd, left = beside_uneven(problem, blocks, odd, logs, usual)
    shown = [ONE_SIZE] if ONE_SIZE in problem.columns and ONE_SIZE not in problem.known else []
    beside: dict[str, Floats] = {}
    for coordinate, more in blocks.items():
        beside |= more if left[coordinate] < STRANGER_P else {}
        if bias_changes:
            beside |= {n: column for n, column in more.items() if n in BIAS_PARTS}
    # A scale must hold beside whatever else is in the path.
    problem = problem.with_columns(beside)
    solved = problem.solve(logs)
    values, covariance = solved.values, solved.covariance
    names = list(problem.columns)
    for name in SCALES:
        covariance[names.index(name), names.index(name)] += (
            _SCALE if name in state.held else _MODEL_STD
        ) ** 2
    found = {n: float(v) + state.values.get(n, 0.0) for n, v in zip(names, values, strict=True)}
    stds = {n: float(np.sqrt(covariance[k, k])) for k, n in enumerate(names)}
    spinning = blocks.get("acceleration", {}).get(SPINNING)
    if spinning is not None:
        wider = problem.with_columns({SPINNING: spinning})
        found[SPINNING], stds[SPINNING] = wider.told(SPINNING, logs)
    # Parts that the truth does not show by itself are noise.
    parts = [n for n in names if n in BIAS_PARTS and left.get("time", 1.0) < STRANGER_P]
    moves_dps = RAD_TO_DEG * bias_moves(*_of(parts, names, values, covariance)) if parts else 0.0
    told = [
        n
        for n in (*knots.laws, *SCALES, SPINNING, *shown, "lever_ahead", "lever_left", *_TIMES, "mounting")
        if n in found
    ]
    return TruthAnswer(
        {n: found[n] for n in told},
        {n: stds[n] for n in told},
        _of(SCALES, names, values, covariance)[1],
        _of([*knots.laws][: knots.told], names, values, covariance)[1],
        odd,
        loss=laid.loss,
        levels=laid.levels,
        bias_moves_dps=moves_dps,
        one_way=one_way,
    )


def _one_way(
    problem: PathProblem, blocks: Mapping[str, Mapping[str, Floats]], laid: _Laid, figures: Figures
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
