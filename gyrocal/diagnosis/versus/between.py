"""Several recordings of one type against one simulation: which parameters differ between them, and which do not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import GAIN
from gyrocal.diagnosis.result import Estimate, NamedEffect
from gyrocal.diagnosis.rows.base import carried_terms, simulate, with_coefficients
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.series import set_means
from gyrocal.diagnosis.versus.answer import LEVEL, Versus
from gyrocal.diagnosis.versus.surfaces import of_rate_alone
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.inference.multiple import holm
from gyrocal.inference.spread import Spread, spread_between
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SCHEMA = "gyrocal-between/1"

#: Rates and temperatures at which surfaces are compared, each.
_GRID = 15


@dataclass(frozen=True)
class Between:
    """A parameter over the recordings.

    Attributes
    ----------
    of : str
        ``surface``, or the effect.
    estimates : tuple of Estimate or None
        In each recording, in their order; None where it has none.
    differs : bool
        Whether the recordings differ in it, all parameters together tested at 1 %.
    """

    of: str
    name: str
    unit: str
    estimates: tuple[Estimate | None, ...]
    spread: Spread
    differs: bool

    def to_json(self) -> dict[str, Any]:
        """Entry of ``parameters``."""
        return {
            "of": self.of,
            "name": self.name,
            "unit": self.unit,
            "values": [None if e is None else e.to_json() for e in self.estimates],
            "mean": self.spread.mean,
            "mean_interval_95": list(self.spread.mean_interval_95),
            "std_between": self.spread.spread,
            "std_between_interval_95": list(self.spread.spread_interval_95),
            "p_value": self.spread.p_value,
            "differs": self.differs,
        }


def between_to_json(answers: Sequence[Versus], found: Sequence[Between]) -> dict[str, Any]:
    """``between.json``."""
    return {
        "schema": SCHEMA,
        "simulation": answers[0].simulation,
        "recordings": [
            {"recording": a.recording, "verdict": a.diagnosis.verdict, "matching": a.match.to_json()}
            for a in answers
        ],
        "parameters": [b.to_json() for b in found],
    }


def between(answers: Sequence[Versus]) -> list[Between]:
    """Compare the parameters of two or more recordings; what differs most comes first.

    Amplitudes mean the same only beside the same laws: those that all recordings together need. A recording in which
    others were found is fitted again with them.
    """
    sets = [_sets_of(a, answers) for a in answers]
    laws = _common_laws(sets)
    fitted = [_fit_beside(a, laws, s) for a, s in zip(answers, sets, strict=True)]
    rows = [("surface", name, e) for name, e in _surface_terms(answers, fitted).items()]
    for effect in [*laws, *(e for e in _all_named(answers) if not _is_law(e))]:
        rows += [(effect, name, e) for name, e in _effect_parameters(answers, fitted, effect).items()]
    compared = []
    for of, name, estimates in rows:
        known = [e for e in estimates if e is not None and 0 < e.std < np.inf]
        if len(known) > 1:
            values, stds = (np.array(x) for x in zip(*((e.value, e.std) for e in known), strict=True))
            compared.append(
                Between(of, name, known[0].unit, tuple(estimates), spread_between(values, stds), False)
            )
    p = holm(np.array([b.spread.p_value for b in compared]))
    judged = [replace(b, differs=bool(x < LEVEL)) for b, x in zip(compared, p, strict=True)]
    return sorted(judged, key=lambda b: b.spread.p_value)


@dataclass(frozen=True)
class _Fit:
    """A recording beside the laws of all: surface, and amplitudes by effect."""

    law: Coefficients
    amplitudes: Mapping[str, Estimate]


@dataclass(frozen=True)
class _Sets:
    """Data sets of a recording: what the simulation's surface leaves of their means, columns of its terms, and of each law."""

    left_dps: Floats
    surface: Floats
    terms: Ints
    laws: Mapping[str, Floats]

    def design(self, laws: Sequence[str]) -> Floats:
        """Columns of the surface and of these laws."""
        return np.column_stack([self.surface, *(self.laws[e] for e in laws)])


def _sets_of(answer: Versus, answers: Sequence[Versus]) -> _Sets:
    """With the columns of all laws that were named in any recording and whose shape one of them tells."""
    difference = answer.match.difference
    # About the simulation's own surface, which the difference has exactly: one of the other direction would leave a misfit.
    base = simulate(difference, answer.match.surface)
    columns = {e: _column(answer, e, answers) for e in _all_named(answers) if _is_law(e)}
    return _Sets(
        set_means(difference, base.residual_dps)[1],
        np.column_stack([set_means(difference, x)[1] for x in base.design.T]),
        base.terms,
        {e: column for e, column in columns.items() if column is not None},
    )


