"""The fit command: output, files, exit codes; every refusal is one sentence with a remedy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gyrocal.cli import main
from gyrocal.fusion.coefficients import FLAG_TEMPERATURE, load_coefficients
from tests.calibration.runs import parts_of, write_run
from tests.calibration.simulation import SURFACE, simulate


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(1)
    rate, temp = (a.ravel() for a in np.meshgrid(np.linspace(-100, 100, 9), [0.0, 20.0, 40.0]))
    temp = temp + rng.normal(0, 0.2, temp.size)
    gyro = SURFACE.output_dps(rate, temp) + rng.normal(0, 1e-3, rate.size)
    path = tmp_path_factory.mktemp("fit") / "sets.csv"
    rows = [f"{r:.4f},{g * -1000:.5f},{t:.4f}" for r, g, t in zip(rate, gyro, temp, strict=True)]
    path.write_text("\n".join(["rate_dps,gyro_counts,temp_c", *rows]) + "\n")
    return path


def call(*arguments: object) -> int:
    """Exit code of `gyrocal fit`."""
    try:
        main(["fit", *map(str, arguments)])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_fit_of_a_table(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "c.json"
    assert call(table, "-o", output, "--counts-per-dps", -1000) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{output}: error ")
    assert "times smaller" in lines[0]
    assert "structure in the residual" in lines[0]
    text = "\n".join(lines)
    for title in (
        "term",
        "Figures (named after IEEE 952)",
        "whole temperatures",
        "whole rates",
        "- no outliers.",
    ):
        assert title in text
    coefficients = load_coefficients(output)
    assert coefficients.correct(50.0, 20.0) == pytest.approx(50.0 - SURFACE.error_dps(50.0, 20.0), abs=5e-3)
    assert coefficients.provenance["counts_per_dps"] == -1000


def test_the_recording_is_never_written_over(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before: --overwrite put the coefficients in its place, or into the run that they are of."""
    path, before = tmp_path / "sets.csv", table.read_bytes()
    path.write_bytes(before)
    (tmp_path / "link.csv").symlink_to(path)
    for output in (path, tmp_path / "link.csv"):
        assert call(path, "-o", output, "--counts-per-dps", -1000, "--overwrite") == 7
    assert path.read_bytes() == before
    run = write_run(tmp_path / "run", parts_of(simulate(np.random.default_rng(1)), np.random.default_rng(2)))
    kept = {file: file.read_bytes() for file in run.rglob("*") if file.is_file()}
    for inside in [*kept, run / "data" / "coefficients.json"]:
        assert call(run, "-o", inside, "--overwrite") == 7
    assert {file: file.read_bytes() for file in run.rglob("*") if file.is_file()} == kept
    assert "is an input of this command, or lies in it" in capsys.readouterr().err


