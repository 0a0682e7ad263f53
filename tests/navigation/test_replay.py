"""Replay: the four conditions, in blocks of any size, and what is said of a log that cannot carry them all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.errors import DataError
from gyrocal.fusion import Valid
from gyrocal.navigation import replay as module
from gyrocal.navigation.empty_cells import LONGEST_S
from gyrocal.navigation.montecarlo import World, simulate_and_replay
from gyrocal.navigation.replay import LogReplay, replay_log
from gyrocal.navigation.simulate import CW
from gyrocal.navigation.table import make_table
from gyrocal.navigation.track import CONDITIONS
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.robot import robot_of
from tests.navigation.drives import both_ways, calibration, drive, robot, source


@cache
def whole() -> LogReplay:
    """The drive in one block with everything that is known; never change it."""
    return replay_log(source(drive()), robot(), calibration())


def without_truth(log: DriveBlock) -> DriveBlock:
    nothing = np.full(len(log), np.nan)
    return replace(log, truth_x_m=nothing, truth_y_m=nothing, truth_heading_deg=nothing)


def test_calibration_improves_the_return_by_an_order_of_magnitude() -> None:
    replays = [replay_log(source(log), robot(), calibration()) for log in both_ways()]
    table = make_table(replays)
    assert [r.direction for r in replays] == ["cw", "ccw"]
    assert table.measure == "return"
    assert table.factors["all"]["calibration"] > 10.0
    assert table.factors["all"]["both"] > 10.0
    for replay in replays:
        assert [t.condition.id for t in replay.tracks] == [c.id for c in CONDITIONS]
        assert replay.notes == ()


@pytest.mark.slow
@pytest.mark.parametrize("chunk_rows", [100, 501])
def test_blocks_of_any_size_give_the_same_replay(chunk_rows: int) -> None:
    parts = replay_log(source(drive(), chunk_rows), robot(), calibration())
    for a, b in zip(whole().tracks, parts.tracks, strict=True):
        np.testing.assert_allclose(b.states, a.states, atol=1e-9)
        np.testing.assert_allclose(b.std, a.std, atol=1e-9)
        assert b.counts == a.counts
        assert b.whiteness.nis == pytest.approx(a.whiteness.nis, nan_ok=True)
        assert b.errors is not None
        assert a.errors is not None
        assert b.errors.end_m == pytest.approx(a.errors.end_m)


@pytest.mark.slow
def test_few_rows_are_kept_of_a_long_log(monkeypatch: pytest.MonkeyPatch) -> None:
    full = whole()
    monkeypatch.setattr(module, "KEPT_ROWS", 100)
    thin = replay_log(source(drive(), 300), robot(), calibration())
    assert thin.t_s.size <= 210
    assert thin.t_s[-1] == full.t_s[-1]
    for a, b in zip(full.tracks, thin.tracks, strict=True):
        assert b.x_m[-1] == pytest.approx(a.x_m[-1], abs=1e-9)
        assert b.whiteness.nis == pytest.approx(a.whiteness.nis, nan_ok=True)
        assert b.errors is not None
        assert a.errors is not None
        assert b.errors.end_m == pytest.approx(a.errors.end_m, abs=1e-9)


def test_the_filter_is_consistent_with_its_covariance() -> None:
    squares, rows = [], 0
    for seed in range(30, 38):
        for replay in simulate_and_replay(World(runs=1), seed):
            track = replay.track("calibrated_filter")
            assert track is not None
            error = np.array(
                [
                    track.x_m[-1] - replay.truth[-1, 0],
                    track.y_m[-1] - replay.truth[-1, 1],
                    track.heading_deg[-1] - replay.truth[-1, 2],
                ]
            )
            squares.append(float(error @ np.linalg.solve(track.covariance[:3, :3], error)))
            rows += 3
    # NEES of position and heading; false alarm in 2 of 1000 sets of seeds.
    assert stats.chi2.ppf(1e-3, rows) < sum(squares) < stats.chi2.ppf(1 - 1e-3, rows)


def test_without_coefficients_only_two_conditions() -> None:
    found = replay_log(source(drive()), robot())
    assert [t.condition.id for t in found.tracks] == ["uncalibrated", "uncalibrated_filter"]


def test_without_temperature_the_calibration_is_not_used_and_it_is_said() -> None:
    log = replace(drive(), gyro_temp_c=np.full(len(drive()), np.nan))
    found = replay_log(source(log), robot(), calibration())
    assert [t.condition.calibrated for t in found.tracks] == [False, False]
    assert found.notes == (
        "the log has no gyro temperature, so the calibration cannot be used: only the conditions without it",
    )


@pytest.mark.slow
def test_a_temperature_at_every_tenth_row_serves_the_rows_between() -> None:
    log = drive()
    sparse = replace(log, gyro_temp_c=np.where(np.arange(len(log)) % 10 == 0, log.gyro_temp_c, np.nan))
    every, tenth = (
        found.track("calibrated_filter")
        for found in (whole(), replay_log(source(sparse), robot(), calibration()))
    )
    assert every is not None
    assert tenth is not None
    assert every.bias is not None
    assert tenth.bias is not None
    assert every.bias.n == tenth.bias.n
    assert tenth.bias.bias_dps == pytest.approx(every.bias.bias_dps, abs=1e-4)
    assert np.hypot(tenth.x_m[-1] - every.x_m[-1], tenth.y_m[-1] - every.y_m[-1]) < 0.02
    assert tenth.counts.no_temperature == np.count_nonzero(np.isnan(sparse.gyro_temp_c))


@pytest.mark.slow
def test_without_rest_the_replay_goes_on_and_it_is_said() -> None:
    found = replay_log(source(drive()), robot().with_figures({"static_s": 0.0}), calibration())
    assert all(t.bias is None for t in found.tracks)
    assert found.notes == (
        "static_s = 0: the robot does not stand at the start, so no static bias was taken; its error is left to the filter",
    )


def test_a_log_without_turns_is_replayed_and_it_is_said() -> None:
    """Straight on, nothing tells the unit of the gyro; nor does the path hang on it."""
    log = cut(drive(), slice(400))
    found = replay_log(source(log), robot())
    assert any("has no turns (within 5 s at most" in note for note in found.notes)
    errors = found.tracks[0].errors
    assert errors is not None
    assert errors.rms_m < 0.1
    assert not any("has no turns" in note for note in replay_log(source(drive()), robot()).notes)


@pytest.mark.slow
def test_a_calibration_that_does_not_cover_the_log() -> None:
    cold = replace(calibration(), valid=Valid((-100.0, 100.0), (-40.0, -20.0)))
    with pytest.raises(DataError) as error:
        replay_log(source(drive()), robot(), cold)
    assert (
        "1774 of 1774 rows lie outside what the calibration covers (-100..100 deg/s, -40..-20 deg C)"
        in str(error.value)
    )
    assert "Calibrate over that range, or replay without --coefficients." in str(error.value)
    slow = replace(calibration(), valid=Valid((-20.0, 20.0), (-20.0, 60.0)))
    (note,) = replay_log(source(drive()), robot(), slow).notes
    assert "rows lie outside what the calibration covers (-20..20 deg/s, -20..60 deg C)" in note


@pytest.mark.slow
def test_truth_missing_leaves_the_return() -> None:
    log = without_truth(drive())
    silent = make_table([replay_log(source(log), robot(), calibration())])
    assert silent.measure == "none"
    assert all(np.isnan(v) for v in silent.rows[0].errors_m.values())
    table = make_table([replay_log(source(log), robot(), calibration(), returns=True)])
    assert table.measure == "return"
    with_truth = make_table([whole()])
    assert table.rows[0].errors_m["calibrated"] == pytest.approx(
        with_truth.rows[0].errors_m["calibrated"], abs=0.05
    )


def test_truth_without_heading_is_aligned_by_positions() -> None:
    log = replace(drive(), truth_heading_deg=np.full(len(drive()), np.nan))
    turned = replace(log, truth_x_m=-log.truth_y_m, truth_y_m=log.truth_x_m)
    track = replay_log(source(turned), robot(), calibration()).track("calibrated")
    assert track is not None
    assert track.alignment is not None
    assert track.alignment.method == "positions"
    assert track.alignment.rotation_deg == pytest.approx(90.0, abs=0.5)
    with pytest.raises(DataError, match="the truth has no heading at its first row"):
        replay_log(source(turned), robot(), method="start")


def test_lost_samples_are_bridged_and_counted() -> None:
    log = drive(CW)
    gyro, left = log.gyro_dps.copy(), log.left_m.copy()
    gyro[[300, 301, 900]], left[700] = np.nan, np.nan
    found = replay_log(source(replace(log, gyro_dps=gyro, left_m=left)), robot(), calibration())
    assert found.notes == (
        "3 rows without a gyro sample",
        "1 row without an encoder sample",
        "empty cells are bridged by those beside them, of the gyro in 3 rows and of the wheels in 1 row; stretches over 0.5 s stay empty",
    )
    track = found.track("calibrated_filter")
    assert track is not None
    assert track.errors is not None
    assert (track.counts.no_gyro, track.counts.no_encoders) == (0, 0)
    assert track.errors.end_m < 1.0


def test_of_a_long_empty_stretch_nothing_is_said_to_be_bridged() -> None:
    log = drive()
    gyro = log.gyro_dps.copy()
    gyro[300:320] = np.nan
    assert log.t_s[320] - log.t_s[299] > LONGEST_S
    found = replay_log(source(replace(log, gyro_dps=gyro)), robot())
    assert found.notes == ("20 rows without a gyro sample",)


def test_bridged_cells_are_no_reading_that_is_stuck_at_its_extreme() -> None:
    """Interpolated between two equal rates they had made a row of ten."""
    log = drive()
    gyro = log.gyro_dps.copy()
    top = int(np.argmax(gyro))
    gyro[top - 4 : top + 5] = np.nan
    gyro[[top - 5, top, top + 5]] = np.nanmax(log.gyro_dps) + 1.0
    gyro[[top - 4, top + 4]] = gyro[top]
    found = replay_log(source(replace(log, gyro_dps=gyro)), robot())
    assert found.survey.longest_extreme < 10
    assert found.survey.bad_gyro == 6


@pytest.mark.parametrize("turned_deg", [pytest.param(0.0, marks=pytest.mark.slow), 170.0])
def test_headings_alone_tell_the_error_of_the_heading(
    turned_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = drive()
    nothing = np.full(len(log), np.nan)
    headings = nothing.copy()
    headings[3::7] = (log.truth_heading_deg[3::7] + turned_deg + 180.0) % 360.0 - 180.0
    alone = replace(log, truth_x_m=nothing, truth_y_m=nothing, truth_heading_deg=headings)
    complete = whole()
    # Rows with a heading are kept, whatever is thinned.
    monkeypatch.setattr(module, "KEPT_ROWS", len(log) // 7 + 1)
    found = replay_log(source(alone), robot(), calibration())
    for track, known in zip(found.tracks, complete.tracks, strict=True):
        assert track.errors is None
        assert track.alignment is not None
        assert track.alignment.method == "headings"
        assert track.heading_errors is not None
        assert known.heading_errors is not None
        assert known.alignment is not None
        assert track.heading_errors.rows == len(log.t_s[3::7])
        # A mean difference of zero leaves what scatters about it.
        apart = (
            known.heading_deg[3::7] + track.alignment.rotation_deg - turned_deg - log.truth_heading_deg[3::7]
        )
        assert np.mean(apart) == pytest.approx(0.0, abs=1e-9)
        assert track.heading_errors.rms_deg == pytest.approx(np.std(apart), rel=1e-9)
        assert known.heading_errors.rms_deg >= np.std(apart) * 0.99


def test_a_path_that_a_rest_takes_back_is_said_with_the_error_before() -> None:
    """Round and round from the first row, with a bias that nobody knows, to a rest at the end."""
    rng, n = np.random.default_rng(5), 3000
    going = np.arange(n) < 2600
    turn_dps = np.where(going, 20.0 * np.sin(np.arange(n) / 90.0), 0.0)
    way_m, half_m = np.where(going, 0.05, 0.0), 0.25 * np.radians(turn_dps) * 0.1
    heading = np.cumsum(np.radians(turn_dps) * 0.1)
    at = np.cumsum(way_m * np.exp(1j * (heading - 0.05 * np.radians(turn_dps))))
    gyro_dps = turn_dps + 0.1 + rng.normal(0.0, 0.02, n)
    log = DriveBlock(
        2, 0.1 * np.arange(n, dtype=np.float64), way_m - half_m, way_m + half_m, gyro_dps, np.full(n, np.nan), at.real, at.imag, np.degrees(heading),
    )  # fmt: skip
    unrested = robot_of({"wheel_separation_m": 0.5, "static_s": 0.0}, Path("r"))
    found = replay_log(source(log), unrested)
    (note,) = [text for text in found.notes if "is taken back" in text]
    assert note.startswith("no calibration, no filter: at t_s = 26")
    track = found.track("uncalibrated")
    assert track is not None
    assert track.leap is not None
    assert track.leap.way_m > 1.0
