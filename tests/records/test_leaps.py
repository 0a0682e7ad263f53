"""Cells that no vehicle makes are refused by their line; a pause of the logger is no leap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.records.columns import read_column_map
from gyrocal.records.drive import DriveBlock, join
from gyrocal.records.drive_log import iterate_drive_log
from tests.records.whole import read_drive_log

#: A robot at 1 m/s, a row every 0.05 s, ticks of 0.2 mm.
TICKS: NDArray[np.int64] = np.arange(1200) * 250
METRES = (2e-4, 2e-4)
MAP = """[columns.t_s]\nfrom = "t_s"\nunit = "s"\n[columns.gyro_dps]\nfrom = "gyro_dps"\nunit = "deg/s"
[columns.left_m]\nfrom = "left_ticks"\nunit = "ticks_total"\nwrap = 65536
[columns.right_m]\nfrom = "right_ticks"\nunit = "ticks_total"\nwrap = 65536\n"""


def write(path: Path, left: NDArray[np.int64], kept: slice | NDArray[np.bool_] = slice(None)) -> Path:
    rows = np.column_stack([np.arange(left.size) * 0.05, left, TICKS, np.sin(np.arange(left.size))])[kept]
    lines = [f"{t:.2f},{a:.0f},{b:.0f},{g:.3f}" for t, a, b, g in rows]
    path.write_text("\n".join(["t_s,left_ticks,right_ticks,gyro_dps", *lines]) + "\n")
    return path


def test_a_damaged_cell_is_refused_by_its_line(tmp_path: Path) -> None:
    left = TICKS.copy()
    left[700] = 99_999_999
    with pytest.raises(
        InputError, match=r"line 702: left_ticks is 99999999, which is a way of 19,965 m in 0.05 s"
    ):
        read_drive_log(write(tmp_path / "log.csv", left), METRES)


@pytest.mark.parametrize("metres", [2e-4, 1e-6])
def test_a_counter_that_goes_round_is_called_so_and_its_wrap_mends_it(tmp_path: Path, metres: float) -> None:
    log = write(tmp_path / "log.csv", (TICKS + 32768) % 65536 - 32768)
    with pytest.raises(
        InputError, match=r"line 134: left_ticks leaps by -65286 counts, nearly 2\^16: .* wrap = 65536"
    ):
        read_drive_log(log, (metres, metres))
    (tmp_path / "map.toml").write_text(MAP)
    read: DriveBlock = join(iterate_drive_log(log, (metres, metres), read_column_map(tmp_path / "map.toml")))
    np.testing.assert_allclose(read.left_m[1:], 250 * metres)


def test_a_pause_in_which_the_counters_go_on_is_as_long_as_it_was(tmp_path: Path) -> None:
    row = np.arange(TICKS.size)
    log = read_drive_log(write(tmp_path / "log.csv", TICKS, (row < 500) | (row >= 900)), METRES)
    assert np.diff(log.t_s).max() == pytest.approx(401 * 0.05)
    assert log.segment.max() == 0
    stands = np.minimum(TICKS, TICKS[500])
    # Of wheels that stand nothing says whether the clock or the logger stepped.
    path = tmp_path / "stands.csv"
    rows = [f"{0.05 * k:.2f},{stands[k]},{stands[k]},0.1" for k in row if k < 500 or k >= 900]
    path.write_text("\n".join(["t_s,left_ticks,right_ticks,gyro_dps", *rows]) + "\n")
    assert read_drive_log(path, METRES).segment.max() == 1


def test_a_log_in_another_unit_has_no_damaged_cells(tmp_path: Path) -> None:
    log = read_drive_log(write(tmp_path / "log.csv", TICKS), (0.2, 0.2))
    assert log.left_m[1] == pytest.approx(50.0)


@pytest.mark.parametrize("emptied", [False, True])
def test_a_counter_that_restarts_or_stood_is_called_so(tmp_path: Path, emptied: bool) -> None:
    kept = np.arange(TICKS.size) != (700 if emptied else -1)
    restarts = np.where(np.arange(TICKS.size) < 700, TICKS, TICKS - TICKS[700])
    with pytest.raises(InputError, match=r"line 702: .*The counter restarts from 0 here.*Cut the log there"):
        read_drive_log(write(tmp_path / "restarts.csv", restarts, kept), METRES)
    stood = np.where((np.arange(TICKS.size) >= 600) & (np.arange(TICKS.size) < 800), TICKS[600], TICKS)
    with pytest.raises(InputError, match=r"line 802: .*stood from line 602 .*lines 603 to 801 empty"):
        read_drive_log(write(tmp_path / "stood.csv", stood), METRES)
    anew = np.where(np.arange(TICKS.size) < 700, TICKS, TICKS + 1_000_000)
    with pytest.raises(InputError, match=r"line 702: .*the counter was set anew. Cut the log there"):
        read_drive_log(write(tmp_path / "anew.csv", anew), METRES)
