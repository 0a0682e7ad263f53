"""The gyro's bias on drives: short stops tell it, it may follow the motion, and 1/f noise is weighed against its laws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from gyrocal.diagnosis.drive import beside_truth, improved
from gyrocal.diagnosis.drive.beside_truth import _loss_with_jump
from gyrocal.diagnosis.drive.engine import diagnose_drive, examine
from gyrocal.diagnosis.drive.findings import joint_estimate
from gyrocal.diagnosis.drive.laws import is_motion
from gyrocal.diagnosis.drive.levels import GAIN
from gyrocal.diagnosis.drive.motions import or_nothing
from gyrocal.diagnosis.drive.reckoning import Figures, reckon
from gyrocal.diagnosis.drive.search import YawAnswer, _gain, examine_yaw
from gyrocal.diagnosis.drive.series import drive_series, nodes_of
from gyrocal.diagnosis.drive.weighing import evidence
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import Term
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.robot import Robot, read_robot, robot_of
from gyrocal.report.remarks import remark_words
from tests.diagnosis.drive.fleet import Plan, drive

NAN = np.full(6000, np.nan)
RESTS = Plan("rests", 6.0, 20.0, tick_m=2e-4, arw_dps_rt_s=0.002, bias_walk=0.0, wheel_noise=2e-4)


def turns(hz: float, rate_dps: np.ndarray) -> DriveBlock:
    """A robot that turns on the spot as its wheels say, at a row every 1/hz."""
    half = 0.25 * np.radians(rate_dps) / hz
    t = np.arange(rate_dps.size) / hz
    return DriveBlock(2, t, 0.05 / hz - half, 0.05 / hz + half, rate_dps, NAN, NAN, NAN, NAN)


def test_the_end_of_a_short_turn_is_no_spike_and_a_spike_is_one(resting: Robot) -> None:
    rng = np.random.default_rng(1)
    peaks = np.zeros(6000)
    for at in range(50, 5900, 100):
        # To 60 deg/s and back within half a second.
        peaks[at : at + 5] = [20.0, 40.0, 60.0, 40.0, 20.0]
    log = turns(10.0, peaks + 0.05 * rng.normal(size=6000))
    np.testing.assert_array_equal(drive_series("log", log, resting, None).gyro_dps, log.gyro_dps)
    spiked = log.gyro_dps.copy()
    spiked[3020] += 40.0
    mended = drive_series("log", replace(log, gyro_dps=spiked), resting, None).gyro_dps
    assert abs(mended[3020]) < 1.0
    assert np.count_nonzero(mended != spiked) == 1


def test_a_fast_robot_that_turns_on_the_spot_does_not_creep(resting: Robot) -> None:
    """Its wheels are slower there by a factor of ten, and nothing else tells the track as well as these turns do."""
    hz, legs = 20.0, 8
    up = np.minimum(np.arange(400), np.arange(400)[::-1]) / 40.0
    straight, stand = 1.5 * np.minimum(up, 1.0), np.zeros(60)
    spin_dps = 30.0 * np.minimum(np.minimum(np.arange(70), np.arange(70)[::-1]) / 5.0, 1.0)
    one = [straight, stand, np.zeros(70), stand]
    speed = np.concatenate([np.zeros(200), *one * legs])
    rate_dps = np.concatenate([np.zeros(200), *[np.zeros(400), stand, spin_dps, stand] * legs])
    rng = np.random.default_rng(3)
    half = 0.25 * np.radians(rate_dps) / hz
    wheels = (speed / hz + side * half for side in (-1.0, 1.0))
    left, right = (x + 2e-4 * rng.normal(size=x.size) * (x != 0.0) for x in wheels)
    gyro = rate_dps + 0.02 * rng.normal(size=rate_dps.size)
    nan = np.full(speed.size, np.nan)
    log = DriveBlock(2, np.arange(speed.size) / hz, left, right, gyro, nan, nan, nan, nan)
    model = examine_yaw(drive_series("log", log, resting, None)).model
    nodes = model.frame.nodes
    turned = np.abs(nodes.between(np.cumsum(rate_dps / hz))) / nodes.dt_s
    way = nodes.between(np.cumsum(speed / hz)) / nodes.dt_s
    assert not model.left_out[turned > 15.0].any()
    setting_off = (way > 0.0) & (way < 0.1)
    assert setting_off.any()
    assert model.left_out[setting_off].all()


@pytest.mark.parametrize(("tick_m", "least_s"), [(2e-4, 1.6), (1e-2, 0.7)])
def test_a_short_stop_is_a_rest_but_for_the_last_tick(tick_m: float, least_s: float, resting: Robot) -> None:
    speed = 0.5 + 0.2 * np.sin(np.arange(6000) / 70.0)
    speed[3000:3100] = 0.0
    way = tick_m * np.diff(np.floor(np.cumsum(speed / 50.0) / tick_m), prepend=0.0)
    log = DriveBlock(
        2, np.arange(6000) / 50.0, way, way * 1.01, np.sin(np.arange(6000.0)), NAN, NAN, NAN, NAN
    )
    series = drive_series("log", log, resting, None)
    stopped_s = float(np.sum(series.dt_s[series.resting]))
    assert least_s < stopped_s < least_s + 0.3
    # What a law says of it does not hang on one interval, which an event is.
    assert np.count_nonzero(nodes_of(series).resting) >= 3


@pytest.mark.parametrize("hz", [20.0, 40.0, 50.0, 80.0])
def test_motion_ends_with_the_last_row_that_moves(hz: float, resting: Robot) -> None:
    """The margin of a rest is a whole number of rows at some of these rates."""
    speed = np.full(6000, 0.5)
    for at in range(500, 5500, 617):
        speed[at : at + int(3 * hz)] = 0.0
    log = DriveBlock(
        2, np.arange(6000) / hz, speed / hz, 1.01 * speed / hz, np.sin(np.arange(6000.0)), NAN, NAN, NAN, NAN
    )
    series = drive_series("log", log, resting, None)
    np.testing.assert_array_equal(series.moving(0.0), speed > 0)


@pytest.mark.slow
@pytest.mark.parametrize("of_gyro", [True, False])
def test_a_truth_tells_a_bias_in_motion_from_what_wheels_do(of_gyro: bool, resting: Robot) -> None:
    log = drive(replace(RESTS, truth_m=0.02), 8)
    moving = np.abs(log.left_m) + np.abs(log.right_m) > 0
    if of_gyro:
        log = replace(log, gyro_dps=log.gyro_dps + 0.2 * moving)
    else:
        turn_m = 0.25 * np.radians(0.2) * np.diff(log.t_s, prepend=log.t_s[0]) * moving
        log = replace(log, left_m=log.left_m + turn_m, right_m=log.right_m - turn_m)
    found = diagnose_drive("log", log, resting)
    bias = 0.0 if found.robot is None else found.robot.parameters.gyro.bias_moving_dps
    if of_gyro:
        assert [e.effect for e in found.diagnosis.effects] == ["gyro_bias"]
        assert bias == pytest.approx(0.2, abs=0.02)
        assert found.diagnosis.effects[0].parameters["time_constant_s"].value == 0.0
    else:
        assert "gyro_bias" not in [e.effect for e in found.diagnosis.effects]
        assert bias == 0.0
        assert found.diagnosis.verdict != "explained"
        assert "speed" in [place.coordinate for place in found.diagnosis.located]


@pytest.mark.slow
def test_at_one_speed_a_bias_in_motion_is_as_well_wheels_that_differ(resting: Robot) -> None:
    """Without a lag the two are one column but for where wheels set off: either has the name, and the other is told with it."""
    log = drive(RESTS, 8)
    moving = np.abs(log.left_m) + np.abs(log.right_m) > 0
    (effect,) = diagnose_drive(
        "log", replace(log, gyro_dps=log.gyro_dps + 0.03 * moving), resting
    ).diagnosis.effects
    assert {effect.effect, *(other.effect for other in effect.alternatives)} == {
        "gyro_bias",
        "wheel_asymmetry",
    }


def test_a_bias_that_comes_with_the_motion_is_named_and_goes_into_the_file(resting: Robot) -> None:
    log, lag_s = drive(RESTS, 8), 1.0
    moving = (np.abs(log.left_m) + np.abs(log.right_m) > 0).astype(float)
    keep = np.exp(-1.0 / 20.0 / lag_s)
    moving = lfilter([1 - keep], [1, -keep], moving)
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + 0.03 * moving), resting)
    (effect,) = found.diagnosis.effects
    assert effect.effect == "gyro_bias"
    amplitude = effect.parameters["amplitude"]
    assert amplitude.value == pytest.approx(30.0, abs=3 * amplitude.std)
    assert found.robot is not None
    gyro = found.robot.parameters.gyro
    assert gyro.bias_moving_dps == pytest.approx(0.03, abs=3 * gyro.bias_moving_dps_std)
    assert gyro.bias_motion_dps == 0.0
    # Intervals in which wheels set off or creep say nothing, and with them goes half of what tells the delay.
    assert gyro.bias_moving_s == pytest.approx(lag_s, rel=0.35)
    told = [e.name for e in found.estimates]
    assert "gyro_bias_while_moving" in told
    assert "gyro_bias_in_motion" not in told


@pytest.mark.parametrize(
    ("of_time", "seed"), [(True, 3), pytest.param(True, 4, marks=pytest.mark.slow), (False, 3)]
)
def test_a_bias_that_drifts_while_a_robot_warms_up_is_no_sure_slope(
    of_time: bool, seed: int, resting: Robot
) -> None:
    """It had a tight interval, no alternative, and the next drive began warm."""
    plan = Plan(minutes=6.0, arw_dps_rt_s=0.002, flicker_dps=2e-4, bias_walk=0.0, wheel_noise=1e-3)
    log = drive(plan, seed)
    whole_s = float(np.ptp(log.t_s))
    warm_c = 20.0 + (5.0 * log.t_s / whole_s if of_time else 4.0 * np.sin(4.0 * np.pi * log.t_s / whole_s))
    added = 0.04 * log.t_s / whole_s if of_time else 0.008 * (warm_c - 20.0)
    odd = replace(log, gyro_dps=log.gyro_dps + added, gyro_temp_c=warm_c)
    found = diagnose_drive("log", odd, resting)
    named = {e.effect: e for e in found.diagnosis.effects}
    said = [n for n in found.diagnosis.notes if isinstance(n, Remark) and n.said is Said.TEMPERATURE_OR_TIME]
    written = found.robot.parameters.gyro.bias_slope_dps_per_c if found.robot else 0.0
    if not of_time:
        assert not named["bias_temperature"].alternatives
        assert not said
        assert written == pytest.approx(0.008, abs=0.001)
        return
    if "bias_temperature" in named:
        assert [a.effect for a in named["bias_temperature"].alternatives] == ["gyro_bias"]
        assert said[0].facts["share"] == pytest.approx(1.0 / (1.0 + said[0].facts["odds"]))
    assert written < 0.9 * 0.008


@pytest.mark.slow
@pytest.mark.parametrize(("of_motion", "seed"), [(True, 1), (True, 2), (False, 21)])
def test_a_bias_in_motion_that_bends_the_whole_path_is_no_scale_of_one_side(
    of_motion: bool, seed: int, resting: Robot
) -> None:
    """The chance of what turns to one side explain is less than a float holds, as that of the bias is."""
    plan = Plan("rests", truth_m=0.02, truth_every_s=0.2, arw_dps_rt_s=0.004, flicker_dps=5e-4, bias_walk=0.0)
    log = drive(plan, seed)
    moving = (log.left_m != 0.0) | (log.right_m != 0.0)
    one_sided = np.where(log.gyro_dps > 0.0, 0.01 * log.gyro_dps, 0.0)
    odd = replace(log, gyro_dps=log.gyro_dps + (0.05 * moving if of_motion else one_sided))
    found = diagnose_drive("log", odd, resting).diagnosis
    if not of_motion:
        assert found.effects == ()
        (said,) = (n for n in found.notes if isinstance(n, Remark) and n.said is Said.SIDES_DIFFER)
        assert (
            said.facts["least"] < -1.0 < said.facts["most"] or said.facts["least"] < 1.0 < said.facts["most"]
        )
        assert said.facts["or_moving_dps"] is None
        return
    (named,) = found.effects
    assert named.effect == "gyro_bias"
    low, high = named.parameters["amplitude"].interval_95
    assert low < 50.0 < high


@pytest.mark.slow
def test_a_bias_that_jumps_is_no_slope_that_the_next_drive_has_too(resting: Robot) -> None:
    log = drive(replace(RESTS, minutes=8.0), 9)
    jumps = 0.05 * (log.t_s > 200.0)
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + jumps), resting)
    assert found.diagnosis.verdict != "explained"
    assert found.robot is None or found.robot.parameters.gyro.bias_slope_dps_per_c == 0.0


@pytest.mark.slow
def test_what_strong_one_over_f_noise_would_make_too_is_hardly_evidence(resting: Robot) -> None:
    # A step from the first rest to all others may as well be 1/f noise of that size.
    log = drive(replace(RESTS, rest_s=30.0, effects={"gyro_bias": 12.0}), 10)
    found = examine("log", log, resting, None).yaw
    told = evidence(found.model, {n: law.column for n, law in found.laws.items()}).knowing(found.known)
    beside = [n for n in found.chosen if n != "step"]
    assert told.added(beside, ["step"]) < 0.7 * told.own.added(beside, ["step"])
    # What 1/f noise does not make keeps what it gains.
    assert told.added(beside, ["delay"]) == pytest.approx(told.own.added(beside, ["delay"]), abs=0.5)


def test_coefficients_correct_every_row_of_a_log_whose_thermometer_is_slow(resting: Robot) -> None:
    """A gyro at 20 Hz beside temperatures at 1 Hz had been interpolated between one row in twenty."""
    log = drive(replace(RESTS, hz=20.0, minutes=2.0), 8)
    every, warm = np.arange(len(log)), np.linspace(20.0, 30.0, len(log))
    by_temperature = np.zeros((4, 3))
    by_temperature[0, 1] = 0.1
    bias = Surface(by_temperature, 0.0, 100.0, 25.0, 10.0)
    lag = Term("thermal_lag", {"amplitude": {"value": 1.0}, "tau_s": {"value": 30.0}}, True)
    valid = Valid((-200.0, 200.0), (-40.0, 80.0))
    plain = Coefficients({"model": "x"}, bias, 1e-12 * np.eye(12), valid)
    sparse = replace(log, gyro_temp_c=np.where(every % 20 == 0, warm, np.nan))
    for file in (plain, replace(plain, terms=(lag,))):
        found = drive_series("log", sparse, resting, file)
        whole = drive_series("log", replace(log, gyro_temp_c=warm), resting, file)
        assert not any(isinstance(n, Remark) and n.said is Said.GYRO_BRIDGED for n in found.notes)
        # By a temperature that is a second old.
        np.testing.assert_allclose(found.gyro_dps, whole.gyro_dps, atol=0.1 * 10.0 / 10.0 / 100.0)
        assert np.ptp(whole.gyro_dps - log.gyro_dps) > 0.05


@pytest.mark.slow
def test_a_bias_that_jumps_and_stays_is_located_and_no_robot_file_holds_it(resting: Robot) -> None:
    log = drive(RESTS, 8)
    jumped = replace(log, gyro_dps=log.gyro_dps + 0.05 * (log.t_s > 200.0))
    found = diagnose_drive("log", jumped, resting)
    assert found.diagnosis.verdict == "unexplained"
    (place,) = [p for p in found.diagnosis.located if p.remains]
    assert (place.coordinate, place.target) == ("time", "bias")
    shape = found.yaw.laws["jump"].shape
    assert place.low == shape["until_s"]
    assert shape["earliest_s"] <= 200.0 <= shape["latest_s"]
    assert shape["latest_s"] - shape["earliest_s"] < 60.0
    before, std = found.yaw.estimate("jump")
    assert before == pytest.approx(-0.05, abs=3 * std)
    # With the jump in the mean the noise is the gyro's own.
    assert std < 0.002
    said = " ".join(remark_words(n) for n in found.diagnosis.notes)
    assert "The gyro's bias jumps by 0.05" in said
    gyro = (resting if found.robot is None else found.robot).parameters.gyro
    assert (gyro.scale, gyro.bias_motion_dps, gyro.bias_moving_dps) == (0.0, 0.0, 0.0)
    # As it is, the same drive has none.
    assert "jump" not in examine("log", log, resting, None).yaw.chosen


@pytest.mark.parametrize("warms", [False, True])
def test_a_jump_between_two_short_rests_is_a_jump(warms: bool) -> None:
    """A bias that follows the motion by a second explains a last rest of half a second as well, and one by the temperature."""
    robot = robot_of({"wheel_separation_m": 0.5, "static_s": 0.0}, Path("restless.toml"))
    plan = replace(RESTS, shape="eights", minutes=3.0, rest_s=0.0, wheel_noise=4e-4)
    log = drive(plan, 4)
    stands_s = float(log.t_s[np.flatnonzero(np.abs(log.left_m) + np.abs(log.right_m))[-1]])
    log = cut(log, slice(0, int(np.searchsorted(log.t_s, stands_s + 0.6))))
    temp_c = log.gyro_temp_c if warms else np.full(len(log), np.nan)
    jumped = replace(log, gyro_dps=log.gyro_dps + 0.07 * (log.t_s > 100.0), gyro_temp_c=temp_c)
    found = examine("log", jumped, robot, None).yaw
    assert "jump" in found.chosen
    assert "asymmetry" not in found.named
    assert not any(is_motion(n) for n in found.chosen)
    shape = found.laws["jump"].shape
    assert shape["earliest_s"] <= 100.0 <= shape["latest_s"]


@pytest.mark.slow
def test_a_jump_that_encoders_cannot_show_is_seen_by_the_truth(resting: Robot) -> None:
    plan = replace(RESTS, shape="random", wheel_noise=0.01, turn_noise=0.05, truth_m=0.01)
    log = drive(plan, 8)
    jumped = replace(log, gyro_dps=log.gyro_dps + 0.02 * (log.t_s > 180.0))
    nothing = np.full(len(log), np.nan)
    unseen = examine("log", replace(jumped, truth_x_m=nothing, truth_y_m=nothing), resting, None)
    assert "jump" not in unseen.yaw.chosen
    found = diagnose_drive("log", jumped, resting)
    assert "time" in [p.coordinate for p in found.diagnosis.located if p.remains]
    assert found.diagnosis.effects == ()
    shape = found.yaw.laws["jump"].shape
    assert shape["earliest_s"] <= 180.0 <= shape["latest_s"]
    before, std = joint_estimate(found.yaw, found.truth, "jump")
    assert before == pytest.approx(-0.02, abs=3 * std)
    assert std < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("added_dps", [0.0, 0.05])
def test_the_truth_tells_a_bias_in_motion_of_a_vehicle_of_one_speed(added_dps: float, resting: Robot) -> None:
    log = drive(replace(RESTS, truth_m=0.02), 8)
    moving = np.abs(log.left_m) + np.abs(log.right_m) > 0
    way_m = 0.5 * (log.left_m + log.right_m)
    log = replace(
        log, left_m=way_m, right_m=way_m, speed_only=True, gyro_dps=log.gyro_dps + added_dps * moving
    )
    found = diagnose_drive("log", log, resting)
    if added_dps == 0.0:
        assert found.diagnosis.verdict == "consistent"
        return
    (effect,) = found.diagnosis.effects
    assert effect.effect == "gyro_bias"
    amplitude = effect.parameters["amplitude"]
    assert amplitude.value == pytest.approx(50.0, abs=3 * amplitude.std)
    assert found.robot is not None
    assert found.robot.parameters.gyro.bias_moving_dps == pytest.approx(0.05, abs=0.005)
    assert found.diagnosis.verdict == "explained"


@pytest.mark.slow
def test_a_bias_in_motion_bends_a_path_that_is_nearly_exact(tmp_path: Path) -> None:
    """Skidding wheels hide it, and what it leaves of the path is odd over everything, surer than its figure is."""
    path = tmp_path / "rested.toml"
    path.write_text("wheel_separation_m = 0.5\nstatic_s = 40.0\n[initial_std]\ngyro_bias_dps = 0.0004\n")
    plan = Plan(
        "rests", 6.0, 20.0, rest_s=45.0, arw_dps_rt_s=0.0009, bias_walk=0.0, turn_noise=0.02, wheel_noise=0.002,
        truth_m=0.0027, truth_every_s=0.1, truth_heading_deg=0.3,
    )  # fmt: skip
    log = drive(plan, 3)
    moving = np.abs(log.left_m) + np.abs(log.right_m) > 0
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps - 0.004 * moving), read_robot(path))
    (effect,) = found.diagnosis.effects
    assert effect.effect == "gyro_bias"
    amplitude = effect.parameters["amplitude"]
    assert amplitude.value == pytest.approx(-4.0, abs=3 * amplitude.std)
    assert amplitude.std < 0.5


@pytest.mark.parametrize("share", [1.0, 0.25, 0.0])
def test_a_bias_that_a_drive_hardly_tells_is_believed_as_far_as_it_helps(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever share of what the file grants the bias has, and little more than the estimate where that is at its best."""
    granted_dps, error_dps = 0.02, 0.03
    rng = np.random.default_rng(4)
    std_dps = (granted_dps**-2 + error_dps**-2) ** -0.5
    bias_dps = share * granted_dps * rng.normal(size=4000)
    estimates = (bias_dps + error_dps * rng.normal(size=4000)) * (std_dps / error_dps) ** 2
    answer = SimpleNamespace(known={"bias": (0.0, granted_dps)})
    believed = []
    for one in estimates:
        monkeypatch.setattr(improved, "joint_estimate", lambda *_, one=one: (float(one), std_dps))
        believed.append(improved.believed_bias(cast(YawAnswer, answer), None))
    errs, of_file, of_estimate = (
        float(np.sqrt(np.mean((x - bias_dps) ** 2))) for x in (np.array(believed), 0.0, estimates)
    )
    assert errs < 1.15 * max(of_file, 0.1 * error_dps)
    assert errs < 1.15 * of_estimate


