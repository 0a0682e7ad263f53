"""``run.json`` and the journal of other loggers: what is of the wrong kind is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gyrocal.errors import InputError
from gyrocal.records.run import read_run

HEAD: dict[str, Any] = {"schema": "gyrocal-run/1", "sensor": {"model": "m"}}
SEGMENT: dict[str, Any] = {
    "event": "segment",
    "id": 1,
    "kind": "rate",
    "rate_dps": 10.0,
    "chamber_c": 20.0,
    "t_start_s": 0.0,
    "t_end_s": 1.0,
    "n": 10,
    "outcome": "ok",
    "file": "data/a.csv",
    "sha256": "0",
}


def write(path: Path, head: str, journal: str) -> Path:
    """A run directory of these texts."""
    (path / "run.json").write_text(head)
    (path / "journal.jsonl").write_text(journal)
    return path


def test_schema_and_sensor_are_enough(tmp_path: Path) -> None:
    run = read_run(write(tmp_path, json.dumps(HEAD), json.dumps(SEGMENT) + "\n"))
    assert run.segments[0].averaging_s is None
    assert run.notes == tuple(
        f"run.json does not say {k}" for k in ("created_utc", "power_on_t_s", "profile")
    )


def test_a_serial_number_that_is_a_number_is_text(tmp_path: Path) -> None:
    head = HEAD | {"sensor": {"model": "m", "serial": 5}}
    assert read_run(write(tmp_path, json.dumps(head), "")).sensor.serial == "5"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"power_on_t_s": "x"}, "power_on_t_s is 'x'"),
        ({"power_on_t_s": float("nan")}, "power_on_t_s is nan"),
        ({"bench": [1]}, r"bench is \[1\]"),
        ({"profile": "x"}, "profile is 'x'"),
        ({"sensor": {"model": "m", "sample_rate_hz": "ten"}}, "sample_rate_hz is 'ten'"),
        ({"sensor": {"model": "m", "sample_rate_hz": 0}}, "sample_rate_hz is 0"),
        ({"sensor": {"model": "m", "rate_range_dps": [100, -100]}}, "the smaller first"),
        ({"sensor": {"model": "m", "temp_range_c": [float("nan"), 1]}}, "temp_range_c is"),
    ],
)
def test_a_head_of_the_wrong_kind_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_run(write(tmp_path, json.dumps(HEAD | change), ""))


def test_a_head_nested_too_deep_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not JSON"):
        read_run(write(tmp_path, "[" * 100_000, ""))


@pytest.mark.parametrize("line", ["5", "[1]", "null", '"text"'])
def test_a_journal_line_that_is_no_object_is_refused(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError, match=r"journal\.jsonl, line 1: is not a JSON object"):
        read_run(write(tmp_path, json.dumps(HEAD), line + "\n"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("id", float("inf")),
        ("id", "x"),
        ("rate_dps", None),
        ("rate_dps", float("nan")),
        ("n", True),
        ("averaging_s", "x"),
        ("t_end_s", 10**400),
        ("file", 5),
        ("file", "a\0b"),
    ],
)
def test_a_segment_with_a_bad_value_is_refused(tmp_path: Path, key: str, value: Any) -> None:
    journal = json.dumps(SEGMENT | {key: value}) + "\n"
    with pytest.raises(InputError, match=rf"journal\.jsonl, line 1: .*{key} is "):
        read_run(write(tmp_path, json.dumps(HEAD), journal))


def journal(*events: dict[str, Any]) -> str:
    return "".join(json.dumps(event) + "\n" for event in events)


START, END = {"event": "start", "t_s": 0.0, "steps": 2}, {"event": "end", "t_s": 9.0, "complete": True}
OTHER = SEGMENT | {"id": 2, "file": "data/b.csv", "t_start_s": 1.0}


@pytest.mark.parametrize(
    ("events", "note"),
    [
        ((START, SEGMENT, OTHER, END), None),
        ((SEGMENT, OTHER), None),  # another logger, which says nothing of starts and ends
        ((START, SEGMENT, {"event": "end", "t_s": 9.0}), "has 1 of 2 segments"),
        ((START, SEGMENT), "incomplete: 1 of 2 planned segments are sealed; its journal has no end"),
        ((START, SEGMENT, END), "says that it was completed, and has 1 of 2 segments"),
        ((START, SEGMENT, END | {"complete": False}), "some segments were skipped or failed"),
        ((START, SEGMENT, {"event": "aborted", "t_s": 2.0, "reason": "Ctrl-C"}), "it was ended: Ctrl-C"),
        ((START, SEGMENT, END, {"event": "resume", "t_s": 3.0}, OTHER), "its journal has no end"),
    ],
)
def test_a_run_that_is_not_whole_says_so(
    tmp_path: Path, events: tuple[dict[str, Any], ...], note: str | None
) -> None:
    notes = [
        n for n in read_run(write(tmp_path, json.dumps(HEAD), journal(*events))).notes if "run.json" not in n
    ]
    assert len(notes) == (note is not None)
    assert note is None or note in notes[0]


def test_files_that_the_journal_does_not_name_are_counted(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    for name in ("a", "b", "c"):
        (tmp_path / "data" / f"{name}.csv").write_text("t_s,gyro_dps\n")
    run = read_run(write(tmp_path, json.dumps(HEAD), journal(SEGMENT)))
    assert run.notes[-1] == (
        "2 files in data stand in no line of the journal and are not used (the first: data/b.csv); was it cut?"
    )


@pytest.mark.parametrize(("said_s", "taken"), [(0.1, True), (0.12, True), (10.0, False), (0.0, False)])
def test_a_row_averages_over_no_more_than_rows_lie_apart(tmp_path: Path, said_s: float, taken: bool) -> None:
    """Other loggers write the length of the whole segment."""
    segment = SEGMENT | {"t_start_s": 5.0, "t_end_s": 14.9, "n": 100, "averaging_s": said_s}
    run = read_run(write(tmp_path, json.dumps(HEAD), journal(segment)))
    assert run.segments[0].averaging_s == (said_s if taken else None)
    said = [note for note in run.notes if "averaging_s" in note]
    assert said == [
        "journal.jsonl says of 1 of 1 segments an averaging_s that is none, or longer than rows lie apart; "
        "their spacing is taken instead"
    ] * (not taken)


@pytest.mark.parametrize("file", ["data/a.csv", "data/./a.csv"])
def test_two_lines_of_one_file_are_refused(tmp_path: Path, file: str) -> None:
    run = write(tmp_path, json.dumps(HEAD), journal(SEGMENT, OTHER | {"file": file}))
    with pytest.raises(InputError, match=r"line 2: names data/a.csv, as line 1 does. The journal is"):
        read_run(run)


@pytest.mark.parametrize("file", ["/etc/passwd", "../a.csv", "data/../../a.csv", ""])
def test_files_outside_of_the_run_are_refused(tmp_path: Path, file: str) -> None:
    run = write(tmp_path, json.dumps(HEAD), journal(SEGMENT | {"file": file}))
    with pytest.raises(InputError, match="and a path in the run is wanted"):
        read_run(run)


def test_the_mark_of_a_windows_editor_is_passed_over(tmp_path: Path) -> None:
    run = read_run(write(tmp_path, "\ufeff" + json.dumps(HEAD), "\ufeff" + journal(SEGMENT)))
    assert len(run.segments) == 1


@pytest.mark.parametrize("event", [{"event": "end", "t_s": "now"}, START | {"steps": [2]}])
def test_events_of_the_wrong_kind_are_refused(tmp_path: Path, event: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"line 1: (t_s|steps) is .*, and a number is wanted"):
        read_run(write(tmp_path, json.dumps(HEAD), journal(event)))
