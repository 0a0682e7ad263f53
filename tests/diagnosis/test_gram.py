"""Tests in the whitened space: gains against least squares, nulls against their distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from gyrocal.diagnosis.gram import (
    benjamini_hochberg,
    effective_trials,
    holm,
    log_evidence,
    project,
    random_evidence,
    tail,
)


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
    one = given.gains(np.array([[3], [4]]))
    two = given.gains(np.array([[3, 4], [5, 6]]))
    three, df = given.block(np.array([3, 4, 5]))
    before = left_over(columns, [0, 1, 2])
    assert given.rss == pytest.approx(before)
    assert one[1] == pytest.approx(before - left_over(columns, [0, 1, 2, 4]))
    assert two[1] == pytest.approx(before - left_over(columns, [0, 1, 2, 5, 6]))
    assert three == pytest.approx(before - left_over(columns, [0, 1, 2, 3, 4, 5]))
    assert df == 3


def test_a_captured_column_gains_nothing_and_a_double_counts_once() -> None:
    rng = np.random.default_rng(1)
    columns, _ = make_gram(rng)
    columns[:, 4] = columns[:, 1] + columns[:, 2]
    columns[:, 6] = columns[:, 5] * (1.0 + 1e-9)
    given = project(columns.T @ columns, np.array([0, 1]))
    assert given.gains(np.array([[3]]))[0] == 0.0
    assert given.block(np.array([4, 5]))[1] == 1
    assert given.gains(np.array([[4, 5]]))[0] == pytest.approx(given.gains(np.array([[4]]))[0], rel=1e-5)


def test_mixtures_are_projected_out_like_columns() -> None:
    columns, gram = make_gram(np.random.default_rng(2))
    mixtures = np.zeros((9, 1))
    mixtures[[3, 5], 0] = 1.0, -2.0
    given = project(gram, np.array([0]), mixtures)
    X = np.column_stack([columns[:, 1], columns[:, 4] - 2.0 * columns[:, 6]])
    left = columns[:, 0] - X @ np.linalg.lstsq(X, columns[:, 0], rcond=None)[0]
    assert given.rss == pytest.approx(float(left @ left))


def test_p_values_of_a_grid_are_uniform_under_the_null() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 200)
    grid = np.column_stack([np.exp(-t / tau) for tau in np.geomspace(0.05, 3.0, 12)])
    X = np.column_stack([np.ones(200), grid])
    points = np.arange(1, 13)[:, None]
    trials = None
    p_values = []
    for _ in range(400):
        matrix = np.column_stack([rng.standard_normal(200), X])
        given = project(matrix.T @ matrix, np.array([0]))
        trials = trials or effective_trials(given, points, rng)
        p_values.append(tail(float(given.gains(points).max()), 1, trials))
    assert trials is not None
    assert 1.5 < trials < 12
    # The upper end is capped at one; below 0.3 the p-values must be uniform (false-alarm rate 0.1 %).
    small = np.array([p for p in p_values if p < 0.3]) / 0.3
    assert kstest(small, "uniform").pvalue > 1e-3
    low, high = 400 * 0.05 + 4 * np.sqrt(400 * 0.05) * np.array([-1, 1])
    assert low < np.sum(np.array(p_values) < 0.05) < high


def test_evidence_pays_for_shapes_and_amplitudes() -> None:
    even = np.full(4, 0.25)
    sharp = log_evidence(np.array([60.0, 0.0, 0.0, 0.0]), 1, 100, even)
    sure = log_evidence(np.array([60.0]), 1, 100, np.ones(1))
    assert sure - sharp == pytest.approx(np.log(4.0), abs=1e-9)
    assert sure == pytest.approx(30.0 - 0.5 * np.log(100.0))
    # Twice as many points at the same shape are no more evidence.
    doubled = log_evidence(np.array([60.0, 60.0, 0.0, 0.0, 0.0]), 1, 100, np.array([0.125, 0.125, *even[1:]]))
    assert doubled == pytest.approx(sharp)
    assert log_evidence(np.empty(0), 1, 100, np.empty(0)) == -np.inf


def test_independent_draws_are_worth_less_than_a_law_that_fits_as_well() -> None:
    rng = np.random.default_rng(4)
    X = rng.standard_normal((300, 6))
    y = X @ np.full(6, 0.5) + rng.standard_normal(300)
    matrix = np.column_stack([y, X, X.sum(axis=1)])
    given = project(matrix.T @ matrix, np.empty(0, dtype=np.int64))
    law = log_evidence(given.gains(np.array([[6]])), 1, 300, np.ones(1))
    assert law > random_evidence(given, np.arange(6)) > 0
    null = np.column_stack([rng.standard_normal(300), X])
    assert random_evidence(project(null.T @ null, np.empty(0, dtype=np.int64)), np.arange(6)) < 2.0


def test_holm_and_benjamini_hochberg_by_hand() -> None:
    p = np.array([0.001, 0.02, 0.012, 0.5])
    np.testing.assert_array_equal(holm(p, 0.05), [True, True, True, False])
    np.testing.assert_array_equal(holm(p, 0.02), [True, False, False, False])
    np.testing.assert_array_equal(benjamini_hochberg(np.array([0.04, 0.01, 0.03, 0.9]), 0.05), [0, 1, 0, 0])
    assert tail(10.0, 0) == 1.0
    assert tail(10.0, 2, 5.0) == pytest.approx(5.0 * chi2.sf(10.0, 2))
