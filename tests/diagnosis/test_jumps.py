"""Jumps of the bias, on a table at one rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.laws import jumps
from gyrocal.diagnosis.laws.at_rows import GAIN, laws_of
from gyrocal.diagnosis.laws.jumps import Jump, with_jumps
from gyrocal.diagnosis.model.layers import full_model, surface_of
from gyrocal.diagnosis.model.starts import fit_anyhow, wandering
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable

_SETS = 90
_PERIOD_S = 30.0


def jumps_in(added_dps: NDArray[np.float64], seed: int) -> list[Jump]:
    """What is found in data sets at rest, of noise of 0.4 mdeg/s and what is added."""
    t = _PERIOD_S * np.arange(_SETS, dtype=np.float64)
    noise = 4e-4 * np.random.default_rng(seed).standard_normal(_SETS)
    temp = 25.0 + 0.1 * np.sin(t / 500.0)
    table = DataSetTable(Path("rest.csv"), np.zeros(_SETS), 0.01 + noise + added_dps, temp, t_s=t)
    full = full_model(means_of(series_of_table(table)))
    fitted = fit_anyhow(full)
    laws = laws_of(full.means, surface_of(fitted.model, fitted.solve()))
    return with_jumps(fitted, wandering(full), laws)[1]


def test_a_jump_is_found_at_its_instant() -> None:
    (found,) = jumps_in(np.where(np.arange(_SETS) >= 40, 3e-3, 0.0), 1)
    assert found.law.effect == "bias_step"
    assert abs(found.law.shape["at_s"] - 39.5 * _PERIOD_S) <= 0.5 * _PERIOD_S
    assert found.rivals["bias_drift"] > GAIN


@pytest.mark.slow
def test_instants_that_were_tried_are_paid_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The evidence of the best of many instants counts less by the logarithm of the root of their number."""
    step_dps = np.where(np.arange(_SETS) >= 40, 3e-3, 0.0)
    (found,) = jumps_in(step_dps, 1)
    paid = 0.5 * np.log(found.trials)
    monkeypatch.setattr(jumps, "GAIN", found.gain - 1.05 * paid)
    assert len(jumps_in(step_dps, 1)) == 1
    monkeypatch.setattr(jumps, "GAIN", found.gain - 0.5 * paid)
    assert not jumps_in(step_dps, 1)


def test_a_walk_is_no_jump() -> None:
    for seed in range(3):
        steps = np.random.default_rng([7, seed]).standard_normal(_SETS)
        assert not jumps_in(4e-4 * np.cumsum(steps), seed)


@pytest.mark.parametrize("seed", range(2))
def test_a_jump_between_temperatures_is_none_of_what_follows_the_temperature(seed: int) -> None:
    """Each temperature once, out and back: a hysteresis and a shape in temperature can follow the jump together."""
    rng = np.random.default_rng(seed)
    temp = np.repeat([-7.0, 11.0, 31.0, 49.0, 41.0, 22.0], 15)
    t = _PERIOD_S * np.arange(temp.size, dtype=np.float64)
    gyro = 0.01 + np.where(temp.size / 2 <= np.arange(temp.size), 3e-3, 0.0)
    gyro += 4e-4 * rng.standard_normal(temp.size)
    temp += 0.1 * rng.standard_normal(temp.size)
    table = DataSetTable(Path("soaks.csv"), np.zeros(temp.size), gyro, temp, t_s=t)
    found = examine(series_of_table(table), 0.01).naming
    assert [n.law.effect for n in found.named] == ["bias_step"]
    assert not found.unnamed


def test_rates_that_hardly_turn_have_no_scale_factor_of_their_own() -> None:
    """Lost in a dead zone at first, they would need one that is nothing; no gyro's jumps by as much."""
    rng = np.random.default_rng(3)
    small, large = [0.01, 0.011, 0.018, 0.019], [0.03, 0.06, 6.0, 17.0, 31.0, 49.0, 70.0, 90.0]
    sweep = np.array([sign * size for size in small + large for sign in (1.0, -1.0)])
    rate = np.concatenate([np.zeros(20), sweep, *[np.concatenate([np.zeros(5), sweep[8:]])] * 3])
    gyro = np.where(np.abs(rate) < 0.02, 0.0, 1.001 * rate) + 0.01 + 3e-4 * rng.standard_normal(rate.size)
    t = _PERIOD_S * np.arange(rate.size, dtype=np.float64)
    table = DataSetTable(Path("small.csv"), rate, gyro, 25.0 + 0.1 * np.sin(t / 500.0), t_s=t)
    full = full_model(means_of(series_of_table(table)))
    fitted = fit_anyhow(full)
    laws = laws_of(full.means, surface_of(fitted.model, fitted.solve()))
    # Without shapes near zero nothing else takes them.
    bare = fitted.refit(fitted.model.without([n for n in fitted.model.components if "near zero" in n]))
    for one in (fitted, bare):
        assert "scale_step" not in {j.law.effect for j in with_jumps(one, wandering(full), laws)[1]}
