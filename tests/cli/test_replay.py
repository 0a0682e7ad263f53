"""``gyrocal replay``: what is written, what is printed, and that bad input leaves nothing behind."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.cli import main
from gyrocal.errors import EXIT_CODES, DataError, InputError, OutputError, ProfileError
from gyrocal.navigation.simulate import CW
from gyrocal.records.drive import format_drive_log
from gyrocal.records.robot import format_robot
from gyrocal.report import navigation
from gyrocal.report.page import Picture
from tests.navigation.drives import BAD, calibration, drive, robot

SHARED = Path(__file__).parents[2].parent / "shared"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two logs, robot file and coefficients."""
    (tmp_path / "cw.csv").write_text(format_drive_log(drive(CW)))
    (tmp_path / "ccw.csv").write_text(format_drive_log(drive()))
    r = robot()
    text = format_robot(r)
    (tmp_path / "robot.toml").write_text(text)
    (tmp_path / "c.json").write_text(calibration().to_text())
    return tmp_path


def run(folder: Path, *arguments: str) -> int:
    """Exit code of a replay in `folder`."""
    try:
        main(["replay", *(a.replace("@", f"{folder}/") for a in arguments)])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def without_figures(patch: pytest.MonkeyPatch) -> None:
    """They take most of the time of a replay, and have tests of their own."""
    picture = Picture("trajectories", "Trajectories", "All runs")
    patch.setattr(navigation, "draw_figures", lambda replays, table: [(picture, None)])
    patch.setattr(navigation, "render", lambda figure, kind: kind.encode())


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures."""
    without_figures(monkeypatch)


ALL = ("@cw.csv", "@ccw.csv", "--robot", "@robot.toml", "--coefficients", "@c.json", "--out", "@out")


def test_everything_is_written_and_the_table_printed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(folder, *ALL) == 0
    out = capsys.readouterr().out
    assert "calibration, filter, cm" in out
    assert "Improvement factors: " in out
    # They end where they began, and are few.
    assert "Errors against truth, all along the path" in out
    written = {str(p.relative_to(folder / "out")) for p in (folder / "out").rglob("*") if p.is_file()}
    assert {"table.csv", "summary.json", "replay.html", "figures/trajectories.png"} <= written
    assert {"trajectories/cw.csv", "states/ccw_calibrated_filter.csv", "figures/trajectories.svg"} <= written
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["schema"] == "gyrocal-replay/1"
    assert [log["direction"] for log in summary["logs"]] == ["cw", "ccw"]
    assert set(summary["logs"][0]["conditions"]) == {
        "uncalibrated",
        "uncalibrated_filter",
        "calibrated",
        "calibrated_filter",
    }
    page = (folder / "out" / "replay.html").read_text()
    assert 'src="data:image/png' in page
    assert "http" not in page.replace("http://www.w3.org", "")


@pytest.mark.slow
def test_the_same_logs_give_the_same_bytes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = navigation.draw_figures
    monkeypatch.setattr(navigation, "draw_figures", lambda replays, table: figures(replays, table)[:1])
    arguments = ("@ccw.csv", "--robot", "@robot.toml", "--out")
    assert run(folder, *arguments, "@a") == 0
    assert run(folder, *arguments, "@b") == 0
    for path in sorted((folder / "a").rglob("*")):
        if path.is_file():
            assert path.read_bytes() == (folder / "b" / path.relative_to(folder / "a")).read_bytes(), path


def test_json_is_the_summary(folder: Path, quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(folder, "@ccw.csv", "--robot", "@robot.toml", "--out", "@out", "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out) == json.loads((folder / "out" / "summary.json").read_text())
    assert printed.err == ""


@pytest.mark.parametrize("name", BAD)
def test_a_bad_log_ends_in_one_sentence_and_leaves_nothing(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, message = BAD[name]
    (folder / "bad.csv").write_text(format_drive_log(spoil(drive())))
    # Nothing is written before all are read: one of them, after a good log, shows it.
    good = ["@ccw.csv"] if name == next(iter(BAD)) else []
    words = (*good, "@bad.csv", "--robot", "@robot.toml", "--out", "@out")
    assert run(folder, *words) == EXIT_CODES[DataError]
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert not (folder / "out").exists()


def _edit(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        (folder / name).write_text(change((folder / name).read_text()))

    return edit


def _occupied(folder: Path) -> None:
    (folder / "out").mkdir()
    (folder / "out" / "mine.txt").write_text("x")


@pytest.mark.parametrize(
    ("spoil", "code", "message"),
    [
        (
            _edit("robot.toml", lambda s: s.replace("wheel_separation_m = 0.6\n", "", 1)),
            ProfileError,
            "wheel_separation_m is missing, which all but a log of one speed needs; allowed: the effective distance",
        ),
        (
            _edit("ccw.csv", lambda s: s.replace("gyro_dps", "yaw", 1)),
            InputError,
            "column gyro_dps is missing",
        ),
        (
            _edit(
                "ccw.csv", lambda s: s.replace("left_m", "left_ticks", 1).replace("right_m", "right_ticks", 1)
            ),
            DataError,
            "the encoders move",
        ),
        (lambda folder: (folder / "ccw.csv").unlink(), InputError, "no such file"),
        (_occupied, OutputError, "exists and is not empty; nothing was overwritten."),
    ],
)
def test_bad_input_ends_in_one_sentence(
    folder: Path,
    spoil: Callable[[Path], None],
    code: type[Any],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    spoil(folder)
    before = sorted((folder / "out").rglob("*"))
    assert run(folder, *ALL) == EXIT_CODES[code]
    assert message in capsys.readouterr().err
    assert sorted((folder / "out").rglob("*")) == before


def test_two_logs_of_one_name_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "more").mkdir()
    (folder / "more" / "cw.csv").write_text((folder / "cw.csv").read_text())
    assert run(folder, "@cw.csv", "@more/cw.csv", *ALL[2:]) == EXIT_CODES[InputError]
    assert "another log is called 'cw' too" in capsys.readouterr().err


def test_a_foreign_log_by_its_mapping(folder: Path, quick: None) -> None:
    log = drive()
    left, right = (np.cumsum(np.round(side / 2.6e-5)) for side in (log.left_m, log.right_m))
    rows = zip(1e3 * log.t_s, left, -right, -np.radians(log.gyro_dps), strict=True)
    lines = ["ms,l,r,w,note", *(f"{t:.1f},{a:.0f},{b:.0f},{w:.9f},ok" for t, a, b, w in rows)]
    (folder / "foreign.csv").write_text("\n".join(lines))
    (folder / "map.toml").write_text(
        '[columns.t_s]\nfrom = "ms"\nunit = "ms"\n'
        '[columns.left_m]\nfrom = "l"\nunit = "ticks_total"\n'
        '[columns.right_m]\nfrom = "r"\nunit = "ticks_total"\nsign = -1\n'
        '[columns.gyro_dps]\nfrom = "w"\nunit = "rad/s"\nsign = -1\n'
    )
    options = ("--robot", "@robot.toml", "--returns", "--out")
    assert run(folder, "@foreign.csv", *options, "@a", "--columns", "@map.toml") == 0
    assert run(folder, "@ccw.csv", *options, "@b") == 0
    table = [json.loads((folder / d / "summary.json").read_text())["table"]["rows"][0] for d in "ab"]
    assert table[0]["uncalibrated"] == pytest.approx(table[1]["uncalibrated"], abs=0.1)


def test_topic_needs_a_purpose(folder: Path) -> None:
    assert run(folder, *ALL, "--topic", "odom") == 2


@pytest.mark.skipif(not SHARED.exists(), reason="../shared is absent")
def test_the_real_drive(folder: Path, quick: None) -> None:
    data = SHARED / "data"
    arguments = (str(data / "skid_steer_drive.csv"), "--robot", str(data / "skid_steer_robot.toml"))
    assert run(folder, *arguments, "--coefficients", "@c.json", "--out", "@out") == 0
    summary = json.loads((folder / "out" / "summary.json").read_text())
    (log,) = summary["logs"]
    assert set(log["conditions"]) == {"uncalibrated", "uncalibrated_filter"}
    remarks = " ".join(summary["remarks"])
    assert "the log has no gyro temperature, so the calibration cannot be used" in remarks
    assert "static_s = 0" in remarks
    assert "defaults stand for" in remarks
    # The reference is the GPS itself: 0.9 m a fix cannot be beaten, and gyro alone stays within 2 % of 359 m.
    error = log["conditions"]["uncalibrated"]["position_error_m"]
    assert 0.9 < error["rms"] < 0.02 * 359.0
    assert error["truth_rows"] == 989
    # The encoders come later than the gyro: proven to many standard deviations.
    assert log["yaw"]["delay_s"] > 10 * log["yaw"]["delay_sigma_s"]


@pytest.mark.slow
def test_a_full_disk_leaves_nothing_and_the_second_try_works(
    folder: Path, quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.iterdir())
    written = 0

    def fsync(_: int) -> None:
        nonlocal written
        written += 1
        if written == 3:
            raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gyrocal.records.files.os.fsync", fsync)
        assert run(folder, *ALL) == EXIT_CODES[OutputError]
    assert "the disk is full; nothing was left half-written" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before
    assert run(folder, *ALL) == 0


@pytest.mark.slow
def test_names_of_logs_are_no_formulas(folder: Path) -> None:
    (folder / "cw.csv").rename(folder / "$b_$.csv")
    assert run(folder, "@$b_$.csv", "@ccw.csv", "--robot", "@robot.toml", "--out", "@out") == 0


def test_options_of_other_kinds_of_log_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("@cw.csv", "--robot", "@robot.toml", "--out", "@out")
    assert run(folder, *words, "--axis", "y") == EXIT_CODES[InputError]
    assert "is no ROS bag; --topic and --axis are for those." in capsys.readouterr().err
    (folder / "a.bag").write_bytes(b"")
    assert run(folder, "@a.bag", *words[1:], "--columns", "@map.toml") == EXIT_CODES[InputError]
    assert "is a bag, and --columns is for CSV." in capsys.readouterr().err


def test_a_vehicle_with_one_speed_goes_by_its_gyro(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = drive()
    way_m = 0.5 * (log.left_m + log.right_m)
    car = replace(log, left_m=way_m, right_m=way_m, speed_only=True)
    (folder / "car.csv").write_text(format_drive_log(car))
    # Nothing in it tells of a track.
    bare = folder / "robot.toml"
    bare.write_text(bare.read_text().replace("wheel_separation_m = 0.6\n", "", 1))
    assert run(folder, "@car.csv", "--robot", "@robot.toml", "-c", "@c.json", "--out", "@out") == 0
    assert "the log has one speed and no sides" in capsys.readouterr().out
    (found,) = json.loads((folder / "out" / "summary.json").read_text())["logs"]
    assert set(found["conditions"]) == {"uncalibrated", "calibrated"}
    assert found["yaw"] is None
    bare.write_text("wheel_separation_m = 0.6\n" + bare.read_text())
    without_figures(monkeypatch)
    assert run(folder, "@ccw.csv", "--robot", "@robot.toml", "-c", "@c.json", "--out", "@two") == 0
    (sides,) = json.loads((folder / "two" / "summary.json").read_text())["logs"]
    one, two = (f["conditions"]["calibrated"]["position_error_m"]["end"] for f in (found, sides))
    # The same way along the same headings.
    assert one == pytest.approx(two, abs=0.02)
