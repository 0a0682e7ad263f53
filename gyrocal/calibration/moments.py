"""Sums over samples that merge: exact means and variances in one pass (Chan, Golub, LeVeque 1983)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.run import Segment
from gyrocal.units import S_PER_MIN

Floats = NDArray[np.float64]

#: Fewer readings than this say nothing of their own scatter about a straight line; each is then as good as 36 arcsec.
_LEAST_FOR_SCATTER, _READING_DEG = 4, 0.01


@dataclass(frozen=True)
class Sums:
    """Number, mean, centred sum of squares and extremes of values; ``whole``: all are whole numbers."""

    n: int = 0
    mean: float = math.nan
    squares: float = 0.0
    low: float = math.inf
    high: float = -math.inf
    n_low: int = 0
    n_high: int = 0
    whole: bool = True

    @property
    def peak(self) -> float:
        """Largest distance of a value from the mean."""
        return max(self.high - self.mean, self.mean - self.low)

    def std(self) -> float:
        """Sample standard deviation; NaN for fewer than two values."""
        return math.sqrt(self.squares / (self.n - 1)) if self.n > 1 else math.nan

    def within(self, sigmas: float) -> tuple[float, float]:
        """Lowest and highest value, at most `sigmas` standard deviations from the mean."""
        reach = sigmas * self.std() if self.n > 1 else 0.0
        return max(self.low, self.mean - reach), min(self.high, self.mean + reach)

    def merge(self, other: Sums) -> Sums:
        """Sums of both groups of values together."""
        if self.n == 0 or other.n == 0:
            return self if other.n == 0 else other
        n = self.n + other.n
        step = other.mean - self.mean
        low, high = min(self.low, other.low), max(self.high, other.high)
        return Sums(
            n=n,
            mean=self.mean + step * other.n / n,
            squares=self.squares + other.squares + step * step * self.n * other.n / n,
            low=low,
            high=high,
            n_low=sum(s.n_low for s in (self, other) if s.low == low),
            n_high=sum(s.n_high for s in (self, other) if s.high == high),
            whole=self.whole and other.whole,
        )


def sums_of(values: Floats, *, integers: bool = False) -> Sums:
    """Sums of finite `values`; `integers` asks whether all are whole numbers (a pass more)."""
    if values.size == 0:
        return Sums()
    low, high = float(values.min()), float(values.max())
    # The sum is taken of the distance from one value: a mean far from zero costs no digits.
    centred = values - values[0]
    offset = float(centred.mean())
    centred -= offset
    return Sums(
        n=int(values.size),
        mean=float(values[0]) + offset,
        squares=float(centred @ centred),
        low=low,
        high=high,
        n_low=int(np.count_nonzero(values == low)),
        n_high=int(np.count_nonzero(values == high)),
        whole=bool(np.all(values == np.rint(values))) if integers else False,
    )


@dataclass(frozen=True)
class SegmentSums:
    """What remains of a segment: sums of gyro, temperature and table, and its ends in time.

    ``angle`` is what the table angle departs from the motion that was commanded: the angle itself grows to numbers
    beside which the noise of its readings is lost in rounding.
    """

    gyro: Sums = Sums()
    temp: Sums = Sums()
    table_rate: Sums = Sums()
    time: Sums = Sums()
    time_temp: float = 0.0
    chamber: Sums = Sums()
    chamber_time: Sums = Sums()
    chamber_time_temp: float = 0.0
    t_first_s: float = math.nan
    t_last_s: float = math.nan
    angle: Sums = Sums()
    angle_time: Sums = Sums()
    angle_time_angle: float = 0.0
    bad_status: int = 0
    non_finite: int = 0

    @property
    def span_s(self) -> float:
        """Time from the first good sample to the last."""
        return self.t_last_s - self.t_first_s

    @property
    def angle_span_s(self) -> float:
        """Time from the first angle to the last; 0 without two angles."""
        return self.angle_time.high - self.angle_time.low if self.angle.n > 1 else 0.0

    def angle_slope_dps(self) -> tuple[float, float] | None:
        """How much faster than commanded the angle moves, and the standard error of that; None without two angles.

        The slope over time by least squares, with the scatter of the readings about it.
        """
        if self.angle.n < 2 or not self.angle_time.squares > 0:
            return None
        slope = self.angle_time_angle / self.angle_time.squares
        if self.angle.n < _LEAST_FOR_SCATTER:
            return slope, _READING_DEG / math.sqrt(self.angle_time.squares)
        left = max(self.angle.squares - slope * self.angle_time_angle, 0.0) / (self.angle.n - 2)
        return slope, math.sqrt(left / self.angle_time.squares)

    def temp_rate_c_per_min(self) -> float:
        """Slope of the temperature over time by least squares; NaN where all samples share one time."""
        return self.time_temp / self.time.squares * S_PER_MIN if self.time.squares > 0 else math.nan

    def by_chamber(self) -> SegmentSums:
        """The same with the chamber's temperature in the place of the gyro's own."""
        return replace(self, temp=self.chamber, time=self.chamber_time, time_temp=self.chamber_time_temp)

    def merge(self, after: SegmentSums) -> SegmentSums:
        """Sums of this block and the one `after` it in time."""
        return SegmentSums(
            gyro=self.gyro.merge(after.gyro),
            temp=self.temp.merge(after.temp),
            table_rate=self.table_rate.merge(after.table_rate),
            time=self.time.merge(after.time),
            time_temp=self.time_temp + after.time_temp + _cross(self.time, self.temp, after.time, after.temp),
            chamber=self.chamber.merge(after.chamber),
            chamber_time=self.chamber_time.merge(after.chamber_time),
            chamber_time_temp=self.chamber_time_temp
            + after.chamber_time_temp
            + _cross(self.chamber_time, self.chamber, after.chamber_time, after.chamber),
            t_first_s=after.t_first_s if math.isnan(self.t_first_s) else self.t_first_s,
            t_last_s=self.t_last_s if math.isnan(after.t_last_s) else after.t_last_s,
            angle=self.angle.merge(after.angle),
            angle_time=self.angle_time.merge(after.angle_time),
            angle_time_angle=self.angle_time_angle
            + after.angle_time_angle
            + _cross(self.angle_time, self.angle, after.angle_time, after.angle),
            bad_status=self.bad_status + after.bad_status,
            non_finite=self.non_finite + after.non_finite,
        )


def _cross(t_before: Sums, before: Sums, t_after: Sums, after: Sums) -> float:
    """What merging two groups adds to the centred sum of products of time and value."""
    both = before.n * after.n
    if not both:
        return 0.0
    return (t_after.mean - t_before.mean) * (after.mean - before.mean) * both / (before.n + after.n)


def _product(t_s: Floats, time: Sums, values: Floats, sums: Sums) -> float:
    """Centred sum of products of times and values."""
    return float((t_s - time.mean) @ (values - sums.mean)) if values.size else 0.0


#: A segment of no samples.
EMPTY = SegmentSums()


def sums_of_block(block: Segment) -> SegmentSums:
    """Reduce one block of a segment. Samples of bad status or not finite are counted and left out."""
    finite, status_good = np.isfinite(block.gyro_dps), block.status == 0
    good = finite & status_good
    everything = bool(good.all())
    t_s, gyro_dps, temp_c = (
        v if everything else v[good] for v in (block.t_s, block.gyro_dps, block.gyro_temp_c)
    )
    warm = np.isfinite(temp_c)
    temp, temp_t_s = (temp_c, t_s) if warm.all() else (temp_c[warm], t_s[warm])
    temp_sums, time_sums = sums_of(temp, integers=True), sums_of(temp_t_s)
    aired = np.isfinite(block.chamber_temp_c)
    air, air_t_s = block.chamber_temp_c[aired], block.bench_t_s[aired]
    air_sums, air_time_sums = sums_of(air, integers=True), sums_of(air_t_s)
    seen = np.isfinite(block.table_angle_deg)
    angle_t_s = block.bench_t_s[seen]
    angle = block.table_angle_deg[seen] - block.record.rate_dps * (angle_t_s - block.record.t_start_s)
    angle_sums, angle_time_sums = sums_of(angle), sums_of(angle_t_s)
    return SegmentSums(
        gyro=sums_of(gyro_dps),
        temp=temp_sums,
        table_rate=sums_of(block.table_rate_dps[np.isfinite(block.table_rate_dps)]),
        time=time_sums,
        time_temp=_product(temp_t_s, time_sums, temp, temp_sums),
        chamber=air_sums,
        chamber_time=air_time_sums,
        chamber_time_temp=_product(air_t_s, air_time_sums, air, air_sums),
        t_first_s=float(t_s[0]) if t_s.size else math.nan,
        t_last_s=float(t_s[-1]) if t_s.size else math.nan,
        angle=angle_sums,
        angle_time=angle_time_sums,
        angle_time_angle=_product(angle_t_s, angle_time_sums, angle, angle_sums),
        bad_status=int(np.count_nonzero(~status_good)),
        non_finite=int(np.count_nonzero(~finite & status_good)),
    )
