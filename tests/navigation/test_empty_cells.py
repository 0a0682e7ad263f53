"""Empty cells are bridged by those beside them, however the log is cut into blocks, and long stretches stay empty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrocal.navigation.empty_cells import bridged
from gyrocal.records.drive import DriveBlock, cut, join

_ROWS, _STEP_S = 200, 0.05


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


def assert_same(a: DriveBlock, b: DriveBlock) -> None:
    for name in ("gyro_dps", "left_m", "right_m"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12)


@settings(max_examples=30)
@given(
    rows=st.sampled_from([1, 2, 5, 13, 60]),
    holes=st.lists(
        st.tuples(st.sampled_from([0, 1, 2]), st.integers(0, _ROWS - 1), st.integers(1, 15)), max_size=6
    ),
)
def test_however_the_log_is_cut_it_is_bridged_alike(rows: int, holes: list[tuple[int, int, int]]) -> None:
    holed, true = log(), log()
    for channel, first, size in holes:
        (holed.gyro_dps, holed.left_m, holed.right_m)[channel][first : first + size] = np.nan
    whole = join(bridged([holed]))
    parts = list(bridged(cut(holed, slice(k, min(k + rows, _ROWS))) for k in range(0, _ROWS, rows)))
    assert_same(join(parts), whole)
    # What was filled is met, and the rest left empty.
    for name in ("gyro_dps", "left_m", "right_m"):
        filled = np.isfinite(getattr(whole, name))
        np.testing.assert_allclose(getattr(whole, name)[filled], getattr(true, name)[filled])


def test_ends_of_a_log_stay_empty_and_what_a_block_says_is_said_once() -> None:
    holed = replace(with_holes(195, 200), notes=("a remark",), late_counts=2)
    holed.gyro_dps[:3] = np.nan
    parts = list(bridged([holed]))
    whole = join(parts)
    np.testing.assert_array_equal(np.isnan(whole.gyro_dps), np.isnan(holed.gyro_dps))
    assert len(parts) == 2
    assert (whole.notes, whole.late_counts) == (("a remark",), 2)
