"""Names hold by the estimate that is told of them: jumps, intervals that hold zero, scales that run away, late truths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.drive.beside_truth import _asked, _beats_structure, told_from_nothing
from gyrocal.diagnosis.drive.engine import diagnose_drive, examine
from gyrocal.diagnosis.drive.estimates import estimates_of
from gyrocal.diagnosis.drive.findings import joint_estimate
from gyrocal.diagnosis.drive.jumps import _likeliest, within_motion
from gyrocal.diagnosis.drive.search import _unlike
from gyrocal.diagnosis.drive.series import Nodes
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot, robot_of
from gyrocal.report.drive_words import drive_sentences
from tests.diagnosis.drive.fleet import drive
from tests.diagnosis.drive.test_lasting import PLAN

Floats = NDArray[np.float64]


def test_a_delay_that_was_taken_out_is_uneven_by_what_is_left_of_it_only() -> None:
    assert _unlike(["delay", "step"], -0.3, ["time:track"]) == {"step", "track"}
    assert _unlike(["delay", "step"], 0.0, []) == {"delay", "step"}


def test_instants_of_a_jump_are_within_the_drive() -> None:
    def rising(instants_s: Floats) -> Floats:
        return np.asarray(instants_s, dtype=np.float64)

    found = _likeliest(0.0, 300.0, 1.0, rising)
    assert found is not None
    assert 0.0 < found.at_s < 300.0
    assert found.latest_s <= 300.0


def test_the_instant_of_a_jump_is_as_fine_as_what_tells_it() -> None:
    """Wheels that were others from 0.3 s before they were on took a fifth of the change from its figure."""

    def peaked(instants_s: Floats) -> Floats:
        return np.asarray(900.0 - 50.0 * np.abs(instants_s - 141.37), dtype=np.float64)

    found = _likeliest(0.0, 300.0, 0.1, peaked)
    assert found is not None
    assert found.at_s == pytest.approx(141.37, abs=0.1)
    assert found.earliest_s < 141.37 < found.latest_s
    assert found.latest_s - found.earliest_s < 1.0


def test_ends_of_the_instant_of_a_jump_were_asked_and_are_outside() -> None:
    """An end had been the finest step from the last instant inside, where the next that was asked lay further."""

    asked: list[float] = []

    def flat(instants_s: Floats) -> Floats:
        asked.extend(instants_s.tolist())
        return np.where(
            (instants_s > 155.2) & (instants_s < 155.8), 58.0, np.where(instants_s < 140.0, 40.0, 51.0)
        )

    found = _likeliest(0.0, 300.0, 0.1, flat)
    assert found is not None
    assert found.earliest_s == max(at_s for at_s in asked if at_s < 140.0)
    assert found.latest_s == 300.0


@pytest.mark.slow
def test_a_bias_beyond_what_is_granted_is_no_jump_at_the_end() -> None:
    """Held to 0.01 deg/s, one of 0.2 deg/s had been another bias "from the end of the log on"."""
    granted = {"wheel_separation_m": 0.5, "static_s": 0.0, "initial_std": {"gyro_bias_dps": 0.01}}
    log = drive(replace(PLAN, rest_s=0.0, bias_dps=0.2, truth_m=0.01, minutes=5.0), 8)
    found = diagnose_drive("log", log, robot_of(granted, Path("robot.toml")))
    assert "jump" not in found.yaw.chosen
    assert "gyro_bias" in [e.effect for e in found.diagnosis.effects]
    # Nor does the page grant what it names.
    assert not any("grants as much" in line for line in drive_sentences(found))
    assert [e.named for e in found.estimates if e.name == "gyro_bias"] == [True]


@pytest.mark.slow
def test_a_law_whose_interval_holds_zero_has_no_name(resting: Robot) -> None:
    found = examine("log", drive(replace(PLAN, truth_m=0.01, minutes=5.0), 6), resting, None)
    (law,) = [n for n in ("step",) if n in found.yaw.laws]
    claimed = found.yaw.with_law(law, 20.0)
    claimed = replace(claimed, named={**claimed.named, "asymmetry": 20.0})
    yaw, truth = told_from_nothing(found.series, claimed, _asked(found.series, claimed, found.truth))
    assert not yaw.named
    assert law not in yaw.chosen
    told = {e.name: e for e in estimates_of(found.series, yaw, truth, {}, found.figures)}
    assert not told["gyro_bias_in_motion"].named
    # Wheels by the estimate that the bias of the truth goes into.
    assert told["wheel_asymmetry"].std == pytest.approx(100.0 * joint_estimate(yaw, truth, "asymmetry")[1])


def circle() -> DriveBlock:
    """Five minutes round one circle with an accurate truth, between rests."""
    rng = np.random.default_rng(51)
    hz, seconds = 20.0, 200.0
    t = np.arange(int(seconds * hz)) / hz
    drives = np.convolve((t > 15.0) & (t < 190.0), np.ones(10) / 10.0, "same")
    rate_dps, speed = 20.0 * drives, 0.5 * drives
    heading = np.cumsum(np.radians(rate_dps)) / hz
    at = np.cumsum(speed * np.exp(1j * (heading - 0.5 * np.radians(rate_dps) / hz))) / hz
    half = 0.25 * np.radians(rate_dps)
    left, right = (
        np.diff(np.floor(np.cumsum(x) / hz / 1e-3) * 1e-3, prepend=0.0) for x in (speed - half, speed + half)
    )
    noise = 0.01 * rng.normal(size=(2, t.size))
    gyro = rate_dps + 0.01 * rng.normal(size=t.size)
    nothing = np.full(t.size, np.nan)
    return DriveBlock(2, t, left, right, gyro, nothing, at.real + noise[0], at.imag + noise[1], nothing)


def test_no_scale_that_runs_away_is_believed(resting: Robot) -> None:
    """On a circle that of the wheels goes with the lever arm: it had been 127 %."""
    truth = examine("log", circle(), resting, None).truth
    assert truth is not None
    assert not truth.believed("wheel_scale")
    assert not truth.shows("wheel_scale") or abs(truth.values["wheel_scale"]) < 0.5
    assert abs(truth.values["gyro_scale"]) < 1e-3
    assert abs(truth.values["lever_left"]) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("late_rows", [8, -8])
def test_a_late_truth_is_of_an_earlier_place(late_rows: int, resting: Robot) -> None:
    """As a shift along the direction at its own time it had bent the path, and made scales of it."""
    log = drive(replace(PLAN, truth_m=0.005, truth_every_s=0.05, minutes=5.0), 6)
    x, y = (np.roll(v, late_rows) for v in (log.truth_x_m, log.truth_y_m))
    edge = slice(0, late_rows) if late_rows > 0 else slice(late_rows, None)
    x[edge] = y[edge] = np.nan
    truth = examine("log", replace(log, truth_x_m=x, truth_y_m=y), resting, None).truth
    assert truth is not None
    assert truth.values["clock"] == pytest.approx(late_rows / 20.0, abs=0.01)
    assert all(abs(truth.told(scale)) < 3.0 for scale in ("gyro_scale", "wheel_scale"))


def test_a_bias_of_the_last_rest_alone_is_no_jump() -> None:
    """It came with the motion; or wheels that go by the speed are as a bias and a difference of theirs together."""
    dt_s = np.ones(400)
    resting = np.arange(400) >= 395
    nodes = cast(Nodes, SimpleNamespace(t_s=np.cumsum(dt_s), dt_s=dt_s, resting=resting))
    np.testing.assert_allclose(within_motion(nodes), [395 / 40, 395 * 39 / 40], atol=1.0)


def test_a_law_beside_which_nothing_is_odd_is_all_that_was_odd() -> None:
    """A bias in motion of 10.4 mdeg/s, 27 of its standard deviations, had less to show than columns over the speed."""

    def told(surest: float, loss: float) -> TruthAnswer:
        return cast(TruthAnswer, SimpleNamespace(surest=surest, loss=loss))

    odd, gain = told(-666.0, -3661.0), 731.0
    assert _beats_structure(gain, told(-0.5, -3746.0), odd, -0.8)
    # What leaves some of it, or fits no better, has to outweigh it; and so has what encoders show over the time.
    assert not _beats_structure(gain, told(-100.0, -3746.0), odd, -0.8)
    assert not _beats_structure(gain, told(-0.5, -3661.0), odd, -0.8)
    assert not _beats_structure(gain, told(-0.5, -3746.0), odd, -500.0)
    assert _beats_structure(2000.0, told(-100.0, -3746.0), odd, -0.8)
