"""One recording on the bench of tests: columns, noise and search, repeated until noise and model agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis import hypotheses, strangers
from gyrocal.diagnosis.base import Base, carried_terms, fit_surface, simulate
from gyrocal.diagnosis.columns import Book, conditions_of
from gyrocal.diagnosis.gram import Projection, project
from gyrocal.diagnosis.hypotheses import Hypothesis, Shape
from gyrocal.diagnosis.jumps import scan
from gyrocal.diagnosis.search import Member, Search, related
from gyrocal.diagnosis.series import Series, set_means
from gyrocal.diagnosis.strangers import Block
from gyrocal.diagnosis.whitening import NoiseLevels, NoiseModel, estimate_levels, look_for_walk, walk_p_value
from gyrocal.errors import DataError
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Leading columns of each generic block that the first noise estimate does without.
_SATURATING = 6
#: Rows that stand for one such column at the least.
_ROWS_A_COLUMN = 3
#: Levels that differ by less are the same.
_SAME_LEVELS = 0.03
_ROUNDS = 3
#: A walk is taken in at this rate of false alarms at the most: the processes that stand for 1/f noise follow it to
#: some percent only, and a long record would have a walk make up for that.
_WALK_LEVEL = 1e-6
#: Rivals that have lost less evidence (nats) get a finer grid before the loss counts.
_NEAR_NATS = 6.0
#: Peaks of the scan for jumps that go on the grid, and instants on either side of each.
_JUMPS = 5
_AROUND_JUMP = 3


@dataclass(frozen=True)
class Setup:
    """Columns of a recording around a simulated sequence."""

    series: Series
    base: Base
    model: NoiseModel
    matrix: Floats
    surface_columns: Ints
    hypotheses: tuple[Hypothesis, ...]
    blocks: tuple[Block, ...]

    @property
    def columns(self) -> Floats:
        """All columns, shape (n, p)."""
        return self.matrix[:, 1:]


@dataclass(frozen=True)
class Analysis:
    """What a search ended with.

    Attributes
    ----------
    setup : Setup
    levels : NoiseLevels
        Under the final model.
    gram : ndarray
        Of record and columns at these levels.
    members : tuple of Member
        Named and strange, the strongest first.
    walk_p : float
        P-value of the rate random walk in the noise; 1 where there is none.
    """

    setup: Setup
    levels: NoiseLevels
    gram: Floats
    members: tuple[Member, ...]
    search: Search
    walk_p: float = 1.0

    @property
    def bare(self) -> Projection:
        """Everything with the surface alone projected out."""
        return project(self.gram, self.setup.surface_columns)

    @property
    def rest(self) -> Projection:
        """Everything with the whole model projected out."""
        return self.search.given(self.members)


def prepare(series: Series, base: Base) -> Setup:
    """Build all columns around a simulated sequence."""
    book = Book(base.residual_dps, base.design)
    known = hypotheses.build(series, base.surface, book)
    strange = strangers.strangers(series, book)
    blocks = strangers.blocks(series, book)
    return Setup(
        series,
        base,
        NoiseModel(series),
        book.matrix(),
        book.model,
        (*known, *strange),
        tuple(blocks),
    )


def search_setup(setup: Setup, level: float, seed: int) -> Analysis:
    """The better of two searches where the record insists on a rate random walk: with it in the noise, or without.

    What wanders slowly can be a law, or noise; the evidence of the whole decides.
    """
    y, X = setup.base.residual_dps, setup.columns
    sure = min(level, _WALK_LEVEL)
    surface, saturated = X[:, setup.surface_columns], X[:, _saturating(setup)]
    bare = estimate_levels(setup.model, y, surface)
    still = estimate_levels(setup.model, y, saturated, bare.levels)
    found = _search_from(setup, still.levels, level, seed)
    walking, p_value = look_for_walk(setup.model, y, saturated, still)
    if p_value > sure and any(related(m.hypothesis.coordinate, "time") for m in found.members):
        walking, p_value = look_for_walk(setup.model, y, surface, bare)
    if not walking.walk or p_value > sure:
        return found
    best = min((found, _search_from(setup, walking, level, seed)), key=_criterion)
    if best is found:
        # What was found may be a part of what walks.
        columns = model_columns(found.setup, found.members)
        still = estimate_levels(setup.model, y, columns, found.levels)
        walking, p_value = look_for_walk(setup.model, y, columns, still)
        if not walking.walk or p_value > level:
            return found
        best = _search_from(found.setup, walking, level, seed, found.members)
    if not best.levels.walk:
        return best
    columns = model_columns(best.setup, best.members)
    p_value = walk_p_value(setup.model, y, columns, best.levels)
    return replace(best, walk_p=p_value) if p_value < sure else found


def _search_from(
    setup: Setup, levels: NoiseLevels, level: float, seed: int, start: Sequence[Member] = ()
) -> Analysis:
    """Search and noise in turns, from a first guess of the noise and of the members."""
    y = setup.base.residual_dps
    members = list(start)
    for attempt in range(_ROUNDS):
        # Once for the record, once for what the members leave.
        setup = _with_jumps(setup, levels, members, seed) if attempt < 2 else setup
        white = setup.model.whiten(levels, setup.matrix)[0]
        gram = np.asarray(white.T @ white)
        search = Search(gram, setup.surface_columns, setup.hypotheses, setup.series.n_sets, level, seed)
        members = search.run(_carried(members, search))
        under = estimate_levels(setup.model, y, model_columns(setup, members), levels).levels
        finer = _finer(setup, search, members) if attempt == 0 else None
        if finer is None and _same(levels, under, setup.model) and (attempt or not members):
            break
        setup, levels = finer or setup, under
    return Analysis(setup, levels, gram, tuple(members), search)


def _saturating(setup: Setup) -> Ints:
    """Columns that follow almost any physics, for a first look at the noise: no more than the rows can pay for."""
    room = len(setup.series) // _ROWS_A_COLUMN - setup.surface_columns.size
    each = int(np.clip(room // max(len(setup.blocks), 1), 0, _SATURATING))
    return np.concatenate([setup.surface_columns, *(b.columns[:each] for b in setup.blocks)])


def _carried(members: Sequence[Member], search: Search) -> list[Member]:
    """Members of an earlier search in the terms of a new one; their columns are the same."""
    current = {(h.id, h.df): h for h in search.hypotheses}
    found = []
    for member in members:
        h = current.get((member.hypothesis.id, member.hypothesis.df))
        place = None if h is None else np.flatnonzero((h.points == member.columns).all(axis=1))
        if h is not None and place is not None and place.size:
            free = np.zeros((search.gram.shape[0] - 1, member.free.shape[1]))
            free[: member.free.shape[0]] = member.free
            found.append(replace(member, hypothesis=h, point=int(place[0]), free=free))
    return found


def _finer(setup: Setup, search: Search, members: Sequence[Member]) -> Setup | None:
    """The setup with finer grids for the laws in the model and their rivals; None where nothing can be finer.

    A rival whose best shape lies between two points of its grid must not lose by that.
    """
    wanted = {}
    for member in members:
        rest = search.given([m for m in members if m is not member])
        near = {member.hypothesis.id, *(e for e, loss in member.rivals if loss < _NEAR_NATS)}
        for score in search.scores(rest):
            h = score.hypothesis
            shapes = hypotheses.finer_shapes(h, score.point) if h.in_catalogue and h.id in near else []
            if shapes:
                wanted[h.id, h.df] = shapes
    return _with_shapes(setup, wanted) if wanted else None


def _with_jumps(setup: Setup, levels: NoiseLevels, members: Sequence[Member], seed: int) -> Setup:
    """The setup with the instants at which a scan of the whole record, given the members, sees a jump."""
    key = ("bias_step", 1)
    known = next((h for h in setup.hypotheses if (h.id, h.df) == key), None)
    if known is None:
        return setup
    columns = model_columns(setup, members)
    rng = np.random.default_rng([seed, 3])
    found = scan(setup.series, setup.model, levels, setup.base.residual_dps, columns, rng)
    there = {shape["at_s"] for shape in known.shapes}
    new = [{"at_s": float(t)} for t in found.candidates(_JUMPS, _AROUND_JUMP) if t not in there]
    trials = max(found.trials, known.trials or 1.0)
    setup = _with_shapes(setup, {key: new}) if new else setup
    return replace(
        setup,
        hypotheses=tuple(
            replace(h, trials=trials) if "bias_step" in (h.id, h.repeats) else h for h in setup.hypotheses
        ),
    )


def _with_shapes(setup: Setup, wanted: Mapping[tuple[str, int], Sequence[Shape]]) -> Setup:
    """The setup with more points on the grids of some hypotheses, and of those that repeat them."""
    q = setup.columns[:, setup.surface_columns] / np.sqrt(len(setup.series))
    c = conditions_of(setup.series)
    parts, count = [setup.matrix], setup.matrix.shape[1] - 1
    numbers: dict[tuple[str, int], Ints] = {}
    for h in setup.hypotheses:
        shapes = wanted.get((h.id, h.df), ())
        if shapes:
            columns = [hypotheses.columns_at(h, c, s, setup.base.surface) for s in shapes]
            new = np.concatenate(columns, axis=1)
            parts.append(new - q @ (q.T @ new))
            numbers[h.id, h.df] = np.arange(count, count + new.shape[1]).reshape(-1, h.df)
            count += new.shape[1]

    def grown(h: Hypothesis) -> Hypothesis:
        key = (h.repeats or h.id, h.df)
        if key not in numbers:
            return h
        points = np.concatenate([h.points, numbers[key]])
        return replace(h, shapes=(*h.shapes, *wanted[key]), points=points)

    return replace(
        setup,
        matrix=np.concatenate(parts, axis=1),
        hypotheses=tuple(grown(h) for h in setup.hypotheses),
    )


def model_columns(setup: Setup, members: Sequence[Member]) -> Floats:
    """Surface, effects and the freedom of their shapes as columns, shape (n, p)."""
    chosen = np.concatenate([setup.surface_columns, *(m.columns for m in members)])
    free = [setup.columns[:, : m.free.shape[0]] @ m.free for m in members if m.free.size]
    return np.concatenate([setup.columns[:, chosen], *free], axis=1)


def _same(a: NoiseLevels, b: NoiseLevels, model: NoiseModel) -> bool:
    """Whether two sets of levels whiten alike: each is compared on the scale of what it adds to a row."""
    white = a.white * model.typical_white
    offset = float(np.sqrt(np.median(model.rate_var)))
    pairs = (
        (a.white, b.white, a.white),
        (a.flicker_dps, b.flicker_dps, max(a.flicker_dps, 0.05 * white)),
        (a.jitter * offset, b.jitter * offset, max(a.jitter * offset, 0.1 * a.flicker_dps)),
    )
    return all(abs(x - y) < _SAME_LEVELS * scale for x, y, scale in pairs)


def analyse(series: Series, level: float, seed: int) -> Analysis:
    """Find what a recording holds beyond its error surface.

    A law that the surface imitates in part (the sine of an open loop is mostly cubic) bends the point around
    which the surface is linearised; where such a law is in sight the search is repeated around its own fit,
    and the better of the two stands.
    """
    first = search_setup(prepare(series, fit_surface(series)), level, seed)
    hint = _large_law(first)
    if hint is None:
        return first
    fitted = _surface_beside(series, *hint)
    second = search_setup(prepare(series, simulate(series, fitted, carried_terms(series))), level, seed)
    held = [hint[0] in [m.hypothesis.id for m in a.members] for a in (first, second)]
    if not held[1]:
        # A surface bent around a law that is not there is further from the truth, however well it fits.
        return first
    return second if _criterion(second) < _criterion(first) + _SELF_CONSISTENT * held[0] else first


#: What a search gains (in twice the log-likelihood) by being linearised around the law that it finds.
_SELF_CONSISTENT = 20.0
#: Laws whose own cubic part is far larger than what they leave beyond the surface.
_LARGE_LAWS = ("sagnac_sine",)


def _large_law(analysis: Analysis) -> tuple[str, dict[str, float]] | None:
    rate_members = [m for m in analysis.members if m.hypothesis.coordinate == "rate"]
    if not rate_members:
        return None
    gain = max(m.gain for m in rate_members)
    scores = analysis.search.scores(analysis.bare)
    for score in scores:
        if score.hypothesis.id in _LARGE_LAWS and score.gain > 0.5 * gain:
            return score.hypothesis.id, dict(score.hypothesis.shapes[score.point])
    return None


def _surface_beside(series: Series, effect: str, start: dict[str, float]) -> Surface:
    """The surface that is left beside a law at its best amplitude and shape.

    By weighted least squares on the means of data sets: this only says around which surface to linearise.
    """
    rows = np.flatnonzero(series.is_set)
    first = rows[np.unique(series.set_index[rows], return_index=True)[1]]
    means = replace(
        series.take(first),
        gyro_dps=set_means(series, series.gyro_dps)[1],
        temp_c=set_means(series, series.temp_c)[1],
        white_std_dps=np.full(first.size, 1.0),
    )
    c = conditions_of(means)
    key, value = next(iter(start.items()))
    best: tuple[float, Surface] = (np.inf, fit_surface(means).surface)
    for factor in np.geomspace(0.35, 2.0, 12):
        curve = hypotheses.law(effect, c, {key: value * factor}, None)
        added, rss, base = np.zeros(first.size), np.inf, fit_surface(means)
        try:
            for _ in range(7):
                both = np.column_stack([base.design, curve])
                added = np.linalg.lstsq(both, base.residual_dps, rcond=None)[0][-1] * curve
                base = fit_surface(means, added)
                rss = float(np.sum((base.residual_dps - added) ** 2))
        except DataError:
            # Law and surface are so nearly the same here that the fit runs off: no point to linearise around.
            continue
        if rss < best[0]:
            best = (rss, base.surface)
    return best[1]


def _criterion(analysis: Analysis) -> float:
    """Twice the negative log-likelihood plus what each member and a walk pay for their freedom."""
    y = analysis.setup.base.residual_dps
    X = model_columns(analysis.setup, analysis.members)
    fit = estimate_levels(analysis.setup.model, y, X, analysis.levels)
    each = float(np.log(analysis.setup.series.n_sets))
    price = sum(m.gain - 2.0 * m.evidence + m.free.shape[1] * each for m in analysis.members)
    return float(-2.0 * fit.ml + price + each * (analysis.levels.walk > 0))
