"""Which effects are in a recording: forward selection with swaps and pruning among the catalogue and strangers.

Rules and their reasons are in physics-report.md, B.2: a generalised likelihood-ratio test whose null takes the
search over shapes into account, Holm over the effects, ranking by evidence with the number of data sets as sample
size, and freedom of shape for what is already named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.gram import (
    Projection,
    effective_trials,
    holm,
    log_evidence,
    project,
    random_evidence,
    tail,
)
from gyrocal.diagnosis.hypotheses import WRONG_SIGN, Hypothesis

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_EFFECTS = 6
#: A second effect of a named one's coordinate that gains less than this share of it is its misfit, not physics.
_MISFIT_SHARE = 0.02
#: Shapes of a family along which a named effect could hide more than this gain are free.
_FREE_GAIN = 4.0
#: Laws from which a search for two laws in one excess starts.
_STARTS = 6
#: Strangers nearer than this to a law of the catalogue cannot be told from it.
_SAME_SHAPE = 0.95

#: Coordinates in which one and the same excess shows.
RELATED = (
    {"time", "time_since_power_on", "data_set_index"},
    {"temperature_rate", "temperature_branch"},
    {"temperature"},
    {"rate"},
    {"table_angle"},
    {"time_since_step"},
    {"supply"},
)


def related(a: str, b: str) -> bool:
    """Whether two coordinates show one and the same excess."""
    return any(a in group and b in group for group in RELATED)


@dataclass(frozen=True)
class Member:
    """An effect in the model.

    Attributes
    ----------
    hypothesis : Hypothesis
    point : int
        Best point of its grid.
    gain : float
        Drop of the residual sum of squares, given the other members (log-likelihood ratio times two).
    p_value, evidence : float
    free : ndarray, shape (p, m)
        Mixtures of columns along which its shape is free.
    rivals : tuple of (id, evidence lost)
        Other laws for the same excess, best first.
    """

    hypothesis: Hypothesis
    point: int
    gain: float
    p_value: float
    evidence: float
    free: Floats
    rivals: tuple[tuple[str, float], ...] = ()

    @property
    def columns(self) -> Ints:
        """Column numbers of its best point."""
        return np.asarray(self.hypothesis.points[self.point])


@dataclass(frozen=True)
class Score:
    """A hypothesis, tested given a model."""

    hypothesis: Hypothesis
    point: int
    gain: float
    p_value: float
    evidence: float


class Search:
    """The tests of one recording at fixed noise levels.

    Parameters
    ----------
    gram : ndarray, shape (1 + p, 1 + p)
        Of the whitened record and columns.
    base : ndarray of int
        Columns of the surface and of other nuisance.
    hypotheses : sequence of Hypothesis
        Catalogue and strangers.
    n_sets : int
    level : float
        Family-wise false-alarm rate.
    seed : int
    """

    def __init__(
        self,
        gram: Floats,
        base: Ints,
        hypotheses: Sequence[Hypothesis],
        n_sets: int,
        level: float,
        seed: int,
    ) -> None:
        self.gram = gram
        self.base = base
        self.n_sets = n_sets
        self.level = level
        bare = project(gram, base)
        self.hypotheses = _without_doubles(hypotheses, bare)
        rng = np.random.default_rng(seed)
        self.trials = [h.trials or effective_trials(bare, h.points, rng) for h in self.hypotheses]

    def given(self, members: Sequence[Member]) -> Projection:
        """Everything with the model of `members`, and the freedom of their shapes, projected out."""
        columns = np.concatenate([self.base, *(m.columns for m in members)])
        free = [m.free for m in members if m.free.size]
        return project(self.gram, columns, np.concatenate(free, axis=1) if free else None)

    def scores(
        self, projection: Projection, exclude: Sequence[str] = (), strangers: bool = True
    ) -> list[Score]:
        """Test every hypothesis, the best evidence first."""
        found = []
        for h, trials in zip(self.hypotheses, self.trials, strict=True):
            if h.id in exclude or not (h.in_catalogue or strangers):
                continue
            gains = projection.gains(h.points)
            weighed = gains
            if h.positive:
                amplitude_sign = projection.score[h.points[:, 0]] < 0
                weighed = gains + 2.0 * WRONG_SIGN * amplitude_sign
            point = int(np.argmax(weighed))
            gain = float(gains[point])
            if h.random:
                evidence = random_evidence(projection, h.points[0]) + h.prior
            else:
                evidence = log_evidence(weighed, h.df, self.n_sets, h.weights) + h.prior
            found.append(Score(h, point, gain, tail(gain, h.df, trials), evidence))
        return sorted(found, key=lambda s: -s.evidence)

    def significant(self, scores: Sequence[Score]) -> list[Score]:
        """Those whose null is rejected: Holm over the catalogue, and separately over the strangers."""
        found: list[Score] = []
        for known in (True, False):
            group = [s for s in scores if s.hypothesis.in_catalogue == known]
            if not group:
                continue
            passed = holm(np.array([s.p_value for s in group]), self.level)
            found += [s for s, ok in zip(group, passed, strict=True) if ok]
        return sorted(found, key=lambda s: -s.evidence)

    def run(self, start: Sequence[Member] = ()) -> list[Member]:
        """The better of two searches: physics first and strangers for what it leaves, or both on equal terms.

        Several effects of the catalogue on top of each other can look like one stranger, and one stranger like
        several effects: the evidence of the whole decides.
        """
        physics = self.forward(self.forward(list(start), strangers=False), strangers=True)
        if not physics:
            return physics
        best = min((physics, self.forward([], strangers=True)), key=self.criterion)
        # Whoever may choose among pairs has more to choose from: each further law pays for the choice of it.
        choice = 2.0 * float(np.log(1 + sum(h.in_catalogue for h in self.hypotheses)))
        return min(
            (best, *self.from_pairs(best)), key=lambda found: self.criterion(found) + choice * len(found)
        )

    def from_pairs(self, members: Sequence[Member]) -> list[list[Member]]:
        """Searches in which the strongest member starts as two laws at once.

        One law can stand for the sum of two others, which no exchange of one law for one other undoes.
        """
        if not members:
            return []
        others = [m for m in members if m is not members[0]]
        projection = self.given(others)
        taken = [m.hypothesis.id for m in others]
        found = []
        for score in self.significant(self.scores(projection, taken, strangers=False))[:_STARTS]:
            first = self._member(score, projection)
            beside = self.given([*others, first])
            second = self.significant(self.scores(beside, [*taken, score.hypothesis.id], strangers=False))
            begun = [*others, first]
            if second and second[0].evidence > 0 and not self._is_misfit(second[0], begun):
                found.append(self.forward([*begun, self._member(second[0], beside)], strangers=True))
        return found

    def criterion(self, members: Sequence[Member]) -> float:
        """Residual sum of squares plus what each member pays for its freedom, in twice nats."""
        price = sum(m.gain - 2.0 * m.evidence + m.free.shape[1] * np.log(self.n_sets) for m in members)
        return float(self.given(members).rss + price)

    def forward(self, members: list[Member], strangers: bool) -> list[Member]:
        """Forward selection; after every addition each member is re-tested against all rivals, or dropped."""
        members = self.settle(members, strangers) if members else []
        tried: set[tuple[str, ...]] = set()
        while len(members) < MOST_EFFECTS:
            projection = self.given(members)
            scores = self.scores(projection, [m.hypothesis.id for m in members], strangers)
            candidates = [
                s for s in self.significant(scores) if s.evidence > 0 and not self._is_misfit(s, members)
            ]
            if not candidates:
                break
            members = self.settle([*members, self._member(candidates[0], projection)], strangers)
            key = tuple(sorted(m.hypothesis.id for m in members))
            if key in tried:
                break
            tried.add(key)
        return sorted(members, key=lambda m: -m.gain)

    def settle(self, members: list[Member], strangers: bool) -> list[Member]:
        """Give each member its best law, shape and p-value given the others; drop what is not needed."""
        for _ in range(3):
            before = [(m.hypothesis.id, m.point) for m in members]
            for member in sorted(members, key=lambda m: m.gain):
                others = [m for m in members if m is not member]
                projection = self.given(others)
                scores = self.scores(projection, [m.hypothesis.id for m in others], strangers)
                passed = [s for s in self.significant(scores) if s.evidence > 0]
                kept = [s for s in passed if self._same_excess(s, member, projection)]
                if not kept:
                    members = others
                    continue
                best = kept[0]
                rivals = tuple(
                    (s.hypothesis.id, best.evidence - s.evidence)
                    for s in kept[1:]
                    if s.hypothesis.id != best.hypothesis.id
                )
                new = replace(self._member(best, projection), rivals=rivals)
                members = [*others, new]
            if sorted(before) == sorted((m.hypothesis.id, m.point) for m in members):
                break
        return members

    def _same_excess(self, score: Score, member: Member, projection: Projection) -> bool:
        """Whether a law speaks of the same excess: its curve shares at least half of the member's."""
        a, b = member.columns, score.hypothesis.points[score.point]
        if score.hypothesis.id == member.hypothesis.id:
            return True
        after = project(projection.restricted(np.concatenate([b, a])), np.arange(b.size))
        left, _ = after.block(np.arange(b.size, b.size + a.size))
        return left < 0.6 * projection.block(a)[0]

    def _member(self, score: Score, projection: Projection) -> Member:
        h = score.hypothesis
        return Member(
            h,
            score.point,
            score.gain,
            score.p_value,
            score.evidence,
            self._free_shapes(h, score.point, score.gain, projection),
        )

    def _free_shapes(self, h: Hypothesis, point: int, gain: float, projection: Projection) -> Floats:
        """Mixtures of the family's columns along which a real effect of this strength may depart from the law."""
        own = h.points[point]
        near = h.points[_near(h, point, projection.gains(h.points) > 0.8 * gain)].ravel()
        family = np.setdiff1d(np.concatenate([near, h.nuisance]), own)
        size = self.gram.shape[0] - 1
        norm = projection.gram[family, family]
        family = family[norm > 1e-6 * projection.norm[family]]
        if family.size == 0:
            return np.empty((size, 0))
        scale = np.sqrt(projection.gram[family, family])
        after = project(projection.restricted(np.concatenate([own, family])), np.arange(own.size))
        inner = after.gram[own.size :, own.size :] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(inner)
        kept = values * gain / family.size > _FREE_GAIN
        mixtures = np.zeros((size, int(kept.sum())))
        mixtures[family] = vectors[:, kept] / scale[:, None]
        return mixtures

    def _is_misfit(self, score: Score, members: Sequence[Member]) -> bool:
        return any(
            related(score.hypothesis.coordinate, m.hypothesis.coordinate)
            and score.gain < _MISFIT_SHARE * m.gain
            for m in members
        )


