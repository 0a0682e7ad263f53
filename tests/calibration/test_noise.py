"""Noise figures: right values, intervals that cover, gaps never bridged, nothing invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.noise import (
    NoiseFigures,
    bias_over_temperature,
    curves_at_rest,
    figures_of,
    noise_figures,
)
from gyrocal.inference.allan import AllanCurve, AllanSums
from gyrocal.records.run import read_run
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.simulation import flicker

#: RD2100: 5 deg/h/sqrt(Hz), that is 0.0833 deg/sqrt(h).
ARW_DPS_RT_S = 1.389e-3
ARW_DPRH = 60.0 * ARW_DPS_RT_S
Floats = NDArray[np.float64]


def curve_of(values: Floats, dt_s: float = 0.1) -> AllanCurve:
    sums = AllanSums(dt_s)
    sums.add(values)
    return sums.curve()


def at_rest(seed: list[int], samples: int, floor_dps: float, arw: float = ARW_DPS_RT_S) -> NoiseFigures:
    rng = np.random.default_rng(seed)
    white = rng.normal(0.0, arw * np.sqrt(10.0), samples)
    return figures_of([curve_of(white + flicker(rng, samples, floor_dps, 0.1, finer=16))])


def test_figures_and_their_intervals() -> None:
    figures = at_rest([1, 1], 72_000, 5e-4)
    walk, bias = figures.angle_random_walk_deg_per_rt_h, figures.bias_instability_deg_per_h
    assert walk is not None
    assert bias is not None
    assert walk[1] < ARW_DPRH < walk[2]
    assert bias[1] < 5e-4 / 0.664 * 3600 < bias[2]
    assert bias[2] / bias[1] < 1.6
    assert "resolved up to" in figures.statement
    assert "none is left out" in figures.fit_statement
    floor = figures.figures["allan_floor"].interval
    assert floor is not None
    assert floor[1] < 0.664 * bias[0] * 1.2 < 1.2 * floor[2]


def test_a_short_record_says_nothing_about_bias_instability() -> None:
    figures = at_rest([3, 1], 300, 1e-4)
    assert figures.angle_random_walk_deg_per_rt_h is not None
    assert figures.bias_instability_deg_per_h is None
    assert "not resolved within averaging times from" in figures.statement
    bound = figures.figures["bias_instability"]
    assert bound.high is not None
    assert bound.high > 1e-4 / 0.664 * 3600


def test_figures_are_refused_with_the_reason() -> None:
    still = figures_of([curve_of(np.zeros(1000))])
    assert still.angle_random_walk_deg_per_rt_h is None
    assert "does not move" in still.statement
    assert figures_of([]).statement == "no record at rest is long enough"
    short = figures_of([curve_of(np.random.default_rng(3).normal(size=40))])
    assert "record an hour or more" in short.figures["angle_random_walk"].reason
    assert short.figures["allan_floor"].interval is not None
    assert {f.reason for f in short.figures.values() if f.value is None} == {short.statement}


def test_a_figure_is_plain_data() -> None:
    figures = at_rest([1, 1], 72_000, 5e-4).figures
    walk = figures["angle_random_walk"].to_json()
    assert walk["unit"] == "deg/√h"
    assert walk["interval_95"][0] < walk["value"] < walk["interval_95"][1]
    assert walk["reason"] == ""
    refused = figures["quantisation"].to_json()
    assert refused["value"] is None
    assert refused["interval_95"] is None
    assert refused["reason"]


def run_at_rest(path: Path, rows: list[str], averaging_s: float | None = 0.1) -> Path:
    return write_run(path, [Part(rows, kind="static", averaging_s=averaging_s)])


def test_gaps_and_bad_samples_cut_the_record(tmp_path: Path) -> None:
    rows = []
    for i in range(300):
        t = i / 10 + (5.0 if i >= 100 else 0.0)
        bad = i == 200
        rows.append(gyro_row(t, "" if bad else f"{0.001 * (i % 7):.4f}", status=0))
    (curve,) = curves_at_rest(read_run(run_at_rest(tmp_path / "run", rows)), np.zeros(1))
    assert curve.lengths.tolist() == [99, 100]
    assert curve.repeats.tolist() == [1, 2]
    assert curve.dt_s == 0.1


def test_sample_time_is_found_where_the_journal_does_not_say_it(tmp_path: Path) -> None:
    rows = [gyro_row(i / 4, f"{0.001 * (i % 5):.4f}") for i in range(80)]
    run = read_run(run_at_rest(tmp_path / "run", rows, averaging_s=None))
    (curve,) = curves_at_rest(run, np.zeros(1))
    assert curve.dt_s == pytest.approx(0.25)


def test_bias_over_temperature_is_no_noise(tmp_path: Path) -> None:
    """Records at rest at four temperatures: what the temperature does is taken off, in all alike."""
    rng = np.random.default_rng(6)
    parts = []
    for temp_c in (0.0, 15.0, 30.0, 45.0, 60.0):
        rows = [
            gyro_row(i / 10, f"{1e-3 * temp_c + rng.normal(0, 4.4e-3):.6f}", f"{temp_c + 1e-3 * i:.3f}")
            for i in range(600)
        ]
        parts.append(Part(rows, kind="static", averaging_s=0.1, chamber_c=temp_c))
    recording = load_recording(write_run(tmp_path / "run", parts))
    bias = bias_over_temperature(recording)
    np.testing.assert_allclose(np.polyval(bias, [0.0, 60.0]), [0.0, 0.06], atol=2e-3)
    assert bias_over_temperature(load_recording(run_at_rest(tmp_path / "one", parts[0].rows))).tolist() == [
        0.0
    ]


def test_noise_of_a_run_and_of_a_table(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rows = [gyro_row(i / 10, f"{rng.normal(0, 4.4e-3):.6f}") for i in range(3000)]
    figures = noise_figures(load_recording(run_at_rest(tmp_path / "run", rows)))
    walk = figures.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert walk[0] == pytest.approx(ARW_DPRH, rel=0.1)
    assert figures.record_s == pytest.approx(300.0)
    again = [gyro_row(i / 10, f"{rng.normal(0.05, 4.4e-3):.6f}") for i in range(3000)]
    both = noise_figures(
        load_recording(tmp_path / "run"), load_recording(run_at_rest(tmp_path / "again", again))
    )
    assert both.record_s == pytest.approx(600.0)
    joint = both.angle_random_walk_deg_per_rt_h
    assert joint is not None
    assert joint[2] - joint[1] < walk[2] - walk[1]
    tau = np.array([0.1, 1.0])
    np.testing.assert_allclose(figures.model_dps(tau), ARW_DPS_RT_S / np.sqrt(tau), rtol=0.1)
    table = tmp_path / "t.csv"
    table.write_text("rate_dps,gyro_dps,temp_c\n0,0.1,20\n")
    assert "table" in noise_figures(load_recording(table)).statement


def test_a_curve_that_rises_faster_than_a_walk_is_said_to_follow_something() -> None:
    """White on its short side, a smooth course on its long one: no noise figure is had of either."""
    rng = np.random.default_rng(0)
    fade = np.exp(-0.5 / 60.0)
    course = signal.lfilter([1.0], [1.0, -2.0 * fade, fade**2], rng.standard_normal(8400))
    gyro = 0.007 * rng.standard_normal(8400) + 0.03 * course / np.std(course)
    reason = figures_of([curve_of(gyro, 0.5)]).figures["rate_random_walk"].reason
    assert "faster than any random walk (0.5): the output follows something, as the temperature." in reason
    assert "bandwidth" not in reason
