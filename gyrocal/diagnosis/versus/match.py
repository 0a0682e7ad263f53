"""A recording and a simulation, set by set: who belongs to whom, on which clocks, and the difference as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.rows.base import carried_terms
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.table_series import FEWEST_ROWS
from gyrocal.errors import DataError
from gyrocal.physics.surface import SHAPE, Direction, Surface
from gyrocal.units import RAD_TO_DEG, STDS_PER_MAD

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Two sets may be partners up to this difference of rate (and share of it) and of temperature; what is left of the
#: difference is bridged by the simulation's own error surface.
_RATE_DPS, _RATE_SHARE, _TEMP_C = 0.05, 0.005, 3.0
#: Differences at which partners are half as welcome: of temperature, and of time once the clocks are known, at least, and in
#: what the clocks leave.
_TEMP_SCALE_C, _LEAST_TIME_SCALE_S, _TIME_SCALE = 1.0, 10.0, 3.0
#: The order of the sets counts where at least this share of those that can have a partner finds one in it: of three rates
#: drawn anew at each temperature two thirds still follow each other, of nine less than half.
_IN_ORDER = 0.8
#: Larger products of sets are matched by rate and temperature alone: the table of the order would not fit.
_MOST_CELLS = 2e7
#: A ramp or soak has a partner that takes as long, up to this share and so many seconds.
_DURATION_SHARE, _DURATION_S = 0.05, 5.0
#: Largest rates that differ by the factor of a unit, to this share, are in that unit.
_SAME_UNIT = 0.15
#: Data sets enclose a rate or a temperature where they come as near, as a share of all they span: plans are met no better.
_NEAR = 0.02


@dataclass(frozen=True)
class Clock:
    """Time of the simulation less time of the recording: ``offset + drift × t``, with standard deviations.

    `left_s`: what this line leaves of the starts of the sets, rms.
    """

    offset_s: float
    offset_std_s: float
    drift_ppm: float
    drift_std_ppm: float
    left_s: float

    def to_json(self) -> dict[str, Any]:
        """Entry ``clock``."""
        return dict(vars(self))


@dataclass(frozen=True)
class Match:
    """Partners, and the recording less the simulation.

    Attributes
    ----------
    difference : Series
        The recording with ``gyro_dps`` the output by `surface` plus recording less simulation: a gyro that has the
        simulation's surface and, beside it, all that the simulation lacks. (Laws that act through the surface of
        the gyro, as a lagging coil does, could not be seen in the bare difference.)
    surface : Surface
        The simulation's own, by least squares.
    sets, simulated_sets, matched_sets : int
        Data sets, ramps and soaks of each, and how many of the recording have a partner.
    in_order : bool
        Whether partners follow each other in the same order in both; else by rate and temperature alone.
    clock : Clock, optional
        Where both have times and one order.
    temp_apart_c : float
        Temperature of the simulation less the recording's, rms over partners.
    lonely_rates_dps, lonely_temp_c : tuple of float
        Rates, and lowest and highest temperature, of the sets that nothing of the simulation was compared with.
    bridged_sets : int
        Sets without a partner that were compared with the simulation's surface, which is all that it holds.
    """

    difference: Series
    surface: Surface
    sets: int
    simulated_sets: int
    matched_sets: int
    in_order: bool
    clock: Clock | None
    temp_apart_c: float
    lonely_rates_dps: tuple[float, ...]
    lonely_temp_c: tuple[float, ...]
    bridged_sets: int = 0

    def to_json(self) -> dict[str, Any]:
        """Entry ``matching``."""
        return {
            "sets": self.sets,
            "simulated_sets": self.simulated_sets,
            "matched_sets": self.matched_sets,
            "bridged_sets": self.bridged_sets,
            "in_order": self.in_order,
            "clock": None if self.clock is None else self.clock.to_json(),
            "temperature_apart_rms_c": self.temp_apart_c,
            "without_partner": {
                "rates_dps": list(self.lonely_rates_dps),
                "temp_c": list(self.lonely_temp_c),
            },
        }


@dataclass(frozen=True)
class _Sets:
    """Data sets, ramps and soaks of a series, arrays of shape (n,); `first` and `last` are their rows."""

    first: Ints
    last: Ints
    rate_dps: Floats
    temp_c: Floats
    start_s: Floats
    end_s: Floats
    is_set: NDArray[np.bool_]

    def __len__(self) -> int:
        return int(self.first.size)


def match(
    real: Series, simulated: Series, only_surface: Callable[[], Surface | None] = lambda: None
) -> Match:
    """Find the partner of each set of a recording in a simulation of it.

    By rate, temperature and order, and where both have times by these too, once offset and drift of the clocks are
    known; where the orders differ (another plan, no order at all) by rate and temperature alone. Small differences of
    rate and temperature between partners are bridged by the error surface of the simulation. A simulation that is nothing
    but a surface is known between its sets, too: there it is the partner of sets that have none.

    Parameters
    ----------
    only_surface : callable
        The surface of the simulation where it holds nothing else; None where it does. Asked where it matters.

    Raises
    ------
    DataError
        They hardly overlap.
    """
    a, b = _sets_of(real), _sets_of(simulated)
    left, right, in_order = _partners(likeness := _likeness(a, b))
    clock = None
    if in_order and real.has_time and simulated.has_time and left.size > 2:
        clock = _clock(a.start_s[left], b.start_s[right])
        scale = max(_TIME_SCALE * clock.left_s, _LEAST_TIME_SCALE_S)
        expected = a.start_s + clock.offset_s + 1e-6 * clock.drift_ppm * a.start_s
        apart = (b.start_s[None, :] - expected[:, None]) / scale
        left, right, in_order = _partners(likeness / (1.0 + apart**2))
        clock = _clock(a.start_s[left], b.start_s[right]) if in_order else None
    surface = surface_of(simulated)
    pairs = _alike(a, b, dict(zip(left.tolist(), right.tolist(), strict=True)))
    between = _between(real, simulated, a, pairs)
    whole = only_surface() if between else None
    bridged = [] if whole is None else between
    surfaces = surface, whole or surface
    difference, apart_c = _difference(real, simulated, surfaces, (a, b), pairs, bridged)
    lonely = np.setdiff1d(np.arange(len(a)), [*pairs, *bridged])
    if len(difference) < FEWEST_ROWS:
        _refuse_little(real, simulated, (a, b), len(pairs))
    temp = a.temp_c[lonely]
    return Match(
        difference,
        surface,
        len(a),
        len(b),
        len(pairs),
        in_order,
        clock,
        apart_c,
        tuple(np.unique(np.round(a.rate_dps[lonely], 3)).tolist()),
        (float(temp.min()), float(temp.max())) if lonely.size else (),
        len(bridged),
    )


def _refuse_little(real: Series, simulated: Series, sets: tuple[_Sets, _Sets], paired: int) -> NoReturn:
    a, b = sets
    raise DataError(
        f"{real.name} and {simulated.name}: {paired} of {len(a)} data sets of the recording have a partner in the simulation "
        f"(the same rate, and a temperature within {_TEMP_C:g} °C), which is too little to compare. "
        + (
            "The rates of the simulation look like rad/s: write rates and outputs in deg/s."
            if _in_radians(a.rate_dps, b.rate_dps)
            else "Simulate the rates and temperatures of the recording."
        )
    )


def _in_radians(real_dps: Floats, simulated_dps: Floats) -> bool:
    """Whether the simulation's rates are those of the recording in rad/s, by the largest of both."""
    largest, simulated = float(np.max(np.abs(real_dps))), float(np.max(np.abs(simulated_dps)))
    return abs(simulated * RAD_TO_DEG - largest) < _SAME_UNIT * largest


