"""Reference rate of a segment: the report or the angle, whichever is known better."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.diagnosis.series import _reference_rate
from gyrocal.records.run import Segment, SegmentRecord

RATE_DPS = 50.0
RECORD = SegmentRecord(1, "rate", RATE_DPS, 20.0, 0.0, 20.0, 200, 0.1, "ok", "data/x.csv", "")


def segment(reported_dps: np.ndarray, angle_deg: np.ndarray, t_s: np.ndarray) -> Segment:
    nothing = np.full(t_s.size, np.nan)
    empty = np.empty(0)
    return Segment(RECORD, empty, empty, empty, empty, t_s, reported_dps, angle_deg, nothing, nothing)


T_S = np.arange(20.0)


def test_an_uneasy_report_gives_way_to_the_angle() -> None:
    rng = np.random.default_rng(1)
    uneasy = RATE_DPS + rng.normal(0, 0.01, T_S.size)
    angle = (RATE_DPS + 0.0005) * T_S + rng.normal(0, 1e-4, T_S.size)
    assert _reference_rate(segment(uneasy, angle, T_S)) == pytest.approx(RATE_DPS + 0.0005, abs=5e-5)


def test_a_steady_report_beats_coarse_time_stamps() -> None:
    steady = np.full(T_S.size, RATE_DPS)
    stamps = T_S + np.random.default_rng(2).uniform(-0.01, 0.01, T_S.size)
    assert _reference_rate(segment(steady, RATE_DPS * T_S, stamps)) == RATE_DPS


def test_a_wrapped_angle_is_no_rate() -> None:
    uneasy = RATE_DPS + np.random.default_rng(3).normal(0, 0.01, T_S.size)
    assert _reference_rate(segment(uneasy, (RATE_DPS * T_S) % 360.0, T_S)) == pytest.approx(np.mean(uneasy))


def test_without_a_report_the_command_stands() -> None:
    nothing = np.full(T_S.size, np.nan)
    assert _reference_rate(segment(nothing, nothing, T_S)) == RATE_DPS
