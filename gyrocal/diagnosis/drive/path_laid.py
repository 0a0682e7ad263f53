"""A path laid on a truth, Gauss and Newton: what figures of gyro, way and frame do to its positions and headings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrocal.diagnosis.drive.laws import (
    AT_ONCE,
    MOVING,
    SETTLING,
    BiasLaws,
    reference_temp_c,
    settling,
    temperature_c,
)
from gyrocal.diagnosis.drive.path_gaps import first_turns
from gyrocal.diagnosis.drive.path_noise import WANDERS_S, Knots, path_noise, stacked
from gyrocal.diagnosis.drive.path_problem import PathProblem
from gyrocal.diagnosis.drive.reckoning import Floats, Reckoned, chords
from gyrocal.diagnosis.drive.series import DriveSeries, between_rows
from gyrocal.diagnosis.drive.yaw import YawNoise
from gyrocal.units import DEG_TO_RAD

#: What time stamps and straight steps between rows are worth, and the quartz of a clock: no scale is known better, relative.
MODEL_STD = 3e-5
#: Scales that the truth alone tells apart.
SCALES = ("gyro_scale", "wheel_scale")
#: What is thought possible beforehand: scales, clock of the truth and course against heading (s), lever arm (m).
SCALE, _CLOCK_S, _LEVER_M = 0.2, 0.3, 1.0
#: What a path against a truth has that is no law of the bias and no scale.
TIMES = ("clock", "course")
#: Laws of the bias, by their names in `KINDS`, that the truth may tell beside its mean, and what is thought possible of each on a
#: vehicle of one speed: slope (deg/s per degC), and what is added in motion (deg/s).
ALONE = {"slope": 0.02, AT_ONCE: 0.2}
#: Parts of the drive over which the path is laid first: over the whole, a heading may be wrong by turns.
_HORIZONS = (0.06, 0.12, 0.25, 0.5, 1.0)
#: Levels' logarithms beforehand: the truth's are free, those of dead reckoning are known from the heading difference.
_FREE, _WAY_FREE = 4.0, 1.0


@dataclass(frozen=True)
class Levels:
    """Logarithms of the levels of noise, and the memory of what wanders in the truth."""

    logs: Floats
    wander_s: float


def rates_of(series: DriveSeries, laws: Iterable[str], jump_s: float) -> dict[str, Floats]:
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
        elif name in SETTLING:
            found[name] = settling(series, SETTLING[name])
        elif name == "jump":
            found[name] = (series.t_s < jump_s).astype(np.float64)
    return {name: series.over_gaps(rate, np.zeros(rate.size)) for name, rate in found.items()}


@dataclass(frozen=True)
class _State:
    """Where the linearisation stands: parameters, direction of the frame, and turns that the gyro's noise and gaps have made.

    Without the latter every path of a noisy gyro would be too long: a heading that strays by 2 deg shortens by 0.06 %.
    `held` are scales that the truth does not tell from its lever arm: they had run away. `one_size` is what an earlier round
    has shown of `ONE_SIZE`.
    """

    values: Mapping[str, float]
    turn: float
    strayed: Floats
    held: frozenset[str]
    one_size: float


def reckoned(knots: Knots, base: Reckoned, state: _State) -> Reckoned:
    """The path with everything that a state has taken out of it."""
    v = state.values
    turned = np.zeros(base.t_s.size)
    for name, rate in knots.laws.items():
        turned = turned + v[name] * np.cumsum(rate * base.dt_s)
    scaled = base.heading_rad / (1.0 + v["gyro_scale"])
    either_way = np.cumsum(np.abs(np.diff(scaled, prepend=scaled[0])))
    heading = scaled + state.one_size * either_way - DEG_TO_RAD * turned + state.turn
    cells = knots.edges_s.size - 1
    turns = np.concatenate([[0.0], np.cumsum(state.strayed[:cells])])
    in_gaps = np.zeros(base.t_s.size)
    in_gaps[base.gap] = state.strayed[cells:]
    heading = heading + np.interp(base.t_s, knots.edges_s, turns) + np.cumsum(in_gaps)
    # The truth is of an earlier time.
    at_s, whole = base.t_s - v["clock"], np.cumsum(base.way_m / (1.0 + v["wheel_scale"]))
    course = between_rows(at_s + v["course"], base.t_s, heading)
    heading, whole = (between_rows(at_s, base.t_s, x) for x in (heading, whole))
    way = np.diff(whole, prepend=whole[0])
    return replace(base, heading_rad=heading, way_m=way, steps_m=chords(way, course, base.dt_s, base.gap))


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
    path = reckoned(knots, base, state)
    at = knots.mean(path.at_m)
    apart = at if knots.position is None else knots.position - at
    headings = np.zeros(knots.count.size)
    if knots.heading is not None:
        headings = knots.heading - knots.mean(path.heading_rad - base.heading_rad)
        headings = headings - 2 * np.pi * np.round(np.median(headings) / (2 * np.pi))
    v = state.values
    known = {
        **{name: (-v[name], MODEL_STD if name in state.held else SCALE) for name in SCALES},
        **{name: (-v[name], _CLOCK_S) for name in TIMES},
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
class Laid:
    """A path laid on the truth: where the linearisation stands, and the problem, levels and loss there."""

    state: _State
    problem: PathProblem
    levels: Levels
    loss: float

    @property
    def left(self) -> Floats:
        """Rows that the best coefficients leave."""
        return self.problem.left(self.problem.solve(self.levels.logs).values)

    def miss_m(self, knots: Knots) -> float:
        """Rms distance that is left between path and truth, m."""
        k = knots.count.size
        return float(np.sqrt(np.mean(self.left[:k] ** 2 + self.left[k : 2 * k] ** 2)))


def laid_on_truth(
    knots: Knots,
    base: Reckoned,
    laws: BiasLaws,
    noise: YawNoise,
    near: Levels | None = None,
    one_size: float = 0.0,
    held: frozenset[str] = frozenset(),
) -> Laid:
    """Gauss and Newton over growing parts of the drive, then levels and path in turn; levels `near` others once.

    A scale that runs away, as on a circle the wheels' do with the lever arm, is held where it was.
    """
    begun = near or Levels(_first_levels(knots), WANDERS_S[1])
    logs, wander_s = begun.logs, begun.wander_s
    wanders_s, rounds = ((wander_s,), (2,)) if near else (WANDERS_S, (0, 2))
    reach = knots.t_s - knots.t_s[0]
    counts = [
        int(np.count_nonzero(reach <= max(horizon * reach[-1], np.sort(reach)[min(5, reach.size - 1)])))
        for horizon in _HORIZONS
    ]
    state = _first_state(knots, base, noise, counts[0], held, one_size)
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
        return laid_on_truth(knots, base, laws, noise, near, one_size, astray)
    levels = Levels(logs, wander_s)
    return Laid(state, _problem(knots, base, state, laws, noise, wander_s), levels, solved.loss)


def _first_state(
    knots: Knots, base: Reckoned, noise: YawNoise, count: int, held: frozenset[str], one_size: float
) -> _State:
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
    values = dict.fromkeys((*SCALES, *TIMES, *knots.laws), 0.0)
    strayed = np.concatenate([np.zeros(knots.edges_s.size - 1), in_gaps])
    return _State(values, turn, strayed, held, one_size)
