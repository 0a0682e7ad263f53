"""Laws of the catalogue as columns at the rows of a record, each at the shapes that are tried for it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from gyrocal.diagnosis.model.layers import Fitted, Law, surface_of
from gyrocal.diagnosis.model.parts import AT_FEW, BLOCKS, EACH_RATE, PAST_RATES, SCALE_IN_TIME, frame_of
from gyrocal.diagnosis.rows.columns import conditions_of, offer_of
from gyrocal.diagnosis.rows.means import Means
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.visited import (
    tells_of_branches,
    tells_of_scale,
    temperatures_apart,
    temperatures_turned,
)
from gyrocal.physics.catalogue import CATALOGUE, law_of
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Effect
from gyrocal.physics.lacking import Reason
from gyrocal.physics.offer import Offer
from gyrocal.physics.rate import FIT_DIRECTION
from gyrocal.physics.surface import Surface
from gyrocal.physics.thermal import RATE_HEATING, TEMPERATURE_ORDER, THERMAL_HYSTERESIS
from gyrocal.physics.timewise import BIAS_STEP

Floats = NDArray[np.float64]

#: What a law gains at least, nats, with the logarithm of the root of the number of its shapes.
GAIN = 8.0
#: Columns that are nothing at these rows, as a share of the largest.
_NOTHING = 1e-12
#: The least share of its natural amplitude that a law may have.
_LEAST_NATURAL = 1e-3
#: Family of what time does.
_TIME = BIAS_STEP.family
#: Rounds in which the surface and the laws that act through it follow each other.
_TIES = 2


@dataclass(frozen=True)
class Trial:
    """A law at one shape: columns at unit amplitude, shape (n, q), deg/s."""

    effect: Effect
    shape: Mapping[str, float]
    columns: Floats


@dataclass(frozen=True)
class Laws:
    """Evaluates laws at the means of a record.

    Attributes
    ----------
    surface : Surface
        Over the input rate; what laws act through that act through the surface.
    """

    means: Means
    conditions: Conditions
    offer: Offer
    surface: Surface

    def at(self, effect: Effect, shape: Mapping[str, float]) -> Floats:
        """Columns of a law at unit amplitude, shape (n, q): evaluated where the record was sampled, then averaged."""
        own = effect.columns(self.conditions, shape, self.surface)
        return np.column_stack([self.means.spread(x) for x in own.T])

    def columns_of(self, law: Law) -> Floats:
        """Columns of a law of a model at these rows, shape (n, q)."""
        effect = CATALOGUE[law.effect]
        return np.asarray(np.sum([weight * self.at(effect, shape) for shape, weight in law.members], axis=0))

    def trials(self, effect: Effect) -> list[Trial]:
        """All shapes of an effect that this record may show."""
        if not wanted(effect) or effect.why_not(self.offer) is not None:
            return []
        if is_of_scale_in_time(effect) and not tells_of_scale(self.means):
            return []
        if effect is THERMAL_HYSTERESIS and not tells_of_branches(self.means.temp_c):
            return []
        found = []
        for shape in effect.search.grid(self.offer):
            if shape.get("of_scale") and not tells_of_scale(self.means):
                continue
            if effect is TEMPERATURE_ORDER and not self._tells_of_order(shape):
                continue
            columns = self.at(effect, shape)
            if np.isfinite(columns).all() and np.any(np.abs(columns) > _NOTHING):
                found.append(Trial(effect, shape, columns))
        return found

    def _tells_of_order(self, shape: Mapping[str, float]) -> bool:
        """Whether there are more temperatures than an order: through as many the surface goes by itself."""
        on_scale = "rate_scale_dps" in shape
        temp_c = temperatures_turned(self.means) if on_scale else self.means.temp_c
        return temperatures_apart(temp_c, frame_of(self.means)) > shape["order"]

    def of_one_amplitude(self, block: str) -> list[Trial]:
        """All shapes of what a block may stand for that a file can hold."""
        return [t for e in effects_of(block) for t in self.trials(e) if t.columns.shape[1] == 1]


def wanted(effect: Effect) -> bool:
    """Whether an effect is looked for by columns over means of data sets."""
    search = effect.search
    within = {"table_angle", "time_since_step"}
    # Whether the surface is one of the input is a part of the model itself. A bias that walks is no jump, so that
    # one is looked for beside the walk; a scale factor seldom walks.
    if effect in (FIT_DIRECTION, BIAS_STEP):
        return False
    return search.by_columns and not search.draws and not search.twin_of and effect.seen_in not in within


def likeliest(effect: Effect, size: float, std: float) -> tuple[float, float]:
    """The amplitude that physics knows, of a law that fits best at this one, and by how much that raises the residual sum of squares."""
    known, natural = effect.parameter("amplitude"), effect.search.natural
    if natural is None:
        amplitude = float(np.clip(size, known.low, known.high))
        return amplitude, ((size - amplitude) / std) ** 2

    expected, spread = natural

    def lost(logarithm: float) -> float:
        off = (logarithm - np.log(expected)) / spread
        return float(((size - np.exp(logarithm)) / std) ** 2 + off**2)

    bounds = float(np.log(_LEAST_NATURAL * expected)), float(np.log(known.high))
    found = minimize_scalar(lost, bounds=bounds, method="bounded")
    return float(np.exp(found.x)), float(found.fun)


def laws_of(means: Means, surface: Surface) -> Laws:
    """Laws at the rows of a record."""
    return Laws(means, conditions_of(means.series), offer_of(means.series), surface)


def tied_anew(fitted: Fitted, laws: Laws) -> tuple[Fitted, Laws]:
    """The model whose laws act through the surface that now stands beside them, and the laws so.

    A lag is one of the whole surface: through another surface something else has to make up for the difference.
    """
    for _ in range(_TIES):
        tied = replace(laws, surface=surface_of(fitted.model, fitted.solve()))
        own = tuple(
            law if law.from_end else replace(law, columns=tied.columns_of(law)) for law in fitted.model.laws
        )
        if all(np.allclose(a.columns, b.columns) for a, b in zip(own, fitted.model.laws, strict=True)):
            break
        fitted, laws = fitted.refit(replace(fitted.model, laws=own)), tied
    return fitted, laws


def effects_of(block: str) -> list[Effect]:
    """Effects of the catalogue that may be what a block of smooth parts stands for."""
    own = BLOCKS[block]
    if block == AT_FEW:
        return []
    found = []
    for effect in CATALOGUE.values():
        if not wanted(effect) or effect.family != own.family:
            continue
        # What no robot undoes would be in no file, and in place of errors of single rates in no smooth part either; what
        # scatters from rate to rate is taken for the peak of a resonance, where it is highest.
        if block == EACH_RATE and (not effect.runtime or effect.search.scatters):
            continue
        if own.family == RATE_HEATING.family and (effect is RATE_HEATING) != (block == PAST_RATES):
            continue
        if own.family == _TIME and is_of_scale_in_time(effect) != (block == SCALE_IN_TIME):
            continue
        found.append(effect)
    return found


def is_of_scale_in_time(effect: Effect) -> bool:
    """Whether it is a drift or a step of the scale factor."""
    return effect.family == _TIME and "rate_dps" in effect.needs


def untestable(series: Series, named: Collection[str] = ()) -> dict[str, Reason]:
    """Effect to the reason why this record cannot show it; not of what was `named` from something like it.

    A table without times has the order of its data sets.
    """
    offer = offer_of(series)
    searched = [
        e for e in CATALOGUE.values() if e.search.by_columns and not e.search.draws and e.id not in named
    ]
    reasons = {e.id: CATALOGUE[law_of(e.id)].why_not(offer) for e in searched}
    return {effect: reason for effect, reason in reasons.items() if reason is not None}
