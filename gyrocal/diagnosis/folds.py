"""The residual folded on the coordinate of the effect that explains it: where its gain can be seen.

The rms of data sets barely moves for thermal, angle and ringing effects; on their own coordinate they stand out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.result import Diagnosis, NamedEffect, Rows
from gyrocal.units import S_PER_H, S_PER_MIN

Floats = NDArray[np.float64]

_MDPS = 1e3
_BINS = 24
#: More distinct values than this are a continuous coordinate.
_MOST_LEVELS = 41
#: Pieces of a record without segments that count as independent of each other, at the most.
_STRETCHES = 120
#: Fewer clusters than this in a bin say nothing of the scatter between clusters.
_FEW = 3
_TURN_DEG = 360.0


@dataclass(frozen=True)
class Coordinate:
    """Where rows lie on an effect's coordinate; arrays of shape (n,), NaN where a row has no place there.

    Attributes
    ----------
    gain : ndarray
        What the effect multiplies; the ordinate is residual over gain, in `unit`.
    within_set : bool
        The effect changes inside a data set, so that each set's own mean is only noise to it.
    """

    label: str
    x: Floats
    gain: Floats
    unit: str
    within_set: bool = False


@dataclass(frozen=True)
class Fold:
    """Binned means over a coordinate; arrays of shape (bins,), in the ordinate's unit.

    ``before`` has all named physics but this effect taken out, ``after`` this one as well; ``law`` is the effect,
    less what the error surface alone would follow of it.
    """

    coordinate: Coordinate
    x: Floats
    before: Floats
    after: Floats
    std_error: Floats
    law: Floats

    def rms(self) -> tuple[float, float, float]:
        """Rms over the bins, weighted by what is known of each: before, after, and of their noise alone."""
        weight = 1.0 / self.std_error**2
        total = float(weight.sum())
        before, after = (float(np.sqrt(weight @ y**2 / total)) for y in (self.before, self.after))
        return before, after, float(np.sqrt(self.x.size / total))


def _plain(label: str, x: Floats, *, within_set: bool = False) -> Coordinate:
    return Coordinate(label, x, np.full(x.size, 1.0 / _MDPS), "mdeg/s", within_set)


def _turn(rows: Rows, effect: NamedEffect) -> Coordinate:
    harmonic = effect.parameters["harmonic"].value if "harmonic" in effect.parameters else 1.0
    period = _TURN_DEG / max(round(harmonic), 1)
    label = "Table angle, deg" if period == _TURN_DEG else f"Table angle, deg (folded on {period:g}°)"
    return _plain(label, np.where(rows.rate_dps != 0, rows.angle_deg % period, np.nan), within_set=True)


def _turn_with_rate(rows: Rows, effect: NamedEffect) -> Coordinate:
    plain = _turn(rows, effect)
    return Coordinate(plain.label, plain.x, rows.rate_dps / 100.0 / _MDPS, "mdeg/s at 100 deg/s", True)


_TIME = "Time, h"


def _over_time(rows: Rows, effect: NamedEffect) -> Coordinate:
    return _plain(_TIME, (rows.t_s - rows.t_s[0]) / S_PER_H)


def _scale_over_time(rows: Rows, effect: NamedEffect) -> Coordinate:
    hours = (rows.t_s - rows.t_s[0]) / S_PER_H
    return Coordinate(_TIME, np.where(rows.rate_dps != 0, hours, np.nan), rows.rate_dps / 1e6, "ppm of rate")


def _since_step(rows: Rows, effect: NamedEffect) -> Coordinate:
    tau = effect.parameters["tau_s"].value if "tau_s" in effect.parameters else 3.0
    near = (rows.since_set_s <= max(6.0 * tau, 5.0)) & (rows.step_dps != 0)
    x = np.where(near, rows.since_set_s, np.nan)
    label = "Time since the data set began, s"
    return Coordinate(label, x, rows.step_dps / 10.0 / _MDPS, "mdeg/s per 10 deg/s of step", True)


def _in_own_units(name: str) -> Callable[[Rows, NamedEffect], Coordinate]:
    """Coordinate that the effect is proportional to: what it adds, over its amplitude."""

    def of(rows: Rows, effect: NamedEffect) -> Coordinate:
        amplitude = effect.parameters["amplitude"].value / _MDPS
        return _plain(name, rows.effect_dps[effect.effect] / amplitude)

    return of


_COORDINATES: dict[str, Callable[[Rows, NamedEffect], Coordinate]] = {
    "shupe": lambda rows, effect: _plain("Temperature rate, °C/min", rows.temp_rate_c_per_min),
    "shupe_gradient": _in_own_units("T - T_in, °C"),
    "thermal_hysteresis": _in_own_units("Play of the temperature, P[T] - T, °C"),
    "thermal_lag": lambda rows, effect: _plain(
        "Error by the lag as modelled, mdeg/s", rows.effect_dps[effect.effect] * _MDPS
    ),
    "warm_up": lambda rows, effect: _plain("Time since power-on, min", rows.since_power_on_s / S_PER_MIN),
    "bias_drift": _over_time,
    "bias_step": _over_time,
    "scale_drift": _scale_over_time,
    "scale_step": _scale_over_time,
    "temperature_order": lambda rows, effect: _plain("Gyro temperature, °C", rows.temp_c),
    "step_response": _since_step,
    "supply_voltage": lambda rows, effect: _plain("Supply, V", rows.supply_v),
    "earth_rate_tilt": _turn,
    "magnetic": _turn,
    "g_sensitivity": _turn,
    "table_eccentricity": _turn_with_rate,
    "bursts": lambda rows, effect: _plain("Data set", rows.set_index.astype(np.float64)),
}


def coordinate_of(rows: Rows, effect: NamedEffect, has_time: bool = True) -> Coordinate:
    """The coordinate on which an effect is shown; the rate where the effect has none of its own.

    Without `has_time` the rows are in time order and no more is known of their times: their number is shown.
    """
    make = _COORDINATES.get(effect.effect)
    c = _plain("Table rate, deg/s", rows.rate_dps) if make is None else make(rows, effect)
    if c.label == _TIME and not has_time:
        number = np.where(np.isfinite(c.x), np.arange(1.0, rows.t_s.size + 1), np.nan)
        c = replace(c, label="Data set, in the order recorded", x=number)
    return c


def fold_of(d: Diagnosis, effect: NamedEffect) -> Fold | None:
    """`fold` for an effect of a diagnosis; of a single effect beside a surface fitted here the change is known exactly."""
    rows = d.rows
    if rows is None:
        return None
    fitted_here = d.surface is not None and d.surface.provenance.get("by") == "diagnose"
    exact = fitted_here and list(rows.effect_dps) == [effect.effect]
    return fold(
        rows, effect, "time" not in d.not_testable, rows.before_dps - rows.after_dps if exact else None
    )


def fold(
    rows: Rows, effect: NamedEffect, has_time: bool = True, seen_dps: Floats | None = None
) -> Fold | None:
    """The residual before and after `effect`, binned on its coordinate; None where the rows do not carry it.

    Each bin is a least-squares mean of residual over gain with the white noise of its rows as weights. Its standard
    error comes from the scatter between data sets, which holds whatever the correlation inside a set is; a record
    without segments is cut into stretches of time. `seen_dps` is what the residual shows of the law, if that is known.
    """
    if effect.effect not in rows.effect_dps:
        return None
    c = coordinate_of(rows, effect, has_time)
    law = beyond_surface(rows, rows.effect_dps[effect.effect]) if seen_dps is None else seen_dps
    use = np.isfinite(c.x) & np.isfinite(rows.after_dps) & (c.gain != 0)
    if use.sum() < 3 or np.ptp(c.x[use]) == 0:
        return None
    after, law = rows.after_dps[use], law[use]
    sets = np.unique(clusters(rows)[use], return_inverse=True)[1]
    weight = 1.0 / rows.white_std_dps[use] ** 2
    if c.within_set:
        after = after - _set_means(after, weight, sets)
    bins, x = bin_rows(c.x[use])
    gain = c.gain[use]

    def mean(values: Floats) -> Floats:
        return np.asarray(
            np.bincount(bins, values * gain * weight) / np.bincount(bins, gain**2 * weight), dtype=np.float64
        )

    # The white noise of the rows is known: no error is less than it.
    white = 1.0 / np.sqrt(np.bincount(bins, gain**2 * weight))
    error = np.maximum(clustered_error(after, gain, weight, bins, sets), white)
    return Fold(c, x, mean(after + law), mean(after), error, mean(law))


def beyond_surface(rows: Rows, law: Floats) -> Floats:
    """What is left of a law once the error surface has followed it as far as it can, deg/s, shape (n,).

    Without the effect in the model the surface bends towards it, and only this is seen in a residual. Segments count
    with their white noise and the scatter of their means, as in the fit.
    """
    known = np.isfinite(rows.after_dps) & np.isfinite(law) & np.isfinite(rows.temp_c)
    piece = np.unique(rows.set_index[known], return_inverse=True)[1]
    weight = 1.0 / rows.white_std_dps[known] ** 2
    total = np.bincount(piece, weight)
    means = np.bincount(piece, weight * rows.after_dps[known]) / total
    weight = np.sqrt(weight / (1.0 + total * np.mean(means**2))[piece])
    u, v = (_scaled(x) for x in (rows.rate_dps, rows.temp_c))
    basis = np.stack([u**i * v**j for i in range(4 if np.ptp(u) > 0 else 1) for j in range(3)], axis=1)
    bend = np.linalg.lstsq(basis[known] * weight[:, None], law[known] * weight, rcond=1e-10)[0]
    return np.asarray(law - basis @ bend)


def _scaled(x: Floats) -> Floats:
    """From -1 to 1."""
    low, high = np.nanmin(x), np.nanmax(x)
    return np.asarray((2.0 * x - low - high) / (high - low) if high > low else np.zeros_like(x))


def _set_means(values: Floats, weight: Floats, sets: NDArray[np.int64]) -> Floats:
    return np.asarray((np.bincount(sets, values * weight) / np.bincount(sets, weight))[sets])


def bin_rows(x: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Bin number of each value and the mean value of each bin: levels where values repeat, else equal widths."""
    distinct = np.unique(np.round(x, 6))
    if distinct.size <= _MOST_LEVELS:
        bins = np.searchsorted(distinct, np.round(x, 6))
    else:
        edges = np.linspace(x.min(), x.max(), _BINS + 1)
        bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
        bins = np.unique(bins, return_inverse=True)[1]
    count = np.bincount(bins)
    return bins, np.asarray(np.bincount(bins, x) / count)


