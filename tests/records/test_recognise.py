"""A file in the place of another: one sentence says what it is, and who takes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.cli import main

SAMPLE = Path(__file__).parents[2] / "sample_data"
DRIVE = SAMPLE / "drives" / "cw1.csv"
COEFFICIENTS = SAMPLE / "coefficients.json"
TABLE = SAMPLE / "data_sets.csv"

A_DRIVE = f"{DRIVE}: is the log of a drive: `replay` takes it, and `diagnose` with --robot."
A_TABLE = f"{TABLE}: is a table of data sets: `fit` and `report` take it, and `diagnose` without --robot."
A_FILE = f"{COEFFICIENTS}: is a coefficient file, and a recording is wanted here: coefficients are given with --coefficients."
UNPLACED = f"{SAMPLE}: is a directory without run.json, so it is no run of the bench. Did you mean one of:"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fit", DRIVE, "-o", "c.json"], A_DRIVE),
        (["report", DRIVE, "-c", COEFFICIENTS, "--out", "r"], A_DRIVE),
        (["noise", DRIVE], A_DRIVE),
        (["turn", DRIVE, "--out", "t"], A_DRIVE),
        (["umbmark", DRIVE, "--robot", DRIVE.parent / "robot.toml", "--side-m", "4"], A_DRIVE),
        (["noise", TABLE], A_TABLE),
        (["replay", TABLE, "--robot", DRIVE.parent / "robot.toml", "--out", "r"], A_TABLE),
        (["fit", COEFFICIENTS, "-o", "c.json"], A_FILE),
        (["noise", COEFFICIENTS], A_FILE),
        (["report", TABLE, "-c", TABLE, "--out", "r"], f"{TABLE}: is not a coefficient file"),
        (["report", SAMPLE / "run", "-c", SAMPLE / "run", "--out", "r"], "a coefficient file of `fit` is wanted"),
        (["fit", SAMPLE, "-o", "c.json"], UNPLACED),
        (["fit", SAMPLE, "-o", "c.json"], str(SAMPLE / "run")),
        (["fit", DRIVE.parent / "robot.toml", "-o", "c.json"], "is a profile or a robot file (TOML)"),
        (["fit", SAMPLE / "turns.csv", "-o", "c.json"], "`noise` takes it if the gyro stands"),
        (["fit", SAMPLE / "squares.csv", "-o", "c.json"], "`umbmark` takes it"),
        (["status", TABLE], f"{TABLE}: is a file, and a run directory is wanted here. Give the directory that `acquire` wrote."),
        (["noise", SAMPLE / "turns.csv"], "the gyro turns in it, at up to"),
    ],
)  # fmt: skip
def test_the_wrong_file_is_named(
    words: list[object],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    err = capsys.readouterr().err
    line = next(text for text in err.splitlines() if text.startswith("gyrocal:"))
    assert said in line
    assert ended.value.code in (3, 4, 6)
    assert not list(tmp_path.iterdir())


def test_a_ros_bag_is_told_as_that(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(SystemExit):
        main(["certify", str(tmp_path), "--out", str(tmp_path / "out")])
    assert f"{tmp_path}: is a ROS bag and no run of the bench: `noise` takes it" in capsys.readouterr().err
