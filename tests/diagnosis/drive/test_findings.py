"""From fits to names: what a truth, a robot file and the noise of a drive say of each other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.special import log_ndtr
from scipy.stats import norm

from gyrocal.diagnosis.drive import findings, places
from gyrocal.diagnosis.drive.beside_truth import _explained
from gyrocal.diagnosis.drive.path_laid import SCALES
from gyrocal.diagnosis.drive.path_problem import log_chance
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import DriveSeries
from gyrocal.diagnosis.drive.truth import TruthAnswer, bias_moves
from gyrocal.diagnosis.remarks import Said


def truth(gyro: float, wheels: float, std: float) -> TruthAnswer:
    """A truth that knows the scales of gyro and wheels independently of each other."""
    return TruthAnswer(
        {"gyro_scale": gyro, "wheel_scale": wheels},
        dict.fromkeys(SCALES, std),
        std**2 * np.eye(2),
        np.zeros((0, 0)),
        {},
    )


def series(rested: bool = False, **robot: Any) -> DriveSeries:
    """A log of which only the robot file is asked for, and whether it has the rest that this promises."""
    return cast(
        DriveSeries, SimpleNamespace(robot=SimpleNamespace(**robot), differential=True, rested=rested)
    )


def yaw(**fields: Any) -> YawAnswer:
    """An answer with some of its fields."""
    return cast(YawAnswer, SimpleNamespace(**fields))


@pytest.mark.parametrize(
    ("gyro", "wheels", "best"),
    [(0.0, 0.02, "wheel_scale"), (1.0 / 1.02 - 1.0, 0.0, "gyro_scale"), (0.0, 0.0, "track")],
)
def test_a_truth_says_which_scale_makes_the_ratio_of_the_headings(
    gyro: float, wheels: float, best: str
) -> None:
    against = findings._against(0.02, 1e-4, truth(gyro, wheels, 1e-3))
    assert min(against, key=lambda n: against[n]) == best
    assert against[best] < 1e-6
    # Each of the others is off by about twenty standard deviations of the truth in one figure or two.
    assert sorted(against.values())[1] == pytest.approx(400.0, rel=0.1)
    assert findings._against(0.02, 1e-4, None) == dict.fromkeys(against, 0.0)


@pytest.mark.parametrize("gain", [1.0, 100.0, 1300.0, 5000.0, 1e6])
def test_a_chance_is_told_where_a_float_holds_none(gain: float) -> None:
    """Of one column it is that of a normal's two tails."""
    exact = np.log(2.0) + log_ndtr(-np.sqrt(gain))
    assert log_chance(gain, 1) == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize(
    ("left", "before", "explained"),
    [(-1.0, -9.0, True), (-30.0, -2000.0, True), (-300.0, -2000.0, False), (-8.0, -20.0, False)],
)
def test_what_a_law_leaves_is_little_of_what_was(left: float, before: float, explained: bool) -> None:
    found, without = (replace(truth(0.0, 0.0, 1e-3), surest=p) for p in (left, before))
    assert _explained(found, without) == explained


@pytest.mark.parametrize(
    ("times", "known", "given", "said"),
    [(5.0, 0.1, True, True), (5.0, 1.0, True, False), (3.0, 0.1, True, False), (5.0, 0.1, False, False)],
)
def test_noise_far_above_that_of_the_robot_file_is_a_place(
    times: float, known: float, given: bool, said: bool
) -> None:
    usual = SimpleNamespace(slip_m_per_rt_m=0.01, turn=0.1)
    noise = SimpleNamespace(slip_m_per_rt_m=0.01 * times, turn=0.1)
    keys = ("noise.wheel_slip_m_per_rt_m", "noise.turn_slip_deg_per_rt_deg") if given else ()
    model = SimpleNamespace(noise=noise, usual=usual, log_std={"slip_m_per_rt_m": known, "turn": known})
    noisy = places._noisy(series(given=keys), yaw(model=model))
    assert [p.coordinate for p in noisy] == (["speed"] if said else [])
    assert [p.times_given for p in noisy] == pytest.approx([times] if said else [])
    # The p-value is that of the level, as well as the drive knows it.
    assert [p.p_value for p in noisy] == pytest.approx([norm.sf(np.log(5.0) / 0.1)] if said else [])
    assert all(p.remains for p in noisy)


@pytest.mark.parametrize(
    ("away_stds", "rested", "found"), [(6.0, False, True), (3.0, False, False), (6.0, True, False)]
)
def test_a_bias_beyond_what_the_robot_file_grants_is_named_where_no_rest_takes_it_off(
    away_stds: float, rested: bool, found: bool
) -> None:
    granted = 0.01
    robot = series(
        rested=rested,
        static_s=0.0,
        wheel_separation_m=0.5,
        initial_std={
            "gyro_bias_dps": granted,
            "wheel_separation_m": 0.01,
            "left_scale": 0.01,
            "right_scale": 0.01,
        },
        parameters=SimpleNamespace(gyro=SimpleNamespace(bias_dps=0.5)),
    )
    answer = findings.unexpected_bias(
        robot, yaw(estimate=lambda name: (0.5 + away_stds * granted, 1e-3)), None
    )
    assert (answer is not None) == found
    if answer is not None:
        gain, effect = answer
        assert gain == pytest.approx((away_stds * granted / 1e-3) ** 2)
        assert effect.effect == "gyro_bias"
        assert effect.seen is not None
        assert effect.seen.said is Said.BIAS_NO_REST


