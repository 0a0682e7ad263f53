"""A path is laid on the truth at some rows of a log, and what the truth says does not hang on which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.drive import truth
from gyrocal.diagnosis.drive.beside_truth import beside_truth
from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.search import examine_yaw
from gyrocal.diagnosis.drive.series import drive_series
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.records.robot import Robot
from tests.diagnosis.drive.fleet import Plan, drive

PLAN = Plan("rests", 4.0, 100.0, tick_m=4e-4, truth_m=0.02, effects={"gyro_scale": 1.0, "wheel_scale": 0.5})


def test_the_truth_says_the_same_at_twenty_rows_a_second_as_at_all(
    resting: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = drive_series("log", drive(PLAN, 5), resting, None)
    yaw = examine_yaw(series)
    _, few = beside_truth(series, yaw)
    monkeypatch.setattr(truth, "NODE_S", 1e-3)
    _, every = beside_truth(series, yaw)
    assert few is not None
    assert every is not None
    for name, value in every.values.items():
        assert few.values[name] == pytest.approx(value, abs=0.1 * every.stds[name]), name
        assert few.stds[name] == pytest.approx(every.stds[name], rel=0.1), name


def test_rows_of_the_truth_and_of_gaps_stay_and_nothing_is_lost_between(resting: Robot) -> None:
    log = drive(PLAN, 5)
    series = drive_series("log", log, resting, None)
    gap = np.zeros(series.t_s.size, dtype=bool)
    gap[7003] = True
    rows = truth._rows(replace(series, gap=gap))
    known = np.flatnonzero(np.isfinite(series.truth_x_m))
    assert set(known) | {0, 7002, 7003, series.t_s.size - 1} <= set(rows)
    assert rows.size < 0.4 * series.t_s.size
    whole = reckon(series, Figures())
    few = whole.at_rows(rows)
    np.testing.assert_allclose(few.at_m, whole.at_m[rows])
    np.testing.assert_allclose(np.cumsum(few.way_m), np.cumsum(whole.way_m)[rows])
    np.testing.assert_allclose(few.dt_s[1:], np.diff(whole.t_s[rows]))


def test_where_the_truth_has_its_sensor_is_said_and_taken_out(resting: Robot) -> None:
    """Half a metre ahead, and a quarter of a second late: the path beside it had been off by these, and no word of it."""
    log = drive(Plan("random", 4.0, 10.0, tick_m=2e-4, truth_m=0.01), 5)
    path = reckon(drive_series("log", log, resting, None), Figures())
    # As a truth has it that stands on the path, turned and shifted.
    late_s, lever_m = 0.25, 0.5 - 0.2j
    seen_m = path.at_m + lever_m * np.exp(1j * path.heading_rad)
    seen_m = 3.0 + 1j + np.exp(0.7j) * np.interp(path.t_s - late_s, path.t_s, seen_m)
    seen_m += 0.01 * np.random.default_rng(1).standard_normal((path.t_s.size, 2)) @ np.array([1.0, 1j])
    seen_m[np.arange(seen_m.size) % 20 > 0] = np.nan
    nothing = np.full(seen_m.size, np.nan)
    moved = replace(log, truth_x_m=seen_m.real, truth_y_m=seen_m.imag, truth_heading_deg=nothing)
    found = diagnose_drive("log", moved, resting)
    assert found.truth is not None
    for name, true in (("lever_ahead", 0.5), ("lever_left", -0.2), ("clock", late_s)):
        value, std = found.truth.sensor[name]
        assert abs(value - true) < 5.0 * std < 0.1, name
    (said,) = (n for n in found.diagnosis.notes if isinstance(n, Remark) and n.said is Said.TRUTH_SENSOR)
    assert set(said.facts) == set(found.truth.sensor)
    assert found.shown[-1].after_m < 0.03
