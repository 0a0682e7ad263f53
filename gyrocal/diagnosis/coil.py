"""Tables of sweeps: at which temperature the coil was, what time did, and what the bias remembers, found jointly.

While a sweep of rates drifts in temperature, a lag of the coil, a drift and a step of the scale factor look alike;
whichever is taken first takes the others' share. So they start together, from every combination, and a beam goes on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws import laws_of
from gyrocal.diagnosis.layers import Fitted, Law, Model, contrasts_of
from gyrocal.diagnosis.parts import Coil, since_on
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import MDPS, PPM
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.thermal import SHUPE_GRADIENT, THERMAL_HYSTERESIS
from gyrocal.physics.timewise import BIAS_DRIFT, BIAS_STEP, SCALE_DRIFT, SCALE_STEP, WARM_UP
from gyrocal.units import NORMAL_95, S_PER_H

Floats = NDArray[np.float64]
Shape = TypeVar("Shape", bound=float)

#: A law of time or of the temperature's history: effect, and its one shape; of a step the row from which on it holds.
Change = tuple[str, float]

#: Time constants that a coil may have, s; of a logarithm that is normal, these are 95 %.
LAG_BOUNDS_S = (30.0, 1500.0)
_SHARES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
_LAGS_S = tuple(np.geomspace(*LAG_BOUNDS_S, 18).round(1).tolist())
#: Of these, with which a search begins.
_FIRST_SHARES, _FIRST_LAGS_S = _SHARES[1::2] + _SHARES[-1:], _LAGS_S[3:16:3]
#: What is the surface's, or is freed of it.
_AT_COIL = ("surface", "temperature")
_STEPS = (SCALE_STEP.id, BIAS_STEP.id)
_DRIFTS = (SCALE_DRIFT.id, BIAS_DRIFT.id)
#: Laws of the temperature's history that act on the bias alone, and their shape.
_HISTORY = {SHUPE_GRADIENT.id: "tau_s", THERMAL_HYSTERESIS.id: "width_c"}
#: Time constants of a warm-up, s; one that the record does not outlast by half is a drift.
_WARM_UPS_S = tuple(np.geomspace(60.0, 7200.0, 31).round().tolist())
_OUTLASTED = 1.5
#: A step has data sets on either side.
_FEWEST_SETS = 4
_MOST_CHANGES = 3
_BEAM = 3
_ROUNDS = 6
_ITERATIONS = 20
#: What a further law pays, nats; with the logarithm of the root of the number of its shapes.
_TOLL_NATS = 3.0
#: And the first one this: beside none, what else has a name goes into the file by its law and not as smooth parts.
_FIRST_NATS = 1.0
#: Models within this of the best one are averaged.
AVERAGED_NATS = 4.0
#: Around models within this of the best one every shape is tried, and around no more of them than this.
_SPREAD_NATS, _MOST_SPREAD = 2.5, 20


@dataclass(frozen=True)
class Candidate:
    """A model of a table: `score` is its negative log evidence with what its laws pay, nats."""

    coil: Coil
    changes: tuple[Change, ...]
    fitted: Fitted
    score: float

    @property
    def effects(self) -> set[str]:
        """Its laws beside the coil's lag."""
        return {effect for effect, _ in self.changes}

    @property
    def warms_up(self) -> bool:
        """Whether a warm-up is among its laws of time."""
        return WARM_UP.id in self.effects


