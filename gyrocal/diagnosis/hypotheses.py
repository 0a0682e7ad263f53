"""The catalogue as hypotheses: each effect is a block of columns over a small grid of its shapes.

Amplitudes (and phases, as cosine and sine) are linear; whatever else shapes an effect is on the grid here and is
refined later. Columns are the catalogue's own laws at unit amplitude, so an estimate is in the catalogue's units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from gyrocal.diagnosis.columns import Book, RowConditions, conditions_of
from gyrocal.diagnosis.series import Series
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Conditions
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Shape = Mapping[str, float]

#: Evidence (nats) that an effect starts with. A polynomial claims no mechanism; a sign that physics excludes
#: has to be bought; what two hypotheses share is then given to the law.
_PRIOR = {"rate_order": -1.0, "fit_direction": -1.0, "mechanical_resonance": -1.0}
WRONG_SIGN = -2.5
#: A warm-up of a gyro of which nobody says that it has just been switched on.
_UNKNOWN_START = -1.0
#: What is not in the catalogue starts with this.
STRANGE = -3.0
#: Effects whose amplitude is positive by their nature.
_POSITIVE = ("sagnac_sine", "saturation", "truncation", "thermal_lag")
#: Patterns of the reference of which less than this share (of the largest) is left beyond the surface are its own.
_BEYOND_SURFACE = 1e-3
#: Parameters of shape along which a grid may become finer.
REFINED_ON_GRID = ("at_s", "tau_s", "width_c", "phase_rad_per_dps", "knee_dps")
#: Instants of a jump that are on the grid from the first.
_JUMP_NET = 48
#: Same law, other cause: (the same columns explain the data exactly as well).
TWINS = {"earth_rate_tilt": ("magnetic", "g_sensitivity")}


@dataclass(frozen=True)
class Hypothesis:
    """An effect (or a stranger to the catalogue) as columns of a book.

    Attributes
    ----------
    id, coordinate, family : str
    shapes : tuple of mapping
        Shape parameters of each grid point.
    points : ndarray of int, shape (g, k)
        Column numbers of each grid point.
    nuisance : ndarray of int
        Further columns of the effect's whole family of shapes.
    prior : float
        Evidence it starts with, nats.
    trials : float, optional
        Independent trials that its grid is worth, where whoever chose the points knows.
    """

    id: str
    coordinate: str
    family: str
    shapes: tuple[Shape, ...]
    points: Ints
    nuisance: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    prior: float = 0.0
    positive: bool = False
    in_catalogue: bool = True
    #: Amplitudes are independent draws of one size, not parameters each.
    random: bool = False
    trials: float | None = None
    #: The law of another hypothesis once more, for a second effect of the kind.
    repeats: str = ""

    @cached_property
    def weights(self) -> Floats:
        """Share of each grid point in the shapes that could be, shape (g,).

        A grid that is finer here than there must not make its law likelier: along the parameter that is refined a
        point stands for half the way to its neighbours, in time itself or in the logarithm of a scale.
        """
        key = next((name for name in REFINED_ON_GRID if name in self.shapes[0]), None)
        if key is None:
            return np.full(len(self.shapes), 1.0 / len(self.shapes))
        others = [tuple(sorted((k, v) for k, v in shape.items() if k != key)) for shape in self.shapes]
        weights = np.empty(len(self.shapes))
        for other in set(others):
            rows = np.flatnonzero([o == other for o in others])
            x = np.array([self.shapes[row][key] for row in rows])
            x = x if key == "at_s" or x.min() <= 0 else np.log(x)
            order = np.argsort(x)
            width = np.ones(x.size)
            if np.ptp(x) > 0 and x.size > 2:
                width[order] = np.gradient(x[order])
            weights[rows] = width / width.sum()
        return np.asarray(weights / weights.sum())

    @property
    def df(self) -> int:
        """Amplitudes of a grid point."""
        return int(self.points.shape[1])


def law(
    effect: str, c: Conditions, shape: Shape, surface: Surface | None, phase_rad: float | None = None
) -> Floats:
    """An effect of the catalogue at unit amplitude, shape (n,), deg/s.

    Rows that are means over many seconds see a jump as the share of the row that is behind it.
    """
    known = CATALOGUE[effect]
    if "at_s" in shape and isinstance(c, RowConditions):
        before = {**known.typical(), "amplitude": 1.0, "at_s": float(c.t_s[0]) - 1e6}
        whole = known.error_dps(c, before, surface, None)[0]
        return np.asarray(whole * np.clip((c.t_s - shape["at_s"]) / c.row_s + 0.5, 0.0, 1.0))
    if effect == "truncation" and surface is not None and shape.get("of_output"):
        # What is cut is the output: at rest its sign is that of the bias, as far as the samples' noise lets it.
        output = c.rate_dps + surface.error_dps(c.rate_dps, c.temp_c)
        noise = c.sample_std_dps if isinstance(c, RowConditions) else 0.0
        return np.asarray(-1e-3 * (erf(output / (np.sqrt(2.0) * noise)) if noise > 0 else np.sign(output)))
    if effect == "saturation" and shape.get("softness_dps"):
        # A gain that falls gradually: the catalogue's knee is its limit.
        return -_soft_knee(c.rate_dps, shape["knee_dps"], shape["softness_dps"])
    p = {**known.typical(), **shape, "amplitude": 1.0}
    if phase_rad is not None:
        p["phase_rad"] = phase_rad
    return known.error_dps(c, p, surface, None)[0]


def phase_columns(effect: str, c: Conditions, shape: Shape) -> Floats:
    """Cosine and sine of an effect with a phase, shape (n, 2): amplitude and phase become linear."""
    return np.column_stack([law(effect, c, shape, None, 0.0), law(effect, c, shape, None, -np.pi / 2)])


def columns_at(h: Hypothesis, c: Conditions, shape: Shape, surface: Surface | None) -> Floats:
    """Columns of a hypothesis of the catalogue at any shape, shape (n, df)."""
    if h.id == "rate_order" and h.df == 2:
        return two_orders(c, shape)
    return phase_columns(h.id, c, shape) if h.df == 2 else law(h.id, c, shape, surface)[:, None]


def two_orders(c: Conditions, shape: Shape) -> Floats:
    """Columns of an even and an odd order at once, shape (n, 2)."""
    other = {**shape, "order": shape["order_2"]}
    return np.column_stack([law("rate_order", c, shape, None), law("rate_order", c, other, None)])


def finer_shapes(h: Hypothesis, point: int) -> list[dict[str, float]]:
    """Shapes between a point of a grid and its neighbours; where a jump may be is scanned for (`jumps`)."""
    best = dict(h.shapes[point])
    for name in REFINED_ON_GRID[1:]:
        if best.get(name, 0.0) > 0.0 and "center_dps" not in best:
            grid = np.unique([s[name] for s in h.shapes])
            place = int(np.searchsorted(grid, best[name]))
            low, high = grid[max(place - 1, 0)], grid[min(place + 1, grid.size - 1)]
            return [{**best, name: float(x)} for x in np.geomspace(low, high, 10)[1:-1]]
    return []


def shapes_of(effect: str, series: Series) -> list[dict[str, float]]:
    """Grid of the shape parameters of an effect for this record."""
    span_s = float(np.ptp(series.t_s))
    full = float(np.max(np.abs(series.rate_dps)))
    temp_span = float(np.ptp(series.history.temp_c))
    size: Floats = np.unique(np.round(np.abs(series.rate_dps), 3))
    grids: dict[str, list[dict[str, float]]] = {
        "shupe_gradient": [{"tau_s": float(x)} for x in np.geomspace(60.0, 3600.0, 12) if x < span_s],
        "thermal_lag": [{"tau_s": float(x)} for x in np.geomspace(30.0, 1800.0, 10) if x < span_s],
        "thermal_hysteresis": [{"width_c": float(x)} for x in np.geomspace(0.012, 0.45, 11) * temp_span],
        "warm_up": [{"tau_s": float(x)} for x in np.geomspace(120.0, 7200.0, 12) if x < span_s],
        "bias_step": [{"at_s": float(x)} for x in _instants(series)],
        "scale_step": [{"at_s": float(x)} for x in _between_turns(series)],
        "sagnac_sine": [{"phase_rad_per_dps": float(x) / full} for x in (0.2, 0.5, 0.8, 1.2)] if full else [],
        "saturation": [
            {"knee_dps": float(x) * full, "softness_dps": soft * full}
            for soft in (0.0, 0.04)
            for x in np.linspace(0.45, 0.95, 11)
        ],
        "mechanical_resonance": [
            {"center_dps": float(a), "width_dps": float(b) * full, "scatter": 0.0}
            for a in size[size > 0]
            for b in (0.02, 0.06, 0.12)
        ],
        "dead_zone": [{"width_dps": float(x)} for x in _dead_widths(size)],
        "table_eccentricity": [{"harmonic": 1.0}, {"harmonic": 2.0}],
        "step_response": _ringing(),
        "temperature_order": _powers(series, (3.0, 4.0)),
        "truncation": [{"of_output": 0.0}, {"of_output": 1.0}],
        "rate_order": [{"order": o, "scale_dps": full or 1.0} for o in (4.0, 5.0, 6.0)],
    }
    return grids.get(effect, [{}])


def _powers(series: Series, orders: Sequence[float]) -> list[dict[str, float]]:
    low, high = float(series.temp_c.min()), float(series.temp_c.max())
    return [{"order": o, "center_c": (low + high) / 2, "scale_c": (high - low) / 2 or 1.0} for o in orders]


def _ringing() -> list[dict[str, float]]:
    """Creeps, and ringing over frequencies and dampings (a servo rings a few times, not for ever)."""
    creep = [{"tau_s": float(t), "frequency_hz": 0.0} for t in (0.3, 0.7, 1.5, 3.0, 6.0)]
    ring = [
        {"tau_s": float(1.0 / (2 * np.pi * f * damping)), "frequency_hz": float(f)}
        for f in np.geomspace(0.1, 4.2, 32)
        for damping in (0.1, 0.25, 0.6)
    ]
    return creep + [s for s in ring if 0.15 < s["tau_s"] < 12.0]


def _dead_widths(size: Floats) -> Floats:
    small = size[size <= 10.0]
    if small.size == 0 or small[0] > 0.01:
        return np.empty(0)
    return (
        np.append((small[:-1] + small[1:]) / 2, small[-1] * 1.05 + 0.05)
        if small.size > 1
        else np.array([0.05])
    )


def _set_starts(series: Series) -> Floats:
    first = np.flatnonzero(np.diff(series.set_index, prepend=-1))
    starts = series.t_s[first]
    if starts.size > 400:
        starts = starts[:: int(np.ceil(starts.size / 400))]
    return starts[1:] - 0.5


def _between_turns(series: Series) -> Floats:
    """Candidate instants of a change of scale factor: between the first and the last two turns of the table.

    Outside of them it is a scale factor for the whole record, which the surface has already.
    """
    turning = np.flatnonzero(np.abs(series.rate_dps) > 0)
    if turning.size == 0:
        return np.empty(0)
    starts = _set_starts(series)
    sets = np.unique(series.set_index[turning])
    edge = min(2, sets.size // 4)
    first = series.t_s[np.flatnonzero(series.set_index == sets[edge])[0]]
    last = series.t_s[np.flatnonzero(series.set_index == sets[-1 - edge])[-1]]
    return np.asarray(starts[(starts > first - 1.0) & (starts < last)])


def _instants(series: Series) -> Floats:
    """A coarse net of instants of a jump; a scan of all of them adds the likely ones (`jumps`)."""
    return np.linspace(series.t_s[0], series.t_s[-1], _JUMP_NET + 2)[1:-1]


def build(series: Series, surface: Surface, book: Book) -> list[Hypothesis]:
    """Every effect of the catalogue that this record can show, as columns of the book."""
    c = conditions_of(series)
    found: list[Hypothesis] = []
    for effect in CATALOGUE.values():
        if effect.id in _SPECIAL or _why_not(effect.id, series) is not None:
            continue
        shapes = shapes_of(effect.id, series)
        if not shapes:
            continue
        if effect.id in ("earth_rate_tilt", "table_eccentricity"):
            points = np.array([book.add(phase_columns(effect.id, c, s)) for s in shapes])
            found.append(_hypothesis(effect.id, shapes, points))
        elif effect.id == "step_response":
            found += _step_hypotheses(c, shapes, book)
        else:
            points = np.array([book.add(law(effect.id, c, s, surface)) for s in shapes])
            nuisance = _family_nuisance(effect.id, c, series, book)
            h = _hypothesis(effect.id, shapes, points, nuisance, series.has_time)
            if effect.id == "warm_up" and series.since_power_on_s is None:
                h = replace(h, coordinate="time", prior=_UNKNOWN_START)
            found.append(h)
            if effect.id == "bias_step":
                found.append(_another(found[-1], "(another jump)"))
            if effect.id == "rate_order":
                both = {**shapes[0], "order": 5.0, "order_2": 4.0}
                pair = book.add(two_orders(c, both))[None, :]
                found.append(_hypothesis(effect.id, [both], pair, nuisance))
    reference = _reference_columns(series, book)
    if reference is not None:
        each = _hypothesis("reference_rate_error", [{}], book.add(reference)[None, :])
        found.append(replace(each, random=True))
    return found


def _another(h: Hypothesis, name: str) -> Hypothesis:
    """A second effect of a kind: it is located, and what there is two of has no name of its own."""
    return replace(h, id=name, prior=STRANGE, in_catalogue=False, repeats=h.id)


#: Found by other means (`sampling.py`), twins of others, or of another build.
_SPECIAL = ("magnetic", "g_sensitivity", "quantisation", "time_base", "bursts", "reference_rate_error")


def _step_hypotheses(c: Conditions, shapes: list[dict[str, float]], book: Book) -> list[Hypothesis]:
    creep = [s for s in shapes if s["frequency_hz"] == 0.0]
    ring = [s for s in shapes if s["frequency_hz"] > 0.0]
    one = np.array([book.add(law("step_response", c, s, None)) for s in creep])
    two = np.array([book.add(phase_columns("step_response", c, s)) for s in ring])
    return [
        _hypothesis("step_response", creep, one, two.ravel()),
        _hypothesis("step_response", ring, two, one.ravel()),
    ]


def _hypothesis(
    effect: str, shapes: Sequence[Shape], points: Ints, nuisance: Ints | None = None, timed: bool = True
) -> Hypothesis:
    known = CATALOGUE[effect]
    return Hypothesis(
        effect,
        "data_set_index" if known.seen_in == "time" and not timed else known.seen_in,
        known.family,
        tuple(shapes),
        points,
        np.empty(0, dtype=np.int64) if nuisance is None else nuisance,
        _PRIOR.get(effect, 0.0),
        effect in _POSITIVE,
    )


def _family_nuisance(effect: str, c: Conditions, series: Series, book: Book) -> Ints:
    """Shapes near an effect's own that a real one may have: they must not be named beside it."""
    t = (c.t_s - c.t_s[0]) / max(float(np.ptp(c.t_s)), 1.0)
    w = c.rate_dps
    full = max(float(np.max(np.abs(w))), 1e-9)
    v = (c.temp_c - series.temp_c.mean()) / max(float(np.ptp(series.temp_c)) / 2, 1e-9)
    extra: list[Floats] = []
    if effect in ("bias_drift", "scale_drift"):
        gain = 1.0 if effect == "bias_drift" else w
        extra = [gain * t**p for p in (0.7, 0.85, 1.2, 1.4)]
    elif effect == "temperature_order":
        extra = [v**5, np.sinh(2 * v), np.exp(2 * v), np.exp(-2 * v), v**3 * w, v**4 * w]
    elif effect == "scale_asymmetry":
        extra = [np.sqrt(w**2 + (s * full) ** 2) for s in (0.005, 0.02, 0.05)]
    elif effect in ("sagnac_sine", "saturation", "rate_order"):
        extra = [(w / full) ** p for p in (5, 7, 9)]
        extra += [_soft_knee(w, k * full, 0.03 * full) for k in (0.5, 0.6, 0.7, 0.8, 0.9)]
    elif effect == "warm_up" and c.since_power_on_s is not None:
        extra = [np.exp(-np.sqrt(c.since_power_on_s / s)) for s in (300.0, 1200.0, 4000.0)]
    elif effect == "supply_voltage" and c.supply_v is not None:
        dv = c.supply_v - np.median(c.supply_v)
        extra = [dv**2, dv * w]
    elif effect == "shupe":
        extra = [np.asarray(series.history.lagged_rate_at(s, c.t_s)) for s in (30.0, 90.0)]
    return book.add(np.column_stack(extra)) if extra else np.empty(0, dtype=np.int64)


