"""The smooth course of a quantity that is read with noise and in steps: a temperature through its thermometer.

The slope of the quantity walks at random (an integrated Wiener process, of which the course is a cubic spline); a
reading is the value with white noise, rounded to the steps of the instrument. How far the slope walks and how large the
noise is, follow from the readings by their evidence, after Laplace where they come in steps.

References
----------
Wecker and Ansley, J. Am. Stat. Assoc. 78 (1983): splines as processes.
Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), section 3.4: Laplace's approximation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize
from scipy.special import gammaln, log_ndtr

Floats = NDArray[np.float64]

#: Nodes of the course are this far apart at least, s, but there are some, and not many more than so many.
_NODE_S, _FEWEST_NODES, _MOST_NODES = 5.0, 3, 4000
#: Bounds of the noise: in degrees where there are no steps, else as a share of a step. Where readings are far apart what it
#: did between them is no less than that; where it was read all along, when it came to a step tells it.
_LEAST_NOISE, _LEAST_NOISE_STEPS, _LEAST_NOISE_ALL_ALONG = 1e-4, 0.05, 0.01
#: A pause between readings over which nothing is known: longer than this, s, and than so many usual ones.
_GAP_S, _GAP_STEPS = 60.0, 20.0
#: What is known of a slope, for each spacing, as a share of what a reading tells of its value.
_SLOPE_TOLD = 1e-6
#: Newton's steps at the most, and what the last may gain, nats.
_NEWTON, _SETTLED = 30, 1e-6
#: What is this near to a step, in steps, was read there.
_AT_STEP = 2e-6
#: Starts of the two levels: noise as a share of the scatter of neighbours, and spacings over which readings are weighed
#: together, with the least and the most of them.
_SHARES, _REACHES, _LEAST_REACH = (0.03, 0.3, 1.0), (1.0, 4.0, 16.0, 100.0), 0.3
#: First step of the simplex over the logarithms of the levels, and its steps at the most.
_FIRST_STEP, _ITERATIONS = 0.5, 80
#: Of the density of a standard normal.
_HALF_LOG_2PI = 0.5 * float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class _Readings:
    """Readings of the nodes: which node, what was read, how often; shape (m,) each."""

    node: NDArray[np.int64]
    value: Floats
    count: Floats
    step: float

    def terms(self, x: Floats, noise: float) -> tuple[float, Floats, Floats]:
        """Log-likelihood of the nodes' values, its slope and its negative curvature at each node."""
        at, sigma = x[self.node], noise
        if self.step == 0.0:
            z = (self.value - at) / sigma
            log_p = -0.5 * z**2 - np.log(sigma) - _HALF_LOG_2PI
            slope, curvature = z / sigma, np.full(z.size, sigma**-2)
        else:
            log_p, slope, curvature = _rounded((self.value - at) / sigma, self.step / sigma)
            slope, curvature = slope / sigma, curvature / sigma**2
        return float(self.count @ log_p), self.summed(slope, x.size), self.summed(curvature, x.size)

    def summed(self, each: Floats, nodes: int) -> Floats:
        """Sums over the readings of each node."""
        return np.bincount(self.node, self.count * each, nodes).astype(np.float64)


