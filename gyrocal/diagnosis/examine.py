"""A recording taken apart: patterns within data sets, the layers of their means, and the laws among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN, Laws, effects_of, laws_of
from gyrocal.diagnosis.laws.contest import ALIKE_NATS
from gyrocal.diagnosis.laws.in_place import NAMED_LEVEL, Named, by_chance, is_passing
from gyrocal.diagnosis.laws.jumps import Jump, with_jumps
from gyrocal.diagnosis.laws.misfit import without_mending
from gyrocal.diagnosis.model.blocks import (
    REPLACED,
    errors_of_each_rate,
    idle,
    of_scale,
    present,
    settle_direction,
)
from gyrocal.diagnosis.model.edges import targets, with_edges
from gyrocal.diagnosis.model.layers import (
    WANDERING_BIAS,
    WANDERING_SCALE,
    Fitted,
    Model,
    full_model,
    surface_of,
)
from gyrocal.diagnosis.model.parts import (
    BLOCKS,
    EACH_RATE,
    FOLLOWING,
    ODD,
    SCALE_IN_TIME,
    Basis,
    passing,
)
from gyrocal.diagnosis.model.rate_errors import of_a_table, with_tails
from gyrocal.diagnosis.model.settling import settling
from gyrocal.diagnosis.model.starts import alive, draws_of, fit_anyhow, wandering
from gyrocal.diagnosis.model.within import Pattern, patterns
from gyrocal.diagnosis.names.between import between_sets
from gyrocal.diagnosis.names.naming import Naming, jumped, may_lose, name
from gyrocal.diagnosis.names.rivals import paid_by
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.sweeps.candidates import Candidate, averaged, sine_nats, standing_for_all
from gyrocal.diagnosis.sweeps.coil import SHAPES, TOLL_NATS, TableSearch, table_search
from gyrocal.diagnosis.sweeps.open_loop import slope_of, told_as_sine, with_open_loop
from gyrocal.diagnosis.sweeps.strays import NO_STRAYS, Strays, strays_beside, without
from gyrocal.diagnosis.sweeps.unclocked import leaps
from gyrocal.inference.additive import Component, Solution
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.disturbance import STEP_RESPONSE
from gyrocal.physics.rate import FIT_DIRECTION
from gyrocal.physics.timewise import BIAS_DRIFT

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Examination:
    """What a recording was taken apart into.

    Attributes
    ----------
    series : Series
        Less the patterns within data sets, and less `strays`.
    whole : Fitted
        Every part that is alive, no law.
    settled : Fitted
        The same with its direction settled, with jumps, and with errors of each rate where these are the simpler account.
    worth : mapping
        What each block of `settled` is worth, nats.
    naming : Naming
        With laws in place of parts.
    candidates : tuple
        Of a table of sweeps with a lag of the coil or a law of time: the models near the best, with their weights.
    ranked : tuple of Candidate
        All of them that have no more than laws, the best first.
    smooth : tuple of Candidate
        Those beside smooth parts, the best first.
    of_rate : tuple of Candidate
        Those with a law of the rate, the best first.
    mending : frozenset of str
        Laws of the best of `ranked` that only mend what its others leave.
    strays : Strays
        Data sets of a table that are off by themselves.
    sine_nats : float
        How much likelier models with the sine of an open loop are than those without.
    """

    series: Series
    patterns: tuple[Pattern, ...]
    whole: Fitted
    settled: Fitted
    worth: Mapping[str, float]
    naming: Naming
    laws: Laws
    candidates: tuple[tuple[float, Candidate], ...] = ()
    ranked: tuple[Candidate, ...] = ()
    smooth: tuple[Candidate, ...] = ()
    of_rate: tuple[Candidate, ...] = ()
    mending: frozenset[str] = frozenset()
    strays: Strays = NO_STRAYS
    sine_nats: float = 0.0

    @property
    def comes_again(self) -> float:
        """Probability that what the bias did since power-on begins anew with the next one.

        Zero for a table without a clock whose temperature leaps, and for a run of which nobody says when that was: its beginning is as good as any for a name, but not for a robot that
        counts from its own.
        """
        if (not self.series.is_table and self.series.since_power_on_s is None) or leaps(self.series):
            return 0.0
        if not self.ranked:
            return self.naming.comes_again
        every = [*self.ranked, *self.smooth]
        weight = np.exp(min(c.score for c in every) - np.array([c.score for c in every]))
        return float(weight @ [c.warms_up for c in every] / weight.sum())

    @property
    def rate_errors_nats(self) -> float:
        """Evidence for an error of each rate by itself, where it is enough for a name; else 0.

        What a law leaves of them that takes most is its misfit.
        """
        nats = self.naming.unnamed.get(EACH_RATE, 0.0)
        taken = any(n.block == EACH_RATE for n in self.naming.named)
        return nats if nats > GAIN and not taken and of_a_table(self.naming.fitted) else 0.0

    @property
    def of_the_input(self) -> bool:
        """Whether a surface of the input, not of the output, is a finding by itself.

        Not where a law of the rate explains it, nor where few sizes of the rate leave one number for all that is odd in it.
        """
        told = FIT_DIRECTION.why_not(self.laws.offer) is None
        return told and self.naming.input_gain > GAIN and not self._laws_odd_in_rate

    @property
    def of_a_sine(self) -> bool:
        """Whether models with the sine of an open loop are surely likelier, where no law that is odd in the rate has a name."""
        return self.sine_nats > ALIKE_NATS and not self._laws_odd_in_rate

    @property
    def _laws_odd_in_rate(self) -> list[Named]:
        return [n for n in self.naming.named if n.block in (ODD, EACH_RATE)]

    @property
    def model(self) -> Model:
        """The model at the end."""
        return self.naming.fitted.model


def examine(series: Series, level: float) -> Examination:
    """Take a recording apart: patterns within data sets at the false-alarm rate `level`, then its layers."""
    found = tuple(patterns(series, level))
    left = _less(series, found)
    # A table of sweeps has no ramps in which the coil's lag could be seen by itself.
    if left.is_table and np.ptp(left.rate_dps) > 0:
        return _table(left, found)
    full, fitted = _run(left, found)
    while (more := between_sets(fitted, found, level)) is not None:
        found += (more,)
        left = _less(series, found)
        full, fitted = _run(left, found)
    best = _account(full, fitted)
    still, cost = _at_temperatures(full, fitted, best)
    if still is not None and cost < best.cost - ALIKE_NATS:
        best = still
    return Examination(left, found, best.whole, best.settled, best.worth, best.naming, best.laws)


def _less(series: Series, found: Sequence[Pattern]) -> Series:
    return replace(series, gyro_dps=series.gyro_dps - sum((p.values for p in found), np.zeros(len(series))))


def _run(series: Series, found: Sequence[Pattern]) -> tuple[Model, Fitted]:
    """All that a run may have beside the patterns that were found, and what of it is there."""
    full = full_model(means := means_of(series))
    if any(p.effect == STEP_RESPONSE.id for p in found):
        full = full.with_components(*settling(means))
    return with_tails(full, fit_anyhow(full))


@dataclass(frozen=True)
class _Account:
    """One account of a run; `cost` is its negative log evidence with what its laws pay, nats."""

    whole: Fitted
    settled: Fitted
    worth: Mapping[str, float]
    naming: Naming
    laws: Laws
    cost: float

    @property
    def passing(self) -> list[str]:
        """Components of what wanders in it, or has a name that could be that."""
        of_scale = ["rate_dps" in CATALOGUE[n.law.effect].needs for n in self.naming.named if is_passing(n)]
        names = [*WANDERING_SCALE] if any(of_scale) or SCALE_IN_TIME in self.naming.unnamed else []
        return names if all(of_scale) else [*names, *WANDERING_BIAS]


def _account(full: Model, fitted: Fitted) -> _Account:
    """A run's layers and names.

    Parameters
    ----------
    full : with all that passes, which may have died since
    """
    whole = settle_direction(alive(fitted))
    laws = laws_of(full.means, surface_of(whole.model, whole.solve()))
    passes = wandering(full)
    beside, jumps = _with_jumps(whole, passes, laws)
    if jumps:
        beside = settle_direction(beside)
    settled, worth = present(errors_of_each_rate(beside, draws_of(full)))
    naming, laws = name(settled, worth, laws, [*map(jumped, jumps)], passes)
    paid = sum(paid_by(n) for n in naming.named if naming.fitted.model.holds(n.law))
    return _Account(whole, settled, worth, naming, laws, naming.fitted.nll + paid)


def _at_temperatures(full: Model, fitted: Fitted, first: _Account) -> tuple[_Account | None, float]:
    """Another account of a run, beside edges over temperature and without what passes in the first; None where there are no edges.

    A plan goes through temperatures in turn: what wanders or jumps follows any shape in temperature, and such shapes most of
    what passes. Of eight looked-at recordings in which this account was the better one it was true of both where by more than
    20 to 1, and of one of six where by less. Without edges it would be what remembers the temperature that stands for a step.

    Returns
    -------
    The account, and what it costs: the less of that with edges, each of which pays as a law does, and that without. Among
    shapes in temperature evidence decides.
    """
    model = full.without(first.passing)
    still = fitted.refit(model) if first.passing else fitted
    edged = with_edges(still, targets([n.law.effect for n in first.naming.named]))
    more = len(edged.model.parts) - len(still.model.parts)
    if not more:
        return None, np.inf
    account = _account(model, edged)
    without = [_account(model, still).cost] if first.passing else []
    return account, min([account.cost + TOLL_NATS * more, *without])


@dataclass(frozen=True)
class _Round:
    """A search of a table, and what was named beside the best of its models.

    Attributes
    ----------
    best : Fitted
        The best of its models beside a scale factor that wanders.
    plain : list of Candidate
        Its models without shapes in temperature, the best first.
    unused : list of str
        Components that names had to stand beside, which else are not there.
    """

    search: TableSearch
    ranked: list[Candidate]
    best: Fitted
    settled: Fitted
    worth: Mapping[str, float]
    plain: list[Candidate]
    naming: Naming
    laws: Laws
    unused: list[str]

    @cached_property
    def by_law(self) -> list[Candidate]:
        """The best model with what was named in place of its smooth parts, and what each law pays; none without a name."""
        if not self.naming.named:
            return []
        best, fitted = self.ranked[0], self.naming.fitted
        fitted = fitted.refit(fitted.model.without(self.unused))
        paid = sum(paid_by(n) for n in self.naming.named if not self.search.base.holds(n.law))
        paid += self.search.cancelled_nats(fitted, WANDERING_SCALE)
        return [replace(best, fitted=fitted, score=best.score + fitted.nll - best.fitted.nll + paid)]


def _table(series: Series, found: tuple[Pattern, ...], aside: Strays = NO_STRAYS) -> Examination:
    search = table_search(full_model(means_of(series), memory=False))
    search, ranked = _or_with_edges(search, search.run())
    search, ranked = _or_before_sine(*_shorn(search, ranked))
    if len(more := strays_beside(ranked, aside)):
        return _table(without(series, more.numbers), found, aside.joined(more))
    before = _round(search, ranked)
    last = _beside_names(before)
    if last is not before and len(more := strays_beside(last.ranked, aside)):
        # What has no name yet makes the noise too large for a data set to be off.
        return _table(without(series, more.numbers), found, aside.joined(more))
    search, ranked, naming, laws = last.search, last.ranked, last.naming, last.laws
    smooth = search.beside_smooth(ranked)
    of_rate = [
        c
        for models in (ranked, last.plain)
        if models
        for c in standing_for_all(search.with_law_of_rate(models, laws), models)
    ]
    of_rate.sort(key=lambda c: c.score)
    by_law = standing_for_all(last.by_law, ranked)
    both = sorted([*ranked, *smooth, *last.plain, *of_rate, *by_law], key=lambda c: c.score)
    joint = both[0] is not ranked[0] or ranked[0].coil is not None or ranked[0].changes != ()
    near, every = averaged(both) if joint or naming.named or naming.unnamed else [], both
    if near:
        of_each_rate = search.with_errors_of_each_rate([c for _, c in near])
        every = sorted([*both, *of_each_rate], key=lambda c: c.score)
        by_sine = with_open_loop([c for _, c in averaged(every)])
        every = sorted([*every, *by_sine], key=lambda c: c.score)
        near = averaged(every)
    if (by_sine_nats := sine_nats(every)) > ALIKE_NATS:
        naming = told_as_sine(naming, laws, near)
    first = ranked[0].fitted
    own = {law.name: () for law in first.model.laws if not search.base.holds(law)}
    mending = own.keys() - {law.name for law in without_mending(first, own, laws).model.laws}
    return Examination(
        series=series,
        patterns=found,
        whole=last.best,
        settled=last.settled,
        worth=last.worth,
        naming=naming,
        laws=laws,
        candidates=tuple(near),
        ranked=tuple(ranked),
        smooth=tuple(smooth),
        of_rate=tuple(of_rate),
        mending=frozenset(mending),
        strays=aside,
        sine_nats=by_sine_nats,
    )


def _shorn(search: TableSearch, ranked: list[Candidate]) -> tuple[TableSearch, list[Candidate]]:
    """A search and its models, without the shapes of the scale factor in temperature that gain less beside the best of them than a law pays.

    Half of all shapes gain something by chance, and while a box warms up they take a lag's or a step's share for it. Those of
    the bias take nothing from either.
    """
    names = idle(ranked[0].fitted, [p.name for p in search.shapes if of_scale(p)], TOLL_NATS)
    if not names:
        return search, ranked
    less = search.without(names)
    return less, less.run(ranked)


def _or_before_sine(search: TableSearch, ranked: list[Candidate]) -> tuple[TableSearch, list[Candidate]]:
    """A search and its models, or those with what changes the scale factor before the sine of an open loop, where that is likelier.

    Gears and a coil's length change its phase, an amplifier what comes out of it: at a phase of 1 rad one has half the effect of the other.
    """
    best = ranked[0]
    slope = slope_of(best)
    if slope is None:
        return search, ranked
    found = search.before_sine(slope)
    if found.fit(best.coil, best.changes, best).score >= best.score:
        return search, ranked
    felt = found.run(ranked)
    return (found, felt) if felt[0].score < best.score else (search, ranked)


def _or_with_edges(search: TableSearch, ranked: list[Candidate]) -> tuple[TableSearch, list[Candidate]]:
    """A search and its models, or those beside edges over temperature, each paying as a law does, that explain surely more."""
    found = search.with_edges(ranked[0])
    if found is not None:
        edged = found.run(ranked)
        more = len(found.base.parts) - len(search.base.parts)
        if edged[0].score + TOLL_NATS * more < ranked[0].score - ALIKE_NATS:
            return found, edged
    return search, ranked


def _round(search: TableSearch, ranked: list[Candidate], held: Sequence[Named] = ()) -> _Round:
    """Name what can be named beside the best model of a search.

    Parameters
    ----------
    held : what has a name and is in all of its models
    """
    base, first = search.base, ranked[0].fitted
    # Sweeps of one sign follow each other: what is to be named must stand beside a scale factor that wanders.
    drifting = [c for c in passing(base.means, base.basis.frame) if c.name in WANDERING_SCALE]
    best = alive(first.refit(first.model.with_components(*drifting)))
    laws = laws_of(base.means, surface_of(best.model, best.solve()))
    settled, worth = present(errors_of_each_rate(settle_direction(best), draws_of(base)))
    beside = settled.model.with_components(*drifting)
    plain = _plain(worth, search, ranked, laws)
    naming, laws = name(settled.refit(beside), _beyond_doubt(worth, ranked, plain, laws), laws, held)
    unused = [c.name for c in drifting if c.name not in settled.model.components]
    return _Round(search, ranked, best, settled, worth, plain, naming, laws, unused)


def _beside_names(before: _Round) -> _Round:
    """The round that follows where laws say more than smooth parts did, if it shows more than they do; else the one before.

    What smooth parts cannot follow, as a narrow peak, the noise has to make up for, and hides all that is smaller.
    """
    held = [n for n in before.naming.named if before.naming.fitted.model.holds(n.law)]
    if not held or before.by_law[0].score >= before.ranked[0].score:
        return before
    search = before.search.beside([n.law for n in held])
    ranked = search.run(before.ranked)
    # Nothing new gains less than what a further law would pay.
    gained = before.by_law[0].score - ranked[0].score - sum(map(paid_by, held))
    return _round(search, ranked, held) if gained > TOLL_NATS else before


def _least(laws: Laws) -> float:
    """What a shape in temperature has to gain for a name, nats."""
    return GAIN + 0.5 * float(np.log(max(1, sum(len(laws.trials(e)) for e in effects_of(SHAPES)))))


def _plain(
    worth: Mapping[str, float], search: TableSearch, ranked: Sequence[Candidate], laws: Laws
) -> list[Candidate]:
    """Models without shapes in temperature, the best first; none where there are hardly any, or nothing stands beside them.

    Where each temperature comes once, a shape in temperature can follow any step and any memory, and beside it no other law is seen.
    """
    if worth.get(SHAPES, 0.0) <= _least(laws) or not (ranked[0].coil or ranked[0].changes):
        return []
    return search.without([p.name for p in search.shapes]).run(ranked)


def _beyond_doubt(
    worth: Mapping[str, float], ranked: Sequence[Candidate], plain: Sequence[Candidate], laws: Laws
) -> dict[str, float]:
    """The blocks that may have a name: of shapes in temperature beside other laws, what laws alone do not explain as well.

    Laws in their place pay what they always do, so that the difference counts as that of a law of the search. What
    time did is told by the search, beside the lag of the coil and what remembers; alone anything may look like it.
    """
    worth = {block: nats for block, nats in worth.items() if BLOCKS[block].family != BIAS_DRIFT.family}
    if SHAPES not in worth or not (ranked[0].coil or ranked[0].changes):
        return worth
    ahead = (
        by_chance(plain[0].score - ranked[0].score, 1) <= NAMED_LEVEL
        if plain
        else worth[SHAPES] > _least(laws)
    )
    return {block: nats for block, nats in worth.items() if block != SHAPES or ahead}


def _with_jumps(whole: Fitted, passes: Sequence[Component], laws: Laws) -> tuple[Fitted, list[Jump]]:
    """The model with the jumps that are there: beside what follows the temperature, or in place of it.

    A plan goes through temperatures in turn: what is smooth in temperature can follow what happened at an instant.
    """
    beside, jumps = with_jumps(whole, passes, laws)
    following = whole.model.of_block(*FOLLOWING)
    plain, instead = with_jumps(whole.refit(whole.model.without(following)), passes, laws)
    more = [*map(jumped, instead[len(jumps) :])]
    at_most = beside.nll + (may_lose(more) if more else REPLACED + len(instead) - len(jumps))
    return (plain, instead) if instead and plain.nll <= at_most else (beside, jumps)


def block_curve(fitted: Fitted, solution: Solution, block: str, basis: Basis | None = None) -> Floats:
    """What a block of smooth parts adds at the rows of the model, or of another basis, deg/s."""
    rows = fitted.model.basis if basis is None else basis
    total = np.zeros(len(rows.means))
    for part in fitted.model.parts:
        if part.block == block and part.name in solution.amplitudes:
            columns = rows.component(part).columns
            if columns is not None:
                total += columns @ solution.amplitudes[part.name]
    for n, b in fitted.model.blocks.items():
        if b == block and n in solution.random:
            total += solution.random[n][rows.means.group_of(fitted.model.means)]
        elif b == block and n not in {p.name for p in fitted.model.parts}:
            columns = fitted.model.components[n].columns
            if columns is not None:
                here = columns @ solution.amplitudes[n]
                total += here[rows.means.group_of(fitted.model.means)]
    return total
