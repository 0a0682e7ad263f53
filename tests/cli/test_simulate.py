"""``gyrocal simulate``: drives and Table II from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gyrocal.cli import main
from gyrocal.errors import EXIT_CODES, OutputError
from gyrocal.report import navigation_table2


def run(*arguments: str) -> int:
    """Exit code of ``gyrocal simulate``."""
    try:
        main(["simulate", *arguments])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_drive_writes_logs_robot_and_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drives"
    assert run("drive", "--runs", "2", "--direction", "cw", "--seed", "3", "--out", str(out)) == 0
    assert {p.name for p in out.iterdir()} == {"cw1.csv", "cw2.csv", "robot.toml", "simulation.json"}
    printed = capsys.readouterr().out
    assert "2 logs of the square, robot.toml and simulation.json (unit 1, seed 3," in printed
    assert f"gyrocal replay {out}/*.csv" in printed


def test_drive_as_json_is_its_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("drive", "--runs", "1", "--out", str(tmp_path / "a"), "--json") == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "a" / "simulation.json").read_text())


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("x")
    assert run("drive", "--out", str(tmp_path)) == EXIT_CODES[OutputError]
    assert "exists and is not empty" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_table2(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = list(navigation_table2.WHAT_IF.items())
    monkeypatch.setattr(navigation_table2, "WHAT_IF", dict([worlds[0], worlds[5]]))
    out = tmp_path / "t2"
    arguments = ("table2", "--experiments", "2", "--what-if", "1", "--workers", "1", "--out", str(out))
    assert run(*arguments) == 0
    printed = capsys.readouterr().out
    assert (
        "Over 2 experiments (data sheet, nonlinearity 0.5 % of full scale) the mean return error improves"
        in printed
    )
    assert "Which physical input would give the paper's factors" in printed
    assert "mean ccw" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert summary["experiments"] == 2
    assert summary["factors"]["calibration"]["median"] > 10.0
    assert list(summary["what_if"]) == [worlds[5][0]]
    # Table I's bias stability in place of 1.8 deg/h: the calibrated gyro returns four times as badly.
    assert (
        summary["what_if"][worlds[5][0]]["calibrated"]["median"]
        > 2.0 * summary["mean_error_m"]["calibrated"]["median"]
    )
    names = {p.name for p in out.iterdir()}
    assert {"table2.html", "factors.png", "table2.svg", "sensitivity.csv", "what_if.csv"} <= names
