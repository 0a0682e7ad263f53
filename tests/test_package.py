"""What is shipped: the wheel holds the package, its profiles and templates, and nothing else."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import gyrocal

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_one_version() -> None:
    assert PROJECT["project"]["version"] == gyrocal.__version__


def test_nothing_unknown_stands_at_the_top_level() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    known = {
        "pyproject.toml",
        "gyrocal",
        "tests",
        "bench_profiles",
        "sample_data",
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
    }
    top = {line.split("/")[0] for line in listed.stdout.splitlines()}
    assert not {name for name in top if not name.startswith(".")} - known


@pytest.mark.slow
def test_wheel_holds_profiles_and_templates(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--quiet",
        "--wheel-dir",
        str(tmp_path),
        str(ROOT),
    ]
    subprocess.run(command, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    for profile in (ROOT / "bench_profiles").glob("*.toml"):
        assert f"gyrocal/bench/profiles/{profile.name}" in names
    package = {
        str(p.relative_to(ROOT))
        for p in (ROOT / "gyrocal").rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert package <= names
    assert {name.split("/")[0] for name in names} == {"gyrocal", f"gyrocal-{gyrocal.__version__}.dist-info"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_installed_program_finds_its_profiles(tmp_path: Path) -> None:
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
    subprocess.run([str(venv / "bin/pip"), "install", "--quiet", str(ROOT)], check=True)
    run = [str(venv / "bin/gyrocal"), "acquire", "quick", "--dry-run"]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "Nothing has moved." in done.stdout
