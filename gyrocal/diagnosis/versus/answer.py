"""What a simulation lacks: the difference diagnosed, the law of it, and whether it helps on sets left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.fit import rms
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.remarks import OF_COEFFICIENTS
from gyrocal.diagnosis.result import Diagnosis, Estimate
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.inputs import check_inputs
from gyrocal.diagnosis.rows.series import Series, set_means
from gyrocal.diagnosis.versus.law import Unseen, law_of, left_by
from gyrocal.diagnosis.versus.match import Match, enclosed, match, surface_of
from gyrocal.diagnosis.versus.surfaces import Apart, surfaces_apart
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.rate import FIT_DIRECTION
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.timewise import WARM_UP
from gyrocal.units import NORMAL_95, S_PER_H

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SCHEMA = "gyrocal-law/1"

#: Neighbouring data sets are left out together, in so many blocks, a fifth of which is held out at a time. Half as many
#: would have most of a warm-up in one of them, which the others cannot know.
_BLOCKS, _FOLDS = 20, 5
#: So many sets at least tell something of a law.
_FEWEST = 5
#: Rate at which any of the figures that are compared is said to differ where none does.
LEVEL = 0.01
#: A simulation without noise is a surface where none of its rows is off by more, deg/s.
_EXACT_DPS = 1e-5


@dataclass(frozen=True)
class Comparison:
    """Recording less simulation on data sets that the law was not fitted to, deg/s, rms of their means.

    Attributes
    ----------
    interval_95 : tuple of float
        Of the drop, if the same plan ran again (`_drop_interval`).
    sets, beyond, beside_jumps : int
        Data sets left out in turn; those whose rate or temperature the others do not enclose, or whose time where the law has
        one of time, and of the others those beside which something jumps: these are not judged, since no surface and no
        course knows beyond its data, and no law when it jumped among them.
    worse_at_dps : tuple of float
        Rates at which the simulation is surely farther from the recording with the law.
    """

    before_dps: float
    after_dps: float
    interval_95: tuple[float, float]
    sets: int
    beyond: int
    beside_jumps: int
    worse_at_dps: tuple[float, ...] = ()

    @property
    def helps(self) -> bool:
        """Whether the simulation is nearer to the recording with the law, surely, and at no rate surely farther."""
        return self.interval_95[0] > 0 and not self.worse_at_dps

    def to_json(self) -> dict[str, Any]:
        """Entry ``left_out``."""
        return {
            "rms_before_dps": self.before_dps,
            "rms_after_dps": self.after_dps,
            "drop_interval_95_dps": list(self.interval_95),
            "sets": self.sets,
            "sets_beyond": self.beyond,
            "sets_beside_jumps": self.beside_jumps,
            "worse_at_dps": list(self.worse_at_dps),
            "helps": self.helps,
        }


@dataclass(frozen=True)
class Compared:
    """Means of the data sets that were compared, shape (n,).

    `apart_dps`: recording less simulation; `left_dps`: less the law, too. `when`: hours, or the number of the set without times.
    """

    rate_dps: Floats
    when: Floats
    apart_dps: Floats
    left_dps: Floats
    has_time: bool


@dataclass(frozen=True)
class Versus:
    """A recording against a simulation: partners, what is in the difference, the law to add, and what it brings.

    `law`: surface of the gyro, and terms that the data show (`unseen`: the others); what both add to the output, less what the simulation's own surface
    (``match.surface``) adds already, is to be added to the simulated output. `comparison` is None where the sets
    are too few to leave some out.
    """

    recording: str
    simulation: str
    match: Match
    diagnosis: Diagnosis
    law: Coefficients
    comparison: Comparison | None
    unseen: Unseen | None = None

    @property
    def helps(self) -> bool:
        """Whether the law is worth adding."""
        return self.comparison is not None and self.comparison.helps

    @property
    def compared(self) -> Compared:
        """What is between the two, set by set, without and with the law."""
        d = self.match.difference
        apart = d.gyro_dps - self.match.surface.output_dps(d.rate_dps, d.temp_c)
        (numbers, rate), (_, t_s), (_, apart), (_, left) = (
            set_means(d, x) for x in (d.rate_dps, d.t_s, apart, left_by(self.law, d))
        )
        when = t_s / S_PER_H if d.has_time else numbers.astype(np.float64) + 1.0
        return Compared(rate, when, apart, left, d.has_time)

    @property
    def terms_dps(self) -> list[Floats]:
        """What each term of the law adds to the rows of the difference, deg/s."""
        c = conditions_of(self.match.difference)
        return [term.error_dps(c, self.law.surface) for term in self.law.terms]

    @property
    def surfaces_apart(self) -> Apart:
        """How far the two surfaces are apart."""
        return surfaces_apart(self.law, self.match.surface, self.match.difference)

    def to_json(self) -> dict[str, Any]:
        """``law.json``."""
        return {
            "schema": SCHEMA,
            "recording": self.recording,
            "simulation": self.simulation,
            "verdict": self.diagnosis.verdict,
            "matching": self.match.to_json(),
            "law": {
                "says": "output = simulated output + S - S_simulated + sum of the terms, S and S_simulated in deg/s; of a parameter with "
                "`in_the_sum` the term has that, and smooth terms the rest of its value",
                "surface": _surface_json(self.law),
                "simulated_surface": self.match.surface.to_json(),
                "surfaces_apart": self.surfaces_apart.to_json(),
                "valid": _valid_json(self.match.difference),
                "terms": _terms_json(self.law, self.diagnosis),
                "terms_unseen": None if self.unseen is None else dict(vars(self.unseen)),
            },
            "left_out": None if self.comparison is None else self.comparison.to_json(),
        }


def versus(
    real: Series, simulated: Series, options: Options, whole: Callable[[], Surface | None] | None = None
) -> Versus:
    """Match, examine the difference, and compare on sets left out.

    Parameters
    ----------
    whole : `only_surface` of the simulation, where several recordings are compared with it

    Raises
    ------
    DataError
        The two hardly overlap, what they share is too little to be examined, or one of them is no gyro's output.
    """
    check_inputs(real, None)
    check_inputs(simulated, None, ideal=True)
    if np.array_equal(real.rate_dps, simulated.rate_dps) and np.array_equal(
        real.gyro_dps, simulated.gyro_dps
    ):
        raise DataError(
            f"{simulated.name}: says what {real.name} says in every row. Give the simulation, not the recording again."
        )
    matched = match(real, simulated, whole or partial(only_surface, simulated, options))
    comparison = compare(matched, options) if options.heldout else None
    # What layers gain on data left out from a surface of their own is another figure than what the simulation gains, and
    # beside that it would be a second answer to the same question.
    found = diagnose(
        matched.difference, None, replace(options, heldout=options.heldout and comparison is None)
    )
    said = tuple(n for n in found.notes if isinstance(n, str) or n.said not in OF_COEFFICIENTS)
    found = replace(found, notes=said)
    law, unseen = law_of(found, matched.difference)
    return Versus(real.name, simulated.name, matched, found, law, comparison, unseen)


def only_surface(simulated: Series, options: Options) -> Surface | None:
    """The error surface of a simulation in which nothing else is seen; None where something is, or too little to see it."""
    try:
        for surface in (surface_of(simulated), surface_of(simulated, "input")):
            left = surface.output_dps(simulated.rate_dps, simulated.temp_c) - simulated.gyro_dps
            if np.abs(left).max() < _EXACT_DPS:
                return surface
        found = diagnose(simulated, None, replace(options, heldout=False))
    except DataError:
        return None
    of_input = [e.effect for e in found.effects] == [FIT_DIRECTION.id] and found.verdict == "explained"
    if found.surface is None or not (of_input or found.verdict == "consistent"):
        return None
    chosen = found.surface.surface
    return surface_of(simulated, "input") if of_input and chosen.direction == "output" else chosen


def compare(matched: Match, options: Options) -> Comparison | None:
    """The law without some blocks of data sets, on those of these sets that the others enclose."""
    difference = matched.difference
    simulated = matched.surface.output_dps(difference.rate_dps, difference.temp_c)
    numbers, plain = set_means(difference, difference.gyro_dps - simulated)
    if numbers.size < _FEWEST:
        return None
    block = np.arange(numbers.size) * _BLOCKS // max(numbers.size, 1)
    after, beside_jumps = np.full(numbers.size, np.nan), 0
    for fold in range(_FOLDS):
        held = block % _FOLDS == fold
        known = ~np.isin(difference.set_index, numbers[held])
        try:
            part = difference.take(known)
            law, _ = law_of(diagnose(part, None, replace(options, heldout=False)), part)
        except DataError:
            return None
        within = enclosed(difference, difference.take(known & difference.is_set))
        if _is_of_time(law):
            within &= _meanwhile(difference, known & difference.is_set)
        certain = ~_jumped_meanwhile(law, difference.t_s, difference.t_s[known])
        enclosed_too = held & np.isin(numbers, difference.set_index[within])
        judged = enclosed_too & np.isin(numbers, difference.set_index[within & certain])
        beside_jumps += int(np.sum(enclosed_too & ~judged))
        after[judged] = set_means(difference, left_by(law, difference))[1][judged]
    judged = np.isfinite(after)
    if np.sum(judged) < _FEWEST:
        return None
    beyond = int(np.sum(~judged)) - beside_jumps
    rate = set_means(difference, difference.rate_dps)[1][judged]
    plain, after, block = plain[judged], after[judged], block[judged]
    return Comparison(
        rms(plain),
        rms(after),
        _drop_interval(plain, after, block),
        plain.size,
        beyond,
        beside_jumps,
        _worse_at(rate, after**2 - plain**2),
    )


def _drop_interval(before_dps: Floats, after_dps: Floats, block: Ints) -> tuple[float, float]:
    """95 % interval of the drop of the rms if the same plan ran again, with other noise.

    What a law adds, ``p``, was found without the data sets that it is added to, so that of the drop of the sum of squares,
    ``sum p (2 y - p)``, the noise in ``y`` alone is open: ``2 sqrt(sum p^2)`` of its standard deviation, more where errors of
    a block go together. Blocks drawn again would ask for what other stretches of the record gain, and a warm-up
    has one stretch.
    """
    squares, added = float(after_dps @ after_dps), before_dps - after_dps
    drop = float(before_dps @ before_dps) - squares
    of_blocks = np.bincount(block, after_dps)
    # The sums of blocks scatter as independent errors would, or more.
    noise = max(squares, float(of_blocks @ of_blocks)) / after_dps.size
    blocks = np.unique(block).size
    half = stats.t.ppf(0.975, max(blocks - 1, 1)) * 2.0 * np.sqrt(noise * float(added @ added))
    by = after_dps.size * (rms(before_dps) + rms(after_dps))
    return float((drop - half) / by), float((drop + half) / by)


def _is_of_time(law: Coefficients) -> bool:
    """Whether a law drifts or settles with time."""
    laws = [term for term in law.terms if not isinstance(term, SmoothTerm)]
    return any(find_effect(term.effect).family == WARM_UP.family for term in laws)


def _meanwhile(series: Series, known: Bools) -> Bools:
    """Rows between the first and the last of those that are known, shape (n,)."""
    return np.asarray((series.t_s >= series.t_s[known].min()) & (series.t_s <= series.t_s[known].max()))


def _jumped_meanwhile(law: Coefficients, t_s: Floats, known_s: Floats) -> Bools:
    """Rows among those left out while something jumped, shape (n,): when in between it did those that are known do not tell."""
    meanwhile = np.zeros(t_s.size, dtype=np.bool_)
    before_s, after_s = (np.append(known_s, end) for end in (-np.inf, np.inf))
    for term in law.terms:
        if isinstance(term, SmoothTerm) or "at_s" not in term.parameters:
            continue
        at_s = float(term.parameters["at_s"]["value"])
        meanwhile |= (t_s > before_s[before_s <= at_s].max()) & (t_s < after_s[after_s >= at_s].min())
    return meanwhile


def _worse_at(rate_dps: Floats, grown_dps2: Floats) -> tuple[float, ...]:
    """Rates at which squares of errors have grown, at `LEVEL` over all rates; what helps most at one rate may spoil others."""
    rates = np.round(rate_dps, 2)
    each = {float(r): grown_dps2[rates == r] for r in np.unique(rates)}
    each = {r: grown for r, grown in each.items() if grown.size >= _FEWEST and np.ptp(grown) > 0.0}
    tests = {
        r: float(stats.ttest_1samp(grown, 0.0, alternative="greater").pvalue) for r, grown in each.items()
    }
    return tuple(r for r, p in tests.items() if p < LEVEL / len(tests))


def counts_from_s(difference: Series) -> float | None:
    """From which t_s on the time since power-on counts; None where it is logged, or there is no time."""
    stated = difference.since_power_on_s is not None
    return None if stated or not difference.has_time else difference.switched_on_s


def _valid_json(difference: Series) -> dict[str, Any]:
    """Where the law is known: what the recording and the simulation have in common."""
    rate, temp = difference.rate_dps, difference.temp_c
    return {
        "rate_dps": [float(rate.min()), float(rate.max())],
        "temp_c": [float(temp.min()), float(temp.max())],
        "since_power_on_counts_from_t_s": counts_from_s(difference),
    }


def _surface_json(law: Coefficients) -> dict[str, Any]:
    std = np.sqrt(np.maximum(np.diag(law.covariance_dps2), 0.0)).reshape(SHAPE)
    values = law.surface.coefficients_dps
    x = "output" if law.surface.direction == "output" else "true rate"
    return law.surface.to_json() | {
        "direction": law.surface.direction,
        "equation": f"S = sum c[i][j] u^i v^j, u = ({x} - center_dps)/scale_dps, v = (T - center_c)/scale_c",
        "interval_95_dps": np.stack([values - NORMAL_95 * std, values + NORMAL_95 * std], axis=2).tolist(),
    }


def _terms_json(law: Coefficients, found: Diagnosis) -> list[dict[str, Any]]:
    estimates = {effect.effect: effect.parameters for effect in found.effects}
    entries = []
    laws = [term for term in law.terms if not isinstance(term, SmoothTerm)]
    several = {term.effect: [t for t in laws if t.effect == term.effect] for term in laws}
    for term in law.terms:
        if isinstance(term, SmoothTerm):
            entries.append(
                term.to_json() | {"equation": "e = sum of coefficient × rate × temperature × driver"}
            )
            continue
        effect = find_effect(term.effect)
        if term is not several[effect.id][0]:
            continue
        shapes = several[effect.id]
        # A law that is averaged over its shapes is the sum of some; its estimate is that of the whole.
        sum_of = [{name: float(p["value"]) for name, p in t.parameters.items()} for t in shapes]
        entries.append(
            ({} if len(shapes) == 1 else {"sum_of": sum_of})
            | {
                "effect": effect.id,
                "family": effect.family,
                "equation": effect.equation,
                "statement": effect.statement,
                "parameters": {
                    name: _parameter_json(entry, estimates.get(effect.id, {}).get(name), len(shapes) > 1)
                    for name, entry in term.parameters.items()
                },
            }
        )
    return entries


def _parameter_json(entry: Mapping[str, Any], estimate: Estimate | None, one_of: bool) -> dict[str, Any]:
    value = float(entry["value"])
    if estimate is not None:
        low, high = estimate.interval_95
        told = estimate.to_json()
        # What has no interval is in none, and beyond none.
        if one_of or not (value < low or value > high):
            return told | ({} if one_of else {"value": value})
        # Smooth parts have the rest of it: the sum needs the share that this term has, and a reader what all of it is.
        return told | {"in_the_sum": value}
    std = float(entry.get("std") or 0.0)
    interval = [value - NORMAL_95 * std, value + NORMAL_95 * std]
    return {"value": value, "std": std, "unit": entry.get("unit", ""), "interval_95": interval}
