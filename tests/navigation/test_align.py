"""Alignment with truth: the frame comes back, and its standard deviations are honest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from gyrocal.navigation.align import Alignment, align_positions, align_start, position_errors


def path(n: int = 200) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    s = np.linspace(0.0, 2.0 * np.pi, n)
    return np.stack([20.0 * np.sin(s), 10.0 * (1.0 - np.cos(s))], axis=1)


@pytest.mark.parametrize("rotation_deg", [0.0, 37.0, -90.0, 179.9, -179.9])
def test_a_moved_path_is_moved_back(rotation_deg: float) -> None:
    frame = Alignment("positions", rotation_deg, 5.0, -3.0, (0.0, 0.0, 0.0))
    truth = np.stack(frame.apply(*path().T), axis=1)
    found = align_positions(path(), truth)
    assert found.rotation_deg == pytest.approx(rotation_deg, abs=1e-9)
    assert (found.x_m, found.y_m) == pytest.approx((5.0, -3.0), abs=1e-9)
    assert max(found.sigma) < 1e-6
    errors = position_errors(np.stack(found.apply(*path().T), axis=1), truth, 100.0)
    assert errors.max_m < 1e-9


def test_the_start_pose_needs_no_fit() -> None:
    found = align_start(np.array([1.0, 2.0, 30.0]), np.array([4.0, 6.0, 120.0]))
    x, y = found.apply(np.array([1.0, 2.0]), np.array([2.0, 2.0]))
    np.testing.assert_allclose(x, [4.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(y, [6.0, 7.0], atol=1e-12)
    assert found.sigma == (0.0, 0.0, 0.0)


def test_jackknife_sigma_fits_the_scatter_of_white_noise() -> None:
    rng = np.random.default_rng(8)
    found = [align_positions(path(), path() + rng.normal(0.0, 0.9, (200, 2))) for _ in range(200)]
    z = np.array([[f.rotation_deg, f.x_m, f.y_m] for f in found]) / np.array([f.sigma for f in found])
    # Ten blocks of a path that is not the same everywhere: Student's t with 9 degrees of freedom at best.
    for k in range(3):
        covered = int(np.count_nonzero(np.abs(z[:, k]) < stats.t.ppf(0.975, 9)))
        assert covered > stats.binom.ppf(1e-3, 200, 0.90)


@pytest.mark.parametrize(("gap_m", "closed"), [(0.0, True), (1.9, True), (2.1, False)])
def test_a_path_returns_when_it_ends_within_two_percent(gap_m: float, closed: bool) -> None:
    truth = np.array([[0.0, 0.0], [50.0, 0.0], [gap_m, 0.0]])
    errors = position_errors(truth + np.array([[0.0, 0.0], [0.0, 3.0], [0.0, 4.0]]), truth, 100.0)
    assert errors.end_m == 4.0
    assert errors.rms_m == pytest.approx(math.sqrt(25.0 / 3.0))
    assert errors.return_m == (4.0 if closed else None)


def test_few_positions_have_no_sigma() -> None:
    assert math.isnan(align_positions(path(3), path(3)).sigma[0])
