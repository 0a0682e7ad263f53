"""Units of one type against one simulation: what they share is told from what is each unit's own."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import Versus, versus
from gyrocal.diagnosis.versus.between import Between, _pooled, between
from gyrocal.report.between import between_file, between_table, between_told
from tests.diagnosis.versus.tables import SURFACE, plan, table

NOISE_DPS = 3e-4
BIAS_DPS = (0.0, 8e-3, -5e-3)
ASYMMETRY = 500e-6


@pytest.fixture(scope="module")
def units() -> tuple[list[Versus], list[Between]]:
    """Three units that share an asymmetry of 500 ppm and have each a bias of its own."""
    t, rate, temp = plan(8)
    simulated = SURFACE.output_dps(rate, temp)
    answers = []
    for number, bias in enumerate(BIAS_DPS):
        noise = np.random.default_rng(number).normal(0, NOISE_DPS, t.size)
        gyro = simulated + bias + ASYMMETRY * np.maximum(rate, 0.0) + noise
        real = series_of_table(table(f"unit{number}.csv", t, rate, gyro, temp))
        sim = series_of_table(table("sim.csv", t, rate, simulated, temp))
        answers.append(versus(real, sim, Options(heldout=False)))
    return answers, between(answers)


@pytest.mark.slow
def test_what_differs_is_told_from_what_does_not(units: tuple[list[Versus], list[Between]]) -> None:
    _, found = units
    assert found[0].of == "surface"
    assert found[0].name.startswith("bias at")
    assert [b.name for b in found if b.differs] == [found[0].name]
    low, high = found[0].spread.spread_interval_95
    assert low < 1e3 * np.std(BIAS_DPS, ddof=1) < high
    shared = next(b for b in found if b.of == "scale_asymmetry")
    assert not shared.differs
    low, high = shared.spread.mean_interval_95
    assert low < 500.0 < high


def test_a_parameter_is_pooled_where_its_uncertainty_is_known() -> None:
    """Of a parameter that is chosen from a few values nobody knows one: its mean had been no number."""
    near, other, far = (Estimate.normal(v, 0.1, "1") for v in (2.0, 2.1, 5.0))
    assert _pooled([near, other], near) == pytest.approx(2.05)
    assert _pooled([near, far], far) == 5.0
    assert _pooled([near], None) == 2.0
    three, four = Estimate.exact(3.0, "1"), Estimate.exact(4.0, "1")
    assert _pooled([three, four], four) == 4.0
    assert _pooled([three, four], None) == 3.0


@pytest.mark.slow
def test_it_is_said_and_written(units: tuple[list[Versus], list[Between]]) -> None:
    answers, found = units
    said = between_told(answers, found)
    assert said[1].startswith("Bias at")
    assert "differs between them" in said[1]
    assert "amplitude of scale_asymmetry" in said[2]
    assert said[2].startswith("No difference")
    document = json.loads(between_file(answers, found))
    assert document["recordings"][2]["recording"] == "unit2.csv"
    assert document["parameters"][0]["differs"]
    assert len(document["parameters"][0]["values"]) == 3
    rows = between_table(answers, found).rows
    assert rows[0][5] == "yes"
    assert len(rows[0]) == 9
