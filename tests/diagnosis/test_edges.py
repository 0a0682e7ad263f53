"""Edges over temperature, which are told from what happens at an instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.correction import correction
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.model.edges import targets, told, with_edges
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.model.starts import fit_anyhow
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

_RATES_DPS = np.array([-80.0, -50.0, -20.0, 0.0, 20.0, 50.0, 80.0])
_NOISE_DPS = 3e-4


def logistic(temp_c: Floats) -> Floats:
    """A scale factor that goes up by 300 ppm about 26 degC, within some tenths of a degree."""
    return np.asarray(3e-4 / (1.0 + np.exp(-(temp_c - 26.0) / 0.1)))


def warmed_and_cooled(seed: int, at_temp: bool, at_instant: bool) -> DataSetTable:
    """Twenty sweeps of seven rates while a room warms up by five degrees and cools down again."""
    rng = np.random.default_rng(seed)
    rate = np.tile(_RATES_DPS, 20)
    t = 20.0 * np.arange(rate.size, dtype=np.float64)
    temp = 23.5 + 5.0 * np.sin(np.pi * t / t[-1])
    scale = (
        2e-4
        + 1e-5 * (temp - 25.0)
        + logistic(temp) * at_temp
        + 3e-4 * (np.arange(rate.size) > 80) * at_instant
    )
    gyro = rate + 0.01 + rate * scale + _NOISE_DPS * rng.standard_normal(rate.size)
    return DataSetTable(Path("room.csv"), rate, gyro, temp, t_s=t)


def holds(edge: Mapping[str, float], name: str, true: float) -> bool:
    return edge[f"{name}_low"] <= true <= edge[f"{name}_high"]


@pytest.mark.slow
def test_intervals_of_an_edge_cover_nearly_what_they_say() -> None:
    """Size, center and width of 20 draws: of 60 intervals of 95 % some 54 hold the truth, beside smooth shapes that share it."""
    held = []
    for seed in range(20):
        found = examine(series_of_table(warmed_and_cooled(100 + seed, at_temp=True, at_instant=False)), 0.01)
        edge = max(told(found.naming.fitted), key=lambda e: abs(e["size"]))
        held += [holds(edge, n, true) for n, true in (("size", 300.0), ("center", 26.0), ("width", 0.2))]
    assert sum(held) >= 51


@pytest.mark.slow
def test_an_edge_that_is_passed_twice_is_no_pair_of_steps() -> None:
    found = examine(series_of_table(warmed_and_cooled(1, at_temp=True, at_instant=False)), 0.01)
    assert [n.law.effect for n in found.naming.named] == ["temperature_order"]
    assert not found.ranked[0].effects
    (edge,) = told(found.naming.fitted)
    assert edge["center_c"] == pytest.approx(26.0, abs=0.15)
    # Of a logistic curve of 0.1 degC the tangent has twice the width.
    assert holds(edge, "size", 300.0)
    assert holds(edge, "width", 0.2)
    temp_c = np.linspace(23.5, 28.5, 200)
    rate_dps = np.full(temp_c.size, 80.0)
    true_dps = 0.01 + rate_dps * (2e-4 + 1e-5 * (temp_c - 25.0) + logistic(temp_c))
    t = 20.0 * np.arange(temp_c.size)
    corrected_dps = Compensator(correction(found)).correct(t, rate_dps + true_dps, temp_c)
    # Two steps would leave 12 mdeg/s, and noise alone 0.1.
    assert np.sqrt(np.mean((corrected_dps - rate_dps) ** 2)) < 1.2e-3


@pytest.mark.slow
def test_a_bias_is_asked_for_edges_where_it_jumps_more_than_once() -> None:
    """20 mdeg/s up about 26 degC as the room warms up, and down again as it cools."""
    assert targets(["scale_step", "bias_step"]) == ("scale",)
    assert targets(["bias_step", "bias_step"]) == ("scale", "bias")
    table = warmed_and_cooled(3, at_temp=False, at_instant=False)
    assert table.temp_c is not None
    by_temp = replace(table, gyro_dps=table.gyro_dps + 0.02 / 3e-4 * logistic(table.temp_c))
    model = full_model(means_of(series_of_table(by_temp)))
    stays = {p.name for p in model.parts}
    without_drifts = model.without([n for n in model.components if n not in stays and "bias" in n])
    fitted = with_edges(fit_anyhow(without_drifts), targets(["bias_step", "bias_step"]))
    # A second one may follow what a logistic curve has beyond the first.
    edge = max(told(fitted), key=lambda e: abs(e["size"]))
    assert not edge["of_scale"]
    assert holds(edge, "size", 20.0)
    assert edge["center_c"] == pytest.approx(26.0, abs=0.15)


@pytest.mark.slow
def test_a_step_at_an_instant_is_no_edge() -> None:
    found = examine(series_of_table(warmed_and_cooled(2, at_temp=False, at_instant=True)), 0.01)
    assert found.ranked[0].effects == {"scale_step"}
    assert not [p for p in found.model.parts if "edge" in p.name]


def test_where_nothing_is_there_are_no_edges() -> None:
    for seed in range(3):
        model = full_model(means_of(series_of_table(warmed_and_cooled(10 + seed, False, False))))
        fitted = fit_anyhow(model)
        assert with_edges(fitted).nll > fitted.nll - 1.0
