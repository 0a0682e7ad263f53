"""Noise figures from the record at rest: Allan deviation, angle random walk, bias instability.

Estimators of the Allan variance and their degrees of freedom are allantools'. Gaps and bad samples split a record
into pieces; no estimate bridges them, and the pieces' variances are pooled. The figures come from one model,

``avar(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3``   (IEEE 952, annex C)

with quantisation Q, angle random walk N, bias instability B and rate random walk K, by maximum likelihood of the
chi-square law of each estimate; intervals are profile likelihoods. A part that the record does not resolve is
None, never a number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import allantools
import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from gyrocal.calibration.datasets import Recording
from gyrocal.physics.surface import Surface
from gyrocal.records.run import Run, SegmentRecord
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPS_TO_DPH

Floats = NDArray[np.float64]
Interval = tuple[float, float, float]

_FLICKER = 2.0 * np.log(2.0) / np.pi
_SHORTEST_PIECE = 32
#: Longer segments are averaged down to about this many samples: memory stays flat.
_MOST_SAMPLES = 1 << 21
#: A step between samples beyond this many sample times is a gap.
_GAP = 1.5
#: An estimate over tau needs at least this many times tau of record.
_SPANS = 4


@dataclass(frozen=True)
class Piece:
    """Samples at rest without a gap: sample time (s) and output (deg/s), shape (n,)."""

    dt_s: float
    gyro_dps: Floats


@dataclass(frozen=True)
class AllanPoints:
    """Pooled Allan deviations of one sample time, shape (m,), with 95 % intervals and degrees of freedom."""

    dt_s: float
    tau_s: Floats
    adev_dps: Floats
    low_dps: Floats
    high_dps: Floats
    dof: Floats


@dataclass(frozen=True)
class NoiseFigures:
    """Noise at rest; each figure ``(value, low, high)`` with a 95 % interval, or None.

    Attributes
    ----------
    statement : str
        What the record says about bias instability, in words.
    model : ndarray, shape (4,), or None
        ``3 Q^2``, ``N^2``, ``(2 ln 2/pi) B^2``, ``K^2/3`` in (deg/s)^2 and seconds.
    """

    angle_random_walk_deg_per_rt_h: Interval | None
    bias_instability_deg_per_h: Interval | None
    statement: str
    points: tuple[AllanPoints, ...]
    model: Floats | None
    record_s: float

    def model_dps(self, tau_s: Floats) -> Floats:
        """Allan deviation of the fitted model, deg/s."""
        if self.model is None:
            return np.full(np.shape(tau_s), np.nan)
        return np.asarray(np.sqrt(_powers(tau_s) @ self.model))


def noise_figures(recording: Recording, surface: Surface | None = None) -> NoiseFigures:
    """Noise figures of a recording's segments at rest; `surface` removes what temperature does to the bias."""
    run = recording.run
    if run is None:
        return NoiseFigures(None, None, "a table of data sets holds no samples at rest", (), None, 0.0)
    pieces = [
        piece
        for record in run.segments
        if record.outcome != "failed" and record.kind in ("static", "rate") and record.rate_dps == 0.0
        for piece in pieces_of(run, record, surface)
    ]
    return allan_figures(pieces)


