"""Noise figures of a record at rest: one function for all who print them.

The Allan variance is taken as the samples are read (`inference.allan`), the figures come from a model whose fit is
tested (`inference.allan_model`). What temperature does to the bias is taken off first, by an ordinary fit to the same
recording, so that the figures are the recording's own whatever coefficients it is looked at with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from gyrocal.calibration.datasets import Recording, recording_of
from gyrocal.calibration.figure import Figure, Interval
from gyrocal.errors import DataError
from gyrocal.inference.allan import AllanCurve, AllanSums
from gyrocal.inference.allan_model import FLICKER, NoiseModel, Part, fit_noise
from gyrocal.records.run import Run, SegmentRecord
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPS_TO_DPH, p_equals

Floats = NDArray[np.float64]

#: Slope of the logarithm of the Allan deviation: that of a random walk is 0.5, and an octave of few values may show more.
_STEEPER_THAN_WALKS = 0.65
#: A step between samples beyond this many sample times is a gap.
_GAP = 1.5
#: Samples on either side by which a late one is told from a missing one.
_WINDOW = 33
#: The bias over temperature is taken off where the records at rest span as many degrees.
_LEAST_SPAN_C = 3.0
_TEMPERATURE_ORDER = 2

_METHOD = "fit to overlapping Allan variances and their covariance"


@dataclass(frozen=True)
class AllanPoints:
    """Allan deviations of one sample time, shape (m,), with 95 % intervals under the fitted noise.

    Attributes
    ----------
    dof : ndarray
        Degrees of freedom of each Allan variance.
    used : ndarray of bool
        Whether the figures rest on it.
    misfit : ndarray
        Distance from the model in standard deviations; NaN without a model.
    """

    dt_s: float
    tau_s: Floats
    adev_dps: Floats
    low_dps: Floats
    high_dps: Floats
    dof: Floats
    used: NDArray[np.bool_]
    misfit: Floats


@dataclass(frozen=True)
class NoiseFigures:
    """Noise at rest.

    Attributes
    ----------
    figures : mapping of str to Figure
        By name: ``angle_random_walk``, ``bias_instability``, ``rate_random_walk``, ``quantisation``, ``allan_floor``.
    statement : str
        What the record says about bias instability, in words.
    fit_statement : str
        How well the model fits, and which averaging times it rests on; empty where none fits.
    """

    figures: Mapping[str, Figure]
    statement: str
    fit_statement: str = ""
    points: tuple[AllanPoints, ...] = ()
    model: NoiseModel | None = field(default=None)
    record_s: float = 0.0

    @property
    def angle_random_walk_deg_per_rt_h(self) -> Interval | None:
        """Value and 95 % interval, or None."""
        return self.figures["angle_random_walk"].interval

    @property
    def bias_instability_deg_per_h(self) -> Interval | None:
        """Value and 95 % interval, or None."""
        return self.figures["bias_instability"].interval

    def model_dps(self, tau_s: Floats) -> Floats:
        """Allan deviation of the fitted model, deg/s; NaN without one or where it is none."""
        if self.model is None:
            return np.full(np.shape(tau_s), np.nan)
        avar = self.model.avar(tau_s)
        return np.sqrt(np.where(avar > 0, avar, np.nan))


#: Name, unit, definition, and the factor from the root of the model's coefficient to the figure.
_PARTS = (
    (
        "quantisation",
        "arcsec",
        "Q of the part 3 Q²/τ² of the Allan variance, less what a low-pass takes off it",
        3600.0 / np.sqrt(3.0),
    ),
    ("angle_random_walk", "deg/√h", "N of the part N²/τ", 1.0 / DEG_PER_RT_H_TO_DPS_PER_RT_HZ),
    ("bias_instability", "deg/h", "B of the flat part (2 ln 2/π) B²", DPS_TO_DPH / np.sqrt(FLICKER)),
    ("rate_random_walk", "deg/h/√h", "K of the part K² τ/3", 60.0 * DPS_TO_DPH * np.sqrt(3.0)),
)


def noise_figures(*recordings: Recording, at_rest: Sequence[Run] = ()) -> NoiseFigures:
    """Noise figures of the segments at rest of one recording, or of several of one gyro together.

    Parameters
    ----------
    at_rest : runs of the gyro that carry nothing else
    """
    sums: dict[float, AllanSums] = {}
    runs = [(r.run, bias_over_temperature(r)) for r in recordings if r.run is not None]
    runs += [(run, bias_at_rest(run)) for run in at_rest]
    if not runs:
        return _nothing("a table of data sets holds no samples at rest")
    for run, bias in runs:
        _add_run(sums, run, bias)
    return figures_of([sums[dt_s].curve() for dt_s in sorted(sums)])


def noise_at_rest(run: Run) -> NoiseFigures:
    """The same of a run of which nothing is read but its segments at rest."""
    return figures_of(curves_at_rest(run, bias_at_rest(run)))


def bias_at_rest(run: Run) -> Floats:
    """`bias_over_temperature` of a run's segments at rest; a constant where none of them is a data set."""
    still = replace(run, segments=tuple(r for r in run.segments if r.rate_dps == 0.0))
    try:
        return bias_over_temperature(recording_of(still))
    except DataError:
        return np.zeros(1)


