"""Samples of a gyro that stands, block by block: what is taken off or set aside, and what is kept of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gyrocal.calibration.course import CourseSums
from gyrocal.calibration.noise import add_pieces, gaps
from gyrocal.inference.allan import AllanCurve, AllanSums
from gyrocal.inference.rounding import StepCounts
from gyrocal.records.gyro_log import GyroChoice, iterate_gyro_log
from gyrocal.records.run import Run
from gyrocal.units import STDS_PER_MAD

Floats = NDArray[np.float64]

#: Robust standard deviations beyond which a sample stands by itself, and from which on it is on the way there.
_ALONE, _ON_THE_WAY = 8.0, 5.0
#: Samples in a row that tell how far is far.
_LEAST_SAMPLES = 50


@dataclass(frozen=True)
class Block:
    """Samples in a row of one segment; NaN output is a missing sample."""

    segment: int
    dt_s: float
    t_s: Floats
    gyro_dps: Floats
    temp_c: Floats


@dataclass
class Reading:
    """What accumulates while a record is read."""

    sums: dict[float, AllanSums] = field(default_factory=dict)
    course: CourseSums = field(default_factory=CourseSums)
    samples: int = 0
    missing: int = 0
    same_time: int = 0
    elapsed_s: float = 0.0
    steps: int = 0
    jitter_s: float = 0.0
    stepped: StepCounts = field(default_factory=StepCounts)
    segments: int = 0


def run_blocks(run: Run) -> Iterator[Block]:
    """A run's segments at rest."""
    for record in run.segments:
        if record.outcome == "failed" or record.rate_dps != 0.0:
            continue
        dt_s = record.averaging_s
        for block in run.iterate_segment(record):
            if dt_s is None and block.t_s.size > 1:
                dt_s = float(np.median(np.diff(block.t_s)))
            if dt_s is not None:
                gyro_dps = np.where(block.good, block.gyro_dps, np.nan)
                yield Block(record.id, dt_s, block.t_s, gyro_dps, block.gyro_temp_c)


def log_blocks(path: Path, choice: GyroChoice, notes: list[str]) -> Iterator[Block]:
    """A log less the rate of its table; what is to be said of it goes to `notes`."""
    for block in iterate_gyro_log(path, choice):
        notes += block.notes
        rate = np.where(np.isfinite(block.rate_dps), block.rate_dps, 0.0)
        yield Block(block.segment, block.usual_dt_s, block.t_s, block.gyro_dps - rate, block.temp_c)


def read_rest(blocks: Iterator[Block]) -> Reading:
    """All that is kept of blocks in a row."""
    reading, segment, tail = Reading(), None, np.empty(0)
    for block in blocks:
        if block.segment != segment:
            for sums in reading.sums.values():
                sums.cut()
            segment, tail = block.segment, np.empty(0)
            reading.segments += 1
        good = np.isfinite(block.gyro_dps) & np.isfinite(block.t_s)
        t_s, gyro_dps = block.t_s[good], block.gyro_dps[good]
        reading.missing += int(good.size - t_s.size)
        if t_s.size < 2:
            continue
        reading.samples += t_s.size
        reading.stepped.add(block.segment, gyro_dps, block.dt_s)
        reading.course.add(t_s, gyro_dps, block.temp_c[good])
        reading.same_time += int(np.count_nonzero(np.diff(t_s, prepend=tail[-1:]) == 0))
        cuts, tail = gaps(tail, t_s, block.dt_s)
        _time(reading, t_s, cuts, block.dt_s)
        add_pieces(reading.sums.setdefault(block.dt_s, AllanSums(block.dt_s)), np.split(gyro_dps, cuts))
    return reading


def curves_of(reading: Reading) -> list[AllanCurve]:
    """Allan curves; the sample time of a plain log is its mean one, which jitter of the time stamps does not bend."""
    curves = [reading.sums[dt_s].curve() for dt_s in sorted(reading.sums)]
    if len(curves) == 1 and reading.steps:
        return [replace(curves[0], dt_s=reading.elapsed_s / reading.steps)]
    return curves


def _time(reading: Reading, t_s: Floats, cuts: NDArray[np.int64], dt_s: float) -> None:
    """Elapsed time and number of steps of gapless stretches, for the clock."""
    for piece in np.split(t_s, cuts):
        if piece.size > 1:
            reading.steps += piece.size - 1
            reading.elapsed_s += float(piece[-1] - piece[0])
            reading.jitter_s = max(
                reading.jitter_s, float(np.std(np.diff(piece))) if piece.size > 2 else dt_s
            )


def without(blocks: Iterator[Block], spans: Sequence[tuple[float, float]]) -> Iterator[Block]:
    """The blocks, missing what lies in `spans`."""
    for block in blocks:
        inside = np.zeros(block.t_s.shape, dtype=np.bool_)
        for start, end in spans:
            inside |= (block.t_s >= start) & (block.t_s <= end)
        yield replace(block, gyro_dps=np.where(inside, np.nan, block.gyro_dps))


def less(blocks: Iterator[Block], off: Callable[[Block], Floats]) -> Iterator[Block]:
    """The blocks less what `off` says of each; a sample of which it says NaN is missing."""
    for block in blocks:
        yield replace(block, gyro_dps=block.gyro_dps - off(block))


def without_glitches(blocks: Iterator[Block], aside_s: list[float]) -> Iterator[Block]:
    """The blocks with the median of five samples in place of single ones that stand by themselves, whose times go to `aside_s`.

    They are set aside where more of them are that far off than are on the way there: a noise of heavy tails stays as it is.
    """
    for block in blocks:
        good = np.isfinite(block.gyro_dps)
        gyro_dps = block.gyro_dps[good]
        moved_dps = np.abs(np.diff(gyro_dps))
        if moved_dps.size < _LEAST_SAMPLES or not moved_dps.any():
            yield block
            continue
        middle_dps = ndimage.median_filter(gyro_dps, 5, mode="nearest")
        # A noise that is hidden by steps may be as large as one.
        scatter_dps = max(
            STDS_PER_MAD * float(np.median(moved_dps)) / np.sqrt(2.0), float(moved_dps[moved_dps > 0].min())
        )
        off_dps = np.abs(gyro_dps - middle_dps)
        alone = off_dps > _ALONE * scatter_dps
        if not alone.sum() > np.count_nonzero(off_dps[~alone] > _ON_THE_WAY * scatter_dps):
            yield block
            continue
        aside_s += block.t_s[good][alone].tolist()
        filled_dps = block.gyro_dps.copy()
        filled_dps[good] = np.where(alone, middle_dps, gyro_dps)
        yield replace(block, gyro_dps=filled_dps)
