"""A package that is not gyrocal's adds an effect, a gyro, a table and a chamber by its entry points."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.bench.test_resume import toml
from tests.bench.tiny import tiny
from tests.extension.use_toy import PERIOD_DPS, SIZE_MDPS

ROOT = Path(__file__).parents[2]
ENTRY_POINTS = """\
[gyrocal.effects]
toy_ripple = gyrocal_toy:RIPPLE
[gyrocal.gyros]
toy-gyro = gyrocal_toy:GYRO
[gyrocal.tables]
toy-table = gyrocal_toy:TABLE
[gyrocal.chambers]
toy-chamber = gyrocal_toy:CHAMBER
"""


def install(site: Path, entry_points: str) -> dict[str, str]:
    """The package as an installer leaves it in a directory of modules; the environment that sees it."""
    info = site / "gyrocal_toy-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: gyrocal-toy\nVersion: 1.0\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(entry_points, encoding="utf-8")
    shutil.copy(Path(__file__).with_name("gyrocal_toy.py"), site)
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}


def run(environment: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    """Python with the package installed."""
    return subprocess.run(
        [sys.executable, *words], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("toy")
    done = run(install(out / "site", ENTRY_POINTS), "-m", "tests.extension.use_toy", str(out))
    assert done.returncode == 0, done.stderr
    read: dict[str, Any] = json.loads((out / "found.json").read_text(encoding="utf-8"))
    return read


def test_diagnose_names_it_with_its_size(found: dict[str, Any]) -> None:
    body = found["table"]["document"]
    (effect,) = body["effects"]
    assert effect["effect"] == "toy_ripple"
    for name, true in (("amplitude", SIZE_MDPS), ("period_dps", PERIOD_DPS)):
        estimate = effect["parameters"][name]
        assert estimate["value"] == pytest.approx(true, rel=0.02)
        low, high = estimate["interval_95"]
        assert low <= true <= high
    assert (effect["equation"], effect["reference"]) == (
        "e = k (1 - cos(2 pi w / p))",
        "A. Toy, Ripples on the rate axis (2026)",
    )


def test_the_page_shows_law_and_source(found: dict[str, Any]) -> None:
    for text in ("e = k (1 - cos(2 pi w / p))", "A. Toy, Ripples on the rate axis (2026)"):
        assert text in found["table"]["page"]


def test_it_is_folded_on_its_own_axis(found: dict[str, Any]) -> None:
    table = found["table"]
    assert table["axis"] == "Rate within a ripple, deg/s"
    assert table["furthest_on_axis"] < 1.05 * PERIOD_DPS
    before, after = table["folded"]
    assert before > 10 * after


def test_a_robot_and_its_firmware_correct_it(found: dict[str, Any]) -> None:
    assert found["table"]["error_left_dps"] < 1.2 * 5e-4
    assert "gyrocal_ripplef" in found["table"]["c"]


def test_a_blind_trial_draws_it(found: dict[str, Any]) -> None:
    assert len(found["drawn"]) >= 2
    assert all(30.0 <= p["period_dps"] <= 80.0 for p in found["drawn"])
    assert len({p["period_dps"] for p in found["drawn"]}) == len(found["drawn"])


def test_its_devices_run(found: dict[str, Any]) -> None:
    run = found["run"]
    assert run["failed"] == 0
    assert run["segments"] > 2
    assert len(run["rates"]) > 1


def test_a_profile_names_its_devices(tmp_path: Path) -> None:
    environment = install(tmp_path / "site", ENTRY_POINTS)
    profile = tmp_path / "toy.toml"
    devices = {f"{role}__device": f"toy-{role}:/dev/tty{role}" for role in ("gyro", "table", "chamber")}
    profile.write_text(toml(tiny(**devices)), encoding="utf-8")
    done = run(
        environment, "-m", "gyrocal", "acquire", str(profile), "--dry-run", "--out", str(tmp_path / "run")
    )
    assert done.returncode == 0, done.stderr
    without = subprocess.run(
        [sys.executable, "-m", "gyrocal", "acquire", str(profile), "--dry-run", "--out", str(tmp_path / "run")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert without.returncode == 5
    assert "gyro.device" in without.stderr


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("toy_ripple = gyrocal_toy:GONE", "cannot be loaded"),
        ("toy_ripple = gyrocal_toy:TABLE", "is a TableKind, not a Effect"),
        ("shupe = gyrocal_toy:RIPPLE", "there is one of that name already"),
        ("toy = gyrocal_toy:RIPPLE", "The effect toy_ripple is added under the name toy"),
    ],
)
def test_a_bad_package_is_named(tmp_path: Path, line: str, said: str) -> None:
    environment = install(tmp_path, f"[gyrocal.effects]\n{line}\n")
    done = run(environment, "-m", "gyrocal", "fit", str(ROOT / "sample_data"), "-o", str(tmp_path / "c.json"))
    assert done.returncode == 3
    assert said in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_page_for_packages_is_a_package(tmp_path: Path) -> None:
    """The law, the package file and the profile of the page as they stand there."""
    page = (ROOT / "gyrocal" / "physics" / "extending.md").read_text(encoding="utf-8")
    law = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)[0]
    project, virtual = (tomllib.loads(t) for t in re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)[:2])
    added = project["project"]["entry-points"]["gyrocal.effects"]
    environment = install(tmp_path, "[gyrocal.effects]\n" + "".join(f"{k} = {v}\n" for k, v in added.items()))
    (module,) = project["tool"]["setuptools"]["py-modules"]
    (tmp_path / f"{module}.py").write_text(law, encoding="utf-8")
    profile = tmp_path / "mine.toml"
    ((effect, sizes),) = virtual["virtual"]["effects"].items()
    profile.write_text(toml(tiny(**{f"virtual__effects__{effect}": sizes})), encoding="utf-8")
    words = ("-m", "gyrocal", "acquire", str(profile), "--dry-run", "--out", str(tmp_path / "run"))
    assert run(environment, *words).returncode == 0
    refused = run({**environment, "PYTHONPATH": str(ROOT)}, *words)
    assert refused.returncode != 0
    assert effect in refused.stderr


def test_the_gyro_of_the_page_is_recognised_on_a_port(tmp_path: Path) -> None:
    page = (ROOT / "gyrocal" / "physics" / "extending.md").read_text(encoding="utf-8")
    gyro = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)[1]
    (entry,) = re.findall(r"`(my-line = .*?)`", page)
    environment = install(tmp_path, "[gyrocal.gyros]\n" + entry.replace(chr(34), "") + "\n")
    (tmp_path / "myline.py").write_text(gyro, encoding="utf-8")
    code = (
        "from gyrocal.bench.probe import identify\n"
        "from gyrocal.bench.registry import GYROS\n"
        "sent = [(0.02 * k, GYROS['my-line'].encode(0.1 * k, 25.0, k, None)) for k in range(100)]\n"
        "print(identify(sent, 2.0, 115200).verdict)\n"
    )
    done = run(environment, "-c", code)
    assert done.stdout.startswith("my-line: "), done.stderr
    assert "with temperature" in done.stdout
