"""What a step response that only nearly holds does to later rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.model.settling import settling
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

_SET_S, _NOISE_DPS = 20, 1e-3


def crept(rate_dps: Floats, tau_s: float) -> Floats:
    """Low-passed rate less the rate, second by second, as means of data sets; the first has been turned for long."""
    past, course = float(rate_dps[0]), []
    for rate in np.repeat(rate_dps, _SET_S):
        past += (rate - past) / tau_s
        course.append(past - rate)
    return np.asarray(np.reshape(course, (-1, _SET_S)).mean(axis=1), dtype=np.float64)


def table(seed: int) -> DataSetTable:
    """Shuffled rates through a room that warms and cools."""
    rng = np.random.default_rng(seed)
    rate = np.concatenate([rng.permutation(np.linspace(-100.0, 100.0, 17)) for _ in range(6)])
    temp_c = 25.0 + 8.0 * np.sin(np.arange(rate.size) / 15.0)
    error = 0.01 + 1e-3 * temp_c + rate * 3e-4
    gyro = rate + error + _NOISE_DPS * rng.standard_normal(rate.size)
    return DataSetTable(Path("t.csv"), rate, gyro, temp_c, t_s=_SET_S * np.arange(float(rate.size)))


@pytest.mark.parametrize("tau_s", [8.0, 23.0, 45.0])
def test_what_creeps_is_a_sum_of_its_columns_and_of_the_surface(tau_s: float) -> None:
    means = means_of(series_of_table(table(1)))
    (component,) = settling(means)
    assert component.columns is not None
    u = means.rate_dps / 100.0
    shapes = np.column_stack([component.columns, u**0, u, u**2, u**3])
    wanted = crept(means.rate_dps, tau_s)
    rest = wanted - shapes @ np.linalg.lstsq(shapes, wanted, rcond=None)[0]
    assert np.std(rest) < 0.05 * np.std(wanted)


def test_it_takes_nothing_that_bias_and_scale_factor_may_be() -> None:
    means = means_of(series_of_table(table(1)))
    (component,) = settling(means)
    assert component.columns is not None
    np.testing.assert_allclose(component.columns.sum(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(component.columns.T @ means.rate_dps, 0.0, atol=1e-6)


def test_where_the_rate_never_changes_there_is_none() -> None:
    still = table(1)
    one = DataSetTable(still.source, np.zeros(60), still.gyro_dps[:60], still.temp_c[:60])
    assert settling(means_of(series_of_table(one))) == []
