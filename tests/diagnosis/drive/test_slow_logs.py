"""Logs of few rows a second: what happens within a row is no structure of the drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.series import between_rows, drive_series
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import robot_of

Floats = NDArray[np.float64]
ROBOT = robot_of({"wheel_separation_m": 0.5, "static_s": 8.0}, Path("robot.toml"))
FINE_HZ, ROWS_HZ = 500.0, 5.0


def arcs(seed: int, late_s: float = 0.0, scale: float = 0.0, noise: float = 1.0) -> DriveBlock:
    """Arcs of three to nine seconds for eight minutes, each set on within 0.8 s; rates are means of rows, as are the ways."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 480.0, 1.0 / FINE_HZ)
    speed, turn_dps = np.zeros(t.size), np.zeros(t.size)
    at_s = 10.0
    while at_s < 470.0:
        now = (t >= at_s) & (t < at_s + 9.0)
        speed[now], turn_dps[now] = rng.uniform(0.3, 1.2), 24.0 * rng.normal()
        at_s += rng.uniform(3.0, 9.0)
    speed[t > 470.0] = turn_dps[t > 470.0] = 0.0
    window = np.hanning(int(0.8 * FINE_HZ))
    speed, turn_dps = (np.convolve(x, window / window.sum(), "same") for x in (speed, turn_dps))
    heading, way = (
        np.concatenate([[0.0], np.cumsum(x)[:-1]]) / FINE_HZ for x in (np.radians(turn_dps), speed)
    )
    middle = heading + 0.5 * np.radians(turn_dps) / FINE_HZ
    at = np.concatenate([[0.0 + 0.0j], np.cumsum(speed * np.exp(1j * middle))[:-1]]) / FINE_HZ
    rows = np.arange(0, t.size, int(FINE_HZ / ROWS_HZ))
    seen = np.interp(t - late_s, t, heading)[rows] * (1.0 + scale)
    rate_dps = np.degrees(np.diff(seen, prepend=0.0)) * ROWS_HZ + 0.004 * noise * rng.normal(size=rows.size)
    ways = [np.diff(way[rows] + sign * 0.25 * heading[rows], prepend=0.0) for sign in (-1.0, 1.0)]
    left, right = (x + noise * 1e-3 * np.sqrt(np.abs(x)) * rng.normal(size=rows.size) for x in ways)
    east, north = (x[rows] + 0.005 * noise * rng.normal(size=rows.size) for x in (at.real, at.imag))
    nothing, segment = np.full(rows.size, np.nan), np.zeros(rows.size, dtype=np.int64)
    return DriveBlock(2, t[rows], left, right, rate_dps, nothing, east, north, nothing, nothing, segment)


def test_a_path_bends_within_its_rows() -> None:
    """By millimetres; arcs from one row to the next, each of one speed and rate, had missed them by centimetres."""
    series = drive_series("log", arcs(1, noise=0.0), ROBOT, None)
    path = reckon(series, Figures(bias_from_rest=False)).at_m
    assert np.max(np.abs(path - (series.truth_x_m + 1j * series.truth_y_m))) < 2e-3


def test_between_rows_lies_a_curve_and_over_a_gap_a_line() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.2), np.arange(14.0, 20.0, 0.2)])
    at_s = np.linspace(0.0, 19.0, 700)
    curve = between_rows(at_s, t, np.sin(t))
    over = (at_s > 9.8) & (at_s < 14.0)
    # At the ends of a record and of a gap the slope is known from one side.
    assert np.max(np.abs(curve - np.sin(at_s))[~over]) < 3e-3
    inside = (at_s > 0.4) & (at_s < 9.2)
    assert np.max(np.abs(curve - np.sin(at_s))[inside]) < 2e-4
    assert curve[over] == pytest.approx(np.interp(at_s[over], t, np.sin(t)))
    # Before the first row and after the last it stays what it was, and doubled time stamps are joined by lines.
    assert between_rows(np.array([-1.0, 30.0]), t, np.sin(t)) == pytest.approx(np.sin(t[[0, -1]]))
    doubled = np.sort(np.append(t, t[20]))
    assert between_rows(at_s, doubled, doubled) == pytest.approx(np.interp(at_s, doubled, doubled))


@pytest.mark.slow
def test_five_rows_a_second_hide_nothing_and_add_nothing() -> None:
    found = [diagnose_drive("log", arcs(seed), ROBOT).diagnosis for seed in (2, 3, 4)]
    assert [d.verdict for d in found] == ["consistent"] * 3


@pytest.mark.slow
def test_a_delay_of_half_a_row_is_no_slip_and_hides_no_scale() -> None:
    """On straight lines between rows it had been 29 slips, and what these left had hidden the scale."""
    found = diagnose_drive("log", arcs(5, late_s=0.1, scale=0.02), ROBOT)
    assert {e.effect for e in found.diagnosis.effects} == {"gyro_delay", "gyro_scale"}
    assert found.robot is not None
    assert found.robot.parameters.gyro.scale == pytest.approx(0.02, abs=5e-4)
    assert found.robot.parameters.gyro.delay_s == pytest.approx(0.1, abs=3e-3)
