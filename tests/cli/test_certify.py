"""`gyrocal certify` and `gyrocal compare` as a user runs them; the page in a browser and on paper."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gyrocal.cli import gyrocal_command, main
from gyrocal.errors import DataError
from gyrocal.records.run import runs_in
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.test_fleet import write_table
from tests.report.browser import look, needs_chromium, needs_pdftotext, printed_words

SAMPLE = Path(__file__).parents[2] / "sample_data"


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unit")
    limits = folder / "limits.toml"
    limits.write_text("bias_instability = { most = 100.0 }\n[angle_random_walk]\nmost = 0.2\n")
    words = ["certify", str(SAMPLE / "run"), "--out", str(folder / "out"), "--limits", str(limits), "--pdf"]
    done = CliRunner().invoke(gyrocal_command, words)
    assert done.exit_code == 0, done.output
    assert done.output.startswith("certify: 0%") or "PASS: all 2 limits" in done.output
    return folder / "out"


def test_it_holds_all(certificate: Path) -> None:
    data = json.loads((certificate / "certificate.json").read_text())
    assert data["simulated"] is True
    assert data["identity"]["Serial number"] == "virtual-1"
    assert data["figures"]["angle_random_walk"]["judgement"] == "pass"
    for name, entry in data["figures"].items():
        for figure in filter(None, (entry["before"], entry["after"])):
            assert (figure["value"] is None) == bool(figure["reason"]), name
    page = (certificate / "certificate.html").read_text()
    assert "SIMULATED" in page
    assert 'class="verdict good"' in page
    assert (certificate / "certificate.pdf").read_bytes().startswith(b"%PDF")


@needs_chromium
@pytest.mark.parametrize("width_px", [360, 1400])
def test_it_fits_the_screen(certificate: Path, width_px: int, tmp_path: Path) -> None:
    seen = look(certificate / "certificate.html", width_px, tmp_path)
    assert seen.wide_px <= seen.given_px
    assert seen.console == ""


@needs_chromium
def test_its_figures_need_no_scrolling_on_a_wide_screen(certificate: Path, tmp_path: Path) -> None:
    page = (certificate / "certificate.html").read_text(encoding="utf-8")
    assert '<td class="words toned good">pass</td>' in page
    path = tmp_path / "page.html"
    # A table that scrolls is made one that runs over.
    path.write_text(page.replace("overflow-x: auto;", ""), encoding="utf-8")
    seen = look(path, 1400, tmp_path)
    assert seen.wide_px <= seen.given_px


@needs_chromium
@needs_pdftotext
def test_it_prints_whole(certificate: Path, tmp_path: Path) -> None:
    words, outside = printed_words(certificate / "certificate.html", tmp_path)
    assert outside == 0
    assert {"figure", "before", "after", "unit", "limit", "definition", "sample"} <= set(words)


@needs_pdftotext
def test_every_sheet_says_of_what_it_is_and_that_it_was_simulated(certificate: Path) -> None:
    command = ["pdftotext", "-layout", str(certificate / "certificate.pdf"), "-"]
    *sheets, _ = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\f")
    assert len(sheets) > 1
    for number, sheet in enumerate(sheets, start=1):
        assert "SIMULATED: NOTHING WAS MEASURED" in sheet
        assert "serial number virtual-1" in sheet
        assert f"{number} of {len(sheets)}" in sheet


def test_a_unit_beyond_its_limits_has_an_exit_code_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text("scale_factor_nonlinearity_rms = { most = 1.0 }\n")
    table = write_table(tmp_path / "unit.csv", 1)
    with pytest.raises(SystemExit) as ended:
        main(["certify", str(table), "--out", str(tmp_path / "out"), "--limits", str(limits)])
    assert ended.value.code == 13
    said = capsys.readouterr()
    assert "FAIL: beyond the limit with all of its uncertainty: scale factor nonlinearity rms" in said.out
    assert "the unit is beyond its limits" in said.err
    assert (tmp_path / "out/certificate.html").exists()


def test_compare(tmp_path: Path) -> None:
    tables = [str(write_table(tmp_path / f"run{k}.csv", k)) for k in (1, 2)]
    done = CliRunner().invoke(gyrocal_command, ["compare", *tables])
    assert done.exit_code == 0, done.output
    assert "Nothing changed from the first run to the last by more than noise" in done.output
    data = json.loads(CliRunner().invoke(gyrocal_command, ["compare", *tables, "--json"]).output)
    assert data["runs"] == ["run1.csv", "run2.csv"]
    assert data["figures"]["bias"]["changed"] is False


@pytest.mark.parametrize(
    ("command", "serials", "said"),
    [
        (["compare"], ("a", "b"), r"of several units \(a, b\): a comparison is of one"),
        (["certify", "--out", "out"], ("a", "b"), r"of several units \(a, b\): a certificate is of one"),
        (["certify", "--out", "out"], (None, "b"), r"of several units \(no serial number, b\)"),
    ],
)
def test_runs_of_two_units_are_refused_before_any_is_fitted(
    command: list[str], serials: tuple[str | None, ...], said: str, tmp_path: Path
) -> None:
    """Of three samples each, of which nothing can be said."""
    paths = []
    for name, serial in zip("xy", serials, strict=True):
        rows = [gyro_row(0.1 * k, f"{0.1 * k}") for k in range(3)]
        head = {"sensor": {"model": "RD2100"} | ({"serial": serial} if serial else {})}
        paths.append(str(write_run(tmp_path / name, [Part(rows, kind="static", averaging_s=None)], head)))
    first, *options = command
    done = CliRunner().invoke(
        gyrocal_command, [first, *paths, *(str(tmp_path / o) if o == "out" else o for o in options)]
    )
    assert isinstance(done.exception, DataError)
    assert re.search(said, str(done.exception))


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The directory of a unit with two runs, of which b was made first."""
    for name, day in (("b", "2026-01-01T00:00:00Z"), ("a", "2026-01-02T00:00:00Z")):
        shutil.copytree(SAMPLE / "run", tmp_path / "unit" / name)
        head = tmp_path / "unit" / name / "run.json"
        head.write_text(head.read_text().replace("2000-01-01T00:00:00Z", day))
    return tmp_path / "unit"


