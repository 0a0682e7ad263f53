"""What tests of drives share."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrocal.records.robot import Robot, robot_of


@pytest.fixture
def resting() -> Robot:
    """The robot of the fleet: it stands for eight seconds."""
    return robot_of({"wheel_separation_m": 0.5, "static_s": 7.0}, Path("resting.toml"))
