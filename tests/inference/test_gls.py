"""Generalised least squares against the textbook's formulas, and its restricted likelihood against contrasts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg, stats

from gyrocal.inference.gls import Levels, regress, restricted_levels, restricted_loss

Floats = NDArray[np.float64]


@pytest.fixture
def problem() -> tuple[Floats, Floats, Floats]:
    """A covariance, columns and a record."""
    rng = np.random.default_rng(4)
    root = rng.standard_normal((30, 30))
    return root @ root.T + 5.0 * np.eye(30), rng.standard_normal((30, 3)), rng.standard_normal(30)


def test_amplitudes_are_those_of_the_normal_equations(problem: tuple[Floats, Floats, Floats]) -> None:
    noise, columns, y = problem
    weight = np.linalg.inv(noise)
    covariance = np.linalg.inv(columns.T @ weight @ columns)
    values = covariance @ columns.T @ weight @ y
    found = regress(noise, columns, y)
    np.testing.assert_allclose(found.values, values, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9)
    left = y - columns @ values
    assert found.left == pytest.approx(left @ weight @ left, rel=1e-9)


def test_the_loss_is_that_of_contrasts_that_no_column_is_seen_in(
    problem: tuple[Floats, Floats, Floats],
) -> None:
    """Harville 1974: but for what depends on the columns alone."""
    noise, columns, y = problem
    contrasts = linalg.null_space(columns.T)
    for more in (np.zeros_like(noise), np.diag(np.linspace(1.0, 4.0, 30))):
        seen = contrasts.T @ (noise + more) @ contrasts
        density = stats.multivariate_normal.logpdf(contrasts.T @ y, np.zeros(27), seen)
        of_columns = np.linalg.slogdet(columns.T @ columns)[1] - 27.0 * np.log(2.0 * np.pi)
        assert restricted_loss(noise + more, columns, y) == pytest.approx(
            of_columns - 2.0 * density, rel=1e-9
        )


def test_what_is_known_is_as_one_more_row_of_each_amplitude(problem: tuple[Floats, Floats, Floats]) -> None:
    noise, columns, y = problem
    mean, std = np.array([0.3, -0.2, 0.0]), np.array([0.1, 2.0, np.inf])
    rows, known = np.eye(3)[:2], linalg.block_diag(noise, np.diag(std[:2] ** 2))
    among = regress(known, np.vstack([columns, rows]), np.append(y, mean[:2]))
    found = regress(noise, columns, y, mean, std)
    np.testing.assert_allclose(found.values, among.values, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, among.covariance, rtol=1e-9)
    assert found.left == pytest.approx(among.left, rel=1e-9)


def test_columns_that_are_one_need_something_to_be_known(problem: tuple[Floats, Floats, Floats]) -> None:
    noise, columns, y = problem
    twice = columns[:, [0, 0]]
    found = regress(noise, twice, y, np.zeros(2), np.full(2, 10.0))
    assert found.values[0] == pytest.approx(found.values[1], rel=1e-6)


def test_noise_that_is_none_is_refused(problem: tuple[Floats, Floats, Floats]) -> None:
    noise, columns, y = problem
    with pytest.raises(np.linalg.LinAlgError):
        regress(-noise, columns, y)


def test_slope_and_average_information_of_levels() -> None:
    """Against differences; the bend against its definition, ``y' P V P V P y / 2`` with P the projection."""
    rng = np.random.default_rng(7)
    n, logs = 20, np.array([0.3, -0.4])
    shapes = [np.diag(rng.uniform(0.5, 2.0, n)), np.exp(-np.abs(np.subtract.outer(range(n), range(n))) / 5.0)]
    columns, y = rng.normal(size=(n, 3)), rng.normal(size=n)
    mean, std = np.array([0.1, 0.0, -0.2]), np.array([0.5, 1e6, 2.0])

    def at(logs: Floats) -> Levels:
        parts = [np.exp(x) * shape for x, shape in zip(logs, shapes, strict=True)]
        return restricted_levels(0.1 * np.eye(n), parts, columns, y, mean, std)

    here = at(logs)
    noise = 0.1 * np.eye(n) + sum(np.exp(x) * shape for x, shape in zip(logs, shapes, strict=True))
    assert here.value == pytest.approx(0.5 * regress(noise, columns, y, mean, std).loss)
    rises = [(at(logs + h).value - at(logs - h).value) / 2e-5 for h in 1e-5 * np.eye(2)]
    assert here.slope == pytest.approx(rises, rel=1e-5)
    inverse = np.linalg.inv(noise)
    known = np.linalg.inv(columns.T @ inverse @ columns + np.diag(std**-2.0))
    values = known @ (columns.T @ inverse @ y + mean * std**-2.0)
    left = inverse @ (y - columns @ values)
    projection = inverse - inverse @ columns @ known @ columns.T @ inverse
    pulled = np.stack([np.exp(x) * shape @ left for x, shape in zip(logs, shapes, strict=True)])
    assert here.bend == pytest.approx(0.5 * pulled @ projection @ pulled.T)
