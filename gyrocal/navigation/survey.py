"""A first look at a drive log, in one pass and bounded memory: what is in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.lost_ways import GAP_STEPS, LACKS_A_ROW
from gyrocal.records.drive import UNUSED_STEERING, DriveBlock
from gyrocal.units import RAD_TO_DEG, plural

Floats = NDArray[np.float64]

#: Distances and turns are summed over bins of this length.
BIN_S = 0.2
#: Turns are compared over sliding windows: short beside a turn to find a delay, long beside a delay otherwise.
DELAY_WINDOW_S, WINDOW_S = 1.0, 5.0
#: Delays up to this are looked for.
MAX_DELAY_S = 1.0
#: Below this angle, summed over windows, the log has no turns that anything could be learnt from.
MIN_TURN_DEG = 20.0
#: No gyro of a robot reads so much: in few rows it is a cell gone wrong, in many the channel has another unit.
_BEYOND_DPS = 4000.0
#: A gyro that reads one number for longer is looked at, s.
_HELD_S = 2.0
#: Rows further apart than this lose the course of a turn where the gyro is sampled: on 15 made-up drives thinned to 10, 5, 2
#: and 1 rows a second the path errs 1.2, 1.8, 4 and 15 times as much, and 0.98, 0.97, 0.9 and 1.4 times by means over each row.
SLOW_S = 0.2
#: Wheels of a robot that turns go apart by more than this share of their way, even on a square kilometre; rounding of a speed
#: that is written twice makes less.
_ONE_SPEED = 1e-4
#: Sides that count one way each lie apart by so many times their largest difference in a row at the most, so often. On 12 made-up
#: logs they did by 1.6 times, 2,000 times and more; on 126 of two wheels by 43 times at least.
_TICKS_APART, _AND_AGAIN = 3.0, 20.0
#: The usual time step is the median of this many; as many of the longest are looked at for gaps.
_STEPS = 10_000


@dataclass(frozen=True)
class Survey:
    """What a drive log holds; see `survey`.

    Attributes
    ----------
    bin_s : ndarray, shape (bins,)
        Ends of the bins that hold rows, from the start of the log.
    left_m, right_m, gyro_deg : ndarray, shape (bins,)
        Sums over the bins.
    bad_gyro, bad_encoder, late_counts, duplicates, gaps : int
        Rows with an empty cell; rows without a count, whose way the next one tells; rows with the time of the row before;
        steps above 5 times the usual one.
    leaps : int
        Steps in which a row is missing or several are, but no gap.
    known : ndarray of bool, shape (bins,)
        Whether no cell of gyro or wheels is empty in the bin.
    fastest_line : int
        Line of the largest rate.
    held_s : tuple of (float, float)
        From when to when the gyro read one number, where that was for long.
    said : tuple of str
        What the reader bridged, closed or left out.
    speed_only : bool
        One speed of the vehicle: left and right are both its way, and tell nothing of turns.
    """

    source: str
    rows: int
    t_start_s: float
    t_end_s: float
    usual_dt_s: float
    bin_s: Floats = field(repr=False)
    left_m: Floats = field(repr=False)
    right_m: Floats = field(repr=False)
    gyro_deg: Floats = field(repr=False)
    known: NDArray[np.bool_] = field(repr=False)
    bad_gyro: int
    bad_encoder: int
    late_counts: int
    duplicates: int
    gaps: int
    leaps: int
    truth_rows: int
    truth_headings: int
    half_fixes: int
    temp_rows: int
    temp_c: tuple[float, float]
    gyro_dps: tuple[float, float]
    fastest_line: int
    beyond_rows: int
    max_speed_mps: float
    longest_extreme: int
    held_s: tuple[tuple[float, float], ...]
    said: tuple[str, ...] = ()
    speed_only: bool = False

    @property
    def duration_s(self) -> float:
        """From the first to the last row."""
        return self.t_end_s - self.t_start_s

    @property
    def distance_m(self) -> float:
        """Distance by the encoders, mean of both sides."""
        return float(0.5 * (self.left_m + self.right_m).sum())

    @property
    def fastest_dps(self) -> float:
        """Size of the largest rate."""
        return max(map(abs, self.gyro_dps))

    def turns_deg(self, wheel_separation_m: float) -> Floats:
        """Turns by the wheels over the bins, shape (bins,)."""
        return np.asarray((self.right_m - self.left_m) / wheel_separation_m * RAD_TO_DEG)

    def notes(self) -> tuple[str, ...]:
        """What was found and bridged, in words."""
        found = (
            (self.bad_gyro, "[row|rows] without a gyro sample"),
            (self.bad_encoder, "[row|rows] without an encoder sample"),
            (
                self.late_counts,
                "[row|rows] without a count of the wheels, whose way stands in the next one that has",
            ),
            (self.duplicates, "[row|rows] with the time of the row before"),
            (self.gaps, f"[gap|gaps] of more than {GAP_STEPS:g} usual steps"),
            (
                self.half_fixes,
                "[row has|rows have] one of truth_x_m and truth_y_m only, which is no position, and [is|are] not used as one",
            ),
        )
        said = [*self.said, *(f"{n} {plural(n, what)}" for n, what in found if n)]
        if self.usual_dt_s > SLOW_S:
            said.append(
                f"a row every {self.usual_dt_s:.2g} s: if gyro_dps is a sample, what the robot turned between two rows is lost, and with it accuracy of the path; log the mean rate since the row before, or every {SLOW_S:g} s or closer"
            )
        return tuple(said)


def survey(source: str, blocks: Iterable[DriveBlock]) -> Survey:
    """Read a log once and count what is in it. Raises what the reader raises."""
    tally = _Tally()
    for block in blocks:
        tally.add(block)
    return tally.result(source)


class _Tally:
    """Running sums of a survey."""

    def __init__(self) -> None:
        self.rows = self.bad_gyro = self.bad_encoder = self.late_counts = self.duplicates = 0
        self.truth_rows = self.truth_headings = self.temp_rows = 0
        self.t_start_s = self.t_end_s = np.nan
        self.temp_c = self.gyro_dps = (np.inf, -np.inf)
        self.fastest_line = self.beyond_rows = self.half_fixes = 0
        self.max_speed_mps = self.max_way_m = 0.0
        self.run_dps, self.run_rows, self.run_since_s = np.nan, 0, np.nan
        self.held_s: dict[float, float] = {}
        self.extreme_rows: dict[float, int] = {}
        self.windows: list[Floats] = []
        self.open_index, self.open_sum = -1, np.zeros(5)
        self.said: list[str] = []
        self.speed_only = False
        self.first_steps, self.long_steps = np.empty(0), np.empty(0)

    def add(self, block: DriveBlock) -> None:
        t_s = block.t_s
        self.said += block.notes
        if UNUSED_STEERING not in self.said and np.isfinite(block.steering_deg).any():
            self.said.append(UNUSED_STEERING)
        self.speed_only = block.speed_only
        first = self.rows == 0
        if first:
            self.t_start_s = self.t_end_s = float(t_s[0])
        dt_s = np.diff(t_s, prepend=self.t_end_s)
        self.rows += len(block)
        self.t_end_s = float(t_s[-1])
        gyro, encoder = np.isfinite(block.gyro_dps), np.isfinite(block.left_m + block.right_m)
        self.bad_gyro += int(np.count_nonzero(~gyro))
        self.bad_encoder += int(np.count_nonzero(~encoder))
        self.late_counts += block.late_counts
        self.duplicates += int(np.count_nonzero(dt_s == 0.0)) - first
        self.truth_rows += int(np.count_nonzero(np.isfinite(block.truth_x_m + block.truth_y_m)))
        self.truth_headings += int(np.count_nonzero(np.isfinite(block.truth_heading_deg)))
        self.temp_rows += int(np.count_nonzero(np.isfinite(block.gyro_temp_c)))
        self.temp_c = _widen(self.temp_c, block.gyro_temp_c)
        fastest = np.nan_to_num(np.abs(block.gyro_dps))
        if fastest.max() > max(self.gyro_dps[1], -self.gyro_dps[0]):
            self.fastest_line = block.first_line + int(np.argmax(fastest))
        self.beyond_rows += int(np.count_nonzero(fastest > _BEYOND_DPS))
        self.half_fixes += int(np.count_nonzero(np.isfinite(block.truth_x_m) ^ np.isfinite(block.truth_y_m)))
        self.gyro_dps = _widen(self.gyro_dps, block.gyro_dps)
        moved = encoder & (dt_s > 0)
        way = 0.5 * (np.abs(block.left_m) + np.abs(block.right_m))[moved]
        self.max_way_m = max(self.max_way_m, float(way.max(initial=0.0)))
        self.max_speed_mps = max(self.max_speed_mps, float((way / dt_s[moved]).max(initial=0.0)))
        positive = dt_s[dt_s > 0]
        if self.first_steps.size < _STEPS:
            self.first_steps = np.concatenate((self.first_steps, positive[:_STEPS]))[:_STEPS]
        self.long_steps = np.sort(np.concatenate((self.long_steps, positive)))[-_STEPS:]
        self._same(t_s, block.gyro_dps)
        self._window(block, dt_s)

    def _same(self, t_s: Floats, gyro_dps: Floats) -> None:
        """Runs of one gyro value: the longest in time, and the longest at each block's extremes."""
        starts = np.flatnonzero(np.diff(gyro_dps, prepend=np.nan) != 0)
        rows, since_s = np.diff(starts, append=gyro_dps.size), t_s[starts]
        if gyro_dps[0] == self.run_dps:
            rows[0] += self.run_rows
            since_s[0] = self.run_since_s
        until_s = t_s[np.append(starts[1:], gyro_dps.size) - 1]
        long = until_s - since_s > _HELD_S
        self.held_s |= zip(since_s[long].tolist(), until_s[long].tolist(), strict=True)
        values = gyro_dps[starts]
        for extreme_dps in _widen((np.inf, -np.inf), values):
            here = int(rows[values == extreme_dps].max(initial=0))
            self.extreme_rows[extreme_dps] = max(here, self.extreme_rows.get(extreme_dps, 0))
        self.run_dps, self.run_rows, self.run_since_s = float(values[-1]), int(rows[-1]), float(since_s[-1])

    def _window(self, block: DriveBlock, dt_s: Floats) -> None:
        channels = np.stack([block.left_m, block.right_m, block.gyro_dps * dt_s])
        empty = ~np.isfinite(channels)
        channels = np.vstack([np.where(empty, 0.0, channels), empty.any(axis=0)])
        index = np.floor((block.t_s - self.t_start_s) / BIN_S).astype(np.int64)
        starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        sums = np.add.reduceat(channels, starts, axis=1)
        sums = np.vstack([(index[starts] + 1) * BIN_S, sums])
        if index[0] == self.open_index:
            sums[1:, 0] += self.open_sum[1:]
        elif self.open_index >= 0:
            self.windows.append(self.open_sum[:, None])
        self.windows.append(sums[:, :-1])
        self.open_index, self.open_sum = int(index[-1]), sums[:, -1]

    def result(self, source: str) -> Survey:
        bin_s, left, right, gyro, empty = np.concatenate([*self.windows, self.open_sum[:, None]], axis=1)
        usual_dt_s = float(np.median(self.first_steps)) if self.first_steps.size else 0.0
        gap = self.long_steps > GAP_STEPS * usual_dt_s
        leap = (self.long_steps > LACKS_A_ROW * usual_dt_s) & ~gap
        fastest_dps = max(map(abs, self.gyro_dps))
        return Survey(
            source,
            self.rows,
            self.t_start_s,
            self.t_end_s,
            usual_dt_s,
            bin_s,
            left,
            right,
            gyro,
            empty == 0.0,
            self.bad_gyro,
            self.bad_encoder,
            self.late_counts,
            self.duplicates,
            int(np.count_nonzero(gap)),
            int(np.count_nonzero(leap)),
            self.truth_rows,
            self.truth_headings,
            self.half_fixes,
            self.temp_rows,
            self.temp_c,
            self.gyro_dps,
            self.fastest_line,
            self.beyond_rows,
            # A stamp that comes early makes its row fast, whose way is an ordinary one.
            min(self.max_speed_mps, self.max_way_m / usual_dt_s) if usual_dt_s else self.max_speed_mps,
            # Of a robot that turns one way only the other extreme is what it reads at rest.
            max(
                (self.extreme_rows.get(v, 0) for v in self.gyro_dps if 2.0 * abs(v) > fastest_dps), default=0
            ),
            tuple(self.held_s.items()),
            tuple(self.said),
            self.speed_only or one_speed(left, right),
        )


