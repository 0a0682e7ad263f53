"""Parts of the noise from Allan variances: how large each is, how well that is known, and whether the model fits.

``avar(tau) = c_q/tau^2 + N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3``   (IEEE Std 952, annex C)

with angle random walk N, bias instability B and rate random walk K. ``c_q`` is ``3 Q^2`` for quantisation of the angle.
It is also what any memory of the sensor leaves at averaging times beyond that memory: the angle's variance grows as
``N^2 t - c0``, and avar is ``N^2/tau - 1.5 c0/tau^2`` exactly. The part is then negative. A low-pass of first order and
time constant T has ``c0 = N^2 T`` and ``N^2 t - c0 (1 - exp(-t/T))`` where the samples are means over dt, which is taken for
the transition; where they are points of the filter's output, ``c0 = N^2 dt / sinh(dt/T)``, so that a filter that is fast
against dt lasts longer than its c0 says. Averaging times near to either, and those that do not fit, are left out.

Allan variances at different averaging times share samples. Their logarithms are taken for normal with the covariance
that the fitted noise gives them (`allan.covariance_parts`); intervals are profile likelihoods, and what is left at the
best fit is chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, special, stats

from gyrocal.inference.allan import POWERS, AllanCurve, covariance_parts

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: ``avar`` of a flat part over B^2.
FLICKER = 2.0 * np.log(2.0) / np.pi
#: A model is taken to fit where one so far off would come by chance more often than this.
LACK_OF_FIT = 0.01
#: Of all intervals.
_LEVEL = 0.95
#: Averaging times beyond the four terms that a test of fit needs.
_LEAST_SPARE = 2
#: Averaging times shorter than this many time constants show the filter's order, not the noise: at 2 a filter that
#: differs by 5 % from the one assumed biases the angle random walk by 3 % without a misfit to be seen.
_MEMORIES = 4.0
#: Standard deviations from which on a value lies above a model.
_SURELY = 3.0
#: Covariance and memory are those of the noise being fitted: so many rounds settle them to the third digit.
_ROUNDS = 6
#: Share of the curve below which a part is not there, and above which no part can be.
_LEAST, _MOST = 1e-12, 1e3


@dataclass(frozen=True)
class Part:
    """One coefficient of the model in (deg/s)^2 and seconds, with its 95 % interval; `low` is 0 where it may be absent."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class NoiseModel:
    """The model fitted to one or more curves.

    Attributes
    ----------
    coefficients : ndarray, shape (4,)
        ``c_q``, ``N^2``, ``(2 ln 2/pi) B^2``, ``K^2/3`` in (deg/s)^2 and seconds; the first may be negative.
    parts : tuple of Part
        The same with intervals.
    memory_s : float
        Time constant of the sensor's memory; 0 where there is none.
    used : ndarray of bool, shape (m,)
        Averaging times of all curves together that the fit rests on.
    dof : ndarray, shape (m,)
        Degrees of freedom of each Allan variance under the fitted noise.
    misfit : ndarray, shape (m,)
        How far each value is from what the used ones predict for it, in standard deviations.
    p_value : float
        Of a misfit this large over the used averaging times, if the model is right.
    """

    coefficients: Floats
    parts: tuple[Part, ...]
    memory_s: float
    used: Mask
    dof: Floats
    misfit: Floats
    p_value: float

    @property
    def fits(self) -> bool:
        """Whether there is a stretch of averaging times that the model describes."""
        return self.p_value >= LACK_OF_FIT

    def avar(self, tau_s: Floats) -> Floats:
        """Allan variance of the model, (deg/s)^2."""
        return np.asarray(_columns(tau_s, self.memory_s) @ self.coefficients)


@dataclass(frozen=True)
class _Logs:
    """Logarithms of Allan variances under a noise: expected offset, covariance's root, degrees of freedom."""

    offset: Floats
    covariance: Floats
    dof: Floats


@dataclass(frozen=True)
class _Best:
    """Coefficients of least cost, and the memory that the first of them was given."""

    coefficients: Floats
    memory_s: float
    cost: float