def test_an_outlier_does_not_widen_what_is_valid(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before: one temperature misread as 85 °C made 60 °C valid, where no band of the file holds."""
    head, *rows = table.read_text().split()
    rate, counts, _ = rows[2].split(",")
    rows[2] = f"{rate},{counts},85.0"
    path = tmp_path / "misread.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    for arguments, noted in (((), True), (("--exclude", 3), False)):
        capsys.readouterr()
        assert (
            call(path, "-o", tmp_path / "c.json", "--counts-per-dps", -1000, "--overwrite", *arguments) == 0
        )
        coefficients = load_coefficients(tmp_path / "c.json")
        assert coefficients.valid.temp_c[1] < 41.0
        assert coefficients.flags(0.0, 60.0) == FLAG_TEMPERATURE
        said = capsys.readouterr().out
        assert ("outliers are not counted in the valid range" in said) == noted


@pytest.mark.parametrize("turned", [[3], [2, 7, 9, 15, 20, 24]])
def test_rows_of_another_sign_are_told_with_what_to_leave_out(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], turned: list[int]
) -> None:
    """Before: an error "0.9 times smaller", and outliers at most, which many hide."""
    head, *rows = table.read_text().split()
    for number in turned:
        rate, counts, temp = rows[number - 1].split(",")
        rows[number - 1] = f"{rate},{-float(counts)},{temp}"
    path = tmp_path / "turned.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    assert call(path, "-o", tmp_path / "c.json", "--counts-per-dps", -1000) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert "times larger" in line
    assert f"Do not use it: {len(turned)} of 27 data sets" in line
    assert f"--exclude {','.join(map(str, turned))}." in line
    left_out = ("--exclude", ",".join(map(str, turned)))
    assert call(path, "-o", tmp_path / "d.json", "--counts-per-dps", -1000, *left_out) == 0
    assert "Do not" not in capsys.readouterr().out


def test_a_figure_without_a_number_is_told_with_its_reason_and_not_in_the_table(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(table, "-o", tmp_path / "c.json", "--counts-per-dps", -1000) == 0
    (line,) = (x for x in capsys.readouterr().out.splitlines() if "angle random walk" in x)
    assert line.startswith("- no number for")


def test_fit_of_a_run_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sets = simulate(np.random.default_rng(2), rates=np.linspace(-100, 100, 7))
    run = write_run(tmp_path / "run", parts_of(sets, np.random.default_rng(3)))
    assert (
        call(
            run,
            "-o",
            tmp_path / "c.json",
            "--json",
            "--weights",
            "ols",
            "--exclude",
            "3,9",
            "--exclude",
            "12",
        )
        == 0
    )
    data = json.loads(capsys.readouterr().out)
    assert data["provenance"]["excluded_by_user"] == [3, 9, 12]
    assert data["provenance"]["weights"] == "ols"
    assert data["structured_in"] == []
    assert data["factor"] > 50


def test_bias_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rest.csv"
    t = np.linspace(-10, 50, 40)
    noise = np.random.default_rng(4).normal(0, 1e-3, 40)
    rows = [f"0,{g:.6f},{c:.3f}" for g, c in zip(SURFACE.error_dps(0.0, t) + noise, t, strict=True)]
    path.write_text("\n".join(["rate_dps,gyro_dps,temp_c", *rows]) + "\n")
    assert call(path, "-o", tmp_path / "a.json") == 4
    assert "--bias-only" in capsys.readouterr().err
    assert call(path, "-o", tmp_path / "a.json", "--bias-only") == 0
    assert "bias over temperature" in capsys.readouterr().out


def test_existing_output_is_kept_unless_told(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "c.json"
    output.write_text("mine")
    assert call(table, "-o", output, "--counts-per-dps", -1000) == 7
    assert "nothing was overwritten" in capsys.readouterr().err
    assert output.read_text() == "mine"
    assert call(table, "-o", output, "--counts-per-dps", -1000, "--overwrite") == 0
    assert load_coefficients(output)
    assert call(table, "-o", tmp_path, "--counts-per-dps", -1000) == 7
    assert "is a directory" in capsys.readouterr().err


HEADER = "rate_dps,gyro_dps,temp_c"
GOOD = [f"{r},{r + 0.1},{t}.5" for t in (0, 20, 40) for r in range(-100, 101, 25)]


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        (None, 3, "no such file"),
        (b"", 3, "is empty"),
        (b"\x00\x01\x02\xff\xfe" * 40, 3, "is not a text file"),
        (HEADER.encode() + b"\n", 3, "no rows"),
        ("\n".join([HEADER, *GOOD, "10,10.1"]).encode(), 3, "2 cells where the header has 3"),
        (
            "\n".join([HEADER, *GOOD, "10,10.1,20,7"]).encode(),
            3,
            "4 cells where the header has 3. Its numbers may have decimal commas",
        ),
        ("\n".join([HEADER, *GOOD, "10,nan,20"]).encode(), 3, "line 29: gyro_dps is empty or not finite"),
        ("\n".join([HEADER, *GOOD, "10,inf,20"]).encode(), 3, "line 29: gyro_dps is empty or not finite"),
        ("\n".join([HEADER, *GOOD, "10,ten,20"]).encode(), 3, "line 29: gyro_dps is 'ten', not a number"),
        ("\n".join([HEADER, *GOOD, "10,,20"]).encode(), 3, "line 29: gyro_dps is empty"),
        ("\n".join(["rate_rad_s,gyro_dps,temp_c", *GOOD]).encode(), 3, "column rate_dps is missing"),
        ("\n".join(["rate_dps,gyro_dps,temp_f", *GOOD]).encode(), 3, "column temp_c is missing"),
        ("\n".join(["rate_dps,gyro_dps,temp_c,note", "0,0,0,0"]).encode(), 3, "unknown column 'note'"),
        (b"rate_dps,gyro_dps,temp_c,t_s\n0,0,20,5\n0,0,20,4\n", 3, "line 3: time goes backwards"),
        ("\n".join([HEADER, *(row for row in GOOD if row[0] != "-")]).encode(), 4, "one sign only"),
        (
            "\n".join(
                [HEADER, *(row.replace("20.5", "0.5").replace("40.5", "0.5") for row in GOOD)]
            ).encode(),
            4,
            "one temperature",
        ),
    ],
)
def test_bad_tables(
    content: bytes | None, code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "sets.csv"
    if content is not None:
        path.write_bytes(content)
    assert call(path, "-o", tmp_path / "c.json") == code
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.startswith("gyrocal: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert sorted(p.name for p in tmp_path.iterdir()) == (["sets.csv"] if content is not None else [])


def test_unfinished_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sets.csv.part"
    path.write_text("\n".join([HEADER, *GOOD]))
    assert call(path, "-o", tmp_path / "c.json") == 3
    assert "still being written" in capsys.readouterr().err


def test_counts_need_their_scale_and_deg_s_do_not(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(table, "-o", tmp_path / "c.json") == 3
    assert "give the nominal scale with --counts-per-dps" in capsys.readouterr().err
    path = tmp_path / "sets.csv"
    path.write_text("\n".join([HEADER, *GOOD]))
    assert call(path, "-o", tmp_path / "c.json", "--counts-per-dps", 10) == 3
    assert "in deg/s already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("damage", "code", "message"),
    [
        ("run.json missing", 3, "is a directory without run.json, so it is no run of the bench"),
        ("wrong schema", 3, "schema is 'gyrocal-run/9'"),
        ("not json", 3, "is not JSON"),
        ("journal torn in the middle", 3, "journal.jsonl, line 1"),
        ("segment edited", 3, "differs from what the journal sealed"),
        ("no segments", 4, "holds no usable data set"),
    ],
)
def test_bad_runs(
    damage: str, code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sets = simulate(
        np.random.default_rng(5), rates=np.linspace(-50, 50, 5), temps=np.array([0.0, 20.0, 40.0])
    )
    run = write_run(tmp_path / "run", parts_of(sets, np.random.default_rng(6), 10))
    journal = run / "journal.jsonl"
    if damage == "run.json missing":
        (run / "run.json").unlink()
    elif damage == "wrong schema":
        (run / "run.json").write_text(
            (run / "run.json").read_text().replace("gyrocal-run/1", "gyrocal-run/9")
        )
    elif damage == "not json":
        (run / "run.json").write_text('{"schema": "gyrocal-run/1", ')
    elif damage == "journal torn in the middle":
        journal.write_text("{" + journal.read_text())
    elif damage == "segment edited":
        segment = sorted((run / "data").iterdir())[0]
        segment.write_text(segment.read_text().replace("12.0", "12.1", 1))
    else:
        journal.write_text("")
    assert call(run, "-o", tmp_path / "c.json") == code
    assert message in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()


def test_exclude_wants_numbers(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(table, "-o", tmp_path / "c.json", "--exclude", "first") == 2
    for scale in ("0", "nan", "inf"):
        assert call(table, "-o", tmp_path / "c.json", "--counts-per-dps", scale) == 2
    assert "give numbers of data sets" in capsys.readouterr().err


def test_output_in_a_missing_directory(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(table, "-o", tmp_path / "no" / "c.json", "--counts-per-dps", -1000) == 7
    assert "cannot write" in capsys.readouterr().err


def test_two_random_walks_of_one_run_are_told_apart(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(__file__).parents[2] / "sample_data" / "run"
    for recording, said in ((run, True), (table, False)):
        counts = () if said else ("--counts-per-dps", -1000)
        assert call(recording, "-o", tmp_path / f"{said}.json", *counts) == 0
        assert (
            "rate random walk among the figures is what the samples at rest" in capsys.readouterr().out
        ) is said
