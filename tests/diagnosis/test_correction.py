"""What earns its place in the improved coefficients."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gyrocal.diagnosis.correction import correction, doubtful, mixed
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.layers import fit_model, full_model
from gyrocal.diagnosis.means import means_of
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.fusion.coefficients import parse_coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.datasets import DataSetTable


def _found(nats: float, named: str = "", candidates: tuple[Any, ...] = ()) -> Examination:
    naming = SimpleNamespace(named=[SimpleNamespace(block=named)], unnamed={"memory": nats})
    return cast(Examination, SimpleNamespace(candidates=candidates, naming=naming))


def _left_out(low: float) -> Any:
    return {"memory": SimpleNamespace(logloss_interval_95=(low, 0.1))}


@pytest.mark.parametrize(
    ("found", "low", "expected"),
    [
        (_found(7.0), -0.01, ["memory"]),
        (_found(7.0), 0.01, []),
        (_found(30.0), -0.01, []),
        (_found(7.0, named="memory"), -0.01, []),
        (_found(7.0, candidates=((1.0, None),)), -0.01, []),
    ],
)
def test_a_weak_part_must_predict_what_was_left_out(
    found: Examination, low: float, expected: list[str]
) -> None:
    assert doubtful(found, _left_out(low)) == expected


def test_a_weak_part_that_nothing_was_left_out_for_is_not_written() -> None:
    assert doubtful(_found(7.0), {}) == ["memory"]


def test_models_that_differ_are_known_no_better_than_they_differ() -> None:
    rng = np.random.default_rng(5)
    laws = [
        (0.3, np.array([1.0, 2.0]), np.diag([0.1, 0.2])),
        (0.7, np.array([3.0, -1.0]), np.diag([0.3, 0.1])),
    ]
    mean, covariance = mixed(laws)
    draws = np.concatenate(
        [rng.multivariate_normal(at, within, round(100_000 * w)) for w, at, within in laws]
    )
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.03)


def test_the_file_corrects_what_the_model_explains() -> None:
    """A bump in temperature at rest: the surface gives back what the smooth part was freed of."""
    t_s = 60.0 * np.arange(150.0)
    temp_c = 25.0 + 20.0 * np.sin(t_s / 1500.0)
    bias = 0.01 + 4e-4 * temp_c + 0.02 * np.exp(-(((temp_c - 30.0) / 5.0) ** 2))
    noise = 2e-4 * np.random.default_rng(6).standard_normal(t_s.size)
    table = DataSetTable(Path("rest.csv"), np.zeros(t_s.size), bias + noise, temp_c, t_s=t_s)
    fitted = fit_model(full_model(means_of(series_of_table(table))))
    found = SimpleNamespace(candidates=(), naming=SimpleNamespace(fitted=fitted), comes_again=1.0)
    file = correction(cast(Examination, found))
    left = Compensator(file).correct(t_s, bias, temp_c, t_s - t_s[0], None)
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.std(bias)


def test_what_follows_the_supply_is_corrected_on_another_run() -> None:
    rng = np.random.default_rng(5)
    t = 30.0 * np.arange(80.0)
    supply = 11.9 + rng.uniform(-0.4, 0.4, t.size)
    gyro = 0.01 + 5e-3 * (supply - 11.9) + 2e-4 * rng.standard_normal(t.size)
    table = DataSetTable(Path("rest.csv"), np.zeros(t.size), gyro, 25.0 + 0.1 * np.sin(t / 500.0), t_s=t)
    series = series_of_table(table)
    known = {k: why for k, why in series.untestable.items() if k != "supply"}
    found = diagnose(replace(series, supply_v=supply, untestable=known), None, Options(heldout=False))
    assert "supply_voltage" in {e.effect for e in found.effects}
    assert found.improved is not None
    compensator = Compensator(parse_coefficients(found.improved.to_text(), "improved"))
    here = [compensator.correct(0.0, 0.01 + 5e-3 * (v - 11.9), 25.0, supply_v=v) for v in (11.5, 11.9, 12.3)]
    np.testing.assert_allclose(here, 0.0, atol=3e-4)