def _soft_knee(w: Floats, knee: float, width: float) -> Floats:
    return np.asarray(np.sign(w) * width * np.logaddexp(0.0, (np.abs(w) - knee) / width))


def _reference_columns(series: Series, book: Book) -> Floats | None:
    """Errors of the reference, fixed for each size of rate, as the odd patterns that the surface leaves.

    The patterns are orthonormal mixtures of the sizes, so that independent errors stay independent. A pattern
    that is all but linear or cubic is left out: what remains of it beyond the surface is not odd any more, and
    an enormous error of the reference would follow other laws along it.
    """
    sizes = np.unique(np.round(np.abs(series.rate_dps), 3))
    sizes = sizes[sizes > 0]
    if not 4 <= sizes.size <= 60:
        return None
    each = np.column_stack(
        [np.where(np.abs(np.abs(series.rate_dps) - s) < 1e-3, series.rate_dps * 1e-6, 0.0) for s in sizes]
    )
    beyond = book.beyond(each)
    values, vectors = np.linalg.eigh(beyond.T @ beyond)
    kept = values > _BEYOND_SURFACE * values[-1]
    return np.asarray(each @ vectors[:, kept])


def _why_not(effect: str, series: Series) -> str | None:
    """Why this record cannot show an effect; None if it can."""
    distinct = np.unique(np.round(series.rate_dps, 3))
    turning = float(np.max(np.abs(series.rate_dps))) > 0
    known = CATALOGUE[effect]
    unknown_start = known.seen_in == "time_since_power_on" and series.has_time
    if known.seen_in in series.untestable and known.seen_in != "time" and not unknown_start:
        return series.untestable[known.seen_in]
    if "angle_deg" in known.needs and not turning:
        return "the table did not turn"
    if known.family == "rate shape":
        if distinct.size < 6:
            return f"it has {distinct.size} different rates, and shapes in rate need at least 6"
        if effect in ("scale_asymmetry", "truncation") and not (distinct.min() < 0 < distinct.max()):
            return "it turns one way only"
        if effect == "dead_zone" and not np.any(np.abs(distinct) < 0.01):
            return "it has no data at rest"
    if effect in ("scale_drift", "scale_step") and not turning:
        return "the table did not turn"
    if effect == "temperature_order" and np.ptp(series.temp_c) < 10.0:
        return "the temperature changed by less than 10 degC"
    if known.family == "thermal transient" and np.ptp(series.temp_c) < 2.0:
        return "the temperature hardly changed"
    if effect == "thermal_lag" and not turning and np.ptp(series.temp_c) < 10.0:
        return "the table did not turn"
    if effect == "step_response" and (series.since_set_s is None or series.step_dps is None):
        return "the record has no samples after a step of rate"
    if effect == "warm_up" and series.since_power_on_s is not None and series.since_power_on_s.min() > 5400:
        return "the record begins more than 1.5 h after power-on"
    return None


def untestable(series: Series) -> dict[str, str]:
    """Effect to the reason why this record cannot show it."""
    reasons = {effect: _why_not(effect, series) for effect in CATALOGUE if effect not in _SPECIAL}
    found = {effect: reason for effect, reason in reasons.items() if reason is not None}
    if "earth_rate_tilt" in found:
        found |= dict.fromkeys(TWINS["earth_rate_tilt"], found["earth_rate_tilt"])
    return found
