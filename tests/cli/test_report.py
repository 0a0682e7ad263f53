"""``gyrocal report`` from the command line: what it writes, what it says, what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.datasets import load_recording
from gyrocal.cli import main
from gyrocal.fusion import load_coefficients

SAMPLE = Path(__file__).parents[2] / "sample_data"
RUN, TABLE, COEFFICIENTS = SAMPLE / "run", SAMPLE / "data_sets.csv", SAMPLE / "coefficients.json"
FIGURES = {
    "figure_1",
    "figure_2",
    "figure_3a",
    "figure_3b",
    "residual_map",
    "residual_over_time",
    "scatter_by_rate",
    "allan_deviation",
    "timeline",
    "coefficients",
}


def report(*arguments: object) -> int:
    """Exit code of ``gyrocal report``."""
    with pytest.raises(SystemExit) as ended:
        main(["report", *map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report on the sample run."""
    out = tmp_path_factory.mktemp("report") / "out"
    assert report(RUN, "--coefficients", COEFFICIENTS, "--out", out) == 0
    return out


def test_every_figure_twice_and_one_page(written: Path) -> None:
    assert {p.stem for p in (written / "figures").glob("*.png")} == FIGURES
    assert {p.stem for p in (written / "figures").glob("*.svg")} == FIGURES
    page = (written / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert "KVH E-Core RD2100 virtual-1" in page


def test_each_error_before_says_what_it_is_about(written: Path) -> None:
    page = (written / "report.html").read_text(encoding="utf-8")
    assert "deg/h rms about the best scale factor and bias to " in page
    assert "Error before, rms about the best scale factor and bias<" in page
    assert page.count("rms as measured, deg/h") == 2
    assert "rms before" not in page
    note = (
        "As measured: nothing is taken off. The error before at the top of the page is about the best scale"
    )
    assert page.count(note) == 2


def test_tables_hold_all_data_sets(written: Path) -> None:
    sets = load_recording(RUN).sets
    assert (written / "tables/data_sets.csv").read_bytes() == TABLE.read_bytes()
    residuals = np.genfromtxt(written / "tables/residuals.csv", delimiter=",", names=True)
    assert residuals.size == len(sets)
    correct = load_coefficients(COEFFICIENTS).correct(sets.gyro_dps, sets.temp_c)
    np.testing.assert_allclose(residuals["residual_dps"], correct - sets.rate_dps, atol=1e-12)
    for name in (
        "coefficients",
        "merit",
        "noise",
        "outliers",
        "error_by_rate",
        "error_by_temperature",
        "allan_deviation",
    ):
        assert (written / f"tables/{name}.csv").read_text().count("\n") >= 1


def test_an_existing_report_is_refused(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (written / "report.html").read_bytes()
    assert report(RUN, "--coefficients", COEFFICIENTS, "--out", written) == 7
    assert "exists and is not empty; nothing was overwritten" in capsys.readouterr().err
    assert (written / "report.html").read_bytes() == before


@pytest.mark.slow
def test_a_table_says_what_it_cannot_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "bare.csv"
    rows = [line.split(",")[:3] for line in TABLE.read_text().splitlines()]
    table.write_text("\n".join(",".join(row) for row in rows) + "\n")
    assert report(table, "--coefficients", COEFFICIENTS, "--out", tmp_path / "out", "--json") == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert captured.err == ""
    assert set(result["figures"]) == FIGURES - {"allan_deviation", "timeline"}
    assert (
        result["not_drawn"]["timeline"]
        == "The recording is a table of data sets: it holds no course in time."
    )
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "it holds no course in time" in page
    assert result["error_before_rms_dps"] > 100 * result["error_after_rms_dps"]


def test_coefficients_of_another_gyro_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.json"
    coefficients = load_coefficients(COEFFICIENTS)
    sensor = dict(coefficients.sensor) | {"serial": "other-7"}
    other.write_text(replace(coefficients, sensor=sensor).to_text())
    assert report(RUN, "--coefficients", other, "--out", tmp_path / "out") == 6
    error = capsys.readouterr().err
    assert "other-7" in error
    assert "virtual-1" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("recording", "coefficients", "code", "text"),
    [
        ("nothing", "sample", 3, "no such file or directory. Check the path."),
        ("sample", "nothing", 3, "cannot be read (No such file or directory). Check the path."),
        ("sample", "edited", 6, "its sha256 does not fit its contents; the file was edited."),
    ],
)
def test_bad_input(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    recording: str,
    coefficients: str,
    code: int,
    text: str,
) -> None:
    edited = tmp_path / "edited.json"
    edited.write_text(COEFFICIENTS.read_text().replace('"software"', '"softwarE"', 1))
    paths = {"nothing": tmp_path / "nothing.csv", "edited": edited}
    out = tmp_path / "out"
    arguments = (paths.get(recording, TABLE), "--coefficients", paths.get(coefficients, COEFFICIENTS))
    assert report(*arguments, "--out", out) == code
    assert text in capsys.readouterr().err.splitlines()[-1]
    assert not out.exists()


@pytest.mark.slow
def test_the_same_input_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert report(RUN, "--coefficients", COEFFICIENTS, "--out", again) == 0
    for path in sorted(p for p in written.rglob("*") if p.is_file()):
        assert (again / path.relative_to(written)).read_bytes() == path.read_bytes(), path.name


@pytest.mark.slow
def test_the_real_table_shows_what_is_odd_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = Path(__file__).parents[2].parent / "shared/data/fog_rate_table_aug2024.csv"
    if not table.exists():
        pytest.skip("../shared is absent")
    scale = ("--counts-per-dps", "-27312.6")
    fog = tmp_path / "fog.json"
    with pytest.raises(SystemExit):
        main(["fit", str(table), *scale, "-o", str(fog)])
    capsys.readouterr()
    assert report(table, *scale, "--coefficients", fog, "--out", tmp_path / "out", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["error_before_rms_dps"] * 3600 == pytest.approx(1922, abs=1)
    said = " ".join(result["remarks"])
    assert "grows with |rate|" in said
    assert "±97.2 deg/s scatter" in said
