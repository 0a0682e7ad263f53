"""The residual folded on the coordinate of the effect that explains it: where its gain can be seen.

The rms of data sets barely moves for thermal, angle and ringing effects; on their own coordinate they stand out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.result import Diagnosis, NamedEffect, Rows
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.fold import FoldAxis
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]

_BINS = 24
#: More distinct values than this are a continuous coordinate.
_MOST_LEVELS = 41
#: Pieces of a record without segments that count as independent of each other, at the most.
_STRETCHES = 120
#: Fewer clusters than this in a bin say nothing of the scatter between clusters.
_FEW = 3


@dataclass(frozen=True)
class Fold:
    """Binned means over a coordinate; arrays of shape (bins,), in the ordinate's unit.

    ``before`` has all named physics but this effect taken out, ``after`` this one as well; ``law`` is the effect,
    less what the error surface alone would follow of it.
    """

    coordinate: FoldAxis
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


def coordinate_of(rows: Rows, effect: NamedEffect, has_time: bool = True) -> FoldAxis:
    """The coordinate on which an effect is shown.

    Without `has_time` the rows are in time order and no more is known of their times: their number is shown.
    """
    values = {name: e.value for name, e in effect.parameters.items()}
    c = CATALOGUE[effect.effect].fold_axis(_conditions(rows), values, rows.effect_dps[effect.effect])
    if c.of_time and not has_time:
        number = np.where(np.isfinite(c.x), np.arange(1.0, rows.t_s.size + 1), np.nan)
        c = replace(c, label="Data set, in the order recorded", x=number)
    return c


def _conditions(rows: Rows) -> Conditions:
    return Conditions(
        t_s=rows.t_s,
        rate_dps=rows.rate_dps,
        temp_c=rows.temp_c,
        angle_deg=rows.angle_deg,
        supply_v=rows.supply_v,
        since_power_on_s=rows.since_power_on_s,
        since_step_s=rows.since_set_s,
        step_dps=rows.step_dps,
        temp_rate_c_per_s=rows.temp_rate_c_per_min / S_PER_MIN,
        data_set_index=rows.set_index.astype(np.float64),
    )


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
    bins, x = bin_rows(c.x[use], c.linear_within)
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


def bin_rows(x: Floats, linear_within: float = 0.0) -> tuple[NDArray[np.int64], Floats]:
    """Bin number of each value and the mean value of each bin: levels where values repeat, else equal widths.

    Beyond `linear_within`, where that is given, bins are equally wide by the logarithm.
    """
    distinct = np.unique(np.round(x, 6))
    if distinct.size <= _MOST_LEVELS:
        bins = np.searchsorted(distinct, np.round(x, 6))
    else:
        drawn = np.arcsinh(x / linear_within) if linear_within > 0 else x
        edges = np.linspace(drawn.min(), drawn.max(), _BINS + 1)
        bins = np.clip(np.searchsorted(edges, drawn, side="right") - 1, 0, _BINS - 1)
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