def _fit_beside(answer: Versus, laws: Sequence[str], sets: _Sets) -> _Fit:
    """The recording's own answer where these laws are what it found; else surface and amplitudes fitted to its data sets."""
    found = {e.effect: e.parameters.get("amplitude") for e in answer.diagnosis.effects if _is_law(e.effect)}
    if set(found) == set(laws) and not any(isinstance(t, SmoothTerm) for t in answer.law.terms):
        return _Fit(answer.law, {e: a for e, a in found.items() if a is not None})
    left, X, terms = sets.left_dps, sets.design(laws), sets.terms
    values, *_ = np.linalg.lstsq(X, left, rcond=1e-10)
    rest = left - X @ values
    variance = float(rest @ rest) / max(left.size - X.shape[1], 1)
    covariance = variance * np.linalg.pinv(X.T @ X)
    before = answer.match.surface
    now = before.coefficients_dps.ravel()[terms] + values[: terms.size]
    of_surface = np.zeros((before.coefficients_dps.size, before.coefficients_dps.size))
    of_surface[np.ix_(terms, terms)] = covariance[: terms.size, : terms.size]
    law = replace(answer.law, surface=with_coefficients(before, terms, now), covariance_dps2=of_surface)
    stds = np.sqrt(np.diag(covariance)[terms.size :])
    sizes = zip(laws, values[terms.size :].tolist(), stds.tolist(), strict=True)
    return _Fit(
        law, {e: Estimate.normal(v, s, CATALOGUE[e].parameter("amplitude").unit) for e, v, s in sizes}
    )


def _surface_terms(answers: Sequence[Versus], fitted: Sequence[_Fit]) -> dict[str, list[Estimate | None]]:
    """Terms of what each recording has beyond the simulation, over the rates and temperatures of all: laws of the rate are in them, or a
    scale factor would be that of the turns which an asymmetry leaves alone."""
    differences = [a.match.difference for a in answers]
    top = min(float(np.max(np.abs(d.rate_dps))) for d in differences) or 1.0
    low, high = (
        max(float(d.temp_c.min()) for d in differences),
        min(float(d.temp_c.max()) for d in differences),
    )
    frame = Surface(np.zeros(SHAPE), 0.0, top, 0.5 * (low + high), max(0.5 * (high - low), 1.0))
    rate, temp = (
        x.ravel() for x in np.meshgrid(np.linspace(-top, top, _GRID), np.linspace(low, high, _GRID))
    )
    design = frame.design(rate, temp)
    carried = [set(carried_terms(d).tolist()) for d in differences]
    terms = sorted(set.intersection(*carried))
    to_terms = np.linalg.pinv(design[:, terms])
    found: dict[str, list[Estimate | None]] = {}
    for a, fit in zip(answers, fitted, strict=True):
        here = fit.law.surface.output_dps(rate, temp) - a.match.surface.output_dps(rate, temp)
        over = to_terms @ fit.law.surface.output_design(rate, temp)
        variance = np.maximum(np.diag(over @ fit.law.covariance_dps2 @ over.T), 0.0)
        for amplitude, unit_dps in _of_rate(a, answers, fit, rate, temp):
            here = here + amplitude.value * unit_dps
            # How it goes with the surface is not known: at the most this wide.
            variance = variance + (amplitude.std * (to_terms @ unit_dps)) ** 2
        values, stds = to_terms @ here, np.sqrt(variance)
        for term, value, std in zip(terms, values.tolist(), stds.tolist(), strict=True):
            i, j = divmod(term, SHAPE[1])
            scale, unit = (1e6 / top, "ppm") if i == 1 else (1e3, "mdeg/s")
            estimate = Estimate.normal(scale * value, scale * std, unit)
            found.setdefault(_term_name(i, j, frame), []).append(estimate)
    return found


def _of_rate(
    answer: Versus, answers: Sequence[Versus], fit: _Fit, rate_dps: Floats, temp_c: Floats
) -> Iterator[tuple[Estimate, Floats]]:
    """Amplitudes of laws of the rate alone, each with the law of amplitude one, shape (n,)."""
    c = Conditions(np.zeros(rate_dps.size), rate_dps, temp_c)
    for effect_id, amplitude in fit.amplitudes.items():
        shape = _shape_of(answer, effect_id, answers)
        if of_rate_alone(effect_id) and shape is not None:
            yield amplitude, CATALOGUE[effect_id].unit_dps(c, shape, fit.law.surface)


