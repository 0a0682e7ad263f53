"""The sample data are what their own README's commands make."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.calibration.datasets import load_recording
from gyrocal.cli import main
from gyrocal.fusion import load_coefficients
from gyrocal.records.run import read_run

SAMPLE = Path(__file__).parents[1] / "sample_data"
LARGEST_BYTES = 5_000_000


def commands() -> list[str]:
    """Commands in the sh block of sample_data/README.md."""
    text = (SAMPLE / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL)
    return str(block).splitlines()


def files(root: Path) -> dict[str, bytes]:
    """Contents of every file below `root`, by its relative path."""
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_small() -> None:
    assert sum(map(len, files(SAMPLE).values())) <= LARGEST_BYTES


def test_run_is_sound_and_settled() -> None:
    run = read_run(SAMPLE / "run")
    for record in run.segments:
        run.verify(record)
    assert {record.outcome for record in run.segments} == {"ok"}
    assert {record.kind for record in run.segments} == {"rate", "static", "ramp", "soak"}


def test_table_and_run_hold_the_same_data_sets() -> None:
    run, table = load_recording(SAMPLE / "run").sets, load_recording(SAMPLE / "data_sets.csv").sets
    np.testing.assert_allclose(table.rate_dps, run.rate_dps, atol=5.1e-7)
    np.testing.assert_allclose(table.gyro_dps, run.gyro_dps, atol=5.1e-9)
    np.testing.assert_allclose(table.temp_c, run.temp_c, atol=5.1e-5)


def same_numbers(a: Any, b: Any, where: str = "") -> None:
    """Equal structure and text; the surface to 1e-9 deg/s, estimates that an optimiser ends on to 1e-4."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            if key != "sha256":
                same_numbers(a[key], b[key], f"{where}.{key}")
    elif isinstance(a, list):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            same_numbers(x, y, f"{where}[{i}]")
    elif isinstance(a, float):
        relative = 0.0 if where.startswith(".surface.coefficients_dps") else 1e-4
        assert a == pytest.approx(b, rel=relative, abs=1e-9), where
    else:
        assert a == b, where


@pytest.mark.slow
def test_made_again_they_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line in commands():
        words = shlex.split(line)
        if words[0] == "cp":
            shutil.copy(words[1], words[2])
            continue
        assert words[0] == "gyrocal"
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        assert ended.value.code == 0, line
    for name in ("run", "drives"):
        assert files(tmp_path / name) == files(SAMPLE / name), name
    assert (tmp_path / "data_sets.csv").read_bytes() == (SAMPLE / "data_sets.csv").read_bytes()
    same_numbers(
        json.loads((tmp_path / "coefficients.json").read_text()),
        json.loads((SAMPLE / "coefficients.json").read_text()),
    )


def test_coefficients_load_and_were_fitted_to_the_run() -> None:
    coefficients = load_coefficients(SAMPLE / "coefficients.json")
    assert coefficients.provenance["source_sha256"] == load_recording(SAMPLE / "run").sha256
    assert coefficients.correct(0.0, 20.0) == pytest.approx(-coefficients.surface.error_dps(0.0, 20.0))
