"""Plain logs of a standing gyro: what is read, in which blocks, in how much memory."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import InputError
from gyrocal.records.static_log import iterate_static_log


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize("chunk_rows", [1000, 1500, 100_000])
def test_blocks_are_the_log(tmp_path: Path, chunk_rows: int) -> None:
    t_s, rate = 0.001 * np.arange(5000), np.round(np.sin(np.arange(5000.0)), 6)
    rows = "".join(f"{t:.3f},{g:.6f},25.5\n" for t, g in zip(t_s, rate, strict=True))
    blocks = list(iterate_static_log(write(tmp_path, "t_s,gyro_dps,temp_c\n" + rows), chunk_rows))
    assert max(map(len, blocks)) <= chunk_rows
    np.testing.assert_allclose(np.concatenate([b.t_s for b in blocks]), t_s, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate([b.gyro_dps for b in blocks]), rate)
    assert {b.segment for b in blocks} == {0}
    assert all((b.temp_c == 25.5).all() and np.isnan(b.rate_dps).all() for b in blocks)
    assert blocks[0].usual_dt_s == pytest.approx(0.001)


@pytest.mark.parametrize("chunk_rows", [1000, 100_000])
@pytest.mark.parametrize("steps_at", [[2500], [1000], [1000, 1001], [2500, 4999]])
def test_a_step_of_the_clock_begins_a_segment(tmp_path: Path, chunk_rows: int, steps_at: list[int]) -> None:
    t_s = 0.01 * np.arange(5000)
    for row in steps_at:
        t_s[row:] += 1e6
    rows = "".join(f"{t:.2f},0\n" for t in t_s)
    blocks = list(iterate_static_log(write(tmp_path, "t_s,gyro_dps\n" + rows), chunk_rows))
    starts = {b.segment: b.first_line for b in reversed(blocks)}
    assert [starts[k] for k in sorted(starts)] == [2, *(row + 2 for row in steps_at)]
    assert sum(len(b.notes) for b in blocks) == len(steps_at)
    assert all(np.ptp(b.t_s) < 60.0 for b in blocks)
    said = next(b.notes[0] for b in blocks if b.notes)
    assert said.startswith(
        f"line {steps_at[0] + 2}: time steps by 1e+06 s, where rows come every 0.01 s; a segment"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s,gyro_dps\n", "has a header and no rows."),
        ("t_s,gyro_rad_s\n0,1\n", "column gyro_dps is missing"),
        ("t_s,gyro_dps,mag\n0,1,2\n", "unknown column 'mag'"),
        ("t_s,gyro_dps\n0,1\n1,1e999\n", "line 3: gyro_dps is infinite. Repair the log."),
        ("t_s,gyro_dps\n0,1\n-1,1\n", "line 3: time goes backwards by 1 s."),
        ("t_s,gyro_dps\n1e18,1\n", "are nanoseconds since 1970."),
        # Since power-on, as a clock that does not know the day has them.
        ("t_s,gyro_dps\n" + "".join(f"{k * 10**7},1\n" for k in range(20000)), "they look like nanoseconds"),
    ],
)
def test_bad_logs_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        list(iterate_static_log(write(tmp_path, text)))
    assert message in str(error.value)


def test_memory_is_bounded_by_the_block(tmp_path: Path) -> None:
    rows = 1_500_000
    path = write(tmp_path, "t_s,gyro_dps\n" + "".join(f"{0.001 * k:.3f},0.25\n" for k in range(rows)))
    tracemalloc.start()
    seen = sum(len(block) for block in iterate_static_log(path, 20_000))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seen == rows
    # Whole, its two columns take 24 MB, and their parsing as much again.
    assert peak_bytes < 30e6