def _near(h: Hypothesis, point: int, good: NDArray[np.bool_]) -> Ints:
    """Grid points that explain almost as much as the best; of instants only those around it, not a second jump."""
    if "at_s" not in h.shapes[point]:
        return np.flatnonzero(good)
    order = np.argsort([shape["at_s"] for shape in h.shapes])
    place = int(np.flatnonzero(order == point)[0])
    worse = np.flatnonzero(~good[order])
    low = int(worse[worse < place][-1]) + 1 if (worse < place).any() else 0
    high = int(worse[worse > place][0]) if (worse > place).any() else order.size
    return order[low:high]


def _without_doubles(hypotheses: Sequence[Hypothesis], bare: Projection) -> list[Hypothesis]:
    """Drop strangers' shapes that a one-column law of the catalogue has as well, and shapes that say nothing."""
    known = [h.points[:, 0] for h in hypotheses if h.in_catalogue and h.df == 1]
    laws = np.concatenate(known) if known else np.empty(0, dtype=np.int64)
    laws = laws[bare.gram[laws, laws] > 1e-7 * bare.norm[laws]]
    found = []
    for h in hypotheses:
        norm = bare.gram[h.points[:, 0], h.points[:, 0]]
        keep = norm > 1e-7 * bare.norm[h.points[:, 0]]
        if not h.in_catalogue and not h.repeats and h.df == 1 and laws.size and keep.any():
            own = h.points[:, 0]
            inner = bare.gram[np.ix_(own, laws)] ** 2
            inner /= np.maximum(norm[:, None], 1e-300) * bare.gram[laws, laws][None, :]
            keep &= inner.max(axis=1) < _SAME_SHAPE
        if keep.any():
            shapes = tuple(s for s, ok in zip(h.shapes, keep, strict=True) if ok)
            found.append(replace(h, points=h.points[keep], shapes=shapes))
    return found
