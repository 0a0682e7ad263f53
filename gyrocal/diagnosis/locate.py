"""Where a recording departs from its simulated sequence, and what a model has left behind.

Each coordinate has generic blocks, strangers and laws of the catalogue; the smallest p-value among them, times
their number, is the coordinate's. Benjamini and Hochberg's rule decides the list, Holm's the lack of fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.analysis import Analysis
from gyrocal.diagnosis.gram import Projection, benjamini_hochberg, holm
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.search import Search
from gyrocal.diagnosis.series import Series
from gyrocal.diagnosis.words import curve_words, span_text

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Place:
    """A coordinate with the strongest excess on it.

    Attributes
    ----------
    log_p : float
        Natural logarithm of the coordinate's p-value: it does not underflow.
    excess : float
        Gain of the strongest item less its degrees of freedom.
    columns : ndarray of int
        Of the strongest item.
    item : str
        What it is.
    """

    coordinate: str
    log_p: float
    excess: float
    columns: Ints
    item: str

    @property
    def p_value(self) -> float:
        """P-value, 0 where it underflows."""
        return float(np.exp(max(self.log_p, -700.0)))


def places(analysis: Analysis, projection: Projection, blocks_only: bool = False) -> list[Place]:
    """Every coordinate's strongest excess given a projection, the strongest first."""
    items: dict[str, list[Place]] = {}
    for block in analysis.setup.blocks:
        for size in block.sizes:
            columns = block.columns[:size]
            gain, df = projection.block(columns)
            if df:
                found = Place(block.coordinate, float(chi2.logsf(gain, df)), gain - df, columns, block.label)
                items.setdefault(block.coordinate, []).append(found)
    if not blocks_only:
        for h, trials in zip(analysis.search.hypotheses, analysis.search.trials, strict=True):
            gains = projection.gains(h.points)
            best = int(np.argmax(gains))
            log_p = min(0.0, float(np.log(trials) + chi2.logsf(gains[best], h.df)))
            place = Place(h.coordinate, log_p, float(gains[best]) - h.df, h.points[best], h.id)
            items.setdefault(h.coordinate, []).append(place)
    strongest = []
    for coordinate, group in items.items():
        top = min(group, key=lambda p: p.log_p)
        log_p = min(0.0, top.log_p + float(np.log(len(group))))
        strongest.append(Place(coordinate, log_p, top.excess, top.columns, top.item))
    # By p-value; where several are beyond all doubt, by how much they explain.
    return sorted(strongest, key=lambda p: (max(p.log_p, -40.0), -p.excess))


def lack_of_fit(analysis: Analysis, level: float) -> list[Place]:
    """Coordinates on which the whole model leaves structure behind (Holm), the strongest first."""
    found = places(analysis, analysis.rest)
    passed = holm(np.array([p.p_value for p in found]), level)
    return [p for p, ok in zip(found, passed, strict=True) if ok]


def locate(analysis: Analysis, remaining: Sequence[Place], level: float) -> list[Located]:
    """The located list for the mean."""
    found = places(analysis, analysis.bare)
    passed = benjamini_hochberg(np.array([p.p_value for p in found]), level)
    # Given the strongest of them, what else is there? A place that only mirrors it is not an excess of its own.
    total = max([sum(m.gain for m in analysis.members), *(p.excess for p in found), 1e-9])
    remains = {p.coordinate for p in remaining}
    located = []
    for place, ok in zip(found, passed, strict=True):
        if not ok and place.coordinate not in remains:
            continue
        located.append(
            Located(
                place.coordinate,
                "mean",
                region(analysis, place),
                place.p_value,
                float(np.clip(place.excess / total, 0.0, 1.0)),
                place.coordinate in remains,
            )
        )
    return located


_UNITS = {
    "rate": ("rate", "deg/s", 1.0),
    "temperature": ("temperature", "degC", 1.0),
    "temperature_rate": ("temperature rate", "degC/min", 1.0),
    "temperature_branch": ("temperature rate", "degC/min", 1.0),
    "time": ("time", "h", 1.0 / 3600.0),
    "data_set_index": ("data set", "", 1.0),
    "time_since_power_on": ("time since power-on", "h", 1.0 / 3600.0),
    "table_angle": ("table angle", "deg", 1.0),
    "time_since_step": ("time since the rate step", "s", 1.0),
    "supply": ("supply", "V", 1.0),
}


def coordinate_values(series: Series, coordinate: str) -> Floats | None:
    """The coordinate itself, row by row; None where the record lacks it."""
    values: dict[str, Floats | None] = {
        "rate": series.rate_dps,
        "temperature": series.temp_c,
        "temperature_rate": series.temp_rate_c_per_min,
        "temperature_branch": series.temp_rate_c_per_min,
        "time": series.t_s,
        "data_set_index": series.set_index.astype(np.float64),
        "time_since_power_on": series.since_power_on_s,
        "table_angle": None if series.angle_deg is None else np.mod(series.angle_deg, 360.0),
        "time_since_step": series.since_set_s,
        "supply": series.supply_v,
    }
    return values.get(coordinate)


def region(analysis: Analysis, place: Place) -> str:
    """Where on its coordinate the excess is largest: the range with half the fitted curve's power."""
    series = analysis.setup.series
    # Where time is the order of the data sets a temperature has a branch and no rate.
    made_up = place.coordinate == "temperature_branch" and not series.has_time
    coordinate = "data_set_index" if made_up else place.coordinate
    values = coordinate_values(series, coordinate)
    if values is None:
        return "everywhere"
    bare = analysis.bare
    A = bare.gram[np.ix_(place.columns, place.columns)]
    b = np.linalg.lstsq(A, bare.score[place.columns], rcond=1e-9)[0]
    curve = analysis.setup.columns[:, place.columns] @ b
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, 25)))
    if edges.size < 3:
        return "everywhere"
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    weight = np.bincount(bins, minlength=edges.size - 1)
    power = np.bincount(bins, weights=curve**2, minlength=edges.size - 1) / np.maximum(weight, 1)
    rms = float(np.sqrt(np.mean(curve**2)))
    peak = int(np.argmax(power))
    first = last = peak
    while first > 0 and power[first - 1] > 0.5 * power[peak]:
        first -= 1
    while last < power.size - 1 and power[last + 1] > 0.5 * power[peak]:
        last += 1
    name, unit, scale = _UNITS[coordinate]
    low, high = edges[first] * scale, edges[last + 1] * scale
    where = f"{name} {span_text(low, high)} {unit}".rstrip()
    if coordinate == "data_set_index":
        where = f"data sets {int(np.ceil(low)) + 1} to {int(high) + 1}"
    if first == 0 and last == power.size - 1:
        where = f"all along {name}"
    follows = [words] if (words := curve_words(place.item)) else []
    return f"{where} ({'; '.join([*follows, f'{1e3 * rms:.2g} mdeg/s rms'])})"


def still_free(search: Search, coordinate: str) -> bool:
    """Whether any law of the catalogue lives on a coordinate."""
    return any(h.in_catalogue and h.coordinate == coordinate for h in search.hypotheses)
