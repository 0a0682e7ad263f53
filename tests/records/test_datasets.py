"""Table of data sets: reader and writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyrocal.errors import InputError
from gyrocal.records.datasets import DataSetTable, format_data_sets, read_data_sets, switched_on_s

SETTINGS = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
VALUES = st.floats(-200, 200)
RATES = VALUES.map(lambda rate: round(rate, 2))


@SETTINGS
@given(
    rows=st.lists(
        st.tuples(RATES, VALUES, VALUES, st.integers(1, 10_000)),
        min_size=1,
        max_size=10,
        unique_by=lambda row: row[0],
    ),
    timed=st.booleans(),
)
def test_what_is_written_is_read(
    tmp_path: Path, rows: list[tuple[float, float, float, int]], timed: bool
) -> None:
    rate, gyro, temp, n = np.array(rows, dtype=np.float64).T
    times = 500.0 * np.arange(rate.size) if timed else None
    path = tmp_path / "t.csv"
    path.write_text(format_data_sets(DataSetTable(path, rate, gyro, temp, n=n, t_s=times)))
    found = read_data_sets(path)
    np.testing.assert_allclose(found.rate_dps, rate, atol=5.1e-7)
    np.testing.assert_allclose(found.gyro_dps, gyro, atol=5.1e-9)
    np.testing.assert_allclose(found.temp_c, temp, atol=5.1e-5)
    assert found.n is not None
    np.testing.assert_array_equal(found.n, n)
    assert (found.t_s is None) == (not timed)
    assert found.gyro_std_dps is None


def refused(path: Path, text: str, counts_per_dps: float | None = None) -> str:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_data_sets(path, counts_per_dps)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "counts", "message"),
    [
        ("rate_dps,gyro_counts,temp_c\n1,2,3\n", None, "give the nominal scale"),
        ("rate_dps,gyro_counts,temp_c\n1,2,3\n", 0.0, "0 is no scale"),
        ("rate_dps,gyro_counts,temp_c\n1,2,3\n", float("nan"), "nan is no scale"),
        ("rate_dps,gyro_counts,temp_c\n1,2,3\n", float("inf"), "inf is no scale"),
        ("rate_dps,gyro_dps,temp_c\n1,2,3\n", 5.0, "in deg/s already"),
        ("rate_dps,gyro_dps,gyro_counts,temp_c\n1,2,2,3\n", 5.0, "has both"),
        ("rate_dps,gyro_dps,temp_c\n", None, "no rows"),
        ("rate_dps,gyro_dps,temp_c\n1,2,3\n1,1e999,3\n", None, "line 3: gyro_dps is empty or not finite"),
        ("rate_dps,gyro_dps,temp_c,t_s\n1,2,3,9\n1,2,3,8\n", None, "line 3: time goes backwards"),
        ("rate_dps,gyro_dps,temp_c,n\n1,2,3,0\n", None, "line 2: n is 0"),
        ("rate_dps,gyro_dps,temp_c,n\n1,2,3,2.5\n", None, "line 2: n is 2.5"),
        (
            "rate_dps,gyro_dps,temp_c,t_s\n1,2,3,0\n2,2,9,0.5\n",
            None,
            "6 degC within 0.5 s of t_s (hours, days?)",
        ),
        ("rate_dps,gyro_dps,temp_c,t_s\n1,2,3,0\n2,2,3,4e9\n", None, "through 4e+09 s, which is years"),
        ("rate_dps,gyro_dps,temp_c,t_s\n1,2,3,0\n2,2,3,9e10\n", None, "which is years (nanoseconds?)"),
        ("rate_dps,gyro_dps,temp_c,t_s\n1,2,3,0\n2,2,3,9e8\n", None, "which is years (microseconds?)"),
        ("rate_dps,gyro_dps,temp_c,gyro_std_dps\n1,2,3,-1\n", None, "line 2: gyro_std_dps is -1"),
        ("rate_dps,gyro_dps,temp_c\n1,2,-300\n", None, "line 2: temp_c is -300"),
        (
            "rate_dps,gyro_dps,temp_c\n1,2,3\n-1e8,2,3\n",
            None,
            "line 3: rate_dps is -1e+08; no table turns so fast",
        ),
        (
            "rate_dps,gyro_dps,temp_c\n-1e-4,0,3\n1e-4,0,3\n",
            None,
            "the fastest rate_dps is 0.0001, which no plan",
        ),
        ("rate_dps,gyro_dps,temp_c,t_s\n1,2,3,9\n1,3,3,9\n", None, "t_s is 9 in every row. Write when"),
        (
            "rate_dps,gyro_dps,temp_c,t_s\n1,2,3,8\n2,2,3,9\n3,4,3,9\n",
            None,
            "line 4: t_s is 9 as in the line before",
        ),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, counts: float | None, message: str) -> None:
    assert message in refused(tmp_path / "t.csv", text, counts)


def test_a_log_at_one_rate_may_share_times_and_values(tmp_path: Path) -> None:
    path = tmp_path / "rest.csv"
    path.write_text("rate_dps,gyro_dps,temp_c,gyro_std_dps,t_s\n" + "0,0,20,0,1\n" * 3 + "0,0,21,0,2\n")
    assert read_data_sets(path).notes == ()


def test_days_between_data_sets_may_be_milliseconds(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for step_s, said in ((60.0, 0), (7200.0, 0), (60_000.0, 1)):
        rows = [f"{k * step_s},{10 * (k % 5 - 2)},{10.1 * (k % 5 - 2)},{20 + k}" for k in range(20)]
        path.write_text("\n".join(["t_s,rate_dps,gyro_dps,temp_c", *rows]) + "\n")
        assert sum("milliseconds" in note for note in read_data_sets(path).notes) == said


@pytest.mark.parametrize(
    ("first_s", "on_s"), [(0.0, 0.0), (3600.0, 0.0), (8000.0, 8000.0), (1.7e9, 1.7e9), (-5.0, -5.0)]
)
def test_a_tables_clock_says_when_the_gyro_was_switched_on_unless_it_began_long_before(
    first_s: float, on_s: float
) -> None:
    assert switched_on_s(first_s + np.linspace(0.0, 7200.0, 20)) == on_s
