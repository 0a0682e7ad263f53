"""Rows reach the file in order of time, each once; means keep what is good and flag what is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gyrocal.bench.devices import GyroSamples
from gyrocal.bench.recorder import BenchRow, Recorder, means
from gyrocal.records.journal import create_run
from gyrocal.records.run import Segment, read_run

NAN = float("nan")


def samples(
    t_s: list[float], gyro: float | list[float] = 1.0, status: list[float] | None = None
) -> GyroSamples:
    """Samples at these times."""
    n = len(t_s)
    return GyroSamples(
        np.array(t_s), np.full(n, gyro) if isinstance(gyro, float) else np.array(gyro), np.full(n, 20.0),
        np.zeros(n) if status is None else np.array(status),
    )  # fmt: skip


def record(
    out: Path, batches: list[tuple[GyroSamples, list[BenchRow]]], averaging_s: float | None
) -> Segment:
    """Record batches and read the segment back."""
    with create_run(out, {"schema": "gyrocal-run/1", "sensor": {"model": "m"}}) as writer:
        segment = writer.begin_segment(1, "rate", 1.0, 20.0)
        recorder = Recorder(segment, averaging_s)
        for batch in batches:
            recorder.add(*batch)
        recorder.finish()
        segment.seal(
            t_start_s=recorder.first_t_s, t_end_s=recorder.last_t_s, n=recorder.n, averaging_s=averaging_s, outcome="ok"
        )  # fmt: skip
    run = read_run(out)
    return run.segment(run.segments[0])


def test_every_sample_and_reading_is_kept_with_its_own_time(tmp_path: Path) -> None:
    bench = BenchRow(0.25, 1.0, 2.5, 20.1, 12.0)
    segment = record(tmp_path / "r", [(samples([0.1, 0.2]), []), (samples([0.3, 0.4]), [bench])], None)
    assert segment.t_s.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert segment.bench_t_s.tolist() == [0.25]
    assert segment.table_angle_deg.tolist() == [2.5]
    assert segment.record.n == 4
    assert (segment.record.t_start_s, segment.record.t_end_s) == (0.1, 0.4)


def test_what_is_not_measured_is_empty(tmp_path: Path) -> None:
    bench = BenchRow(0.2, 1.0, 2.5, 20.1, NAN)
    record(tmp_path / "r", [(samples([0.1], [NAN], [3.0]), [bench])], None)
    (file,) = (tmp_path / "r" / "data").iterdir()
    assert file.name == "0001_rate_+001.000dps_+020.0C.csv"
    assert file.read_text().splitlines() == [
        "t_s,gyro_dps,gyro_temp_c,status,table_rate_dps,table_angle_deg,chamber_temp_c,supply_v",
        "0.100000,,20.000,3,,,,",
        "0.200000,,,,1.000000,2.500000,20.100,",
    ]


@given(st.lists(st.integers(1, 25), min_size=1, max_size=8), st.booleans())
def test_rows_are_in_order_of_time_in_any_split(sizes: list[int], with_bench: bool) -> None:
    import tempfile

    batches, k = [], 0
    for size in sizes:
        t = [0.1 * (k + j + 1) for j in range(size)]
        k += size
        rows = [BenchRow(t[j], 1.0, t[j], 20.0, 12.0) for j in range(0, size, 3)] if with_bench else []
        batches.append((samples(t, [float(round(10 * x)) for x in t]), rows))
    with tempfile.TemporaryDirectory() as folder:
        segment = record(Path(folder) / "r", batches, 1.0)  # the reader refuses time going backwards
    counted = np.arange(1.0, k + 1)
    expected = [float(np.mean(part)) for part in np.split(counted, range(10, k, 10)) if part.size]
    assert np.allclose(segment.gyro_dps, expected, atol=1e-5)
    assert segment.bench_t_s.size == sum(len(rows) for _, rows in batches)


def test_means_use_good_samples_and_flag_bad_ones() -> None:
    m = means(samples([0.5, 0.9, 1.5, 1.9, 2.5], [1.0, 100.0, 3.0, 5.0, 9.0], [0.0, 4.0, 0.0, 0.0, 2.0]), 1.0)
    assert m.gyro_dps.tolist() == [1.0, 4.0, 9.0]
    assert m.status.tolist() == [4.0, 0.0, 2.0]
    assert m.t_s.tolist() == [0.7, 1.7, 2.5]


def test_a_sample_that_is_no_number_is_flagged_in_its_mean() -> None:
    m = means(samples([0.5, 0.9], [1.0, NAN]), 1.0)
    assert m.gyro_dps.tolist() == [1.0]
    assert m.status.tolist() == [1.0]
