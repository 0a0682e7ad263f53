"""A directory of results is there wholly or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.errors import OutputError
from gyrocal.records.files import raise_output_error, write_atomically
from gyrocal.records.output import check_output, write_directory


def test_files_and_folders_are_written(tmp_path: Path) -> None:
    out = tmp_path / "report"
    write_directory(out, {"a.txt": "text", "figures/b.png": b"\x00\x01"})
    assert (out / "a.txt").read_text() == "text"
    assert (out / "figures/b.png").read_bytes() == b"\x00\x01"
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_an_empty_directory_is_taken(tmp_path: Path) -> None:
    out = tmp_path / "report"
    out.mkdir()
    write_directory(out, {"a.txt": "text"})
    assert (out / "a.txt").exists()


@pytest.mark.parametrize("function", [check_output, lambda path: write_directory(path, {"a.txt": "text"})])
def test_a_directory_with_files_is_refused_and_kept(tmp_path: Path, function: object) -> None:
    out = tmp_path / "report"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    with pytest.raises(
        OutputError, match=r"exists and is not empty; nothing was overwritten\. Choose another --out"
    ):
        function(out)  # type: ignore[operator]
    assert [p.name for p in out.iterdir()] == ["mine.txt"]


def test_check_leaves_nothing_behind(tmp_path: Path) -> None:
    check_output(tmp_path / "report")
    assert list(tmp_path.iterdir()) == []


def test_a_failure_in_the_middle_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(path: Path, data: bytes | str) -> None:
        if path.name == "b.txt":
            raise_output_error(path, OSError(28, "No space left on device"))
        write_atomically(path, data)

    monkeypatch.setattr("gyrocal.records.output.write_atomically", full_disk)
    with pytest.raises(OutputError, match="the disk is full; nothing was left half-written") as caught:
        write_directory(tmp_path / "report", {"a.txt": "a", "b.txt": "b"})
    assert str(caught.value).startswith(f"{tmp_path / 'report'}: ")
    assert list(tmp_path.iterdir()) == []