def clusters(rows: Rows) -> NDArray[np.int64]:
    """Number of the piece of the record that each row belongs to: its segment, or a stretch of a log without any."""
    alone = np.ptp(rows.rate_dps) == 0 and np.unique(rows.set_index).size == rows.t_s.size > _STRETCHES
    if not alone:
        return np.unique(rows.set_index, return_inverse=True)[1]
    return np.arange(rows.t_s.size) * _STRETCHES // rows.t_s.size


def clustered_error(
    values: Floats, gain: Floats, weight: Floats, bins: NDArray[np.int64], sets: NDArray[np.int64]
) -> Floats:
    """Cluster-robust standard error of each bin's mean, with `sets` as clusters.

    A bin with fewer than three clusters takes the scatter of a cluster's mean from all bins together.
    """
    size = int(bins.max()) + 1
    information = np.bincount(bins, gain**2 * weight, minlength=size)
    mean = np.bincount(bins, values * gain * weight, minlength=size) / information
    score = (values - mean[bins] * gain) * gain * weight
    cells, cell = np.unique(bins * (sets.max() + 1) + sets, return_inverse=True)
    total = np.bincount(cell, score)
    part = np.bincount(cell, gain**2 * weight)
    owner = cells // (sets.max() + 1)
    count = np.bincount(owner, minlength=size).astype(np.float64)
    own = np.bincount(owner, total**2, minlength=size) / information**2 * count / np.maximum(count - 1.0, 1.0)
    # The scatter of a cluster's mean about its bin's; where no bin has two clusters, about zero.
    free = part * (1.0 - part / information[owner])
    if np.any(count > 1):
        pooled = float(np.sum(total**2 / part) / np.sum(free))
    else:
        pooled = float(np.sum(np.bincount(cell, values * gain * weight) ** 2 / part) / np.sum(part))
    shared = pooled * np.bincount(owner, part**2, minlength=size) / information**2
    return np.asarray(np.sqrt(np.where(count < _FEW, shared, own)))
