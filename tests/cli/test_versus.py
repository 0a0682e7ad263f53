"""``gyrocal diagnose REAL --simulation SIM``: what to add to somebody's own simulation, end to end."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrocal.cli import gyrocal_command
from gyrocal.errors import GyrocalError
from tests.diagnosis.versus.tables import SURFACE, Floats, plan

ASYMMETRY = 400e-6
NOISE_DPS = 5e-4


def write(path: Path, **columns: Floats) -> Path:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    return path


def diagnose(real: Path, simulated: Path, out: Path, *more: str) -> Result:
    words = ["diagnose", str(real), "--simulation", str(simulated), "--out", str(out), *more]
    return CliRunner().invoke(gyrocal_command, words)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A gyro with another bias and an asymmetry of the scale factor, of which the simulation knows nothing."""
    folder = tmp_path_factory.mktemp("versus")
    t, rate, temp = plan(8)
    noise = np.random.default_rng(2).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    gyro = simulated + 0.02 + ASYMMETRY * np.maximum(rate, 0.0) + noise
    real = write(folder / "real.csv", rate_dps=rate, gyro_dps=gyro, temp_c=temp, t_s=t)
    sim = write(folder / "sim.csv", rate_dps=rate, gyro_dps=simulated, temp_c=temp, t_s=t + 30.0)
    return real, sim


@pytest.fixture(scope="module")
def answered(written: tuple[Path, Path]) -> tuple[Path, Result]:
    """The answer, and where it was written."""
    out = written[0].parent / "out"
    return out, diagnose(*written, out)


@pytest.mark.slow
def test_it_says_who_was_matched_and_what_the_law_brings(answered: tuple[Path, Result]) -> None:
    out, said = answered
    assert said.exit_code == 0, said.exception
    assert (
        "104 of 104 data sets have a partner in the simulation, matched by rate, temperature, order and time"
        in said.stdout
    )
    first = said.stdout.lstrip("- ").splitlines()[0]
    told = re.fullmatch(
        r"Left out, (\d+) data sets differ from the simulation by .*; on another run of the same plan the gain is .* \(95 %\)\. "
        r"(\d+) more lie beyond the rates, the temperatures or the times of the others and are not judged\. Add the law: .*",
        first,
    )
    assert told is not None, first
    assert int(told[1]) + int(told[2]) == 104
    assert int(told[2]) < 12
    # What the law brings is said once.
    assert "on data left out" not in said.stdout
    page = (out / "diagnosis.html").read_text(encoding="utf-8")
    assert page.partition('class="verdict')[2].partition(">")[2].startswith(f"Left out, {told[1]} data sets")
    assert "clock is 30.000 ± less than 0.001 s ahead of the recording's" in said.stdout
    assert "scale_asymmetry" in said.stdout
    law = json.loads((out / "law.json").read_text(encoding="utf-8"))
    assert law["schema"] == "gyrocal-law/1"
    left = law["left_out"]
    assert left["rms_before_dps"] > 0.02
    # Twice the noise leaves room for what the fit of the other sets adds to it.
    assert NOISE_DPS * 0.8 < left["rms_after_dps"] < 2 * NOISE_DPS
    assert left["helps"] is True
    assert "improved.json" not in {path.name for path in out.iterdir()}


@pytest.mark.slow
def test_the_python_file_makes_the_simulation_the_recording(answered: tuple[Path, Result]) -> None:
    """On a plan that was not recorded."""
    out, _ = answered
    added = runpy.run_path(str(out / "law.py"))["added_dps"]
    rng = np.random.default_rng(5)
    rate, temp = rng.uniform(-95, 95, 200), rng.uniform(-5, 45, 200)
    t = 3.0 * np.arange(200)
    law = added(rate, temp, t_s=t, since_power_on_s=t)
    np.testing.assert_allclose(law, 0.02 + ASYMMETRY * np.maximum(rate, 0.0), atol=6 * NOISE_DPS)


def test_one_recording_is_not_two_units(tmp_path: Path, written: tuple[Path, Path]) -> None:
    real, sim = written
    copy = tmp_path / "copy.csv"
    copy.write_bytes(real.read_bytes())
    words = ["diagnose", str(real), str(copy), "--simulation", str(sim), "--out", str(tmp_path / "out")]
    assert "are the same recording" in str(CliRunner().invoke(gyrocal_command, words).exception)


def test_options_that_do_not_go_together_are_refused(tmp_path: Path, written: tuple[Path, Path]) -> None:
    real, sim = written
    for more, says in (
        (("--coefficients", "c.json"), "Leave --coefficients out"),
        (
            ("--robot", "r.toml", "--coefficients", "c.json"),
            "compared with its simulation as both were logged",
        ),
    ):
        failed = diagnose(real, sim, tmp_path / "out", *more).exception
        assert isinstance(failed, GyrocalError)
        assert says in str(failed)
        assert not (tmp_path / "out").exists()
