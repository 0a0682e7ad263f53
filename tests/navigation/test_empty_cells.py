"""Empty cells are bridged by those beside them, however the log is cut into blocks, and long stretches stay empty."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrocal.navigation.empty_cells import bridged
from gyrocal.records.drive import DriveBlock, cut, join

_ROWS, _STEP_S = 400, 0.05


def log() -> DriveBlock:
    """A speed and a rate that grow steadily, which a straight line between neighbours meets."""
    t_s: NDArray[np.float64] = _STEP_S * np.arange(_ROWS, dtype=np.float64)
    nothing = np.full(_ROWS, np.nan)
    way: NDArray[np.float64] = _STEP_S * (0.2 + 0.1 * t_s)
    return DriveBlock(2, t_s, way, 1.1 * way, 3.0 * t_s, nothing, nothing, nothing, nothing)


def with_holes(first: int, last: int) -> DriveBlock:
    block = log()
    for channel in (block.gyro_dps, block.left_m):
        channel[first:last] = np.nan
    return block


def test_short_holes_are_bridged() -> None:
    holed = with_holes(100, 104)
    holed.right_m[7] = np.nan
    (whole,) = bridged([holed])
    true = log()
    np.testing.assert_allclose(whole.gyro_dps, true.gyro_dps)
    np.testing.assert_allclose(whole.left_m, true.left_m)
    np.testing.assert_allclose(whole.right_m, true.right_m)


def test_long_ones_stay_empty_and_known_cells_stay_as_they_are() -> None:
    holed = with_holes(100, 130)
    (whole,) = bridged([holed])
    np.testing.assert_array_equal(np.isnan(whole.gyro_dps), np.isnan(holed.gyro_dps))
    np.testing.assert_array_equal(np.isnan(whole.left_m), np.isnan(holed.left_m))
    (same,) = bridged([log()])
    np.testing.assert_array_equal(same.left_m, log().left_m)
    np.testing.assert_array_equal(same.gyro_dps, log().gyro_dps)


@settings(max_examples=30)
@given(rows=st.integers(1, 90))
def test_blocks_of_any_size_are_bridged(rows: int) -> None:
    """Where a block ends in a hole the last value holds for it, of a line of no slope the same."""
    holed = with_holes(100, 104)
    holed.gyro_dps[np.isfinite(holed.gyro_dps)] = 5.0
    parts = bridged(cut(holed, slice(k, min(k + rows, _ROWS))) for k in range(0, _ROWS, rows))
    whole = join(parts)
    np.testing.assert_array_equal(whole.gyro_dps, np.full(_ROWS, 5.0))
    np.testing.assert_allclose(whole.left_m, log().left_m, rtol=0.04)