@pytest.mark.slow
@pytest.mark.parametrize("sticks", [True, False])
def test_without_a_truth_a_wheel_that_sticks_is_no_bias_of_the_gyro(sticks: bool, resting: Robot) -> None:
    log = drive(RESTS, 8)
    way_m = 0.5 * (log.left_m + log.right_m)
    moving = np.abs(log.left_m) + np.abs(log.right_m) > 0
    slow = np.convolve(way_m, np.full(20, 0.05), "same") < 0.7 * np.quantile(way_m, 0.9)
    left_m = np.where(slow & sticks, 0.99 * log.left_m, log.left_m)
    shaken = replace(log, left_m=left_m, gyro_dps=log.gyro_dps + 0.05 * moving)
    found = examine("log", shaken, resting, None).yaw
    if sticks:
        assert "speed" in found.odd
        assert not any(n == "step" or n.startswith("moving") for n in found.named)
    else:
        assert "moving_0" in found.named


@pytest.mark.parametrize(
    ("slope", "seeds"),
    [
        pytest.param(0.0, range(8), marks=pytest.mark.slow),
        pytest.param(1.5, range(1), marks=pytest.mark.slow),
    ],
)
def test_encoders_and_truth_together_show_a_bias_that_neither_shows(
    slope: float, seeds: range, tmp_path: Path
) -> None:
    path = tmp_path / "rough.toml"
    path.write_text("wheel_separation_m = 0.5\nstatic_s = 0.0\n")
    robot = read_robot(path)
    plan = Plan(
        "random", 10.0, 10.0, rest_s=0.0, arw_dps_rt_s=0.001, bias_walk=0.0, turn_noise=0.02, wheel_noise=0.005,
        truth_m=0.005, truth_heading_deg=0.2, effects={"bias_temperature": slope},
    )  # fmt: skip
    for seed in seeds:
        log = drive(plan, seed)
        nothing = np.full(len(log), np.nan)
        alone = examine(
            "log", replace(log, truth_x_m=nothing, truth_y_m=nothing, truth_heading_deg=nothing), robot, None
        )
        assert "slope" not in alone.yaw.named
        found = diagnose_drive("log", log, robot)
        names = [e.effect for e in found.diagnosis.effects]
        if slope == 0.0:
            assert names == []
            continue
        assert names == ["bias_temperature"]
        amplitude = found.diagnosis.effects[0].parameters["amplitude"]
        assert amplitude.value == pytest.approx(slope, abs=3 * amplitude.std)
        assert amplitude.std < 0.25 * slope
        assert found.robot is not None
        gyro = found.robot.parameters.gyro
        # As far as it is not a drift of the bias.
        share = 1.0 / (1.0 + found.yaw.time_odds)
        slope_dps, slope_std_dps = or_nothing(1e-3 * amplitude.value, 1e-3 * amplitude.std, share)
        assert gyro.bias_slope_dps_per_c == pytest.approx(slope_dps)
        assert gyro.bias_slope_dps_per_c_std == pytest.approx(slope_std_dps)