def one_speed(left_m: Floats, right_m: Floats) -> bool:
    """Whether the distances of both sides are one vehicle's speed written twice, or counted in ticks of each."""
    apart = right_m - left_m
    whole = float(np.sum(np.abs(apart)))
    if whole <= _ONE_SPEED * float(np.sum(np.abs(right_m))):
        return True
    # Counts of one way part by a tick and come together again; those of a robot that turns do not.
    range_m = float(np.ptp(np.cumsum(apart)))
    return range_m <= _TICKS_APART * float(np.max(np.abs(apart))) and whole >= _AND_AGAIN * range_m


def _widen(span: tuple[float, float], values: Floats) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    return (
        (min(span[0], float(finite.min())), max(span[1], float(finite.max())))
        if finite.size
        else (span[0], span[1])
    )


def sliding(found: Survey, sums: Floats, window_s: float, delay_s: float = 0.0) -> Floats:
    """Sum over a window that slides by a bin, looked at `delay_s` later; the same times for every delay."""
    total = np.cumsum(sums)
    first, last = found.bin_s[0] + MAX_DELAY_S, found.bin_s[-1] - window_s - MAX_DELAY_S
    start_s = np.arange(first, max(last, first + BIN_S), BIN_S) + delay_s
    return np.asarray(
        np.interp(start_s + window_s, found.bin_s, total) - np.interp(start_s, found.bin_s, total)
    )
