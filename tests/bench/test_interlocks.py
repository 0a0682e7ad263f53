"""What ends a run at once: each condition by itself, on either side."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import pytest

from gyrocal.bench.devices import ChamberReading, TableReading
from gyrocal.bench.plan import Bound, Limits
from gyrocal.bench.safety import Interlocks
from gyrocal.errors import InterlockError
from tests.bench.tiny import tiny_profile

#: A table of -40 to 60 deg/s, air of 0 to 50 degC; the gyro of the tiny profile may be at -40 to 75 degC.
LIMITS = Limits(
    min_rate_dps=Bound(-40.0, "made up"),
    max_rate_dps=Bound(60.0, "made up"),
    min_temp_c=Bound(0.0, "made up"),
    max_temp_c=Bound(50.0, "made up"),
    max_ramp_c_per_min=Bound(5.0, "made up"),
    max_acceleration_dps2=Bound(100.0, "made up"),
    max_turns=None,
)
TABLE, CHAMBER = TableReading(1.0, 30.0, 90.0), ChamberReading(1.0, 20.0, 20.0, True, plate_c=20.0)


def interlocks() -> Interlocks:
    """Of the tiny profile, which tolerates 5 degC beyond each range and a tenth above the highest rate."""
    return Interlocks(tiny_profile(safe__gyro_margin_c=5.0), LIMITS)


def trips_if(trips: bool, said: str) -> AbstractContextManager[Any]:
    return pytest.raises(InterlockError, match=said) if trips else nullcontext()


@pytest.mark.parametrize(
    ("table", "chamber", "gyro_c", "faults", "said"),
    [
        ({}, {}, 20.0, (), None),
        ({"rate_dps": 65.9}, {}, 20.0, (), None),
        ({"rate_dps": 66.1}, {}, 20.0, (), "the table turns at 66.1 deg/s"),
        ({"rate_dps": -66.1}, {}, 20.0, (), "the table turns at -66.1 deg/s"),
        ({}, {}, 20.0, ("over-current",), "the table reports over-current"),
        ({}, {"alarms": ("door",)}, 20.0, (), "the chamber reports door"),
        ({}, {"running": False}, 20.0, (), "the chamber is not running"),
        ({}, {}, 79.9, (), None),
        ({}, {}, 80.1, (), "the gyro is at 80.1"),
        ({}, {}, -45.1, (), "the gyro is at -45.1"),
        ({}, {"plate_c": 80.1}, 20.0, (), "the plate under the gyro is at 80.1"),
        ({}, {"temp_c": 54.9}, 20.0, (), None),
        ({}, {"temp_c": 55.1}, 20.0, (), "the chamber's air is at 55.1"),
        ({}, {"temp_c": -5.1}, 20.0, (), "the chamber's air is at -5.1"),
        ({}, {"temp_c": math.nan}, 20.0, (), None),
        ({}, {"temp_c": math.nan, "plate_c": math.nan}, math.nan, (), "neither gyro nor chamber says"),
    ],
)
def test_what_trips(
    table: dict[str, Any],
    chamber: dict[str, Any],
    gyro_c: float,
    faults: tuple[str, ...],
    said: str | None,
) -> None:
    locks = interlocks()
    if said is None:
        locks.check(replace(TABLE, **table), faults, replace(CHAMBER, **chamber), gyro_c)
        return
    with pytest.raises(InterlockError, match=said):
        locks.check(replace(TABLE, **table), faults, replace(CHAMBER, **chamber), gyro_c)
    with pytest.raises(InterlockError, match=said):
        locks.check(TABLE, (), CHAMBER, 20.0)


@pytest.mark.parametrize(
    ("table_dps", "gyro_dps", "trips"),
    [
        (50.0, 49.0, False),
        (50.0, -50.0, True),
        (-50.0, 0.0, True),
        (-50.0, math.nan, True),
        (2.0, 0.0, False),
    ],
)
def test_a_gyro_that_does_not_follow(table_dps: float, gyro_dps: float, trips: bool) -> None:
    with trips_if(trips, "the gyro said"):
        interlocks().check_gyro_follows(1.0, table_dps, gyro_dps)


@pytest.mark.parametrize(
    ("chamber_c", "gyro_c", "trips"),
    [(10.0, 9.0, False), (10.0, 0.0, True), (-10.0, 0.0, True), (4.0, 0.0, False)],
)
def test_a_thermometer_that_does_not_move(chamber_c: float, gyro_c: float, trips: bool) -> None:
    with trips_if(trips, "frozen"):
        interlocks().check_thermometer(1.0, chamber_c, gyro_c)
