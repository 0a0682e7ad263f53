"""What rounding does to means of samples whose noise carries them over few steps of the output."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import special

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

#: Fewest samples and distinct values that tell a lattice, and the share of their distances that lie on it.
_LATTICE_SAMPLES, _LATTICE_VALUES, _ON_LATTICE = 50, 5, 0.98
#: Fewer values tell one where each comes so often on average, as no continuous value does.
_OFTEN_EACH = 50
#: Steps between values from which the step is found, nearer ones first.
_REACHES = (8.0, 64.0, 512.0)
#: Share of means that stand where the one before stood, from which on these tell the steps of what was read.
_STANDING = 0.3
#: Places that stand so often tell a step that all of them are multiples of, and the least of such steps.
_OFTEN, _DIGIT = 3, 0.01
#: Means in which a reading went from one step to the next, as a share of all, at the most.
_BETWEEN = 0.3
#: A distance lies on the lattice within this share of a step, and within what files round to, deg/s; the least step that
#: can be told from that rounding.
_OFF_LATTICE, _ROUNDED, _LEAST_LATTICE = 0.02, 2e-6, 5e-6
#: Distances up to this many times the least are one step; of less than this share of the rounding they are none.
_ONE_STEP, _NO_STEP = 1.5, 0.1
#: Noise in steps that is tried; above, rounding does nothing to a mean.
_NOISES = np.geomspace(0.02, 2.0, 60)
#: Places of a mean between two steps that are tried.
_PLACES = np.linspace(-1.0, 1.0, 81)
#: Steps to either side that noise may carry an output over; with more it knows of none.
_EDGES = 20
#: Steps that come less often than this may be spikes, or the end of a movement, and would be taken for noise.
_LEAST_SHARE = 0.02
#: An output of more values than this has noise enough to carry it over its steps.
_FEW_VALUES = 64
#: Where values come less often than this on average, they are no steps.
_AGAIN = 2
#: Sample times that differ by less than this factor are one.
_SAME_TIME = 1.5
#: Fall of the log-likelihood at a bound that holds with 95 % (half of chi-square's 90 % with one degree of freedom).
_FALL = 1.3528


def lattice(values: Floats) -> float | None:
    """Step of the lattice that values lie on; None where they are as good as continuous.

    The candidate is the least distance between distinct values; at least 98 % of all distances must be whole
    multiples of it, which continuous values would not do by chance.
    """
    distinct = np.unique(np.round(values, 9))
    fewest = 2 if values.size >= _OFTEN_EACH * distinct.size else _LATTICE_VALUES
    if distinct.size < fewest or values.size < _LATTICE_SAMPLES:
        return None
    gaps = np.diff(distinct)
    gaps = gaps[gaps > _NO_STEP * _ROUNDED]
    if gaps.size < fewest - 1:
        return None
    small = float(np.median(gaps[gaps < _ONE_STEP * gaps.min()]))
    # Files round the step as well: what that leaves open of it adds up over many steps.
    for reach in _REACHES:
        near = gaps[gaps < reach * small]
        small = float(np.sum(near) / np.sum(np.round(near / small)))
    multiples = gaps / small
    off = np.abs(multiples - np.round(multiples))
    if np.mean(off < _OFF_LATTICE + _ROUNDED / small) < _ON_LATTICE or small < _LEAST_LATTICE:
        return None
    return float(np.sum(gaps) / np.sum(np.round(multiples)))


def lattice_of_few(values: Floats) -> float | None:
    """Step of the lattice that all of a few values lie on, as any few with digits in common do; None of none."""
    return lattice(np.tile(values, 1 + _LATTICE_SAMPLES // values.size))


def lattice_of_means(values: Floats) -> float | None:
    """Step of the lattice that means of a few readings lie on, but for those during which the readings went to the next step.

    Means have finer steps than what they are means of. What stands twice in a row was read on one step all the time.
    """
    fine = lattice(values)
    standing = values[1:][np.diff(values) == 0.0]
    if standing.size < max(_STANDING * values.size, _LATTICE_VALUES):
        return fine
    # A mean in which one reading of a hundred was on the next step may stand, too.
    stands = lattice_of_few(standing) or 0.0
    return max(stands, _divisor(values, standing), fine or 0.0) or None


def _divisor(values: Floats, standing: Floats) -> float:
    """The largest step of which all values that stand often are multiples: of few places their distances tell none; 0 of too few.

    Two tell it where it is what they are apart: any two numbers have some divisor in common. Where many others lie between,
    as on ramps, places that stand are set points.
    """
    places, times = np.unique(np.round(standing / _DIGIT), return_counts=True)
    often = places[times >= _OFTEN].astype(np.int64).tolist()
    divisor = math.gcd(*often) if len(often) > 1 else 0
    if not divisor or (len(often) == 2 and divisor != often[1] - often[0]):
        return 0.0
    between = np.abs(np.remainder(values / _DIGIT + 0.5 * divisor, divisor) - 0.5 * divisor) > 0.5
    return _DIGIT * divisor if float(np.mean(between)) <= _BETWEEN else 0.0


@dataclass
class StepCounts:
    """Steps of an output and how often each of its values comes, of samples as they are read.

    Of a record of samples and of means of them, those of the shortest sample time count: means have finer steps.

    Attributes
    ----------
    step : float
        Least step, in the unit of the output; infinite where it does not move.
    values : dict of int to Counter
        By the segment that they come in, each of a mean of its own; not counted further where they are many.
    """

    dt_s: float = np.inf
    step: float = np.inf
    values: dict[int, Counter[float]] = field(default_factory=dict)

    def add(self, segment: int, output: Floats, dt_s: float) -> None:
        """Samples in a row, shape (n,), `dt_s` apart."""
        if dt_s > _SAME_TIME * self.dt_s:
            return
        if dt_s * _SAME_TIME < self.dt_s:
            self.dt_s, self.step, self.values = dt_s, np.inf, {}
        moved = np.abs(np.diff(output))
        self.step = float(np.min(moved, where=moved > 0.0, initial=self.step))
        if self._countable:
            values, counts = np.unique(output, return_counts=True)
            counted = dict(zip(values.tolist(), counts.tolist(), strict=True))
            self.values.setdefault(segment, Counter()).update(counted)

    @property
    def few(self) -> bool:
        """Whether the values are so few that steps may hide the noise: of a record of a few rows each may come once."""
        distinct = sum(len(counted) for counted in self.values.values())
        return (
            self._countable and sum(counted.total() for counted in self.values.values()) >= _AGAIN * distinct
        )

    @property
    def _countable(self) -> bool:
        return all(len(counted) <= _FEW_VALUES for counted in self.values.values())

    def least_noise(self) -> float:
        """`least_noise` of all that was counted."""
        records = [
            (np.array(sorted(counted)), np.array([counted[value] for value in sorted(counted)]))
            for counted in self.values.values()
        ]
        return least_noise(records, self.step)


def least_noise(records: Sequence[tuple[Floats, Counts]], step: float) -> float:
    """The least noise, in the unit of `step`, that records rounded to steps can have with 95 %.

    The scatter of the samples does not say it: of a mean halfway between two steps they toggle, whatever the noise. How
    often which step comes does, by the likelihood of a normal about a mean of each record's own; of two steps, nothing is
    said.

    Parameters
    ----------
    records : values that come in each record, ascending, and how often they do
    """
    log = np.zeros(_NOISES.size)
    for values, counts in records:
        often = counts >= _LEAST_SHARE * counts.sum()
        levels, counts = np.round((values[often] - values[0]) / step), counts[often]
        if levels.size > 2:
            places = _PLACES + np.average(levels, weights=counts)
            edges = (levels[:, None, None] - 0.5 - places[:, None]) / _NOISES
            # The lower tail keeps its digits where the upper one is one.
            low = np.minimum(edges, -edges - 1.0 / _NOISES)
            share = np.maximum(special.ndtr(low + 1.0 / _NOISES) - special.ndtr(low), 1e-300)
            log += np.max(np.tensordot(counts, np.log(share / share.sum(axis=0)), axes=1), axis=0)
    if not log.any():
        return 0.0
    # One less than the first that may be, since it lies between the two.
    first = int(np.flatnonzero(log >= log.max() - _FALL)[0])
    return step * float(_NOISES[max(first - 1, 0)])


def mean_error(step: float, scatter: float) -> float:
    """How far the mean of many rounded samples may be off, wherever between two steps it is: all that noise leaves of half a step."""
    return step * float(np.max(np.abs(_off_steps(step, scatter))))


def mean_error_std(step: float, scatter: float) -> float:
    """How far the mean of many rounded samples is off, rms over where between two steps it may be."""
    return step * float(np.sqrt(np.mean(_off_steps(step, scatter) ** 2)))


def _off_steps(step: float, scatter: float) -> Floats:
    """What rounding adds to means, in steps, at places from one step to halfway to the next."""
    noise, place = _noise_steps(step, scatter), np.linspace(0.0, 0.5, _PLACES.size)
    if noise == 0.0:
        return -place
    edges = np.arange(_EDGES) + 0.5
    up, down = (special.ndtr((x[:, None] - edges) / noise).sum(axis=1) for x in (place, -place))
    return np.asarray(up - down - place)


def harmonic(step: float, scatter: float, order: int = 1) -> float:
    """Size of a harmonic of what rounding does to means, over where between two steps they are."""
    noise = _noise_steps(step, scatter)
    return step / (math.pi * order) * math.exp(-2.0 * (math.pi * order * noise) ** 2)


def _noise_steps(step: float, scatter: float) -> float:
    """Noise in steps: the scatter of the samples has a twelfth of the square of a step in it, which is none of the noise's."""
    return math.sqrt(max((scatter / step) ** 2 - 1.0 / 12.0, 0.0))


def slope_error(step: float, scatter: float) -> float:
    """The share by which what is slow may come out too large or too small: the slope of the first harmonic."""
    return 2.0 * math.pi * harmonic(step, scatter) / step