@pytest.mark.slow
def test_laws_of_the_bias_that_hide_each_other_are_found_together(resting: Robot) -> None:
    """A step up as the drive begins, and a slope down as the gyro warms: either alone gains nothing."""
    plan = Plan(
        "lawn", 10.0, 20.0, rest_s=30.0, tick_m=2e-4, arw_dps_rt_s=0.0005, bias_walk=0.0, wheel_noise=2e-4
    )
    effects = {"gyro_bias": 12.0, "bias_temperature": -3.0}
    found = examine("log", drive(replace(plan, effects=effects), 3), resting, None).yaw
    assert {"step", "slope"} <= set(found.named)
    for name, amplitude in (("step", 0.012), ("slope", -0.003)):
        value, std = found.estimate(name)
        assert value == pytest.approx(amplitude, abs=3.0 * std)
        assert _gain(found.told, [n for n in found.chosen if n not in ("step", "slope")], name) < GAIN


@pytest.mark.slow
def test_an_instant_outside_of_a_log_is_no_jump(resting: Robot) -> None:
    log = drive(replace(RESTS, truth_m=0.02), 8)
    found = examine("log", log, resting, None)
    assert found.truth is not None
    begin_s, end_s = log.t_s[0], log.t_s[-1]
    for at_s in (begin_s - 5.0, begin_s, begin_s + 1e-3, end_s, end_s + 5.0):
        assert _loss_with_jump(found.series, found.yaw, found.truth, at_s) == np.inf
    assert np.isfinite(_loss_with_jump(found.series, found.yaw, found.truth, 0.5 * (begin_s + end_s)))


