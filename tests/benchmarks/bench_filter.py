"""The filter against filterpy and dense Eigen with the same matrices, and dead reckoning without it.

filterpy (``pip install filterpy``) and Eigen (``apt-get install libeigen3-dev``, and a C++ compiler) are needed by
this benchmark only; where one is absent, its row says so and has no goal.
"""

from __future__ import annotations

import importlib.util
import math
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.fusion import FilterNoise, Navigator, RobotParameters
from gyrocal.fusion import filter as loop
from tests.benchmarks.row import Row, best_time_s
from tests.fusion.drive import Drive, paper, simulate
from tests.fusion.test_filter import dense_matrices

Floats = NDArray[np.float64]

ROBOT = RobotParameters(0.5, noise=FilterNoise(0.005, 0.0, 0.08, 0.0, 0.05))
#: A block that stays in the cache, as a log that is streamed does; a log of ten million rows is measured apart.
ROWS = 20_000
REFERENCE_ROWS = 1_000
REPEATS = 25
_EIGEN = (
    Path("/usr/include/eigen3"),
    Path("/usr/local/include/eigen3"),
    Path("/opt/homebrew/include/eigen3"),
)


def measure() -> list[Row]:
    """All rows."""
    drive = simulate(ROBOT, np.random.default_rng(1), ROWS * 0.1)
    filter_ns = 1e9 * _run_s(drive, filtering=True) / ROWS
    alone_ns = 1e9 * _run_s(drive, filtering=False) / ROWS
    step_ns = 1e9 * _step_s(drive) / REFERENCE_ROWS
    model_ns = 1e9 * _run_s(drive, filtering=True, kind="model") / ROWS
    first = Drive(*(getattr(drive, name)[:REFERENCE_ROWS] for name in Drive.__dataclass_fields__))
    numpy_ns, filterpy_ns = _dense_ns(first)
    rows = [
        Row("filter, Navigator.run with all bookkeeping", filter_ns, "ns/step"),
        Row("filter, Navigator.step (one row a call)", step_ns, "ns/step", 3e3),
        Row("the same matrices in plain numpy / Navigator.step", numpy_ns / step_ns, ""),
        Row("drive model, Navigator.run at 10 Hz", model_ns, "ns/step"),
        Row("the same matrices in plain numpy", numpy_ns, "ns/step"),
        Row("the same matrices in plain numpy / ours", numpy_ns / filter_ns, ""),
    ]
    if math.isnan(filterpy_ns):
        rows.append(Row("filterpy is not installed (pip install filterpy): not compared", math.nan, ""))
    else:
        rows.append(Row("filterpy's KalmanFilter, the same matrices", filterpy_ns, "ns/step"))
        rows.append(Row("filterpy / ours", filterpy_ns / filter_ns, "", 100.0, at_least=True))
    rows += _eigen_rows(drive, filter_ns)
    rows.append(Row("dead reckoning without the filter", 1e9 / alone_ns, "rows/s", 1e7, at_least=True))
    return rows


def _run_s(drive: Drive, *, filtering: bool, kind: str = "paper") -> float:
    def work() -> None:
        navigator = Navigator(ROBOT, kind=kind, filtering=filtering)
        navigator.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)

    work()
    return best_time_s(work, REPEATS)


def _step_s(drive: Drive) -> float:
    def work() -> None:
        navigator = paper(ROBOT)
        for k in range(REFERENCE_ROWS):
            navigator.step(0.1, drive.left_m[k], drive.right_m[k], drive.gyro_dps[k])

    return best_time_s(work, 5)


