"""Whatever kind of log: one way to read it, for replay and diagnose alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.errors import InputError
from gyrocal.records.drive_source import Reading, read_drive
from gyrocal.records.robot import Robot, read_robot
from tests.records.test_drive_bags import IMU_ODOMETRY, write_bag

MAP = "".join(
    f'[columns.{name}]\nfrom = "{source}"\nunit = "{unit}"\n'
    for name, source, unit in (
        ("t_s", "stamp", "ms"),
        ("left_m", "l", "mm"),
        ("right_m", "r", "mm"),
        ("gyro_dps", "w", "rad/s"),
    )
)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    path = tmp_path / "robot.toml"
    path.write_text("wheel_separation_m = 0.5\n")
    return read_robot(path)


def test_a_foreign_csv_by_its_mapping(tmp_path: Path, robot: Robot) -> None:
    (tmp_path / "map.toml").write_text(MAP)
    log = tmp_path / "log.csv"
    log.write_text("stamp,l,r,w\n" + "".join(f"{20 * k},10,20,0.1\n" for k in range(30)))
    block = read_drive(log, robot, Reading(tmp_path / "map.toml"))
    np.testing.assert_allclose(block.t_s, 0.02 * np.arange(30))
    np.testing.assert_allclose(block.left_m, 0.01)
    np.testing.assert_allclose(block.gyro_dps, np.degrees(0.1))
    with pytest.raises(InputError, match=r"column t_s is missing"):
        read_drive(log, robot)


def test_a_bag_by_its_topics_and_axis(tmp_path: Path, robot: Robot) -> None:
    bag = write_bag(tmp_path / "run", "mcap", IMU_ODOMETRY | {"/odom2": "nav_msgs/msg/Odometry"})
    up = read_drive(bag, robot, Reading(topics={"wheels": "/odom2"}))
    down = read_drive(bag, robot, Reading(topics={"wheels": "/odom2"}, axis="-z"))
    np.testing.assert_array_equal(down.gyro_dps, -up.gyro_dps)