@pytest.mark.slow
def test_a_gyro_that_lacks_turns_in_one_place_has_no_scale(resting: Robot) -> None:
    """As on a slope: seen by the truth, and by the encoders where the truth is too coarse to tell where."""
    plan = replace(RESTS, shape="eights", minutes=5.0, truth_m=0.02, truth_heading_deg=0.2)
    log = drive(plan, 8)
    found = examine("log", log, resting, None)
    assert found.truth is not None
    east_m = reckon(found.series, Figures()).at_m.real
    slope = east_m > np.median(east_m)
    tilted = replace(log, gyro_dps=np.where(slope, 0.98, 1.0) * log.gyro_dps)
    answer = diagnose_drive("log", tilted, resting)
    # Where the place begins no column does: what is left there looks like a delay of a millisecond.
    assert {e.effect for e in answer.diagnosis.effects} <= {"gyro_delay"}
    assert answer.robot is None or abs(answer.robot.parameters.gyro.delay_s) < 2e-3
    assert answer.robot is None or answer.robot.parameters.gyro.scale == 0.0
    assert "place" in [p.coordinate for p in answer.diagnosis.located if p.remains]
    scaled = diagnose_drive("log", replace(log, gyro_dps=0.98 * log.gyro_dps), resting)
    assert [e.effect for e in scaled.diagnosis.effects] == ["gyro_scale"]


