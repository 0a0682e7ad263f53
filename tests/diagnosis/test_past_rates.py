"""Heat of past turns: found where it lingers, told from shapes in rate, and taken off another run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.kernels import heat
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

#: Sweeps go out and back, with a pause after each, through temperatures up and down.
_SIZES_DPS = np.array([0.0, 20.0, 40.0, 60.0, 80.0, 100.0])
_SWEEP_DPS = np.concatenate([_SIZES_DPS, _SIZES_DPS[::-1], -_SIZES_DPS, -_SIZES_DPS[::-1]])
_TEMPS_C = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 35.0, 25.0, 15.0, 5.0])
_SET_S, _PAUSE_S, _NOISE_DPS = 25.0, 900.0, 3e-4
_TAU_S, _HOT_DPS = 500.0, 0.008


def warmed(tau_s: float, rates_dps: Floats, seconds: int) -> Floats:
    """Heat of data sets of so many seconds, second by second: a share of 100 deg/s turned for ever, at each set's middle."""
    share, course = 0.0, []
    for rate in np.repeat(rates_dps, seconds):
        share += ((rate / 100.0) ** 2 - share) / tau_s
        course.append(share)
    return np.array(course, dtype=np.float64)[seconds // 2 :: seconds]


def lingering(seed: int, hot_dps: float, bend_dps: float = 0.0) -> DataSetTable:
    """Sweeps at each temperature, and `hot_dps` by past turns or `bend_dps` by the fourth power of the rate."""
    rng = np.random.default_rng(seed)
    pause = int(_PAUSE_S / _SET_S)
    rates, temps, t = [], [], []
    for k, temp in enumerate(_TEMPS_C):
        rates += [*_SWEEP_DPS, *np.zeros(pause)]
        temps += [temp] * (_SWEEP_DPS.size + pause)
        t += [*(_SET_S * (np.arange(_SWEEP_DPS.size + pause) + k * (_SWEEP_DPS.size + pause)))]
    rate, temp_c = np.array(rates), np.array(temps) + 0.05 * rng.standard_normal(len(temps))
    error = hot_dps * warmed(_TAU_S, rate, int(_SET_S)) + bend_dps * (rate / 100.0) ** 4
    error += (
        0.02 + 3e-4 * temp_c + rate * (2e-4 + 1e-5 * temp_c) + _NOISE_DPS * rng.standard_normal(rate.size)
    )
    kept = np.tile(np.arange(_SWEEP_DPS.size + pause) < _SWEEP_DPS.size, _TEMPS_C.size)
    return DataSetTable(
        Path("sweeps.csv"), rate[kept], (rate + error)[kept], temp_c[kept], t_s=np.array(t)[kept]
    )


def found_in(table: DataSetTable) -> Diagnosis:
    return diagnose(table, options=Options(heldout=False))


def names(found: Diagnosis) -> list[str]:
    return [effect.effect for effect in found.effects]


def held(found: Diagnosis) -> dict[str, bool]:
    """Whether the intervals of the heat's parameters hold the truth."""
    (warm,) = [effect for effect in found.effects if effect.effect == "rate_heating"]
    true = {"amplitude": 1e3 * _HOT_DPS, "tau_s": _TAU_S}
    ends = {name: warm.parameters[name].interval_95 for name in true}
    return {name: ends[name][0] <= value <= ends[name][1] for name, value in true.items()}


@pytest.mark.slow
def test_heat_of_past_turns_has_its_name_and_goes_from_another_run() -> None:
    found = found_in(lingering(1, _HOT_DPS))
    assert names(found) == ["rate_heating"]
    assert all(held(found).values())
    rate = np.repeat(np.tile([0.0, 90.0, -45.0, 70.0], 8), 40)
    hot_dps = _HOT_DPS * warmed(_TAU_S, rate, 5)
    temp_c = np.linspace(5.0, 38.0, rate.size)
    own_dps = 0.02 + 3e-4 * temp_c + rate * (2e-4 + 1e-5 * temp_c)
    assert found.improved is not None
    corrected = Compensator(found.improved).correct(
        5.0 * np.arange(rate.size), rate + own_dps + hot_dps, temp_c
    )
    assert np.std(corrected - rate) < 0.3 * np.std(hot_dps)


@pytest.mark.slow
@pytest.mark.parametrize("bend_dps", [0.0, 0.02])
def test_a_shape_in_rate_is_no_heat(bend_dps: float) -> None:
    assert names(found_in(lingering(20, 0.0, bend_dps))) == ["rate_order"] * (bend_dps > 0.0)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_intervals_of_heat_cover() -> None:
    """Of 40 intervals of 95 %, over 20 draws."""
    inside: list[bool] = []
    for seed in range(20):
        found = found_in(lingering(40 + seed, _HOT_DPS))
        inside += held(found).values()
    assert sum(inside) >= 34


def test_the_table_stands_in_the_pauses_between_rows() -> None:
    """Against the sum over the seconds of each data set; between rows as near as usual it goes from one rate to the next."""
    sets = np.array([0.0, 40.0, 80.0, -100.0, -60.0, 30.0])
    rate = np.tile(np.concatenate([sets, np.zeros(30)]), 3)
    t_s = _SET_S * np.arange(rate.size, dtype=np.float64)
    kept = np.tile(np.arange(36) < 6, 3)
    by_sum = 1e4 * warmed(300.0, rate, int(_SET_S))[kept]
    found, _ = heat(t_s[kept], rate[kept], 300.0, None)
    np.testing.assert_allclose(found, by_sum, atol=0.02 * by_sum.max())


@pytest.mark.parametrize("split", [1, 7, 50])
def test_blocks_of_any_size_remember_the_same(split: int) -> None:
    rng = np.random.default_rng(3)
    steps_s = np.where(np.arange(100) % 14 == 0, 400.0, rng.uniform(0.01, 2.0, 100))
    t_s, rate = np.cumsum(steps_s, dtype=np.float64), rng.uniform(-90.0, 90.0, 100)
    rate[[0, 31]] = np.nan
    whole, _ = heat(t_s, rate, 40.0, None)
    memory, parts = None, []
    for first in range(0, 100, split):
        block = slice(first, first + split)
        part, memory = heat(t_s[block], rate[block], 40.0, memory)
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_data_sets_that_are_minutes_apart_are_no_pauses() -> None:
    """Of rows 240 s apart it turned all along; one that comes ten times later came after a pause."""
    rate = np.tile([0.0, 60.0, 100.0, -100.0, -60.0], 6)
    t_s = 240.0 * np.arange(rate.size, dtype=np.float64)
    by_sum = 1e4 * warmed(900.0, rate, 240)
    found, _ = heat(t_s, rate, 900.0, None)
    np.testing.assert_allclose(found, by_sum, atol=0.15 * by_sum.max())
    late = t_s + np.where(np.arange(rate.size) > 14, 7200.0, 0.0)
    assert heat(late, rate, 900.0, None)[0][15] < 0.02 * found.max()


def test_heat_grows_and_decays_by_its_closed_form() -> None:
    """Of 50 deg/s for 600 s and rest after them."""
    t_s = np.arange(0.0, 2400.0, 0.5)
    grown = -np.expm1(-np.minimum(t_s, 600.0) / 300.0)
    expected = 2500.0 * grown * np.exp(-np.maximum(t_s - 600.0, 0.0) / 300.0)
    found, _ = heat(t_s, np.where(t_s <= 600.0, 50.0, 0.0), 300.0, None)
    np.testing.assert_allclose(found, expected, atol=3.0)
