"""Strict numeric CSV: what pandas would let pass in silence is refused with its line."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.records.csvio import format_columns, iterate_columns, read_columns, read_header, require_columns

SETTINGS = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
NUMBERS = st.floats(-1e20, 1e20, allow_subnormal=False) | st.just(float("nan"))


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read(path: Path) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in read_columns(path, read_header(path)).items()}


@SETTINGS
@given(
    rows=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), max_size=20), crlf=st.booleans(), end=st.booleans()
)
def test_numbers_come_back(
    tmp_path: Path, rows: list[tuple[float, float, float]], crlf: bool, end: bool
) -> None:
    values = np.array(rows, dtype=np.float64).reshape(-1, 3)
    text = format_columns({name: (values[:, k], "%.17g") for k, name in enumerate("abc")})
    text = text if end else text.rstrip("\n")
    path = write(tmp_path / "x.csv", text.replace("\n", "\r\n") if crlf else text)
    found = np.column_stack(list(read_columns(path, read_header(path)).values()))
    np.testing.assert_allclose(found, values, rtol=1e-15)


@SETTINGS
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = write(tmp_path / "x.csv", content)
    message = str(path)
    columns: dict[str, NDArray[np.float64]] = {}
    try:
        header = read_header(path)
        columns = read_columns(path, header) if len(set(header)) == len(header) else {}
    except InputError as error:
        message = str(error)
    assert str(path) in message
    assert all(values.dtype == np.float64 for values in columns.values())


@SETTINGS
@given(rows=st.lists(st.integers(0, 5), min_size=1, max_size=12))
def test_a_row_of_another_length_is_named(tmp_path: Path, rows: list[int]) -> None:
    """Rows of 0 to 5 cells under a header of 3; an empty line is a row of one cell."""
    text = "\n".join(["a,b,c", *(",".join(["1"] * n) for n in rows)]) + "\n"
    path = write(tmp_path / "x.csv", text)
    bad = [k for k, n in enumerate(rows) if n != 3]
    if not bad:
        assert len(read(path)["a"]) == len(rows)
        return
    wrong = "is empty. Remove it" if rows[bad[0]] == 0 else ".* cells where the header has 3"
    with pytest.raises(InputError, match=f"line {bad[0] + 2}: {wrong}"):
        read(path)


@pytest.mark.parametrize(
    ("header", "remedy"),
    [
        ("t_s,RATE_DPS", "Rename 'RATE_DPS' to rate_dps"),
        ("t_s, rate_dps [deg/s]", "Rename .*rate_dps .* to rate_dps"),
        ("# a comment", "first line is a comment: remove it"),
        ("t_s;rate_dps", "separated by semicolons"),
    ],
)
def test_a_header_that_is_nearly_right_gets_its_remedy(header: str, remedy: str) -> None:
    with pytest.raises(InputError, match=remedy):
        require_columns(Path("x.csv"), header.split(","), ["rate_dps"], ["t_s", "rate_dps"])


def test_quoted_names_are_names(tmp_path: Path) -> None:
    """As R writes them."""
    path = write(tmp_path / "x.csv", '"a","b"\n1,2\n')
    assert read_header(path) == ["a", "b"]
    assert read(path)["b"] == [2.0]


def test_quoted_numbers_are_numbers(tmp_path: Path) -> None:
    """As spreadsheets write them; a decimal comma in quotes is none, and a quote that never ends takes nothing along."""
    assert read(write(tmp_path / "x.csv", '"a","b"\n"1","-2.5"\n"3",""\n'))["b"][0] == -2.5
    for rows in ('"1,5","2"\n', '1,"2\n3,4\n5,6\n', '1,2\n3,4"\n'):
        with pytest.raises(InputError, match=r"x\.csv"):
            read(write(tmp_path / "x.csv", f"a,b\n{rows}"))


@pytest.mark.parametrize("cell", ['"2"3', '2"3', '""2"', '2""'])
def test_a_quote_within_a_number_is_none_of_a_cell(tmp_path: Path, cell: str) -> None:
    """A number was made of the digits on both sides of it."""
    with pytest.raises(InputError, match="line 3: a quote stands within a number"):
        read(write(tmp_path / "x.csv", f'a,b\n"1",2\n{cell},3\n'))


def test_a_date_is_told_from_a_wrong_number(tmp_path: Path) -> None:
    path = write(tmp_path / "x.csv", "t_s,b\n2026-11-23T08:00:00,1\n")
    with pytest.raises(InputError, match=r"line 2: t_s is .*, a date\. Write seconds"):
        read(path)


def test_lines_that_end_with_carriage_returns_alone_are_told(tmp_path: Path) -> None:
    path = write(tmp_path / "x.csv", "a,b\r1,2\r3,4\r")
    with pytest.raises(InputError, match="carriage returns alone"):
        read(path)


@pytest.mark.parametrize(
    "cell", ["ten", "True", "1_0", "0x10", "NULL", "NA", "1;2", '"ten"', "1 2", "--1", "é", "1e", "\0"]
)
def test_what_is_not_a_number_is_named(tmp_path: Path, cell: str) -> None:
    path = write(tmp_path / "x.csv", f"a,b\n1,2\n3,{cell}\n")
    with pytest.raises(InputError, match=r"line 3: b is .*not a number"):
        read(path)


@pytest.mark.parametrize(
    "cell", ["", " 4 ", "nan", "NaN", "inf", "-inf", "+1.5", ".5", "5.", "1e-3", "-1E+3"]
)
def test_what_is_a_number_or_empty_is_read(tmp_path: Path, cell: str) -> None:
    path = write(tmp_path / "x.csv", f"a,b\n1,{cell}\n")
    expected = float(cell) if cell.strip() else np.nan
    np.testing.assert_equal(read(path)["b"], [expected])


def test_bad_line_far_into_a_long_file(tmp_path: Path) -> None:
    text = "a,b\n" + "1.25,2.5\n" * 600_000 + "1\n" + "1.25,2.5\n" * 10
    with pytest.raises(InputError, match="line 600002: 1 cells"):
        read(write(tmp_path / "x.csv", text))


def test_blocks_know_their_lines(tmp_path: Path) -> None:
    path = write(tmp_path / "x.csv", "a\n" + "\n".join(map(str, range(10))) + "\n")
    blocks = list(iterate_columns(path, ["a"], 4))
    assert [line for line, _ in blocks] == [2, 6, 10]
    assert np.concatenate([c["a"] for _, c in blocks]).tolist() == list(range(10))


def test_chosen_columns_leave_the_others_alone(tmp_path: Path) -> None:
    path = write(tmp_path / "x.csv", 'a,note,b\n1,"hello, there",2\n3,x,4\n')
    ((_, columns),) = iterate_columns(path, ["a", "note", "b"], 100, ["a", "b"])
    assert columns["b"].tolist() == [2.0, 4.0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.csv", b"", "is empty"),
        ("x.csv", b"\n1,2\n", "is empty"),
        ("x.csv", b"a\0b,c\n", "is not a text file"),
        ("x.csv", b"\xff\xfe\x00", "is not a text file"),
        ("x.csv.part", b"a,b\n1,2\n", "is still being written"),
    ],
)
def test_headers_that_are_none(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_header(write(tmp_path / name, content))


def test_missing_file_and_directory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_header(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is a directory"):
        read_header(tmp_path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (["a"], "column b is missing"),
        (["a", "b", "a"], "column a stands twice"),
        (["a", "b", "z"], "unknown column 'z'"),
    ],
)
def test_columns_that_are_wrong(header: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        require_columns(Path("x.csv"), header, ("a", "b"), ("a", "b", "c"))


def test_very_many_columns_take_no_longer_than_their_number(tmp_path: Path) -> None:
    """In 2026 a header of 50,000 names took 47 s, since each was looked for in all."""
    path = tmp_path / "wide.csv"
    path.write_text(",".join(f"c{k}" for k in range(50_000)) + "\n" + ",".join(["1"] * 50_000) + "\n")
    begin_s = time.process_time()
    with pytest.raises(InputError, match="unknown column 'c1'"):
        require_columns(path, read_header(path), ("c0",), ("c0",))
    assert time.process_time() - begin_s < 5.0


@pytest.mark.parametrize("cell", ["1e308", "-1e21"])
def test_numbers_that_no_quantity_has_are_refused(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(f"a,b\n1,2\n3,{cell}\n")
    with pytest.raises(InputError, match=r"line 3: b is .*; no quantity is so large. Repair or remove"):
        read_columns(path, ["a", "b"])


def test_a_file_without_lines_is_not_held_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(b"1" * (1 << 25))
    with pytest.raises(InputError, match="is not a text file"):
        read_header(path)
    path.write_bytes(b"a,b\n" + b"1" * (1 << 25))
    with pytest.raises(InputError, match="holds a line of more than"):
        read_columns(path, ["a", "b"])


@pytest.mark.parametrize(
    ("header", "known", "commands"),
    [
        (
            ["t_s", "left_m", "right_m", "gyro_dps"],
            ("rate_dps", "gyro_dps"),
            "is the log of a drive: `replay` takes it",
        ),
        (
            ["t_s", "speed_mps", "gyro_dps"],
            ("t_s", "gyro_dps", "temp_c"),
            "is the log of a drive: `replay` takes it",
        ),
        (
            ["rate_dps", "gyro_dps", "temp_c"],
            ("t_s", "left_m", "right_m"),
            "is a table of data sets: `fit` and `report` take it",
        ),
    ],
)
def test_a_file_of_another_kind_is_told_with_the_commands_that_take_it(
    header: list[str], known: tuple[str, ...], commands: str
) -> None:
    for required in (known[:1], ()):
        with pytest.raises(InputError, match=commands):
            require_columns(Path("a.csv"), header, required, known)


def test_a_cell_as_long_as_a_file_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "x.csv", "t_s,gyro_dps\n" + 200_000 * "x" + ",1\n")
    with pytest.raises(InputError, match="cannot be parsed as CSV"):
        read(path)
