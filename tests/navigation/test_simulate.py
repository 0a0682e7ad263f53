"""The simulated robot: the paper's path, a skid steer's encoders, and the virtual bench's gyro."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.errors import OutputError
from gyrocal.navigation.drives import DriveRequest, simulate_to_directory, simulated_files
from gyrocal.navigation.path import Motion, drive, square_via_points
from gyrocal.navigation.simulate import CCW, CW, Day, SimulatedRobot, Spread, encoder_steps, simulate_log
from gyrocal.physics.gyro import rd2100_unit
from gyrocal.records.files import raise_output_error, write_atomically
from gyrocal.records.robot import read_robot
from gyrocal.units import DPH_TO_DPS, EARTH_RATE_DPH
from tests.records.whole import read_drive_log

PATH = drive(square_via_points(Motion(), CCW), Motion(), 0.1, 10.0)
STILL = Spread(separation_run_std=0.0, turn_slip_deg_per_rt_deg=0.0, bumps_per_m=0.0)


@pytest.mark.parametrize("direction", [CW, CCW])
def test_the_path_is_the_papers(direction: int) -> None:
    motion = Motion()
    path = drive(square_via_points(motion, direction), motion, 0.1, 10.0)
    assert path.distance_m.sum() == pytest.approx(210.0, abs=1.0)
    assert np.hypot(path.x_m[-1], path.y_m[-1]) < 0.1
    assert 160.0 < path.t_s[-1] < 200.0  # about three minutes
    assert np.sign(path.heading_deg[-1]) == direction
    assert path.heading_deg[-1] == pytest.approx(path.turn_deg.sum())
    speed = path.distance_m / 0.1
    assert speed.max() == pytest.approx(motion.speed_mps)
    assert np.all(speed[path.t_s <= 10.0] == 0.0)
    assert np.abs(path.turn_deg).max() / 0.1 <= motion.turn_dps + 1e-9


def test_every_via_point_is_passed_slowly() -> None:
    for point in square_via_points(Motion(), CCW)[:-1]:
        distance = np.hypot(PATH.x_m - point[0], PATH.y_m - point[1])
        nearest = int(np.argmin(distance))
        assert distance[nearest] < Motion().reached_m
        assert PATH.distance_m[nearest] / 0.1 == pytest.approx(Motion().slow_mps, abs=0.01)


def test_encoders_follow_eq_7_with_the_effective_track() -> None:
    robot = SimulatedRobot(STILL, 0.01, -0.02, 0.7)
    left, right = encoder_steps(PATH, robot, np.random.default_rng(1))
    half = 0.5 * 0.7 * np.radians(PATH.turn_deg.sum())
    assert left.sum() == pytest.approx((PATH.distance_m.sum() - half) * 1.01, abs=STILL.metres_per_tick)
    assert right.sum() == pytest.approx((PATH.distance_m.sum() + half) * 0.98, abs=STILL.metres_per_tick)
    ticks = left / STILL.metres_per_tick
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)


def test_bumps_only_add_counts() -> None:
    bumpy = replace(STILL, bumps_per_m=2.0, bump_m=0.001)
    plain = encoder_steps(PATH, SimulatedRobot(STILL, 0.0, 0.0, 0.6), np.random.default_rng(1))
    rough = encoder_steps(PATH, SimulatedRobot(bumpy, 0.0, 0.0, 0.6), np.random.default_rng(1))
    for smooth, rattled in zip(plain, rough, strict=True):
        added = np.cumsum(rattled - smooth)
        assert added.min() > -1.01 * STILL.metres_per_tick
        # 2 bumps a metre of 1 mm: variance 2 * 2 * 1e-6 m^2 a metre, six standard deviations (2e-9).
        travelled = np.abs(smooth).sum()
        assert added[-1] == pytest.approx(0.002 * travelled, abs=6 * np.sqrt(4e-6 * travelled))


def test_the_gyro_is_the_units_true_surface_at_the_days_temperature() -> None:
    model = replace(rd2100_unit(3), bias_instability_deg_per_h=0.0, lsb_deg=0.0)
    day = Day(25.0, temp_run_std_c=0.0, drift_std_c_per_min=0.0, latitude_deg=42.3)
    robot = SimulatedRobot(STILL, 0.0, 0.0, 0.6)
    log = simulate_log(PATH, model, robot, day, np.random.default_rng(2))
    earth_dps = EARTH_RATE_DPH * DPH_TO_DPS * np.sin(np.radians(42.3))
    expected = model.surface.output_dps(PATH.turn_deg / 0.1 + earth_dps, 25.0)
    # Angle random walk of 5 deg/h/sqrt(Hz) in 0.1 s samples; the bandwidth shifts turns by 1.6 ms.
    sigma = 5.0 / 3600.0 / np.sqrt(0.1)
    rest = PATH.t_s < 10.0
    miss = (log.gyro_dps - expected)[rest] / sigma
    assert abs(miss.mean()) * np.sqrt(miss.size) < stats.norm.ppf(1 - 1e-6)
    assert np.sum(miss**2) < stats.chi2.ppf(1 - 1e-6, miss.size)
    assert np.abs(log.gyro_dps - expected).max() < 0.2


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path: Path) -> None:
    request = DriveRequest(tmp_path / "a", 5, runs=1)
    files, note = simulated_files(request)
    assert files == simulated_files(request)[0]
    assert files["cw1.csv"] != simulated_files(replace(request, seed=6))[0]["cw1.csv"]
    assert files["cw1.csv"] != simulated_files(replace(request, unit_seed=2))[0]["cw1.csv"]
    assert set(files) == {"cw1.csv", "ccw1.csv", "robot.toml", "simulation.json"}
    assert [run["direction"] for run in note["runs"]] == ["cw", "ccw"]


def test_what_is_written_is_what_replay_reads(tmp_path: Path) -> None:
    simulate_to_directory(DriveRequest(tmp_path / "a", 5, runs=1, direction="ccw"))
    robot = read_robot(tmp_path / "a" / "robot.toml")
    assert robot.defaulted == ()
    log = read_drive_log(tmp_path / "a" / "ccw1.csv", robot.metres_per_tick)
    assert log.truth_heading_deg[-1] > 300.0
    assert log.left_m.sum() == pytest.approx(210.0, abs=4.0)


def test_a_disk_that_fills_between_two_logs_keeps_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def filling(path: Path, data: bytes | str) -> None:
        if path.name == "robot.toml":
            raise_output_error(path, OSError(28, "No space left on device"))
        write_atomically(path, data)

    monkeypatch.setattr("gyrocal.records.output.write_atomically", filling)
    with pytest.raises(OutputError, match="the disk is full; nothing was left half-written"):
        simulate_to_directory(DriveRequest(tmp_path / "a", 5, runs=1, direction="ccw"))
    assert list(tmp_path.iterdir()) == []