def test_the_runs_of_a_unit_are_in_the_order_in_which_they_were_made(unit: Path) -> None:
    assert [run.name for run in runs_in(unit)] == ["b", "a"]
    assert runs_in(unit / "a") == [unit / "a"]


@pytest.mark.slow
def test_the_directory_of_a_unit_stands_for_its_runs(unit: Path, tmp_path: Path) -> None:
    words = ["certify", str(unit), "--out", str(tmp_path / "out"), "--json"]
    done = CliRunner().invoke(gyrocal_command, words)
    assert done.exit_code == 0, done.output
    names = [name for name in json.loads(done.stdout)["provenance"] if name.endswith(", sha256")]
    assert names == ["b, sha256", "a, sha256"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scatter_dps", "least", "most"),
    [
        pytest.param(4e-3, set(), set(), id="as before"),
        pytest.param(8e-3, {"angle_random_walk"}, {"angle_random_walk", "allan_floor"}, id="twice"),
    ],
)
def test_runs_at_rest_are_compared_by_their_noise(
    tmp_path: Path, scatter_dps: float, least: set[str], most: set[str]
) -> None:
    """Twice the noise is a change of it, and of the lowest deviation at the most."""
    rng = np.random.default_rng(8)
    for name, scatter in (("a", 4e-3), ("b", scatter_dps)):
        gyro = rng.normal(0.0, scatter, 12_000)
        rows = [gyro_row(0.1 * k + 0.05, f"{x:.6f}") for k, x in enumerate(gyro)]
        write_run(tmp_path / name, [Part(rows, kind="static", averaging_s=None)])

    done = CliRunner().invoke(
        gyrocal_command, ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]
    )
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)["figures"]
    assert least <= {name for name, entry in figures.items() if entry["changed"]} <= most


@pytest.mark.slow
def test_a_run_at_rest_is_not_compared_with_one_that_turns(tmp_path: Path) -> None:
    gyro = np.random.default_rng(8).normal(0.0, 4e-3, 2000)
    rows = [gyro_row(0.1 * k + 0.05, f"{x:.6f}") for k, x in enumerate(gyro)]
    write_run(tmp_path / "a", [Part(rows, kind="static", averaging_s=None)])
    mixed = CliRunner().invoke(gyrocal_command, ["compare", str(tmp_path / "a"), str(SAMPLE / "run")])
    assert isinstance(mixed.exception, DataError)
    assert "carries no surface" in str(mixed.exception)
