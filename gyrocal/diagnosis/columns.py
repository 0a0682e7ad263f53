"""Regression columns of all hypotheses in one matrix, so that one whitening pass serves every test."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.series import Series
from gyrocal.physics.effect import Conditions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class RowConditions(Conditions):
    """Conditions of rows that are means over a while.

    ``row_s``, shape (n,), says over how long; ``sample_std_dps`` is the noise of the samples in them, 0 if unknown.
    """

    row_s: Floats = field(default_factory=lambda: np.empty(0))
    sample_std_dps: float = 0.0


def conditions_of(series: Series) -> RowConditions:
    """What the laws of the catalogue may depend on, row by row.

    Where it is not known when the gyro was switched on, that is when the record begins: a warm-up has the same
    shape whenever it is first seen.
    """
    since_on = series.since_power_on_s
    if since_on is None and series.has_time:
        since_on = series.t_s - series.t_s[0]
    return RowConditions(
        t_s=series.t_s,
        rate_dps=series.rate_dps,
        temp_c=series.temp_c,
        angle_deg=series.angle_deg,
        supply_v=series.supply_v,
        since_power_on_s=since_on,
        since_step_s=series.since_set_s,
        step_dps=series.step_dps,
        temp_rate_c_per_s=series.temp_rate_c_per_min / 60.0,
        data_set_index=series.set_index.astype(np.float64),
        row_s=np.maximum(series.averaging_s, 0.1),
        sample_std_dps=0.0
        if series.is_table
        else float(np.max(series.white_std_dps[series.is_set], initial=0.0)),
    )


@dataclass
class Book:
    """Collects columns; each is freed of the base columns first, which keeps the algebra well scaled.

    Parameters
    ----------
    record : ndarray, shape (n,)
        Recording minus simulated sequence: it stands before all columns.
    base : ndarray, shape (n, p)
        Columns 0..p-1.
    """

    record: Floats
    base: Floats
    _parts: list[Floats] = field(default_factory=list)
    _count: int = 0

    def __post_init__(self) -> None:
        # Orthogonal columns span the same and stay well conditioned where rates or temperatures are few.
        self._q = np.linalg.qr(self.base / np.linalg.norm(self.base, axis=0))[0]
        self._count = self.base.shape[1]
        self._parts += [self.record[:, None], self._q * np.sqrt(len(self._q))]

    @property
    def model(self) -> Ints:
        """Numbers of the base columns."""
        return np.arange(self.base.shape[1])

    def add(self, columns: Floats) -> Ints:
        """Add columns, shape (n,) or (n, k); returns their numbers, shape (k,)."""
        block = self.beyond(columns[:, None] if columns.ndim == 1 else columns)
        self._parts.append(block)
        first = self._count
        self._count += block.shape[1]
        return np.arange(first, self._count)

    def beyond(self, columns: Floats) -> Floats:
        """What columns, shape (n, k), say beyond the base columns."""
        return np.asarray(columns - self._q @ (self._q.T @ columns))

    def matrix(self) -> Floats:
        """Record and all columns, shape (n, 1 + p)."""
        return np.concatenate(self._parts, axis=1)


def hats(x: Floats, knots: Floats) -> Floats:
    """Piecewise-linear hat functions on the knots, shape (n, len(knots))."""
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(knots.size)])


def quantile_knots(x: Floats, count: int) -> Floats:
    """Distinct knots at quantiles of x."""
    return np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