@pytest.mark.parametrize(("std", "known"), [(0.01, True), (0.03, False)])
def test_a_truth_that_knows_a_scale_poorly_is_said_to_be_poor(std: float, known: bool) -> None:
    log = yaw(laws={"slope": 0, "step": 0}, chosen=(), gram=SimpleNamespace(names=()))
    reasons = findings.not_testable(series(), log, truth(0.0, 0.0, std))
    assert ("gyro_scale" not in reasons) == known


@pytest.mark.parametrize(("scale", "tilted"), [(-0.02, True), (-0.005, False), (0.02, False)])
def test_a_gyro_that_reads_far_too_little_may_be_tilted(scale: float, tilted: bool) -> None:
    found = findings._of_scale(
        "gyro_scale",
        {"gyro_scale": findings.OfTruth(scale, 1e-3)},
        series(initial_std={"gyro_scale": 4e-3}),
        yaw(estimate=lambda name: (0.0, 1e-3)),
        cast(TruthAnswer, SimpleNamespace(**vars(truth(scale, 0.0, 1e-3)), believed=lambda name: True)),
    )
    assert ("robot_tilt" in [a.effect for a in found.alternatives]) == tilted


@pytest.mark.parametrize(("std", "rivals"), [(1e-4, []), (1e-2, ["wheel_scale"])])
def test_a_scale_that_is_named_is_no_rival_of_the_track_beside_it(std: float, rivals: list[str]) -> None:
    """It had been 'likelier: more than 1,000,000 to 1' than what is left without it; wheels that the truth knows poorly are one."""
    told = truth(0.01, 0.0, 1e-4)
    told = replace(told, covariance=np.diag([1e-8, std**2]))
    parts = {"gyro_scale": findings.OfTruth(0.01, 1e-4), "track": findings.OfTruth(0.005, 3e-4)}
    robot = series(initial_std={"gyro_scale": 4e-3})
    found = findings._of_scale("track", parts, robot, yaw(estimate=lambda name: (-0.005, 3e-4)), told)
    assert [a.effect for a in found.alternatives] == rivals


def test_a_law_is_the_one_that_encoders_and_truth_tell_together() -> None:
    told = truth(0.0, 0.0, 0.02)
    told.values["bias"], told.stds["bias"] = 0.2, 0.02  # type: ignore[index]
    told = replace(told, of_laws=np.array([[0.02**2]]))
    covariance = np.array([[0.1**2, 0.8 * 0.1 * 0.3], [0.8 * 0.1 * 0.3, 0.3**2]])
    found = yaw(
        chosen=("bias", "asymmetry"),
        of_bias=("bias",),
        covariance=covariance,
        estimate=lambda name: (0.5, 0.1) if name == "bias" else (2.0, 0.3),
    )
    found.beside = partial(YawAnswer.beside, found)  # type: ignore[method-assign]
    assert findings.joint_estimate(found, told, "bias") == pytest.approx((0.7, 0.02))
    # As a measurement of the bias alone by the truth would have it, of which 0.7 +- 0.02 is what both know.
    seen = np.array([1.0, 0.0])
    precision = 0.02**-2 - 0.1**-2
    measured = (0.7 * 0.02**-2 - 0.5 * 0.1**-2) / precision
    both = np.linalg.inv(np.linalg.inv(covariance) + precision * np.outer(seen, seen))
    mean = both @ (np.linalg.inv(covariance) @ [0.5, 2.0] + precision * measured * seen)
    assert findings.joint_estimate(found, told, "asymmetry") == pytest.approx((mean[1], np.sqrt(both[1, 1])))
    assert findings.joint_estimate(found, replace(told, mirrored=True), "bias") == (0.5, 0.1)


def test_a_bias_that_differs_between_the_parts_of_a_drive_differs_by_what_the_truth_tells() -> None:
    rng = np.random.default_rng(5)
    # The truth tells all of the parts but one mixture of them, of which it knows nothing.
    spread = np.diag([0.02, 0.01, 0.03, 0.02, 0.01, 0.02, 0.03]) ** 2
    mixture = np.ones(7) / np.sqrt(7.0)
    covariance = spread + 1e6 * np.outer(mixture, mixture)
    errors = rng.multivariate_normal(np.zeros(7), spread, 400) + 1e3 * rng.normal(size=(400, 1)) * mixture
    for true in (0.0, 0.1):
        bias = true * rng.normal(size=(400, 8))
        parts = bias[:, :-1] - bias.mean(axis=1, keepdims=True) + errors
        found = [bias_moves(one, covariance) for one in parts]
        assert np.sqrt(np.mean(np.square(found))) == pytest.approx(true, abs=0.01)
