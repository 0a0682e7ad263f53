"""What lives within data sets: patterns of the table angle, and settling after a step of rate.

The mean of each data set is taken off, and the laws are fitted to what is left in all sets together. The test trusts no
model of the noise: each data set counts as one independent draw of the score (cluster-robust covariance). 1/f noise has
no fixed sign within a set, so it averages out over the sets and makes no pattern.

References
----------
Liang and Zeger, Biometrika 73 (1986): covariance from independent clusters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from gyrocal.diagnosis.model.intervals import (
    Interval,
    Point,
    amplitude_interval,
    profile_interval,
    refined,
    shapes_within,
)
from gyrocal.diagnosis.result import Located
from gyrocal.diagnosis.rows.base import fit_surface
from gyrocal.diagnosis.rows.columns import conditions_of, offer_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.inference.multiple import hotelling_p_value
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.effect import Effect
from gyrocal.units import NORMAL_95

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Coordinates that a data set runs through.
_WITHIN = ("table_angle", "time_since_step")
#: Harmonics of the table angle beyond those of a centre and an oval.
_HIGHER_HARMONICS = (3, 4, 5, 6)


@dataclass(frozen=True)
class Pattern:
    """A pattern within data sets that is there beyond noise.

    Attributes
    ----------
    effect : str
    shape : mapping
        Its shape parameters.
    columns : ndarray, shape (rows, q)
        At the rows of the series, means of the sets included.
    amplitudes, covariance : ndarray, shape (q,), (q, q)
    p_value : float
    dof : float
        Degrees of freedom of the covariance.
    intervals, size : of the shape's parameters, and of the amplitude where it is traded against them
    """

    effect: str
    shape: Mapping[str, float]
    columns: Floats
    amplitudes: Floats
    covariance: Floats
    p_value: float
    dof: float
    intervals: Mapping[str, Interval] = field(default_factory=dict)
    size: Interval | None = None

    @property
    def is_sure(self) -> bool:
        """Whether the 95 % interval of its amplitude does not hold zero."""
        b = self.amplitudes
        std = float(np.sqrt(b @ self.covariance @ b) / np.linalg.norm(b))
        return float(np.linalg.norm(b)) > float(student.ppf(0.975, self.dof)) * std

    @property
    def values(self) -> Floats:
        """What it adds to each row, deg/s."""
        return np.asarray(self.columns @ self.amplitudes)


@dataclass(frozen=True)
class _Candidate:
    effect: str
    shape: Mapping[str, float]
    columns: Floats


class _Laws:
    """Laws of the catalogue at the rows of a series."""

    def __init__(self, series: Series) -> None:
        self._conditions = conditions_of(series)
        surface = fit_surface(series).surface
        # Where the reference errs, the gyro turns as fast as it does.
        self._turned = 1.0 / (1.0 - surface.slope_per_dps(series.gyro_dps, series.temp_c))

    def at(self, effect: Effect, shape: Mapping[str, float]) -> _Candidate:
        """A law at a shape, as the output shows it."""
        columns = effect.columns(self._conditions, shape, None)
        if effect.acts_on == "reference":
            columns = columns * self._turned[:, None]
        return _Candidate(effect.id, shape, columns)


def patterns(series: Series, level: float) -> list[Pattern]:
    """Patterns within data sets, the strongest first, each tested beside those that were found before it.

    `level` is the rate of false alarms over all patterns together.
    """
    rows = _usable(series)
    tried = _tried(series)
    if not (tried and rows.any()):
        return []
    laws = _Laws(series)
    candidates = [laws.at(effect, shape) for effect, shape in tried]
    sets = np.unique(series.set_index[rows], return_inverse=True)[1]
    found: list[_Candidate] = []
    result: list[Pattern] = []
    while candidates:
        # The test says whether a pattern is there, but not which shape fits best (a wrong one may scatter less from set
        # to set), so that the shape of each kind is chosen by least squares, and only the best one is tested.
        best: dict[object, tuple[float, _Candidate]] = {}
        for candidate in candidates:
            loss = _loss(series, rows, sets, [*found, candidate])
            kind = kind_of(candidate)
            if kind not in best or loss < best[kind][0]:
                best[kind] = loss, candidate
        tested = [(_test(series, rows, sets, [*found, c])[-1].p_value, c) for _, c in best.values()]
        p, candidate = min(tested, key=lambda x: x[0])
        if p * len(candidates) > level:
            break
        candidates = [c for c in candidates if kind_of(c) != kind_of(candidate)]
        found.append(_refined(laws, series, rows, sets, found, candidate))
        result = _test(series, rows, sets, found)
    return sorted(_with_intervals(laws, series, rows, sets, result), key=lambda p: p.p_value)


def tested_alone(series: Series) -> list[Pattern]:
    """Every law that runs with the table angle within data sets, by itself, as the sets show it."""
    rows = _usable(series)
    angle = [(effect, shape) for effect, shape in _tried(series) if effect.seen_in == "table_angle"]
    # Sets that turn through a part of a turn each do not tell higher harmonics from each other.
    tried = [(effect, shape) for effect, shape in angle if shape.get("harmonic") not in _HIGHER_HARMONICS]
    if not (tried and rows.any()):
        return []
    laws, sets = _Laws(series), np.unique(series.set_index[rows], return_inverse=True)[1]
    return [_test(series, rows, sets, [laws.at(effect, shape)])[0] for effect, shape in tried]


def _with_intervals(
    laws: _Laws, series: Series, rows: NDArray[np.bool_], sets: Ints, found: list[Pattern]
) -> list[Pattern]:
    """The same with how well amplitudes and shapes are known.

    Where few sets carry most of a pattern, the scatter of the scores is too small a measure of its error. So here each set
    is left out in turn (jackknife); for the test the plain scatter serves, since its law is known.
    """
    if not found:
        return []
    candidates = [_Candidate(p.effect, p.shape, p.columns) for p in found]
    y, z = _centred(series, rows, sets, candidates)
    covariance = jackknife(y, z, sets)
    first, result = 0, []
    for pattern in found:
        own = slice(first, first + pattern.amplitudes.size)
        first = own.stop
        known = replace(pattern, covariance=covariance[own, own])
        effect = CATALOGUE[pattern.effect]
        if effect.search.refined:
            basis = np.linalg.qr(np.delete(z, np.arange(own.start, own.stop), axis=1))[0]

            def columns(shape: Mapping[str, float], effect: Effect = effect) -> Floats:
                return _centred(series, rows, sets, [laws.at(effect, shape)])[1]

            beside = _ShapeWithin(effect, columns, y - basis @ (basis.T @ y), basis)
            own_intervals, size = beside.intervals(known.shape, known.amplitudes, known.covariance, known.dof)
            known = replace(known, intervals=own_intervals, size=size)
        result.append(known)
    return result


def strange_turns(series: Series, level: float) -> list[Located]:
    """Patterns of the table angle that no law of the catalogue has: higher harmonics of one size at every rate.

    Parameters
    ----------
    series : less the patterns that have a name
    level : rate of false alarms over all harmonics together
    """
    rows = _usable(series)
    if series.angle_deg is None or not rows.any():
        return []
    c = conditions_of(series)
    sets = np.unique(series.set_index[rows], return_inverse=True)[1]
    candidates = []
    for k in _HIGHER_HARMONICS:
        turns = np.column_stack([c.turned(k, 0.0), c.turned(k, -0.5 * np.pi)])
        candidates.append(_Candidate("", {"harmonic": float(k)}, turns))
    places = []
    for candidate in candidates:
        (found,) = _test(series, rows, sets, [candidate])
        p = min(1.0, found.p_value * len(candidates))
        if p < level:
            rms = float(np.sqrt(np.mean(found.values**2)))
            follows = f"{found.shape['harmonic']:.0f} a turn"
            places.append(Located("table_angle", "mean", p, 1.0, True, target=follows, rms_dps=rms))
    return sorted(places, key=lambda place: place.p_value)


def kind_of(candidate: _Candidate | Pattern) -> tuple[str, tuple[tuple[str, float], ...]]:
    """What makes two candidates the same pattern: the effect, and of its shape what is not refined."""
    if CATALOGUE[candidate.effect].search.refined:
        return candidate.effect, ()
    return candidate.effect, tuple(candidate.shape.items())


def _refined(
    laws: _Laws,
    series: Series,
    rows: NDArray[np.bool_],
    sets: Ints,
    beside: list[_Candidate],
    candidate: _Candidate,
) -> _Candidate:
    """The same pattern with its shape between the points of the grid."""
    effect = CATALOGUE[candidate.effect]

    def gain(shape: Mapping[str, float]) -> float:
        return -_loss(series, rows, sets, [*beside, laws.at(effect, shape)])

    return laws.at(effect, refined(candidate.shape, effect.search.refined, gain))


def _usable(series: Series) -> NDArray[np.bool_]:
    return np.asarray(series.is_set & (not series.is_table), dtype=np.bool_)


def _tried(series: Series) -> list[tuple[Effect, Mapping[str, float]]]:
    """Laws of the catalogue that live within data sets, with every shape that is tried."""
    offer = offer_of(series)
    found: list[tuple[Effect, Mapping[str, float]]] = []
    for effect in CATALOGUE.values():
        if effect.seen_in not in _WITHIN or effect.search.twin_of or not effect.search.by_columns:
            continue
        if effect.why_not(offer) is None:
            found += [(effect, shape) for shape in effect.search.grid(offer)]
    return found


def _centred(
    series: Series, rows: NDArray[np.bool_], sets: Ints, candidates: list[_Candidate]
) -> tuple[Floats, Floats]:
    """Errors, and columns of all candidates, less the means of the sets, in units of white noise.

    Free, too, of what goes with the temperature within sets, on the bias and on the scale factor: where a chamber drifts,
    that is a straight line, and so is what creeps for longer than a set lasts.
    """
    weight = 1.0 / series.white_std_dps[rows] ** 2
    total = np.bincount(sets, weight)
    block = np.concatenate([c.columns[rows] for c in candidates], axis=1)
    temp_c, rate_dps = series.temp_c[rows], series.rate_dps[rows]
    block = np.column_stack([temp_c, temp_c * rate_dps, series.gyro_dps[rows] - rate_dps, block])
    means = np.column_stack([np.bincount(sets, weight * x) / total for x in block.T])
    warming, block = np.split((block - means[sets]) * np.sqrt(weight)[:, None], [2], axis=1)
    block = block - warming @ np.linalg.lstsq(warming, block, rcond=1e-10)[0]
    return block[:, 0], block[:, 1:]


def _loss(series: Series, rows: NDArray[np.bool_], sets: Ints, candidates: list[_Candidate]) -> float:
    """Bayesian information criterion of least squares within sets, half of it, nats."""
    y, z = _centred(series, rows, sets, candidates)
    left = y - z @ np.linalg.lstsq(z, y, rcond=1e-10)[0]
    return 0.5 * float(y.size * np.log(np.sum(left**2)) + z.shape[1] * np.log(y.size))


def _test(series: Series, rows: NDArray[np.bool_], sets: Ints, candidates: list[_Candidate]) -> list[Pattern]:
    """Least squares within sets; each candidate's p-value given the others, by Hotelling's law over the sets."""
    y, z = _centred(series, rows, sets, candidates)
    sizes = [c.columns.shape[1] for c in candidates]
    bread = np.linalg.pinv(z.T @ z, rcond=1e-10, hermitian=True)
    b = bread @ (z.T @ y)
    left = y - z @ b
    score = np.column_stack([np.bincount(sets, x * left) for x in z.T])
    covariance = bread @ (score.T @ score) @ bread
    found, first = [], 0
    for candidate, size in zip(candidates, sizes, strict=True):
        own = slice(first, first + size)
        first += size
        used = _effective_sets(z[:, own], sets)
        v = covariance[own, own] * used / max(used - size, 1.0)
        dof = used - size
        t2 = float(b[own] @ np.linalg.pinv(v, rcond=1e-10, hermitian=True) @ b[own])
        p = hotelling_p_value(t2, used, size) if dof > 0.0 else 1.0
        found.append(
            Pattern(candidate.effect, candidate.shape, candidate.columns, b[own], v, p, max(dof, 1.0))
        )
    return found


def jackknife(y: Floats, z: Floats, sets: Ints) -> Floats:
    """Covariance of least-squares coefficients from leaving out each set in turn."""
    size = z.shape[1]
    bread = np.linalg.pinv(z.T @ z, rcond=1e-10, hermitian=True)
    left = y - z @ (bread @ (z.T @ y))
    score = np.column_stack([np.bincount(sets, x * left) for x in z.T])
    each = np.column_stack([np.bincount(sets, x * w) for x in z.T for w in z.T]).reshape(-1, size, size)
    moved = np.linalg.pinv(np.eye(size) - each @ bread, rcond=1e-6) @ score[:, :, None]
    change = moved[:, :, 0] @ bread
    return np.asarray((len(score) - 1.0) / len(score) * change.T @ change)


def _effective_sets(z: Floats, sets: Ints) -> float:
    """How many sets of equal weight would tell as much of these columns: fewer than there are, where few carry most.

    The degrees of freedom of the scatter go by this number (Bell and McCaffrey, Survey Methodology 28, 2002).
    """
    each = np.column_stack([np.bincount(sets, x * y) for x in z.T for y in z.T])
    share = each @ np.linalg.pinv(z.T @ z, rcond=1e-10, hermitian=True).ravel()
    return float(np.sum(share)) ** 2 / max(float(np.sum(share**2)), 1e-30)


@dataclass(frozen=True)
class _ShapeWithin:
    """A pattern beside the others that were found: how well it does at any shape, and how far it may be from there.

    Attributes
    ----------
    columns : callable
        Columns at a shape, freed of the means of the sets, weighted by the white noise.
    left, others : ndarray, shape (rows,), (rows, q)
        What the other patterns leave of the record, and an orthonormal basis of them.
    inflation : float
        Variance of the amplitude from the scatter between sets, over that of white noise.
    """

    effect: Effect
    columns: Callable[[Mapping[str, float]], Floats]
    left: Floats
    others: Floats
    inflation: float = 1.0

    def at(self, shape: Mapping[str, float]) -> Point:
        """At a shape; of two amplitudes their size counts."""
        x = self.columns(shape)
        x = x - self.others @ (self.others.T @ x)
        covariance = np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
        b = covariance @ (x.T @ self.left)
        size = float(np.linalg.norm(b)) if b.size > 1 else float(b[0])
        along = b / size if size else np.ones(b.size)
        std = float(np.sqrt(self.inflation * along @ covariance @ along))
        return Point(-float(b @ x.T @ self.left) / self.inflation, size, std or float("inf"))

    def intervals(
        self, shape: Mapping[str, float], amplitudes: Floats, covariance: Floats, dof: float
    ) -> tuple[dict[str, Interval], Interval]:
        """Of each parameter of the shape, and of the amplitude, which is traded against them.

        Parameters
        ----------
        amplitudes, covariance, dof : at `shape`, from the scatter between the sets
        """
        along = amplitudes / np.linalg.norm(amplitudes)
        std = float(np.sqrt(along @ covariance @ along)) * float(student.ppf(0.975, dof)) / NORMAL_95
        beside = replace(self, inflation=(std / self.at(shape).std) ** 2)
        found, points = {}, [beside.at(shape)]
        for name in beside.free(shape):
            known = self.effect.parameter(name)
            loss = partial(beside._loss, shape, name)
            found[name] = profile_interval(loss, shape[name], (known.low, known.high))
            points += [beside.at({**shape, name: float(x)}) for x in shapes_within(found[name])]
        return found, amplitude_interval(points)

    def free(self, shape: Mapping[str, float]) -> list[str]:
        """Parameters that are refined."""
        return [n for n in self.effect.search.refined if shape.get(n, 0.0) > 0.0]

    def _loss(self, shape: Mapping[str, float], name: str, value: float) -> float:
        return self.at({**shape, name: value}).loss
