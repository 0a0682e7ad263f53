"""`gyrocal fleet` as a user runs it, on processes and on a cluster that loses a worker."""

from __future__ import annotations

import json
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd
import pytest
from click.testing import CliRunner
from distributed import LocalCluster

from gyrocal.calibration.calibrate import FitConfig
from gyrocal.calibration.fleet import FleetConfig, measure_all, measure_fleet
from gyrocal.cli import gyrocal_command
from gyrocal.report.fleet import write_fleet
from tests.calibration.test_fleet import write_table


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("units")
    return [write_table(folder / f"U{k}.csv", k) for k in range(1, 7)]


def test_it_writes_page_and_tables(tables: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "fleet"
    done = CliRunner().invoke(gyrocal_command, ["fleet", *map(str, tables), "--out", str(out), "--jobs", "1"])
    assert done.exit_code == 0, done.output
    assert "6 of 6 recordings are fitted; no unit is out of line" in done.output
    data = json.loads((out / "fleet.json").read_text())
    assert data["schema"] == "gyrocal-fleet/1"
    assert [u["serial"] for u in data["units"]] == [f"U{k}.csv" for k in range(1, 7)]
    frame = pd.read_parquet(out / "fleet.parquet")
    assert frame["c00 [deg/s]"].tolist() == pd.read_csv(out / "fleet.csv")["c00 [deg/s]"].tolist()
    assert "data:image/png;base64," in (out / "fleet.html").read_text()


@pytest.mark.slow
def test_the_same_units_give_the_same_bytes(tables: list[Path], tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_fleet(measure_fleet(FleetConfig(tuple(tables[:3]), jobs=2), lambda s, w: None), tmp_path / name)
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_few_units_have_no_spread_to_draw(tables: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "two"
    words = ["fleet", *map(str, tables[:2]), "--out", str(out), "--jobs", "1"]
    done = CliRunner().invoke(gyrocal_command, words)
    assert "2 of 2 recordings are fitted; who is out of line can be told of 5 units or more" in done.output
    assert not (out / "distributions.png").exists()
    assert "A spread takes 5 units or more" in (out / "fleet.html").read_text()


def test_one_recording_is_no_fleet(tables: list[Path], tmp_path: Path) -> None:
    done = CliRunner().invoke(gyrocal_command, ["fleet", str(tables[0]), "--out", str(tmp_path / "x")])
    assert "a fleet has two at least" in str(done.exception)
    assert not (tmp_path / "x").exists()


def test_a_recording_given_twice_is_refused_under_any_name(tables: list[Path], tmp_path: Path) -> None:
    copy = tmp_path / "copy.csv"
    copy.write_bytes(tables[0].read_bytes())
    done = CliRunner().invoke(
        gyrocal_command, ["fleet", *map(str, tables[:2]), str(copy), "--out", str(tmp_path / "x")]
    )
    assert "are the same recording: give each once" in str(done.exception)
    done = CliRunner().invoke(gyrocal_command, ["compare", str(tables[0]), str(copy)])
    assert "are the same recording: give each once" in str(done.exception)


def test_a_recording_that_is_not_there_stops_no_other(tables: list[Path], tmp_path: Path) -> None:
    """It had been an error of the tool's own, and the fleet was lost."""
    missing = str(tmp_path / "nofile.csv")
    words = ["fleet", *map(str, tables[:2]), missing, "--jobs", "1", "--out", str(tmp_path / "x")]
    done = CliRunner().invoke(gyrocal_command, words)
    assert done.exit_code == 0, done.exception
    assert "nofile.csv" in (tmp_path / "x" / "fleet.html").read_text()


@pytest.mark.slow
def test_no_scheduler_is_said(tables: list[Path]) -> None:
    config = FleetConfig(tuple(tables), dask="tcp://127.0.0.1:9")
    with pytest.raises(Exception, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        measure_fleet(config, lambda share, what: None)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_cluster_that_loses_a_worker_loses_no_unit(tables: list[Path]) -> None:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        killed: list[int] = []

        def tell(share: float, what: str) -> None:
            if not killed:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        with cluster.get_client() as client, client.get_executor(retries=3) as executor:
            units = list(measure_all(tables * 4, [FitConfig()] * 24, executor, tell))
    with ThreadPoolExecutor(1) as pool:
        alone = {u.source: u.figures for u in measure_all(tables, [FitConfig()] * 6, pool, lambda s, w: None)}
    assert killed
    assert len(units) == 4 * len(tables)
    assert all(repr(u.figures) == repr(alone[u.source]) for u in units)
