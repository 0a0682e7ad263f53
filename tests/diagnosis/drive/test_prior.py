"""What is known before a drive, where the drive says something else."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive import improved
from gyrocal.diagnosis.drive.prior import widened
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.weighing import Gram
from gyrocal.records.robot import robot_of


def told(name: str, value: float, std: float) -> Gram:
    """A drive that tells one figure so."""
    found = np.array([value]), np.array([[std**2]])
    gram = SimpleNamespace(solve=lambda names: found)
    gram.knowing = lambda known: gram
    return cast(Gram, gram)


@pytest.mark.parametrize(
    ("value", "std", "widens"),
    [(-0.25, 0.15, False), (-0.25, 0.005, False), (-0.4, 0.005, True), (-0.6, 0.15, True)],
)
def test_what_is_granted_of_a_track_holds_until_a_drive_contradicts_it(
    value: float, std: float, widens: bool
) -> None:
    """A real skid steer in 66 s: −25 ± 15 % beside a granted 9 %, and the file had a track that was a quarter too small."""
    series = cast(
        DriveSeries, SimpleNamespace(robot=robot_of({"wheel_separation_m": 0.5}, Path("robot.toml")))
    )
    known = {"track": (0.0, 0.1)}
    found = widened(series, known, told("track", value, std), ["track"])
    assert (found["track"][1] > 0.1) == widens


def test_a_bias_widens_as_the_drive_makes_likeliest() -> None:
    series = cast(
        DriveSeries, SimpleNamespace(robot=robot_of({"wheel_separation_m": 0.5}, Path("robot.toml")))
    )
    found = widened(series, {"bias": (0.0, 0.2)}, told("bias", 0.5, 0.3), ["bias"])
    assert found["bias"][1] == pytest.approx(0.4)


def test_what_a_track_is_off_by_is_asked_without_the_slip_that_stands_for_it() -> None:
    """A track of 2 % granted to 0.4 % had become a slip law, beside which nothing of it was left."""
    asked: list[list[str]] = []

    def solve(names: list[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        asked.append(list(names))
        return np.array([0.02]), np.array([[1e-6]])

    gram = SimpleNamespace(solve=solve)
    gram.knowing = lambda known: gram
    series = cast(
        DriveSeries, SimpleNamespace(robot=robot_of({"wheel_separation_m": 0.5}, Path("robot.toml")))
    )
    found = widened(series, {"track": (0.0, 0.004)}, cast(Gram, gram), ["track", "slip_curvature"])
    assert asked == [["track"]]
    assert found["track"][1] > 0.019


def test_a_bias_of_which_nothing_is_known_beforehand_is_the_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that jumps: `diagnose` had ended with "a bug, KeyError"."""
    monkeypatch.setattr(improved, "joint_estimate", lambda yaw, truth, name: (0.1, 0.01))
    assert improved.believed_bias(cast(YawAnswer, SimpleNamespace(known={})), None) == 0.1
