"""Rows that went with the way of their wheels, rows whose way was kept, and stamps that come late."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.navigation.lost_ways import LostWays, rows_missing
from gyrocal.navigation.lost_ways import lost_ways as lost_of
from gyrocal.records.drive import DriveBlock, cut

Floats = NDArray[np.float64]

_STEP_S, _ROWS = 0.02, 4000


def drive(seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Times, and the way of each side since the row before, of a robot that speeds up and slows down."""
    t_s: Floats = _STEP_S * np.arange(_ROWS, dtype=np.float64)
    speed_mps: Floats = np.asarray(0.6 + 0.4 * np.sin(0.3 * t_s), dtype=np.float64)
    noise: Floats = 1e-4 * np.random.default_rng(seed).standard_normal((2, _ROWS))
    return t_s, (speed_mps - 0.05) * _STEP_S + noise[0], (speed_mps + 0.05) * _STEP_S + noise[1]


def block(t_s: Floats, left_m: Floats, right_m: Floats) -> DriveBlock:
    nothing = np.full(t_s.size, np.nan)
    return DriveBlock(2, t_s, left_m, right_m, nothing, nothing, nothing, nothing, nothing)


def lost_ways(log: DriveBlock) -> LostWays | None:
    steps = np.diff(log.t_s)
    return lost_of([log], float(np.median(steps[steps > 0.0])))


def kept_rows(share: float, seed: int) -> NDArray[np.bool_]:
    keep = np.random.default_rng([seed, 1]).random(_ROWS) > share
    keep[0] = True
    return np.asarray(keep)


@pytest.mark.parametrize("seed", range(3))
def test_the_way_of_rows_that_were_lost_is_added(seed: int) -> None:
    t_s, left, right = drive(seed)
    keep = kept_rows(0.05, seed)
    log = block(t_s[keep], left[keep], right[keep])
    lost = lost_ways(log)
    assert lost is not None
    gone = 0.5 * float(np.sum(left[~keep] + right[~keep]))
    # Of four leaps in a row the last is taken for another step of the logger.
    assert lost.rows == pytest.approx(np.count_nonzero(~keep), abs=2)
    assert lost.way_m == pytest.approx(gone, rel=0.02)
    (whole,) = lost.completed([log])
    assert 0.5 * float(np.sum(whole.left_m + whole.right_m)) == pytest.approx(
        0.5 * np.sum(left + right), rel=1e-3
    )


def test_block_by_block_it_is_the_same() -> None:
    t_s, left, right = drive()
    keep = kept_rows(0.05, 0)
    log = block(t_s[keep], left[keep], right[keep])
    parts = [cut(log, slice(k, k + 700)) for k in range(0, len(log), 700)]
    whole, by_parts = lost_ways(log), lost_of([cut(log, slice(0, 0)), *parts], _STEP_S)
    assert whole is not None
    assert by_parts is not None
    assert by_parts.rows == whole.rows
    assert by_parts.way_m == pytest.approx(whole.way_m)
    (at_once,) = whole.completed([log])
    pieces = list(whole.completed([cut(log, slice(0, 0)), *parts]))
    np.testing.assert_array_equal(np.concatenate([p.left_m for p in pieces]), at_once.left_m)


def test_a_counter_goes_on_counting() -> None:
    t_s, left, right = drive()
    keep = kept_rows(0.05, 0)
    totals = [np.diff(np.cumsum(side)[keep], prepend=0.0) for side in (left, right)]
    assert lost_ways(block(t_s[keep], *totals)) is None


@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_come_late_lose_no_way(seed: int) -> None:
    """The step after is short: no row is missing."""
    t_s, left, right = drive(seed)
    late = np.random.default_rng([seed, 2]).random(_ROWS) < 0.05
    assert lost_ways(block(t_s + 0.9 * _STEP_S * late, left, right)) is None


def test_of_few_leaps_or_without_any_nothing_is_said() -> None:
    t_s, left, right = drive()
    assert lost_ways(block(t_s, left, right)) is None
    keep = np.ones(_ROWS, dtype=np.bool_)
    keep[100:1600:100] = False
    assert lost_ways(block(t_s[keep], left[keep], right[keep])) is None
    # A second in which nothing was logged is a gap, and no row.
    gap = np.ones(_ROWS, dtype=np.bool_)
    for at in range(200, _ROWS, 120):
        gap[at : at + 50] = False
    assert lost_ways(block(t_s[gap], left[gap], right[gap])) is None


