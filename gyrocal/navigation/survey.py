"""A first look at a drive log, in one pass and bounded memory: what is in it, and whether its channels can be right."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.navigation.sanity import turn_part_fault
from gyrocal.records.drive import UNUSED_STEERING, DriveBlock
from gyrocal.records.leaps import FASTEST_ROBOT_MPS, FASTEST_VEHICLE_MPS
from gyrocal.records.scale import WORST_SCALE, odd_temperature
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG, plural

Floats = NDArray[np.float64]

#: Distances and turns are summed over bins of this length.
BIN_S = 0.2
#: Turns are compared over sliding windows: short beside a turn to find a delay, long beside a delay otherwise.
DELAY_WINDOW_S, WINDOW_S = 1.0, 5.0
#: Delays up to this are looked for.
MAX_DELAY_S = 1.0
#: Below this angle, summed over windows, the log has no turns that anything could be learnt from.
MIN_TURN_DEG = 20.0
#: A correlation of encoder and gyro turns that no sound pair of channels falls below, and one that only a
#: sound pair reaches.
_CORRELATION_BAD, _CORRELATION_GOOD = 0.3, 0.7
#: deg/s logged as rad/s (or the reverse) changes the ratio by 57.3; half of that on a log scale is the border.
_UNIT_BORDER = RAD_TO_DEG**0.5
_MAX_BAD_SHARE = 0.05
#: No robot turns so fast for a twentieth of a drive, not even in degrees that were converted twice: 55 turns a second.
_FASTEST_DPS, _FASTEST_SHARE = 20_000.0, 0.05
#: No gyro of a robot reads so much: in fewer rows than that share it is a cell gone wrong, in more the channel has another unit.
_BEYOND_DPS = 4000.0
#: A gyro with coarse bits repeats itself by chance: 5 equal rows at the extreme came up once in 4,000 sound logs.
_SATURATED_ROWS = 10
_STUCK_S = 2.0
#: Rows further apart than this lose the course of a turn where the gyro is sampled: on 15 made-up drives thinned to 10, 5, 2
#: and 1 rows a second the path errs 1.2, 1.8, 4 and 15 times as much, and 0.98, 0.97, 0.9 and 1.4 times by means over each row.
SLOW_S = 0.2
#: What no vehicle does across its way in a twentieth of the time that it moves, twice what tyres hold; and turns which one that
#: goes round corners exceeds in a hundredth of it: a radian a second that is read as a degree a second is as slow as these.
_ACROSS_MPS2, _SLOW_TURNS_DPS, _RARELY = 20.0, 2.0, 0.99
#: Wheels that roll less than this over a window stand.
_STILL_M = 1e-3
#: Wheels of a robot that turns go apart by more than this share of their way, even on a square kilometre; rounding of a speed
#: that is written twice makes less.
_ONE_SPEED = 1e-4
#: Sides that count one way each lie apart by so many times their largest difference in a row at the most, so often. On 12 made-up
#: logs they did by 1.6 times, 2,000 times and more; on 126 of two wheels by 43 times at least.
_TICKS_APART, _AND_AGAIN = 3.0, 20.0
#: The usual time step is the median of this many; as many of the longest are looked at for gaps.
_STEPS = 10_000

#: What a wrong encoder does to (left, right): name -> signs of left and right in the turn.
_HYPOTHESES: tuple[tuple[str, float, float], ...] = (
    ("the gyro's sign is inverted, or left and right encoders are swapped", 1.0, -1.0),
    ("the left encoder's sign is inverted", 1.0, 1.0),
    ("the right encoder's sign is inverted", -1.0, -1.0),
)


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
    fastest_line : int
        Line of the largest rate.
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
    bad_gyro: int
    bad_encoder: int
    late_counts: int
    duplicates: int
    gaps: int
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
    longest_same_s: float
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
            (self.gaps, "[gap|gaps] of more than 5 usual steps"),
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
        self.longest_same_s = 0.0
        self.extreme_rows: dict[float, int] = {}
        self.windows: list[Floats] = []
        self.open_index, self.open_sum = -1, np.zeros(4)
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
        way = 0.5 * np.abs(block.left_m + block.right_m)[moved]
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
        self.longest_same_s = max(self.longest_same_s, float(np.max(until_s - since_s)))
        values = gyro_dps[starts]
        for extreme_dps in _widen((np.inf, -np.inf), values):
            here = int(rows[values == extreme_dps].max(initial=0))
            self.extreme_rows[extreme_dps] = max(here, self.extreme_rows.get(extreme_dps, 0))
        self.run_dps, self.run_rows, self.run_since_s = float(values[-1]), int(rows[-1]), float(since_s[-1])

    def _window(self, block: DriveBlock, dt_s: Floats) -> None:
        channels = np.stack([block.left_m, block.right_m, block.gyro_dps * dt_s])
        channels = np.where(np.isfinite(channels), channels, 0.0)
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
        bin_s, left, right, gyro = np.concatenate([*self.windows, self.open_sum[:, None]], axis=1)
        usual_dt_s = float(np.median(self.first_steps)) if self.first_steps.size else 0.0
        gaps = int(np.count_nonzero(self.long_steps > 5.0 * usual_dt_s))
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
            self.bad_gyro,
            self.bad_encoder,
            self.late_counts,
            self.duplicates,
            gaps,
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
            max(self.extreme_rows.get(value, 0) for value in self.gyro_dps)
            if self.rows > self.bad_gyro
            else 0,
            self.longest_same_s,
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


def check_cells(
    name: str, rows: int, bad_gyro: int, bad_encoder: int, gyro_dps: Floats, temp_c: Floats
) -> None:
    """Refuse a log of many empty cells, rates that no robot has, or temperatures that no gyro has.

    Parameters
    ----------
    gyro_dps : the known rates, or means over bins
    temp_c : the known temperatures, at least the extremes

    Raises
    ------
    DataError
    """
    for bad, what in ((bad_gyro, "gyro_dps"), (bad_encoder, "left or right distance")):
        if bad > _MAX_BAD_SHARE * rows:
            msg = f"{name}: {what} is empty in {bad} of {rows} rows; up to {_MAX_BAD_SHARE:.0%} can be bridged. Repair the log."
            raise DataError(msg)
    fast_dps = float(np.quantile(np.abs(gyro_dps), 1.0 - _FASTEST_SHARE)) if gyro_dps.size else 0.0
    if fast_dps > _FASTEST_DPS:
        msg = f"{name}: gyro_dps is beyond {fast_dps:,.0f} deg/s in a twentieth of the drive, and no robot turns so fast: it is in deg/h, or in counts. Write it in deg/s, or state its unit in a mapping with --columns."
        raise DataError(msg)
    odd = odd_temperature(temp_c) if temp_c.size else None
    if odd is not None:
        raise DataError(f"{name}: {odd.what}. {odd.remedy}.")


def check_speed(name: str, fast_mps: float, *, speed_only: bool) -> None:
    """Refuse a way that no vehicle goes: another unit, or totals where a row holds what it adds.

    Raises
    ------
    DataError
    """
    if fast_mps > (FASTEST_VEHICLE_MPS if speed_only else FASTEST_ROBOT_MPS):
        if speed_only:
            msg = f"{name}: the vehicle goes {fast_mps:,.0f} m/s by its column of speed or distance, and none is so fast: speed_mps is in m/s, speed_m in metres since the row before. Correct that column, or state its unit in a mapping with --columns."
            raise DataError(msg)
        msg = f"{name}: the encoders say {fast_mps:.3g} m/s; left_m and right_m are distances since the row before, in metres. left_ticks and right_ticks are counts since the start. Check unit and metres_per_tick, or map the columns with --columns."
        raise DataError(msg)


def check(found: Survey, wheel_separation_m: float) -> tuple[str, ...]:
    """Refuse a log whose channels cannot be right, and say what is doubtful.

    Raises
    ------
    DataError
        Nothing moves, no turns, a channel that is stuck, saturated or mostly empty, encoders and gyro that
        disagree in sign or unit, temperatures that no gyro has.
    """
    name = found.source
    temp_c = np.array(found.temp_c if found.temp_rows else ())
    check_cells(name, found.rows, found.bad_gyro, found.bad_encoder, found.gyro_deg / BIN_S, temp_c)
    fastest_dps = max(abs(v) for v in found.gyro_dps)
    few = 0 < found.beyond_rows < _FASTEST_SHARE * found.rows
    if found.rows > found.bad_gyro and (few or fastest_dps > _FASTEST_DPS):
        msg = f"{name}, line {found.fastest_line}: gyro_dps is {fastest_dps:,.0f} deg/s in size, and no robot turns so fast. Repair the cell or leave it empty: it is bridged."
        raise DataError(msg)
    if found.duration_s <= 0:
        raise DataError(f"{name}: all rows carry the same time. Check the clock of the logger.")
    check_speed(name, found.max_speed_mps, speed_only=found.speed_only)
    _check_stuck(found, wheel_separation_m)
    return _check_rates(found) if found.speed_only else _check_turns(found, wheel_separation_m)


def _check_stuck(found: Survey, separation_m: float) -> None:
    name = found.source
    left, right = (float(np.abs(side).sum()) for side in (found.left_m, found.right_m))
    if max(left, right) < 1.0:
        raise DataError(
            f"{name}: the encoders move {max(left, right):.3g} m in all: the robot stood, or both are stuck."
        )
    for low, high, side in ((left, right, "left"), (right, left, "right")):
        if low < 0.01 * high:
            msg = f"{name}: the {side} encoder moves {low:.3g} m while the other moves {high:.3g} m; it is stuck. Check its cable."
            raise DataError(msg)
    turned_deg = float(np.abs(found.right_m - found.left_m).sum()) / separation_m * RAD_TO_DEG
    if found.gyro_dps[0] == found.gyro_dps[1]:
        msg = f"{name}: gyro_dps is {found.gyro_dps[0]:g} in every row while the encoders turn {turned_deg:.0f} deg; the gyro is stuck. Check its cable."
        raise DataError(msg)
    if found.longest_same_s > _STUCK_S and found.longest_same_s > 0.25 * found.duration_s:
        msg = f"{name}: gyro_dps does not change for {found.longest_same_s:.0f} s of {found.duration_s:.0f} s; the gyro is stuck. Check its cable."
        raise DataError(msg)
    standing_deg = 0.0 if found.speed_only else _turned_standing_deg(found)
    if standing_deg > MIN_TURN_DEG:
        msg = f"{name}: the gyro turns {standing_deg:.0f} deg within {WINDOW_S:g} s in which neither encoder moves; both are stuck, or the robot was turned by hand. Check their cables."
        raise DataError(msg)
    worst_dps = max(abs(v) for v in found.gyro_dps)
    if found.longest_extreme >= _SATURATED_ROWS and worst_dps > 10.0:
        msg = f"{name}: gyro_dps stays at its extreme ({found.gyro_dps[0]:g} or {found.gyro_dps[1]:g} deg/s) for {found.longest_extreme} rows in a row; it is saturated. Drive slower turns or use a gyro of a wider range."
        raise DataError(msg)


def _turned_standing_deg(found: Survey) -> float:
    """The most that the gyro turns in a window in which no wheel moves; each that stops alone would show in the turns."""
    moved_m = sliding(found, np.abs(found.left_m) + np.abs(found.right_m), WINDOW_S)
    gyro = sliding(found, found.gyro_deg, WINDOW_S)
    # Neither a bias (which the median has) nor a circle (which the median is) may look like a turn at rest.
    turned = np.minimum(np.abs(gyro), np.abs(gyro - np.median(gyro)))[moved_m < _STILL_M]
    return float(turned.max(initial=0.0))


def _check_rates(found: Survey) -> tuple[str, ...]:
    """The unit of a gyro that no wheel can be compared with, by what vehicles do."""
    long_s = np.diff(found.bin_s, prepend=0.0)
    moved_m = 0.5 * (found.left_m + found.right_m)
    rate_dps = np.abs(found.gyro_deg / long_s - np.median(found.gyro_deg / long_s))
    moving = moved_m > _STILL_M
    if not moving.any():
        return ()
    across = float(np.quantile((moved_m / long_s * DEG_TO_RAD * rate_dps)[moving], 1.0 - _FASTEST_SHARE))
    if across > _ACROSS_MPS2:
        msg = f"{found.source}: speed and gyro_dps make {across:.3g} m/s2 across the way, and no wheel holds more than 10: the gyro is in deg/h, or was converted to degrees twice. Write it in deg/s, or state its unit in a mapping with --columns."
        raise DataError(msg)
    fastest_dps, turned_deg = float(np.quantile(rate_dps[moving], _RARELY)), _turned_standing_deg(found)
    if turned_deg > MIN_TURN_DEG:
        # One speed of both wheels is zero where they turn against each other.
        return (
            f"the gyro turns {turned_deg:.0f} deg within {WINDOW_S:g} s in which the speed is zero: if the robot did not turn on the spot, "
            "the speed was stuck, or somebody turned the robot",
        )
    if fastest_dps > _SLOW_TURNS_DPS:
        return ()
    return (
        f"by gyro_dps the vehicle hardly ever turns faster than {fastest_dps:.2g} deg/s, and no wheel says whether: if it went round corners, the gyro is in rad/s; state its unit in a mapping with --columns",
    )


def _check_turns(found: Survey, separation_m: float) -> tuple[str, ...]:
    name = found.source
    left, right, gyro = (sliding(found, v, WINDOW_S) for v in (found.left_m, found.right_m, found.gyro_deg))
    encoder = (right - left) / separation_m * RAD_TO_DEG
    # A turn shows in few windows; a gyro bias shifts them all and goes with the median. Encoders have none.
    turned = [float(np.max(np.abs(v), initial=0.0)) for v in (gyro - np.median(gyro), encoder)]
    if max(turned) < MIN_TURN_DEG:
        return (
            f"the log has no turns (within {WINDOW_S:g} s at most {turned[0]:.0f} deg by the gyro, {turned[1]:.0f} deg by the encoders): "
            "whether unit and sign of the gyro are right cannot be seen; log a drive that turns both ways",
        )
    turned_deg = np.cumsum(found.right_m - found.left_m) / separation_m * RAD_TO_DEG
    t_s, names = found.bin_s + found.t_start_s, ("the encoders", "gyro_dps")
    fault = turn_part_fault(t_s, turned_deg, np.cumsum(found.gyro_deg), names)
    if fault is not None:
        raise DataError(f"{name}: {fault}")
    # Turns that come and go correlate about their mean; a circle, which never changes, only about zero.
    ratio, correlation = max(
        _compare(encoder, gyro), _compare(encoder, gyro, 0.0), key=lambda found: found[1]
    )
    if correlation < _CORRELATION_GOOD:
        for cause, left_sign, right_sign in _HYPOTHESES:
            other = (left_sign * left + right_sign * right) / separation_m * RAD_TO_DEG
            if _compare(other, gyro)[1] > _CORRELATION_GOOD:
                msg = f"{name}: encoder and gyro turns disagree (correlation {correlation:.2f}): {cause}. State the signs in a mapping with --columns."
                raise DataError(msg)
    if correlation < _CORRELATION_BAD:
        msg = f"{name}: encoder and gyro turns have nothing in common (correlation {correlation:.2f} over {WINDOW_S:g} s windows): one of them is stuck, or they are not of one robot or not of one clock. Check the log."
        raise DataError(msg)
    if not 1.0 / _UNIT_BORDER < ratio < _UNIT_BORDER:
        cause = (
            "near 57.3 is rad/s logged as deg/s"
            if ratio < 1
            else "near 57.3 is a rate in deg/s converted twice, one near 3,600 deg/h logged as deg/s"
        )
        msg = f"{name}: the gyro turns {ratio:.3g} times as far as the encoders; a factor {cause}, any other a wrong wheel_separation_m or metres_per_tick. State the units in a mapping with --columns."
        raise DataError(msg)
    if 1.0 / WORST_SCALE < ratio < WORST_SCALE:
        return ()
    return (
        f"the gyro turns {ratio:.2g} times as far as the encoders: wheels that skid, a wrong wheel_separation_m or metres_per_tick, or a gyro of another scale; `diagnose --robot` looks which",
    )


def sliding(found: Survey, sums: Floats, window_s: float, delay_s: float = 0.0) -> Floats:
    """Sum over a window that slides by a bin, looked at `delay_s` later; the same times for every delay."""
    total = np.cumsum(sums)
    first, last = found.bin_s[0] + MAX_DELAY_S, found.bin_s[-1] - window_s - MAX_DELAY_S
    start_s = np.arange(first, max(last, first + BIN_S), BIN_S) + delay_s
    return np.asarray(
        np.interp(start_s + window_s, found.bin_s, total) - np.interp(start_s, found.bin_s, total)
    )


def _compare(encoder: Floats, gyro: Floats, centred: float = 1.0) -> tuple[float, float]:
    """Size of the gyro's turns over the encoders' (root mean squares) and their correlation, about mean or zero."""
    e, g = encoder - centred * encoder.mean(), gyro - centred * gyro.mean()
    see, sgg, seg = float(e @ e), float(g @ g), float(e @ g)
    if see == 0.0 or sgg == 0.0:
        return np.inf if see == 0.0 else 0.0, 0.0
    return (sgg / see) ** 0.5, seg / (see * sgg) ** 0.5
