"""The noise model: its filter against the dense covariance, and its levels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from gyrocal.diagnosis.rows.history import temperature_history
from gyrocal.diagnosis.rows.series import Raw, Series
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.inference.whitening import (
    TAUS_S,
    Likelihood,
    NoiseLevels,
    NoiseModel,
    estimate_levels,
    look_for_walk,
    walk_p_value,
)
from gyrocal.records.datasets import DataSetTable

LEVELS = NoiseLevels(1.0, 7e-4, 2e-5)
WALKING = replace(LEVELS, walk=4e-4)


def make_series(n_sets: int = 30, per_set: int = 12) -> Series:
    """A shuffled sweep of rates in a slowly warming chamber."""
    rng = np.random.default_rng(3)
    rates = rng.permutation(np.tile(np.linspace(-100, 100, 10), n_sets // 10 + 1))[:n_sets]
    n = n_sets * per_set
    index = np.repeat(np.arange(n_sets), per_set)
    t_s = (index * 24 + np.tile(np.arange(per_set), n_sets)).astype(np.float64)
    temp = 20.0 + 5.0 * np.sin(t_s / 400.0)
    return Series(
        name="made",
        t_s=t_s,
        gyro_dps=np.zeros(n),
        rate_dps=rates[index],
        temp_c=temp,
        white_std_dps=np.full(n, 1.4e-3),
        averaging_s=np.full(n, 1.0),
        set_index=index,
        is_set=np.ones(n, dtype=bool),
        temp_rate_c_per_min=np.gradient(temp, t_s) * 60.0,
        history=temperature_history(t_s, temp),
        raw=Raw(np.empty(0), np.empty(0), n),
    )


def dense_covariance(series: Series, model: NoiseModel, levels: NoiseLevels) -> np.ndarray:
    """The covariance that the filter stands for, written out."""
    gap = np.abs(series.t_s[:, None] - series.t_s[None, :])
    total = np.diag((levels.white * series.white_std_dps) ** 2)
    for k, tau in enumerate(TAUS_S):
        read = model.read[:, k]
        total = total + levels.flicker_dps**2 * np.exp(-gap / tau) * np.outer(read, read)
    same = series.set_index[:, None] == series.set_index[None, :]
    since = series.t_s - series.t_s[0]
    total = total + levels.walk**2 * np.minimum(since[:, None], since[None, :])
    return np.asarray(total + same * (levels.jitter * series.rate_dps[:, None]) ** 2)


@pytest.mark.parametrize("levels", [LEVELS, WALKING])
def test_filter_equals_the_dense_covariance(levels: NoiseLevels) -> None:
    series = make_series()
    model = NoiseModel(series)
    X = np.random.default_rng(0).standard_normal((len(series), 4))
    white, std = model.whiten(levels, X)
    covariance = dense_covariance(series, model, levels)
    np.testing.assert_allclose(white.T @ white, X.T @ np.linalg.solve(covariance, X), rtol=1e-9)
    assert 2.0 * np.log(std).sum() == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-12)


@pytest.mark.parametrize("levels", [LEVELS, WALKING])
def test_simulated_noise_is_whitened_to_standard_normal(levels: NoiseLevels) -> None:
    model = NoiseModel(make_series(60))
    noise = model.simulate(levels, np.random.default_rng(1), 4)
    white, _ = model.whiten(levels, noise)
    # Kolmogorov-Smirnov at a false-alarm rate of one in a thousand.
    assert kstest(white.ravel(), "norm").pvalue > 1e-3
    lagged = np.mean(white[1:] * white[:-1])
    assert abs(lagged) < 4.0 / np.sqrt(white.size)


def test_the_processes_of_a_longer_record_stay_a_decade_apart() -> None:
    series = make_series(10)
    model = NoiseModel(replace(series, t_s=500.0 * series.t_s))
    later = model.gap_s > 0.0
    taus = -model.gap_s[later][:, None] / np.log(model.decay[later][:, 1:])
    np.testing.assert_allclose(taus[0], [20.0, 200.0, 2e3, 2e4, 2e5], rtol=1e-6)


def test_levels_are_found_again() -> None:
    series = make_series(150)
    model = NoiseModel(series)
    noise = model.simulate(LEVELS, np.random.default_rng(5), 1)[:, 0]
    X = np.column_stack([np.ones(len(series)), series.rate_dps, series.temp_c])
    found = estimate_levels(model, noise, X).levels
    # 1 800 rows: white noise to 2 % (one sigma), the others far less; bounds at four sigma.
    assert found.white == pytest.approx(LEVELS.white, rel=0.08)
    assert found.flicker_dps == pytest.approx(LEVELS.flicker_dps, rel=0.5)
    assert found.jitter == pytest.approx(LEVELS.jitter, rel=0.6)


def test_record_at_rest_needs_no_jitter() -> None:
    series = replace(make_series(40), rate_dps=np.zeros(480))
    model = NoiseModel(series)
    noise = model.simulate(LEVELS, np.random.default_rng(6), 1)[:, 0]
    found = estimate_levels(model, noise, np.ones((480, 1))).levels
    assert found.white == pytest.approx(1.0, rel=0.2)
    assert found.jitter < 1e-6


def test_a_random_walk_is_taken_in_where_there_is_one_and_nowhere_else() -> None:
    series = make_series(150)
    model = NoiseModel(series)
    X = np.column_stack([np.ones(len(series)), series.rate_dps])
    rng = np.random.default_rng(7)
    for levels in (LEVELS, WALKING):
        noise = model.simulate(levels, rng, 6)
        taken = []
        for y in noise.T:
            found, p_value = look_for_walk(model, y, X, estimate_levels(model, y, X))
            taken.append(found.walk if p_value < 0.01 else 0.0)
        if levels.walk:
            # 60 minutes of a walk: its level to a factor of two.
            assert np.median(taken) == pytest.approx(levels.walk, rel=0.5)
        else:
            assert np.count_nonzero(taken) <= 1


def test_a_walk_from_nothing_is_at_the_edge_of_what_a_variance_can_be() -> None:
    """Half of all records of no walk have a likelihood that is highest without: 5 % is the 10 % point of chi-square."""
    without = Likelihood(WALKING, 100.0)
    for p in (0.05, 1e-4):
        gain = 0.5 * float(chi2.isf(2.0 * p, 1))
        assert walk_p_value(Likelihood(WALKING, 100.0 + gain), without) == pytest.approx(p)
    assert walk_p_value(Likelihood(WALKING, 99.0), without) == 0.5


@pytest.mark.slow
def test_a_jitter_that_the_record_hardly_tells_from_none_is_not_taken_for_none() -> None:
    n = 120
    rate_dps = np.tile([-60.0, -20.0, 0.0, 20.0, 60.0], n // 5)
    t_s = 30.0 * np.arange(float(n))
    for seed in range(4):
        gyro = rate_dps + 1e-3 * np.random.default_rng([6, seed]).standard_normal(n)
        table = DataSetTable(Path("sweep.csv"), rate_dps, gyro, 20.0 + np.sin(t_s / 999.0), t_s=t_s)
        model = NoiseModel(series_of_table(table))
        found = estimate_levels(model, gyro - rate_dps, np.column_stack([np.ones(n), rate_dps]))
        # Noise of a row over the largest rate is 17 ppm; the likelihood of two of the four is highest at none.
        assert 8e-6 < found.levels.jitter < 17e-6
