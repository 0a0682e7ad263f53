"""Bursts, steps of the output and of the thermometer in static logs, where rows are samples; and what there is no time in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyrocal.diagnosis.answer.untimed import between_sets, by_data_set, by_time
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.rows.order import SURROGATE_PERIOD_S
from gyrocal.diagnosis.rows.scatter import (
    clock_findings,
    dead_sets,
    outlier_findings,
    step_findings,
    variance_places,
)
from gyrocal.diagnosis.rows.series import Series
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.strays import set_aside
from gyrocal.inference.whitening import NoiseLevels, NoiseModel
from gyrocal.records.datasets import DataSetTable

NOISE_DPS = 0.01


def make_log(seed: int = 1, n: int = 3000, timed: bool = True) -> DataSetTable:
    """A static log of one sample a second, of a slowly warming gyro."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(float(n))
    temp = 20.0 + 10.0 * np.sin(2 * np.pi * t_s / n)
    gyro = 0.03 + 0.002 * temp + NOISE_DPS * rng.standard_normal(n)
    return DataSetTable(Path("log.csv"), np.zeros(n), gyro, temp, t_s=t_s if timed else None)


SPIKES = np.array([100, 700, 701, 1500, 2900])


@pytest.mark.parametrize("timed", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_bursts_of_a_static_log_are_found_before_rows_are_averaged(timed: bool) -> None:
    table = make_log(timed=timed)
    clean = series_of_table(make_log(timed=timed))
    table.gyro_dps[SPIKES] += 25 * NOISE_DPS
    series = series_of_table(table)
    (found,) = outlier_findings(series)
    assert found.effect == "bursts"
    assert found.seen == Remark(Said.BURST_SAMPLES, {"count": 5, "samples": 3000})
    assert found.parameters["amplitude"].value == pytest.approx(250.0, rel=0.15)
    place = found.place
    assert (place.low, place.high, place.unit) == (
        (100.0, 2900.0, "s") if timed else (101.0, 2901.0, "data set")
    )
    left = np.interp(clean.t_s, series.t_s, series.gyro_dps) - clean.gyro_dps
    assert np.max(np.abs(left)) < 5 * NOISE_DPS


@pytest.mark.slow
def test_noise_alone_has_no_bursts() -> None:
    for seed in range(20):
        assert outlier_findings(series_of_table(make_log(seed))) == []


def test_a_single_wild_row_is_left_out_and_said() -> None:
    table = make_log()
    table.gyro_dps[1234] = 1e30
    series = series_of_table(table)
    assert outlier_findings(series) == []
    assert Remark(Said.STRAY_SAMPLES, {"count": 1}) in series.notes
    assert np.max(np.abs(series.gyro_dps)) < 1.0


@pytest.mark.parametrize(("step_sigmas", "said"), [(2.0, True), (0.1, False)])
def test_output_steps_are_said_where_they_add_noise(step_sigmas: float, said: bool) -> None:
    table, step = make_log(), step_sigmas * NOISE_DPS
    coarse = replace(table, gyro_dps=np.round(table.gyro_dps / step) * step)
    found = step_findings(series_of_table(coarse))
    assert bool(found) == said
    if found:
        assert found[0].effect == "quantisation"
        assert found[0].parameters["amplitude"].value == pytest.approx(1e3 * step, rel=1e-3)


def test_whole_degrees_are_said() -> None:
    table = make_log()
    assert Remark(Said.WHOLE_DEGREES) not in series_of_table(table).notes
    coarse = series_of_table(replace(table, temp_c=np.round(table.temp_c)))
    assert Remark(Said.WHOLE_DEGREES) in coarse.notes


def test_a_plan_that_leaps_between_temperatures_is_taken_as_read() -> None:
    """No smooth course goes through it; one that scatters about a smooth course is not."""
    rng = np.random.default_rng(2)
    n = 66
    leaps, slow = np.repeat([0.0, 40.0] * 3, 11), 20.0 + 5.0 * np.sin(np.arange(n) / 20.0)
    for course_c, as_read in ((leaps, True), (slow, False)):
        read_c = course_c + rng.normal(0.0, 0.05, n)
        table = DataSetTable(
            Path("t.csv"),
            np.tile([-50.0, 0.0, 50.0], 22),
            np.zeros(n),
            read_c,
            t_s=15.0 * np.arange(float(n)),
        )
        assert np.array_equal(series_of_table(table).temp_c, read_c) == as_read


def make_scattering(noise_dps: float, seed: int, follows: bool = True) -> DataSetTable:
    """A thermometer that scatters about a slow course, and a gyro that follows it, or does not."""
    rng = np.random.default_rng(seed)
    n = np.arange(120.0)
    slow_c = 20.0 + 8.0 * np.sin(n / 20.0)
    read_c = slow_c + rng.normal(0.0, 0.3, n.size)
    rate = np.tile([-50.0, 0.0, 50.0], 40)
    gyro = 1.001 * rate + 0.01 * (read_c if follows else slow_c) + noise_dps * rng.standard_normal(n.size)
    return DataSetTable(Path("t.csv"), rate, gyro, read_c, t_s=15.0 * n)


@pytest.mark.parametrize(("noise_dps", "seed"), [(0.006, 2), (0.008, 1), (0.01, 1), (0.012, 3), (0.014, 2)])
def test_a_thermometers_scatter_is_real_where_the_gyro_follows_it(noise_dps: float, seed: int) -> None:
    table = make_scattering(noise_dps, seed)
    course_c = series_of_table(make_scattering(noise_dps, seed, follows=False)).temp_c
    rate, temp = table.rate_dps / 50.0, (course_c - 20.0) / 8.0
    surface = np.column_stack([rate**i * temp**j for i in range(3) for j in range(3)])
    both = np.column_stack([table.gyro_dps - table.rate_dps, table.temp_c - course_c])
    left, scatter = (both - surface @ np.linalg.lstsq(surface, both, rcond=1e-9)[0]).T
    squares = [float(np.sum((left - slope * scatter) ** 2)) for slope in (0.0, 0.01)]
    evidence = 0.5 * left.size * np.log(squares[0] / squares[1])
    assert np.array_equal(series_of_table(table).temp_c, table.temp_c) == (evidence > 3.0)


@pytest.mark.parametrize("spread", [False, True])
def test_rows_of_more_samples_are_known_better(spread: bool) -> None:
    """A single sample has no spread of its own: it takes that of the others."""
    n = np.tile([1.0, 4.0, 100.0], 20)
    std = np.where(n > 1, 0.01, 0.0) * (np.repeat([1.0, 3.0], 30) if spread else 1.0)
    series = series_of_table(replace(make_log(n=60), gyro_std_dps=std, n=n))
    last = 3.0 if spread else 1.0
    white = series.white_std_dps / series.white_std_dps[2]
    typical = np.median(std[n > 1]) / 0.01
    assert white[:3] == pytest.approx([10.0 * typical, 5.0, 1.0])
    assert white[-3:] == pytest.approx([10.0 * typical, 5.0 * last, last])


@pytest.mark.slow
def test_without_time_jumps_and_drifts_are_stated_by_data_set_and_back() -> None:
    timed, untimed = series_of_table(make_log()), series_of_table(make_log(timed=False))
    jump = {"at_s": Estimate(33.5 * SURROGATE_PERIOD_S, 2.0, "s", (665.0, 675.0))}
    assert by_data_set(timed, jump) == jump
    stated = by_data_set(untimed, jump)
    assert stated["at_data_set"].value == 34.5
    assert between_sets(stated) == Remark(Said.BETWEEN_SETS, {"first": 34, "last": 35})
    assert stated["at_data_set"].std == pytest.approx(0.5 / 3.92, rel=0.01)
    assert between_sets(jump) is None
    drift = {
        "amplitude": Estimate(180.0, 18.0, "mdeg/s/h", (150.0, 210.0)),
        "tau_s": Estimate(60.0, 1.0, "s", (50.0, 70.0)),
    }
    stated = by_data_set(untimed, drift)
    assert stated["amplitude"].value == pytest.approx(1.0)
    assert stated["amplitude"].unit == "mdeg/s a data set"
    assert stated["tau_data_sets"].interval_95 == (2.5, 3.5)
    rate = {"amplitude": Estimate(6.0, 0.6, "mdeg/s per degC/min", (4.8, 7.2))}
    stated = by_data_set(untimed, rate)
    assert stated["amplitude"].value == pytest.approx(18.0)
    assert stated["amplitude"].unit == "mdeg/s per degC a data set"
    for parameters in (jump, drift, rate):
        assert by_time(by_data_set(untimed, parameters)) == pytest.approx(
            {name: e.value for name, e in parameters.items()}
        )
    growing = {**drift, "power": Estimate(2.0, 0.1, "1", (1.8, 2.2))}
    stated = by_data_set(untimed, growing)
    # After an hour, of 180 data sets, it is 180 mdeg/s by either.
    assert stated["amplitude"].value * 180.0**2 == pytest.approx(180.0)
    assert by_time(stated) == pytest.approx({name: e.value for name, e in growing.items()})
    assert [untimed.data_set_at(t) for t in (0.0, 5 * SURROGATE_PERIOD_S)] == [1.0, 6.0]


@pytest.mark.parametrize(
    ("most_dps", "noise_dps", "count"), [(170.0, 0.0, 10), (90.0, 2e-3, 30), (300.0, 0.0, 0)]
)
def test_data_sets_of_a_clipped_gyro_are_left_out_and_say_where_it_is(
    most_dps: float, noise_dps: float, count: int
) -> None:
    """At one rate alone, as at several; behind what clips there may be noise. They had been knees, peaks and rates mixed up."""
    table = make_rates(0.0)
    clipped = np.clip(table.gyro_dps, -most_dps, most_dps)
    noise = noise_dps * np.random.default_rng(4).standard_normal(clipped.size)
    series = series_of_table(replace(table, gyro_dps=clipped + noise))
    left, findings, strays = set_aside(series, series.gyro_dps)
    assert len(left) == len(series) - count
    assert not len(strays)
    if not count:
        assert findings == []
        return
    (found,) = findings
    assert found.effect == "saturation"
    assert found.seen.facts["count"] == count
    low, high = found.parameters["knee_dps"].interval_95
    assert low < most_dps / 1.001 < high
    assert found.parameters["knee_dps"].value == pytest.approx(most_dps, rel=0.02)


def test_a_slope_that_makes_up_for_the_bias_at_one_end_is_not_clipped() -> None:
    """Bias and scale factor over temperature that cancel at the largest rate leave it as still, but where the scale factor says."""
    table = make_rates(0.0)
    warm = (table.temp_c - 20.0) / 40.0
    gyro = 1.001 * table.rate_dps + 2.0 * warm - 0.01 * warm * table.rate_dps
    series = series_of_table(replace(table, gyro_dps=gyro))
    assert len(set_aside(series, series.gyro_dps)[0]) == len(series)


def test_a_rate_that_was_visited_at_one_temperature_is_not_clipped_there() -> None:
    """A scale factor that changes by 3 % over temperature leaves the others ten times as wide."""
    table = make_rates(0.0)
    fastest = np.abs(table.rate_dps) == 200.0
    temp_c = np.where(fastest, 55.0, table.temp_c) + 0.1 * np.random.default_rng(5).standard_normal(
        fastest.size
    )
    gyro = table.rate_dps * (1.0 - 3e-2 * (temp_c - 20.0) / 40.0)
    series = series_of_table(replace(table, temp_c=temp_c, gyro_dps=gyro))
    assert len(set_aside(series, series.gyro_dps)[0]) == len(series)


def make_rates(zone_dps: float, bias_dps: float = 0.3, seed: int = 3) -> DataSetTable:
    """A table of 11 rates at 5 temperatures whose output stays 0 for what is smaller than `zone_dps`."""
    rng = np.random.default_rng(seed)
    rate = np.tile(np.linspace(-200.0, 200.0, 11), 5)
    temp = np.repeat(np.linspace(-20.0, 60.0, 5), 11)
    gyro = 1.001 * rate + bias_dps * (1.0 + 0.01 * temp) + 0.003 * rng.standard_normal(rate.size)
    return DataSetTable(Path("made.csv"), rate, np.where(np.abs(gyro) < zone_dps, 0.0, gyro), temp)


def test_data_sets_without_output_are_a_dead_zone_and_do_not_bend_the_surface() -> None:
    series = series_of_table(make_rates(0.6))
    left, findings, _ = set_aside(series, series.gyro_dps)
    (found,) = findings
    assert found.effect == "dead_zone"
    assert found.seen.said is Said.DEAD_SETS
    assert (found.seen.facts["count"], found.seen.facts["sets"]) == (5, 55)
    low, high = found.parameters["width_dps"].interval_95
    assert low == pytest.approx(0.48, abs=0.02)
    assert low < 0.6 < high
    assert found.parameters["amplitude"].value == pytest.approx(1e3 * np.sqrt(np.mean(lost() ** 2)), rel=0.05)
    assert len(left) == 50
    assert not np.any(left.rate_dps == 0)


def lost() -> np.ndarray:
    return 0.3 * (1.0 + 0.01 * np.linspace(-20.0, 60.0, 5))


@pytest.mark.parametrize("what", ["alive", "no bias", "dead at every rate"])
def test_zeros_that_are_no_dead_zone(what: str) -> None:
    """A gyro whose rest is 0 by chance or by its bias loses nothing; one that fails at a high rate is not dead at rest."""
    table = make_rates(0.0 if what == "alive" else 0.6, bias_dps=0.0 if what == "no bias" else 0.3)
    if what == "dead at every rate":
        table.gyro_dps[[0, 12, 30]] = 0.0
    series = series_of_table(table)
    assert dead_sets(series, series.gyro_dps)[0].size == 0


def make_sweeps(n: int) -> Series:
    """Data sets at five rates, one a second."""
    rate_dps = np.tile([-20.0, -10.0, 0.0, 10.0, 20.0], n // 5)
    t_s = np.arange(float(n))
    table = DataSetTable(Path("table.csv"), rate_dps, rate_dps, 20.0 + np.sin(t_s / 99.0), t_s=t_s)
    return series_of_table(table)


WHITE = cast(NoiseModel, SimpleNamespace(whiten=lambda levels, columns: (columns,)))
LEVELS = cast(NoiseLevels, None)


def test_heavy_tails_alone_are_no_place_of_more_scatter() -> None:
    """Of Student's law of 5 degrees of freedom at a level of 5 %: 17 of 200 recordings, where 49 would be without the
    kurtosis."""
    series = make_sweeps(1200)
    draws = [np.random.default_rng([4, seed]).standard_t(5, len(series)) for seed in range(200)]
    assert sum(bool(variance_places(series, WHITE, LEVELS, y, 0.05)) for y in draws) <= 20


def test_two_stretches_of_more_scatter_share_its_excess() -> None:
    """Each is one of the forty into which the time is cut."""
    series = make_sweeps(1200)
    y = np.random.default_rng(5).standard_normal(1200)
    y[90:120] *= 5.0
    (place,) = variance_places(series, WHITE, LEVELS, y, 0.01)
    assert (place.coordinate, place.share) == ("time", 1.0)
    y[690:720] *= 5.0
    (place,) = variance_places(series, WHITE, LEVELS, y, 0.01)
    assert place.share == pytest.approx(0.5, abs=0.1)


def test_of_two_stretches_the_less_probable_one_is_told() -> None:
    """Whichever comes first."""
    series = make_sweeps(1200)
    for strong, weak in ((slice(90, 120), slice(690, 720)), (slice(690, 720), slice(90, 120))):
        y = np.random.default_rng(5).standard_normal(1200)
        y[strong] *= 5.0
        y[weak] = 0.98 * y[strong]
        (place,) = variance_places(series, WHITE, LEVELS, y, 0.01)
        assert place.low == pytest.approx(series.t_s[strong.start], abs=np.ptp(series.t_s) / 40.0)


@pytest.mark.parametrize(
    ("ppm", "std_ppm", "named"), [(80.0, 2.0, True), (80.0, 30.0, False), (15.0, 0.1, False)]
)
def test_a_sample_clock_is_off_where_that_is_beyond_doubt_and_beyond_a_crystal(
    ppm: float, std_ppm: float, named: bool
) -> None:
    series = series_of_table(make_log(n=100))
    raw = replace(series.raw, interval_ratio=1e-6 * ppm, interval_ratio_std=1e-6 * std_ppm)
    found = clock_findings(replace(series, raw=raw))
    assert [f.effect for f in found] == (["time_base"] if named else [])
    if found:
        low, high = found[0].parameters["amplitude"].interval_95
        assert (low, high) == pytest.approx((ppm - 1.96 * std_ppm, ppm + 1.96 * std_ppm), rel=1e-3)
        assert found[0].p_value < 1e-12
