"""Reduction of recordings to data sets."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gyrocal.calibration.datasets import load_recording, reduce_segment, reference_rate
from gyrocal.calibration.moments import SegmentSums, Sums, sums_of
from gyrocal.errors import DataError, InputError
from gyrocal.records.run import Segment, SegmentRecord
from tests.calibration.runs import Part, bench_row, gyro_row, parts_of, write_run
from tests.calibration.simulation import simulate

FLOATS = st.floats(-1e6, 1e6, allow_subnormal=False)


@given(st.lists(FLOATS, min_size=1, max_size=60), st.integers(0, 60))
def test_sums_of_two_blocks_merge_to_those_of_all(values: list[float], cut: int) -> None:
    x = np.array(values)
    merged = sums_of(x[:cut], integers=True).merge(sums_of(x[cut:], integers=True))
    assert merged.n == x.size
    scale = np.abs(x).max() + 1e-300
    assert merged.mean == pytest.approx(x.mean(), abs=1e-12 * scale)
    assert merged.squares == pytest.approx(np.sum((x - x.mean()) ** 2), abs=1e-11 * scale**2 * x.size)
    assert (merged.low, merged.high) == (x.min(), x.max())
    assert merged.n_high == np.count_nonzero(x == x.max())
    assert merged.whole == bool(np.all(x == np.round(x)))


def test_variance_keeps_its_digits_far_from_zero() -> None:
    x = 1e9 + np.random.default_rng(1).normal(0.0, 1e-3, 10_000)
    merged = Sums()
    for part in np.array_split(x, 37):
        merged = merged.merge(sums_of(part))
    assert merged.std() == pytest.approx(np.std(x - 1e9, ddof=1), rel=1e-6)


def blocks(samples: int, block: int) -> Iterator[Segment]:
    """A segment at 10 deg/s as a stream of blocks, made when asked for."""
    record = SegmentRecord(1, "rate", 10.0, 20.0, 0.0, samples / 10, samples, 0.1, "ok", "x.csv", "")
    empty = np.empty(0)
    for start in range(0, samples, block):
        t = np.arange(start, min(start + block, samples)) / 10
        yield Segment(record, t, 10 + np.sin(t), 20 + t / 6000, np.zeros(t.size), *[empty] * 5)


def test_reduction_does_not_depend_on_the_blocks() -> None:
    one, many = (reduce_segment(blocks(30_000, size)) for size in (30_000, 997))
    assert one.gyro.mean == pytest.approx(many.gyro.mean, rel=1e-13)
    assert one.gyro.std() == pytest.approx(many.gyro.std(), rel=1e-12)
    assert one.temp_rate_c_per_min() == pytest.approx(0.01, rel=1e-9)
    assert many.temp_rate_c_per_min() == pytest.approx(0.01, rel=1e-9)


def test_memory_does_not_grow_with_the_samples() -> None:
    def peak(samples: int) -> int:
        tracemalloc.start()
        reduce_segment(blocks(samples, 20_000))
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    assert peak(600_000) < 1.2 * peak(60_000)


def test_run_gives_the_means_that_were_put_in(tmp_path: Path) -> None:
    sets = simulate(np.random.default_rng(3))
    found = load_recording(write_run(tmp_path / "run", parts_of(sets, np.random.default_rng(4)))).sets
    np.testing.assert_allclose(found.gyro_dps, sets.gyro_dps, atol=1e-6)
    np.testing.assert_allclose(found.rate_dps, sets.rate_dps, atol=1e-4)
    np.testing.assert_allclose(found.temp_c, sets.temp_c, atol=1e-3)
    np.testing.assert_allclose(found.t_s, sets.t_s, atol=0.06)
    np.testing.assert_allclose(found.duration_s, 4.0, atol=1e-6)
    assert set(found.reference) == {"table"}


def still(rate: float, *, angle: bool = True, report: bool = True, wrap: bool = False) -> Part:
    """Twenty seconds at `rate`; the table truly turns 1 % faster than it reports."""
    rows = []
    for i in range(200):
        t = i / 10
        if i % 10 == 0:
            position = 1.01 * rate * t
            position = (position + 180) % 360 - 180 if wrap else position
            rows.append(bench_row(t, rate if report else "", f"{position:.6f}" if angle else ""))
        rows.append(gyro_row(t, rate))
    return Part(rows, rate_dps=rate + 0.001)


@pytest.mark.parametrize(
    ("part", "reference", "rate"),
    [
        (still(5.0), "angle", 5.05),
        (still(5.0, angle=False), "table", 5.0),
        (still(5.0, angle=False, report=False), "command", 5.001),
        (still(50.0, wrap=True), "table", 50.0),
    ],
)
def test_reference_rate(tmp_path: Path, part: Part, reference: str, rate: float) -> None:
    recording = load_recording(write_run(tmp_path / "run", [part]))
    assert recording.sets.reference[0] == reference
    assert recording.sets.rate_dps[0] == pytest.approx(rate)
    wrapped = [note for note in recording.notes if "wrapped" in note]
    assert bool(wrapped) == (rate == 50.0)


def sums_at(angle_deg: np.ndarray, reported_dps: np.ndarray, t_s: np.ndarray, block: int = 7) -> SegmentSums:
    """Sums of a segment of 20 s at 50 deg/s from blocks, with bench readings at `t_s`."""
    gyro_t = np.arange(0.0, 20.0, 0.1)
    still = np.full(gyro_t.size, 50.0)
    nothing, empty = np.full(t_s.size, np.nan), np.empty(0)
    gyro = Segment(COMMAND, gyro_t, still, still, np.zeros(gyro_t.size), *[empty] * 5)
    parts = [gyro]
    for i in range(0, t_s.size, block):
        cut = slice(i, i + block)
        bench = (t_s[cut], reported_dps[cut], angle_deg[cut], nothing[cut], nothing[cut])
        parts.append(Segment(COMMAND, empty, empty, empty, empty, *bench))
    return reduce_segment(parts)


COMMAND = SegmentRecord(1, "rate", 50.0, 20.0, 0.0, 20.0, 200, 0.1, "ok", "x.csv", "")
BENCH_S = np.arange(20.0)
TRUE_DPS = 50.0005


def test_slope_of_the_angle_and_its_error_are_those_of_a_straight_line() -> None:
    rng = np.random.default_rng(1)
    angle = 3e5 + TRUE_DPS * BENCH_S + rng.normal(0, 1e-4, BENCH_S.size)
    line = stats.linregress(BENCH_S, angle - 50.0 * BENCH_S)
    for block in (3, 20):
        found = sums_at(angle, np.full(20, np.nan), BENCH_S, block).angle_slope_dps()
        assert found is not None
        assert found == pytest.approx((line.slope, line.stderr), rel=1e-5)


@pytest.mark.parametrize(
    ("report", "angle", "reference"),
    [
        ("uneasy", "fine", "angle"),
        ("steady", "fine", "angle"),  # a report that echoes the command, ten standard errors beside the angle
        ("true", "fine", "table"),
        ("uneasy", "none", "table"),
        ("none", "fine", "angle"),
        ("none", "none", "command"),
        ("true", "coarse stamps", "table"),
        ("uneasy", "wrapped", "table"),
    ],
)
def test_the_rate_that_is_known_best_is_the_reference(report: str, angle: str, reference: str) -> None:
    rng = np.random.default_rng(2)
    reports = {
        "uneasy": TRUE_DPS + rng.normal(0, 0.01, 20),
        "steady": np.full(20, 50.0),
        "true": np.full(20, TRUE_DPS),
        "none": np.full(20, np.nan),
    }
    stamps = BENCH_S + rng.uniform(-0.01, 0.01, 20) * (angle == "coarse stamps")
    angles = {
        "wrapped": np.mod(TRUE_DPS * BENCH_S, 360.0),
        "none": np.full(20, np.nan),
    }.get(angle, TRUE_DPS * BENCH_S + rng.normal(0, 2e-4, 20))
    rate, taken, note = reference_rate(COMMAND, sums_at(angles, reports[report], stamps))
    assert taken == reference
    assert bool(note) == (angle == "wrapped")
    best = {"angle": TRUE_DPS, "command": 50.0}.get(reference, float(np.mean(reports[report])))
    assert rate == pytest.approx(best, abs=1e-4)


def test_two_readings_of_the_angle_catch_a_report_that_is_far_off_only() -> None:
    ends = np.array([0.0, 20.0])
    for true_dps, reference in ((50.5, "angle"), (50.001, "table")):
        sums = sums_at(true_dps * ends, np.full(2, 50.0), ends)
        assert reference_rate(COMMAND, sums)[1] == reference


def test_bad_samples_are_counted_and_left_out(tmp_path: Path) -> None:
    rows = [gyro_row(i / 10, 1.0 + 0.001 * (i % 2)) for i in range(50)]
    rows[3] = gyro_row(0.3, 99.0, status=2)
    rows[7] = gyro_row(0.7, "inf")
    rows[9] = gyro_row(0.9, "")
    recording = load_recording(write_run(tmp_path / "run", [Part(rows, rate_dps=1.0)]))
    assert (recording.masked.bad_status, recording.masked.non_finite) == (1, 2)
    assert recording.sets.n[0] == 47
    assert recording.sets.gyro_dps[0] == pytest.approx(1.0005, abs=1e-4)
    assert recording.n_samples == 50


def test_failed_and_empty_segments_are_listed_and_unsettled_ones_used(tmp_path: Path) -> None:
    good = [gyro_row(i / 10, 0.1 * (i % 3)) for i in range(20)]
    parts = [
        Part(good, outcome="unsettled"),
        Part(good, outcome="failed"),
        Part([gyro_row(i / 10, 1.0, status=1) for i in range(20)]),
        Part([gyro_row(i / 10, 1.0, "") for i in range(20)]),
        Part(good, kind="ramp"),
    ]
    recording = load_recording(write_run(tmp_path / "run", parts))
    assert recording.sets.outcome.tolist() == ["unsettled"]
    assert [(e.segment, e.reason) for e in recording.excluded] == [
        (2, "the bench marked it failed"),
        (3, "it holds no good gyro sample"),
        (4, "it holds no gyro temperature"),
    ]


def test_run_without_a_data_set_is_refused(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", [Part([gyro_row(0.0, 1.0)], kind="soak")])
    with pytest.raises(DataError, match=r"holds no usable data set.*Record segments of kind rate"):
        load_recording(path)


def test_clipped_samples_are_saturated_and_coarse_ones_are_not(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)

    def parts(step: float, rail: float) -> list[Part]:
        made = []
        for rate in (-90.0, -50.0, 0.0, 50.0, 90.0):
            gyro = np.clip(np.round(rng.normal(rate, 0.004, 200) / step) * step, -rail, rail)
            made.append(Part([gyro_row(i / 10, f"{g:.6f}") for i, g in enumerate(gyro)], rate_dps=rate))
        return made

    clipped = load_recording(write_run(tmp_path / "clipped", parts(1e-6, 89.999)))
    assert clipped.saturated.tolist() == [True, False, False, False, True]
    assert clipped.masked.saturated > 100
    coarse = load_recording(write_run(tmp_path / "coarse", parts(0.01, 1e3)))
    assert not coarse.saturated.any()


def test_edited_truncated_and_missing_segments_are_refused(tmp_path: Path) -> None:
    part = Part([gyro_row(i / 10, 1.0) for i in range(20)])
    path = write_run(tmp_path / "run", [part])
    file = next((path / "data").iterdir())
    file.write_text(file.read_text()[:-40])
    with pytest.raises(InputError, match="differs from what the journal sealed"):
        load_recording(path)
    file.unlink()
    with pytest.raises(InputError, match="no such file"):
        load_recording(path)


def test_counts_per_dps_is_not_for_runs(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", [Part([gyro_row(0.0, 1.0)])])
    with pytest.raises(InputError, match="--counts-per-dps is for tables"):
        load_recording(path, 100.0)


def test_table_knows_what_it_does_not_know(tmp_path: Path) -> None:
    path = tmp_path / "sets.csv"
    path.write_text("rate_dps,gyro_counts,temp_c\n-10,1000,20\n10,-1000,25\n")
    recording = load_recording(path, -100.0)
    assert recording.sets.gyro_dps.tolist() == [-10.0, 10.0]
    assert not recording.sets.timed
    assert recording.sets.segment.tolist() == [1, 2]
    assert recording.whole_degrees
    assert recording.notes == ("the table does not say gyro_std_dps, n, t_s",)


def test_select_takes_the_same_rows_of_every_column() -> None:
    sets = simulate(np.random.default_rng(6))
    some = sets.select(np.array([5, 2]))
    assert some.segment.tolist() == [6, 3]
    assert some.gyro_dps.tolist() == [sets.gyro_dps[5], sets.gyro_dps[2]]
    assert some.outcome.tolist() == ["ok", "ok"]


def parts_without_thermometer(aired: bool = True) -> list[Part]:
    """Two data sets of a gyro that sends no temperature, in a chamber at 19.5 and 20.5 deg C."""
    parts = []
    for k, rate in enumerate((-10.0, 10.0)):
        t0 = 100.0 * k
        rows = [gyro_row(t0 + 0.1 * i, rate + 0.01 * (i % 3), "") for i in range(100)]
        chamber = [bench_row(t0 + 0.1 * i + 0.05, rate, rate * 0.1 * i) for i in range(0, 100, 10)]
        chamber = [row.replace(",20.0,12.0", f",{19.5 + k},12.0" if aired else ",,12.0") for row in chamber]
        parts.append(Part(sorted(rows + chamber, key=lambda row: float(row.split(",")[0])), rate_dps=rate))
    return parts


def test_the_chamber_stands_for_a_gyro_without_thermometer(tmp_path: Path) -> None:
    recording = load_recording(write_run(tmp_path / "r", parts_without_thermometer()))
    assert recording.sets.temp_c == pytest.approx([19.5, 20.5])
    assert recording.excluded == ()
    assert any(
        "the gyro sends no temperature: the chamber's stands for its own" in note for note in recording.notes
    )


def test_a_thermometer_that_died_half_way_is_not_replaced(tmp_path: Path) -> None:
    parts = parts_without_thermometer()
    parts[0].rows = [row.replace(",,0,,,,", ",20.0,0,,,,") for row in parts[0].rows]
    recording = load_recording(write_run(tmp_path / "r", parts))
    assert recording.sets.temp_c == pytest.approx([20.0])
    assert [e.reason for e in recording.excluded] == ["it holds no gyro temperature"]


def test_no_temperature_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="it holds no gyro temperature"):
        load_recording(write_run(tmp_path / "r", parts_without_thermometer(aired=False)))


def test_a_scatter_of_zero_throughout_gives_no_weights(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("rate_dps,gyro_dps,temp_c,gyro_std_dps,n\n1,2,3,0,9\n2,2,3,0,9\n")
    with pytest.raises(InputError, match="gyro_std_dps is 0 in every row, by which no data set has a weight"):
        load_recording(path)
