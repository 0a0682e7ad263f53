"""Data sets with what the coefficients leave of them, and a run's course in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.apply import hold
from gyrocal.calibration.datasets import DataSets
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.run import Run, Segment

Floats = NDArray[np.float64]

#: Points of a curve over time that a page can still show.
_CURVE_POINTS = 4000


@dataclass(frozen=True)
class Examined:
    """Data sets in time order and the error that the coefficients leave in them; arrays of shape (n,).

    Attributes
    ----------
    residual_dps : ndarray
        Corrected output minus reference rate.
    covariance_dps2 : ndarray, shape (n, n)
        Covariance expected of the residuals: estimated scatter with its drift in time, and the coefficients.
    marked : ndarray of bool
        Outliers and unsettled data sets: drawn hollow, never dropped.
    """

    sets: DataSets
    residual_dps: Floats
    covariance_dps2: Floats
    marked: NDArray[np.bool_]

    @property
    def sigma_dps(self) -> Floats:
        """Standard deviation expected of each residual."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance_dps2), 0.0)))


@dataclass(frozen=True)
class Span:
    """A segment on the time axis."""

    start_s: float
    end_s: float
    rate_dps: float
    kind: str
    outcome: str


@dataclass(frozen=True)
class Timeline:
    """The course of a run; curves are thinned to what a page shows."""

    gyro_temp_t_s: Floats
    gyro_temp_c: Floats
    chamber_t_s: Floats
    chamber_temp_c: Floats
    supply_t_s: Floats
    supply_v: Floats
    spans: tuple[Span, ...]


def read_course(run: Run, compensator: Compensator | None) -> tuple[Timeline, dict[int, float]]:
    """Read a run once more, in bounded memory: its course in time, and corrected means where terms need history.

    Parameters
    ----------
    compensator : Compensator or None
        With terms that depend on what went before; every sample then goes through it in the order of time.

    Returns
    -------
    timeline : Timeline
    corrected_dps : dict
        Mean corrected rate of the good samples of each segment, by its id; empty without compensator.
    """
    step = max(1, sum(record.n for record in run.segments) // _CURVE_POINTS)
    parts: list[Segment] = []
    sums: dict[int, tuple[float, int]] = {}
    last_c = last_v = float("nan")
    for record in run.segments:
        for block in run.iterate_segment(record):
            parts.append(_thinned(block, step))
            if compensator is None:
                continue
            temp_c, last_c = hold(block.gyro_temp_c, last_c)
            since_s = None if run.power_on_t_s is None else block.t_s - run.power_on_t_s
            supply_v, last_v = block.supply_held(last_v)
            rate_dps = compensator.correct(block.t_s, block.gyro_dps, temp_c, since_s, supply_v)
            good = block.good & np.isfinite(rate_dps)
            total, count = sums.get(record.id, (0.0, 0))
            sums[record.id] = total + float(rate_dps[good].sum()), count + int(good.sum())
    corrected = {segment: total / count for segment, (total, count) in sums.items() if count}
    return _timeline(run, parts), corrected


def _timeline(run: Run, parts: list[Segment]) -> Timeline:
    def curve(time: str, value: str) -> tuple[Floats, Floats]:
        t = np.concatenate([getattr(p, time) for p in parts])
        v = np.concatenate([getattr(p, value) for p in parts])
        known = np.isfinite(v)
        return t[known], v[known]

    spans = tuple(Span(r.t_start_s, r.t_end_s, r.rate_dps, r.kind, r.outcome) for r in run.segments)
    return Timeline(
        *curve("t_s", "gyro_temp_c"),
        *curve("bench_t_s", "chamber_temp_c"),
        *curve("bench_t_s", "supply_v"),
        spans,
    )


def _thinned(block: Segment, step: int) -> Segment:
    """Every `step`-th gyro sample of a block, and about as many bench readings."""
    bench_step = max(1, step * block.bench_t_s.size // max(1, block.t_s.size))
    gyro = ("t_s", "gyro_dps", "gyro_temp_c", "status")
    bench = ("bench_t_s", "table_rate_dps", "table_angle_deg", "chamber_temp_c", "supply_v")
    return Segment(
        block.record,
        *(getattr(block, name)[::step] for name in gyro),
        *(getattr(block, name)[::bench_step] for name in bench),
    )
