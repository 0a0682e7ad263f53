"""Several recordings of one type against one simulation: which parameters differ between them, and which do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.base import carried_terms
from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.series import set_means
from gyrocal.diagnosis.versus.answer import Versus, left_by
from gyrocal.inference.multiple import holm
from gyrocal.inference.spread import Spread, spread_between
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.smooth import SmoothTerm
from gyrocal.physics.surface import SHAPE, Surface

Floats = NDArray[np.float64]

SCHEMA = "gyrocal-between/1"

#: Rate at which any parameter is said to differ where none does.
_LEVEL = 0.01
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
    """Compare the parameters of two or more recordings; what differs most comes first."""
    rows = [("surface", name, e) for name, e in _surface_terms(answers).items()]
    for effect in dict.fromkeys(e.effect for a in answers for e in a.diagnosis.effects):
        rows += [(effect, name, e) for name, e in _effect_parameters(answers, effect).items()]
    compared = []
    for of, name, estimates in rows:
        known = [e for e in estimates if e is not None and 0 < e.std < np.inf]
        if len(known) > 1:
            values, stds = (np.array(x) for x in zip(*((e.value, e.std) for e in known), strict=True))
            compared.append(
                Between(of, name, known[0].unit, tuple(estimates), spread_between(values, stds), False)
            )
    p = holm(np.array([b.spread.p_value for b in compared]))
    judged = [replace(b, differs=bool(x < _LEVEL)) for b, x in zip(compared, p, strict=True)]
    return sorted(judged, key=lambda b: b.spread.p_value)


def _surface_terms(answers: Sequence[Versus]) -> dict[str, list[Estimate | None]]:
    """Terms of what each recording's surface has beyond the simulation's, over the rates and temperatures of all."""
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
    for a in answers:
        here = a.law.surface.output_dps(rate, temp) - a.match.surface.output_dps(rate, temp)
        values = to_terms @ here
        over = to_terms @ a.law.surface.output_design(rate, temp)
        stds = np.sqrt(np.maximum(np.diag(over @ a.law.covariance_dps2 @ over.T), 0.0))
        for term, value, std in zip(terms, values.tolist(), stds.tolist(), strict=True):
            i, j = divmod(term, SHAPE[1])
            scale, unit = (1e6 / top, "ppm") if i == 1 else (1e3, "mdeg/s")
            estimate = Estimate.normal(scale * value, scale * std, unit)
            found.setdefault(_term_name(i, j, frame), []).append(estimate)
    return found


def _term_name(i: int, j: int, frame: Surface) -> str:
    what = ("bias", "scale factor", "second order in rate", "third order in rate")[i]
    if j == 0:
        return f"{what} at {frame.temp_center_c:.3g} degC"
    return f"{what}, {('', 'change', 'curvature')[j]} over {frame.temp_scale_c:.3g} degC"


def _effect_parameters(answers: Sequence[Versus], effect_id: str) -> dict[str, list[Estimate | None]]:
    """Parameters of an effect in each recording; where it was not named, its amplitude at the shape of the others."""
    effect = CATALOGUE[effect_id]
    named = [next((e for e in a.diagnosis.effects if e.effect == effect_id), None) for a in answers]
    units = {p.name: p.unit for p in effect.parameters if not p.choice}
    found: dict[str, list[Estimate | None]] = {}
    for name, unit in units.items():
        estimates = [None if e is None else e.parameters.get(name) for e in named]
        if any(e is not None and e.unit == unit for e in estimates):
            found[name] = estimates
    shape = {name: _pooled(estimates) for name, estimates in found.items() if name != "amplitude"}
    if "amplitude" in found and set(shape) == set(units) - {"amplitude"} and not _drawn(effect_id):
        found["amplitude"] = [
            e or _amplitude_of(a, effect_id, shape) for e, a in zip(found["amplitude"], answers, strict=True)
        ]
    return found


def _drawn(effect_id: str) -> bool:
    return CATALOGUE[effect_id].search.draws or not CATALOGUE[effect_id].search.by_columns


def _pooled(estimates: Sequence[Estimate | None]) -> float:
    known = [e for e in estimates if e is not None]
    weight = np.array([1.0 / max(e.std, 1e-9) ** 2 for e in known])
    return float(weight @ np.array([e.value for e in known]) / weight.sum())


def _amplitude_of(answer: Versus, effect_id: str, shape: Mapping[str, float]) -> Estimate | None:
    """Amplitude of a law beside the surface in a recording in which it was not named, from the means of the sets."""
    effect, difference = CATALOGUE[effect_id], answer.match.difference
    bare = replace(answer.law, terms=tuple(t for t in answer.law.terms if not isinstance(t, SmoothTerm)))
    column = effect.unit_dps(conditions_of(difference), dict(shape), answer.law.surface)
    left, x = (set_means(difference, v)[1] for v in (left_by(bare, difference), column))
    rate, temp = (set_means(difference, v)[1] for v in (difference.rate_dps, difference.temp_c))
    surface = answer.law.surface.design(rate, temp)[:, carried_terms(difference)]
    beyond = x - surface @ np.linalg.lstsq(surface, x, rcond=1e-10)[0]
    square = float(beyond @ beyond)
    free = left.size - surface.shape[1] - 1
    if square <= 1e-12 * float(x @ x) or free < 1:
        return None
    value = float(beyond @ left) / square
    rest = left - surface @ np.linalg.lstsq(surface, left, rcond=1e-10)[0] - value * beyond
    std = float(np.sqrt(rest @ rest / free / square))
    return Estimate.normal(value, std, effect.parameter("amplitude").unit)
