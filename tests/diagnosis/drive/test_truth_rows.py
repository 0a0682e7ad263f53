"""A path is laid on the truth at some rows of a log, and what the truth says does not hang on which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.drive import truth
from gyrocal.diagnosis.drive.beside_truth import beside_truth
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.search import examine_yaw
from gyrocal.diagnosis.drive.series import drive_series
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
