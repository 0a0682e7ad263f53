"""Rows of a segment: gyro samples and bench readings, each with its own time, merged in order of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.bench.devices import GyroSamples
from gyrocal.records.journal import SegmentWriter

Floats = NDArray[np.float64]

#: A sample on the edge of an averaging interval belongs to the interval that ends there, rounding errors aside.
_EDGE = 1e-6


@dataclass(frozen=True)
class BenchRow:
    """One reading of table, chamber and supply; NaN where there is none."""

    t_s: float
    table_rate_dps: float
    table_angle_deg: float
    chamber_temp_c: float
    supply_v: float


class Recorder:
    """Writes a segment as its rows come; `averaging_s` None keeps every sample."""

    def __init__(self, writer: SegmentWriter, averaging_s: float | None) -> None:
        self._writer = writer
        self._averaging_s = averaging_s
        self._samples: list[GyroSamples] = []
        self._bench: list[BenchRow] = []
        self.n = 0
        self.first_t_s = np.inf
        self.last_t_s = -np.inf

    def add(self, samples: GyroSamples, bench: list[BenchRow]) -> None:
        """Take what was drained, and the bench readings made before that."""
        if samples.t_s.size:
            self._samples.append(samples)
        self._bench += bench
        if self._averaging_s is None:
            self._write(joined(self._samples), np.inf)
            self._samples = []
        elif self._samples:
            self._write_whole_means()

    def finish(self) -> None:
        """Write what is left, the last unfinished mean included."""
        samples = joined(self._samples)
        if self._averaging_s is not None:
            samples = means(samples, self._averaging_s)
        self._samples = []
        self._write(samples, np.inf)

    def _write_whole_means(self) -> None:
        """Write the intervals that are over; a bench reading waits until no earlier mean can come."""
        period_s = self._averaging_s or 1.0
        if self._samples[-1].t_s[-1] - self._samples[0].t_s[0] < period_s:
            return
        samples = joined(self._samples)
        index = np.ceil(samples.t_s / period_s - _EDGE)
        over = int(np.searchsorted(index, index[-1]))
        self._samples = [cut(samples, slice(over, None))]
        self._write(means(cut(samples, slice(None, over)), period_s), float(index[-1] - 1) * period_s)

    def _write(self, samples: GyroSamples, horizon_s: float) -> None:
        now = [row for row in self._bench if row.t_s <= horizon_s]
        self._bench = [row for row in self._bench if row.t_s > horizon_s]
        rows = [*_gyro_rows(samples), *map(_bench_row, now)]
        if not rows:
            return
        rows.sort(key=lambda row: row[0])
        self.n += samples.t_s.size
        self.first_t_s = min(self.first_t_s, rows[0][0])
        self.last_t_s = rows[-1][0]
        self._writer.append("".join([text for _, text in rows]))


def joined(parts: list[GyroSamples]) -> GyroSamples:
    """Samples of several drains as one."""
    if not parts:
        return GyroSamples()
    if len(parts) == 1:
        return parts[0]
    return GyroSamples(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in GyroSamples.__dataclass_fields__)
    )


def cut(samples: GyroSamples, rows: slice) -> GyroSamples:
    """Some of the samples."""
    return GyroSamples(*(getattr(samples, name)[rows] for name in GyroSamples.__dataclass_fields__))


def means(samples: GyroSamples, period_s: float) -> GyroSamples:
    """Means over intervals of `period_s`.

    Good samples only where there are any; an interval with a bad sample carries that sample's status, so
    that whoever reads it knows.
    """
    if samples.t_s.size == 0:
        return samples
    index = np.ceil(samples.t_s / period_s - _EDGE)
    starts = np.flatnonzero(np.diff(index, prepend=-np.inf))
    good = (samples.status == 0) & np.isfinite(samples.gyro_dps)
    some_good = np.logical_or.reduceat(good, starts)
    length = np.diff(starts, append=index.size)
    used = good | ~np.repeat(some_good, length)
    count = np.add.reduceat(used.astype(np.float64), starts)
    bad = ~good
    worst = np.maximum.reduceat(np.where(bad, np.maximum(np.nan_to_num(samples.status), 1.0), 0.0), starts)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.where(used, values, 0.0), starts) / count)

    return GyroSamples(
        np.add.reduceat(samples.t_s, starts) / length,
        mean(samples.gyro_dps),
        mean(samples.gyro_temp_c),
        worst,
    )


def _cell(value: float, digits: int) -> str:
    return "" if value != value else f"{value:.{digits}f}"


def _gyro_rows(samples: GyroSamples) -> list[tuple[float, str]]:
    columns = (samples.t_s, samples.gyro_dps, samples.gyro_temp_c, samples.status)
    return [
        (t, f"{t:.6f},{_cell(g, 6)},{_cell(c, 3)},{_cell(s, 0)},,,,\n")
        for t, g, c, s in zip(*(column.tolist() for column in columns), strict=True)
    ]


def _bench_row(row: BenchRow) -> tuple[float, str]:
    cells = (
        _cell(row.table_rate_dps, 6),
        _cell(row.table_angle_deg, 6),
        _cell(row.chamber_temp_c, 3),
        _cell(row.supply_v, 3),
    )
    return row.t_s, f"{row.t_s:.6f},,,," + ",".join(cells) + "\n"