def _rounded(z: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Logarithm of the probability that a standard normal, rounded to `step`, is `z`; its slope and curvature by -z."""
    sign = np.where(z > 0.0, -1.0, 1.0)
    high, low = sign * z + 0.5 * step, sign * z - 0.5 * step
    log_high = log_ndtr(high)
    log_p = log_high + np.log1p(-np.exp(log_ndtr(low) - log_high))
    f_high, f_low = (np.exp(-0.5 * e**2 - _HALF_LOG_2PI - log_p) for e in (high, low))
    slope = f_low - f_high
    return log_p, sign * slope, slope**2 + high * f_high - low * f_low


@dataclass(frozen=True)
class Course:
    """Values and slopes at nodes, shape (k,), with the factor of their precision.

    Attributes
    ----------
    noise : float
        Standard deviation of a reading's white noise.
    run : ndarray, shape (k,)
        Number of the step that the node was read at, which nodes in a row share.
    room : ndarray, shape (k,)
        How little is known of where within that step the node is, standard deviation; 0 where it is not told apart.
    evidence : float
        Log density of the readings at the likeliest levels, nats: comparable between steps and counts of one series.
    """

    t_s: Floats
    value: Floats
    slope: Floats
    noise: float
    gap: NDArray[np.bool_]
    factor: Floats = field(repr=False)
    run: NDArray[np.int64]
    room: Floats
    evidence: float

    def at(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Value and slope at times, shape (n,) each; straight across a gap, and level beyond either end."""
        t = np.clip(t_s, self.t_s[0], self.t_s[-1])
        spline = CubicHermiteSpline(self.t_s, self.value, self.slope)
        k = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, self.gap.size - 1)
        straight = np.diff(self.value)[k] / np.diff(self.t_s)[k]
        across = self.gap[k]
        value = np.where(across, self.value[k] + straight * (t - self.t_s[k]), spline(t))
        return value, np.where(across, straight, spline(t, 1))

    def covariance(self, t_s: Floats) -> Floats:
        """Covariance of the values at times, shape (n, n)."""
        t = np.clip(t_s, self.t_s[0], self.t_s[-1])
        k = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, self.gap.size - 1)
        share = (t - self.t_s[k]) / np.diff(self.t_s)[k]
        pick = np.zeros((2 * self.t_s.size, t.size))
        rows = np.arange(t.size)
        pick[2 * k, rows] = 1.0 - share
        pick[2 * k + 2, rows] += share
        smooth = np.asarray(pick.T @ linalg.cho_solve_banded((self.factor, False), pick))
        # Where a course levels off it bends more than anywhere else: all that is known is which step it is on.
        unknown = np.sqrt(np.maximum(np.interp(t, self.t_s, self.room) ** 2 - np.diag(smooth), 0.0))
        nearest = np.rint(np.interp(t, self.t_s, np.arange(self.run.size))).astype(np.int64)
        run = self.run[nearest]
        return smooth + np.where(run[:, None] == run, np.outer(unknown, unknown), 0.0)


@dataclass
class _Field:
    """The nodes' values and slopes as a Gaussian Markov field, and the last course that was found.

    Attributes
    ----------
    alike : ndarray, shape (k,)
        How many nodes in a row read the same step: together they tell once that the value is within it.
    """

    readings: _Readings
    spacing: Floats
    gap: NDArray[np.bool_]
    last: Floats
    alike: Floats

    def prior(self, walk: float) -> Floats:
        """Upper bands of the precision, shape (4, 2 k); across a gap nothing is known."""
        h = self.spacing
        size = np.where(self.gap, 0.0, 1.0 / walk)
        n = h.size + 1
        bands = np.zeros((4, 2 * n))
        stiff, turn, own, other = 12.0 * size / h**3, 6.0 * size / h**2, 4.0 * size / h, 2.0 * size / h
        first, second = np.arange(n - 1) * 2, np.arange(1, n) * 2
        bands[3, first] += stiff
        bands[3, second] += stiff
        bands[3, first + 1] += own
        bands[3, second + 1] += own
        bands[2, first + 1] += turn
        bands[2, second + 1] -= turn
        bands[2, second] -= turn
        bands[1, second] -= stiff
        bands[1, second + 1] += other
        bands[0, second + 1] += turn
        return bands

    def settle(self, walk: float, noise: float) -> tuple[float, Floats, Floats]:
        """Log evidence, values and slopes (shape (2 k,)), and the factor of the precision."""
        prior = self.prior(walk)
        told = 1.0 / (noise**2 + self.readings.step**2 / 12.0)
        # A slope that nothing tells of is not known, and not infinite.
        prior[3, 1::2] += _SLOPE_TOLD * told
        x = self.last
        value, slope, curvature = self._loss(prior, x, noise)
        for _ in range(_NEWTON):
            precision = prior.copy()
            precision[3, ::2] += np.maximum(curvature, told / self.alike)
            factor = linalg.cholesky_banded(precision)
            step = linalg.cho_solve_banded((factor, False), -slope)
            size = 1.0
            while size > 1e-3:
                new = self._loss(prior, x + size * step, noise)
                if new[0] <= value:
                    break
                size *= 0.5
            done = value - new[0] < _SETTLED
            if new[0] <= value:
                x, (value, slope, curvature) = x + size * step, new
            if done:
                break
        links = np.count_nonzero(~self.gap)
        self.last = x
        return -value - float(np.sum(np.log(factor[3]))) - links * float(np.log(walk)), x, factor

    def _loss(self, prior: Floats, x: Floats, noise: float) -> tuple[float, Floats, Floats]:
        log_p, slope, curvature = self.readings.terms(x[::2], noise)
        bent = _times(prior, x)
        gradient = bent.copy()
        gradient[::2] -= slope
        return 0.5 * float(x @ bent) - log_p, gradient, curvature


