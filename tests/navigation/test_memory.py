"""Long logs are replayed in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

#: Replays argv[1] and prints the peak memory of the process, MiB, and the rows that were taken.
PROGRAM = """
import resource, sys
from pathlib import Path
from gyrocal.navigation.equip import DriveSource
from gyrocal.navigation.replay import replay_log
from gyrocal.records.drive_log import iterate_drive_log
from gyrocal.records.robot import read_robot
path = Path(sys.argv[1])
robot = read_robot(path.with_name("robot.toml"))
found = replay_log(DriveSource("long", lambda: iterate_drive_log(path)), robot)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, found.survey.rows, found.t_s.size)
"""


def long_log(folder: Path, rows: int) -> Path:
    """A robot that drives eights at 100 Hz."""
    (folder / "robot.toml").write_text("wheel_separation_m = 0.5\nstatic_s = 0\n")
    path = folder / "long.csv"
    with path.open("w") as f:
        f.write("t_s,left_m,right_m,gyro_dps,gyro_temp_c\n")
        for first in range(0, rows, 100_000):
            k = np.arange(first, min(first + 100_000, rows))
            rate = 20.0 * np.sign(np.sin(2.0 * np.pi * k / 3600.0))
            half = 0.25 * np.radians(rate) * 0.01
            f.writelines(
                f"{t:.2f},{0.01 - h:.6f},{0.01 + h:.6f},{w + e:.4f},\n"
                for t, h, w, e in zip(0.01 * k, half, rate, 1e-3 * (k % 7), strict=True)
            )
    return path


def peak_mib(folder: Path, rows: int) -> float:
    """Peak memory of a replay in a process of its own."""
    path = long_log(folder, rows)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path)], capture_output=True, text=True, check=True
    )
    mib, seen, kept = done.stdout.split()
    assert int(seen) == rows
    assert int(kept) <= 20_002
    return float(mib)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    # A block of 200,000 rows is the working set; five times the rows may cost the windows of the survey only.
    assert peak_mib(tmp_path, 2_000_000) < 1.15 * peak_mib(tmp_path, 400_000)