@pytest.mark.slow
def test_a_slip_that_one_curvature_shows_is_no_structure_without_a_name(resting: Robot) -> None:
    """All turns of squares are alike, so that columns without a name do what the law does."""
    plan = replace(RESTS, shape="square", minutes=10.0)
    log = drive(replace(plan, effects={"skid_slip": -30.0, "exponent": 2.0}), 8)
    found = diagnose_drive("log", log, resting)
    assert "skid_slip" in [e.effect for e in found.diagnosis.effects]


@pytest.mark.slow
def test_a_jump_is_tried_beside_a_bias_in_motion(resting: Robot) -> None:
    """A wheel that grows looks like either: what a tried jump says of the lag of the motion was asked of laws without it."""
    plan = Plan(
        "random", 8.0, 20.0, rest_s=10.0, tick_m=2e-4, arw_dps_rt_s=0.002, bias_walk=0.0, wheel_noise=5e-4,
        truth_m=0.3, truth_heading_deg=0.2,
    )  # fmt: skip
    log = drive(plan, 1)
    late = np.arange(len(log)) > len(log) // 2
    robot = robot_of({"wheel_separation_m": plan.separation_m, "static_s": 10.0}, resting.source)
    found = examine("log", replace(log, left_m=np.where(late, 1.01, 1.0) * log.left_m), robot, None)
    assert "time" in found.yaw.odd


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "truth_m"),
    [
        ("square", 0.0),
        ("square", 0.02),
        ("lawn", 0.0),
    ],
)
def test_a_wheel_that_changes_is_no_bias(shape: str, truth_m: float) -> None:
    """Told since when and by how much; at a steady speed a bias that comes and goes looks much like it."""
    plan = Plan(
        shape, 8.0, 20.0, rest_s=10.0, tick_m=2e-4, arw_dps_rt_s=0.002, bias_walk=0.0, wheel_noise=5e-4,
        truth_m=truth_m,
    )  # fmt: skip
    log = drive(plan, 1)
    from_s = float(log.t_s[len(log) // 2])
    robot = robot_of({"wheel_separation_m": plan.separation_m, "static_s": 10.0}, Path("robot.toml"))
    wheels = replace(log, left_m=np.where(log.t_s > from_s, 1.01, 1.0) * log.left_m)
    found = diagnose_drive("log", wheels, robot)
    assert not found.diagnosis.effects
    assert found.diagnosis.verdict == "unexplained"
    assert [
        (p.target, abs(float(p.low or 0.0) - from_s) < 2.0) for p in found.diagnosis.located if p.low
    ] == [("wheels", True)]
    notes = [n for n in found.diagnosis.notes if not isinstance(n, str)]
    told = next(n for n in notes if n.said is Said.WHEELS_CHANGE)
    assert told.facts["least"] < -1.0 < told.facts["most"]
    # Who goes further on the left turns further to the right.
    track = next(n for n in notes if n.said is Said.TRACK_CHANGES)
    assert 0.0 < track.facts["least"] < 0.5 < track.facts["most"]
    assert found.robot is None
    assert "the distance counted by the right wheel" in remark_words(told)


@pytest.mark.slow
def test_a_gyro_that_errs_by_heading_is_told_as_such(resting: Robot) -> None:
    """As one in the field of the earth: a bias of another size on each leg of a square."""
    log = drive(replace(RESTS, shape="square", truth_m=0.02, truth_heading_deg=0.1), 4)
    heading = np.cumsum(np.radians(log.gyro_dps) * np.diff(log.t_s, prepend=log.t_s[0]))
    found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + 0.03 * np.cos(heading)), resting)
    assert found.diagnosis.verdict != "explained"
    assert "heading" in [p.coordinate for p in found.diagnosis.located if p.remains]


