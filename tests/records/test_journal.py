"""The run writer: a segment is sealed or it is not, whatever instant the program dies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gyrocal.errors import InputError, OutputError
from gyrocal.records.journal import RunWriter, create_run, is_stillborn, resume_run, segment_file
from gyrocal.records.run import read_run

HEAD = {"schema": "gyrocal-run/1", "sensor": {"model": "m"}}
ROW = "1.0,0.5,20.0,0,,,,\n"


def seal(writer: RunWriter, number: int = 1) -> None:
    """Write and seal a segment of one row."""
    segment = writer.begin_segment(number, "rate", -12.5, -7.25)
    segment.append(ROW)
    segment.seal(t_start_s=1.0, t_end_s=1.0, n=1, averaging_s=None, outcome="ok")


def journal(path: Path) -> list[str]:
    """Events of the journal."""
    return [json.loads(line)["event"] for line in (path / "journal.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((3, "rate", -12.5, -7.25), "data/0003_rate_-012.500dps_-007.2C.csv"),
        ((12345, "soak", 0.0, 120.0), "data/12345_soak_+000.000dps_+120.0C.csv"),
        ((1, "ramp", -0.0, -0.0), "data/0001_ramp_+000.000dps_+000.0C.csv"),
    ],
)
def test_names_of_segments(arguments: tuple[int, str, float, float], name: str) -> None:
    assert segment_file(*arguments) == name


def test_a_sealed_segment_reads_back(tmp_path: Path) -> None:
    with create_run(tmp_path / "r", HEAD) as writer:
        seal(writer)
    run = read_run(tmp_path / "r")
    assert run.segment(run.segments[0]).gyro_dps.tolist() == [0.5]
    assert journal(tmp_path / "r") == ["sealing", "segment"]


def test_an_open_segment_is_a_part_that_readers_do_not_see(tmp_path: Path) -> None:
    with create_run(tmp_path / "r", HEAD) as writer:
        segment = writer.begin_segment(1, "rate", 0.0, 20.0)
        segment.append(ROW)
        assert [p.suffix for p in (tmp_path / "r" / "data").iterdir()] == [".part"]
        assert read_run(tmp_path / "r").segments == ()
        segment.abandon()


def test_an_output_that_holds_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="exists and is not empty"):
        create_run(tmp_path, HEAD)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_a_read_only_output_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(OutputError, match="cannot write here"):
        create_run(tmp_path / "r", HEAD)


def test_a_shell_left_by_a_crash_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "r"
    (path / "data").mkdir(parents=True)
    (path / "journal.jsonl").touch()
    (path / ".run.json.abc.part").write_text("{")
    assert is_stillborn(path)
    create_run(path, HEAD).__exit__()
    assert {p.name for p in path.iterdir()} == {"data", "journal.jsonl", "run.json"}
    assert not is_stillborn(path)


def test_two_writers_are_kept_apart(tmp_path: Path) -> None:
    with (
        create_run(tmp_path / "r", HEAD),
        pytest.raises(OutputError, match="another gyrocal is writing this run"),
    ):
        resume_run(tmp_path / "r")
    writer, _ = resume_run(tmp_path / "r")
    writer.__exit__()


def test_resume_finds_what_is_sealed_and_discards_what_is_not(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer, 1)
        writer.begin_segment(2, "rate", 0.0, 20.0).abandon()
    (path / "data" / "notes.txt").write_text("mine")
    writer, found = resume_run(path)
    with writer:
        assert found.sealed == {1: "ok"}
        assert found.highest_id == 1
        assert found.last_t_s == 1.0
        assert found.discarded == ("data/0002_rate_+000.000dps_+020.0C.csv.part",)
    assert (path / "data" / "notes.txt").exists()


@pytest.mark.parametrize("renamed", [True, False])
def test_a_file_that_was_announced_is_adopted(tmp_path: Path, renamed: bool) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    lines = (path / "journal.jsonl").read_text().splitlines(keepends=True)
    (path / "journal.jsonl").write_text(lines[0] + lines[1][:40])  # died while it wrote the last line
    file = next((path / "data").iterdir())
    if not renamed:
        file.rename(file.with_name(file.name + ".part"))
    writer, found = resume_run(path)
    writer.__exit__()
    assert found.adopted == (f"data/{file.name}",)
    assert journal(path) == ["sealing", "segment"]
    run = read_run(path)
    assert run.segment(run.segments[0]).gyro_dps.tolist() == [0.5]


def test_a_file_that_was_announced_but_is_not_whole_is_discarded(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    (path / "journal.jsonl").write_text((path / "journal.jsonl").read_text().splitlines()[0] + "\n")
    file = next((path / "data").iterdir())
    file.write_text("torn")
    writer, found = resume_run(path)
    writer.__exit__()
    assert found.sealed == {}
    assert not file.exists()


def test_a_sealed_file_that_changed_stops_the_resume(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    next((path / "data").iterdir()).write_text("edited")
    with pytest.raises(InputError, match="differs from what the journal sealed"):
        resume_run(path)
    # and the lock is free again
    RunWriter(path).__exit__()


def test_measured_files_that_the_journal_lost_are_not_thrown_away(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        for number in (1, 2, 3):
            seal(writer, number)
    lines = (path / "journal.jsonl").read_text().splitlines(keepends=True)
    (path / "journal.jsonl").write_text("".join(lines[:2]))  # cut in its middle, at the end of a line
    before = sorted((path / "data").iterdir())
    with pytest.raises(InputError, match=r"2 files in data stand in no line of the journal.*0002_rate"):
        resume_run(path)
    assert sorted((path / "data").iterdir()) == before
    assert journal(path) == ["sealing", "segment"]


@pytest.mark.parametrize(
    ("event", "sentence"),
    [
        ({"event": "sealing", "t_s": 1.0}, "line 3: the segment's id is missing"),
        ({"event": "sealing", "t_s": 1.0, "id": "x"}, "line 3: id is 'x', and a number is wanted"),
        ({"event": "skipped", "id": [1]}, r"line 3: id is \[1\], and a number is wanted"),
    ],
)
def test_a_line_that_was_edited_by_hand_is_named(
    tmp_path: Path, event: dict[str, Any], sentence: str
) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    with (path / "journal.jsonl").open("a") as f:
        f.write(json.dumps(event) + "\n")
    with pytest.raises(InputError, match=sentence):
        resume_run(path)


def test_a_line_without_a_time_hinders_no_resume(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    with (path / "journal.jsonl").open("a") as f:
        f.write('{"event": "note", "t_s": null, "id": null}\n')
    writer, found = resume_run(path)
    writer.__exit__()
    assert (found.last_t_s, found.highest_id) == (1.0, 1)


def test_a_damaged_journal_stops_the_resume(tmp_path: Path) -> None:
    path = tmp_path / "r"
    with create_run(path, HEAD) as writer:
        seal(writer)
    (path / "journal.jsonl").write_text("{]\n" + (path / "journal.jsonl").read_text())
    with pytest.raises(InputError, match=r"journal\.jsonl, line 1: is not JSON"):
        resume_run(path)
    (path / "journal.jsonl").write_text("7\n")
    with pytest.raises(InputError, match="is not a JSON object"):
        resume_run(path)


def test_what_is_not_a_number_becomes_null(tmp_path: Path) -> None:
    with create_run(tmp_path / "r", HEAD) as writer:
        writer.event("make_safe", 1.0, table_rate_dps=float("nan"))
    line = (tmp_path / "r" / "journal.jsonl").read_text()
    assert json.loads(line)["table_rate_dps"] is None
