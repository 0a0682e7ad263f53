"""Noise of the heading difference: how it grows with way and turn, and bins that are no noise at all (isolated slips)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from gyrocal.diagnosis.drive_effects import candidates, coordinates
from gyrocal.diagnosis.drive_series import Bins, DriveSeries, bins_of
from gyrocal.diagnosis.result import Located

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Standard deviations beyond which a bin is no noise: once in 5e8 bins of a normal one; neighbours of such a bin.
_OUTLIER, _NEIGHBOUR = 6.0, 2.0
#: Slips in more than this share of the bins are not isolated: they are noise of this robot.
_MOST = 0.25
_HUBER, _BISQUARE = 1.5, 4.7
_ROUNDS = 20
#: How the region of such bins begins.
ISOLATED = "isolated slips"
#: Times of slips that a region lists.
_LISTED = 6


@dataclass(frozen=True)
class YawNoise:
    """Standard deviation of each bin (deg), shape (bins,), and the bins of isolated slips with what they add (deg)."""

    std_deg: Floats
    slips: Ints
    slip_deg: Floats

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which bins are no slips, shape (bins,)."""
        used = np.ones(self.std_deg.size, dtype=bool)
        used[self.slips] = False
        return used

    def dummies(self) -> Floats:
        """A column of its own for each slip, which takes the bin out of a regression."""
        return np.eye(self.std_deg.size)[:, self.slips]


def yaw_noise(series: DriveSeries) -> YawNoise:
    """Robust fit of every law and curve there is; what it leaves is noise, or a slip.

    The curves are there so that no law of the catalogue, and no smooth stranger either, is taken for slips.
    """
    bins = bins_of(series, 0.0)
    y = bins.encoder_deg - bins.gyro_deg
    columns = _everything(series, bins)
    growth = _growth(bins)
    sigma = np.full(y.size, _spread(y))
    residual, weight = y, np.ones(y.size)
    for k in range(_ROUNDS):
        scaled = np.sqrt(weight) / sigma
        values = np.linalg.lstsq(columns * scaled[:, None], y * scaled, rcond=1e-8)[0]
        residual = y - columns @ values
        z = residual / sigma
        if k < _ROUNDS // 2:
            weight = np.minimum(1.0, _HUBER / np.maximum(np.abs(z), 1e-12))
            sigma = np.full(y.size, _spread(residual))
        else:
            weight = np.where(np.abs(z) < _BISQUARE, (1 - (z / _BISQUARE) ** 2) ** 2, 0.0)
            sigma = _levels(residual, growth, np.abs(z) < _BISQUARE, sigma)
    # Degrees of freedom that the curves have taken.
    sigma = sigma * np.sqrt(y.size / max(y.size - columns.shape[1], 0.5 * y.size))
    # Between standing and moving the noise is hardly known, and a slip that matters is one beside the usual noise.
    slips = _outliers(residual / np.maximum(sigma, 0.5 * float(np.median(sigma))))
    return YawNoise(sigma, slips, residual[slips])


def _everything(series: DriveSeries, bins: Bins) -> Floats:
    """Columns of every law, and of every curve that there are bins for."""
    families = candidates(series, bins, 0.0)
    delays = families.pop("gyro_delay")
    laws = [c.columns for family in families.values() for c in family]
    laws += [c.columns for c in delays if round(abs(c.shape["delay_s"]), 2) in (0.12, 0.28, 0.52, 1.0)]
    curves = [c.columns for c in coordinates(series, bins, 0.0)]
    columns = np.hstack([*laws, *curves])
    columns = columns[:, : max(bins.t_s.size // 6, 1)]
    length = np.linalg.norm(columns, axis=0)
    return np.asarray(columns[:, length > 0] / length[length > 0])


def _growth(bins: Bins) -> Floats:
    """What a variance may grow with: nothing, way and its square, turn and its square; shape (bins, 5)."""
    way, turn = bins.way_m, np.abs(bins.gyro_deg)
    columns = np.stack([np.ones(way.size), way, way**2, turn, turn**2], axis=1)
    return np.asarray(columns / np.maximum(columns.mean(axis=0), 1e-12))


def _spread(x: Floats) -> float:
    """Standard deviation by the median of absolute values."""
    return float(1.4826 * np.median(np.abs(x))) + 1e-9


def _levels(residual: Floats, growth: Floats, used: NDArray[np.bool_], sigma: Floats) -> Floats:
    """Standard deviation of each bin: squares fitted by what they grow with, none negative."""
    weight = used / np.maximum(sigma**2, 1e-4 * float(np.median(sigma**2)))
    levels, _ = optimize.nnls(growth * weight[:, None], residual**2 * weight)
    variance = growth @ levels
    return np.asarray(np.sqrt(np.maximum(variance, 1e-3 * float(np.median(variance)) + 1e-18)))


def _outliers(z: Floats) -> Ints:
    """Bins far out, and their neighbours that are out too; none where they are too many to be isolated."""
    far = np.abs(z) > _OUTLIER
    near = np.abs(z) > _NEIGHBOUR
    for _ in range(3):
        beside = np.zeros_like(far)
        beside[1:] |= far[:-1]
        beside[:-1] |= far[1:]
        far = far | (beside & near)
    found = np.flatnonzero(far)
    return found if found.size <= _MOST * z.size else found[:0]


def slips_place(bins: Bins, noise: YawNoise) -> Located | None:
    """The isolated slips as a place in time."""
    if not noise.slips.size:
        return None
    z = np.abs(noise.slip_deg) / noise.std_deg[noise.slips]
    p_value = min(1.0, 2.0 * noise.std_deg.size * float(stats.norm.sf(np.max(z))))
    squares = float(noise.slip_deg @ noise.slip_deg)
    share = squares / (squares + float(np.sum(noise.std_deg**2)))
    where = f"{ISOLATED} at {_listed(slip_times(bins, noise))}"
    return Located("time", "mean", where, max(p_value, 1e-16), share, True)


def slip_times(bins: Bins, noise: YawNoise) -> tuple[float, ...]:
    """When each slip begins, s since the log began; neighbouring bins are one."""
    first = np.diff(noise.slips, prepend=-10) > 1
    return tuple(float(t) for t in bins.t_s[noise.slips[first]] - 0.5 * bins.width_s)


def _listed(times: Sequence[float]) -> str:
    shown = ", ".join(f"{t:.0f}" for t in times[:_LISTED])
    more = len(times) - _LISTED
    return f"t = {shown} s" + (f" and {more} more" if more > 0 else "")
