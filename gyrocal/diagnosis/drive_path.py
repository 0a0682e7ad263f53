"""The path that encoders and gyro reckon, row by row, and its means over the knots into which the truth is averaged."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.drive_series import DriveSeries
from gyrocal.units import DEG_TO_RAD

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: Knots into which the truth is averaged.
KNOTS = 80
#: A share of a column below which the nuisances hold all of it.
_HIDDEN = 1e-4


class Path:
    """Row-wise quantities of a reckoned path, and their means over the truth's knots."""

    def __init__(self, series: DriveSeries, delay_s: float) -> None:
        t = series.t_s
        turned = np.interp(t - delay_s, t, series.gyro_deg)
        self.t_s = t - t[0]
        self.heading = DEG_TO_RAD * turned
        self.ds = np.diff(series.distance_m, prepend=0.0)
        self.way = np.diff(series.way_m, prepend=0.0)
        self.dt = np.diff(t, prepend=t[0])
        self.rate = np.divide(
            np.diff(self.heading, prepend=self.heading[0]), self.dt, out=np.zeros_like(t), where=self.dt > 0
        )
        self.known = np.isfinite(series.truth_x_m) & np.isfinite(series.truth_y_m)
        self.knot = knots_of(t[self.known])
        self.count = np.bincount(self.knot).astype(np.float64)
        truth = series.truth_x_m + 1j * series.truth_y_m
        self.truth = self.mean(truth)
        self.at_s = self.mean(self.t_s)
        self.has_heading = bool(np.all(np.isfinite(series.truth_heading_deg[self.known])))
        self.truth_heading = DEG_TO_RAD * series.truth_heading_deg

    def mean(self, rows: NDArray[np.generic]) -> NDArray:  # type: ignore[type-arg]
        """Mean of a row-wise quantity over each knot's positions."""
        seen = rows[self.known]
        if np.iscomplexobj(seen):
            return np.asarray(self.mean(rows.real) + 1j * self.mean(rows.imag))
        return np.asarray(np.bincount(self.knot, seen) / self.count)

    def reckon(self, heading: Floats, ds: Floats) -> tuple[Complexes, Complexes]:
        """Steps of the path, and the path, row by row."""
        middle = 0.5 * (heading + np.concatenate([heading[:1], heading[:-1]]))
        steps = ds * np.exp(1j * middle)
        return steps, np.cumsum(steps)


def knots_of(t_s: Floats) -> NDArray[np.int64]:
    """Number of the knot of each position; knots are equally long, empty ones left out."""
    width = (t_s[-1] - t_s[0]) / min(KNOTS, t_s.size)
    return np.asarray(np.unique(np.floor((t_s - t_s[0]) / width), return_inverse=True)[1], dtype=np.int64)


def short_variance(residual: Floats, count: Floats) -> float:
    """Variance of a single position's noise from neighbouring knots."""
    second = residual[2:] - 2 * residual[1:-1] + residual[:-2]
    return float(np.median(second**2) / 0.455 / 6.0 * np.median(count))


def independent(nuisances: Mapping[str, Floats], interests: Mapping[str, Floats]) -> tuple[Floats, list[str]]:
    """Columns that add something to those before them, nuisances first."""
    kept: list[str] = []
    basis = np.zeros((next(iter(nuisances.values())).size, 0))
    columns = {**nuisances, **interests}
    for name, column in columns.items():
        length = float(np.linalg.norm(column))
        if length == 0:
            continue
        free = column - basis @ (basis.T @ column)
        free = free - basis @ (basis.T @ free)
        if float(np.linalg.norm(free)) < _HIDDEN * length:
            continue
        basis = np.column_stack([basis, free / np.linalg.norm(free)])
        kept.append(name)
    return np.column_stack([columns[name] for name in kept]), kept