def smooth_course(
    t_s: Floats, value: Floats, count: Floats, step: float, *, all_along: bool = False
) -> Course:
    """The course of a quantity from its readings.

    Parameters
    ----------
    t_s, value : ndarray, shape (m,)
        When it was read, in order, and what; a value between two steps is a mean of readings of either.
    count : ndarray, shape (m,)
        Of how many readings the value is a mean.
    step : float
        Steps of the instrument; 0: none.
    all_along : bool
        Whether it was read so often that when it came to a step, and how fast, is seen.
    """
    if np.ptp(t_s) == 0.0:
        # What was read at one instant is taken to stay.
        t_s = np.concatenate([t_s, t_s + _NODE_S])
        value, count = np.tile(value, 2), np.tile(count, 2)
    t, node = _nodes(t_s, count)
    readings = _stepped(_Readings(node, value, count, step))
    spacing = np.diff(t)
    typical = float(np.median(spacing))
    gap = spacing > max(_GAP_S, _GAP_STEPS * typical)
    total = np.bincount(node, count)
    mean = np.bincount(node, count * value) / total
    run = _runs(mean, step)
    # Counted in usual spacings, a slope is as large as a change of the value is: what the band's factor needs.
    rough = np.column_stack([mean, np.gradient(mean)]).ravel()
    alike = np.bincount(run)[run].astype(np.float64)
    found = _Field(readings, spacing / typical, gap, rough, alike)
    least = step * (_LEAST_NOISE_ALL_ALONG if all_along else _LEAST_NOISE_STEPS) or _LEAST_NOISE
    # Means of nodes scatter as less than single readings do.
    often = float(np.sqrt(np.median(total)))
    scatter = max(_scatter(mean) * often, 2.0 * least)
    farthest = min(_REACHES[-1], float(t.size))

    def levels(logs: Floats) -> tuple[float, float]:
        """How far the slope walks, and noise: of logarithms of the reach in spacings, and of the noise."""
        reach, own = np.exp(np.clip(logs, [np.log(_LEAST_REACH), np.log(least)], [np.log(farthest), np.inf]))
        return float((own**2 / often**2 + step**2 / 12.0) / reach**4), float(own)

    def loss(logs: Floats) -> float:
        return -found.settle(*levels(logs))[0]

    starts = [np.log([reach, max(share * scatter, least)]) for share in _SHARES for reach in _REACHES[:-1]]
    first = min(starts, key=loss)
    around = first + _FIRST_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    best = minimize(
        loss,
        first,
        method="Nelder-Mead",
        options={"maxiter": _ITERATIONS, "xatol": 0.02, "fatol": 0.05, "initial_simplex": around},
    )
    walk, noise = levels(best.x)
    _, x, factor = found.settle(walk, noise)
    nats = _whole_evidence(-float(best.fun), value, count, step)
    smooth = Course(t, x[::2], x[1::2] / typical, noise, gap, factor, run, np.zeros(t.size), nats)
    return _levelled(smooth, mean, step) if all_along and step else smooth


def _whole_evidence(of_steps: float, value: Floats, count: Floats, step: float) -> float:
    """Log density of means of readings, of that of the single readings in steps: in how many orders they make these means."""
    if step == 0.0:
        return of_steps
    high = _between(value, step)[1] * count
    orders = gammaln(count + 1.0) - gammaln(high + 1.0) - gammaln(count - high + 1.0)
    return of_steps + float(np.sum(orders + np.log(count / step)))


