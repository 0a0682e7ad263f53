"""Laws of time and of the history of temperature and rate that a table's search tries, as columns at its rows.

Few gyros do what they do with one time constant, or at an instant. A law of one shape that misses its course leaves to a
wandering bias what it misses, and then nothing is told apart; so each has a spread too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.laws.at_rows import Laws, laws_of
from gyrocal.diagnosis.model.layers import Law
from gyrocal.diagnosis.model.parts import since_on
from gyrocal.diagnosis.rows.columns import EDGE
from gyrocal.diagnosis.rows.means import Means
from gyrocal.diagnosis.rows.visited import steps_of_scale, tells_of_scale
from gyrocal.diagnosis.sweeps.finer import neighbours
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import where_it_acts
from gyrocal.physics.smooth import Frame
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.thermal import RATE_HEATING, SHUPE, SHUPE_GRADIENT, THERMAL_HYSTERESIS
from gyrocal.physics.timewise import (
    AGEING_NATS,
    BIAS_DRIFT,
    BIAS_STEP,
    KNEES,
    POWERS,
    SCALE_DRIFT,
    SCALE_STEP,
    WARM_UP,
    growth,
    power_shape,
)
from gyrocal.units import MDPS, PPM

Floats = NDArray[np.float64]
#: An effect, and whether it acts on the scale factor instead of the bias.
Kind = tuple[str, bool]

STEPS = (SCALE_STEP.id, BIAS_STEP.id)
DRIFTS = (SCALE_DRIFT.id, BIAS_DRIFT.id)
_IN_TIME = tuple((effect, False) for effect in (*STEPS, *DRIFTS))
#: Laws of what is remembered, and their shape; the first has none. Heat of past turns grows as a
#: warm-up does: only beside each other are they told apart.
HISTORY = {
    SHUPE.id: "",
    SHUPE_GRADIENT.id: "tau_s",
    THERMAL_HYSTERESIS.id: "width_c",
    RATE_HEATING.id: "tau_s",
}
#: Those that may act on the scale factor as well, whatever does on the bias. A warm-up does beside its own of the bias alone, of
#: the same time constant: else it was one in place of a drift by the root of time.
_OF_SCALE = (THERMAL_HYSTERESIS.id,)
#: Time constants of a warm-up, s: of a minute, as a small gyro's, to two hours.
_WARM_UPS_S = tuple(np.geomspace(60.0, 7200.0, 31).round().tolist())
#: A warm-up that the record does not outlast by half is a drift: its end is not seen.
_OUTLASTED = 1.5
#: After so many time constants it is over.
_OVER = 5.0
#: A step has data sets on either side, in a long table more than these.
_FEWEST_SETS = 4
#: How long a step takes, in distances of data sets: the time constant of a logistic curve.
_RISES = (0.0, 0.5, 1.0, 2.0, 4.0)
#: Standard deviation of the logarithm of a time constant; 0.8 and 1.6 are near to stretched exponentials of 0.85 and 0.6.
_SPREADS = (0.0, 0.8, 1.6)
#: Of the time constants of a grid one of so many has a part in a spread, and none less than this.
_THINNED, _LEAST_WEIGHT = 3, 0.01
#: A drift is next to so many on either side: powers of time and of its logarithm lie between each other.
_NEXT_DRIFTS = 2


class Change(NamedTuple):
    """A law at its shape: of a step the row from which on it holds, of a drift its power, else a width or time constant.

    `spread` is that of a time constant or width, of a step how long it takes, and of a drift that ages its knee, s;
    `of_scale` is of those that else act on the bias.
    """

    effect: str
    at: float
    spread: float = 0.0
    of_scale: bool = False

    @property
    def kind(self) -> Kind:
        """What a model has once, but for steps."""
        return self.effect, self.of_scale

    @property
    def beside(self) -> Change | None:
        """The law without which a model does not have it."""
        return self._replace(of_scale=False) if self.effect == WARM_UP.id and self.of_scale else None

    @property
    def prior_nats(self) -> float:
        """Evidence that it starts with."""
        ages = self.effect in DRIFTS and bool(self.spread)
        before = CATALOGUE[self.effect].search.nats_before({HISTORY.get(self.effect, ""): self.at})
        return before + (AGEING_NATS if ages else 0.0)

    @property
    def plain(self) -> bool:
        """Whether it is of one time constant, sudden or straight."""
        return not self.spread and (self.effect not in DRIFTS or self.at == 1.0)


@dataclass(frozen=True)
class Changes:
    """Laws at the rows of a table, each effect at all its shapes."""

    means: Means
    frame: Frame

    def at(self, means: Means) -> Changes:
        """The same shapes, at the same rows of another slope of the output."""
        found = Changes(means, self.frame)
        found.values.update(self.values)
        found.trials.update(self.trials)
        return found

    def grids(self, effect: str) -> tuple[Sequence[float], Sequence[float]]:
        """Values and spreads that an effect other than a drift may have here; none where the record cannot show it."""
        m = self.means
        if effect in STEPS:
            rise_s = float(np.median(np.diff(m.t_s))) * np.array(_RISES)
            edge = max(_FEWEST_SETS, round(EDGE * len(m)))
            rows = np.arange(edge, len(m) - edge)
            if effect == SCALE_STEP.id and not self.tells_of_scale:
                rows = np.intersect1d(rows, steps_of_scale(m, _FEWEST_SETS))
            return rows.tolist(), rise_s.tolist()
        return self.values[effect], _SPREADS if effect in (WARM_UP.id, SHUPE_GRADIENT.id) else (0.0,)

    @cached_property
    def tells_of_scale(self) -> bool:
        """Whether it turned at temperatures enough to tell what changes the scale factor from the surface."""
        return tells_of_scale(self.means)

    @cached_property
    def lasting(self) -> list[Kind]:
        """What stays with the gyro, each where it may act."""
        kinds = [(effect, False) for effect in (WARM_UP.id, *HISTORY)]
        return kinds + [(effect, True) for effect in _OF_SCALE if self.tells_of_scale]

    def shapes(self, effect: str, of_scale: bool = False) -> list[Change]:
        """All shapes of an effect."""
        if effect == SCALE_DRIFT.id and not self.tells_of_scale:
            return []
        if effect in DRIFTS:
            return [Change(effect, *shape) for shape in self._drifts]
        values, spreads = self.grids(effect)
        return [Change(effect, float(at), float(spread), of_scale) for at in values for spread in spreads]

    @cached_property
    def trials(self) -> dict[Kind, int]:
        """How many shapes each may have at first: what it pays does not depend on how fine its grid became since."""
        return {kind: len(self.shapes(*kind)) for kind in (*self.lasting, *_IN_TIME)}

    def of_scale_too(self, change: Change) -> list[Change]:
        """What a warm-up may do to the scale factor beside the bias, where the record shows it."""
        found = change._replace(of_scale=True)
        return [found] if found.beside == change and self.tells_of_scale else []

    def neighbours(self, change: Change) -> list[Change]:
        """The shapes next to one."""
        if change.effect in DRIFTS:
            tried = self.shapes(change.effect)
            at = tried.index(change)
            return [
                near for near in tried[max(at - _NEXT_DRIFTS, 0) : at + _NEXT_DRIFTS + 1] if near != change
            ]
        values, spreads = self.grids(change.effect)
        near = [change._replace(at=float(at)) for at in neighbours(list(values), change.at)]
        return near + [change._replace(spread=float(x)) for x in neighbours(list(spreads), change.spread)]

    def law(self, change: Change) -> Law:
        """A change as a law of the model: what remembers stays, and a warm-up comes again with the next switch-on.

        A step is zero at the end of the record, whose state the surface is to have; a drift is in the mean. Whether it
        lasts nobody knows, and one that is none, but something else's misfit, then moves no level.
        """
        m, (effect, at, spread) = self.means, change[:3]
        if effect in STEPS or effect in DRIFTS:
            scale = PPM * m.felt_dps if "rate_dps" in CATALOGUE[effect].needs else np.full(len(m), MDPS)
            if effect in DRIFTS:
                shape = self._of_drift(at, spread)
                ahead = growth(m.t_s, shape)
                return Law(effect, shape, ((ahead - ahead.mean()) * scale)[:, None], from_end=True)
            shape = {"at_s": float(0.5 * (m.t_s[int(at) - 1] + m.t_s[int(at)]))}
            ahead = self._risen(int(at), spread)
            return Law(effect, shape, (ahead * scale)[:, None], from_end=True, spread=spread)
        name = HISTORY.get(effect, "tau_s")
        mixture = _spread_over(self._coarse[effect][::_THINNED], at, spread) if spread else {at: 1.0}
        of_bias = np.sum([weight * self._of_bias(effect, x) for x, weight in mixture.items()], axis=0)
        where = {"of_scale": float(change.of_scale)}
        column = where_it_acts(Conditions(m.t_s, m.felt_dps, m.temp_c), where, of_bias)[:, None]
        shape = _shape(name, at) | (where if change.of_scale else {})
        return Law(effect, shape, column, spread=spread, mixture=tuple(mixture.items()) if spread else ())

    def columns(self, effect: str, of_scale: bool = False) -> Floats:
        """Columns of all shapes of an effect, shape (n, shapes)."""
        tried = self.shapes(effect, of_scale)
        key = effect, of_scale, len(tried)
        if key not in self._columns:
            self._columns[key] = np.column_stack([self.law(c).columns[:, 0] for c in tried])
        return self._columns[key]

    def priors_nats(self, effect: str, of_scale: bool = False) -> Floats:
        """Evidence that each shape of an effect starts with, shape (shapes,)."""
        tried = self.shapes(effect, of_scale)
        key = effect, of_scale, len(tried)
        if key not in self._priors:
            self._priors[key] = np.array([change.prior_nats for change in tried])
        return self._priors[key]

    @cached_property
    def _drifts(self) -> list[tuple[float, float]]:
        """Powers and knees of a drift, one of them zero, in the order of how much of it is there after half of the record."""
        from_s, span_s = float(self.means.t_s[0]), float(np.ptp(self.means.t_s))
        found = [(power, 0.0) for power in POWERS] + [(0.0, share * span_s) for share in KNEES]

        def early(shape: tuple[float, float]) -> float:
            begun, half, whole = growth(from_s + np.array([0.0, 0.5, 1.0]) * span_s, self._of_drift(*shape))
            return float((half - begun) / (whole - begun))

        return sorted(found, key=early)

    def _of_drift(self, power: float, knee_s: float) -> dict[str, float]:
        """The shape of one; what ages does so since the record began."""
        if knee_s:
            return {"knee_s": knee_s, "from_s": float(self.means.t_s[0])}
        return power_shape(power, self._laws.offer)

    @cached_property
    def _columns(self) -> dict[tuple[str, bool, int], Floats]:
        return {}

    @cached_property
    def _priors(self) -> dict[tuple[str, bool, int], Floats]:
        return {}

    @cached_property
    def values(self) -> dict[str, list[float]]:
        """Time constants and widths that are tried, ascending, to which finer ones may come."""
        least_s, most_s = since_on(self.means)[0] / _OVER, np.ptp(self.means.t_s) / _OUTLASTED
        found = {effect: list(grid) for effect, grid in self._coarse.items()}
        return found | {WARM_UP.id: [tau for tau in _WARM_UPS_S if least_s <= tau < most_s]}

    @cached_property
    def _coarse(self) -> dict[str, tuple[float, ...]]:
        """Values over which a spread is a sum; a search over models begins with a grid as fine as that of a warm-up."""
        found = {WARM_UP.id: _WARM_UPS_S}
        for effect, name in HISTORY.items():
            trials = [t for t in self._laws.trials(CATALOGUE[effect]) if not t.shape.get("of_scale")]
            grid = [trial.shape.get(name, 0.0) for trial in trials]
            if name and grid:
                grid = np.geomspace(min(grid), max(grid), len(_WARM_UPS_S)).tolist()
            found[effect] = tuple(grid)
        return found

    def _of_bias(self, effect: str, at: float) -> Floats:
        """A warm-up, or what is remembered, on the bias, shape (n,)."""
        key = effect, at
        if key not in self._known:
            self._known[key] = (
                MDPS * np.exp(-since_on(self.means) / at)
                if effect == WARM_UP.id
                else self._laws.at(CATALOGUE[effect], _shape(HISTORY[effect], at))[:, 0]
            )
        return self._known[key]

    @cached_property
    def _known(self) -> dict[tuple[str, float], Floats]:
        return {}

    @cached_property
    def _laws(self) -> Laws:
        """Laws none of which acts through the surface."""
        frame = self.frame
        blank = Surface(np.zeros(SHAPE), 0.0, frame.rate_scale_dps, frame.temp_center_c, frame.temp_scale_c)
        return laws_of(self.means, blank)

    def _risen(self, row: int, rise_s: float) -> Floats:
        """A step up to zero before a row, shape (n,)."""
        if not rise_s:
            return np.asarray(-1.0 * (np.arange(len(self.means)) < row))
        t_s = self.means.t_s
        away = (t_s - 0.5 * (t_s[row - 1] + t_s[row])) / rise_s
        risen = 1.0 / (1.0 + np.exp(-np.clip(away, -50.0, 50.0)))
        return np.asarray(risen - risen[-1])


def _shape(name: str, at: float) -> dict[str, float]:
    return {name: at} if name else {}


def _spread_over(values: Sequence[float], at: float, spread: float) -> dict[float, float]:
    """Weights of values whose logarithms scatter about one: normal, and none that hardly counts."""
    weight = np.exp(-0.5 * (np.log(np.array(values) / at) / spread) ** 2)
    weight /= weight.sum()
    kept = {x: float(w) for x, w in zip(values, weight, strict=True) if w > _LEAST_WEIGHT}
    whole = sum(kept.values())
    return {x: w / whole for x, w in kept.items()}
