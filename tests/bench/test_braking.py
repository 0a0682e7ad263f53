"""A table that speeds up and brakes slowly: time rises as the acceleration falls, in plan, wait and stop alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.bench.safety import stop_time_s
from tests.bench.tiny import Stand

#: So slow that a wait which takes the acceleration the wrong way round is too short, deg/s^2.
SLOW_DPS2 = 0.5


def slow(out: Path) -> Stand:
    return Stand(out, virtual__table__max_acceleration_dps2=SLOW_DPS2)


def test_a_stop_is_given_the_time_that_braking_takes(tmp_path: Path) -> None:
    stand = slow(tmp_path / "r")
    braking_s = stand.table.limits().max_rate_dps / SLOW_DPS2
    assert stop_time_s(stand.table, stand.profile) == stand.profile.safe.stop_deadline_s + braking_s
    assert stand.table.motions == ["stop"]


def test_the_plan_counts_what_a_change_of_rate_takes(tmp_path: Path) -> None:
    quick, patient = Stand(tmp_path / "q").plan, slow(tmp_path / "s").plan
    changes = [abs(b.rate_dps - a.rate_dps) for a, b in zip(quick.steps, quick.steps[1:], strict=False)]
    assert max(changes) > 0
    longer_s = sum(s.expected_s for s in patient.steps) - sum(s.expected_s for s in quick.steps)
    quick_dps2 = quick.limits.max_acceleration_dps2.value
    assert longer_s == pytest.approx(sum(changes) * (1 / SLOW_DPS2 - 1 / quick_dps2))


def test_a_slow_table_arrives_and_is_brought_to_rest(tmp_path: Path) -> None:
    stand = slow(tmp_path / "r")
    summary = stand.run()
    assert (summary.unsettled, summary.failed) == ([], [])
    assert stand.table.motions[-1] == "stop"
    assert stand.bench.table.read().rate_dps == 0.0