def bias_over_temperature(recording: Recording) -> Floats:
    """Polynomial of the bias in °C, highest power first, from the data sets at rest; a constant where they do not say."""
    sets = recording.sets
    rest = sets.rate_dps == 0.0
    temp_c, error_dps = sets.temp_c[rest], sets.error_dps[rest]
    if temp_c.size <= _TEMPERATURE_ORDER + 1 or not np.ptp(temp_c) > _LEAST_SPAN_C:
        return np.zeros(1)
    order = min(_TEMPERATURE_ORDER, np.unique(np.round(temp_c)).size - 1)
    rising = np.polynomial.Polynomial.fit(temp_c, error_dps, order).convert().coef
    return np.asarray(rising[::-1], dtype=np.float64)


def curves_at_rest(run: Run, bias: Floats) -> list[AllanCurve]:
    """Allan curves of the segments at rest, one for each sample time; `bias` is taken off the output."""
    sums: dict[float, AllanSums] = {}
    _add_run(sums, run, bias)
    return [sums[dt_s].curve() for dt_s in sorted(sums)]


def _add_run(sums: dict[float, AllanSums], run: Run, bias: Floats) -> None:
    for record in run.segments:
        if record.outcome != "failed" and record.kind in ("static", "rate") and record.rate_dps == 0.0:
            _add_segment(sums, run, record, bias)


def _add_segment(sums: dict[float, AllanSums], run: Run, record: SegmentRecord, bias: Floats) -> None:
    """The good samples of a segment, cut at every gap."""
    dt_s, tail = record.averaging_s, np.empty(0)
    for block in run.iterate_segment(record):
        good = block.good
        t_s, gyro_dps, temp_c = block.t_s[good], block.gyro_dps[good], block.gyro_temp_c[good]
        if dt_s is None:
            if t_s.size < 2:
                continue
            # Six digits: the last ones differ from segment to segment, and like samples belong together.
            dt_s = float(f"{np.median(np.diff(t_s)):.6g}")
        total = sums.setdefault(dt_s, AllanSums(dt_s))
        known = np.where(np.isfinite(temp_c), temp_c, record.chamber_c)
        gyro_dps = gyro_dps - np.polyval(bias, known)
        cuts, tail = gaps(tail, t_s, dt_s)
        add_pieces(total, np.split(gyro_dps, cuts))
    if dt_s is not None and dt_s in sums:
        sums[dt_s].cut()