def _dense_ns(drive: Drive) -> tuple[float, float]:
    """Time of a predict and update alone, matrices given, for plain numpy and filterpy."""
    navigator = paper(ROBOT)
    figures, p0 = navigator._figures, np.diag(navigator._matrix[loop.D])
    matrices = []
    innovation = []
    for k in range(REFERENCE_ROWS):
        matrices.append(
            dense_matrices(
                navigator._nav.copy(), figures, drive.left_m[k], drive.right_m[k], drive.gyro_dps[k]
            )
        )
        row = navigator.step(0.1, drive.left_m[k], drive.right_m[k], drive.gyro_dps[k])
        innovation.append(float(np.radians(row.innovation_deg)))
    h = np.zeros((1, 9))
    h[0, [loop.PSI, loop.PHI]] = 1.0, -1.0
    noise = figures[loop.MEASUREMENT]

    def by_numpy() -> Floats:
        p, identity = p0.copy(), np.eye(9)
        for (f, q), z in zip(matrices, innovation, strict=True):
            p = f @ p @ f.T + q
            gain = p @ h.T / ((h @ p @ h.T)[0, 0] + noise)
            gain * z
            left = identity - gain @ h
            p = left @ p @ left.T + noise * (gain @ gain.T)
        return p

    numpy_ns = 1e9 * best_time_s(by_numpy, 5) / REFERENCE_ROWS
    if importlib.util.find_spec("filterpy") is None:
        return numpy_ns, math.nan
    from filterpy.kalman import KalmanFilter

    def by_filterpy() -> Floats:
        kalman = KalmanFilter(dim_x=9, dim_z=1)
        kalman.P, kalman.H, kalman.R = p0.copy(), h, np.array([[noise]])
        for (f, q), z in zip(matrices, innovation, strict=True):
            kalman.predict(F=f, Q=q)
            kalman.update(z)
        return np.asarray(kalman.P)

    _check_same(by_numpy(), by_filterpy(), "filterpy")
    return numpy_ns, 1e9 * best_time_s(by_filterpy, 5) / REFERENCE_ROWS


def _eigen_rows(drive: Drive, filter_ns: float) -> list[Row]:
    """Dense Eigen at -O3 over the same rows, its last states checked against ours."""
    include = next((path for path in _EIGEN if path.is_dir()), None)
    compiler = shutil.which("g++") or shutil.which("clang++")
    if include is None or compiler is None:
        what = "Eigen" if include is None else "a C++ compiler"
        return [Row(f"{what} is absent (apt-get install libeigen3-dev g++): not compared", math.nan, "")]
    navigator = paper(ROBOT)
    navigator.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)
    fresh = paper(ROBOT)
    f, d = fresh._figures, fresh._matrix[loop.D]
    used = (f[loop.SLIP], f[loop.WALK], f[loop.MEASUREMENT], f[loop.GATE], ROBOT.wheel_separation_m, REPEATS)
    arguments = [repr(float(v)) for v in (*used, *d)]
    t = np.diff(drive.t_s, prepend=drive.t_s[0])
    table = np.column_stack([t, drive.left_m, drive.right_m, np.radians(drive.gyro_dps)])
    rows = []
    for flags, goal in (("-O3", 1.0), ("-O3 -march=native", None)):
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / "filter"
            source = Path(__file__).with_name("filter_eigen.cpp")
            subprocess.run([compiler, *flags.split(), "-I", include, source, "-o", program], check=True)
            # The first row has no time step and ours measures nothing there; the rest is the same filter.
            done = subprocess.run(
                [program, *arguments], input=table[1:].tobytes(), capture_output=True, check=True
            )
        eigen_ns, *states = (float(v) for v in done.stdout.split())
        _check_same(navigator._nav[:9], np.array(states), "Eigen")
        rows.append(Row(f"dense Eigen 9 x 9, {flags}", eigen_ns, "ns/step"))
        rows.append(Row(f"dense Eigen, {flags} / ours", eigen_ns / filter_ns, "", goal, at_least=True))
    return rows


def _check_same(ours: Floats, theirs: Floats, name: str) -> None:
    scale = np.abs(ours).max()
    if not np.allclose(ours, theirs, rtol=1e-5, atol=1e-7 * scale):
        msg = f"{name} does not compute the same filter, so a comparison of speed says nothing"
        raise ArithmeticError(msg)
