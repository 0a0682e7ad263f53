"""Temperatures that a table visits, and what so many tell of the scale factor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.laws.at_rows import effects_of, laws_of
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.model.parts import AT_FEW, remembering
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.rows.visited import (
    steps_of_scale,
    tells_of_branches,
    temperatures_apart,
    visits_tell,
    visits_turned_at,
)
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.smooth import Frame
from gyrocal.physics.surface import Surface
from gyrocal.physics.thermal import TEMPERATURE_ORDER, THERMAL_HYSTERESIS
from gyrocal.records.datasets import DataSetTable

_CUBIC_DPS, _NOISE_DPS = 0.02, 1e-3
_SURFACE = Surface(
    np.array([[0.02, 0.05, 0.01], [0.3, 0.2, -0.05], [0.01, 0.0, 0.0], [-0.2, 0.03, 0.0]]),
    0,
    100,
    20,
    30,
    "input",
)


def at_temperatures(temps_c: list[float], seed: int = 3) -> tuple[DataSetTable, np.ndarray]:
    """A dwell at each, whose scale factor is cubic in temperature; and the true errors beyond the surface."""
    rng = np.random.default_rng(seed)
    rate = np.tile(np.array([0.0, 10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 100.0, -100.0] * 2), len(temps_c))
    temp = np.repeat(np.array(temps_c), 18)
    t_s = 60.0 * np.arange(rate.size) + 3000.0 * np.repeat(np.arange(len(temps_c)), 18)
    own = _CUBIC_DPS * rate / 100.0 * ((temp - 20.0) / 30.0) ** 3
    output = _SURFACE.output_dps(rate, temp) + own + rng.normal(0.0, _NOISE_DPS, rate.size)
    return DataSetTable(Path("few.csv"), rate, output, temp, t_s=t_s), own


@pytest.mark.parametrize(
    ("temps_c", "has"), [([10.0, 50.0, -10.0], False), ([10.0, 50.0, -10.0, 30.0], True)]
)
def test_four_temperatures_tell_the_next_order_of_the_scale_factor_and_three_do_not(
    temps_c: list[float], has: bool
) -> None:
    table, _ = at_temperatures(temps_c)
    assert visits_turned_at(table.rate_dps, table.temp_c) == len(temps_c)
    assert not visits_tell(len(temps_c))
    model = full_model(means_of(series_of_table(table)))
    assert any(p.block == AT_FEW for p in model.parts) == has
    assert effects_of(AT_FEW) == []


def test_what_four_temperatures_tell_is_corrected_without_a_name() -> None:
    table, _ = at_temperatures([10.0, 50.0, -10.0, 30.0])
    found = diagnose(table, options=Options(heldout=False))
    assert not {e.effect for e in found.effects} & {"temperature_order", "scale_step", "scale_drift"}
    assert [u.coordinate for u in found.unnamed] == ["temperature"]
    assert found.improved is not None
    rate, temp = np.full(5, 80.0), np.linspace(0.0, 45.0, 5)
    output = _SURFACE.output_dps(rate, temp) + _CUBIC_DPS * 0.8 * ((temp - 20.0) / 30.0) ** 3
    # Each after a long soak.
    soaked = [Compensator(found.improved).correct(0.0, x, c) for x, c in zip(output, temp, strict=True)]
    left = np.array(soaked) - rate
    # The surface alone leaves up to 3 mdeg/s between the temperatures.
    assert np.max(np.abs(left)) < 1.5e-3


def test_a_step_within_a_visit_is_told_from_the_surface_and_one_between_two_is_not() -> None:
    means = means_of(series_of_table(at_temperatures([10.0, 50.0, -10.0])[0]))
    # Of nine rates, each twice, the first and the tenth of a visit are rest: it turned at sixteen.
    assert steps_of_scale(means, 4).tolist() == [
        18 * visit + k for visit in range(3) for k in (5, 6, 7, 8, 10, 11, 12, 13, 14)
    ]
    five = means_of(series_of_table(at_temperatures([10.0, 50.0, -10.0, 30.0, 0.0])[0]))
    assert steps_of_scale(five, 4).tolist() == np.flatnonzero(five.rate_dps).tolist()


@pytest.mark.parametrize("from_row", [pytest.param(62, marks=pytest.mark.slow), 54])
def test_a_step_of_the_scale_factor_at_four_temperatures(from_row: int) -> None:
    """Within the last visit it is named; from its beginning on it is as well the temperature's."""
    table, own = at_temperatures([10.0, 50.0, -10.0, 30.0])
    jumped = 1e-3 * table.rate_dps * (np.arange(table.rate_dps.size) >= from_row)
    found = diagnose(replace(table, gyro_dps=table.gyro_dps - own + jumped), options=Options(heldout=False))
    steps = [e for e in found.effects if e.effect == "scale_step"]
    if from_row == 54:
        assert not steps
        return
    low, high = steps[0].parameters["amplitude"].interval_95
    assert low < 1000.0 < high
    low, high = steps[0].parameters["at_s"].interval_95
    assert table.t_s is not None
    assert low < 0.5 * (table.t_s[from_row - 1] + table.t_s[from_row]) < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("jump_dps", "seed"),
    [(0.0, 12), (0.02, 12), (0.02, 14), (0.02, 15)],
)
def test_a_step_between_two_of_five_visits_is_found_or_told_as_noise(jump_dps: float, seed: int) -> None:
    """It is as well a bias that wanders; what stands ten sigmas out of the scatter of a visit is never passed over."""
    rng = np.random.default_rng(seed)
    rate = np.tile(np.linspace(-75.0, 75.0, 16), 5)
    temp = np.repeat(np.linspace(-20.0, 60.0, 5), 16)
    t_s = 900.0 + 30.0 * np.arange(80) + 1800.0 * np.repeat(np.arange(5), 16)
    output = 1.002 * rate + 0.01 + 2e-4 * temp + jump_dps * (t_s > t_s[47]) + rng.normal(0.0, 2e-3, 80)
    found = diagnose(
        DataSetTable(Path("one.csv"), rate, output, temp, t_s=t_s), options=Options(heldout=False)
    )
    told = [n for n in found.notes if isinstance(n, Remark) and n.said is Said.WANDERS]
    if jump_dps:
        assert told or found.effects or any(u.coordinate != "rate" for u in found.unnamed)
    else:
        assert not told
    for remark in told:
        assert remark.facts["slow_mdps"] > 1.5 * remark.facts["fast_mdps"]