def fit_noise(curves: Sequence[AllanCurve]) -> NoiseModel | None:
    """Fit the model to curves of one noise (one for each sample time); None where there are too few averaging times.

    Averaging times are left out, the shortest first, until what is left passes the test of fit; if none such are
    left, also the longest. The longest stretch that passes is used, but for one that leaves out the floor of the curve as noise
    that it has not: a sensor's memory takes noise away on the short side and adds none, so that what rises from such a floor, as
    an output that follows the temperature does, is something else.
    """
    tau = np.concatenate([c.tau_s for c in curves]) if curves else np.empty(0)
    avar = np.concatenate([c.avar for c in curves]) if curves else np.empty(0)
    order = np.argsort(tau, kind="stable")
    least = len(POWERS) + _LEAST_SPARE
    if tau.size < least or not np.all(avar > 0):
        return None
    size = np.cumsum([0] + [c.factor.size for c in curves])
    parts = np.zeros((tau.size, tau.size, 4, 4))
    for curve, a, b in zip(curves, size[:-1], size[1:], strict=True):
        parts[a:b, a:b] = covariance_parts(curve)
    data = _Data(tau, avar, parts, np.concatenate([np.full(c.factor.size, c.dt_s) for c in curves]))
    best: tuple[float, Mask] | None = None
    for length in range(tau.size, least - 1, -1):
        # Of stretches as long as one another the one without the shortest averaging times comes first.
        for first in range(tau.size - length, -1, -1):
            used = np.zeros(tau.size, dtype=np.bool_)
            used[order[first : first + length]] = True
            p_value = data.settle(used)[2]
            if p_value >= LACK_OF_FIT and data.misses_the_floor(order[:first], used):
                continue
            if best is None or p_value > best[0]:
                best = p_value, used
            if p_value >= LACK_OF_FIT:
                return data.model(data.beyond_memory(data.off_the_bend(used, first)))
    return None if best is None else data.model(best[1])