def _sets_of(series: Series) -> _Sets:
    """A change of the set's number begins another; a static log has a set a row."""
    first = np.flatnonzero(np.diff(series.set_index, prepend=series.set_index[0] - 1))
    last = np.append(first[1:], len(series)) - 1
    size = last - first + 1

    def mean(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values, first) / size)

    since = np.zeros(len(series)) if series.since_set_s is None else series.since_set_s
    return _Sets(
        first,
        last,
        mean(series.rate_dps),
        mean(series.temp_c),
        series.t_s[first] - since[first],
        series.t_s[last],
        series.is_set[first],
    )


def _likeness(a: _Sets, b: _Sets) -> Floats:
    """How welcome each is to each as a partner, 0 to 1, shape (n, m)."""
    size = np.maximum(np.abs(a.rate_dps)[:, None], np.abs(b.rate_dps)[None, :])
    same = np.abs(a.rate_dps[:, None] - b.rate_dps[None, :]) <= _RATE_DPS + _RATE_SHARE * size
    same &= a.is_set[:, None] == b.is_set[None, :]
    apart_c = a.temp_c[:, None] - b.temp_c[None, :]
    return np.where(same & (np.abs(apart_c) <= _TEMP_C), 1.0 / (1.0 + (apart_c / _TEMP_SCALE_C) ** 2), 0.0)