def _scatter(mean: Floats) -> float:
    """How far values scatter about a course, by how they bend from one to the next."""
    bends = np.diff(mean, 2)
    return float(np.linalg.norm(bends) / np.sqrt(6.0 * max(bends.size, 1)))


def _levelled(smooth: Course, mean: Floats, step: float) -> Course:
    """The course with what is not known within the steps: far from either end of one its middle errs least."""
    room = _room(smooth.t_s, smooth.slope, mean, smooth.run, step)
    deep = (np.sqrt(12.0) * room / step) ** 4
    shift = deep * (mean - smooth.value)
    slope = smooth.slope + np.gradient(shift, smooth.t_s)
    return replace(smooth, value=smooth.value + shift, slope=slope, room=room)


def _room(t_s: Floats, slope: Floats, mean: Floats, run: NDArray[np.int64], step: float) -> Floats:
    """How little is known of where within its step each node is, standard deviation, shape (k,).

    Since it came to a step, and until it leaves it, it goes no farther than the slope there takes it.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    came, left = first[run], np.append(first[1:], run.size)[run]
    inside = (came > 0) & (left < run.size)
    before, after = np.maximum(came - 1, 0), np.minimum(left, run.size - 1)
    speed = np.maximum(np.abs(slope), np.abs(np.roll(slope, -1)))
    since = np.where(came > 0, speed[before] * (t_s - t_s[before]), step)
    until = np.where(left < run.size, speed[after - 1] * (t_s[after] - t_s), step)
    width = np.minimum(np.minimum(since, until), step)
    # What it came through it had to go all the way.
    through = inside & ((mean[came] > mean[before]) == (mean[after] > mean[after - 1]))
    slack = np.where(through, np.maximum(since + until - step, 0.0), step)
    return np.asarray(np.minimum(width, slack) / np.sqrt(12.0))


def _nodes(t_s: Floats, count: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Times of the nodes, and the node of each reading."""
    steps = np.diff(t_s)
    # A pause needs no nodes.
    span = float(np.sum(np.minimum(steps, max(_GAP_S, _GAP_STEPS * float(np.median(steps))))))
    width = max(min(_NODE_S, span / _FEWEST_NODES), span / _MOST_NODES)
    node = np.unique((t_s - t_s[0]) // width, return_inverse=True)[1]
    return np.bincount(node, count * t_s) / np.bincount(node, count), node.astype(np.int64)


def _stepped(r: _Readings) -> _Readings:
    """Means of readings as the readings of the two steps that they lie between."""
    if r.step == 0.0:
        return r
    below, share = _between(r.value, r.step)
    value = np.concatenate([below, below + 1.0]) * r.step
    count = np.concatenate([(1.0 - share) * r.count, share * r.count])
    node, seen = np.tile(r.node, 2), count > 0.0
    return _Readings(node[seen], value[seen], count[seen], r.step)


def _between(value: Floats, step: float) -> tuple[Floats, Floats]:
    """The step below each value, counted from zero, and the share of the way to the next at which the value lies."""
    below = np.floor(value / step + _AT_STEP)
    share = np.clip(value / step - below, 0.0, 1.0)
    share[share < _AT_STEP] = 0.0
    return below, share


def _runs(mean: Floats, step: float) -> NDArray[np.int64]:
    """For each node the number of its run: nodes in a row at one step; by itself where readings are of two steps."""
    if step == 0.0:
        return np.arange(mean.size)
    here = mean / step
    between = np.abs(here - np.round(here)) > _AT_STEP
    alone = between | np.append(False, between[:-1])
    return np.asarray(np.cumsum((np.diff(np.round(here), prepend=np.nan) != 0.0) | alone) - 1)


def _times(bands: Floats, x: Floats) -> Floats:
    """Product of a symmetric matrix of upper bands with a vector."""
    out = bands[3] * x
    for k in (1, 2, 3):
        out[:-k] += bands[3 - k, k:] * x[k:]
        out[k:] += bands[3 - k, k:] * x[:-k]
    return np.asarray(out)
