"""Fit of ten million samples: data-set reduction and fit against least squares on every sample, in one run.

Both start from samples in memory and end with twelve coefficients; ours has their covariance as well. Memory is
the peak that Python and numpy allocate while a hundred million samples, made a block at a time, are reduced.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets, reduce_segment
from gyrocal.calibration.fit import fit_surface
from gyrocal.records.run import Segment, SegmentRecord
from tests.benchmarks.row import Row, best_time_s
from tests.calibration.simulation import SURFACE

Floats = NDArray[np.float64]

RATES = np.linspace(-100.0, 100.0, 21)
TEMPS = np.array([-10.0, 10.0, 30.0, 50.0, 40.0, 20.0, 0.0])
BLOCK = 500_000


def samples(total: int) -> tuple[Floats, Floats, Floats, int]:
    """Rate of each data set, gyro and temperature of each sample, and samples a data set."""
    rng = np.random.default_rng(1)
    rate, temp = (a.ravel() for a in np.meshgrid(RATES, TEMPS))
    each = total // rate.size
    gyro = np.repeat(SURFACE.output_dps(rate, temp), each) + rng.normal(0.0, 4.4e-3, each * rate.size)
    return rate, gyro, np.repeat(temp, each) + rng.normal(0.0, 0.02, each * rate.size), each


def blocks(record: SegmentRecord, gyro: Floats, temp: Floats) -> Iterator[Segment]:
    """A segment in blocks, as the reader of run directories gives them."""
    empty = np.empty(0)
    for start in range(0, gyro.size, BLOCK):
        part = slice(start, min(start + BLOCK, gyro.size))
        t = record.t_start_s + 0.1 * np.arange(part.start, part.stop, dtype=np.float64)
        yield Segment(record, t, gyro[part], temp[part], np.zeros(t.size), *[empty] * 5)


def ours(rate: Floats, gyro: Floats, temp: Floats, each: int) -> Floats:
    """Reduce to data sets, estimate the scatter, fit."""
    sums = []
    for k, r in enumerate(rate):
        record = SegmentRecord(k, "rate", float(r), 20.0, 0.1 * each * k, 0.0, each, 0.1, "ok", "", "")
        rows = slice(k * each, (k + 1) * each)
        sums.append(reduce_segment(blocks(record, gyro[rows], temp[rows])))
    size = rate.size
    sets = DataSets(
        rate_dps=rate,
        gyro_dps=np.array([s.gyro.mean for s in sums]),
        temp_c=np.array([s.temp.mean for s in sums]),
        gyro_std_dps=np.array([s.gyro.std() for s in sums]),
        n=np.full(size, float(each)),
        gyro_peak_dps=np.array([s.gyro.peak for s in sums]),
        t_s=np.array([0.5 * (s.t_first_s + s.t_last_s) for s in sums]),
        duration_s=np.array([s.span_s for s in sums]),
        temp_rate_c_per_min=np.array([s.temp_rate_c_per_min() for s in sums]),
        averaging_s=np.full(size, 0.1),
        segment=np.arange(size),
        outcome=np.full(size, "ok"),
        kind=np.full(size, "rate"),
        reference=np.full(size, "command"),
    )
    return fit_surface(sets).surface.error_dps(rate, np.repeat(TEMPS, RATES.size))


def baseline(rate: Floats, gyro: Floats, temp: Floats, each: int) -> Floats:
    """numpy's polynomials and least squares on every sample, scaled as ours."""
    u, v = gyro / 100.0, (temp - 20.0) / 30.0
    design = np.polynomial.polynomial.polyvander2d(u, v, [3, 2])
    c = np.linalg.lstsq(design, gyro - np.repeat(rate, each), rcond=None)[0]
    middle = SURFACE.output_dps(rate, np.repeat(TEMPS, RATES.size)) / 100.0
    at = (np.repeat(TEMPS, RATES.size) - 20.0) / 30.0
    return np.asarray(np.polynomial.polynomial.polyval2d(middle, at, c.reshape(4, 3)))


def stream(total: int) -> None:
    """Reduce one segment of `total` samples that are never in memory together."""
    record = SegmentRecord(1, "rate", 10.0, 20.0, 0.0, total / 10, total, 0.1, "ok", "", "")
    empty = np.empty(0)
    rng = np.random.default_rng(2)
    gyro = rng.normal(10.0, 4.4e-3, BLOCK)
    t = 0.1 * np.arange(BLOCK, dtype=np.float64)
    zeros = np.zeros(BLOCK)
    made = (
        Segment(record, t + k * 0.1 * BLOCK, gyro, 20.0 + zeros, zeros, *[empty] * 5)
        for k in range(total // BLOCK)
    )
    reduce_segment(made)


def peak_mib(work: Callable[[], object]) -> float:
    """Peak of allocated memory, MiB."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    return peak


def measure() -> list[Row]:
    """Times, their ratio, and memory."""
    data = samples(10_000_000)
    mine = best_time_s(lambda: ours(*data), 3)
    theirs = best_time_s(lambda: baseline(*data), 1)
    return [
        Row("fit of 1e7 samples: reduction and fit", mine, "s"),
        Row("fit of 1e7 samples: polyvander2d and lstsq on all", theirs, "s"),
        Row("fit of 1e7 samples: times as fast", theirs / mine, "x", 5.0, at_least=True),
        Row("reduction of 1e7 samples: peak memory", peak_mib(lambda: stream(10_000_000)), "MiB", 1024.0),
        Row("reduction of 1e8 samples: peak memory", peak_mib(lambda: stream(100_000_000)), "MiB", 1024.0),
    ]
