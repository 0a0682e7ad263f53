"""Diagnosis of drive logs: hidden physics is named, nothing is named where nothing is, strangers are not renamed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.diagnosis import robust
from gyrocal.diagnosis.drive_checks import ticks, time_stamps
from gyrocal.diagnosis.drive_result import diagnose_drive
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.errors import DataError
from gyrocal.records.drive import cut, read_drive_log
from gyrocal.records.robot import Robot, read_robot
from tests.diagnosis.drive_world import SEPARATION_M, Hidden, simulate

SHARED = Path(__file__).parents[2].parent / "shared" / "data"


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    path = tmp_path / "robot.toml"
    path.write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0.0\n")
    return read_robot(path)


def found(hidden: Hidden, robot: Robot, seed: int) -> Diagnosis:
    return diagnose_drive("drive.csv", simulate(hidden, seed), robot).diagnosis


def names(diagnosis: Diagnosis) -> list[str]:
    return [e.effect for e in diagnosis.effects]


@pytest.mark.parametrize(
    ("hidden", "effect", "truth"),
    [
        (Hidden(delay_s=0.12), "gyro_delay", 0.12),
        (Hidden(slip=0.06), "skid_slip", 6.0),
        (Hidden(slip=0.1, slip_exponent=1.0), "skid_slip", 10.0),
        (Hidden(asymmetry=0.006), "wheel_asymmetry", 0.6),
        (Hidden(eccentricity=0.01), "wheel_eccentricity", 1.0),
        (Hidden(scale=0.03, gps_m=0.6), "wheel_scale", 3.0),
    ],
)
def test_a_hidden_effect_is_named_with_its_size(
    robot: Robot, hidden: Hidden, effect: str, truth: float
) -> None:
    diagnosis = found(hidden, robot, 11)
    assert names(diagnosis) == [effect]
    assert diagnosis.verdict == "explained"
    amplitude = diagnosis.effects[0].parameters["amplitude"]
    # Five standard deviations: with six cases a false alarm once in ten thousand runs of this test.
    assert abs(amplitude.value - truth) < 5 * amplitude.std + 0.02 * truth


def test_two_effects_at_once(robot: Robot) -> None:
    diagnosis = found(Hidden(slip=0.4, delay_s=0.1), robot, 3)
    assert sorted(names(diagnosis)) == ["gyro_delay", "skid_slip"]
    gain = diagnosis.improvement
    assert gain is not None
    assert gain.heldout_rms_after_dps < 0.3 * gain.heldout_rms_before_dps
    assert gain.interval_95[0] > 0
    slip = next(e for e in diagnosis.effects if e.effect == "skid_slip")
    assert "gyro_scale" in [a.effect for a in slip.alternatives]


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1 / 57.29578, "in rad/s"),
        (-1.0, "sign inverted"),
        (-1 / 57.29578, "in rad/s and with the sign inverted"),
    ],
)
def test_wrong_unit_and_sign_are_named_and_bridged(robot: Robot, factor: float, text: str) -> None:
    diagnosis = found(Hidden(gyro_factor=factor), robot, 5)
    assert names(diagnosis) == ["unit_or_sign"]
    assert text in diagnosis.effects[0].statement


def test_nothing_is_named_where_nothing_is(robot: Robot) -> None:
    diagnosis = found(Hidden(), robot, 1)
    assert diagnosis.verdict == "consistent"
    assert names(diagnosis) == []


def test_a_document_of_the_format(robot: Robot) -> None:
    document = found(Hidden(slip=0.2), robot, 2).to_json()
    assert document["schema"] == "gyrocal-diagnosis/1"
    assert document["located"][0]["coordinate"] in ("turn_rate", "curvature")
    assert document["effects"][0]["improvement"]["heldout_rms_before_dps"] > 0
    assert "bias_temperature" in document["not_testable"]


def test_same_seed_same_answer(robot: Robot) -> None:
    assert found(Hidden(slip=0.2), robot, 2).to_json() == found(Hidden(slip=0.2), robot, 2).to_json()


def test_ticks_gaps_and_jitter_are_found() -> None:
    log = simulate(Hidden(), 1)
    tick_m = 0.002
    counted = [np.round(np.cumsum(side) / tick_m) for side in (log.left_m, log.right_m)]
    steps = [np.diff(c, prepend=0.0) * tick_m for c in counted]
    quantised = replace(log, left_m=steps[0], right_m=steps[1])
    assert ticks(log) is None
    size = ticks(quantised)
    assert size is not None
    assert size.parameters["amplitude"].value == pytest.approx(2.0, rel=1e-6)
    assert time_stamps(log, 0.1) == []
    holes = np.r_[0:500, 520:1500, 1560 : len(log)]
    (lost,) = time_stamps(replace(log, t_s=log.t_s[holes]), 0.1)
    assert lost.effect == "dropped_samples"
    assert "About 80 rows are missing" in lost.sentence


def test_short_and_still_logs_are_refused(robot: Robot) -> None:
    log = simulate(Hidden(), 1)
    with pytest.raises(DataError, match="log at least 60 s"):
        diagnose_drive("short.csv", cut(log, slice(0, 300)), robot)
    still = replace(log, left_m=np.zeros(len(log)), right_m=np.zeros(len(log)))
    with pytest.raises(DataError, match="the wheels move less than 1 m"):
        diagnose_drive("still.csv", still, robot)


def test_score_test_keeps_its_level_under_uneven_noise() -> None:
    rng = np.random.default_rng(7)
    n, trials, alarms = 300, 200, 0
    signs = rng.choice([-1.0, 1.0], size=(999, 30))
    for _ in range(trials):
        x = rng.normal(size=n)
        y = rng.normal(size=n) * (0.5 + np.abs(x)) + np.convolve(
            rng.normal(size=n + 2), [0.5, 0.3, 0.2], "valid"
        )
        regression = robust.regress(y, np.ones((n, 1)), robust.autoregression(y), 10)
        alarms += (
            robust.score_test(regression, [x[:, None]], signs[:, : regression.blocks.size]).p_value < 0.05
        )
    # Bound with a false alarm rate of 1e-3.
    assert alarms <= stats.binom.ppf(1 - 1e-3, trials, 0.05)


def test_the_real_drive() -> None:
    log, robot_file = SHARED / "skid_steer_drive.csv", SHARED / "skid_steer_robot.toml"
    if not log.exists():
        pytest.skip("../shared is absent")
    diagnosis = diagnose_drive(log.name, read_drive_log(log), read_robot(robot_file)).diagnosis
    assert names(diagnosis)[0] == "gyro_delay"
    assert diagnosis.verdict == "partly_explained"
    gain = diagnosis.improvement
    assert gain is not None
    assert gain.interval_95[0] > 0


@pytest.mark.slow
def test_false_names_and_strangers_over_many_drives(robot: Robot) -> None:
    trials = 60
    false_names = sum(bool(names(found(Hidden(), robot, 100 + i))) for i in range(trials))
    assert false_names <= stats.binom.ppf(0.999, trials, 0.02)
    wrong = sum(found(Hidden(lag_s=0.8), robot, 300 + i).verdict == "explained" for i in range(20))
    # A lag is near to a delay; with so long a one the difference has to show in most drives.
    assert wrong <= 8
    inside = [
        d for i in range(trials) if names(d := found(Hidden(slip=0.06), robot, 500 + i)) == ["skid_slip"]
    ]
    # The slip is about ten standard deviations; the gain on data left out must show too.
    assert len(inside) >= 0.9 * trials
    covered = 0
    for diagnosis in inside:
        low, high = diagnosis.effects[0].parameters["amplitude"].interval_95
        covered += low <= 6.0 <= high
    assert covered >= stats.binom.ppf(1e-3, len(inside), 0.92)
