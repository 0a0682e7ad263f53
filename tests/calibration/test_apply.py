"""`gyrocal apply`: numbers, flags, refusals, and nothing half-written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from gyrocal.calibration import apply
from gyrocal.calibration.apply import COLUMNS, ApplyConfig, apply_recording, hold
from gyrocal.calibration.calibrate import FitConfig, calibrate
from gyrocal.calibration.provenance import check_sensor
from gyrocal.cli import gyrocal_command
from gyrocal.errors import CoefficientError, DataError, GyrocalError, InputError, OutputError
from gyrocal.fusion import Coefficients, Compensator, Term, Valid
from gyrocal.physics.surface import Surface

SURFACE = Surface(
    np.array([[0.05, -0.02, 0.01], [0.4, 0.3, -0.1], [0.02, 0.01, 0.0], [-0.3, 0.05, 0.02]]), 0, 100, 20, 30
)
LAG = Term(
    "thermal_lag",
    {
        "amplitude": {"value": 0.5, "std": 0.05, "unit": "1"},
        "tau_s": {"value": 20.0, "std": 1.0, "unit": "s"},
    },
    True,
)
WARM = Term("warm_up", {"amplitude": {"value": 10.0, "std": 1.0, "unit": "mdeg/s"}}, True)
SUPPLY = Term("supply_voltage", {"amplitude": {"value": 1000.0}, "nominal_v": {"value": 11.5}}, True)
BENCH = Term("table_eccentricity", {"amplitude": {"value": 3.0, "std": 1.0, "unit": "arcsec"}}, False)


def quiet(share: float, what: str) -> None:
    """Take a report of progress and say nothing."""


def write_coefficients(path: Path, *terms: Term, **sensor: str) -> Coefficients:
    c = Coefficients(
        sensor or {"model": "RD2100", "serial": "7"},
        SURFACE,
        1e-8 * np.eye(12),
        Valid((-100, 100), (-10, 50)),
        terms=terms,
    )
    path.write_text(c.to_text(), encoding="utf-8")
    return c


SEGMENTS = {
    "data/0001_ramp_+000.000dps_+020.0C.csv": (
        "0.1,0.05,20.0,0,,,,\n0.15,,,,0.0,0.0,20.0,12.0\n0.2,0.06,,0,,,,\n0.3,0.07,20.5,1,,,,\n"
    ),
    "data/0002_rate_+120.000dps_+020.0C.csv": "1.1,120.5,21.0,0,,,,\n1.2,,21.0,0,,,,\n1.3,-20.25,,0,,,,\n",
}


def write_run(path: Path, **head: Any) -> Path:
    (path / "data").mkdir(parents=True)
    document = {
        "schema": "gyrocal-run/1",
        "sensor": {"model": "RD2100", "serial": "7"},
        "power_on_t_s": -60.0,
    } | head
    (path / "run.json").write_text(json.dumps(document), encoding="utf-8")
    lines = []
    header = "t_s,gyro_dps,gyro_temp_c,status,table_rate_dps,table_angle_deg,chamber_temp_c,supply_v\n"
    for number, (name, rows) in enumerate(SEGMENTS.items(), start=1):
        (path / name).write_text(header + rows, encoding="utf-8")
        digest = hashlib.sha256((header + rows).encode()).hexdigest()
        lines.append(
            {"event": "segment", "id": number, "kind": "rate", "rate_dps": 0.0, "chamber_c": 20.0, "t_start_s": number,
             "t_end_s": number + 1.0, "n": 3, "outcome": "ok", "file": name, "sha256": digest}
        )  # fmt: skip
    (path / "journal.jsonl").write_text("".join(json.dumps(x) + "\n" for x in lines), encoding="utf-8")
    return path


def config(tmp_path: Path, recording: Path, **more: Any) -> ApplyConfig:
    return ApplyConfig(recording, tmp_path / "c.json", tmp_path / "out.csv", **{"overwrite": True, **more})


def test_every_sample_of_a_run(tmp_path: Path) -> None:
    c = write_coefficients(tmp_path / "c.json", LAG, WARM, BENCH)
    applied = apply_recording(config(tmp_path, write_run(tmp_path / "run")), quiet)
    out = pd.read_csv(tmp_path / "out.csv")
    assert tuple(out.columns) == COLUMNS
    t = np.array([0.1, 0.2, 0.3, 1.1, 1.2, 1.3])
    gyro = np.array([0.05, 0.06, 0.07, 120.5, np.nan, -20.25])
    held = np.array([20.0, 20.0, 20.5, 21.0, 21.0, 21.0])
    wanted = Compensator(c).evaluate(t, gyro, held, t + 60.0)
    np.testing.assert_allclose(out["t_s"], t)
    np.testing.assert_allclose(out["gyro_dps"], gyro)
    np.testing.assert_array_equal(out["segment"], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(out["temp_c"].isna(), [0, 1, 0, 0, 0, 1])
    np.testing.assert_allclose(out["corrected_dps"], wanted.rate_dps, atol=1e-9)
    np.testing.assert_allclose(out["sigma_dps"], wanted.sigma_dps, rtol=1e-3)
    np.testing.assert_array_equal(out["flag"], [0, 16, 8, 1, 4, 16])
    assert (applied.rows, applied.flagged_rows, applied.segments) == (6, 5, 2)
    assert applied.flagged == {1: 1, 2: 0, 4: 1, 8: 1, 16: 2, 32: 0}
    assert applied.terms == ("thermal_lag", "warm_up")
    assert applied.not_applied == ("table_eccentricity",)
    assert applied.notes == ()


def test_the_supply_of_a_run_is_that_of_its_last_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    c = write_coefficients(tmp_path / "c.json", SUPPLY)
    run = write_run(tmp_path / "run")
    for rows in (100, 1):
        monkeypatch.setattr(apply, "_CHUNK_ROWS", rows)
        apply_recording(config(tmp_path, run), quiet)
        out = pd.read_csv(tmp_path / "out.csv")
        supply = np.array([np.nan, 12.0, 12.0, 12.0, 12.0, 12.0])
        wanted = Compensator(c).correct(out["t_s"], out["gyro_dps"], 20.0, supply_v=supply)
        surface = Compensator(write_coefficients(tmp_path / "bare.json")).correct(
            out["t_s"], out["gyro_dps"], 20.0
        )
        np.testing.assert_allclose(wanted - surface, [0, -0.5, -0.5, -0.5, np.nan, -0.5], atol=5e-3)
        same_c = np.array([0, 1])
        np.testing.assert_allclose(out["corrected_dps"][same_c], wanted[same_c], atol=1e-9)


def test_blocks_of_any_size_give_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coefficients(tmp_path / "c.json", LAG, WARM)
    run = write_run(tmp_path / "run")
    apply_recording(config(tmp_path, run), quiet)
    whole = (tmp_path / "out.csv").read_bytes()
    monkeypatch.setattr(apply, "_CHUNK_ROWS", 1)
    apply_recording(config(tmp_path, run), quiet)
    assert (tmp_path / "out.csv").read_bytes() == whole


def test_a_table_of_data_sets_in_counts(tmp_path: Path) -> None:
    c = write_coefficients(tmp_path / "c.json", model="unknown")
    table = tmp_path / "table.csv"
    table.write_text("rate_dps,gyro_counts,temp_c\n0,10,20\n50,-5010,60\n", encoding="utf-8")
    applied = apply_recording(config(tmp_path, table, counts_per_dps=-100.0), quiet)
    out = pd.read_csv(tmp_path / "out.csv")
    np.testing.assert_allclose(out["gyro_dps"], [-0.1, 50.1])
    np.testing.assert_allclose(out["corrected_dps"], c.correct([-0.1, 50.1], [20, 60]), atol=1e-9)
    np.testing.assert_array_equal(out["flag"], [0, 2])
    assert out["t_s"].isna().all()
    assert applied.notes == (
        "whether this is the same gyro was not checked by model and serial: not stated in both files",
    )


@pytest.mark.slow
def test_rows_that_were_averaged_are_within_their_own_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a table of 4,000 rows the ends had been those of means of two rows; here 640 are as many."""
    monkeypatch.setattr("gyrocal.calibration.calibrate.MOST_DATA_SETS", 400)
    rng = np.random.default_rng(4)
    rate = np.tile(np.repeat(np.linspace(-100.0, 100.0, 8), 8), 10)
    temp = np.linspace(-20.0, 60.0, rate.size) + 0.2 * rng.standard_normal(rate.size)
    gyro = 1.01 * rate + 0.2 + 3e-3 * temp + 3e-3 * rng.standard_normal(rate.size)
    rows = [f"{w:.3f},{g:.6f},{c:.3f}" for w, g, c in zip(rate, gyro, temp, strict=True)]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["rate_dps,gyro_dps,temp_c", *rows]) + "\n")
    (tmp_path / "c.json").write_text(calibrate(table, FitConfig(paper=True)).coefficients.to_text())
    assert apply_recording(config(tmp_path, table), quiet).flagged_rows == 0
    # Nor is what was left out in it.
    row = int(np.argmax(temp)) + 1
    (tmp_path / "c.json").write_text(
        calibrate(table, FitConfig(paper=True, exclude=(row,))).coefficients.to_text()
    )
    (tmp_path / "out.csv").unlink()
    assert apply_recording(config(tmp_path, table), quiet).flagged_rows == 1


