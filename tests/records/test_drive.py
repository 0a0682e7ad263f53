"""The drive log: what is read, what is refused, and in how much memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal.errors import GyrocalError, InputError, ProfileError
from gyrocal.records.drive import DriveBlock, format_drive_log, join
from gyrocal.records.drive_log import iterate_drive_log
from tests.records.whole import read_drive_log

HEADER = "t_s,left_m,right_m,gyro_dps,gyro_temp_c"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "drive.csv"
    path.write_text(text)
    return path


def log_of(rows: int, *, truth: bool = True) -> DriveBlock:
    rng = np.random.default_rng(3)
    nothing = np.full(rows, np.nan)
    return DriveBlock(
        2,
        0.1 * np.arange(rows, dtype=np.float64),
        np.round(rng.uniform(0, 0.2, rows), 6),
        np.round(rng.uniform(0, 0.2, rows), 6),
        np.round(rng.normal(0, 5, rows), 6),
        np.round(rng.uniform(20, 21, rows), 3),
        np.round(rng.normal(0, 5, rows), 4) if truth else nothing,
        np.round(rng.normal(0, 5, rows), 4) if truth else nothing,
        nothing,
    )


def assert_same(a: DriveBlock, b: DriveBlock) -> None:
    for name in set(DriveBlock.__dataclass_fields__) - {"notes"}:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9)


@pytest.mark.parametrize("truth", [True, False])
def test_a_log_reads_back_as_it_was_written(tmp_path: Path, truth: bool) -> None:
    log = log_of(50, truth=truth)
    assert_same(read_drive_log(write(tmp_path, format_drive_log(log))), log)


@pytest.mark.parametrize("chunk_rows", [1, 7, 50, 1000])
def test_blocks_joined_are_the_whole_log(tmp_path: Path, chunk_rows: int) -> None:
    log = log_of(50)
    path = write(tmp_path, format_drive_log(log, metres_per_tick=1e-4))
    blocks = list(iterate_drive_log(path, (1e-4, 1e-4), chunk_rows=chunk_rows))
    assert max(map(len, blocks)) <= chunk_rows
    assert_same(join(blocks), read_drive_log(path, (1e-4, 1e-4)))
    assert [b.first_line for b in blocks] == list(range(2, 52, chunk_rows))


def test_ticks_are_cumulative_and_each_side_has_its_own_size(tmp_path: Path) -> None:
    path = write(tmp_path, "t_s,left_ticks,right_ticks,gyro_dps,gyro_temp_c\n0,100,7,0,20\n1,110,4,0,20\n")
    log = read_drive_log(path, (0.1, 0.5))
    np.testing.assert_allclose(log.left_m, [0.0, 1.0])
    np.testing.assert_allclose(log.right_m, [0.0, -1.5])


def test_a_tick_counter_that_misses_a_row_loses_no_distance(tmp_path: Path) -> None:
    path = write(
        tmp_path, "t_s,left_ticks,right_ticks,gyro_dps,gyro_temp_c\n0,1,1,0,\n1,,2,0,\n2,,3,0,\n3,9,4,0,\n"
    )
    for chunk_rows in (1, 2, 10):
        log = join(iterate_drive_log(path, (1.0, 1.0), chunk_rows=chunk_rows))
        np.testing.assert_allclose(log.left_m, [0.0, 0.0, 0.0, 8.0])
    assert np.isnan(log.gyro_temp_c).all()


def test_a_log_without_a_thermometer_needs_no_column_for_it(tmp_path: Path) -> None:
    log = read_drive_log(write(tmp_path, "t_s,left_m,right_m,gyro_dps\n0,0,0,0.1\n1,0.1,0.2,0.3\n"))
    np.testing.assert_allclose(log.gyro_dps, [0.1, 0.3])
    assert np.isnan(log.gyro_temp_c).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("0,0,0,0,20\n1,0,0,0,20\n", "line 1: holds numbers where the names of the columns are wanted"),
        (HEADER + "\n", "has a header and no rows. Check that it was written to its end."),
        ("t_s,left_m,right_m,gyro_dps,gyro_temp\n0,0,0,0,20\n", "unknown column 'gyro_temp'"),
        (HEADER.replace("gyro_dps", "gyro_rad_s") + "\n0,0,0,0,0\n", "column gyro_dps is missing"),
        (
            HEADER + ",left_ticks,right_ticks\n0,0,0,0,0,1,1\n",
            "has both ticks and metres. Remove one of them; the way is told once.",
        ),
        (HEADER + "\n0,0,0,0,20\n1,0,0,x,20\n", "line 3: gyro_dps is 'x', not a number"),
        (HEADER + "\n0,0,0,inf,20\n", "line 2: gyro_dps is infinite. Repair the log."),
        (
            HEADER + "\n1,0,0,0,20\n0.5,0,0,0,20\n",
            "line 3: time goes backwards by 0.5 s. Rows must be in time order; repair the log.",
        ),
        (HEADER + "\n,0,0,0,20\n", "line 2: time is empty or not finite. Repair the log."),
        (HEADER + "\n0,0,0,0,20\n1,0,0\n", "line 3"),
    ],
)
def test_bad_logs_are_refused_in_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read_drive_log(write(tmp_path, text))
    assert message in str(error.value)


def test_time_going_backwards_between_blocks_is_seen(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER + "\n0,0,0,0,20\n5,0,0,0,20\n4,0,0,0,20\n")
    with pytest.raises(InputError, match="line 4: time goes backwards by 1 s"):
        list(iterate_drive_log(path, chunk_rows=2))


def test_ticks_without_their_size_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "t_s,left_ticks,right_ticks,gyro_dps,gyro_temp_c\n0,1,1,0,\n")
    with pytest.raises(ProfileError) as error:
        read_drive_log(path)
    assert str(error.value).endswith(
        "is in ticks, and the robot file has no metres_per_tick; add metres_per_tick = [LEFT, RIGHT] there."
    )


@settings(max_examples=60)
@given(st.text(alphabet="0123456789.,-+eE\nnaif x", max_size=120))
def test_any_text_is_read_or_refused_but_never_crashes(
    tmp_path_factory: pytest.TempPathFactory, body: str
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "drive.csv"
    path.write_text(HEADER + "\n" + body)
    try:
        log = read_drive_log(path)
    except GyrocalError:
        return
    assert np.all(np.diff(log.t_s) >= 0)
    assert not np.isinf(log.gyro_dps).any()


def test_memory_is_bounded_by_the_block(tmp_path: Path) -> None:
    rows = 700_000
    row = "{},{},{},0.5,20.5"
    path = write(tmp_path, HEADER + "\n" + "\n".join(row.format(k, 0.25, 0.125) for k in range(rows)))
    tracemalloc.start()
    seen = sum(len(block) for block in iterate_drive_log(path, chunk_rows=20_000))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seen == rows
    # The eight columns whole would take 45 MB, and their parsing as much again.
    assert peak_bytes < 30e6


def test_a_counter_that_has_not_begun_is_missing_not_standing(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{0.1 * k:.1f},{'' if k < 3 else 10 * k},," + "0.0,20.0\n" for k in range(6)]
    path.write_text("t_s,left_ticks,right_ticks,gyro_dps,gyro_temp_c\n" + "".join(rows))
    for chunk_rows in (2, 100):
        blocks = list(iterate_drive_log(path, (0.01, 0.01), chunk_rows=chunk_rows))
        left = np.concatenate([b.left_m for b in blocks])
        np.testing.assert_allclose(left, [np.nan] * 3 + [0.0, 0.1, 0.1])
        assert np.isnan(np.concatenate([b.right_m for b in blocks])).all()
