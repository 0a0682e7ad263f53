"""Tables of sweeps: at which temperature the coil was, what time did, and what the bias remembers, found jointly.

While a sweep of rates drifts in temperature, a lag of the coil, a drift and a step of the scale factor look alike;
whichever is taken first takes the others' share. So they start together, from every combination, and a beam goes on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.laws.contest import best_law, price
from gyrocal.diagnosis.laws.estimates import reshaped
from gyrocal.diagnosis.model.blocks import of_scale
from gyrocal.diagnosis.model.edges import targets, with_edges
from gyrocal.diagnosis.model.layers import WANDERING_SCALE, Fitted, Law, Model, contrasts_of, lagging
from gyrocal.diagnosis.model.parts import (
    AT_FEW,
    DRIFTING_BIAS,
    DRIFTING_SCALE,
    EACH_RATE,
    EVEN,
    ODD,
    Coil,
    Part,
    drifts,
    of_each_direction,
    passing,
    remembering,
)
from gyrocal.diagnosis.sweeps.candidates import Candidate, best_of_each
from gyrocal.diagnosis.sweeps.changes import DRIFTS, STEPS, Change, Changes
from gyrocal.diagnosis.sweeps.finer import halved, neighbours
from gyrocal.inference.additive import START, Component, Contrasts, Solution, gains
from gyrocal.physics.surface import SHAPE
from gyrocal.physics.thermal import THERMAL_LAG
from gyrocal.physics.timewise import BIAS_DRIFT, BIAS_STEP, SCALE_DRIFT, SCALE_STEP

Floats = NDArray[np.float64]

#: Time constants that are tried for a coil, s. Where a table hardly tells, a lag of a quarter of an hour would move a coil by
#: ten degrees for nothing, were it not for those that coils have (`THERMAL_LAG`).
LAG_BOUNDS_S = (30.0, 1500.0)
#: Shares of the whole lag, negative where the sensor lags behind the coil; what lies between them is told by its posterior
#: (`lag_posterior`).
_SHARES = (-0.85, -0.7, -0.55, -0.4, -0.25, -0.1, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
#: Time constants between the bounds, each a quarter longer than the one before.
_LAGS_S = tuple(np.geomspace(*LAG_BOUNDS_S, 18).round(1).tolist())
#: Of these, with which a search begins.
_FIRST_SHARES, _FIRST_LAGS_S = (-0.25, 0.25, 0.55, 0.85, 1.0), _LAGS_S[3:16:3]
#: The coil has been through this share of the range of temperatures: of the rest nobody knows what it would do.
_REACHED = 0.7
#: What is the surface's, or is freed of it.
_AT_COIL = ("surface", "temperature", AT_FEW)
#: Laws of time and memory beside the lag: four and more trade their shares freely on the tables that were made up.
_MOST_CHANGES = 3
#: Models that the search goes on with, and how often: it costs as much as their number.
_BEAM, _ROUNDS = 3, 6
#: What a further law pays, nats; with the logarithm of the root of the number of its shapes.
TOLL_NATS = 3.0
#: One that is not of one time constant, sudden or straight pays this beside: of two that explain as much the plain one.
_ODD_NATS = 1.5
#: Where laws cancel each other or the surface they pay this, nats, for each multiple of what the record shows by which their
#: sizes together exceed it.
_CANCELLED_NATS = 2.0
#: The first law pays this beside: without any, what has a name is written as its law and not as smooth parts.
_FIRST_NATS = 1.0
#: Models of so many sets of laws are fitted beside smooth parts, and without the laws that those can stand for.
_BESIDE_SMOOTH = 3
#: And of so many sets with a law of the rate; a search without shapes in temperature begins with as many.
BEGUN_WITH = 6
#: Block of smooth shapes in temperature, and that of the rate whose laws may stand beside it.
SHAPES, _OF_RATE = "temperature", ODD
#: Around models within this of the best one every shape is tried, and around no more of them than this.
_SPREAD_NATS, _MOST_SPREAD = 2.5, 40


def table_search(base: Model) -> TableSearch:
    """A search over models of a table that begin with this one."""
    return TableSearch(base, Changes(base.means, base.basis.frame))


@dataclass
class TableSearch:
    """Models of a table that were fitted, each once."""

    base: Model
    changes: Changes
    #: Shares and time constants of the coil's lag that are tried.
    shares: list[float] = field(default_factory=lambda: [*_SHARES])
    lags_s: list[float] = field(default_factory=lambda: [*_LAGS_S])
    known: dict[tuple[Coil, tuple[Change, ...]], Candidate] = field(default_factory=dict)
    _at_coil: dict[Coil, Model] = field(default_factory=dict)
    _contrasts: dict[Coil, Contrasts] = field(default_factory=dict)
    _at_hand: tuple[Candidate, tuple[Floats, Floats]] | None = None

    def run(self, near: Sequence[Candidate] = ()) -> list[Candidate]:
        """All models that were fitted, the best first.

        Parameters
        ----------
        near : models of another search, the best first, of which this one begins with the best of each kind, in place of coils of all kinds
        """
        near = best_of_each(near)[:BEGUN_WITH]
        first = self.fit(None, (), None)
        coils: list[Coil] = [None, *dict.fromkeys(c.coil for c in near if c.coil is not None)]
        if not near and np.ptp(self.base.means.series.history.temp_c) > 1.0:
            lags = [(a, tau) for tau in _FIRST_LAGS_S for a in _FIRST_SHARES]
            coils += [lag for lag in lags if self._reached(lag)]
        beam = [self.fit(None, (change,), first) for change in self.best_lasting(first)]
        beam += [self.fit(c.coil, c.changes, first) for c in near]
        # What drifts or jumps in the bias mostly does so in the scale factor too, and one alone shows little.
        of_bias = [
            (change,) for effect in (BIAS_DRIFT.id, BIAS_STEP.id) for change in self.best(first, effect)
        ]
        for coil, changes in [*((coil, ()) for coil in coils), *((None, changes) for changes in of_bias)]:
            alone = self.fit(coil, changes, first)
            beam.append(alone)
            for effect in (SCALE_DRIFT.id, SCALE_STEP.id):
                more = self.best(alone, effect)
                beam += [self.fit(coil, tuple(sorted({*changes, change})), alone) for change in more]
        best = self._climb(beam)
        finer = self._refined(best)
        if finer is not best:
            self._climb([self.fit(*_shaped_as(c, finer), finer) for c in self._ranked()[:BEGUN_WITH]])
        self._spread()
        return self._ranked()

    def _ranked(self) -> list[Candidate]:
        return sorted(self.known.values(), key=lambda c: c.score)

    def _climb(self, beam: list[Candidate]) -> Candidate:
        """The best of all models, after some were changed step by step."""
        beam = _best(beam)
        for _ in range(_ROUNDS):
            wider = [self.fit(*move, c) for c in beam for move in self.moves(c)]
            wider = _best([*beam, *wider])
            if [c.score for c in wider] == [c.score for c in beam]:
                break
            beam = wider
        return self._ranked()[0]

    def _refined(self, c: Candidate) -> Candidate:
        """The best between the shapes of a model and those next to them, which are tried from then on."""
        for change in c.changes:
            if change.effect in self.changes.values and change.beside is None:
                at = halved(self.changes.values[change.effect], change.at, partial(self._cost, c, change))
                c = self._with_shape(c, change, at)
        if c.coil is not None:
            share, tau_s = c.coil
            tau_s = halved(self.lags_s, tau_s, lambda x: self.fit((share, x), c.changes, c).score)
            share = halved(self.shares, share, lambda x: self.fit((x, tau_s), c.changes, c).score)
            c = self.fit((share, tau_s), c.changes, c)
        return c

    def _with_shape(self, c: Candidate, change: Change, at: float) -> Candidate:
        """A model with one of its laws at another shape."""
        return self.fit(c.coil, replaced(c.changes, change, change._replace(at=at)), c)

    def _cost(self, c: Candidate, change: Change, at: float) -> float:
        return self._with_shape(c, change, at).score

    def _over(self, base: Model, changes: Changes | None = None) -> TableSearch:
        """The search over another model, which compares with this one."""
        contrasts: dict[Coil, Contrasts] = {None: self._contrasts[None]}
        return TableSearch(base, changes or self.changes, self.shares, self.lags_s, _contrasts=contrasts)

    def before_sine(self, slope: Floats) -> TableSearch:
        """The search over models in which all that changes the scale factor does so before an open loop's sine of that slope."""
        means, frame = replace(self.base.means, slope=slope), self.base.basis.frame
        felt = {c.name: c for c in passing(means, frame) if c.name in self.base.components}
        basis, components = replace(self.base.basis, means=means), {**self.base.components, **felt}
        base = replace(self.base, means=means, basis=basis, components=components)
        return self._over(base, self.changes.at(means))

    def beside(self, laws: Sequence[Law]) -> TableSearch:
        """The search over models that have some laws, which compare with these."""
        return self._over(self.base.with_laws(*laws))

    def with_edges(self, candidate: Candidate) -> TableSearch | None:
        """The search beside edges over temperature, in the place of what passes in a model; None without any."""
        stays = tuple(change for change in candidate.changes if change.effect not in (*STEPS, *DRIFTS))
        on = targets([change.effect for change in candidate.changes])
        edged = with_edges(self.fit(candidate.coil, stays, candidate).fitted, on).model
        parts = [p for p in edged.parts if p not in self.base.parts]
        if not parts:
            return None
        return self._over(self.base.with_parts(parts))

    @property
    def shapes(self) -> list[Part]:
        """Smooth shapes in temperature that its models may have."""
        return [p for p in self.base.parts if p.block == SHAPES]

    def without(self, names: Sequence[str]) -> TableSearch:
        """The search over models without some parts, which compare with these; in which they had died, those are known."""
        parts = tuple(p for p in self.base.parts if p.name not in names)
        less = self._over(replace(self.base.without(names), parts=parts))
        less.known.update(
            (key, c.without(names)) for key, c in self.known.items() if all(map(c.fitted.has_died, names))
        )
        return less

    def beside_smooth(self, ranked: Sequence[Candidate]) -> list[Candidate]:
        """The best models, and those with their steps alone, beside smooth parts of temperature's history and of time.

        Few gyros obey a law: what one leaves is taken for a warm-up or a step, or a law is taken that is none. What the scale
        factor remembers is like a coil's lag, and pays by itself.
        """
        parts = remembering(self.base.means)
        of_bias = [p for p in parts if not of_scale(p)]
        if not parts:
            return []
        chosen = {(c.coil, c.changes): c for c in best_of_each(ranked)[:_BESIDE_SMOOTH]}
        for c in [*chosen.values()]:
            steps = tuple(change for change in c.changes if change.effect in STEPS)
            for key in ((None, steps), (c.coil, steps)):
                chosen.setdefault(key, self.fit(*key, c))
        chosen[None, ()] = self.known[None, ()]
        kinds = [of_bias, parts] if len(parts) > len(of_bias) else [of_bias]
        return sorted(
            (self._with_smooth(c, kind) for c in chosen.values() for kind in kinds), key=lambda c: c.score
        )

    def with_law_of_rate(self, ranked: Sequence[Candidate], laws: Laws) -> list[Candidate]:
        """The best models, each with the law of the rate that gains most beside the first, where it is worth what it pays.

        Errors of each rate of the table follow a knee through every rate that was visited, and between two of them know
        nothing. That of seven rates a knee explains all is seldom enough for a name, but mostly true.
        """
        best = ranked[0].fitted
        won = best_law(best, best, _OF_RATE, laws.of_one_amplitude(_OF_RATE), laws)
        if won is None:
            return []
        # A grid coarse enough for a name leaves a robot's rates what the true shape would take.
        shaped = reshaped(won.fitted, laws, [won.law.name])
        law = shaped.model.laws[-1]
        found, nearest = [], best_of_each(ranked)[:BEGUN_WITH]
        for c in nearest:
            fitted = shaped if c is ranked[0] else c.fitted.refit(c.fitted.model.with_laws(law))
            paid = price(law, won.shapes, TOLL_NATS)
            found.append(replace(c, fitted=fitted, score=c.score + fitted.nll - c.fitted.nll + paid))
        # With a sine of so small a phase that the cubic does as well, neither surface nor law would be what it says.
        return [with_law for with_law, c in zip(found, nearest, strict=True) if with_law.score < c.score]

    def with_errors_of_each_rate(self, near: Sequence[Candidate]) -> list[Candidate]:
        """Models with errors of each rate of the table alone in place of shapes in rate, which pay together what a law pays.

        A few rates are followed by anything smooth as well as by errors that know nothing of each other, and only one of
        the two is the gyro's. A table may err in each direction by itself: then those that are even in rate are its own too.
        """
        draws = self.base.components.get(EACH_RATE)
        if draws is None:
            return []
        odd = [c for c in near if self._shapes(c.fitted.model, _OF_RATE)]
        plain = [self._with_draws(c, _OF_RATE, [draws], TOLL_NATS) for c in odd]
        own = [draws, of_each_direction(self.base.means, self.base.basis.frame)]
        even = [c for c in (*near, *plain) if self._shapes(c.fitted.model.alive(c.fitted.fit), EVEN)]
        return plain + [self._with_draws(c, EVEN, own, 0.0) for c in even]

    def _shapes(self, model: Model, block: str) -> list[str]:
        """Components of a block that a model has."""
        return [p.name for p in self.base.parts if p.block == block and p.name in model.components]

    def _with_draws(self, c: Candidate, block: str, draws: Sequence[Component], saved: float) -> Candidate:
        """A model with errors of each rate in place of a block of shapes in rate, for which it paid."""
        plain = c.fitted.model.without(self._shapes(c.fitted.model, block))
        fitted = c.fitted.refit(
            plain.with_components(*draws),
            start={**c.fitted.fit.log_variance, **{d.name: START for d in draws}},
        )
        return replace(c, fitted=fitted, score=c.score + fitted.nll - c.fitted.nll - saved)

    def _with_smooth(self, candidate: Candidate, parts: Sequence[Part]) -> Candidate:
        """A model beside smooth parts, which pay what a law pays: together, and those of the scale factor once more."""
        coil, changes, near = candidate.coil, candidate.changes, candidate.fitted
        means, frame = self.base.means, self.base.basis.frame
        more = [*drifts(means, frame), *(c for c in passing(means, frame) if c.name == "scale walk")]
        if not self.changes.tells_of_scale:
            more = [c for c in more if c.name == DRIFTING_BIAS]
        model = near.model.with_parts(parts)
        fitted = near.refit(model.with_components(*more))
        paid = self._toll(coil, changes) + (0.0 if coil or changes else _FIRST_NATS)
        paid += TOLL_NATS * (1 + any(map(of_scale, parts)))
        smooth = [p.name for p in parts] + [c.name for c in more if c.columns is not None]
        return Candidate(coil, changes, fitted, fitted.nll + paid + self.cancelled_nats(fitted, smooth))

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
            if coil not in self._contrasts:
                self._contrasts[coil] = self._contrasts_of(model)
            contrasts = self._contrasts[coil]
            start = None if near is None else near.fitted.fit.log_variance
            fit = contrasts.fit(model.all, start)
            fitted = Fitted(model, fit, contrasts)
            added = self._added(model, fitted.solve()).values() if changes else ()
            cancelled = self._cancelled(added, self.base.error_dps)
            paid = self._toll(coil, changes) + _CANCELLED_NATS * cancelled
            self.known[key] = Candidate(coil, changes, fitted, fit.nll + paid)
        return self.known[key]

    def _contrasts_of(self, model: Model) -> Contrasts:
        """Contrasts that all models with the same coil share."""
        if None in self._contrasts:
            return contrasts_of(model, self._contrasts[None])
        designs = [replace(self.base.basis, coil=(1.0, tau)).surface() for tau in _FIRST_LAGS_S]
        return contrasts_of(model, designs=designs)

    @cached_property
    def _by_rate(self) -> Floats:
        """What is the same at all times and temperatures, as an orthonormal basis, shape (n, p)."""
        return np.linalg.qr(self.base.design[:, [k for k in self.base.flat if k % SHAPE[1] == 0]])[0]

    def _beyond_rate(self, columns: Floats) -> float:
        """Root mean square of what is not the same at all times and temperatures."""
        return float(np.sqrt(np.mean((columns - self._by_rate @ (self._by_rate.T @ columns)) ** 2)))

    def cancelled_nats(self, fitted: Fitted, smooth: Sequence[str]) -> float:
        """What a model pays where its laws and some smooth parts cancel each other, in all or in the bias alone, nats.

        The record mostly shows a scale factor, beside which a drift of the bias and a slope over temperature may be of any size.
        But what drifts while it warms up may well hide most of the slope: of the bias it is one multiple at most.
        """
        model, solution = fitted.model, fitted.solve()
        added = self._added(model, solution, smooth)
        of_bias = [curve for name, curve in added.items() if name not in self._with_rate(model)]
        still = model.design[:, : SHAPE[1]] @ model.legendre(solution)[: SHAPE[1]]
        in_bias = self._cancelled(of_bias, still + np.sum(of_bias, axis=0)) if of_bias else 0.0
        return _CANCELLED_NATS * max(self._cancelled(added.values(), self.base.error_dps), min(in_bias, 1.0))

    def _cancelled(self, curves: Iterable[Floats], shown: Floats) -> float:
        """How far curves go together beyond what is shown, as a share of that.

        Each hides the others. The surface and what passes can take back nearly all of a law that is like them, and the record would not tell.
        """
        size = self._beyond_rate(shown)
        return max(0.0, sum(map(self._beyond_rate, curves)) / size - 1.0) if size else 0.0

    def _added(self, model: Model, solution: Solution, smooth: Sequence[str] = ()) -> dict[str, Floats]:
        """What the laws that the base lacks and some smooth parts add, each by its name, shape (n,)."""
        columns = {law.name: law.columns for law in model.laws if not self.base.holds(law)}
        columns |= {
            n: c.columns for n, c in model.components.items() if n in smooth and c.columns is not None
        }
        return {name: own @ solution.amplitudes[name] for name, own in columns.items()}

    def _with_rate(self, model: Model) -> set[str]:
        """Laws that go by the rate, and what of the components stands for the scale factor in time or over temperature."""
        laws = {law.name for law in model.laws if law.goes_by_rate}
        return laws | {p.name for p in model.parts if of_scale(p)} | {*WANDERING_SCALE, DRIFTING_SCALE}

    def model(self, coil: Coil, changes: tuple[Change, ...]) -> Model:
        """The base with the surface at the coil, and laws of time."""
        if coil not in self._at_coil:
            basis = replace(self.base.basis, coil=coil)
            moved = {p.name: basis.component(p) for p in self.base.parts if p.block in _AT_COIL}
            self._at_coil[coil] = replace(
                self.base, basis=basis, design=basis.surface(), components={**self.base.components, **moved}
            )
        return self._at_coil[coil].with_laws(*(self.changes.law(change) for change in changes))

    def best(self, candidate: Candidate, effect: str, on_scale: bool = False) -> list[Change]:
        """The shape of an effect that gains most beside a candidate; none where the record cannot show any."""
        tried = self.changes.shapes(effect, on_scale)
        if not tried:
            return []
        found = 0.5 * gains(self.changes.columns(effect, on_scale), *self._precision(candidate))
        found += self.changes.priors_nats(effect, on_scale)
        return [tried[int(np.argmax(found))]]

    def best_coil(self, candidate: Candidate) -> Coil:
        """The lag of the coil that gains most beside a candidate without one, to first order; None where there is none."""
        score, p = self._precision(candidate)
        surface = candidate.fitted.model.legendre(candidate.fitted.solve())
        x = np.column_stack([gained @ surface for gained in self._lagging.values()])
        along, information = x.T @ score, np.maximum(np.einsum("ij,ij->j", x, p @ x), 1e-300)
        gain = along**2 / information
        k = int(np.argmax(gain))
        share = min(_SHARES, key=lambda a: abs(a - float(along[k] / information[k])))
        coil = share, _LAGS_S[k]
        return coil if gain[k] > 0.0 and self._reached(coil) else None

    @cached_property
    def _lagging(self) -> dict[float, Floats]:
        """What the terms of the surface gain where the coil lags wholly, by its time constant, shape (n, 12) each."""
        return {tau: lagging(replace(self.base.basis, coil=(1.0, tau))) for tau in _LAGS_S}

    def best_lasting(self, candidate: Candidate) -> list[Change]:
        """Of each kind that stays, that the record may show and that the candidate lacks, the one that gains most.

        A warm-up is one since the record began.
        """
        known = {change.kind for change in candidate.changes}
        kinds = [kind for kind in self.changes.lasting if kind not in known]
        return [change for kind in kinds for change in self.best(candidate, *kind)]

    def _precision(self, candidate: Candidate) -> tuple[Floats, Floats]:
        """Of the candidate at hand, for which every kind of step and the warm-up are tried in turn."""
        if self._at_hand is None or self._at_hand[0] is not candidate:
            f = candidate.fitted
            self._at_hand = candidate, f.contrasts.precision(f.model.all, f.fit.log_variance)
        return self._at_hand[1]

    def moves(self, candidate: Candidate) -> Iterable[tuple[Coil, tuple[Change, ...]]]:
        """Models one step away."""
        coil, changes = candidate.coil, candidate.changes
        yield (None if coil is not None else self.best_coil(candidate)), changes
        for change in changes:
            fewer = replaced(changes, change, None)
            yield coil, fewer
            if coil is None:
                # What took a lag's evidence gives it back only when it is gone.
                yield self.best_coil(self.fit(None, fewer, candidate)), fewer
        yield from self.reshaped(candidate)
        for change in changes:
            for more in self.changes.of_scale_too(change):
                yield coil, tuple(sorted({*changes, more}))
        if sum(change.beside is None for change in changes) < _MOST_CHANGES:
            # Steps may be several.
            for effect in (*STEPS, *(e for e in DRIFTS if e not in candidate.effects)):
                for change in self.best(candidate, effect):
                    yield coil, tuple(sorted({*changes, change}))
            for change in self.best_lasting(candidate):
                yield coil, tuple(sorted({*changes, change}))

    def reshaped(self, candidate: Candidate) -> Iterable[tuple[Coil, tuple[Change, ...]]]:
        """The same laws, one of them in a neighbouring shape."""
        coil, changes = candidate.coil, candidate.changes
        if coil is not None:
            share, tau_s = coil
            lags = [(a, tau_s) for a in neighbours(self.shares, share)]
            lags += [(share, tau) for tau in neighbours(self.lags_s, tau_s)]
            yield from ((lag, changes) for lag in filter(self._reached, lags))
        for change in changes:
            if change.beside is None:
                for near in self.changes.neighbours(change):
                    yield coil, replaced(changes, change, near)

    def _reached(self, coil: tuple[float, float]) -> bool:
        """Whether the coil has been through most of the temperatures that its sensor has, and visits to these tell of a lag."""
        m, (share, tau_s) = self.base.means, coil
        coil_c = m.temp_c + share * (m.series.history.lagged_at(tau_s, m.t_s) - m.temp_c)
        return bool(np.ptp(coil_c) >= _REACHED * np.ptp(m.temp_c)) and self.changes.tells_of_scale

    def _toll(self, coil: Coil, changes: tuple[Change, ...]) -> float:
        """What the laws of a model pay, nats: for their priors, too, as a coil's time constant does.

        A coil behind its sensor is what gyros have: it pays for its shapes, and no toll, as a sensor behind its coil does.
        """
        shapes = [len(_FIRST_SHARES) * len(_FIRST_LAGS_S)] if coil else []
        # What stands beside another law has the shape of that.
        own = [change for change in changes if change.beside is None]
        shapes += [self.changes.trials[change.kind] for change in own]
        paid = _ODD_NATS * sum(not change.plain for change in own)
        paid -= sum(change.prior_nats for change in changes)
        paid += TOLL_NATS * len(changes) + 0.5 * float(np.sum(np.log(shapes)))
        paid += _FIRST_NATS if coil or changes else 0.0
        paid += TOLL_NATS if coil and coil[0] < 0.0 else 0.0
        return paid if coil is None else paid - THERMAL_LAG.search.nats_before({"tau_s": coil[1]})


def replaced(changes: tuple[Change, ...], old: Change, new: Change | None) -> tuple[Change, ...]:
    """Laws with another in the place of one, or none, and so of what stands beside that."""
    others = {change for change in changes if old not in (change, change.beside)}
    beside = {new._replace(of_scale=True) for change in changes if new is not None and change.beside == old}
    return tuple(sorted({*others, *beside, *([new] if new is not None else [])}))


def _shaped_as(c: Candidate, like: Candidate) -> tuple[Coil, tuple[Change, ...]]:
    """The laws of a model in the shapes of another's, as far as those are of a grid that became finer."""
    shapes = {change.kind: change for change in like.changes if change.effect not in (*STEPS, *DRIFTS)}
    coil = like.coil if c.coil is not None and like.coil is not None else c.coil
    return coil, tuple(sorted({shapes.get(change.kind, change) for change in c.changes}))


def _best(candidates: list[Candidate]) -> list[Candidate]:
    different = {(c.coil, c.changes): c for c in candidates}
    return sorted(different.values(), key=lambda c: c.score)[:_BEAM]