def _partners(likeness: Floats) -> tuple[Ints, Ints, bool]:
    if likeness.size <= _MOST_CELLS:
        left, right = _in_order(likeness)
        possible = min(np.count_nonzero(likeness.any(axis=axis)) for axis in (0, 1))
        if left.size >= _IN_ORDER * possible:
            return left, right, True
    best = np.argmax(likeness, axis=1)
    left = np.flatnonzero(likeness[np.arange(best.size), best] > 0)
    return left, best[left], False


def _in_order(likeness: Floats) -> tuple[Ints, Ints]:
    """The pairs of greatest total likeness that follow each other in both orders (longest common subsequence)."""
    n, m = likeness.shape
    best = np.zeros((n + 1, m + 1))
    for i in range(n):
        paired = np.maximum(best[i, 1:], np.where(likeness[i] > 0, best[i, :-1] + likeness[i], 0.0))
        best[i + 1, 1:] = np.maximum.accumulate(paired)
    pairs: list[tuple[int, int]] = []
    i, j = n, m
    while i and j:
        if best[i, j] == best[i - 1, j]:
            i -= 1
        elif best[i, j] == best[i, j - 1]:
            j -= 1
        else:
            i, j = i - 1, j - 1
            pairs.append((i, j))
    found = np.array(pairs[::-1], dtype=np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _clock(real_s: Floats, simulated_s: Floats) -> Clock:
    """A straight line through the differences of the starts, robust against partners that are none (Huber weights)."""
    apart = simulated_s - real_s
    center = float(np.mean(real_s))
    X = np.column_stack([np.ones(real_s.size), real_s - center])
    weight = np.ones(real_s.size)
    for _ in range(20):
        line = np.linalg.lstsq(X * weight[:, None], apart * weight, rcond=None)[0]
        left = apart - X @ line
        scale = STDS_PER_MAD * float(np.median(np.abs(left))) or 1.0
        weight = np.sqrt(np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(left), 1e-12)))
    variance = float(np.sum((weight * left) ** 2)) / max(real_s.size - 2, 1)
    covariance = variance * np.linalg.pinv((X * weight[:, None]).T @ (X * weight[:, None]))
    at_zero = np.array([1.0, -center])
    return Clock(
        float(line[0] - line[1] * center),
        float(np.sqrt(at_zero @ covariance @ at_zero)),
        1e6 * float(line[1]),
        1e6 * float(np.sqrt(covariance[1, 1])),
        float(np.sqrt(np.mean(left**2))),
    )


def _alike(a: _Sets, b: _Sets, partner: dict[int, int]) -> dict[int, int]:
    """Partners less ramps and soaks that take another time."""
    return {i: j for i, j in partner.items() if a.is_set[i] or _as_long(a, b, i, j)}


def _as_long(a: _Sets, b: _Sets, i: int, j: int) -> bool:
    lasts, lasts_there = a.end_s[i] - a.start_s[i], b.end_s[j] - b.start_s[j]
    return bool(abs(lasts - lasts_there) <= _DURATION_SHARE * lasts + _DURATION_S)


