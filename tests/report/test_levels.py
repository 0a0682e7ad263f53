"""Levels of a plan are found in the values; continuous values are binned at round numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.report.levels import cell_edges, levels, round_edges


def plan(centres: list[float], each: int, noise: float, seed: int = 1) -> np.ndarray:
    """Values around levels, shuffled."""
    rng = np.random.default_rng(seed)
    values = np.repeat(centres, each) + rng.uniform(-noise, noise, len(centres) * each)
    return rng.permutation(values)


@pytest.mark.parametrize(
    ("centres", "noise"),
    [
        ([-10.0, 0.0, 10.0, 20.0, 30.0, 40.0, 50.0], 0.6),
        ([-100.0, -2.0, -1.0, 0.0, 1.0, 2.0, 100.0], 0.001),
        ([float(r) for r in range(-100, 101, 10)], 0.005),
        ([-100.0, 100.0], 0.0),
    ],
)
def test_levels_of_a_plan(centres: list[float], noise: float) -> None:
    values = plan(centres, 6, noise)
    found, tight = levels(values, most=64, bins=7)
    assert tight
    np.testing.assert_allclose([level.value for level in found], centres, atol=max(noise, 1e-12))
    assert all(level.rows.size == 6 for level in found)


def test_continuous_values_are_binned() -> None:
    values = np.random.default_rng(2).uniform(36.7, 49.3, 700)
    found, tight = levels(values, most=9, bins=7)
    assert not tight
    assert [(level.low, level.high) for level in found] == [(a, a + 2.0) for a in range(36, 50, 2)]
    for level in found:
        assert np.all((values[level.rows] >= level.low) & (values[level.rows] < level.high))


def test_one_value_is_one_level() -> None:
    found, tight = levels(np.full(5, 3.0), most=9, bins=7)
    assert tight
    assert len(found) == 1
    assert found[0].value == 3.0


@given(
    st.lists(st.floats(-150, 150, allow_subnormal=False), min_size=1, max_size=60),
    st.integers(2, 20),
    st.integers(2, 12),
)
def test_every_data_set_is_in_exactly_one_level(values: list[float], most: int, bins: int) -> None:
    found, tight = levels(np.array(values), most=most, bins=bins)
    rows = np.concatenate([level.rows for level in found])
    assert sorted(rows.tolist()) == list(range(len(values)))
    assert len(found) <= max(most if tight else bins, 1)
    centres = [level.value for level in found]
    assert centres == sorted(centres)


@given(st.floats(-1e3, 1e3, allow_subnormal=False), st.floats(0.001, 1e3), st.integers(2, 30))
def test_round_edges_cover(low: float, span: float, bins: int) -> None:
    edges = round_edges(low, low + span, bins)
    assert edges[0] <= low
    assert edges[-1] > low + span - 1e-9 * max(abs(low), span)
    assert 1 <= edges.size - 1 <= bins


def test_cell_edges_lie_halfway() -> None:
    found, _ = levels(np.array([0.0, 0.0, 10.0, 10.0, 30.0, 30.0]), most=9, bins=5)
    np.testing.assert_allclose(cell_edges(found), [-5.0, 5.0, 20.0, 40.0])
