"""The search of a table: laws that it tells apart, and models that are averaged by their evidence."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gyrocal.diagnosis.coil import AVERAGED_NATS, Candidate, Change, TableSearch, averaged
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.means import means_of
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.effect import Conditions
from gyrocal.records.datasets import DataSetTable


def test_models_weigh_by_their_evidence_and_far_ones_not_at_all() -> None:
    scores = [10.0, 10.5, 13.0, 10.0 + AVERAGED_NATS + 0.1]
    found = averaged([Candidate(None, (), cast(Any, None), score) for score in scores])
    assert [c.score for _, c in found] == scores[:3]
    expected = np.exp([0.0, -0.5, -3.0])
    assert [w for w, _ in found] == pytest.approx((expected / expected.sum()).tolist())


def _soaks(what: str) -> DataSetTable:
    """A closed-loop gyro at temperatures in turn, up and down, whose bias has 4 mdeg/s per degC of memory."""
    rng = np.random.default_rng(5)
    rates = np.tile([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0], 8)
    target_c = np.repeat([20.0, 35.0, 50.0, 20.0, 5.0, 35.0, 50.0, 20.0], 7)
    seconds = np.arange(40)
    at_s = 40.0 * np.arange(rates.size, dtype=np.float64)
    temp, inside, play = 20.0, 20.0, 20.0
    outside_c, behind_c = np.empty(rates.size), np.empty(rates.size)
    for k, goal in enumerate(target_c):
        reached = []
        for _ in seconds:
            temp += (goal - temp) / 150.0
            inside += (temp - inside) / 400.0
            play = min(max(play, temp - 3.0), temp + 3.0)
            reached.append((temp, temp - inside if what == "shupe_gradient" else play - temp))
        outside_c[k], behind_c[k] = np.mean(reached, axis=0)
    gyro = rates * (1.0002 + 1e-4 * (outside_c - 27.0) / 25.0) + 0.005 + 4e-3 * behind_c
    gyro = gyro + 6e-4 * rng.standard_normal(rates.size)
    return DataSetTable(Path("soaks.csv"), rates, gyro, outside_c, t_s=at_s + 20.0)


@pytest.mark.parametrize(
    ("effect", "shape", "true"), [("shupe_gradient", "tau_s", 400.0), ("thermal_hysteresis", "width_c", 3.0)]
)
def test_what_the_bias_of_a_table_remembers_is_told_from_a_lag_of_its_coil(
    effect: str, shape: str, true: float
) -> None:
    found = examine(series_of_table(_soaks(effect)), 1e-3)
    best = found.ranked[0]
    assert best.coil is None
    assert best.effects == {effect}
    assert best.fitted.model.laws[0].shape[shape] == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize(
    ("change", "shape"),
    [(("bias_step", 7), {"at_s": 390.0}), (("scale_step", 7), {"at_s": 390.0}), (("bias_drift", 0), {}), (("scale_drift", 0), {})],
)  # fmt: skip
def test_a_law_of_time_is_that_of_the_catalogue_less_the_state_at_the_end(
    change: Change, shape: dict[str, float]
) -> None:
    t_s, rate_dps = 60.0 * np.arange(40.0), np.linspace(-50.0, 50.0, 40)
    means = means_of(
        series_of_table(DataSetTable(Path("sweep.csv"), rate_dps, rate_dps, 20.0 + t_s / 600.0, t_s=t_s))
    )
    law = TableSearch(cast(Any, SimpleNamespace(means=means))).law(change)
    assert dict(law.shape) == shape
    effect, ones = find_effect(change[0]), np.ones(40)
    by_rate = "rate_dps" in effect.needs
    c = Conditions(t_s, rate_dps, 20.0 * ones)
    expected = effect.unit_dps(c, shape, None)
    at_end = expected[-1] / (rate_dps[-1] if by_rate else 1.0) * (rate_dps if by_rate else ones)
    np.testing.assert_allclose(law.columns[:, 0], expected - at_end, atol=1e-12)
