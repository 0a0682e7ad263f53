"""Noise figures: right values, intervals that cover, gaps never bridged, nothing invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.noise import NoiseFigures, Piece, allan_figures, noise_figures, pieces_of
from gyrocal.records.run import read_run
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.simulation import flicker

#: RD2100: 5 deg/h/sqrt(Hz), that is 0.0833 deg/sqrt(h).
ARW_DPS_RT_S = 1.389e-3
ARW_DPRH = 60.0 * ARW_DPS_RT_S
FALSE_ALARM = 1e-3


def at_rest(seed: list[int], samples: int, floor_dps: float, arw: float = ARW_DPS_RT_S) -> NoiseFigures:
    rng = np.random.default_rng(seed)
    white = rng.normal(0.0, arw * np.sqrt(10.0), samples)
    return allan_figures([Piece(0.1, white + flicker(rng, samples, floor_dps, 0.1, finer=16))])


def test_figures_and_their_intervals() -> None:
    figures = at_rest([1, 1], 72_000, 5e-4)
    walk, bias = figures.angle_random_walk_deg_per_rt_h, figures.bias_instability_deg_per_h
    assert walk is not None
    assert bias is not None
    assert walk[1] < ARW_DPRH < walk[2]
    assert bias[1] < 5e-4 / 0.664 * 3600 < bias[2]
    assert bias[2] / bias[1] < 1.5
    assert "resolved up to" in figures.statement


def test_a_short_record_says_nothing_about_bias_instability() -> None:
    figures = at_rest([2, 1], 300, 1e-4)
    assert figures.angle_random_walk_deg_per_rt_h is not None
    assert figures.bias_instability_deg_per_h is None
    assert "not seen within" in figures.statement
    assert "static_allan" in figures.statement


def test_drift_is_seen_but_not_taken_for_bias_instability() -> None:
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(0.0, 3e-5, 20_000))
    figures = allan_figures([Piece(0.1, rng.normal(0.0, 4.4e-3, 20_000) + walk)])
    assert figures.bias_instability_deg_per_h is None
    assert "seen but not separable" in figures.statement


def test_output_that_does_not_move_has_no_figures() -> None:
    figures = allan_figures([Piece(0.1, np.zeros(1000))])
    assert figures.angle_random_walk_deg_per_rt_h is None
    assert "does not move" in figures.statement
    assert allan_figures([]).statement == "no record at rest is long enough"


def test_pooled_variances_are_those_of_the_pieces() -> None:
    rng = np.random.default_rng(4)
    pieces = [Piece(0.1, rng.normal(c, 1e-3, 4096)) for c in (0.0, 5.0)]
    apart = [allan_figures([p]).points[0] for p in pieces]
    together = allan_figures(pieces).points[0]
    mean = 0.5 * (apart[0].adev_dps ** 2 + apart[1].adev_dps ** 2)
    np.testing.assert_allclose(together.adev_dps**2, mean, rtol=1e-9)
    np.testing.assert_allclose(together.dof, 2 * apart[0].dof)


def run_at_rest(path: Path, rows: list[str], averaging_s: float | None = 0.1) -> Path:
    return write_run(path, [Part(rows, kind="static", averaging_s=averaging_s)])


def test_gaps_and_bad_samples_cut_the_record(tmp_path: Path) -> None:
    rows = []
    for i in range(300):
        t = i / 10 + (5.0 if i >= 100 else 0.0)
        bad = i == 200
        rows.append(gyro_row(t, "" if bad else f"{0.001 * (i % 7):.4f}", status=0))
    run = read_run(run_at_rest(tmp_path / "run", rows))
    pieces = pieces_of(run, run.segments[0])
    assert [p.gyro_dps.size for p in pieces] == [100, 100, 99]
    assert all(p.dt_s == 0.1 for p in pieces)


def test_sample_time_is_found_where_the_journal_does_not_say_it(tmp_path: Path) -> None:
    rows = [gyro_row(i / 4, f"{0.001 * (i % 5):.4f}") for i in range(80)]
    run = read_run(run_at_rest(tmp_path / "run", rows, averaging_s=None))
    (piece,) = pieces_of(run, run.segments[0])
    assert piece.dt_s == pytest.approx(0.25)


def test_noise_of_a_run_and_of_a_table(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rows = [gyro_row(i / 10, f"{rng.normal(0, 4.4e-3):.6f}") for i in range(3000)]
    figures = noise_figures(load_recording(run_at_rest(tmp_path / "run", rows)))
    walk = figures.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert walk[0] == pytest.approx(ARW_DPRH, rel=0.1)
    assert figures.record_s == pytest.approx(300.0)
    tau = np.array([0.1, 1.0])
    np.testing.assert_allclose(figures.model_dps(tau), ARW_DPS_RT_S / np.sqrt(tau), rtol=0.1)
    table = tmp_path / "t.csv"
    table.write_text("rate_dps,gyro_dps,temp_c\n0,0.1,20\n")
    assert "table" in noise_figures(load_recording(table)).statement


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("samples", "floor_dps"), [(36_000, 5e-4), (36_000, 1e-3), (36_000, 2e-3)])
def test_intervals_cover(samples: int, floor_dps: float) -> None:
    """Profile intervals rest on large samples; two points are allowed below and above the nominal 95 %."""
    runs = 300
    hits = np.zeros(2)
    for k in range(runs):
        figures = at_rest([6, k], samples, floor_dps)
        for part, (interval, truth) in enumerate(
            (
                (figures.angle_random_walk_deg_per_rt_h, ARW_DPRH),
                (figures.bias_instability_deg_per_h, floor_dps / 0.664 * 3600),
            )
        ):
            assert interval is not None
            hits[part] += interval[1] <= truth <= interval[2]
    slack = stats.norm.ppf(1 - FALSE_ALARM / 2) * np.sqrt(0.95 * 0.05 / runs)
    assert np.all(np.abs(hits / runs - 0.95) < 0.02 + slack)