def enclosed(series: Series, by: Series) -> NDArray[np.bool_]:
    """Rows between the lowest and the highest rate and temperature of other rows, shape (n,)."""
    inside = np.ones(len(series), dtype=bool)
    for own, there in ((series.rate_dps, by.rate_dps), (series.temp_c, by.temp_c)):
        low, high = np.min(there), np.max(there)
        inside &= (own >= low - _NEAR * (high - low)) & (own <= high + _NEAR * (high - low))
    return inside


def _between(real: Series, simulated: Series, a: _Sets, pairs: Mapping[int, int]) -> list[int]:
    """Sets without a partner whose rates and temperatures the simulation encloses."""
    inside = enclosed(real, simulated)
    return [i for i in range(len(a)) if i not in pairs and inside[a.first[i] : a.last[i] + 1].all()]


def _difference(
    real: Series, simulated: Series, surfaces: tuple[Surface, Surface], sets: tuple[_Sets, _Sets],
    pairs: Mapping[int, int], bridged: Sequence[int],
) -> tuple[Series, float]:  # fmt: skip
    """The difference row by row, and how far the temperatures are apart, rms over partners.

    Parameters
    ----------
    surfaces : that which the difference has, and that which the simulation has between its sets
    """
    (surface, whole), (a, b) = surfaces, sets
    error = simulated.gyro_dps - simulated.rate_dps
    rows, values, noise, apart = [], [], [], []
    for i in sorted((*pairs, *bridged)):
        r = np.arange(a.first[i], a.last[i] + 1)
        rows.append(r)
        if i not in pairs:
            rate, temp = real.rate_dps[r], real.temp_c[r]
            e = whole.output_dps(rate, temp) - rate
            noise.append(np.zeros(r.size))
        else:
            j = pairs[i]
            q = np.arange(b.first[j], b.last[j] + 1)
            white = simulated.white_std_dps[q]
            if _as_long(a, b, i, j) and min(r.size, q.size) > 1:
                since, there = real.t_s[r] - a.start_s[i], simulated.t_s[q] - b.start_s[j]
                known = [np.interp(since, there, x[q]) for x in (error, simulated.rate_dps, simulated.temp_c)]
                noise.append(np.interp(since, there, white))
            else:
                known = [
                    np.full(r.size, np.mean(x[q])) for x in (error, simulated.rate_dps, simulated.temp_c)
                ]
                noise.append(np.full(r.size, np.sqrt(np.sum(white**2)) / q.size))
            e, rate, temp = known
            apart.append(float(np.mean(temp - real.temp_c[r])))
        # What the simulation says at its own rate and temperature, less what its surface says there.
        values.append(e - (surface.output_dps(rate, temp) - rate))
    if not rows:
        return real.take(np.zeros(0, dtype=np.int64)), 0.0
    taken = real.take(np.concatenate(rows))
    difference = taken.gyro_dps - np.concatenate(values)
    white = taken.white_std_dps
    if real.states_noise and simulated.states_noise:
        white = np.hypot(white, np.concatenate(noise))
    name = f"{real.name} less {simulated.name}"
    series = replace(taken, name=name, gyro_dps=difference, white_std_dps=white)
    return series, float(np.sqrt(np.mean(np.square(apart)))) if apart else 0.0


def surface_of(simulated: Series, direction: Direction = "output") -> Surface:
    """The simulation's own error surface by least squares (paper eq. 5); what it does not determine is small."""
    g, temp = simulated.gyro_dps, simulated.temp_c
    x = g if direction == "output" else simulated.rate_dps
    center, scale = float(np.mean(temp)), max(float(np.ptp(temp)) / 2, 1.0)
    empty = Surface(np.zeros(SHAPE), 0.0, max(float(np.max(np.abs(g))), 1.0), center, scale, direction)
    terms, c = carried_terms(simulated), np.zeros(SHAPE[0] * SHAPE[1])
    c[terms] = np.linalg.lstsq(empty.design(x, temp)[:, terms], g - simulated.rate_dps, rcond=1e-6)[0]
    return replace(empty, coefficients_dps=c.reshape(SHAPE))
