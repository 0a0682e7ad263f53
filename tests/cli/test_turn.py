"""`gyrocal turn` and `gyrocal umbmark` as a user runs them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gyrocal.cli import gyrocal_command
from tests.calibration.test_turns import Gyro, turned
from tests.navigation.test_umbmark import return_error


@pytest.fixture
def log(tmp_path: Path) -> Path:
    t_s, gyro = turned(np.random.default_rng(1), Gyro(3e-3, 8e-4, -0.12), 0.02, [1, -1, 1, 1, -1, -1])
    path = tmp_path / "turns.csv"
    rows = [f"{t:.3f},{g:.6f}" for t, g in zip(t_s, gyro, strict=True)]
    rows[40] = rows[40].split(",")[0] + ","
    path.write_text("\n".join(["t_s,gyro_dps", *rows]) + "\n")
    return path


def test_turn_says_and_writes(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = CliRunner().invoke(gyrocal_command, ["turn", str(log), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output.startswith("6 turns between 7 rests: scale factor error 3")
    assert "- 1 empty sample is bridged by the next one" in done.output
    data = json.loads((out / "turns.json").read_text())
    assert data["scale"]["low"] < 3000 < data["scale"]["high"]
    assert (out / "turns.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "turns.html").read_text(encoding="utf-8")
    assert "mean bias of the rests" in page
    assert "Rests and turns" in page


def test_turn_reads_logs_of_others(log: Path, tmp_path: Path) -> None:
    t_s, gyro_dps = np.genfromtxt(log, delimiter=",", skip_header=1).T
    table = np.stack([1e3 * t_s, -np.radians(gyro_dps)], axis=1)
    other = tmp_path / "other.csv"
    np.savetxt(other, table[np.isfinite(gyro_dps)], "%.9f", ",", header="ms,wz", comments="")
    columns = tmp_path / "columns.toml"
    columns.write_text(
        '[columns.t_s]\nfrom = "ms"\nunit = "ms"\n[columns.gyro_dps]\nfrom = "wz"\nunit = "rad/s"\nsign = -1\n'
    )
    words = ["turn", str(other), "--columns", str(columns), "--json"]
    found = json.loads(CliRunner().invoke(gyrocal_command, words).output)
    assert len(found["turns"]) == 6
    assert found["scale"]["low"] < 3000 < found["scale"]["high"]


def test_turn_as_json(log: Path) -> None:
    done = CliRunner().invoke(gyrocal_command, ["turn", str(log), "--json"])
    assert json.loads(done.output)["schema"] == "gyrocal-turns/1"


def test_a_log_without_turns_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "rest.csv"
    path.write_text("t_s,gyro_dps\n" + "".join(f"{0.1 * k:.1f},{0.01 * (k % 3):.2f}\n" for k in range(900)))
    done = CliRunner().invoke(gyrocal_command, ["turn", str(path)])
    assert str(done.exception).startswith(f"{path}: ")
    assert "three turns are wanted" in str(done.exception)


def squares(path: Path, bad: str = "") -> Path:
    rng = np.random.default_rng(2)
    rows = [
        f"{direction},{x:.5f},{y:.5f}"
        for direction in (1, -1)
        for x, y in return_error(direction, 1.002, 1.01) + 0.005 * rng.normal(size=(5, 2))
    ]
    path.write_text("\n".join(["direction,x_m,y_m", *rows]) + "\n" + bad)
    return path


def test_umbmark(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text("wheel_separation_m = 0.34\n")
    path = squares(tmp_path / "squares.csv")
    done = CliRunner().invoke(gyrocal_command, ["umbmark", str(path), "--robot", str(robot), "--side-m", "4"])
    assert done.exit_code == 0, done.output
    assert "Systematic error before correction" in done.output
    words = ["umbmark", str(path), "--robot", str(robot), "--side-m", "4", "--json"]
    data = json.loads(CliRunner().invoke(gyrocal_command, words).output)
    assert data["wheel_separation_m"]["low"] < 0.34 * 1.01 < data["wheel_separation_m"]["high"]


def test_a_bad_square_is_named_with_its_line(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text("wheel_separation_m = 0.34\n")
    path = squares(tmp_path / "squares.csv", "2,0.1,0.1\n")
    done = CliRunner().invoke(gyrocal_command, ["umbmark", str(path), "--robot", str(robot), "--side-m", "4"])
    assert str(done.exception).endswith(
        "squares.csv, line 12: holds 2, 0.1, 0.1; wanted are a direction of 1 or -1 and two distances in metres."
    )
