"""Tests in the whitened space: gains against least squares, nulls against their distributions."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.inference.gram import project


def make_gram(rng: np.random.Generator, n: int = 400, p: int = 9) -> tuple[np.ndarray, np.ndarray]:
    columns = rng.standard_normal((n, p + 1))
    return columns, columns.T @ columns


def left_over(columns: np.ndarray, model: list[int]) -> float:
    """Residual sum of squares of column 0 on others (numbered from 0 behind it)."""
    X = columns[:, [m + 1 for m in model]]
    return float(np.sum((columns[:, 0] - X @ np.linalg.lstsq(X, columns[:, 0], rcond=None)[0]) ** 2))


def test_gains_are_drops_of_the_residual_sum_of_squares() -> None:
    columns, gram = make_gram(np.random.default_rng(0))
    given = project(gram, np.array([0, 1, 2]))
    one, two = given.block(np.array([4]))[0], given.block(np.array([5, 6]))[0]
    three, df = given.block(np.array([3, 4, 5]))
    before = left_over(columns, [0, 1, 2])
    assert given.rss == pytest.approx(before)
    assert one == pytest.approx(before - left_over(columns, [0, 1, 2, 4]))
    assert two == pytest.approx(before - left_over(columns, [0, 1, 2, 5, 6]))
    assert three == pytest.approx(before - left_over(columns, [0, 1, 2, 3, 4, 5]))
    assert df == 3


def test_a_captured_column_gains_nothing_and_a_double_counts_once() -> None:
    rng = np.random.default_rng(1)
    columns, _ = make_gram(rng)
    columns[:, 4] = columns[:, 1] + columns[:, 2]
    columns[:, 6] = columns[:, 5] * (1.0 + 1e-9)
    given = project(columns.T @ columns, np.array([0, 1]))
    assert given.block(np.array([3])) == (0.0, 0)
    assert given.block(np.array([4, 5]))[1] == 1
    assert given.block(np.array([4, 5]))[0] == pytest.approx(given.block(np.array([4]))[0], rel=1e-5)