@pytest.mark.slow
def test_what_errs_to_one_side_has_no_scale(resting: Robot) -> None:
    """Another path turns more to the other side."""
    log = drive(replace(RESTS, shape="random", truth_m=0.02, truth_heading_deg=0.2), 8)
    one_sided = replace(log, gyro_dps=np.where(log.gyro_dps > 0.0, 1.009, 1.0) * log.gyro_dps)
    found = diagnose_drive("log", one_sided, resting)
    assert "gyro_scale" not in [e.effect for e in found.diagnosis.effects]
    assert "turn_rate" in [p.coordinate for p in found.diagnosis.located if p.remains]
    assert found.robot is not None
    gyro = found.robot.parameters.gyro
    assert gyro.asymmetry == pytest.approx(0.009, abs=4.0 * gyro.asymmetry_std)
    assert gyro.scale == pytest.approx(0.0045, abs=4.0 * gyro.scale_std)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(4, 6), range(4, 14)])
def test_a_wheel_that_changes_slowly_steers_no_bias(seeds: range) -> None:
    """Without a rest a bias is told by the wheels alone, and has to hold beside what goes with the time.

    Of ten such drives the bias errs 0.7 times as much as without that.
    """
    plan = Plan(
        "lawn", 8.0, 20.0, rest_s=0.0, tick_m=2e-4, arw_dps_rt_s=0.003, bias_walk=0.0, wheel_noise=5e-4,
        bias_dps=0.1,
    )  # fmt: skip
    robot = robot_of({"wheel_separation_m": plan.separation_m, "static_s": 0.0}, Path("robot.toml"))
    off, steered = [], []
    for seed in seeds:
        log = drive(plan, seed)
        grown = 1.0 + 0.01 * np.clip((log.t_s - 150.0) / 240.0, 0.0, 1.0)
        found = examine("log", replace(log, left_m=grown * log.left_m), robot, None).yaw
        value, std = found.estimate("bias")
        assert abs(value - plan.bias_dps) < 2.5 * std
        off.append(value - plan.bias_dps)
        steered.append(found.gram.solve(found.chosen)[0][found.chosen.index("bias")] - plan.bias_dps)
    assert np.abs(off).sum() < (0.8 if len(seeds) > 2 else 0.7) * np.abs(steered).sum()


