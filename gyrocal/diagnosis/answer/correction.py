"""What is to be corrected on the next run: surface, laws and smooth parts that stay with the gyro, as a coefficient file."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.apply import SECONDS_A_DATA_SET
from gyrocal.diagnosis.answer.between_rates import over_shapes
from gyrocal.diagnosis.answer.rising import dead_zone, rising
from gyrocal.diagnosis.answer.standing import left_by_drifts, state_of_laws, state_of_walks
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.laws.in_place import is_passing
from gyrocal.diagnosis.model.blocks import BENT, around_itself, evidence, of_scale
from gyrocal.diagnosis.model.layers import DIRECTION, NEGLIGIBLE, PHASE, WANDERING_SCALE, Fitted, Law, Model
from gyrocal.diagnosis.model.parts import (
    BIAS_IN_TIME,
    BLOCKS,
    SCALE_IN_TIME,
    SINCE_ON,
    SURFACE,
    Part,
    legendre_to_powers,
    polynomials,
    since_on,
)
from gyrocal.diagnosis.names.rivals import may_wander, of_one_surface, with_rivals
from gyrocal.diagnosis.rows.means import Means, angle_random_walk
from gyrocal.diagnosis.rows.order import SURROGATE_PERIOD_S
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.diagnosis.sweeps.open_loop import given_back
from gyrocal.diagnosis.sweeps.unclocked import leaps, without_clock
from gyrocal.fusion.coefficients import Coefficients, Noise, Valid
from gyrocal.inference.additive import Solution
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.rate import DEAD_ZONE, FIT_DIRECTION, SAGNAC_SINE
from gyrocal.physics.smooth import SmoothTerm, seen_of
from gyrocal.physics.surface import SHAPE, Direction, Surface
from gyrocal.physics.terms import Term
from gyrocal.physics.thermal import THERMAL_LAG
from gyrocal.physics.timewise import WARM_UP
from gyrocal.units import MDPS

Floats = NDArray[np.float64]

_TERMS = SHAPE[0] * SHAPE[1]
#: Evidence from which on a part without a name is written, nats. Of 20 weaker ones in made-up runs 8 would have made another
#: run better and 9 worse, whether or not they surely predicted what was left out.
_BEYOND_DOUBT = 10.0
#: Effects that are seen over the rate.
_OF_RATE = frozenset(e.id for e in CATALOGUE.values() if e.seen_in == "rate")
#: What comes again with less probability than this has no term in the file.
_SURELY_NOT = 0.01


@dataclass(frozen=True)
class _Item:
    """A term of the file: the component that it comes from, and where its parameters stand among all."""

    name: str
    part: Part | None
    law: Law | None
    start: int
    size: int


@dataclass(frozen=True)
class _Estimate:
    """All parameters of the file, surface first, with their covariance."""

    values: Floats
    covariance: Floats


def doubtful(found: Examination) -> list[str]:
    """Blocks without a name that have not earned their place in the file.

    A weak part may be the accident of one run; and what a bias or a scale factor that wanders explains nearly as well
    does not come again. That a part predicts what was left out is no proof: the other run wanders otherwise. A shape in
    rate comes again at each visit, and without it the surface alone would follow it, worst at the largest rates.
    """
    if found.candidates:
        return []
    named = {n.block for n in found.naming.named}
    unnamed = {b: n for b, n in found.naming.unnamed.items() if b not in BENT}
    nameless = {b: n for b, n in unnamed.items() if BLOCKS[b].lasts and b not in named}
    beside = _beside_wander(found, [b for b, nats in nameless.items() if nats >= _BEYOND_DOUBT])
    return [b for b in nameless if beside.get(b, 0.0) < _BEYOND_DOUBT]


def _beside_wander(found: Examination, blocks: Sequence[str]) -> dict[str, float]:
    """What blocks are worth where bias and scale factor may wander, nats."""
    if not blocks:
        return {}
    beside = found.naming.fitted
    beside = beside.refit(may_wander(beside.model))
    return {b: evidence(beside, b)[0] for b in blocks}


def correction(found: Examination, without: Sequence[str] = ()) -> Coefficients:
    """The coefficient file of what was found, averaged over the models that are near.

    The surface has the state at the end of the record: what passes is held where it was last, but for a walk and a drift of a
    table, whose mean it has. Where it is open whether a change since power-on comes again, the file has the mean of both,
    which errs least.

    Parameters
    ----------
    without : blocks that are left out of it
        What they explained falls to the surface of the whole record, and what that leaves of it to the uncertainty.
    """
    near = [(weight, candidate.fitted) for weight, candidate in found.candidates]
    beside = _less(found, without)
    fallen = _fallen(found.naming.fitted.model, without, beside.model)
    near = of_one_surface(near or with_rivals(beside, found.naming.named, found.laws))
    near = over_shapes(near, found.laws)
    zone = dead_zone(near[0][1], found.laws)
    models = [(weight, rising(fitted, zone)) for weight, fitted in near]
    solved = [(weight, fitted, fitted.solve()) for weight, fitted in models]
    again = found.comes_again
    items, total = _items([(weight, f.model, s) for weight, f, s in solved], again)
    # What may come again or not is known no better than the two states differ.
    states = [(again, True), (1.0 - again, False)] if again >= _SURELY_NOT else [(1.0, False)]
    each = [
        (w * chance, _estimate(f.model, s, items, total, comes, fallen))
        for w, f, s in solved
        for chance, comes in states
        if chance > 0.0
    ]
    mean, covariance = mixed([(w, e.values, e.covariance) for w, e in each])
    first, comes = models[0][1], again > 0.5
    # What the variances add is much the same in models so near to each other, and in either state.
    plain, widened = (
        _estimate(first.model, s, items, total, comes, fallen)
        for s in (solved[0][2], first.solve(widened=True))
    )
    covariance += widened.covariance - plain.covariance
    mean, covariance = _with_sine(first.model, items, mean, covariance)
    place, hidden_dps = _hidden(items, mean)
    covariance[np.ix_(place, place)] = np.outer(hidden_dps, hidden_dps)
    frame = first.model.basis.frame
    direction: Direction = "output" if first.model.direction == "output" else "input"
    surface = Surface(
        mean[:_TERMS].reshape(SHAPE),
        0.0,
        frame.rate_scale_dps,
        frame.temp_center_c,
        frame.temp_scale_c,
        direction,
    )
    least = NEGLIGIBLE * float(np.std(solved[0][2].left))
    terms = [_term(item, first.model, mean, covariance, least) for item in items]
    return replace(
        file_without_surface(first),
        surface=surface,
        covariance_dps2=covariance[:_TERMS, :_TERMS],
        terms=(*terms, *(() if leaps(first.model.means.series) else _coil_terms(found.candidates))),
    )


def with_drifts(file: Coefficients, found: Examination) -> Coefficients:
    """A file whose uncertainty has what goes on to drift about the mean that the surface has of it.

    The surface alone lacks as much: whether the file is better than that is asked without it.
    """
    each = [(w, left_by_drifts(c.fitted.model, c.fitted.solve())) for w, c in found.candidates]
    covariance = file.covariance_dps2.copy()
    covariance[0, 0] += sum(w * constant for w, (constant, _) in each)
    covariance[SHAPE[1], SHAPE[1]] += sum(w * share for w, (_, share) in each)
    return replace(file, covariance_dps2=covariance)


def _with_sine(
    model: Model, items: Sequence[_Item], mean: Floats, covariance: Floats
) -> tuple[Floats, Floats]:
    """The parameters with a sine of the phase that they have, of which the model is a straight line."""
    if model.open_loop is None:
        return mean, covariance
    at = _sine_of(items).start + 1
    back, slope = given_back(model.open_loop, float(mean[at]), model.basis.frame.rate_scale_dps)
    moved, turn = mean.copy(), np.eye(mean.size)
    moved[: _TERMS : SHAPE[1]] -= back
    turn[: _TERMS : SHAPE[1], at] -= slope
    # A mean of ones is one to the last digit but one.
    moved[at - 1], turn[at - 1, at - 1] = 1.0, 0.0
    return moved, turn @ covariance @ turn.T


def mixed(each: Sequence[tuple[float, Floats, Floats]]) -> tuple[Floats, Floats]:
    """Mean and covariance of a mixture of laws, each with its weight, mean and covariance."""
    mean = np.sum([weight * values for weight, values, _ in each], axis=0)
    covariance = [w * (within + np.outer(values - mean, values - mean)) for w, values, within in each]
    return mean, np.sum(covariance, axis=0)


def _less(found: Examination, blocks: Sequence[str]) -> Fitted:
    """Without some blocks, whose place what may wander takes: the surface alone would be bent by what they explained.

    What a law of time explains is that law's: a walk beside it would take it along.
    """
    fitted = found.naming.fitted
    names = fitted.model.of_block(*blocks)
    if not names:
        return fitted
    passing = [CATALOGUE[n.law.effect] for n in found.naming.named if is_passing(n)]
    taken = [SCALE_IN_TIME if "rate_dps" in effect.needs else BIAS_IN_TIME for effect in passing]
    if not _any_of_scale(fitted.model, blocks):
        # What acted on the bias alone leaves the scale factor as it was.
        taken.append(SCALE_IN_TIME)
    return around_itself(fitted.refit(may_wander(fitted.model.without(names), [*blocks, *taken])))


def _fallen(model: Model, blocks: Collection[str], beside: Model) -> set[str]:
    """Components of the model without some blocks that stand for them."""
    fallen = beside.components.keys() - model.components.keys()
    if _any_of_scale(model, blocks):
        # What a scale factor that wanders explains nearly as well is in its walk already.
        fallen |= {*WANDERING_SCALE} & beside.components.keys()
    return fallen


def _any_of_scale(model: Model, blocks: Collection[str]) -> bool:
    """Whether any part of some blocks that a model has acts on more than the bias."""
    parts = [p for p in model.parts if p.block in blocks and p.name in model.components]
    return any(map(of_scale, parts))


def file_without_surface(fitted: Fitted) -> Coefficients:
    """A file without surface: where it holds, and where it comes from."""
    series, frame = fitted.model.means.series, fitted.model.basis.frame
    origin: dict[str, object] = {"recording": series.name, "by": "diagnose"}
    if not series.has_time:
        origin[SECONDS_A_DATA_SET] = SURROGATE_PERIOD_S
    return Coefficients(
        sensor=series.sensor,
        surface=Surface(np.zeros(SHAPE), 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c),
        covariance_dps2=np.zeros((_TERMS, _TERMS)),
        valid=_valid(series),
        noise=Noise(angle_random_walk_deg_per_rt_h=angle_random_walk(series)),
        provenance=origin,
    )


def _valid(series: Series) -> Valid:
    """As far as the rows reach, or what they are means of: `apply` corrects samples, and temperatures as they are read."""
    gyro = float(series.gyro_dps.min()), float(series.gyro_dps.max())
    temp = float(series.temp_c.min()), float(series.temp_c.max())
    if series.reach is None:
        return Valid(gyro, temp)
    gyro_low, _, temp_low, _ = np.fmin.reduce(series.reach).tolist()
    _, gyro_high, _, temp_high = np.fmax.reduce(series.reach).tolist()
    return Valid((gyro_low, gyro_high), (min(temp[0], temp_low), max(temp[1], temp_high)))


def _items(models: Sequence[tuple[float, Model, Solution]], again: float) -> tuple[list[_Item], int]:
    """Terms that any of the models needs, and the number of all parameters; none that surely does not come again."""
    found: list[_Item] = []
    place = _TERMS
    known: set[str] = set()
    for weight, model, solution in models:
        # As far as a model is unlikely, what it alone holds widens the mean of all by little.
        least = NEGLIGIBLE * float(np.std(solution.left)) / np.sqrt(weight)
        laws = _lasting(model)
        parts = {p.name: p for p in model.parts if p.block != "surface"}
        passed = set(_since_power_on(model)) if again < _SURELY_NOT else set()
        passed |= without_clock(model)
        for name in solution.order:
            if name in passed:
                continue
            new: list[tuple[str, Part | None, Law | None, int]]
            if name in laws:
                # What a law of the rate does between the rates of a plan does not show at its rows.
                if laws[name][0][0].effect not in _OF_RATE and _most(model, solution, name) < least:
                    continue
                new = [(law.name, None, law, len(_linear(law))) for law, _ in laws[name]]
            elif name == DIRECTION or name in parts:
                if name in parts and _most(model, solution, name) < least:
                    continue
                new = [(name, parts.get(name), None, len(solution.amplitudes[name]))]
            elif name == PHASE and model.open_loop is not None:
                whole = Law(SAGNAC_SINE.id, {}, model.open_loop.by_phase)
                new = [(whole.name, None, whole, len(_linear(whole)))]
            else:
                continue
            for term, part, law, size in new:
                if term not in known:
                    known.add(term)
                    found.append(_Item(term, part, law, place, size))
                    place += size
    return found, place


def _most(model: Model, solution: Solution, name: str) -> float:
    """The most that a component adds to a row, deg/s."""
    columns = next(c.columns for c in model.all if c.name == name)
    return float(np.max(np.abs(np.asarray(columns) @ solution.amplitudes[name])))


def _lasting(model: Model) -> dict[str, list[tuple[Law, float]]]:
    """Laws of a model that a robot evaluates, by component: each as laws of one shape with their weights."""
    lasting = [law for law in model.laws if CATALOGUE[law.effect].runtime and not law.from_end]
    return {
        law.name: [(Law(law.effect, shape, law.columns), weight) for shape, weight in law.members]
        for law in lasting
    }


def _estimate(
    model: Model, solution: Solution, items: Sequence[_Item], total: int, again: bool, fallen: Collection[str]
) -> _Estimate:
    """Parameters of the file from the amplitudes of one model: linear, so that the covariance follows.

    Parameters
    ----------
    again : whether what follows the time since power-on comes again; else it is held where it was last
    fallen : components of which the surface takes what it can
    """
    amplitudes = np.concatenate([solution.flat, *(solution.amplitudes[n] for n in solution.order)])
    starts = solution.starts
    to_file = np.zeros((total, amplitudes.size))
    powers = legendre_to_powers()
    to_file[:_TERMS, : len(model.flat)] = powers[:, list(model.flat)]
    for part in model.parts:
        if part.block == "surface" and part.name in starts:
            own = [SURFACE.index(column) for column in part.columns]
            at = starts[part.name]
            to_file[:_TERMS, at : at + len(own)] = powers[:, own] * np.array(part.weights)
    for item in items:
        if item.law is not None or item.name not in starts:
            continue
        at = starts[item.name]
        weight = np.ones(item.size) if item.part is None else np.array(item.part.weights)
        to_file[item.start : item.start + item.size, at : at + item.size] = np.diag(weight)
        if item.part is not None:
            # The surface gives back what the smooth part was freed of.
            taken = powers @ polynomials(item.part.columns, model.basis.frame)
            to_file[:_TERMS, at : at + item.size] -= taken * weight
    place = {item.name: item.start for item in items}
    for name, members in _lasting(model).items():
        for member, share in members:
            if member.name in place:
                to_file[place[member.name], starts[name]] += share
                if "width_dps" in (linear := _linear(member)):
                    # A dead zone is as wide as what it takes of the larger rates.
                    to_file[place[member.name] + linear.index("width_dps"), starts[name]] += share * MDPS
    values = np.zeros(total)
    if (sine := model.open_loop) is not None:
        at = _sine_of(items).start
        values[at : at + 2] = 1.0, sine.phase_rad_per_dps
        to_file[at + 1, starts[PHASE]] = sine.phase_rad_per_dps * sine.spread
    for name, columns in {} if again else _since_power_on(model).items():
        mine = slice(starts[name], starts[name] + columns.shape[1])
        to_file[_TERMS:, mine] = 0.0
        to_file[0, mine] += columns[-1]
    for name, (constant, share) in state_of_laws(model).items():
        to_file[0, starts[name]] += constant
        to_file[SHAPE[1], starts[name]] += share
    # What goes by a clock that nobody has is there in the mean; a warm-up is held where it was last, as above.
    fallen = {*fallen, *(without_clock(model) - _since_power_on(model).keys())}
    stood, left_dps2 = state_of_walks(model, solution, fallen)
    values += to_file @ amplitudes
    values[:_TERMS] += stood
    covariance = to_file @ solution.covariance @ to_file.T
    covariance[0, 0] += left_dps2
    return _Estimate(values, covariance)


def _since_power_on(model: Model) -> dict[str, Floats]:
    """Columns of what follows the time since power-on, by component."""
    parts = {
        p.name: model.components[p.name].columns
        for p in model.parts
        if p.block == SINCE_ON and p.name in model.components
    }
    laws = {law.name: law.columns for law in model.laws if law.effect == WARM_UP.id and not law.from_end}
    return laws | {n: columns for n, columns in parts.items() if columns is not None}


def _linear(law: Law) -> tuple[str, ...]:
    """Parameters of a law whose covariance the file has, by name: in a dead zone nobody knows where the rate is, too."""
    if _is_whole(law):
        return ("amplitude", "phase_rad_per_dps")
    return ("amplitude", "place_dps", "width_dps") if law.effect == DEAD_ZONE.id else ("amplitude",)


def _is_whole(law: Law) -> bool:
    """Whether it is the sine of an open loop at an amplitude of one."""
    return law.effect == SAGNAC_SINE.id and not law.shape


def _sine_of(items: Sequence[_Item]) -> _Item:
    """That of the sine of an open loop, which a file has once."""
    return next(item for item in items if item.law is not None and _is_whole(item.law))


def _hidden(items: Sequence[_Item], values: Floats) -> tuple[list[int], Floats]:
    """Where among all parameters the place in a dead zone is, and how little is known of it, deg/s: it is anywhere."""
    zones = [i for i in items if i.law is not None and "place_dps" in _linear(i.law)]
    widths_dps = MDPS * np.abs(values[[i.start for i in zones]])
    return [i.start + 1 for i in zones], np.asarray(widths_dps / np.sqrt(3.0))


def _term(
    item: _Item, model: Model, values: Floats, covariance: Floats, least_dps: float
) -> Term | SmoothTerm:
    rows = slice(item.start, item.start + item.size)
    if item.part is not None:
        columns = model.basis.at(item.part.columns)
        return SmoothTerm(
            BLOCKS[item.part.block].family,
            item.name,
            model.basis.frame,
            item.part.columns,
            values[rows],
            covariance[rows],
            seen_of(columns, np.abs(values[rows]) + np.sqrt(np.diag(covariance)[rows]), least_dps),
        )
    effect = FIT_DIRECTION if item.law is None else CATALOGUE[item.law.effect]
    shape = {} if item.law is None else item.law.shape
    linear = ("amplitude",) if item.law is None else _linear(item.law)
    parameters = {
        name: {
            "value": float(values[k]),
            "std": float(np.sqrt(covariance[k, k])),
            "unit": effect.parameter(name).unit,
            "covariance": covariance[k].tolist(),
        }
        for k, name in enumerate(linear, item.start)
    }
    known = {p.name: p.unit for p in effect.parameters}
    for name, value in shape.items():
        if name in known:
            uncertain = parameters.get(name, {"std": 0.0, "unit": known[name]})
            parameters[name] = {**uncertain, "value": float(value)}
    settles = "since_power_on_s" in effect.needs
    return Term(effect.id, parameters, True, max(_begun_s(model.means), 0.0) if settles else 0.0)


def _begun_s(means: Means) -> float:
    """Time since power-on at which a record began."""
    return float(since_on(means)[0] - (means.t_s[0] - means.from_s[0]))


def _coil_terms(candidates: Sequence[tuple[float, Candidate]]) -> list[Term]:
    """The coil's temperature as lags of the surface: of several models each has its weight."""
    shares: dict[float, float] = {}
    for weight, candidate in candidates:
        if candidate.coil is not None:
            share, tau = candidate.coil
            shares[tau] = shares.get(tau, 0.0) + weight * share
    whole, sizes = sum(shares.values()), sum(map(abs, shares.values()))
    spread = sum(w * ((c.coil[0] if c.coil else 0.0) - whole) ** 2 for w, c in candidates)
    unit = {p.name: p.unit for p in THERMAL_LAG.parameters}
    return [
        Term(
            THERMAL_LAG.id,
            {
                "amplitude": {
                    "value": share,
                    # Taken for independent of each other, so that their variances add up to that of the whole.
                    "std": float(np.sqrt(spread * abs(share) / sizes)),
                    "unit": unit["amplitude"],
                },
                "tau_s": {"value": tau, "std": 0.0, "unit": unit["tau_s"]},
            },
            True,
        )
        for tau, share in sorted(shares.items())
        if share != 0.0
    ]
