"""``gyrocal demo``: the whole main job, start to end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gyrocal.cli import main
from gyrocal.fusion import load_coefficients


@pytest.mark.slow
def test_demo_does_the_whole_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "demo"
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--out", str(out), "--seed", "3", "--json"])
    assert ended.value.code == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    result = json.loads(captured.out)
    for name in (
        "run/run.json",
        "coefficients.json",
        "report/report.html",
        "replay/replay.html",
        "drives/robot.toml",
    ):
        assert (out / name).is_file(), name
    assert load_coefficients(out / "coefficients.json").sensor["serial"] == "virtual-1"
    # The surface is known: the fit must be off it by what its own uncertainty says. A ratio of 2 has a chance
    # below 1e-6 for twelve degrees of freedom (chi-square above 48).
    truth = result["truth"]
    assert truth["rms_dps"] < 2 * truth["expected_rms_dps"]
    assert result["report"]["error_after_rms_dps"] < result["report"]["error_before_rms_dps"] / 10


def test_demo_does_not_overwrite(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--out", str(tmp_path)])
    assert ended.value.code == 7
    assert "nothing was overwritten" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