@pytest.mark.slow
def test_a_wheel_that_sticks_when_slow_leaves_a_bias_without_a_rest_open() -> None:
    """Its bias is known no better than what goes over the speed leaves it; track and wheels keep their mean over the drive."""
    plan = Plan(
        "random", 8.0, 20.0, rest_s=0.0, tick_m=2e-4, arw_dps_rt_s=0.003, bias_walk=0.0, wheel_noise=5e-4
    )
    robot = robot_of({"wheel_separation_m": plan.separation_m, "static_s": 0.0}, Path("robot.toml"))
    log = drive(plan, 3)
    way_m = 0.5 * (log.left_m + log.right_m)
    slow = np.convolve(way_m, np.full(20, 0.05), "same") < 0.8 * np.quantile(way_m, 0.9)
    stuck = replace(log, left_m=np.where(slow, 0.97 * log.left_m, log.left_m))
    found = examine("log", stuck, robot, None).yaw
    assert "speed" in found.odd
    assert any(n.startswith("speed:") for n in found.nameless)
    covariance = found.gram.solve(found.chosen)[1]
    value, std = found.estimate("bias")
    assert std > 1.1 * np.sqrt(covariance[0, 0])
    assert abs(value) < 3.0 * std
    # The wheels' figures beside that bias are those that the drive has without the columns of the speed.
    told = found.gram.knowing({"bias": (value, 1e-9)})
    mean = told.solve(found.chosen)[0][found.chosen.index("asymmetry")]
    assert found.estimate("asymmetry")[0] == pytest.approx(mean, abs=0.1 * abs(mean))