@pytest.mark.parametrize(
    ("output", "why"),
    [
        (lambda rate, temp: np.deg2rad(rate), r"it is in rad/s.*Convert the output, or say --force-sensor"),
        (lambda rate, temp: -rate, "sign"),
        (lambda rate, temp: temp, "does not follow the rate"),
    ],
)
def test_an_output_that_does_not_follow_the_rates_of_its_table(
    tmp_path: Path, output: Callable[[Any, Any], Any], why: str
) -> None:
    write_coefficients(tmp_path / "c.json")
    rate = np.tile([-100.0, -50.0, 0.0, 50.0, 100.0], 6)
    temp = np.repeat([18.0, 20.0, 22.0, 22.0, 20.0, 18.0], 5)
    table = pd.DataFrame({"rate_dps": rate, "gyro_dps": output(rate, temp), "temp_c": temp})
    table.to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(DataError, match=why):
        apply_recording(config(tmp_path, tmp_path / "t.csv"), quiet)
    assert not (tmp_path / "out.csv").exists()
    applied = apply_recording(config(tmp_path, tmp_path / "t.csv", force_sensor=True), quiet)
    assert "(--force-sensor)" in applied.notes[-1]
    assert applied.rows == rate.size


def test_a_table_goes_once_through_terms_that_remember(tmp_path: Path) -> None:
    """To ask whether its columns are what they say, it had gone through the same compensator twice."""
    coefficients = write_coefficients(tmp_path / "c.json", LAG)
    rows = {
        "gyro_dps": [10.0, 20.0, -5.0, 30.0],
        "temp_c": [20.0, 22.0, 24.0, 26.0],
        "t_s": [5.0, 65.0, 125.0, 185.0],
    }
    pd.DataFrame({"rate_dps": rows["gyro_dps"], **rows}).to_csv(tmp_path / "t.csv", index=False)
    apply_recording(config(tmp_path, tmp_path / "t.csv"), quiet)
    t_s, gyro, temp = (np.array(rows[name]) for name in ("t_s", "gyro_dps", "temp_c"))
    expected = Compensator(coefficients).evaluate(t_s, gyro, temp, None, np.full(4, np.nan)).rate_dps
    np.testing.assert_allclose(pd.read_csv(tmp_path / "out.csv")["corrected_dps"], expected, atol=1e-9)