def sides(t_s: Floats) -> tuple[Floats, Floats]:
    """Complete ways of rows at any times."""
    way_m = np.diff(0.6 * t_s - 0.8 * np.cos(0.5 * t_s), prepend=-0.8)
    return 0.95 * way_m, 1.05 * way_m


@pytest.mark.parametrize("later_s", [0.04, 0.05, 0.09])
def test_a_logger_of_another_step_from_some_row_on_loses_nothing(later_s: float) -> None:
    """Every row of 40 ms after those of 20 had been a leap: 40 m were added to 100."""
    t_s = np.concatenate([0.02 * np.arange(6000.0), 120.0 + later_s * np.arange(2000.0)])
    assert lost_ways(block(t_s, *sides(t_s))) is None
    # With rows and their ways lost beside, those alone are added.
    left, right = sides(t_s)
    keep = np.random.default_rng(3).random(t_s.size) > 0.03
    log = block(t_s[keep], left[keep], right[keep])
    lost = lost_ways(log)
    if lost is not None:
        (whole,) = lost.completed([log])
        assert np.sum(whole.left_m) < 1.001 * np.sum(left)


def test_rows_of_another_step_are_not_missing() -> None:
    """2,000 rows of 10 a second before as many of 25 had been "22 % of the log"."""
    t_s = np.concatenate([0.1 * np.arange(2000.0), 200.0 + 0.04 * np.arange(5000.0)])
    assert rows_missing(t_s, 0.04) <= 6
    even_s = 0.04 * np.arange(7000.0)
    keep = np.random.default_rng(2).random(even_s.size) > 0.05
    keep[3000:3040] = False
    assert rows_missing(even_s[keep], 0.04) == pytest.approx(np.count_nonzero(~keep), abs=3)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.42, 0.45, 0.48])
def test_a_logger_of_mixed_steps_loses_nothing(share: float) -> None:
    t_s = np.cumsum(np.where(np.random.default_rng(0).random(10_000) < share, 0.02, 0.01))
    assert lost_ways(block(t_s, *sides(t_s))) is None


@pytest.mark.parametrize("rate_hz", [30, 60, 75, 120, 150])
@pytest.mark.parametrize("share", [0.003, 0.01, 0.02])
def test_late_stamps_in_whole_milliseconds_lose_nothing(rate_hz: int, share: float) -> None:
    rows, rng = np.arange(20_000.0), np.random.default_rng(1)
    t_s = np.round((rows + 0.85 * (rng.random(rows.size) < share)) / rate_hz, 3)
    assert lost_ways(block(t_s, *sides(rows / rate_hz))) is None


@pytest.mark.parametrize("rate_hz", [30, 60, 75, 120, 150])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
def test_lost_rows_between_stamps_in_whole_milliseconds_are_found(rate_hz: int, share: float) -> None:
    rows, rng = np.arange(20_000.0), np.random.default_rng(1)
    left, right = sides(rows / rate_hz)
    keep = rng.random(rows.size) > share
    log = block(np.round(rows / rate_hz, 3)[keep], left[keep], right[keep])
    lost = lost_ways(log)
    assert lost is not None
    (whole,) = lost.completed([log])
    assert np.sum(whole.left_m + whole.right_m) == pytest.approx(np.sum(left + right), rel=2e-3)


def test_a_turn_on_the_spot_goes_as_far_as_its_wheels_do() -> None:
    t_s = _STEP_S * np.arange(float(_ROWS))
    way_m = np.full(_ROWS, 0.01)
    keep = kept_rows(0.05, 0)
    log = block(t_s[keep], -way_m[keep], way_m[keep])
    lost = lost_ways(log)
    assert lost is not None
    assert lost.way_m == pytest.approx(float(np.sum(way_m[~keep])), rel=0.05)
    (whole,) = lost.completed([log])
    assert np.sum(whole.right_m) == pytest.approx(np.sum(way_m), rel=1e-3)