def gaps(tail: Floats, t_s: Floats, dt_s: float) -> tuple[NDArray[np.int64], Floats]:
    """Where samples are missing in `t_s`, shape (n,), that follow `tail`; and the tail for what follows.

    A host that is late with a sample and then catches up leaves no gap: the times of samples run from a missing one on
    behind those of a regular clock for good, which the earliest of the next and of the last samples show.
    """
    whole = np.concatenate([tail, t_s])
    behind = whole - dt_s * np.arange(whole.size)
    before = ndimage.minimum_filter1d(behind, _WINDOW, origin=_WINDOW // 2, mode="nearest")
    after = ndimage.minimum_filter1d(behind, _WINDOW, origin=-(_WINDOW // 2), mode="nearest")
    late = (np.diff(whole) > _GAP * dt_s) & (after[1:] - before[:-1] > 0.5 * _GAP * dt_s)
    cuts = [0]
    for i in (np.flatnonzero(late) + 1).tolist():
        # Behind a gap the times before it say nothing any more.
        if after[i] - behind[max(cuts[-1], i - _WINDOW) : i].min() > 0.5 * _GAP * dt_s:
            cuts.append(i)
    found = np.array(cuts[1:], dtype=np.int64) - tail.size
    return found[found >= 0], whole[-_WINDOW:]


def add_pieces(total: AllanSums, pieces: Iterable[Floats]) -> None:
    """Go on with the first piece, and begin anew with every other."""
    for number, piece in enumerate(pieces):
        if number:
            total.cut()
        total.add(piece)


def figures_of(curves: Sequence[AllanCurve]) -> NoiseFigures:
    """Noise figures of Allan curves in (deg/s)^2, one for each sample time."""
    record_s = sum(c.record_s for c in curves)
    curves = [c for c in curves if c.factor.size]
    if not curves:
        return _nothing("no record at rest is long enough")
    if not all(np.all(c.avar > 0) for c in curves):
        return _nothing("the output at rest does not move at all")
    model = fit_noise(curves)
    points = _points(curves, model)
    longest_s = max(float(c.tau_s[-1]) for c in curves)
    if model is None:
        said = f"not to be had from {record_s:.3g} s at rest: record an hour or more (static_allan profile)"
        return NoiseFigures(_refused(said) | _floor(points), said, points=points, record_s=record_s)
    used_s = np.concatenate([p.tau_s for p in points])[model.used]
    span = f"averaging times from {used_s.min():.4g} to {used_s.max():.4g} s"
    if not model.fits:
        said = f"not to be had: no stretch of averaging times follows the model (best {span}, {p_equals(model.p_value)}){_rise(points)}"
        return NoiseFigures(_refused(said) | _floor(points), said, points=points, record_s=record_s)
    model = _less_than_seen(model, points)
    figures = {
        name: _figure(name, unit, definition, factor, part, span)
        for (name, unit, definition, factor), part in zip(_PARTS, model.parts, strict=True)
    }
    fit = f"the model fits {span} ({p_equals(model.p_value)}); {_left_out(points, model)}"
    bias = figures["bias_instability"]
    statement = f"resolved up to {longest_s:.0f} s" if bias.interval else bias.reason
    return NoiseFigures(figures | _floor(points), statement, fit, points, model, record_s)


def _less_than_seen(model: NoiseModel, points: Sequence[AllanPoints]) -> NoiseModel:
    """The model with its flat part and its walk no larger than longer averaging times than it fits leave them.

    What swings with a period rises like a walk up to half of it, and falls again behind it, as none of them does.
    """
    tau_s = np.concatenate([p.tau_s for p in points])
    most = np.concatenate([p.high_dps for p in points]) ** 2
    longer = tau_s > tau_s[model.used].max()
    if not longer.any():
        return model
    *shorter, flat, walk = model.parts
    bounds = float(most[longer].min()), float((most[longer] / tau_s[longer]).min())
    return replace(model, parts=(*shorter, *map(_at_most, (flat, walk), bounds)))


def _at_most(part: Part, bound: float) -> Part:
    """A part that is told as it is; what is not, or is surely more than it may be, is that at the most."""
    if 0.0 < part.low <= bound:
        return part
    return Part(min(part.value, bound), min(part.low, 0.0), min(part.high, bound))


def _figure(name: str, unit: str, definition: str, factor: float, part: Part, span: str) -> Figure:
    """A part of the model as a figure, or why it is none."""
    low, value, high = (factor * float(np.sqrt(max(v, 0.0))) for v in (part.low, part.value, part.high))
    blank = Figure(name, unit, definition, method=_METHOD, sample=span)
    if part.low > 0.0:
        return replace(blank, value=value, low=low, high=high)
    if part.high <= 0.0:
        return replace(
            blank, reason="the output is low-passed: short averaging times show less noise, not more"
        )
    if not np.isfinite(high):
        return replace(blank, reason=f"not resolved within {span}, and not bounded")
    return replace(
        blank, high=high, reason=f"not resolved within {span}: less than {high:.3g} {unit} with 95 %"
    )


def _rise(points: Sequence[AllanPoints]) -> str:
    """Where the Allan deviation rises from its floor faster than any random walk: a sentence's end, empty where nowhere."""
    tau = np.concatenate([p.tau_s for p in points])
    order = np.argsort(tau, kind="stable")
    tau, adev = tau[order], np.concatenate([p.adev_dps for p in points])[order]
    floor = int(np.argmin(adev))
    slope = np.diff(np.log(adev[floor:])) / np.diff(np.log(tau[floor:]))
    steep = np.flatnonzero(slope > _STEEPER_THAN_WALKS)
    if steep.size == 0:
        return ""
    from_s, to_s = tau[floor + steep[0]], tau[floor + steep[-1] + 1]
    return f"; from {from_s:.3g} to {to_s:.3g} s the Allan deviation rises by slopes up to {slope[steep].max():.2g}, faster than any random walk (0.5): the output follows something, as the temperature. Record at one temperature"


def _left_out(points: Sequence[AllanPoints], model: NoiseModel) -> str:
    tau = np.concatenate([p.tau_s for p in points])
    short = tau[~model.used & (tau < tau[model.used].min())]
    long = tau[~model.used & (tau > tau[model.used].max())]
    # A bandwidth takes noise away; what lies above the model has another cause.
    below = np.all(model.misfit[~model.used & (tau < tau[model.used].min())] < 0.0)
    why = "the sensor's bandwidth" if below else "other noise than the model's"
    said = [f"shorter ones, from {short.min():.3g} s, are left out ({why})"] if short.size else []
    said += [f"longer ones, to {long.max():.3g} s, are left out (other than noise)"] if long.size else []
    return "; ".join(said) or "none is left out"


def _floor(points: Sequence[AllanPoints]) -> dict[str, Figure]:
    """The lowest Allan deviation with its interval: what the curve itself says, whatever the model."""
    tau, adev, low, high = (
        np.concatenate(v)
        for v in zip(*((p.tau_s, p.adev_dps, p.low_dps, p.high_dps) for p in points), strict=True)
    )
    k = int(np.argmin(adev))
    last = ", the longest that the record carries: it may fall further" if tau[k] == tau.max() else ""
    return {
        "allan_floor": Figure(
            name="allan_floor",
            unit="deg/h",
            definition=f"lowest Allan deviation, at {tau[k]:.3g} s{last}",
            method="overlapping Allan deviation",
            sample=f"averaging times from {tau.min():.4g} to {tau.max():.4g} s",
            value=float(adev[k]) * DPS_TO_DPH,
            low=float(low[k]) * DPS_TO_DPH,
            high=float(high[k]) * DPS_TO_DPH,
        )
    }


def _refused(reason: str) -> dict[str, Figure]:
    return {
        name: Figure(name=name, unit=unit, definition=definition, method=_METHOD, reason=reason)
        for name, unit, definition, _ in _PARTS
    }


def _nothing(reason: str) -> NoiseFigures:
    return NoiseFigures(_refused(reason), reason)


def _points(curves: Sequence[AllanCurve], model: NoiseModel | None) -> tuple[AllanPoints, ...]:
    """Curves with intervals; without a model the noise is taken for white."""
    found, first = [], 0
    for c in curves:
        rows = slice(first, first + c.factor.size)
        first += c.factor.size
        spans = (c.repeats @ np.maximum(c.lengths[:, None] - 2 * c.factor + 1, 0)) / c.factor
        dof = np.maximum(spans, 1.0) if model is None else model.dof[rows]
        adev_dps = np.sqrt(c.avar)
        found.append(
            AllanPoints(
                dt_s=c.dt_s,
                tau_s=c.tau_s,
                adev_dps=adev_dps,
                low_dps=adev_dps * np.sqrt(dof / stats.chi2.ppf(0.975, dof)),
                high_dps=adev_dps * np.sqrt(dof / stats.chi2.ppf(0.025, dof)),
                dof=dof,
                used=np.zeros(dof.size, dtype=np.bool_) if model is None else model.used[rows],
                misfit=np.full(dof.size, np.nan) if model is None else model.misfit[rows],
            )
        )
    return tuple(found)
