"""Fixes of a truth that cannot be, and those of a receiver as they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.navigation.fixes import frozen_fixes, no_fixes, wild_fixes

Floats = NDArray[np.float64]
ROWS = 2000


def path(noise_m: float, each: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """A winding path at 1 m/s and 20 rows a second, with a fix every so many rows that stands until the next; and the way."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0.0, 0.05, ROWS))
    z = np.cumsum(0.05 * np.exp(1j * heading)) + 500.0 * (1 + 1j)
    held = (
        z[::each][np.arange(ROWS) // each]
        + noise_m * np.repeat(rng.normal(size=(-(-ROWS // each), 2)) @ np.array([1.0, 1j]), each)[:ROWS]
    )
    return held.real, held.imag, 0.05 * np.arange(1.0, ROWS + 1.0)


@pytest.mark.parametrize("each", [1, 4, 20])
@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.9, 3.0])
def test_a_receiver_s_fixes_stay(noise_m: float, each: int) -> None:
    for seed in range(20):
        assert not wild_fixes(*path(noise_m, each, seed)).any()


def test_a_jump_that_stays_is_no_wild_fix() -> None:
    """As where satellites come and go, or after a gap."""
    x, y, way = path(0.05, 1, 0)
    x[900:] += 30.0
    assert not wild_fixes(x, y, way).any()


@pytest.mark.parametrize("each", [1, 20])
@pytest.mark.parametrize("at", [0, 900, ROWS - 1])
def test_one_fix_far_off_is_set_aside(at: int, each: int) -> None:
    x, y, way = path(0.5, each, 1)
    first = at // each * each
    x[first : first + each] += 400.0
    np.testing.assert_array_equal(
        np.flatnonzero(wild_fixes(x, y, way)), np.arange(first, min(first + each, ROWS))
    )


def test_fixes_that_are_off_by_metres_among_good_ones_are_set_aside() -> None:
    """Three in a hundred by 3 m had been "the truth's own error" of 0.77 m, where the others had 2 cm."""
    x, y, way = path(0.02, 4, 1)
    fixes = np.random.default_rng(4).choice(np.arange(1, ROWS // 4 - 1, 3), 15, replace=False)
    off = np.isin(np.arange(ROWS) // 4, fixes)
    x[off] += 3.0
    np.testing.assert_array_equal(wild_fixes(x, y, way), off)


def test_zeros_before_the_first_fix_are_set_aside_and_a_start_at_the_origin_is_none() -> None:
    x, y, way = path(0.01, 1, 2)
    x[:160] = y[:160] = 0.0
    assert np.flatnonzero(wild_fixes(x, y, way)).tolist() == list(range(160))
    x, y, way = path(0.01, 1, 2)
    x, y = x - x[0], y - y[0]
    x[:160] = y[:160] = 0.0
    way -= np.minimum(way, way[159])
    assert not wild_fixes(x, y, way).any()


def test_empty_cells_and_few_fixes_are_left_as_they_are() -> None:
    x, y, way = path(0.01, 1, 3)
    x[np.arange(ROWS) % 7 > 0] = np.nan
    x[700] += 400.0
    assert np.flatnonzero(wild_fixes(x, y, way)).tolist() == [700]
    x[9 * 7 :] = np.nan
    x[21] += 400.0
    assert not wild_fixes(x, y, way).any()


@pytest.mark.parametrize("each", [1, 4, 20, 200])
def test_a_slow_receiver_is_not_frozen_and_a_robot_may_stand(each: int) -> None:
    x, y, way = path(0.0, each, 2)
    t_s = 0.05 * np.arange(ROWS, dtype=np.float64)
    assert not frozen_fixes(t_s, x, y, way).any()
    stands = np.clip(np.arange(ROWS), None, 900)
    assert not frozen_fixes(t_s, x[stands], y[stands], way[stands]).any()


@pytest.mark.parametrize("each", [1, 4])
def test_a_truth_that_stands_still_while_the_robot_drives_is_left_out(each: int) -> None:
    x, y, way = path(0.01, each, 3)
    t_s = 0.05 * np.arange(ROWS, dtype=np.float64)
    held = np.where((np.arange(ROWS) >= 800) & (np.arange(ROWS) < 1200), 800, np.arange(ROWS))
    none, said = no_fixes(t_s, x[held], y[held], way)
    np.testing.assert_array_equal(np.flatnonzero(none), np.arange(801, 1200))
    assert said == (
        "399 of the truth's rows are left out: its position stands still to the last digit while the wheels go on, from t_s = 40 to 60 (19.9 m)",
    )
