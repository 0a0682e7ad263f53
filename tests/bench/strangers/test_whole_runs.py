"""Whole runs of `gyrocal acquire` on ports, in real time: what was recorded against what the devices truly did."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import pytest

from tests.bench.strangers.gyros import GYROS
from tests.bench.strangers.runs import ARRIVAL_S, CHAMBERS, acquire, bench, differences, profile
from tests.bench.strangers.tables import TABLES

#: Every gyro, every table and every chamber once, all but the first under `slow`, where the product of all is.
EACH_ONCE = (
    ("kvh-dsp3000", "json-lines", "espec"),
    ("kvh-ecore2000", "zaber", "watlow-f4"),
    ("kvh-frame-a", "aerosmith", "weiss"),
    ("kvh-frame-b", "acutrol", "watlow-f4t-scpi"),
    ("vn100", "json-lines", "watlow-f4t-modbus"),
    ("ascii-line", "acutrol", "espec"),
)


#: A machine that stands still for half a second stamps what arrives late; a driver that is wrong is wrong each time.
ATTEMPTS = 3


@pytest.mark.parametrize(
    ("gyro", "table", "chamber"),
    [pytest.param(*devices, marks=[pytest.mark.slow] if k else []) for k, devices in enumerate(EACH_ONCE)],
)
def test_a_small_run_is_recorded_as_it_was(tmp_path: Path, gyro: str, table: str, chamber: str) -> None:
    found = ["never run"]
    for k in range(ATTEMPTS):
        if found:
            (tmp_path / str(k)).mkdir()
            with bench(gyro, table, chamber) as b:
                outcome = acquire(tmp_path / str(k), profile(b, temperatures="[24.0]"))
                found = differences(b, outcome)
    assert found == []


@pytest.mark.slow
def test_what_is_compared_does_not_hang_on_the_load_of_the_machine(tmp_path: Path) -> None:
    with bench("kvh-dsp3000", "json-lines", "espec") as b:

        def hold_up() -> None:
            time.sleep(0.8 * ARRIVAL_S)
            b.lab.after(0.4, hold_up)

        b.lab.after(1.0, hold_up)
        outcome = acquire(tmp_path, profile(b, temperatures="[24.0]"))
        assert differences(b, outcome) == []


@pytest.mark.slow
@pytest.mark.parametrize(("gyro", "table", "chamber"), list(itertools.product(GYROS, TABLES, CHAMBERS)))
def test_every_bench_is_recorded_as_it_was(tmp_path: Path, gyro: str, table: str, chamber: str) -> None:
    with bench(gyro, table, chamber) as b:
        outcome = acquire(tmp_path, profile(b))
        assert differences(b, outcome) == []
