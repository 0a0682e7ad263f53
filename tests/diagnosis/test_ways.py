"""A hysteresis of the rate: located, and told from none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.names.ways import strange_ways
from gyrocal.diagnosis.rows.base import fit_surface
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable
from gyrocal.report.words import region_words
from tests.diagnosis.versus.tables import SURFACE


def table(way_dps: float, seed: int, *, sweeps: bool = False) -> DataSetTable:
    """Ten temperatures of twelve rates, shuffled or from the lowest to the highest, with 0.5 mdeg/s of noise."""
    rng = np.random.default_rng(seed)
    rates = np.linspace(-100.0, 100.0, 12)
    rate = np.concatenate([rates if sweeps else rng.permutation(rates) for _ in range(10)])
    temp = np.repeat(np.linspace(-10.0, 50.0, 10), 12)
    way = np.sign(np.diff(rate, prepend=rate[0]))
    gyro = SURFACE.output_dps(rate, temp) + way_dps * way + 5e-4 * rng.standard_normal(rate.size)
    return DataSetTable(Path("ways.csv"), rate, gyro, temp, t_s=30.0 * np.arange(float(rate.size)))


def rest_of(series: Series) -> np.ndarray:
    """What the surface alone leaves."""
    surface = fit_surface(series).surface
    return np.asarray(series.gyro_dps - surface.output_dps(series.rate_dps, series.temp_c))


def test_it_is_located_with_its_size() -> None:
    """ "Nothing stands out of the noise" had been said of one of eight times the noise, which counted as noise."""
    found = diagnose(table(4e-3, 1), None, Options(heldout=False))
    assert found.verdict == "unexplained"
    place = found.located[0]
    assert (place.coordinate, place.target, place.remains) == ("rate", "way", True)
    assert place.rms_dps == pytest.approx(4e-3, rel=0.1)
    assert "reached from below or from above (" in region_words(place)


def test_noise_has_none_and_a_plan_that_goes_one_way_cannot_tell() -> None:
    for seed in range(100):
        series = series_of_table(table(0.0, seed))
        assert strange_ways(series, rest_of(series), SURFACE) == [], seed
    series = series_of_table(table(4e-3, 1, sweeps=True))
    assert strange_ways(series, rest_of(series), SURFACE) == []