@pytest.mark.slow
def test_a_bias_that_settles_is_no_step_that_the_next_drive_has(resting: Robot) -> None:
    plan = replace(RESTS, shape="random", rest_s=30.0)
    log = drive(plan, 5)
    log = replace(log, gyro_temp_c=np.full(len(log), np.nan))
    settled = np.arctan((log.t_s - log.t_s[0]) / 100.0)
    for bias_dps, lasts in ((0.05 * settled, False), (0.2 * (log.t_s - log.t_s[0] > 30.0), True)):
        found = diagnose_drive("log", replace(log, gyro_dps=log.gyro_dps + bias_dps), resting)
        assert [e.effect for e in found.diagnosis.effects] == (["gyro_bias"] if lasts else [])
        assert found.diagnosis.verdict == ("explained" if lasts else "unexplained")
        assert ("time" in [p.coordinate for p in found.diagnosis.located if p.remains]) != lasts
        written = found.robot is not None and found.robot.parameters.gyro.bias_motion_dps != 0.0
        assert written == lasts


@pytest.mark.slow
@pytest.mark.parametrize("warm_dps", [0.0, 0.3])
def test_a_bias_in_motion_is_no_wheel_that_differs_where_it_ends_before_the_last_tick(
    warm_dps: float, resting: Robot
) -> None:
    """A robot that creeps to a stand no longer shakes its gyro, and one that was just switched on warms up meanwhile."""
    rng, hz = np.random.default_rng(5), 20.0
    t = np.arange(0.0, 420.0, 1.0 / hz)
    goal = np.zeros(t.size)
    for begin_s, cruise_mps in zip(range(30, 400, 30), [0.5, 1.0, 0.7, 1.2, 0.4, 0.9] * 3, strict=False):
        goal[(t >= begin_s) & (t < begin_s + 26.0)] = cruise_mps
    # Wheels come to stand as a first-order lag has it, and the last millimetres take long.
    speed_mps = lfilter([0.15], [1.0, -0.85], goal)
    turn_dps = 12.0 * np.sin(t / 4.0) * (speed_mps > 0.3)
    added_dps = 0.1 * (speed_mps > 0.05) + warm_dps * np.exp(-t / 80.0)
    white_dps = 0.004 * np.sqrt(hz) * rng.normal(size=t.size)
    half_m = 0.5 * resting.wheel_separation_m * np.radians(turn_dps) / hz
    ways_m = []
    for way_m in (speed_mps / hz - half_m, speed_mps / hz + half_m):
        slipped_m = way_m + 6e-4 * np.sqrt(np.abs(way_m)) * rng.normal(size=t.size)
        ways_m.append(2e-4 * np.diff(np.floor(np.cumsum(slipped_m) / 2e-4), prepend=0.0))
    none = np.full(t.size, np.nan)
    gyro_dps = turn_dps + added_dps + white_dps
    log = DriveBlock(2, t, ways_m[0], ways_m[1], gyro_dps, none, none, none, none)
    found = diagnose_drive("log", log, resting)
    effects = {e.effect: e for e in found.diagnosis.effects}
    assert "gyro_bias" in effects
    assert "wheel_asymmetry" not in effects
    amplitude = effects["gyro_bias"].parameters["amplitude"]
    assert amplitude.value == pytest.approx(100.0, abs=3 * amplitude.std)
    assert amplitude.std < 20.0
    asymmetry = next(e for e in found.estimates if e.name == "wheel_asymmetry")
    assert abs(asymmetry.value) < 3 * asymmetry.std


class _Laws:
    """Laws of the bias as `_with_laws` takes and drops them, with what each is worth."""

    laws = ("slope", "step")
    uneven: frozenset[str] = frozenset()

    def __init__(self, named: dict[str, float]) -> None:
        self.named = named

    @property
    def chosen(self) -> tuple[str, ...]:
        return tuple(self.named)

    def less(self, names: list[str]) -> _Laws:
        return _Laws({n: g for n, g in self.named.items() if n not in names})

    def with_law(self, name: str, gain: float) -> _Laws:
        return _Laws({**self.named, name: gain})


@pytest.mark.parametrize(("beside", "stays"), [(10.0, True), (4.0, False)])
def test_a_law_that_was_found_first_stays_beside_another_that_leaves_it_20_to_1(
    beside: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slope that the encoders show, and a step that the truth adds: with the step alone that held the share of both."""

    def gain(series: object, yaw: _Laws, truth: object, name: str) -> tuple[float, object]:
        return ({"step": 40.0, "slope": beside}[name], truth)

    monkeypatch.setattr(beside_truth, "_with_truth", gain)
    monkeypatch.setattr(beside_truth, "_asked", lambda series, yaw, near: near)
    found, _ = beside_truth._with_laws(
        cast("Any", SimpleNamespace(differential=True)),
        cast("Any", _Laws({"slope": 20.0})),
        cast("Any", "truth"),
    )
    assert set(found.named) == ({"slope", "step"} if stays else {"step"})
