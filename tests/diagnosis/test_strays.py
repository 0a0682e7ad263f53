"""Single data sets that are off by themselves, told from steps of the bias and of the scale factor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.diagnosis.sweeps.coil import table_search
from gyrocal.diagnosis.sweeps.strays import NO_STRAYS, Strays, gross_strays, stray_findings, strays_beside
from gyrocal.records.datasets import DataSetTable
from gyrocal.report.remarks import WORDS

NOISE_DPS = 1e-3


def make_sweeps(seed: int, off_dps: dict[int, float], step_dps: float = 0.0) -> DataSetTable:
    """Seven sweeps of nine rates at one temperature after another, some rows off, and the bias with a step after 30."""
    rng = np.random.default_rng(seed)
    rate = np.tile(np.linspace(-80.0, 80.0, 9), 7)
    temp = np.repeat(np.linspace(20.0, 20.9, 7), 9)
    noise: NDArray[np.float64] = NOISE_DPS * rng.standard_normal(rate.size)
    gyro = 1.0004 * rate + 0.01 + noise + step_dps * (np.arange(rate.size) >= 30)
    at_s = 60.0 * np.arange(rate.size, dtype=np.float64)
    for row, dps in off_dps.items():
        gyro[row] += dps
    return DataSetTable(Path("sweeps.csv"), rate, gyro, temp, t_s=at_s + 30.0)


def without_laws(table: DataSetTable) -> list[Candidate]:
    """The model of a table that has no law of time."""
    return [table_search(full_model(means_of(series_of_table(table)), memory=False)).fit(None, (), None)]


def found_in(table: DataSetTable) -> Strays:
    return strays_beside(without_laws(table), NO_STRAYS)


@pytest.mark.slow
def test_noise_has_no_stray_data_set() -> None:
    assert [len(found_in(make_sweeps(seed, {}))) for seed in range(20)] == [0] * 20


def test_more_strays_than_may_be_are_none() -> None:
    """Each twice the one before stands out beside those that were found: the last one had no offset, and `diagnose` failed."""
    off_dps = {5 + 5 * k: 0.02 * 2.2**k for k in range(12)}
    table = make_sweeps(1, off_dps)
    assert len(off_dps) > 0.15 * table.rate_dps.size
    assert found_in(table) is NO_STRAYS


@pytest.mark.parametrize("off_dps", [0.02, -0.5])
def test_a_stray_data_set_is_found_with_how_far_it_is_off(off_dps: float) -> None:
    found = found_in(make_sweeps(1, {40: off_dps}))
    assert found.numbers.tolist() == [40]
    assert abs(found.off_dps[0] - off_dps) < 4.0 * NOISE_DPS


def test_how_sure_a_stray_is_goes_by_how_far_it_is_off_and_out_of_how_many() -> None:
    series = series_of_table(make_sweeps(1, {}))
    sets = np.unique(series.set_index).size
    five = Strays(np.array([3]), np.array([5e-3]), np.array([1e-3]))
    (found,) = stray_findings(series, five)
    assert found.p_value == pytest.approx(sets * 5.733e-7, rel=1e-3)


def test_of_so_many_rows_a_tenth_stray_is_none_of_a_few() -> None:
    ranked = without_laws(make_sweeps(2, {20: 0.02}))
    known = Strays(np.arange(50, 59), np.full(9, 0.02), np.full(9, NOISE_DPS))
    assert len(strays_beside(ranked, NO_STRAYS)) == 1
    assert len(strays_beside(ranked, known)) == 0


@pytest.mark.parametrize(
    ("off_dps", "numbers"),
    [
        ({3: 0.02}, [3]),
        ({59: -0.02}, [59]),
        ({0: 0.02}, [0]),
        ({1: 0.02}, [1]),
        ({62: 0.02}, [62]),
        ({k: 0.04 * 0.7**k for k in range(6)}, []),
        (dict.fromkeys(range(4), 0.02), []),
        (dict.fromkeys(range(60, 63), 0.02), []),
    ],
)
def test_near_an_end_a_set_is_a_stray_where_those_beyond_it_are_not_off(
    off_dps: dict[int, float], numbers: list[int]
) -> None:
    """One of the first four had been taken for two steps and a drift."""
    assert found_in(make_sweeps(3, off_dps)).numbers.tolist() == numbers


def test_a_set_at_a_large_rate_among_many_small_ones_is_no_stray_by_the_thermometer() -> None:
    """Half a degree that a thermometer of whole degrees does not tell is nothing at 1 deg/s and 20 mdeg/s at 100."""
    rng = np.random.default_rng(4)
    sizes = np.array([0.1, 0.2, 0.5, 1.0, 5.0, 10.0, 50.0, 100.0])
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 5)
    temp = np.repeat([-8.0, 30.0, 30.0, 12.0, -8.0], 17) + np.tile(np.linspace(-0.5, 0.5, 17), 5)
    gyro = rate * (1.0 + 2e-4 * temp) + 0.01 + 7e-4 * rng.standard_normal(rate.size)
    at_s = 60.0 * np.arange(rate.size, dtype=np.float64)

    def strays(off_dps: float) -> Strays:
        off = np.where(np.arange(rate.size) == 43, off_dps, 0.0)
        return gross_strays(
            series_of_table(DataSetTable(Path("t.csv"), rate, gyro + off, np.round(temp), t_s=at_s))
        )

    assert len(strays(0.0)) == 0
    assert strays(0.3).numbers.tolist() == [43]


@pytest.mark.slow
def test_one_stray_data_set_is_not_two_steps_and_a_step_is_not_strays() -> None:
    found = examine(series_of_table(make_sweeps(4, {40: 0.02}, step_dps=0.02)), 1e-3)
    assert found.strays.numbers.tolist() == [40]
    assert [(c.effect, c.at) for c in found.ranked[0].changes] == [("bias_step", 30.0)]
    assert len(found.series) == 62


def test_a_stray_data_set_is_said_and_nothing_else_is_named() -> None:
    found = diagnose(series_of_table(make_sweeps(5, {40: 0.02})))
    assert [e.effect for e in found.effects] == ["bursts"]
    seen = found.effects[0].seen
    assert seen is not None
    ((number, rate_dps, _, off_mdps),) = seen.facts["sets"]
    assert (number, rate_dps) == (41, pytest.approx(0.0))
    assert off_mdps == pytest.approx(20.0, abs=4.0)
    low, high = found.effects[0].parameters["amplitude"].interval_95
    assert low < 20.0 < high


@pytest.mark.slow
@pytest.mark.parametrize("off_dps", [0.03, 0.06, 0.3])
def test_what_is_off_at_one_rate_whenever_it_is_visited_is_no_stray(off_dps: float) -> None:
    """Six sets at one of fifteen rates had been six disturbed ones; a disturbed one beside them still is."""
    rng = np.random.default_rng(1)
    rates = np.linspace(-100.0, 100.0, 15)
    rate = np.concatenate([rng.permutation(rates) for _ in range(6)])
    temp = np.repeat(np.linspace(-20.0, 60.0, 6), 15) + 0.05 * rng.standard_normal(90)
    gyro = 1.01 * rate + 0.2 + 3e-3 * rng.standard_normal(90) + off_dps * (rate == rates[10])
    table = DataSetTable(Path("t.csv"), rate, gyro, temp)
    found = diagnose(table, options=Options(heldout=False))
    names = {e.effect for e in found.effects}
    assert "bursts" not in names
    assert names & {"reference_rate_error", "mechanical_resonance"}
    gyro[33] += 0.6
    assert gross_strays(series_of_table(table)).numbers.tolist() == [33]


def make_disturbed(seed: int, off: NDArray[np.int64], asymmetry: float = 0.0) -> DataSetTable:
    """Nineteen rates in any order at each of seven temperatures, some sets 20 to 150 standard deviations off."""
    rng = np.random.default_rng(seed)
    sizes = np.array([0.5, 2.0, 5.0, 10.0, 20.0, 35.0, 50.0, 70.0, 100.0])
    rates = np.concatenate([-sizes[::-1], [0.0], sizes])
    temps = np.array([25.0, 50.0, 35.0, 5.0, -10.0, 15.0, 30.0])
    rate = np.concatenate([rng.permutation(rates) for _ in temps])
    temp = np.repeat(temps, rates.size) + 0.1 * rng.standard_normal(rate.size)
    v = (temp - 20.0) / 30.0
    gyro = rate * (1.001 + 3e-4 * v) + 0.01 + 4e-3 * v - 3e-3 * v**2 + asymmetry * np.maximum(rate, 0.0)
    gyro += NOISE_DPS * rng.standard_normal(rate.size)
    gyro[off] += rng.choice([-1.0, 1.0], off.size) * NOISE_DPS * np.geomspace(20.0, 150.0, off.size)
    return DataSetTable(Path("t.csv"), rate, gyro, temp, t_s=120.0 * np.arange(rate.size, dtype=np.float64))


def here_and_there(seed: int, share: float) -> NDArray[np.int64]:
    return np.sort(np.random.default_rng(seed).choice(133, round(share * 133), replace=False))


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.03, 0.08])
def test_beside_disturbed_sets_a_law_is_named_and_nothing_else(share: float) -> None:
    off = here_and_there(1, share)
    found = diagnose(make_disturbed(1, off, asymmetry=2e-4), options=Options(heldout=False))
    assert sorted(e.effect for e in found.effects) == ["bursts", "scale_asymmetry"]
    (said,) = [e.seen for e in found.effects if e.effect == "bursts"]
    assert said is not None
    assert sorted(number - 1 for number, *_ in said.facts["sets"]) == off.tolist()


@pytest.mark.slow
def test_more_disturbed_sets_than_can_be_left_out_are_told() -> None:
    off = here_and_there(2, 0.2)
    found = diagnose(make_disturbed(2, off), options=Options(heldout=False))
    (told,) = [n for n in found.notes if isinstance(n, Remark) and n.said is Said.FAR_SETS]
    assert set(told.facts["sets"]) <= {int(n) + 1 for n in off}
    assert len(told.facts["sets"]) > 0.6 * off.size
    words = WORDS[Said.FAR_SETS]
    assert callable(words)
    assert "of 133 data sets" in words(**told.facts)


def test_sets_of_one_rate_that_are_off_together_are_physics() -> None:
    """What lives at one rate, or at one temperature, is not left out as disturbed."""
    table = make_disturbed(3, here_and_there(3, 0.0))
    one_rate = np.flatnonzero(np.abs(np.abs(table.rate_dps) - 35.0) < 0.1)[::2]
    table.gyro_dps[one_rate] += 0.1
    assert len(gross_strays(series_of_table(table))) == 0
    table.gyro_dps[one_rate] -= 0.1
    scattered = here_and_there(4, one_rate.size / 133)
    table.gyro_dps[scattered] += 0.1
    assert gross_strays(series_of_table(table)).numbers.tolist() == scattered.tolist()


def test_sets_that_are_off_in_one_stretch_or_at_one_supply_are_physics() -> None:
    """Seven sets of a brown-out, four of which were off by enough, had been disturbed ones, and its law lost them."""
    table = make_disturbed(5, here_and_there(5, 0.0))
    off = np.array([60, 63, 64, 66])
    table.gyro_dps[off] += 0.1
    assert len(gross_strays(series_of_table(table))) == 0
    table.gyro_dps[off] -= 0.1
    apart = np.array([10, 55, 71, 120])
    table.gyro_dps[apart] += 0.1
    series = series_of_table(table)
    assert gross_strays(series).numbers.tolist() == apart.tolist()
    supply_v = 12.0 + 1e-3 * np.random.default_rng(6).standard_normal(len(series))
    supply_v[apart] += 0.6
    assert len(gross_strays(replace(series, supply_v=supply_v))) == 0
