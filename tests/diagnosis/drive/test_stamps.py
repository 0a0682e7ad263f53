"""Rows that share a time stamp: floors of a coarse clock, doubles, rows that came late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.checks import missing_rows
from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.drive.stamps import at_own_times, spread
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.records.robot import Robot
from tests.diagnosis.drive.fleet import Plan, drive

Floats = NDArray[np.float64]
TIMES: Floats = np.round(0.05 * np.arange(400, dtype=np.float64), 9)
#: A drive with nothing hidden; it must not turn by what its clock does.
PLAN = Plan("eights", 3.0, 20.0)


def late(t_s: Floats) -> Floats:
    """One row in twenty has the time of the next one."""
    return np.where(np.arange(t_s.size) % 20 == 7, np.roll(t_s, -1), t_s)


def doubled(t_s: Floats) -> Floats:
    """Every ninth row has the time of the one before."""
    told = t_s.copy()
    told[1::9] = told[0::9][: told[1::9].size]
    return told


STAMPS = {
    "whole seconds": lambda t: np.floor(t),
    "in fours": lambda t: t[4 * (np.arange(t.size) // 4)],
    "doubled": doubled,
    "late": late,
}


@pytest.mark.parametrize("name", STAMPS)
def test_rows_have_their_times_again(name: str) -> None:
    found = spread(STAMPS[name](TIMES))
    np.testing.assert_allclose(found, TIMES, atol=1e-8)
    assert np.all(np.diff(found) > 0.0)


def test_times_of_their_own_stay() -> None:
    log = drive(PLAN, 4)
    same, notes = at_own_times(log)
    assert same is log
    assert notes == []


def test_rows_before_a_gap_do_not_reach_into_it() -> None:
    told = np.concatenate([np.repeat(np.arange(0.0, 10.0, 0.1), 2), np.repeat(np.arange(60.0, 70.0, 0.1), 2)])
    found = spread(told)
    assert found[199] == pytest.approx(9.95)
    assert found[200] == pytest.approx(60.0)


def test_rows_that_came_late_are_not_lost() -> None:
    for told in (late(TIMES), doubled(TIMES)):
        assert missing_rows(told) is not None
        assert missing_rows(told, int(np.count_nonzero(np.diff(told) == 0.0))) is None
    lost = missing_rows(np.delete(TIMES, np.arange(5, 395, 20)))
    assert lost is not None


def test_a_log_whose_first_rows_share_a_stamp_is_told_of(resting: Robot) -> None:
    """No interval before it had any time, and the noise over none is none."""
    log = drive(replace(PLAN, rest_s=0.0, hz=5.0), 4)
    told = log.t_s.copy()
    told[1] = told[0]
    found = diagnose_drive("log", replace(log, t_s=told), resting)
    assert Remark(Said.SHARED_TIMES, {"count": 1}) in found.diagnosis.notes


@pytest.mark.slow
@pytest.mark.parametrize("name", STAMPS)
def test_shared_stamps_make_no_effect_and_no_robot_file(name: str, resting: Robot) -> None:
    """Doubled stamps had a skid of -97 %, and a file with a track of 13 mm."""
    log = drive(PLAN, 4)
    found = diagnose_drive("log", replace(log, t_s=STAMPS[name](log.t_s)), resting)
    assert found.diagnosis.verdict == "consistent"
    assert found.diagnosis.effects == ()