def test_a_temperature_that_drifts_is_no_second_one() -> None:
    """45 and 47 degC on either side of an edge had been two of four, and a cubic through three and a half was 20 times off."""
    visited = np.concatenate([x + np.linspace(0.0, 0.4, 11) for x in (-29.0, 45.2, 59.0, 46.9, -29.3)])
    frame = Frame(100.0, 15.0, 44.5, 0.0)
    assert temperatures_apart(visited, frame) == 3
    assert temperatures_apart(np.linspace(-29.5, 59.5, 11), frame) == 11
    assert temperatures_apart(np.linspace(-29.5, 59.5, 500), frame) == 11


@pytest.mark.parametrize(("temperatures", "orders"), [(3, set()), (4, {3.0}), (5, {3.0, 4.0})])
def test_an_order_of_the_temperature_needs_more_temperatures_than_it_is(
    temperatures: int, orders: set[float]
) -> None:
    up = np.linspace(-10.0, 60.0, temperatures)
    temp_c = np.repeat(np.concatenate([up, up[-2::-1]]), 11)
    rate_dps = np.tile(np.linspace(-100.0, 100.0, 11), 2 * temperatures - 1)
    gyro_dps = rate_dps + _NOISE_DPS * np.random.default_rng(3).standard_normal(rate_dps.size)
    means = means_of(series_of_table(DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c)))
    laws = laws_of(means, _SURFACE)
    assert {t.shape["order"] for t in laws.trials(TEMPERATURE_ORDER)} == orders


@pytest.mark.parametrize(
    ("temps_c", "told"),
    [([8.0, -14.0, 53.0, 32.0], False), ([8.0, -14.0, 53.0, 32.0, -5.0], True)],
)
def test_four_visits_tell_of_no_branch(temps_c: list[float], told: bool) -> None:
    """Through four temperatures a branch of the bias goes as a cubic does: one had made a file three times worse than the surface."""
    means = means_of(series_of_table(at_temperatures(temps_c)[0]))
    assert tells_of_branches(means.temp_c) is told
    plays = [c for p in remembering(means) for c in p.columns if c.driver.kind == "play"]
    assert bool(plays) is told
    blank = Surface(np.zeros((4, 3)), 0.0, 100.0, 20.0, 30.0)
    assert bool(laws_of(means, blank).trials(THERMAL_HYSTERESIS)) is told
