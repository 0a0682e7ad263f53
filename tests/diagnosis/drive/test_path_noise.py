"""The covariance of a reckoned path, part by part, against draws of what makes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.laws import BiasLaws
from gyrocal.diagnosis.drive.path_noise import Knots, cell_edges_s, path_noise, stacked
from gyrocal.diagnosis.drive.reckoning import Reckoned
from gyrocal.diagnosis.drive.yaw import YawNoise
from gyrocal.physics.drive import FLICKER_TAUS_S
from gyrocal.units import DEG_TO_RAD

_ROWS, _DT_S, _DRAWS = 600, 0.2, 400
_LONG = 0.03
_LAWS = 2
_ARW_DPS, _SLIP, _FLICKER_DPS = 0.05, 0.01, 0.002


def _path() -> Reckoned:
    """Eights of two minutes."""
    t_s = _DT_S * np.arange(float(_ROWS))
    heading = 3.0 * np.sin(2.0 * np.pi * t_s / 60.0)
    way = np.full(_ROWS, 0.5 * _DT_S)
    gap = np.zeros(_ROWS, dtype=np.bool_)
    return Reckoned(
        t_s, np.full(_ROWS, _DT_S), heading, way, np.abs(way), way * np.exp(1j * heading), gap, 0.5, True
    )


def _knots(path: Reckoned) -> Knots:
    """Truth in every row at first and in every fourth later on, so that means are of unequal counts."""
    rows = np.r_[0:300, 300:_ROWS:4]
    at = (path.t_s[rows] // 10.0).astype(np.int64)
    count = np.bincount(at).astype(np.float64)
    edges_s = cell_edges_s(path.t_s, count.size)
    knots = Knots(rows, at, count, path.t_s, path.at_m, np.zeros(count.size), {}, _LAWS, edges_s)
    return replace(knots, t_s=knots.mean(path.t_s), position=knots.mean(path.at_m))


def _known(path: Reckoned, weights: NDArray[np.float64]) -> BiasLaws:
    """Two laws whose errors are all the gyro's."""
    return BiasLaws(("bias", "slope"), 1e-12 * np.eye(_LAWS), path.t_s, weights)


def _spread(draws: list[NDArray[np.float64]], like: NDArray[np.float64]) -> float:
    """Mean of squared draws over their covariance: 1 for draws of it, along each of its long axes.

    The short ones are of what happens within a cell, for which a cell's turn is all at one rate.
    """
    values, axes = np.linalg.eigh(like)
    large = values > _LONG * values[-1]
    along = np.array(draws) @ axes[:, large]
    ratio = np.mean(along**2, axis=0) / values[large]
    assert np.all(np.abs(ratio - 1.0) < 0.35), ratio
    return float(np.mean(ratio))


def test_each_part_is_what_draws_of_it_scatter_by() -> None:
    rng = np.random.default_rng(1)
    path = _path()
    knots = _knots(path)
    quiet = YawNoise(_ARW_DPS, _SLIP, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0)
    # A bias of the second half of the drive, and a law of the first half and the second: their errors are those of the path's
    # turns there.
    late = path.t_s > 60.0
    weights = np.stack([np.where(late, 20.0, 0.0), np.where(late, 5.0, -10.0)])
    parts = path_noise(knots, path, quiet, _known(path, weights), 60.0)
    none, no_heading = np.zeros(_ROWS), np.zeros(knots.count.size)
    by_gyro, by_way, by_truth = [], [], []
    for _ in range(_DRAWS):
        turns = DEG_TO_RAD * _ARW_DPS * np.sqrt(_DT_S) * rng.standard_normal(_ROWS)
        turned = np.cumsum(turns)
        moved = knots.mean(path.moved_by(turned, none))
        by_gyro.append(stacked(knots, moved, knots.mean(turned), weights @ turns))
        way = _SLIP * np.sqrt(0.5 * path.way_m) * rng.standard_normal(_ROWS)
        by_way.append(stacked(knots, knots.mean(path.moved_by(none, way)), no_heading))
        seen = rng.standard_normal(_ROWS) + 1j * rng.standard_normal(_ROWS)
        by_truth.append(stacked(knots, knots.mean(seen), no_heading))
    for draws, like in ((by_gyro, parts.gyro), (by_way, parts.way), (by_truth, parts.white)):
        assert _spread(draws, like) == pytest.approx(1.0, abs=0.1)


def test_a_bias_that_wanders_turns_the_path_as_its_processes_do() -> None:
    rng = np.random.default_rng(2)
    path = _path()
    knots = _knots(path)
    noise = YawNoise(0.0, _SLIP, 0.0, 0.0, _FLICKER_DPS, 0.0, 1.0, 0.0, 1.0, 0.0)
    parts = path_noise(knots, path, noise, _known(path, np.zeros((_LAWS, _ROWS))), 60.0)
    lag = np.abs(path.t_s[:, None] - path.t_s[None, :])
    kernel = sum(np.exp(-lag / tau) for tau in FLICKER_TAUS_S) * _FLICKER_DPS**2
    kernel = kernel + noise.walk_dps_per_rt_s**2 * np.minimum(path.t_s[:, None], path.t_s[None, :])
    root = np.linalg.cholesky(kernel + 1e-15 * np.eye(_ROWS))
    draws = []
    for _ in range(_DRAWS):
        turned = DEG_TO_RAD * np.cumsum(root @ rng.standard_normal(_ROWS)) * _DT_S
        moved = path.moved_by(turned, np.zeros(_ROWS))
        draws.append(stacked(knots, knots.mean(moved), knots.mean(turned)))
    assert _spread(draws, parts.gyro) == pytest.approx(1.0, abs=0.15)
