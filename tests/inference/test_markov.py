"""The Gaussian Markov field against dense matrices, and its levels against what was drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.inference.markov import MarkovField, restricted_maximum

Floats = NDArray[np.float64]


def some_field(n: int, seed: int) -> MarkovField:
    """Three states of all kinds: fading, constant, and one that forgets everything."""
    rng = np.random.default_rng(seed)
    keep = np.column_stack([rng.uniform(0.2, 0.9, n), np.ones(n), np.zeros(n)])
    push = rng.uniform(0.1, 1.0, (n, 3))
    before, after = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    return MarkovField(np.array([1.0, 0.5, 2.0]), keep, push, before, after, rng.uniform(0.3, 2.0, n))


def dense(field: MarkovField) -> Floats:
    """Covariance of the observations, from the definition."""
    n, s = field.keep.shape
    # Each state as a linear map of the independent pushes, those of node 0 first.
    maps = np.zeros((n + 1, s, (n + 1) * s))
    maps[0, :, :s] = np.diag(np.sqrt(field.start))
    for k in range(n):
        maps[k + 1] = field.keep[k][:, None] * maps[k]
        maps[k + 1, :, (k + 1) * s : (k + 2) * s] += np.diag(np.sqrt(field.push[k]))
    seen = np.einsum("ks,ksp->kp", field.before, maps[:-1]) + np.einsum("ks,ksp->kp", field.after, maps[1:])
    return np.asarray(seen @ seen.T + np.diag(field.noise))


def test_likelihood_and_inverse_are_those_of_the_dense_matrix() -> None:
    field = some_field(40, 1)
    v = dense(field)
    columns = np.random.default_rng(2).normal(size=(40, 4))
    given = field.given(columns)
    assert given.log_det == pytest.approx(np.linalg.slogdet(v)[1], rel=1e-12)
    np.testing.assert_allclose(given.gram, columns.T @ np.linalg.solve(v, columns), rtol=1e-9)
    np.testing.assert_allclose(given.inverse(), np.linalg.solve(v, columns), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(given.inverse_diagonal(), np.diag(np.linalg.inv(v)), rtol=1e-8)


def test_variances_that_make_no_matrix_are_refused() -> None:
    field = replace(some_field(5, 1), noise=np.array([1.0, 1.0, 0.0, 1.0, 1.0]))
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        field.given(np.ones((5, 1)))


def test_restricted_loss_is_that_of_error_contrasts() -> None:
    """REML is the likelihood of what is orthogonal to the columns, up to a constant of the columns alone."""
    rng = np.random.default_rng(3)
    columns, y = rng.normal(size=(30, 2)), rng.normal(size=30)
    contrasts = np.linalg.qr(columns, mode="complete")[0][:, 2:].T
    apart = []
    for seed in (1, 2, 3):
        field = some_field(30, seed)
        v = contrasts @ dense(field) @ contrasts.T
        likelihood = stats.multivariate_normal(np.zeros(28), v, allow_singular=False).logpdf(contrasts @ y)
        loss = field.given(np.column_stack([columns, y])).restricted_loss()
        apart.append(loss + 2 * likelihood)
    assert apart == pytest.approx([apart[0]] * 3, rel=1e-10)


def test_slope_is_that_of_differences() -> None:
    rng = np.random.default_rng(4)
    both = rng.normal(size=(30, 3))
    field = some_field(30, 6)
    slope = field.given(both).restricted_slope()
    for name in ("start", "push", "noise"):
        variances, found = getattr(field, name), np.ravel(getattr(slope, name))
        for k, step in enumerate(1e-5 * np.eye(variances.size)):
            up, down = (
                replace(field, **{name: variances * np.exp(sign * step).reshape(variances.shape)})
                for sign in (1.0, -1.0)
            )
            rise = up.given(both).restricted_loss() - down.given(both).restricted_loss()
            assert found[k] == pytest.approx(rise / 2e-5, abs=1e-5)
            both_ways = slope.along(field, up) - slope.along(field, down)
            assert both_ways == pytest.approx(rise, rel=1e-3, abs=1e-9)


def test_slope_along_what_states_keep_is_that_of_differences() -> None:
    both = np.random.default_rng(7).normal(size=(30, 3))
    field = some_field(30, 8)
    slope = field.given(both).restricted_slope()
    for k, step in enumerate(1e-5 * np.eye(field.keep.size)):
        up, down = (replace(field, keep=field.keep + sign * step.reshape(30, 3)) for sign in (1.0, -1.0))
        rise = up.given(both).restricted_loss() - down.given(both).restricted_loss()
        assert np.ravel(slope.keep)[k] == pytest.approx(rise / 2e-5, abs=1e-5)
        assert slope.along(field, up) - slope.along(field, down) == pytest.approx(rise, rel=1e-3, abs=1e-9)


def test_levels_are_found() -> None:
    """White noise and a walk, drawn 40 times: the mean of the found logarithms is the truth's."""
    n, truth = 300, np.log([0.5, 0.1])

    def field_of(logs: Floats) -> MarkovField:
        white, walk = np.exp(2 * logs)
        one = np.ones((n, 1))
        return MarkovField(np.array([1e-6]), one, walk * one, 0 * one, one, np.full(n, white))

    found, left = [], []
    for seed in range(40):
        rng = np.random.default_rng([seed, 5])
        y = np.cumsum(rng.normal(size=n)) * np.exp(truth[1]) + np.exp(truth[0]) * rng.normal(size=n)
        usual = truth + 0.7
        logs, spread = restricted_maximum(field_of, y, np.ones((n, 1)), usual, np.full(2, 1.0), usual)
        found.append(logs)
        left.append(spread)
    mean, std = np.mean(found, axis=0), np.std(found, axis=0)
    # Four standard errors: one false alarm in 8000 runs.
    assert np.all(np.abs(mean - truth) < 4 * std / np.sqrt(40))
    assert np.all(std < 0.3)
    assert np.mean(left, axis=0) == pytest.approx(std, rel=0.5)