@dataclass
class TableSearch:
    """Models of a table that were fitted, each once."""

    base: Model
    known: dict[tuple[Coil, tuple[Change, ...]], Candidate] = field(default_factory=dict)
    _at_coil: dict[Coil, Model] = field(default_factory=dict)
    _at_hand: tuple[Candidate, tuple[Floats, Floats]] | None = None

    @cached_property
    def _remembering(self) -> dict[str, dict[float, Law]]:
        """Laws of the temperature's history by effect and shape; none acts through the surface."""
        frame = self.base.basis.frame
        blank = Surface(np.zeros(SHAPE), 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c)
        laws = laws_of(self.base.means, blank)
        found: dict[str, dict[float, Law]] = {}
        for effect, name in _HISTORY.items():
            tried = [trial.shape[name] for trial in laws.trials(CATALOGUE[effect])]
            # A search over models refines no shape: its grid is as fine as that of a warm-up.
            grid = np.geomspace(min(tried), max(tried), len(_WARM_UPS_S)).tolist() if tried else []
            shapes = [{name: float(at)} for at in grid]
            found[effect] = {s[name]: Law(effect, s, laws.at(CATALOGUE[effect], s)) for s in shapes}
        return found

    def run(self) -> list[Candidate]:
        """All models that were fitted, the best first."""
        first = self.fit(None, (), None)
        coils: list[Coil] = [None]
        if np.ptp(self.base.means.series.history.temp_c) > 1.0:
            coils += [(a, tau) for tau in _FIRST_LAGS_S for a in _FIRST_SHARES]
        beam = [self.fit(None, (change,), first) for change in self.best_lasting(first)]
        for coil in coils:
            alone = self.fit(coil, (), first)
            beam += [alone, self.fit(coil, ((_DRIFTS[0], 0),), first)]
            beam.append(self.fit(coil, (self.best_step(alone, _STEPS[0]),), first))
        beam = _best(beam)
        for _ in range(_ROUNDS):
            wider = [self.fit(*move, c) for c in beam for move in self.moves(c)]
            wider = _best([*beam, *wider])
            if [c.score for c in wider] == [c.score for c in beam]:
                break
            beam = wider
        self._spread()
        return sorted(self.known.values(), key=lambda c: c.score)

    def _spread(self) -> None:
        """Every shape near those of the best models, so that an average over them is one over all that they may be."""
        done: set[tuple[Coil, tuple[Change, ...]]] = set()
        while len(done) < _MOST_SPREAD:
            best = min(self.known.values(), key=lambda c: c.score)
            near = [c for k, c in self.known.items() if k not in done and c.score < best.score + _SPREAD_NATS]
            if not near:
                break
            start = min(near, key=lambda c: c.score)
            done.add((start.coil, start.changes))
            for move in self.reshaped(start):
                self.fit(*move, start)

    def fit(self, coil: Coil, changes: tuple[Change, ...], near: Candidate | None) -> Candidate:
        """A model with the variances of a near one for a start."""
        key = coil, changes
        if key not in self.known:
            model = self.model(coil, changes)
            if near is None:
                designs = [replace(self.base.basis, coil=(1.0, tau)).surface() for tau in _FIRST_LAGS_S]
                contrasts = contrasts_of(model, designs=designs)
            else:
                contrasts = contrasts_of(model, near.fitted.contrasts)
            start = None if near is None else near.fitted.fit.log_variance
            fit = contrasts.fit(model.all, start, _ITERATIONS if near else 60)
            self.known[key] = Candidate(
                coil, changes, Fitted(model, fit, contrasts), fit.nll + self._toll(coil, changes)
            )
        return self.known[key]

    def model(self, coil: Coil, changes: tuple[Change, ...]) -> Model:
        """The base with the surface at the coil, and laws of time."""
        if coil not in self._at_coil:
            basis = replace(self.base.basis, coil=coil)
            moved = {p.name: basis.component(p) for p in self.base.parts if p.block in _AT_COIL}
            self._at_coil[coil] = replace(
                self.base, basis=basis, design=basis.surface(), components={**self.base.components, **moved}
            )
        return replace(self._at_coil[coil], laws=tuple(self.law(change) for change in changes))

    def law(self, change: Change) -> Law:
        """A change as a law of the model: what remembers stays, and a warm-up comes again with the next switch-on.

        The others are zero at the end of the record, whose state the surface is to have.
        """
        m, (effect, at) = self.base.means, change
        if effect in _HISTORY:
            return self._remembering[effect][at]
        if effect in _STEPS:
            row = int(at)
            shape = {"at_s": float(0.5 * (m.t_s[row - 1] + m.t_s[row]))}
            columns = -1.0 * (np.arange(len(m)) < row)
        elif effect == WARM_UP.id:
            shape = {"tau_s": at}
            columns = np.exp(-since_on(m) / at)
        else:
            shape = {}
            columns = (m.t_s - m.t_s[-1]) / S_PER_H
        of_scale = "rate_dps" in CATALOGUE[effect].needs
        scale = PPM * m.rate_dps if of_scale else np.full(len(m), MDPS)
        return Law(effect, shape, (columns * scale)[:, None], from_end=effect != WARM_UP.id)

    def best_step(self, candidate: Candidate, effect: str) -> Change:
        """The boundary between data sets at which a step gains most."""
        rows = range(_FEWEST_SETS, len(self.base.means) - _FEWEST_SETS)
        return self._best_of(candidate, [(effect, row) for row in rows])

    def best_lasting(self, candidate: Candidate) -> list[Change]:
        """Of each kind that stays, that the record may show and that the candidate lacks, the one that gains most.

        A warm-up is one since the record began.
        """
        span_s = float(np.ptp(self.base.means.t_s))
        kinds = {WARM_UP.id: [tau for tau in _WARM_UPS_S if _OUTLASTED * tau < span_s]}
        kinds |= {effect: list(laws) for effect, laws in self._remembering.items()}
        return [
            self._best_of(candidate, [(effect, at) for at in shapes])
            for effect, shapes in kinds.items()
            if shapes and effect not in candidate.effects
        ]

    def _best_of(self, candidate: Candidate, tried: Sequence[Change]) -> Change:
        score, p = self._precision(candidate)
        x = np.column_stack([self.law(change).columns[:, 0] for change in tried])
        gain = (x.T @ score) ** 2 / np.maximum(np.einsum("ij,ij->j", x, p @ x), 1e-300)
        return tried[int(np.argmax(gain))]

    def _precision(self, candidate: Candidate) -> tuple[Floats, Floats]:
        """Of the candidate at hand, for which every kind of step and the warm-up are tried in turn."""
        if self._at_hand is None or self._at_hand[0] is not candidate:
            f = candidate.fitted
            self._at_hand = candidate, f.contrasts.precision(f.model.all, f.fit.log_variance)
        return self._at_hand[1]

    def moves(self, candidate: Candidate) -> Iterable[tuple[Coil, tuple[Change, ...]]]:
        """Models one step away."""
        coil, changes = candidate.coil, candidate.changes
        if coil is not None:
            yield None, changes
        for k in range(len(changes)):
            yield coil, changes[:k] + changes[k + 1 :]
        yield from self.reshaped(candidate)
        if len(changes) < _MOST_CHANGES:
            for effect in _STEPS:
                yield coil, tuple(sorted({*changes, self.best_step(candidate, effect)}))
            for effect in _DRIFTS:
                yield coil, tuple(sorted({*changes, (effect, 0)}))
            for change in self.best_lasting(candidate):
                yield coil, tuple(sorted({*changes, change}))

    def reshaped(self, candidate: Candidate) -> Iterable[tuple[Coil, tuple[Change, ...]]]:
        """The same laws, one of them in a neighbouring shape."""
        coil, changes = candidate.coil, candidate.changes
        if coil is not None:
            share, tau_s = coil
            yield from (((near, tau_s), changes) for near in _neighbours(_SHARES, share))
            yield from (((share, near), changes) for near in _neighbours(_LAGS_S, tau_s))
        rows = range(_FEWEST_SETS, len(self.base.means) - _FEWEST_SETS)
        for k, (effect, at) in enumerate(changes):
            grid = rows if effect in _STEPS else self._shapes(effect)
            others = changes[:k] + changes[k + 1 :]
            yield from ((coil, tuple(sorted({*others, (effect, near)}))) for near in _neighbours(grid, at))

    def _shapes(self, effect: str) -> Sequence[float]:
        """The shapes that a law which is no step may have."""
        return _WARM_UPS_S if effect == WARM_UP.id else tuple(self._remembering.get(effect, ()))

    def _toll(self, coil: Coil, changes: tuple[Change, ...]) -> float:
        """What the laws of a model pay, nats: a coil's time constant its prior too, a normal one of its logarithm."""
        shapes = [float(len(_FIRST_SHARES) * len(_FIRST_LAGS_S))] if coil else []
        steps = float(len(self.base.means))
        shapes += [
            steps if effect in _STEPS else float(max(len(self._shapes(effect)), 1)) for effect, _ in changes
        ]
        paid = _FIRST_NATS + float(np.sum(_TOLL_NATS + 0.5 * np.log(shapes))) if shapes else 0.0
        if coil is None:
            return paid
        low, high = np.log(LAG_BOUNDS_S)
        off = (np.log(coil[1]) - 0.5 * (low + high)) / ((high - low) / (2.0 * NORMAL_95))
        return paid + 0.5 * float(off**2)


def _neighbours(grid: Sequence[Shape], value: Shape) -> list[Shape]:
    """The values before and after one of a grid."""
    if value not in grid:
        return []
    at = grid.index(value)
    return [grid[k] for k in (at - 1, at + 1) if 0 <= k < len(grid)]


def _best(candidates: list[Candidate]) -> list[Candidate]:
    different = {(c.coil, c.changes): c for c in candidates}
    return sorted(different.values(), key=lambda c: c.score)[:_BEAM]


def averaged(candidates: list[Candidate]) -> list[tuple[float, Candidate]]:
    """The models worth averaging over, with their weights.

    With a warm-up or without, as the best one: a robot that need not know when it was switched on shall not have to.
    """
    close = [c for c in candidates if c.score < candidates[0].score + AVERAGED_NATS]
    near = [c for c in close if c.warms_up == candidates[0].warms_up]
    weight = np.exp([candidates[0].score - c.score for c in near])
    return list(zip((weight / weight.sum()).tolist(), near, strict=True))
