"""Rendering that commands share: plain when piped, JSON that any parser reads."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from pathlib import Path

import pytest

from gyrocal.cli.console import emit_json, emit_table, progress
from gyrocal.cli.filling import filling
from gyrocal.errors import InterruptedRunError, OutputError
from gyrocal.records.files import raise_output_error


def test_json_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    emit_json({"a": float("nan"), "b": [float("inf"), 1.5], "c": {"d": None, "e": "x"}})
    text = capsys.readouterr().out

    def refuse(word: str) -> None:
        raise AssertionError(word)

    parsed = json.loads(text, parse_constant=refuse)
    assert parsed == {"a": None, "b": [None, 1.5], "c": {"d": None, "e": "x"}}


def test_table_is_aligned_when_piped(capsys: pytest.CaptureFixture[str]) -> None:
    emit_table(("name", "value"), (("a", "1.0"), ("long name", "12.25")), title="Numbers")
    assert capsys.readouterr().out.splitlines() == [
        "Numbers",
        "name       value",
        "a            1.0",
        "long name  12.25",
    ]


def test_a_wide_table_folds_its_widest_cells(capsys: pytest.CaptureFixture[str]) -> None:
    text = " ".join(["word"] * 60)
    emit_table(("name", "what"), (("a", text), ("b", "short")))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    assert " ".join(lines).split().count("word") == 60
    assert sum(line.startswith("b ") for line in lines) == 1


def test_an_interval_is_not_broken_where_the_window_lets_it_be(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    columns = ("figure", "before the repair", "after the repair", "")
    row = ("scale factor error", "1,815 (1,808 to 1,822)", "-0.4227 (-7.448 to 6.493)", "")
    emit_table(columns, [row])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 60
    assert any("(1,808 to 1,822)" in line and "(-7.448 to 6.493)" in line for line in lines)
    assert "\N{NO-BREAK SPACE}" not in "".join(lines)


def test_table_without_rows(capsys: pytest.CaptureFixture[str]) -> None:
    emit_table(("name", "value"), ())
    assert capsys.readouterr().out.splitlines() == ["name  value"]


def test_piped_progress_says_a_line_a_quarter_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("acquire") as report:
        for i in range(101):
            report(i / 100, f"segment {i}")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "acquire: 0%, segment 0",
        "acquire: 25%, segment 25",
        "acquire: 50%, segment 50",
        "acquire: 75%, segment 75",
        "acquire: 100%, segment 100",
    ]


def test_quiet_progress_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("acquire", quiet=True) as report:
        report(1.0, "x")
    captured = capsys.readouterr()
    assert captured.out + captured.err == ""


def test_a_table_whose_numbers_would_break_is_set_out_row_by_row(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    columns = ("figure", "run1", "last less first", "")
    row = ("scale factor error", "1,815 (1,808 to 1,822)", "3.061 (-6.600 to 12.72)", "")
    emit_table(columns, [row, ("bias", "1", "7 (6 to 8)", "changed")])
    assert capsys.readouterr().out.splitlines() == [
        "scale factor error",
        "  run1             1,815",
        "                   (1,808 to 1,822)",
        "  last less first  3.061",
        "                   (-6.600 to 12.72)",
        "bias",
        "  run1             1",
        "  last less first  7 (6 to 8)",
        "                   changed",
    ]


def test_what_goes_on_of_a_title_stands_in(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "26")
    emit_table(("figure", "value"), [("scale factor error", "1,815 (1,808 to 1,822)"), ("bias", "3")])
    assert capsys.readouterr().out.splitlines() == [
        "figure               value",
        "scale                1,815",
        "  factor  (1,808 to 1,822)",
        "  error",
        "bias                     3",
    ]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InterruptedRunError("... --resume carries on.")])
def test_an_interrupted_demo_or_trial_promises_no_resume(error: BaseException) -> None:
    with pytest.raises(InterruptedRunError) as caught, filling(Path("demo")):
        raise error
    assert (
        str(caught.value)
        == "interrupted; demo holds what was done until then, which nothing carries on. Remove it and run it again."
    )


def test_a_full_disk_in_a_demo_or_trial_promises_no_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OutputError) as caught, filling(tmp_path):
        raise_output_error(tmp_path / "run", full, "what was sealed is kept. Carry on with --resume")
    assert str(caught.value) == (
        f"{tmp_path}: cannot write all of it (No space left on device); it holds what was done until then, which nothing "
        "carries on. Remove it, and free some space or choose another place."
    )
    monkeypatch.setattr(tempfile, "tempdir", "/elsewhere")
    with pytest.raises(OutputError, match=r"^/elsewhere: .* name another place in TMPDIR"), filling(tmp_path):
        raise OutputError("/elsewhere/trial0: cannot be written") from full
    with pytest.raises(OutputError, match="exists and holds files"), filling(tmp_path):
        raise OutputError(f"{tmp_path}: exists and holds files.")