def pieces_of(run: Run, record: SegmentRecord, surface: Surface | None = None) -> list[Piece]:
    """The good samples of a segment, cut at every gap; a long one is averaged down as it is read."""
    average = max(1, -(-record.n // _MOST_SAMPLES))
    dt_s = record.averaging_s
    pieces: list[Piece] = []
    chunks: list[Floats] = []
    rest = np.empty(0)
    last_s = np.nan

    def close() -> None:
        whole = np.concatenate([*chunks, _averaged(rest, average)[0]]) if chunks or rest.size else rest
        if whole.size >= _SHORTEST_PIECE and dt_s is not None:
            pieces.append(Piece(dt_s * average, whole))
        chunks.clear()

    for block in run.iterate_segment(record):
        good = block.good
        t_s, gyro_dps = block.t_s[good], block.gyro_dps[good]
        if surface is not None:
            gyro_dps = gyro_dps - _bias_over_temperature(surface, block.gyro_temp_c[good], record.chamber_c)
        if t_s.size < 2:
            continue
        if dt_s is None:
            # Six digits: the last ones differ from segment to segment, and like samples belong together.
            dt_s = float(f"{np.median(np.diff(t_s)):.6g}")
        cuts = np.flatnonzero(np.diff(t_s, prepend=last_s) > _GAP * dt_s)
        for number, part in enumerate(np.split(gyro_dps, cuts)):
            if number:
                close()
                rest = np.empty(0)
            done, rest = _averaged(np.concatenate([rest, part]), average)
            chunks.append(done)
        last_s = float(t_s[-1])
    close()
    return pieces


def _bias_over_temperature(surface: Surface, temp_c: Floats, about_c: float) -> Floats:
    known = np.where(np.isfinite(temp_c), temp_c, about_c)
    return surface.error_dps(0.0, known) - surface.error_dps(0.0, about_c)


def _averaged(values: Floats, average: int) -> tuple[Floats, Floats]:
    """Means of `average` values in a row, and the values left over."""
    whole = values.size // average * average
    return values[:whole].reshape(-1, average).mean(axis=1), values[whole:]


def allan_figures(pieces: Sequence[Piece]) -> NoiseFigures:
    """Noise figures of gapless pieces."""
    record_s = float(sum(p.gyro_dps.size * p.dt_s for p in pieces))
    points = tuple(
        _pooled([p for p in pieces if p.dt_s == dt_s]) for dt_s in sorted({p.dt_s for p in pieces})
    )
    points = tuple(p for p in points if p.tau_s.size)
    if not points:
        return NoiseFigures(None, None, "no record at rest is long enough", (), None, record_s)
    tau, avar, dof = (
        np.concatenate(v) for v in zip(*((p.tau_s, p.adev_dps**2, p.dof) for p in points), strict=True)
    )
    if not np.all(avar > 0):
        return NoiseFigures(None, None, "the output at rest does not move at all", points, None, record_s)
    model, cost = _fit_model(tau, avar, dof, np.ones(4, dtype=np.bool_))
    arw = _profile(tau, avar, dof, 1, model, cost)
    flicker = _profile(tau, avar, dof, 2, model, cost)
    to_bias = DPS_TO_DPH / np.sqrt(_FLICKER)
    bias = None if flicker is None else tuple(float(np.sqrt(v) * to_bias) for v in flicker)
    walk = None if arw is None else tuple(float(np.sqrt(v) / DEG_PER_RT_H_TO_DPS_PER_RT_HZ) for v in arw)
    white_only = _fit_model(tau, avar, dof, np.array([True, True, False, False]))[1]
    seen = 2.0 * (white_only - cost) > stats.chi2.ppf(0.99, 2)
    return NoiseFigures(
        (walk[0], walk[1], walk[2]) if walk else None,
        (bias[0], bias[1], bias[2]) if bias else None,
        _statement(bias is not None, bool(seen), float(tau.max())),
        points,
        model,
        record_s,
    )


def _statement(separable: bool, seen: bool, longest_s: float) -> str:
    if separable:
        return f"resolved up to {longest_s:.0f} s"
    if seen:
        return f"seen but not separable from drift within {longest_s:.0f} s: record hours at rest (static_allan profile)"
    return f"not seen within {longest_s:.0f} s: record hours at rest (static_allan profile)"


def _pooled(pieces: Sequence[Piece]) -> AllanPoints:
    """Overlapping Allan variances at octaves, pooled over pieces by their degrees of freedom."""
    dt_s = pieces[0].dt_s
    sums: dict[int, tuple[float, float]] = {}
    for piece in pieces:
        octaves = [1 << k for k in range(40) if _SPANS << k <= piece.gyro_dps.size]
        # Removing the mean changes no Allan variance and keeps the digits of the running sums.
        centred = piece.gyro_dps - piece.gyro_dps.mean()
        taus, adev, _, _ = allantools.oadev(
            centred, rate=1.0 / dt_s, data_type="freq", taus=[m * dt_s for m in octaves]
        )
        for tau, deviation in zip(taus, adev, strict=True):
            m = round(tau / dt_s)
            dof = _degrees_of_freedom(m, piece.gyro_dps.size)
            total, weight = sums.get(m, (0.0, 0.0))
            sums[m] = (total + dof * deviation**2, weight + dof)
    ms = sorted(sums)
    freedom = np.array([sums[m][1] for m in ms])
    adev_dps = np.sqrt(np.array([sums[m][0] for m in ms]) / freedom)
    return AllanPoints(
        dt_s=dt_s,
        tau_s=np.array(ms) * dt_s,
        adev_dps=adev_dps,
        low_dps=adev_dps * np.sqrt(freedom / stats.chi2.ppf(0.975, freedom)),
        high_dps=adev_dps * np.sqrt(freedom / stats.chi2.ppf(0.025, freedom)),
        dof=freedom,
    )


def _degrees_of_freedom(m: int, size: int) -> float:
    """Of an overlapping Allan variance of white rate noise; with few spans flicker noise gives the same."""
    return max(float(allantools.edf_greenhall(0, 2, m, size + 1, overlapping=True, modified=False)), 1.0)


def _powers(tau_s: Floats) -> Floats:
    tau = np.asarray(tau_s, dtype=np.float64)
    return np.stack([tau**-2.0, tau**-1.0, np.ones_like(tau), tau], axis=-1)


def _fit_model(
    tau: Floats,
    avar: Floats,
    dof: Floats,
    free: NDArray[np.bool_],
    fixed: tuple[int, float] | None = None,
    near: Floats | None = None,
) -> tuple[Floats, float]:
    """Parts of the model by maximum likelihood, and minus the log-likelihood; parts not `free` are 0 or `fixed`."""
    powers = _powers(tau)
    largest = avar.max() / powers.max(axis=0)
    index = np.flatnonzero(free)
    base = np.zeros(4)
    if fixed is not None:
        base[fixed[0]] = fixed[1]
        index = index[index != fixed[0]]

    def cost(log_share: Floats) -> tuple[float, Floats]:
        model = base.copy()
        model[index] = largest[index] * np.exp(log_share)
        predicted = np.maximum(powers @ model, 1e-300)
        value = float(np.sum(0.5 * dof * (np.log(predicted) + avar / predicted)))
        slope = (0.5 * dof * (1.0 - avar / predicted) / predicted) @ powers
        return value, slope[index] * model[index]

    best: tuple[float, Floats] | None = None
    starts = [np.full(index.size, share) for share in (-2.0, -9.0)]
    if near is not None:
        starts = [np.log(np.clip(near[index] / largest[index], 1e-12, 10.0))]
    for start in starts:
        found = optimize.minimize(
            cost,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=[(-30.0, 3.0)] * index.size,
            options={"ftol": 1e-13, "gtol": 1e-9, "maxiter": 500},
        )
        if best is None or found.fun < best[0]:
            best = float(found.fun), found.x
    model = base.copy()
    if best is None:
        return model, np.inf
    model[index] = largest[index] * np.exp(best[1])
    return model, best[0]


def _profile(
    tau: Floats, avar: Floats, dof: Floats, part: int, model: Floats, cost: float
) -> Interval | None:
    """95 % profile-likelihood interval of one part of the model; None when it may as well be nothing.

    Estimates at neighbouring tau share samples; the threshold is widened by as much as that costs in variance.
    """
    free = np.ones(4, dtype=np.bool_)
    widening = _variance_ratio(tau, dof, model)[part]
    threshold = cost + 0.5 * widening * float(stats.chi2.ppf(0.95, 1))
    without = free.copy()
    without[part] = False
    if (
        not _fit_model(tau, avar, dof, without)[1] > threshold
        or not _fit_model(tau, avar, dof, without, None, model)[1] > threshold
    ):
        return None

    def excess(log_value: float) -> float:
        return float(_fit_model(tau, avar, dof, free, (part, float(np.exp(log_value))), model)[1] - threshold)

    center = float(np.log(model[part]))
    ends = []
    for sign in (-1.0, 1.0):
        step = 0.1
        while excess(center + sign * step) < 0:
            step *= 2.0
            if step > 20.0:
                return None
        ends.append(float(optimize.brentq(excess, center, center + sign * step, xtol=1e-3)))
    return float(model[part]), float(np.exp(ends[0])), float(np.exp(ends[1]))


def _variance_ratio(tau: Floats, dof: Floats, model: Floats) -> Floats:
    """Variance of each part's logarithm over what independent estimates would give (Godambe), shape (4,).

    The correlation of two Allan variances is that of their filtered squares,
    ``int |H_a|^2 |H_b|^2 S^2 df``, with ``|H|^2 = 2 sin^4(pi f tau) / (pi f tau)^2``.
    """
    # S(f), two-sided as in IEEE 952: 3 Q^2 -> (2 pi f)^2 Q^2, N^2, B^2 / (2 pi f), K^2 / (2 pi f)^2.
    f = np.geomspace(0.02 / tau.max(), 0.5 / tau.min(), 20000)
    w = 2.0 * np.pi * f
    density = (
        np.stack([w**2 * tau.min() / 3.0, np.ones_like(f), 1.0 / (w * _FLICKER), 3.0 / w**2], axis=1) @ model
    )
    gain = 2.0 * np.sin(np.pi * f * tau[:, None]) ** 4 / (np.pi * f * tau[:, None]) ** 2
    filtered = gain * density * np.sqrt(np.gradient(f))
    overlap = filtered @ filtered.T
    correlation = overlap / np.sqrt(np.outer(np.diag(overlap), np.diag(overlap)))
    slopes = _powers(tau) * model / (_powers(tau) @ model)[:, None]
    present = slopes.max(axis=0) > 1e-3
    d = slopes[:, present]
    independent = np.linalg.pinv(d.T @ (0.5 * dof[:, None] * d), hermitian=True)
    score = d.T @ (0.5 * np.sqrt(np.outer(dof, dof)) * correlation) @ d
    ratio = np.ones(4)
    actual = np.diag(independent @ score @ independent)
    ratio[present] = np.maximum(actual / np.maximum(np.diag(independent), 1e-300), 1.0)
    return ratio
