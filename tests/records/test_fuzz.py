"""Every reader against damaged files: a sentence or a sound answer, never a crash, a hang or all the memory."""

from __future__ import annotations

import json
import resource
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from gyrocal.bench.profile import load_profile
from gyrocal.bench.status import read_status
from gyrocal.errors import CoefficientError, GyrocalError, InputError
from gyrocal.fusion.coefficients import load_coefficients
from gyrocal.records.bags import Wheels, iterate_bag
from gyrocal.records.columns import read_column_map
from gyrocal.records.datasets import read_data_sets
from gyrocal.records.gyro_log import iterate_gyro_log
from gyrocal.records.raw import RawWriter, iterate_raw, read_raw_head
from gyrocal.records.robot import read_robot
from gyrocal.records.run import read_run
from gyrocal.records.static_log import iterate_static_log
from tests.records.mutation import mutated
from tests.records.test_drive_bags import write_bag
from tests.records.test_gyro_log import dataflash, ulog
from tests.records.whole import read_drive_log

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_data"
#: Nothing that is read here is larger than a megabyte; nothing may take longer or more than this.
LONGEST_S, LARGEST_KIB = 10.0, 1 << 20
TOPICS = {"/imu": "sensor_msgs/msg/Imu", "/odom": "nav_msgs/msg/Odometry"}
COLUMN_MAP = """
[columns.t_s]
from = "t_s"
unit = "s"
[columns.gyro_dps]
from = "gyro_dps"
unit = "deg/s"
[columns.left_m]
from = "left_m"
unit = "m"
[columns.right_m]
from = "right_m"
unit = "m_total"
wrap = 100
"""


@dataclass(frozen=True)
class Target:
    """A reader: where its sound files come from, which of them is damaged, and how it is read."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]


def _copy(source: Path) -> Callable[[Path], Path]:
    return lambda folder: Path(shutil.copy(source, folder))


def _run(file: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        shutil.copytree(SAMPLE / "run", folder / "run", dirs_exist_ok=True)
        return folder / "run" / file

    return make


def _read_run_of(file: Path) -> object:
    run = read_run(file.parent)
    return run.segments, read_status(file.parent, datetime(2026, 1, 1, tzinfo=UTC))


def _segment_file() -> str:
    line = (SAMPLE / "run" / "journal.jsonl").read_text().splitlines()[-4]
    return str(json.loads(line)["file"])


def _read_segment(file: Path) -> object:
    run = read_run(file.parent.parent)
    record = next(r for r in run.segments if r.file.endswith(file.name))
    found = list(run.iterate_segment(record))
    with pytest.raises(InputError, match="differs from what the journal sealed"):
        run.verify(record)
    return found


def _raw(folder: Path) -> Path:
    path = folder / "gyro.raw"
    capture = RawWriter(path, "kvh-dsp3000", {})
    for k in range(50):
        capture.chunk(0.01 * k, f"{0.1 * k:15.6f}   1\r\n".encode())
    capture.close()
    return path


def _static(folder: Path) -> Path:
    path = folder / "rest.csv"
    path.write_text("t_s,gyro_dps,temp_c\n" + "".join(f"{0.01 * k:.2f},{0.001 * k},25\n" for k in range(400)))
    return path


def _map(folder: Path) -> Path:
    path = folder / "map.toml"
    path.write_text(COLUMN_MAP)
    return path


def _bag(kind: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / ("run.bag" if kind == "bag" else "run")
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        write_bag(path, kind, TOPICS, last_s=2.0)
        return path if kind == "bag" else next(path.glob(f"*.{kind}"))

    return make


def _read_coefficients(path: Path) -> object:
    sound = load_coefficients(SAMPLE / "coefficients.json")
    found = load_coefficients(path)
    # What is accepted says the same: white space may change, nothing else.
    assert json.loads(found.to_text()) == json.loads(sound.to_text())
    return found


DRIVE = next(p for p in sorted((SAMPLE / "drives").glob("*.csv")))
TARGETS = {
    "run.json": Target(_run("run.json"), _read_run_of),
    "journal": Target(_run("journal.jsonl"), _read_run_of),
    "segment": Target(_run(_segment_file()), _read_segment),
    "data sets": Target(_copy(SAMPLE / "data_sets.csv"), read_data_sets),
    "drive": Target(_copy(DRIVE), lambda p: read_drive_log(p, (1e-4, 1e-4))),
    "robot": Target(_copy(SAMPLE / "drives" / "robot.toml"), read_robot),
    "coefficients": Target(_copy(SAMPLE / "coefficients.json"), _read_coefficients),
    "profile": Target(_copy(ROOT / "bench_profiles" / "rd2100.toml"), load_profile),
    "column map": Target(_map, read_column_map),
    "raw": Target(_raw, lambda p: (read_raw_head(p), list(iterate_raw(p)))),
    "static": Target(_static, lambda p: list(iterate_static_log(p))),
    "ROS 1 bag": Target(_bag("bag"), lambda p: list(iterate_bag(p, Wheels(0.5, 0.1)))),
    "ROS 2 sqlite": Target(_bag("db3"), lambda p: list(iterate_bag(p, Wheels(0.5, 0.1)))),
    "ULog": Target(lambda f: ulog(f / "a.ulg"), lambda p: list(iterate_gyro_log(p))),
    "DataFlash": Target(lambda f: dataflash(f / "a.bin"), lambda p: list(iterate_gyro_log(p))),
    "MCAP": Target(_bag("mcap"), lambda p: list(iterate_bag(p, Wheels(0.5, 0.1)))),
}


def attack(target: Target, folder: Path, seed: int, rounds: int) -> tuple[int, int]:
    """Damage and read, `rounds` times; how many files were refused, and how many were read."""
    rng = np.random.default_rng(seed)
    file = target.make(folder)
    sound = file.read_bytes()
    refused = read = longest = 0
    for number in range(rounds):
        damaged = mutated(sound, rng)
        if damaged == sound:
            continue
        file.write_bytes(damaged)
        begin_s = time.process_time()
        try:
            target.read(file)
            read += 1
        except GyrocalError as error:
            refused += 1
            longest = max(longest, *map(len, str(error).splitlines()))
        except Exception as error:
            raise AssertionError(f"round {number} of seed {seed}: {type(error).__name__}: {error}") from error
        took_s = time.process_time() - begin_s
        assert took_s < LONGEST_S, f"round {number} of seed {seed} took {took_s:.1f} s"
    assert longest < 2000, "a message that nobody reads"
    return refused, read


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_refused_or_read(tmp_path: Path, name: str) -> None:
    refused, _ = attack(TARGETS[name], tmp_path, seed=1, rounds=30)
    assert refused > 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 * LARGEST_KIB


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", TARGETS)
def test_very_many_damaged_files(tmp_path: Path, name: str) -> None:
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused, read = attack(TARGETS[name], tmp_path, seed=2, rounds=1500)
    assert refused + read > 1400
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < LARGEST_KIB


def test_an_untouched_file_of_each_kind_is_read(tmp_path: Path) -> None:
    for name, target in TARGETS.items():
        if name != "segment":
            target.read(target.make(tmp_path))


def test_every_altered_coefficient_is_refused(tmp_path: Path) -> None:
    body = json.loads((SAMPLE / "coefficients.json").read_text())
    body["surface"]["coefficients_dps"][0][0] += 1e-12
    path = tmp_path / "fog.json"
    path.write_text(json.dumps(body))
    with pytest.raises(CoefficientError, match="sha256 does not fit its contents"):
        load_coefficients(path)
