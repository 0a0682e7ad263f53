"""One recording on the bench of tests: columns, noise and search, repeated until noise and model agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis import hypotheses, strangers
from gyrocal.diagnosis.base import Base, carried_terms, fit_surface, simulate
from gyrocal.diagnosis.columns import Book, conditions_of
from gyrocal.diagnosis.gram import Projection, project
from gyrocal.diagnosis.hypotheses import Hypothesis
from gyrocal.diagnosis.search import Member, Search
from gyrocal.diagnosis.series import Series
from gyrocal.diagnosis.strangers import Block
from gyrocal.diagnosis.whitening import NoiseLevels, NoiseModel, Whitened, estimate_levels

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Leading columns of each generic block that the first noise estimate does without.
_SATURATING = 8
#: Levels that differ by less are the same.
_SAME_LEVELS = 0.03
_ROUNDS = 3


@dataclass(frozen=True)
class Setup:
    """Columns of a recording around a simulated sequence."""

    series: Series
    base: Base
    model: NoiseModel
    columns: Floats
    surface_columns: Ints
    hypotheses: tuple[Hypothesis, ...]
    blocks: tuple[Block, ...]


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
    """

    setup: Setup
    levels: NoiseLevels
    gram: Floats
    members: tuple[Member, ...]
    search: Search

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
    book = Book(base.design)
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
    """Noise, search, noise again under what was found, until nothing changes."""
    y, X = setup.base.residual_dps, setup.columns
    generic = [b.columns[:_SATURATING] for b in setup.blocks]
    saturated = X[:, np.concatenate([setup.surface_columns, *generic])]
    bare = estimate_levels(setup.model, y, X[:, setup.surface_columns]).levels
    levels = estimate_levels(setup.model, y, saturated, bare).levels
    members: list[Member] = []
    for _ in range(_ROUNDS):
        gram = Whitened(setup.model.whiten(levels, np.column_stack([y, X]))[0], levels).gram
        search = Search(
            gram, setup.surface_columns, setup.hypotheses, setup.series.n_sets, level, seed
        )
        members = search.run(members)
        under = estimate_levels(setup.model, y, model_columns(setup, members), levels).levels
        if _same(levels, under, setup.model):
            break
        levels = under
    return Analysis(setup, levels, gram, tuple(members), search)


def model_columns(setup: Setup, members: Sequence[Member]) -> Floats:
    """Surface, effects and the freedom of their shapes as columns, shape (n, p)."""
    chosen = np.concatenate([setup.surface_columns, *(m.columns for m in members)])
    free = [setup.columns @ m.free for m in members if m.free.size]
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
    surface_base = first.setup.base
    for _ in range(3):
        added = _fitted_law(series, surface_base, hint, first)
        fitted = fit_surface(series, added)
        surface_base = simulate(series, fitted.surface, carried_terms(series))
    second = search_setup(prepare(series, surface_base), level, seed)
    return second if _criterion(second) < _criterion(first) else first


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


def _fitted_law(
    series: Series, base: Base, hint: tuple[str, dict[str, float]], analysis: Analysis
) -> Floats:
    """The law at its best amplitude and shape around a surface, deg/s, shape (n,)."""
    effect, start = hint
    c = conditions_of(series)
    key, value = next(iter(start.items()))
    best: tuple[float, Floats] = (np.inf, np.zeros(len(series)))
    for factor in np.geomspace(0.6, 1.7, 9):
        shape = {key: value * factor}
        curve = hypotheses.law(effect, c, shape, base.surface)
        columns = np.column_stack([base.residual_dps, base.design, curve])
        white = analysis.setup.model.whiten(analysis.levels, columns)[0]
        solution = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
        rss = float(np.sum((white[:, 0] - white[:, 1:] @ solution) ** 2))
        if rss < best[0]:
            best = (rss, solution[-1] * curve)
    return best[1]


def _criterion(analysis: Analysis) -> float:
    """Twice the negative log-likelihood plus BIC, to compare two searches of one recording."""
    y = analysis.setup.base.residual_dps
    X = model_columns(analysis.setup, analysis.members)
    fit = estimate_levels(analysis.setup.model, y, X, analysis.levels)
    amplitudes = sum(2 if m.hypothesis.random else m.hypothesis.df + len(m.hypothesis.shapes[0]) for m in analysis.members)
    amplitudes += sum(m.free.shape[1] for m in analysis.members)
    return -2.0 * fit.ml + amplitudes * float(np.log(analysis.setup.series.n_sets))