def _term_name(i: int, j: int, frame: Surface) -> str:
    what = ("bias", "scale factor", "second order in rate", "third order in rate")[i]
    if j == 0:
        return f"{what} at {frame.temp_center_c:.3g} degC"
    return f"{what}, {('', 'change', 'curvature')[j]} over {frame.temp_scale_c:.3g} degC"


def _named(answer: Versus, effect_id: str) -> NamedEffect | None:
    return next((e for e in answer.diagnosis.effects if e.effect == effect_id), None)


def _all_named(answers: Sequence[Versus]) -> list[str]:
    return list(dict.fromkeys(e.effect for a in answers for e in a.diagnosis.effects))


def _is_law(effect_id: str) -> bool:
    """Whether an effect is a function of what is known of each data set, times an amplitude."""
    effect = CATALOGUE[effect_id]
    sized = any(p.name == "amplitude" for p in effect.parameters)
    return sized and effect.search.by_columns and not effect.search.draws


def _effect_parameters(
    answers: Sequence[Versus], fitted: Sequence[_Fit], effect_id: str
) -> dict[str, list[Estimate | None]]:
    """Parameters of an effect in each recording, where it was named; its amplitude in all of them."""
    named = [_named(a, effect_id) for a in answers]
    found: dict[str, list[Estimate | None]] = {}
    for p in CATALOGUE[effect_id].parameters:
        own = [None if e is None else e.parameters.get(p.name) for e in named]
        if p.name == "amplitude":
            own = [f.amplitudes.get(effect_id, e) for f, e in zip(fitted, own, strict=True)]
        if not p.choice and any(e is not None and e.unit == p.unit for e in own):
            found[p.name] = own
    return found


def _common_laws(sets: Sequence[_Sets]) -> list[str]:
    """Laws that all recordings together need beside surfaces of their own, of those that were named in any.

    One by one, by what they explain in all: what was named otherwise in one of them explains nothing more beside.
    """
    open_laws = [e for e in sets[0].laws if all(e in s.laws for s in sets)]
    taken: list[str] = []
    nats = _log_likelihood(sets, taken)
    while open_laws:
        each = {e: _log_likelihood(sets, [*taken, e]) for e in open_laws}
        best = max(each, key=lambda e: each[e])
        if each[best] - nats < GAIN:
            break
        taken.append(best)
        open_laws.remove(best)
        nats = each[best]
    return taken


def _log_likelihood(sets: Sequence[_Sets], laws: Sequence[str]) -> float:
    """Of surfaces and laws beside white noise of any size, less half a nat times log n for each amplitude (Schwarz)."""
    total = 0.0
    for s in sets:
        left, X = s.left_dps, s.design(laws)
        rest = left - X @ np.linalg.lstsq(X, left, rcond=1e-10)[0]
        total -= 0.5 * left.size * float(np.log(rest @ rest)) + 0.5 * len(laws) * float(np.log(left.size))
    return total


def _column(answer: Versus, effect_id: str, answers: Sequence[Versus]) -> Floats | None:
    """A law of amplitude one at the data sets of a recording, shape (sets,); None where no recording tells its shape."""
    difference, shape = answer.match.difference, _shape_of(answer, effect_id, answers)
    if shape is None:
        return None
    unit_dps = CATALOGUE[effect_id].unit_dps(conditions_of(difference), shape, answer.law.surface)
    return set_means(difference, unit_dps)[1]


def _shape_of(answer: Versus, effect_id: str, answers: Sequence[Versus]) -> dict[str, float] | None:
    """The shape of a law; None where no recording tells it.

    That of all, since amplitudes at different ones say nothing; its own where shapes differ, as instants do.
    """
    effect = CATALOGUE[effect_id]
    named = [e for a in answers if (e := _named(a, effect_id)) is not None]
    own = _named(answer, effect_id)
    shape: dict[str, float] = {}
    for p in effect.parameters:
        estimates = [x for e in named if (x := e.parameters.get(p.name)) is not None]
        if p.name == "amplitude" or (p.choice and not estimates):
            continue
        if not estimates:
            return None
        shape[p.name] = _pooled(estimates, None if own is None else own.parameters[p.name])
    return shape


def _pooled(estimates: Sequence[Estimate], own: Estimate | None) -> float:
    """A parameter of all recordings; a recording's own where they differ, or where it was chosen from a few."""
    known = [e for e in estimates if np.isfinite(e.std)]
    if len(known) < len(estimates):
        return (own or estimates[0]).value
    values, stds = np.array([e.value for e in known]), np.array([max(e.std, 1e-9) for e in known])
    apart = stds.size > 1 and spread_between(values, stds).p_value < LEVEL
    return own.value if apart and own is not None else float(np.average(values, weights=stds**-2))