def test_a_clock_in_milliseconds_is_said_where_it_counts(tmp_path: Path) -> None:
    rate = np.tile([-100.0, -50.0, 0.0, 50.0, 100.0], 6)
    rows = {"rate_dps": rate, "gyro_dps": rate, "temp_c": np.linspace(18.0, 22.0, 30)}
    pd.DataFrame(rows | {"t_s": 6e4 * np.arange(30.0)}).to_csv(tmp_path / "t.csv", index=False)
    for term, said in ((LAG, 1), (None, 0)):
        write_coefficients(tmp_path / "c.json", *([term] if term else []))
        applied = apply_recording(config(tmp_path, tmp_path / "t.csv", overwrite=True), quiet)
        assert sum("milliseconds" in note for note in applied.notes) == said


def test_swapped_columns_are_refused(tmp_path: Path) -> None:
    """A gyro's own error is too small for the scale to tell."""
    write_coefficients(tmp_path / "c.json")
    rate = np.tile(np.linspace(-100.0, 100.0, 11), 12)
    gyro = 1.001 * rate + 1e-3 * np.random.default_rng(0).standard_normal(rate.size)
    table = pd.DataFrame({"rate_dps": gyro, "gyro_dps": rate, "temp_c": np.linspace(18.0, 22.0, rate.size)})
    table.to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(DataError, match="seem to be swapped"):
        apply_recording(config(tmp_path, tmp_path / "t.csv"), quiet)


