"""Partners, clocks and the difference, against plans of which all is known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, series_of
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import only_surface
from gyrocal.diagnosis.versus.match import match
from gyrocal.errors import DataError
from tests.diagnosis.versus.tables import RATES, SURFACE, plan, table


def real() -> Series:
    t, rate, temp = plan()
    gyro = SURFACE.output_dps(rate, temp) + 3e-4 * np.maximum(rate, 0.0)
    return series_of_table(table("real.csv", t, rate, gyro, temp))


def test_the_same_plan_on_another_clock() -> None:
    """Offset, drift, jitter of the starts, sets that are missing, another thermometer: the difference is the law."""
    t, rate, temp = plan()
    rng = np.random.default_rng(0)
    there = 1000.0 + t * (1 + 80e-6) + rng.normal(0, 0.2, t.size)
    kept = np.ones(t.size, dtype=bool)
    kept[40:47] = False
    gyro = SURFACE.output_dps(rate, temp + 0.4)
    m = match(real(), series_of_table(table("sim.csv", *(x[kept] for x in (there, rate, gyro, temp + 0.4)))))
    assert (m.sets, m.simulated_sets, m.matched_sets, m.in_order) == (t.size, kept.sum(), kept.sum(), True)
    np.testing.assert_array_equal(m.difference.t_s, t[kept])
    assert m.temp_apart_c == pytest.approx(0.4, abs=1e-3)
    # What is left between simulation and recording is the asymmetry: the bridge of 0.4 degC is as exact as the course of
    # the temperature, whose times jitter.
    lacking = m.difference.gyro_dps - m.surface.output_dps(m.difference.rate_dps, m.difference.temp_c)
    np.testing.assert_allclose(lacking, 3e-4 * np.maximum(rate[kept], 0.0), atol=5e-5)
    assert m.clock is not None
    assert abs(m.clock.offset_s - 1000.0) < 4 * m.clock.offset_std_s
    assert abs(m.clock.drift_ppm - 80.0) < 4 * m.clock.drift_std_ppm
    assert 0.1 < m.clock.left_s < 0.3
    assert m.lonely_rates_dps == tuple(sorted(rate[~kept]))
    np.testing.assert_allclose(m.lonely_temp_c, (temp[~kept].min(), temp[~kept].max()))


@pytest.mark.slow
def test_the_clock_interval_covers() -> None:
    """Offset and drift within 1.96 of their standard deviations, in 40 jittered clocks (at 95 %, 32 of 40 in 1e-4)."""
    t, rate, temp = plan(4)
    gyro = SURFACE.output_dps(rate, temp)
    here = series_of_table(table("real.csv", t, rate, gyro, temp))
    inside = np.zeros(2)
    for seed in range(40):
        there = 50.0 + t * (1 - 300e-6) + np.random.default_rng(seed).normal(0, 0.5, t.size)
        clock = match(here, series_of_table(table("sim.csv", np.sort(there), rate, gyro, temp))).clock
        assert clock is not None
        inside += [
            abs(clock.offset_s - 50.0) < 1.96 * clock.offset_std_s,
            abs(clock.drift_ppm + 300.0) < 1.96 * clock.drift_std_ppm,
        ]
    assert inside.min() >= 32


def test_another_order_is_matched_by_rate_and_temperature() -> None:
    """Sorted by rate and temperature and without times, as a look-up table would be."""
    levels = np.linspace(-12.0, 52.0, 33)
    rate, temp = (x.ravel() for x in np.meshgrid(np.sort(RATES), levels, indexing="ij"))
    gyro = SURFACE.output_dps(rate, temp)
    m = match(real(), series_of_table(table("sim.csv", None, rate, gyro, temp)))
    assert not m.in_order
    assert m.clock is None
    assert m.matched_sets == m.sets
    lacking = m.difference.gyro_dps - m.surface.output_dps(m.difference.rate_dps, m.difference.temp_c)
    np.testing.assert_allclose(lacking, 3e-4 * np.maximum(m.difference.rate_dps, 0.0), atol=1e-6)


def test_rates_that_are_drawn_anew_at_each_temperature_are_matched_by_what_they_are() -> None:
    """Half of them follow each other by chance: matched in order, the other half would have no partner."""
    rng = np.random.default_rng(0)
    levels = np.linspace(-10.0, 50.0, 6)
    sets = []
    for name in ("real.csv", "sim.csv"):
        rate = np.concatenate([rng.permutation(RATES) for _ in levels])
        temp = np.repeat(levels, RATES.size)
        t = 60.0 * np.arange(rate.size) + 1000.0 * np.repeat(np.arange(levels.size), RATES.size)
        sets.append(series_of_table(table(name, t, rate, SURFACE.output_dps(rate, temp), temp)))
    m = match(sets[0], sets[1])
    assert not m.in_order
    assert m.matched_sets == m.sets


def test_noise_of_both_counts() -> None:
    t, rate, temp = plan()
    gyro = SURFACE.output_dps(rate, temp)
    two = [
        series_of_table(
            replace(
                table(name, t, rate, gyro, temp), gyro_std_dps=np.full(t.size, std), n=np.full(t.size, 100.0)
            )
        )
        for name, std in (("real.csv", 3e-3), ("sim.csv", 4e-3))
    ]
    np.testing.assert_allclose(match(two[0], two[1]).difference.white_std_dps, 5e-4)


def test_what_does_not_overlap_is_refused() -> None:
    t, rate, temp = plan()
    other = series_of_table(table("sim.csv", t, rate + 3.0, SURFACE.output_dps(rate + 3.0, temp), temp))
    with pytest.raises(DataError, match=r"0 of 130 data sets of the recording have a partner.*Simulate"):
        match(real(), other)


def test_a_simulation_in_rad_per_s_is_told_as_that() -> None:
    t, rate, temp = plan()
    radians = np.radians(rate), np.radians(SURFACE.output_dps(rate, temp))
    other = series_of_table(table("sim.csv", t, *radians, temp))
    with pytest.raises(DataError, match="look like rad/s: write rates and outputs in deg/s"):
        match(real(), other)


def test_a_run_is_matched_row_by_row() -> None:
    """Sample run against itself ten seconds later: every row of every segment, ramps too, and nothing between them."""
    run = series_of(Path(__file__).parents[3] / "sample_data" / "run")
    m = match(run, replace(run, t_s=run.t_s + 10.0, gyro_dps=run.gyro_dps - 0.5))
    assert m.matched_sets == m.sets
    np.testing.assert_array_equal(m.difference.t_s, run.t_s)
    lacking = m.difference.gyro_dps - m.surface.output_dps(run.rate_dps, run.temp_c)
    np.testing.assert_allclose(lacking, 0.5, atol=1e-9)
    np.testing.assert_allclose(m.difference.white_std_dps, np.sqrt(2) * run.white_std_dps)


def test_a_simulation_that_is_nothing_but_a_surface_is_known_between_its_sets() -> None:
    t, rate, temp = plan()
    mine = series_of_table(table("real.csv", t, rate, SURFACE.output_dps(rate, temp) + 0.01, temp))
    # Every other rate, and as far.
    kept = np.isin(np.abs(rate), np.abs(RATES)[::4]) | (np.abs(rate) == np.abs(RATES).max())
    gyro = SURFACE.output_dps(rate, temp)
    coarse = series_of_table(table("sim.csv", t[kept], rate[kept], gyro[kept], temp[kept]))
    some = match(mine, coarse)
    assert some.bridged_sets == 0
    assert some.matched_sets < some.sets
    every = match(mine, coarse, partial(only_surface, coarse, Options()))
    assert every.matched_sets == some.matched_sets
    assert every.matched_sets + every.bridged_sets == every.sets
    assert every.lonely_rates_dps == ()
    off = every.difference.gyro_dps - every.surface.output_dps(rate, temp)
    np.testing.assert_allclose(off, 0.01, atol=1e-6)
    # What lies beyond its rates has nothing to be compared with.
    slower = coarse.take(np.abs(coarse.rate_dps) < 70.0)
    slow = match(mine, slower, partial(only_surface, slower, Options()))
    assert set(np.abs(slow.lonely_rates_dps)) == {80.0, 100.0}


@pytest.mark.slow
@pytest.mark.parametrize("more", [False, True])
def test_a_simulation_with_noise_is_a_surface_where_nothing_else_is_seen_in_it(more: bool) -> None:
    t, rate, temp = plan()
    gyro = SURFACE.output_dps(rate, temp) + 1e-3 * np.random.default_rng(3).standard_normal(t.size)
    seen = only_surface(
        series_of_table(table("sim.csv", t, rate, gyro + more * 2e-4 * np.abs(rate), temp)), Options()
    )
    assert (seen is None) == more
    if seen is not None:
        np.testing.assert_allclose(seen.output_dps(rate, temp), SURFACE.output_dps(rate, temp), atol=2e-3)