@dataclass(frozen=True)
class _Data:
    """Allan variances at averaging times, shape (m,), the parts of their covariance, and the sample times."""

    tau_s: Floats
    avar: Floats
    parts: Floats
    dt_s: Floats

    def logs(self, coefficients: Floats) -> _Logs:
        """Law of the logarithms, if the noise is that of `coefficients`."""
        # A sensor's memory, not white angle noise, makes the first part negative: it adds no fluctuation of its own.
        c = np.maximum(coefficients, 0.0)
        expected = _powers(self.tau_s) @ c
        relative = np.einsum("abkl,k,l->ab", self.parts, c, c, optimize=True) / np.outer(expected, expected)
        dof = 2.0 / np.diag(relative)
        spread = special.polygamma(1, 0.5 * dof)
        scale = np.sqrt(spread / np.diag(relative))
        offset = special.digamma(0.5 * dof) - np.log(0.5 * dof)
        return _Logs(offset, relative * np.outer(scale, scale), dof)

    def best(
        self, used: Mask, logs: _Logs, start: Floats, memory_s: float, fixed: tuple[int, float] | None = None
    ) -> _Best:
        """Coefficients of least cost at the averaging times `used`; one may be `fixed`."""
        powers, avar = _columns(self.tau_s[used], memory_s), self.avar[used]
        root = linalg.cholesky(logs.covariance[np.ix_(used, used)], lower=True)
        target = np.log(avar) - logs.offset[used]
        unit = (avar[:, None] / powers).min(axis=0)
        index = np.arange(4) if fixed is None else np.delete(np.arange(4), fixed[0])
        base = np.zeros(4)
        if fixed is not None:
            base[fixed[0]] = fixed[1]

        def coefficients(x: Floats) -> Floats:
            c = base.copy()
            c[index] = x * unit[index]
            return c

        def residual(x: Floats) -> Floats:
            expected = np.maximum(powers @ coefficients(x), _LEAST * avar)
            return np.asarray(linalg.solve_triangular(root, target - np.log(expected), lower=True))

        def slope(x: Floats) -> Floats:
            expected = np.maximum(powers @ coefficients(x), _LEAST * avar)
            return np.asarray(
                linalg.solve_triangular(root, -powers[:, index] * unit[index] / expected[:, None], lower=True)
            )

        low = np.where(index == 0, -_MOST, 0.0)
        found = optimize.least_squares(
            residual,
            np.clip(start[index] / unit[index], low + _LEAST, _MOST),
            slope,
            bounds=(low, np.full(index.size, 2.0 * _MOST)),
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-10,
            x_scale="jac",
        )
        return _Best(coefficients(found.x), memory_s, 2.0 * float(found.cost))

    def settle(self, used: Mask) -> tuple[_Best, _Logs, float]:
        """Best coefficients with the covariance that they give themselves, and the p-value of the misfit."""
        powers, avar = _powers(self.tau_s[used]), self.avar[used]
        c = optimize.nnls(powers / avar[:, None], np.ones(avar.size))[0]
        for _ in range(_ROUNDS):
            logs = self.logs(c)
            best = self.best(used, logs, c, _memory(c))
            c = best.coefficients
        free = np.count_nonzero(c[1:] > 1e-6 * (avar[:, None] / powers[:, 1:]).min(axis=0)) + 1
        return best, logs, float(stats.chi2.sf(best.cost, int(used.sum()) - free))

    def off_the_bend(self, used: Mask, left_out: int) -> Mask:
        """All but the shortest averaging time, where `left_out` shorter ones do not fit.

        What bends those bends the next one too, only not enough to be seen: a filter that rings has a memory in the sense
        of this model that is far shorter than its ringing.
        """
        longer = used & (self.tau_s > self.tau_s[used].min())
        return longer if left_out and longer.sum() >= len(POWERS) + _LEAST_SPARE else used

    def beyond_memory(self, used: Mask) -> Mask:
        """Those of the averaging times that are long against the sensor's memory as the fit to them says it.

        Nearer to it the model still bends its other parts to what it cannot describe, without a misfit to be seen.
        """
        while True:
            memory_s = self.settle(used)[0].memory_s
            longer = used & (self.tau_s > _MEMORIES * _of_points(memory_s, self.dt_s))
            if longer.sum() < len(POWERS) + _LEAST_SPARE or np.array_equal(longer, used):
                return used
            used = longer

    def misses_the_floor(self, left_out: Ints, used: Mask) -> bool:
        """Whether the least variance is at a shorter averaging time, left out, and the model has surely less noise there."""
        if left_out.size == 0 or self.avar[left_out].min() >= self.avar[used].min():
            return False
        best, logs, _ = self.settle(used)
        return bool(self._misfit(logs, best)[left_out[np.argmin(self.avar[left_out])]] > _SURELY)

    def model(self, used: Mask) -> NoiseModel:
        """The model with its intervals."""
        best, logs, p_value = self.settle(used)
        return NoiseModel(
            coefficients=best.coefficients,
            parts=tuple(self._interval(used, logs, best, k) for k in range(4)),
            memory_s=best.memory_s,
            used=used,
            dof=logs.dof,
            misfit=self._misfit(logs, best),
            p_value=p_value,
        )

    def _interval(self, used: Mask, logs: _Logs, best: _Best, k: int) -> Part:
        """Profile interval of one coefficient."""
        # The covariance is held at the best fit, which makes a chi-square rise cover 91 to 93 % (coverage test of this
        # module); that of Student's law with the averaging times to spare covers what it says.
        rise = float(stats.f.ppf(_LEVEL, 1, int(used.sum()) - len(POWERS)))
        value = float(best.coefficients[k])
        unit = float((self.avar[used] / _powers(self.tau_s[used])[:, k]).min())

        def excess(x: float) -> float:
            return self.best(used, logs, best.coefficients, best.memory_s, (k, x)).cost - best.cost - rise

        def end(sign: float) -> float:
            step = max(abs(value), 1e-3 * unit) * 0.1
            inner = value
            for _ in range(60):
                outer = value + sign * step
                if k > 0 and outer <= 0.0:
                    if excess(0.0) <= 0.0:
                        return 0.0
                    outer = 0.0
                if outer > _MOST * unit:
                    return float(np.inf)
                if excess(outer) > 0.0:
                    return float(
                        optimize.brentq(excess, inner, outer, xtol=1e-4 * max(abs(value), 1e-6 * unit))
                    )
                inner, step = outer, 2.0 * step
            return float(sign * np.inf)

        return Part(value, end(-1.0), end(1.0))

    def _misfit(self, logs: _Logs, best: _Best) -> Floats:
        columns = _columns(self.tau_s, best.memory_s)
        expected = np.maximum(columns @ best.coefficients, _LEAST * self.avar)
        off = np.log(self.avar / expected) - logs.offset
        return np.asarray(off / np.sqrt(np.diag(logs.covariance)))


def _powers(tau_s: Floats) -> Floats:
    tau = np.asarray(tau_s, dtype=np.float64)
    return np.stack([tau ** float(p) for p in POWERS], axis=-1)


def _memory(coefficients: Floats) -> float:
    """Time constant of a first-order low-pass with these coefficients, s."""
    quantised, white = float(coefficients[0]), float(coefficients[1])
    return -quantised / (1.5 * white) if quantised < 0.0 < white else 0.0


def _of_points(memory_s: float, dt_s: Floats) -> Floats:
    """Time constant of a low-pass with this `memory_s` whose output is sampled at points: the longer of the two."""
    return dt_s / np.arcsinh(dt_s / memory_s) if memory_s > 0.0 else np.zeros_like(dt_s)


def _columns(tau_s: Floats, memory_s: float) -> Floats:
    """Allan variance of each part with coefficient one, shape (m, 4)."""
    columns = _powers(tau_s)
    if memory_s > 0.0:
        x = np.asarray(tau_s) / memory_s
        columns[..., 0] *= (4.0 * -np.expm1(-x) + np.expm1(-2.0 * x)) / 3.0
    return columns