def test_temperatures_in_kelvin_are_refused(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json")
    (tmp_path / "t.csv").write_text("rate_dps,gyro_dps,temp_c\n10,10,290\n-20,-20,295\n")
    with pytest.raises(DataError, match="no gyro works so hot"):
        apply_recording(config(tmp_path, tmp_path / "t.csv"), quiet)


def test_rates_without_noise_are_corrected_like_others(tmp_path: Path) -> None:
    """What a simulation wrote: of no scatter, and of an output that may be the rate."""
    write_coefficients(tmp_path / "c.json")
    (tmp_path / "t.csv").write_text("rate_dps,gyro_dps,temp_c,gyro_std_dps,n\n10,10,20,0,9\n20,20,21,0,9\n")
    apply_recording(ApplyConfig(tmp_path / "t.csv", tmp_path / "c.json", tmp_path / "out.csv"), quiet)
    assert np.isfinite(pd.read_csv(tmp_path / "out.csv")["corrected_dps"]).all()


def test_the_command(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json", WARM, BENCH)
    run = write_run(tmp_path / "run")
    arguments = ["apply", str(run), "--coefficients", str(tmp_path / "c.json"), "-o", str(tmp_path / "o.csv")]
    result = CliRunner().invoke(gyrocal_command, arguments, catch_exceptions=False)
    assert "6 rows of 2 segments corrected; 5 flagged (1 rate outside the valid range" in result.stdout
    assert "Terms of the bench, not applied: table_eccentricity." in result.stdout
    written = (tmp_path / "o.csv").read_bytes()
    (tmp_path / "o.csv").write_bytes(b"mine")
    refused = CliRunner().invoke(gyrocal_command, [*arguments, "--json"])
    assert "exists; nothing was overwritten" in str(refused.exception)
    assert (tmp_path / "o.csv").read_bytes() == b"mine"
    arguments.append("--overwrite")
    result = CliRunner().invoke(gyrocal_command, [*arguments, "--json"], catch_exceptions=False)
    assert (tmp_path / "o.csv").read_bytes() == written
    summary = json.loads(result.stdout)
    assert summary["rows"] == 6
    assert summary["flagged"]["bad status of the gyro"] == 1
    shown = CliRunner().invoke(gyrocal_command, ["apply", "--help"]).stdout
    assert "noise of the sample itself is not in it" in " ".join(shown.split())


@pytest.mark.parametrize(
    "head",
    [
        {"compensated": True},
        {"sensor": {"model": "RD2100", "compensated": "a3f1"}},
        {"software": {"name": "logger", "compensated": "a3f1"}},
    ],
)
def test_compensated_runs_are_refused(tmp_path: Path, head: dict[str, Any]) -> None:
    write_coefficients(tmp_path / "c.json")
    run = write_run(tmp_path / "run", **head)
    with pytest.raises(
        DataError, match=r"run\.json: says that its rates are compensated already.*Use the raw record"
    ):
        apply_recording(config(tmp_path, run), quiet)
    assert not (tmp_path / "out.csv").exists()


def test_coefficients_of_another_gyro(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json", model="RD2100", serial="8")
    run = write_run(tmp_path / "run")
    with pytest.raises(CoefficientError, match=r"serial 7, .* those of serial 8\. Use .* --force-sensor"):
        apply_recording(config(tmp_path, run), quiet)
    applied = apply_recording(config(tmp_path, run, force_sensor=True), quiet)
    assert applied.notes == ("serial differs: recording 7, coefficients 8 (--force-sensor)",)
    with pytest.raises(CoefficientError, match=r"model A, .* model B"):
        check_sensor({"model": "B"}, {"model": "A"}, run)


def test_nothing_is_left_when_the_recording_turns_out_bad(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json")
    run = write_run(tmp_path / "run")
    last = run / list(SEGMENTS)[-1]
    last.write_text(last.read_text(encoding="utf-8") + "1.4,1.0", encoding="utf-8")
    (tmp_path / "out.csv").write_text("before", encoding="utf-8")
    with pytest.raises(InputError, match="differs from what the journal sealed"):
        apply_recording(config(tmp_path, run), quiet)
    assert (tmp_path / "out.csv").read_text(encoding="utf-8") == "before"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json", "out.csv", "run"]


def test_the_recording_is_never_written_into(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json")
    run = write_run(tmp_path / "run")
    before = (run / "run.json").read_bytes()
    for inside in ("run.json", "corrected.csv"):
        with pytest.raises(OutputError, match="is an input of this command, or lies in it"):
            apply_recording(ApplyConfig(run, tmp_path / "c.json", run / inside), quiet)
    assert (run / "run.json").read_bytes() == before


def test_other_refusals(tmp_path: Path) -> None:
    write_coefficients(tmp_path / "c.json", LAG, model="unknown")
    table = tmp_path / "table.csv"
    table.write_text("rate_dps,gyro_dps,temp_c\n0,0.1,20\n", encoding="utf-8")
    with pytest.raises(CoefficientError, match="has no t_s, and thermal_lag"):
        apply_recording(config(tmp_path, table), quiet)
    with pytest.raises(OutputError, match="is an input of this command"):
        apply_recording(ApplyConfig(table, tmp_path / "c.json", table), quiet)
    write_coefficients(tmp_path / "c.json", model="unknown")
    with pytest.raises(OutputError, match=r"nowhere.* cannot write"):
        apply_recording(ApplyConfig(table, tmp_path / "c.json", tmp_path / "nowhere" / "o.csv"), quiet)
    with pytest.raises(GyrocalError, match="counts-per-dps is for tables"):
        apply_recording(config(tmp_path, write_run(tmp_path / "run"), counts_per_dps=3.0), quiet)
    write_coefficients(tmp_path / "c.json", WARM, model="unknown")
    with pytest.raises(CoefficientError, match="has no t_s, and warm_up"):
        apply_recording(config(tmp_path, table), quiet)


def test_hold() -> None:
    held, last = hold(np.array([np.nan, 1.0, np.nan, 2.0, np.nan]), 7.0)
    np.testing.assert_array_equal(held, [7, 1, 1, 2, 2])
    assert last == 2.0
    assert hold(np.array([]), 3.0)[1] == 3.0
