"""Rows of a run, whose reference rate is the one that `fit` takes, and of a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.calibration.datasets import load_recording
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.series import _Samples, _white_std, missing_samples, series_of_run
from gyrocal.diagnosis.rows.table_series import _scatter_is_real, series_of_table
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.run import read_run
from gyrocal.report.remarks import remark_words
from tests.calibration.runs import Part, bench_row, gyro_row, write_run

T_S = np.arange(0.0, 20.0, 0.1)


def part(rate_dps: float, true_dps: float, unrest_dps: float = 0.0, wrap: bool = False) -> Part:
    """Twenty seconds at a command, with a report and an angle each second."""
    rng = np.random.default_rng(1)
    rows = []
    for i, t in enumerate(T_S):
        if i % 10 == 0:
            angle = true_dps * t + rng.normal(0, 1e-4)
            angle = angle % 360.0 if wrap else angle
            rows.append(bench_row(t, f"{rate_dps + unrest_dps * rng.standard_normal():.6f}", f"{angle:.6f}"))
        rows.append(gyro_row(t, true_dps + 1e-3 * rng.standard_normal()))
    return Part(rows, rate_dps=rate_dps)


def test_diagnose_and_fit_take_the_same_reference(tmp_path: Path) -> None:
    parts = [part(50.0, 50.0005, 0.01), part(-20.0, -20.01), part(80.0, 80.0, 0.01, wrap=True)]
    path = write_run(tmp_path / "run", parts)
    series, sets = series_of_run(read_run(path)), load_recording(path).sets
    rates = [series.rate_dps[series.set_index == n][0] for n in np.unique(series.set_index)]
    assert rates == pytest.approx(sets.rate_dps, abs=1e-12)
    assert rates[:2] == pytest.approx([50.0005, -20.01], abs=1e-4)
    assert list(sets.reference) == ["angle", "angle", "table"]
    assert sum("is the angle wrapped?" in remark_words(note) for note in series.notes) == 1


def test_a_data_set_at_one_step_of_the_output_is_off_by_its_rounding() -> None:
    rows = {
        "count": np.array([100.0, 100.0, 100.0]),
        "sample_s": np.full(3, 0.1),
        "set_index": np.array([0.0, 1.0, 2.0]),
    }
    none = np.empty(0)
    taken = [
        _Samples(
            k, True, "", 0.1, none, none, none, none, set_aside=0, span_s=9.9, n=100, missing=0, noise_dps=std
        )
        for k, std in enumerate((0.0, 0.0, 0.02))
    ]
    rounding_dps = 0.05 / np.sqrt(12.0)
    stated = _white_std(rows, taken, rounding_dps)
    np.testing.assert_allclose(stated, [rounding_dps, rounding_dps, rounding_dps / 10.0])
    assert np.all(_white_std(rows, taken[:2] * 2, 0.0) > 0.0)


def test_a_failed_segment_is_counted_and_moves_no_other(tmp_path: Path) -> None:
    still = replace(part(10.0, 10.0), rows=[gyro_row(t, 10.0) for t in T_S])
    parts = [replace(part(50.0, 50.0), outcome="failed"), part(-20.0, -20.0), still, part(80.0, 80.0)]
    series = series_of_run(read_run(write_run(tmp_path / "run", parts)))
    assert np.unique(series.set_index).tolist() == [1, 2, 3]
    noise_dps = [np.median(series.white_std_dps[series.set_index == n]) for n in (1, 2, 3)]
    # What stands at one step is off by its rounding, of which so short a run does not tell; the others by their scatter.
    assert noise_dps[0] == pytest.approx(noise_dps[2], rel=0.5)
    assert sum("failed" in remark_words(note) for note in series.notes) == 1


def test_a_step_is_from_the_rate_that_the_table_had_before(tmp_path: Path) -> None:
    """Where nothing is used of a segment the table turned all the same: 15 deg/s had been the step after a failed one of 85."""
    parts = [part(50.0, 50.0), replace(part(85.0, 85.0), outcome="failed"), part(-20.0, -20.0)]
    series = series_of_run(read_run(write_run(tmp_path / "run", parts)))
    assert series.step_dps is not None
    steps = [series.step_dps[series.set_index == n][0] for n in (0, 2)]
    assert steps == pytest.approx([50.0, -105.0], abs=0.01)


def test_set_points_of_a_plan_are_the_temperatures_as_they_are_written() -> None:
    """Seven of them, ten degrees apart, are no thermometer of steps of ten degrees."""
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 21), np.linspace(-10.0, 50.0, 7)))
    gyro = 90.0 * np.sin(rate / 90.0)
    series = series_of_table(DataSetTable(Path("plan.csv"), rate, gyro, temp))
    np.testing.assert_array_equal(series.temp_c, temp)
    assert series.history.covariance_at(series.t_s) is None


def dithered(course_c: NDArray[np.float64], step_c: float, seed: int) -> DataSetTable:
    """A table whose temperatures are means of 60 readings in steps, 0.15 steps of noise about a course."""
    rng = np.random.default_rng(seed)
    read = course_c[:, None] + 0.15 * max(step_c, 0.5) * rng.standard_normal((course_c.size, 60))
    mean = (step_c * np.round(read / step_c) if step_c else read).mean(axis=1)
    rate = np.resize(np.linspace(-90.0, 90.0, 15), course_c.size)
    error = 0.01 * course_c + 4e-4 * rng.standard_normal(course_c.size)
    return DataSetTable(
        Path("t.csv"), rate, rate + error, np.round(mean, 4), t_s=90.0 * np.arange(float(course_c.size))
    )


WARMING_C = 22.0 + 9.0 * (1.0 - np.exp(-np.arange(120.0) / 100.0))
SOAKED_C = 20.0 + 5.0 * np.convolve(np.repeat(np.arange(6.0), 20), [0.1, 0.2, 0.4, 0.2, 0.1], "same")[2:-2]


@pytest.mark.parametrize("step_c", [0.5, 1.0])
def test_means_of_readings_that_noise_carries_over_steps_are_seen_through(step_c: float) -> None:
    """They lie nearer to the steps than the temperature does, by 0.14 degC rms of whole degrees."""
    table = dithered(WARMING_C, step_c, 1)
    series = series_of_table(table)
    assert Remark(Said.DITHERED, {"step_c": step_c}) in series.notes
    assert np.std(table.temp_c - WARMING_C) > 0.1 * step_c
    assert np.std(series.temp_c - WARMING_C) < 0.03 * step_c


@pytest.mark.parametrize("course_c", [WARMING_C, SOAKED_C], ids=["warming", "soaked"])
@pytest.mark.parametrize("seed", range(3))
def test_a_fine_thermometer_is_taken_for_none_in_steps(course_c: NDArray[np.float64], seed: int) -> None:
    """Nor where a chamber holds it at whole degrees."""
    notes = series_of_table(dithered(course_c, 0.0, seed)).notes
    assert not [n for n in notes if isinstance(n, Remark) and n.said is Said.DITHERED]


@pytest.mark.parametrize("beyond", ["asymmetry", "step", "drift"])
def test_a_scatter_that_the_output_follows_is_the_temperature_s(beyond: str) -> None:
    """Where physics that a surface leaves hid that, a smooth course stood in its place, and twice the noise was left."""
    rng = np.random.default_rng(5)
    rate = np.concatenate([rng.permutation(np.linspace(-100.0, 100.0, 15)) for _ in range(12)])
    temp = np.linspace(-10.0, 50.0, 180) + 0.09 * rng.standard_normal(180)
    late = np.arange(180.0) / 180.0
    added = {
        "asymmetry": 6e-4 * np.maximum(rate, 0.0),
        "step": 2e-2 * (late > 0.6),
        "drift": 3e-4 * rate * late,
    }
    for slope, real in ((2e-4, True), (0.0, False)):
        gyro = rate * (1.0 + slope * temp) + added[beyond] + 5e-4 * rng.standard_normal(180)
        table = DataSetTable(Path("t.csv"), rate, gyro, temp, t_s=30.0 * np.arange(180.0))
        series = series_of_table(table)
        assert np.array_equal(series.temp_c, temp) == real
        said = [n.facts["rms_c"] for n in series.notes if isinstance(n, Remark) and n.said is Said.SMOOTHED]
        assert said == ([] if real else [pytest.approx(0.09, rel=0.15)])


@pytest.mark.parametrize("seed", range(4))
def test_few_readings_in_steps_are_no_means_of_readings_in_larger_ones(seed: int) -> None:
    """Steps of 36 readings are not told, but means of readings in whole degrees would not all lie on halves."""
    rng = np.random.default_rng(seed)
    course_c = -10.0 + 26.0 * np.cumsum(rng.uniform(0.0, 2.0, 36)) / 36.0
    rate = np.resize(np.linspace(-90.0, 90.0, 9), 36)
    read_c = 0.5 * np.round(course_c / 0.5)
    table = DataSetTable(Path("t.csv"), rate, rate + 0.01 * course_c, read_c, t_s=12.0 * np.arange(36.0))
    notes = series_of_table(table).notes
    assert not [n for n in notes if isinstance(n, Remark) and n.said is Said.DITHERED]


def test_samples_that_are_missing_are_counted_and_slow_no_clock(tmp_path: Path) -> None:
    """A third of the samples lost on the line is no sample clock that is 50 % late."""
    rng = np.random.default_rng(3)
    whole = [part(rate, rate) for rate in (50.0, -20.0, 80.0)]
    thinned = [
        replace(p, rows=[row for row in p.rows if not row.split(",")[1] or rng.random() < 0.67])
        for p in whole
    ]
    head = {"sensor": {"model": "RD2100", "serial": "T1", "sample_rate_hz": 10.0}}
    series = series_of_run(read_run(write_run(tmp_path / "run", thinned, head)))
    lost = sum(len(a.rows) - len(b.rows) for a, b in zip(whole, thinned, strict=True))
    (said,) = [remark_words(note) for note in series.notes if "missing" in remark_words(note)]
    assert int(said.split()[0]) == pytest.approx(lost, abs=6)
    assert series.raw.interval_ratio is not None
    assert abs(series.raw.interval_ratio) < 1e-3


def test_samples_of_bad_status_are_not_missing_and_hide_none_that_are(tmp_path: Path) -> None:
    """160 lost samples had been said to be none where another segment was unusable."""
    rng = np.random.default_rng(3)
    lossy = replace(part(50.0, 50.0), rows=[r for r in part(50.0, 50.0).rows if rng.random() < 0.7])
    bad = replace(part(-20.0, -20.0), rows=[gyro_row(t, -20.0, status=1) for t in T_S])
    patchy = [
        gyro_row(t, 80.0 + 1e-3 * rng.standard_normal(), status=int(i % 5 == 0)) for i, t in enumerate(T_S)
    ]
    head = {"sensor": {"model": "RD2100", "serial": "T1", "sample_rate_hz": 10.0}}
    said = [
        [n.facts["count"] for n in series.notes if isinstance(n, Remark) and n.said is Said.MISSING_SAMPLES]
        for number, parts in enumerate(([lossy], [lossy, bad], [replace(bad, rows=patchy, rate_dps=80.0)]))
        for series in [series_of_run(read_run(write_run(tmp_path / f"run{number}", parts, head)))]
    ]
    assert said[0] == said[1] != []
    assert said[2] == []


@pytest.mark.parametrize(
    ("t_s", "missing"),
    [
        (np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.9]), 4),
        (0.1 * np.arange(50) * 1.04, 0),
        # Four at a time, and a jitter of half an interval: no clock, nothing to be counted.
        (np.repeat(0.4 * np.arange(20), 4), 0),
        (0.1 * np.arange(200) + 0.05 * np.random.default_rng(0).standard_normal(200), 0),
    ],
)
def test_missing_samples_are_whole_multiples_of_an_even_clock(t_s: NDArray[np.float64], missing: int) -> None:
    assert missing_samples(t_s) == missing


def test_a_scatter_that_a_simulation_has_too_is_the_temperature_s_where_that_is_likelier() -> None:
    """A warm-up that was left out of a simulation hid that the output follows: the recording alone was smoothed."""
    rng = np.random.default_rng(11)
    rate = np.concatenate([rng.permutation(np.linspace(-100.0, 100.0, 15)) for _ in range(9)])
    course = np.repeat([-20.0, 0.0, 20.0, 40.0, 60.0, 40.0, 20.0, 0.0, -20.0], 15)
    t_s = 40.0 * np.arange(135.0) + np.repeat(3600.0 * np.arange(9.0), 15)
    counts = np.zeros((2, 2), dtype=int)
    for _ in range(24):
        temp = course + rng.normal(0.0, 0.3, 135)
        noise = 0.02 * np.exp(-t_s / 2400.0) + rng.normal(0.0, 2.2e-3, 135)
        for row, at_c in enumerate((temp, course)):
            gyro = rate + 1.3e-3 * at_c + 3.8e-5 * rate * at_c + noise
            counts[row] += [_scatter_is_real(rate, gyro, temp, course, shared=s) for s in (True, False)]
    (beside, alone), (wrong_beside, wrong_alone) = counts.tolist()
    assert beside >= 20 > alone
    assert wrong_beside <= wrong_alone + 1 <= 2


def test_a_table_is_a_simulation_s_partner_by_its_temperatures(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    read = 20.0 + 5.0 * np.sin(np.arange(40.0) / 10.0) + rng.normal(0.0, 0.2, 40)
    rate = np.tile([-50.0, -10.0, 10.0, 50.0], 10)
    real = DataSetTable(Path("r.csv"), rate, rate + rng.normal(0, 1e-3, 40), read, t_s=60 * np.arange(40.0))
    asked: list[bool] = []

    def ask(*_: object, shared: bool) -> bool:
        asked.append(shared)
        return False

    monkeypatch.setattr("gyrocal.diagnosis.rows.table_series._scatter_is_real", ask)
    smooth = replace(real, temp_c=20.0 + 5.0 * np.sin(np.arange(40.0) / 10.0))
    short = DataSetTable(Path("s.csv"), rate[:30], rate[:30], read[:30])
    for partner in (None, replace(real, temp_c=read + 1e-3), smooth, short):
        series_of_table(real, partner)
    assert asked == [False, True, False, False]
