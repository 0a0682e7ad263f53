"""Whether the channels of a drive log can be right: what is empty, stuck, saturated, or in another unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.navigation.sanity import turn_part_fault
from gyrocal.navigation.stuck_wheel import StuckWheel, refuse_stuck, stuck_said, stuck_wheels
from gyrocal.navigation.survey import BIN_S, MIN_TURN_DEG, WINDOW_S, Survey, sliding
from gyrocal.records.leaps import FASTEST_ROBOT_MPS, FASTEST_VEHICLE_MPS
from gyrocal.records.scale import WORST_SCALE, odd_temperature
from gyrocal.units import DEG_TO_RAD, RAD_TO_DEG

Floats = NDArray[np.float64]

#: A correlation of encoder and gyro turns that no sound pair of channels falls below, and one that only a
#: sound pair reaches.
_CORRELATION_BAD, _CORRELATION_GOOD = 0.3, 0.7
#: deg/s logged as rad/s (or the reverse) changes the ratio by 57.3; half of that on a log scale is the border.
_UNIT_BORDER = RAD_TO_DEG**0.5
_MAX_BAD_SHARE = 0.05
#: No robot turns so fast for a twentieth of a drive, not even in degrees that were converted twice: 55 turns a second.
_FASTEST_DPS, _FASTEST_SHARE = 20_000.0, 0.05
#: A gyro with coarse bits repeats itself by chance: 5 equal rows at the extreme came up once in 4,000 sound logs.
_SATURATED_ROWS = 10
#: What no vehicle does across its way in a twentieth of the time that it moves, twice what tyres hold; and turns which one that
#: goes round corners exceeds in a hundredth of it: a radian a second that is read as a degree a second is as slow as these.
_ACROSS_MPS2, _SLOW_TURNS_DPS, _RARELY = 20.0, 2.0, 0.99
#: Wheels that roll less than this over a window stand.
_STILL_M = 1e-3
#: Rests of so many bins, in which no wheel moves by more than a bin's share of that, tell the bias; two in a row that differ by so
#: many standard deviations, and by so much turn on the way from one to the other, are told.
_REST_BINS, _REST_M, _CHANGED, _CHANGED_DEG = 10, 1e-5, 6.0, 10.0
#: And a vehicle that goes so far while its gyro reads one number has a gyro that is stuck, or goes straight on.
_GOES_M = 1.0

#: What a wrong encoder does to (left, right): name -> signs of left and right in the turn.
_HYPOTHESES: tuple[tuple[str, float, float], ...] = (
    ("the gyro's sign is inverted, or left and right encoders are swapped", 1.0, -1.0),
    ("the left encoder's sign is inverted", 1.0, 1.0),
    ("the right encoder's sign is inverted", -1.0, -1.0),
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
        msg = f"{name}: gyro_dps is beyond {fast_dps:,.0f} deg/s in a twentieth of the drive, and no robot turns so fast: it is in mdeg/s (1,000 times), in deg/h (3,600 times), or in counts. Write it in deg/s, or state its unit in a mapping with --columns."
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
        msg = f"{name}: the encoders say {fast_mps:.3g} m/s; left_m and right_m are distances since the row before, in metres. left_ticks and right_ticks are counts since the start. Check their unit, metres_per_tick, and the clock (t_s in minutes makes 60 times the speed), or map the columns with --columns."
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
    few = 0 < found.beyond_rows < _FASTEST_SHARE * found.rows
    if found.rows > found.bad_gyro and (few or found.fastest_dps > _FASTEST_DPS):
        msg = f"{name}, line {found.fastest_line}: gyro_dps is {found.fastest_dps:,.0f} deg/s in size, and no robot turns so fast. Repair the cell or leave it empty: it is bridged."
        raise DataError(msg)
    if found.duration_s <= 0:
        raise DataError(f"{name}: all rows carry the same time. Check the clock of the logger.")
    check_speed(name, found.max_speed_mps, speed_only=found.speed_only)
    stuck = _stuck(found, wheel_separation_m)
    _check_stuck(found, wheel_separation_m, stuck)
    if found.speed_only:
        return _check_rates(found)
    t_s, sides = found.bin_s + found.t_start_s, (found.left_m, found.right_m)
    wheels = stuck_wheels(t_s, *sides, found.gyro_deg, wheel_separation_m)
    refuse_stuck(name, wheels, found.duration_s)
    return (
        *stuck_said(wheels, bridged=False),
        *_stuck_said(stuck),
        *_check_turns(_without(found, wheels), wheel_separation_m),
        *_rests_said(found),
    )


def _without(found: Survey, stuck: Sequence[StuckWheel]) -> Survey:
    """The log as if it stood while a wheel is stuck, which tells nothing of turns."""
    end_s = found.bin_s + found.t_start_s
    sound = np.all([(end_s <= w.since_s) | (end_s > w.until_s) for w in stuck], axis=0) if stuck else True
    left_m, right_m, gyro_deg = (
        np.where(sound, v, 0.0) for v in (found.left_m, found.right_m, found.gyro_deg)
    )
    return replace(found, left_m=left_m, right_m=right_m, gyro_deg=gyro_deg)


#: From when to when, and how much the wheels do meanwhile.
_Stuck = list[tuple[float, float, float]]


def _stuck(found: Survey, separation_m: float) -> _Stuck:
    """From when to when the gyro reads one number while the wheels turn otherwise, and by how far, deg; while they go, beside one speed.

    At rest, and straight on, one of coarse steps reads one number, too.
    """
    if found.speed_only:
        otherwise, least = np.cumsum(found.left_m), _GOES_M
    else:
        otherwise, least = np.cumsum(found.turns_deg(separation_m) - found.gyro_deg), MIN_TURN_DEG
    from_to_s = np.array(found.held_s).reshape(-1, 2)
    first, last = np.interp(from_to_s.T - found.t_start_s, found.bin_s, otherwise)
    each = zip(from_to_s.tolist(), np.abs(last - first).tolist(), strict=True)
    return [(since_s, until_s, by) for (since_s, until_s), by in each if by > least]


def _stuck_said(stuck: _Stuck) -> tuple[str, ...]:
    if not stuck:
        return ()
    each = [f"t_s = {a:.0f} to {b:.0f} ({by:.0f} deg)" for a, b, by in stuck]
    return (
        f"the gyro reads one number while the wheels turn, from {', '.join(each)}: it was stuck, and from there on the path is off by that",
    )


def _rests_said(found: Survey) -> tuple[str, ...]:
    """That the gyro reads otherwise from one rest to the next: what it turned on the way is off by as much."""
    rests = [r for r in _rests(found) if r.size >= _REST_BINS]
    rate_dps = found.gyro_deg / BIN_S
    # The first and the last bin of a rest may hold a part of the motion.
    inside = [rate_dps[r[1:-1]] for r in rests]
    mean_dps = np.array([r.mean() for r in inside])
    variance = np.array([r.var() / r.size for r in inside])
    middle_s = np.array([found.bin_s[r].mean() for r in rests])
    step_dps, way_s = np.diff(mean_dps), np.diff(middle_s)
    sure = np.abs(step_dps) > _CHANGED * np.sqrt(variance[1:] + variance[:-1])
    off_deg = np.where(sure, np.abs(step_dps) * way_s, 0.0)
    if not off_deg.size or off_deg.max() < _CHANGED_DEG:
        return ()
    k = int(np.argmax(off_deg))
    t_s = middle_s + found.t_start_s
    return (
        f"the gyro reads {mean_dps[k]:.3g} deg/s at the rest about t_s = {t_s[k]:.0f} and {mean_dps[k + 1]:.3g} at the next, about {t_s[k + 1]:.0f}: its bias "
        f"changed, and heading and path are off by up to {off_deg[k]:.0f} deg in between; `diagnose --robot` looks when",
    )


def _rests(found: Survey) -> list[NDArray[np.int64]]:
    """Runs of bins that follow each other, in which no wheel moves and no cell is empty."""
    still = np.flatnonzero(found.known & (np.abs(found.left_m) + np.abs(found.right_m) < _REST_M))
    apart = np.diff(still) > 1
    apart |= np.diff(found.bin_s[still]) > 1.5 * BIN_S
    return np.split(still, np.flatnonzero(apart) + 1)


def _check_stuck(found: Survey, separation_m: float, stuck: _Stuck) -> None:
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
    turned_deg = float(np.abs(found.turns_deg(separation_m)).sum())
    if found.gyro_dps[0] == found.gyro_dps[1]:
        msg = f"{name}: gyro_dps is {found.gyro_dps[0]:g} in every row while the encoders turn {turned_deg:.0f} deg; the gyro is stuck. Check its cable."
        raise DataError(msg)
    longest_s = max((b - a for a, b, _ in stuck), default=0.0)
    if longest_s > 0.25 * found.duration_s:
        msg = f"{name}: gyro_dps does not change for {longest_s:.0f} s of {found.duration_s:.0f} s; the gyro is stuck. Check its cable."
        raise DataError(msg)
    standing_deg = 0.0 if found.speed_only else _turned_standing_deg(found)
    if standing_deg > MIN_TURN_DEG:
        msg = f"{name}: the gyro turns {standing_deg:.0f} deg within {WINDOW_S:g} s in which neither encoder moves; both are stuck, or the robot was turned by hand. Check their cables."
        raise DataError(msg)
    if found.longest_extreme >= _SATURATED_ROWS and found.fastest_dps > 10.0:
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
    turned_deg = np.cumsum(found.turns_deg(separation_m))
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
            "near 0.0175 is rad/s logged as deg/s"
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


def _compare(encoder: Floats, gyro: Floats, centred: float = 1.0) -> tuple[float, float]:
    """Size of the gyro's turns over the encoders' (root mean squares) and their correlation, about mean or zero."""
    e, g = encoder - centred * encoder.mean(), gyro - centred * gyro.mean()
    see, sgg, seg = float(e @ e), float(g @ g), float(e @ g)
    if see == 0.0 or sgg == 0.0:
        return np.inf if see == 0.0 else 0.0, 0.0
    return (sgg / see) ** 0.5, seg / (see * sgg) ** 0.5


def held(values: Floats) -> Floats:
    """The last finite value in the place of those that are not, as the navigator does with a missing temperature."""
    return values[np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), 0))]
