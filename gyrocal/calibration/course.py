"""The course of a record over hours, in few means: what is kept of it while it is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Means that are kept at most; twice as many are pooled in pairs.
_MOST = 512


@dataclass(frozen=True)
class Course:
    """Means over stretches of equal numbers of samples, shape (k,): time, output, temperature (NaN unknown), samples."""

    t_s: Floats
    gyro_dps: Floats
    temp_c: Floats
    n: Floats

    @property
    def span_s(self) -> float:
        """Length of the record, gaps included."""
        return float(np.ptp(self.t_s)) * (1.0 + 1.0 / max(self.t_s.size - 1, 1))


class CourseSums:
    """Gathers a course in memory that does not grow: stretches double in length when there are too many."""

    def __init__(self) -> None:
        self._stretch = 1
        self._rows: list[Floats] = []
        self._open = np.zeros(5)

    def add(self, t_s: Floats, gyro_dps: Floats, temp_c: Floats) -> None:
        """Go on with finite samples; their temperatures may be NaN."""
        warm = np.isfinite(temp_c)
        columns = np.stack([np.ones(t_s.size), t_s, gyro_dps, np.where(warm, temp_c, 0.0), warm], axis=1)
        while columns.size:
            take = int(self._stretch - self._open[0])
            if columns.shape[0] < take:
                self._open = self._open + columns.sum(axis=0)
                return
            first, columns = self._open + columns[:take].sum(axis=0), columns[take:]
            whole = columns.shape[0] // self._stretch
            more = columns[: whole * self._stretch].reshape(whole, self._stretch, 5).sum(axis=1)
            columns = columns[whole * self._stretch :]
            self._rows += [first, *more]
            self._open = np.zeros(5)
            while len(self._rows) >= 2 * _MOST:
                pairs = np.array(self._rows[: len(self._rows) // 2 * 2])
                odd = self._rows[pairs.shape[0] :]
                self._rows = list(pairs.reshape(-1, 2, 5).sum(axis=1))
                self._open = odd[0] if odd else self._open
                self._stretch *= 2

    def course(self) -> Course:
        """What was gathered; the last stretch may be shorter."""
        rows = np.array([*self._rows, *([self._open] if self._open[0] else [])]).reshape(-1, 5)
        n = rows[:, 0]
        with np.errstate(invalid="ignore"):
            temp_c = rows[:, 3] / rows[:, 4]
        return Course(rows[:, 1] / n, rows[:, 2] / n, temp_c, n)
