"""Diagnosis of drive logs: hidden physics is named with its size, nothing is named where nothing is, intervals cover."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import lfilter

from gyrocal.diagnosis.drive.alignment import align
from gyrocal.diagnosis.drive.checks import missing_rows, uneven_clock, wrong_truth
from gyrocal.diagnosis.drive.engine import DriveDiagnosis, diagnose_drive, examine
from gyrocal.diagnosis.drive.laws import MOVING, candidate_laws, frame_of, law
from gyrocal.diagnosis.drive.search import examine_yaw
from gyrocal.diagnosis.drive.series import drive_series, nodes_of, tick_size
from gyrocal.diagnosis.drive.yaw import _independent, _Sources, usual_noise
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.errors import DataError
from gyrocal.physics.drive import SKID_SLIP
from gyrocal.records.drive import DriveBlock, cut
from gyrocal.records.robot import Robot, read_robot
from gyrocal.report.drive_words import drive_sentences
from gyrocal.report.remarks import remark_words, statement
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.world import SEPARATION_M, Hidden, simulate
from tests.records.whole import read_drive_log

SHARED = Path(__file__).parents[3].parent / "shared" / "data"


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    path = tmp_path / "robot.toml"
    path.write_text(f"wheel_separation_m = {SEPARATION_M}\nstatic_s = 0.0\n")
    return read_robot(path)


def found(hidden: Hidden, robot: Robot, seed: int) -> DriveDiagnosis:
    return diagnose_drive("drive.csv", simulate(hidden, seed), robot)


def test_a_row_that_comes_twice_at_one_time_says_nothing_new(robot: Robot) -> None:
    log = simulate(Hidden(), 3, duration_s=120.0)
    twice = np.repeat(np.arange(len(log)), 2)
    second = np.arange(twice.size) % 2 == 1
    columns = {
        f: getattr(log, f)[twice] for f in ("t_s", "gyro_dps", "gyro_temp_c", "truth_x_m", "truth_y_m")
    }
    columns |= {f: np.where(second, 0.0, getattr(log, f)[twice]) for f in ("left_m", "right_m")}
    pairs = DriveBlock(2, truth_heading_deg=log.truth_heading_deg[twice], **columns)
    once, both = (drive_series("drive.csv", b, robot, None) for b in (log, pairs))
    np.testing.assert_array_equal(both.moving(2.0)[~second], once.moving(2.0))
    assert both.gap.sum() == once.gap.sum()
    assert align(both) == pytest.approx(align(once), abs=1e-3)


def test_what_prudence_takes_off_a_bias_is_in_the_asymmetry_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        "wheel_separation_m = 0.5\nstatic_s = 0.0\n[initial_std]\nleft_scale = 0.01\nright_scale = 0.01\n"
    )
    # At one speed, without a rest, a drive tells a sum of bias and asymmetry, which the file must keep.
    log = drive(Plan(shape="eights", minutes=4, rest_s=0.0, bias_dps=0.1, tick_m=4e-4), 4)
    log = cut(log, slice(len(log) // 20, -len(log) // 20))
    told = diagnose_drive("drive.csv", log, read_robot(path))
    estimate = {e.name: e.value for e in told.estimates}
    assert told.robot is not None
    given_dps, wheels = told.robot.parameters.gyro.bias_dps, told.robot.parameters.encoders
    taken_off_dps = estimate["gyro_bias"] - given_dps
    assert taken_off_dps > 0.02
    given = (1 + wheels.right_scale) / (1 + wheels.left_scale) - 1
    speed_mps = float(np.mean(log.left_m + log.right_m) / 2 / np.mean(np.diff(log.t_s)))
    by_wheels_dps = np.degrees((1e-2 * estimate["wheel_asymmetry"] - given) * speed_mps / 0.5)
    assert by_wheels_dps == pytest.approx(taken_off_dps, rel=0.1)


@pytest.mark.slow
def test_a_bias_that_the_file_knows_better_than_the_drive_stays(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    given = "wheel_separation_m = 0.5\nstatic_s = 0.0\n[gyro]\nbias_dps = 0.095\n[initial_std]\nleft_scale = 0.01\nright_scale = 0.01\n"
    path.write_text(given)
    log = drive(Plan(shape="eights", minutes=4, rest_s=0.0, bias_dps=0.1, tick_m=4e-4), 4)
    guessed = diagnose_drive("drive.csv", log, read_robot(path)).robot
    path.write_text(given + "gyro_bias_dps = 0.003\n")
    known = diagnose_drive("drive.csv", log, read_robot(path)).robot
    assert guessed is not None
    assert known is not None
    assert guessed.parameters.gyro.bias_dps == pytest.approx(0.095, abs=0.03)
    assert known.parameters.gyro.bias_dps == pytest.approx(0.095, abs=0.003)
    assert known.parameters.gyro.bias_dps_std < 0.003


def test_a_drive_without_a_rest_may_tell_the_white_noise_of_its_gyro(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text("wheel_separation_m = 0.5\nstatic_s = 0.0\n")
    plan = Plan(minutes=4, rest_s=0.0, arw_dps_rt_s=0.03, tick_m=4e-4, wheel_noise=5e-4)
    noise = examine_yaw(drive_series("drive.csv", drive(plan, 3), read_robot(path), None)).model.noise
    assert noise.arw_dps_per_rt_hz == pytest.approx(0.03, rel=0.3)


def test_what_is_named_is_not_said_to_be_untestable(tmp_path: Path) -> None:
    """A bias of 2 deg/s had been named, and not testable "because the log does not begin with a rest"."""
    path = tmp_path / "robot.toml"
    path.write_text("wheel_separation_m = 0.5\nstatic_s = 0.0\n")
    log = drive(Plan(minutes=3, rest_s=0.0, bias_dps=2.0, tick_m=4e-4), 3)
    told = diagnose_drive("drive.csv", log, read_robot(path)).diagnosis
    named = {e.effect for e in told.effects}
    assert "gyro_bias" in named
    assert named.isdisjoint(told.not_testable)
    assert "wheel_scale" in told.not_testable


def names(result: DriveDiagnosis) -> list[str]:
    return [e.effect for e in result.diagnosis.effects]


@pytest.mark.parametrize(
    ("hidden", "effect", "truth"),
    [
        pytest.param(Hidden(delay_s=0.12), "gyro_delay", 0.12, marks=pytest.mark.slow),
        pytest.param(Hidden(delay_s=1.3), "gyro_delay", 1.3, marks=pytest.mark.slow),
        (Hidden(slip=0.06), "skid_slip", 6.0),
        pytest.param(Hidden(slip=-0.08), "skid_slip", -8.0, marks=pytest.mark.slow),
        (Hidden(slip=0.1, slip_exponent=1.0), "skid_slip", 10.0),
        (Hidden(asymmetry=0.006), "wheel_asymmetry", 0.6),
        (Hidden(eccentricity=0.01), "wheel_eccentricity", 1.0),
        pytest.param(Hidden(scale=0.03, gps_m=0.6), "wheel_scale", 3.0, marks=pytest.mark.slow),
    ],
)
def test_a_hidden_effect_is_named_with_its_size(
    robot: Robot, hidden: Hidden, effect: str, truth: float
) -> None:
    result = found(hidden, robot, 11)
    assert names(result) == [effect]
    # Without truth a track that is wider at every rate may as well be a scale.
    ratio = effect == "skid_slip" and not hidden.slip_exponent
    assert result.diagnosis.verdict == ("partly_explained" if ratio else "explained")
    amplitude = result.diagnosis.effects[0].parameters["amplitude"]
    # Five standard deviations: with eight cases a false alarm once in ten thousand runs of this test.
    assert abs(amplitude.value - truth) < 5 * amplitude.std + 0.02 * abs(truth)


@pytest.mark.parametrize(
    ("effects", "name", "truth"),
    [
        pytest.param({"bias_temperature": 4.0}, "bias_temperature", 4.0, marks=pytest.mark.slow),
        pytest.param({"gyro_scale": 1.5}, "gyro_scale", 15000.0, marks=pytest.mark.slow),
        pytest.param({"wheel_scale": -0.5}, "wheel_scale", -0.5, marks=pytest.mark.slow),
    ],
)
def test_rests_and_truth_tell(resting: Robot, effects: dict[str, float], name: str, truth: float) -> None:
    plan = Plan("rests", 6.0, 10.0, arw_dps_rt_s=0.001, truth_m=0.02, effects=effects)
    result = diagnose_drive("drive.csv", drive(plan, 4), resting)
    assert names(result)[0] == name
    amplitude = result.diagnosis.effects[0].parameters["amplitude"]
    assert abs(amplitude.value - truth) < 5 * amplitude.std
    assert result.robot is not None


@pytest.mark.parametrize(("bias_dps", "least", "most"), [(0.0, 0.0, 0.5), (0.5, 0.9, 1.0)])
def test_a_bias_that_means_nothing_is_hardly_told_to_the_robot(
    robot: Robot, bias_dps: float, least: float, most: float
) -> None:
    result = found(Hidden(bias_dps=bias_dps), robot, 8)
    bias = next(e for e in result.estimates if e.name == "gyro_bias")
    assert result.robot is not None
    assert least < result.robot.parameters.gyro.bias_dps / bias.value < most


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.01, 0.0025])
def test_a_slope_of_the_ground_is_no_scale_of_the_gyro(resting: Robot, share: float) -> None:
    log = drive(Plan("eights", 3.0, 10.0, tick_m=4e-4, truth_m=0.02, truth_every_s=1.0, wheel_noise=0.001), 5)
    heading = np.cumsum(np.radians(log.gyro_dps) / 10.0)
    lacking = share * (1.0 + np.cos(2.0 * heading - 0.8))
    told = diagnose_drive("drive.csv", replace(log, gyro_dps=log.gyro_dps * (1.0 - lacking)), resting)
    assert names(told) == ["robot_tilt"]
    tilt = told.diagnosis.effects[0].parameters["amplitude"]
    assert tilt.interval_95[0] < np.degrees(2.0 * np.sqrt(share)) < tilt.interval_95[1]
    assert "robot_tilt" not in told.diagnosis.not_testable
    assert told.robot is None


@pytest.mark.slow
def test_headings_alone_tell_the_scale_of_the_gyro(resting: Robot) -> None:
    plan = Plan(
        "lawn",
        5.0,
        10.0,
        tick_m=4e-4,
        truth_m=0.02,
        truth_heading_deg=0.2,
        wheel_noise=0.001,
        turn_noise=0.002,
    )
    log = drive(replace(plan, effects={"gyro_scale": 0.8}), 11)
    nowhere = np.full(len(log), np.nan)
    told = diagnose_drive("drive.csv", replace(log, truth_x_m=nowhere, truth_y_m=nowhere), resting)
    assert names(told) == ["gyro_scale"]
    scale = told.diagnosis.effects[0].parameters["amplitude"]
    assert scale.interval_95[0] < 8000.0 < scale.interval_95[1]
    assert told.robot is not None
    assert told.robot.parameters.gyro.scale == pytest.approx(0.008, abs=0.002)
    # Headings say nothing of the way.
    assert "wheel_scale" in told.diagnosis.not_testable
    assert "wheel_scale" not in [e.name for e in told.estimates]


@pytest.mark.slow
def test_a_patch_of_ground_is_told_by_its_place(resting: Robot) -> None:
    # Fifteen laps of a square, and ground that slips in one of its corners.
    rng = np.random.default_rng(12)
    lap_dps = np.tile(np.concatenate([np.zeros(80), np.full(20, 45.0)]), 4)
    lap_mps = np.concatenate([np.append(np.full(80, v), np.zeros(20)) for v in (0.3, 0.5, 0.3, 0.5)])
    corner = np.concatenate([np.zeros(380), np.full(20, 0.1)])
    rate, speed, slips = (np.concatenate([np.zeros(100), np.tile(x, 15)]) for x in (lap_dps, lap_mps, corner))
    wander = 0.02 * lfilter([np.sqrt(1 - 0.97**2)], [1, -0.97], rng.normal(size=rate.size))
    half = 0.25 * np.radians(rate) / 10.0 * (1.0 + slips + wander) + 2e-4 * rng.normal(size=rate.size)
    half[:100] = 0.0
    nothing = np.full(rate.size, np.nan)
    gyro = rate + 0.01 * rng.normal(size=rate.size)
    way = speed / 10.0
    log = DriveBlock(
        2, np.arange(rate.size) / 10.0, way - half, way + half, gyro, nothing, nothing, nothing, nothing
    )
    told = diagnose_drive("drive.csv", log, resting)
    assert "place" in [p.coordinate for p in told.diagnosis.located if p.remains]
    assert told.diagnosis.verdict in ("unexplained", "partly_explained")
    # Where no rest takes the bias off there is a file. A tenth in one corner of four is 0.043 rms about its mean, by which
    # the next drive's ground may be another.
    restless = replace(resting, parameters=replace(resting.parameters, static_s=0.0))
    found = diagnose_drive("drive.csv", log, restless).robot
    assert found is not None
    assert found.initial_std["wheel_separation_m"] / 0.5 == pytest.approx(0.043, abs=0.01)


def test_waits_between_two_ticks_are_not_taken_for_slip(resting: Robot) -> None:
    log = drive(Plan("rests", 5.0, 10.0, tick_m=1.5e-3, arw_dps_rt_s=0.002, turn_noise=0.002), 6)
    told = diagnose_drive("drive.csv", log, resting)
    assert names(told) == []
    # Two wheels, each of a step over the square root of twelve.
    assert told.yaw.model.noise.tick_m == pytest.approx(1.5e-3 / np.sqrt(6.0), rel=0.4)


def test_beside_a_wrong_track_no_delay_of_half_a_row_is_named(resting: Robot) -> None:
    log = drive(Plan("random", 6.0, 5.0, tick_m=2e-4, wheel_noise=0.001, effects={"skid_slip": 6.0}), 7)
    assert names(diagnose_drive("drive.csv", log, resting)) == ["skid_slip"]


def test_a_robot_file_that_grants_too_little_leaves_no_structure_without_a_name(tmp_path: Path) -> None:
    path = tmp_path / "firm.toml"
    path.write_text(
        "wheel_separation_m = 0.5\nstatic_s = 7.0\n[initial_std]\nleft_scale = 0.002\nright_scale = 0.002\n"
    )
    plan = Plan("straight", 5.0, 10.0, effects={"wheel_asymmetry": 1.6})
    result = diagnose_drive("drive.csv", drive(plan, 2), read_robot(path))
    assert names(result) == ["wheel_asymmetry"]
    assert result.diagnosis.verdict == "explained"


@pytest.mark.slow
def test_two_effects_at_once(robot: Robot) -> None:
    result = found(Hidden(slip=0.4, delay_s=0.1), robot, 3)
    assert sorted(names(result)) == ["gyro_delay", "skid_slip"]
    slip = next(e for e in result.diagnosis.effects if e.effect == "skid_slip")
    assert "gyro_scale" in [a.effect for a in slip.alternatives]
    for effect in result.diagnosis.effects:
        gained = effect.improvement
        assert gained is not None
        assert gained.heldout_rms_after_dps < gained.heldout_rms_before_dps
        assert gained.interval_95[0] > 0
        assert gained.heldout_rms_after_dps == pytest.approx(gained.noise_floor_dps, rel=0.25)


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1 / 57.29578, "in rad/s"),
        (-1.0, "sign inverted"),
        (-1 / 57.29578, "in rad/s and with the sign inverted"),
    ],
)
def test_wrong_unit_and_sign_are_named_and_bridged(robot: Robot, factor: float, text: str) -> None:
    result = found(Hidden(gyro_factor=factor), robot, 5)
    assert names(result) == ["unit_or_sign"]
    assert text in statement(result.diagnosis.effects[0])


@pytest.mark.slow
def test_half_a_track_is_a_slip_or_a_mix_up(tmp_path: Path) -> None:
    path = tmp_path / "half.toml"
    path.write_text(f"wheel_separation_m = {0.5 * SEPARATION_M}\nstatic_s = 0.0\n")
    result = found(Hidden(), read_robot(path), 6)
    (slip,) = result.diagnosis.effects
    assert slip.effect == "skid_slip"
    assert "unit_or_sign" in [a.effect for a in slip.alternatives]


@pytest.mark.slow
def test_a_law_that_holds_in_places_only_is_slip_that_lasts(resting: Robot) -> None:
    log = drive(Plan("lawn", minutes=5.0), 3)
    way_m = np.cumsum(0.5 * (log.left_m + log.right_m))
    rough = replace(log, right_m=log.right_m * np.where(way_m % 20.0 < 5.0, 1.02, 1.0))
    result = diagnose_drive("drive.csv", rough, resting)
    # What its parts differ by is more than its mean.
    assert names(result) == []
    # The wheels differ by 2 % for a quarter of the way: a standard deviation of 0.9 %.
    assert 0.006 < result.yaw.model.noise.wheel_wander < 0.013


@pytest.mark.slow
def test_a_ratio_of_the_headings_is_not_explained_while_the_log_cannot_tell_whose_it_is(
    resting: Robot,
) -> None:
    log = drive(Plan(minutes=5.0), 4)
    result = diagnose_drive("drive.csv", replace(log, gyro_dps=1.03 * log.gyro_dps), resting)
    assert names(result) == []
    assert result.diagnosis.verdict == "consistent"
    assert any("-2.9" in said and "cannot tell apart" in said for said in drive_sentences(result))
    # A robot file that grants no such ratio is wrong somewhere.
    std = {"initial_std.wheel_separation_m": 0.001}
    firm = diagnose_drive("drive.csv", replace(log, gyro_dps=1.03 * log.gyro_dps), resting.with_figures(std))
    assert (names(firm), firm.diagnosis.verdict) == ([], "unexplained")


def test_nothing_is_named_where_nothing_is(robot: Robot) -> None:
    result = found(Hidden(), robot, 1)
    assert result.diagnosis.verdict == "consistent"
    assert names(result) == []


def test_a_document_of_the_format(robot: Robot) -> None:
    document = found(Hidden(slip=0.2), robot, 2).diagnosis.to_json()
    assert document["schema"] == "gyrocal-diagnosis/1"
    assert document["located"][0]["coordinate"] in ("turn_rate", "curvature")
    costs = [e["metres"] for e in document["drive"]["estimates"] if e["metres"] is not None]
    assert costs == sorted(costs, reverse=True)
    assert "bias_temperature" in document["not_testable"]


@pytest.mark.slow
def test_same_log_same_answer(robot: Robot) -> None:
    one, two = (found(Hidden(slip=0.2), robot, 2).diagnosis.to_json() for _ in range(2))
    assert one == two


@pytest.mark.slow
def test_positions_tell_the_slope_of_a_bias_where_no_wheel_turns_against_another(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text("wheel_separation_m = 1.6\nstatic_s = 0.0\n")
    plan = Plan("random", 6.0, 10.0, rest_s=0.0, truth_m=0.05, effects={"bias_temperature": 20.0})
    told = diagnose_drive("car.csv", _speed_only(drive(plan, 4)), read_robot(path))
    assert names(told) == ["bias_temperature"]
    amplitude = told.diagnosis.effects[0].parameters["amplitude"]
    assert abs(amplitude.value - 20.0) < 4 * amplitude.std
    assert told.robot is not None
    # As far as it is not a drift of the bias, which its temperature went along with.
    share = 1.0 / (1.0 + told.yaw.time_odds)
    assert told.robot.parameters.gyro.bias_slope_dps_per_c == pytest.approx(share * amplitude.value / 1e3)


def _speed_only(log: DriveBlock) -> DriveBlock:
    speed = 0.5 * (log.left_m + log.right_m)
    return replace(log, left_m=speed, right_m=speed)


def test_one_speed_for_both_wheels_says_what_it_can(resting: Robot) -> None:
    plan = Plan("rests", 5.0, 10.0, truth_m=0.02, effects={"wheel_scale": 2.0})
    result = diagnose_drive("car.csv", _speed_only(drive(plan, 4)), resting)
    assert names(result) == ["wheel_scale"]
    assert {"skid_slip", "wheel_asymmetry", "gyro_delay"} <= set(result.diagnosis.not_testable)
    bias = next(e for e in result.estimates if e.name == "gyro_bias")
    assert abs(bias.value - plan.bias_dps) < 5 * bias.std


def test_encoders_that_average_are_seen(robot: Robot) -> None:
    log = simulate(Hidden(), 2)
    ten = np.ones(10) / 10
    left, right = (np.convolve(wheel, ten)[: len(log)] for wheel in (log.left_m, log.right_m))
    averaged = replace(log, left_m=left, right_m=right)
    delay_s, window_s = align(drive_series("late.csv", averaged, robot, None))
    assert window_s == pytest.approx(1.0)
    # To the middle of the window: nine of ten rows are older.
    assert delay_s == pytest.approx(-0.45, abs=0.06)


def test_laws_do_not_share_the_noise_of_the_difference(robot: Robot) -> None:
    """At rest the difference is the gyro's noise: a turn of the gyro's own noise would explain all of it."""
    log = simulate(Hidden(), 4)
    still = np.arange(len(log)) < 1000
    log = replace(log, left_m=np.where(still, 0.0, log.left_m), right_m=np.where(still, 0.0, log.right_m))
    series = drive_series("d", log, robot, None)
    frame = frame_of(series, nodes_of(series), 0.0, 0.0, 0.0)
    track = law(frame, SKID_SLIP, law=0.0, shape=0.0).column
    assert np.all(track[frame.nodes.resting] == 0.0)


def test_ticks_of_each_wheel_are_told() -> None:
    log = simulate(Hidden(), 1)
    assert tick_size(log.left_m) == 0.0
    for tick_m in (0.0002, 0.002, 0.02):
        counted = np.diff(np.round(np.cumsum(log.left_m) / tick_m), prepend=0.0) * tick_m
        # As a log in metres has it: rounded to a tenth of a micrometre.
        assert tick_size(np.round(counted, 7)) == pytest.approx(tick_m, rel=1e-4)


@pytest.mark.parametrize("sampled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_gyro_that_is_sampled_where_a_row_should_be_a_mean_is_told(resting: Robot, sampled: bool) -> None:
    log = drive(Plan(shape="random", minutes=4.0), 3)
    rows, every = log.t_s.size // 20, 20

    def by_row(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values[: rows * every].reshape(rows, every)

    gyro = by_row(log.gyro_dps)
    slow = replace(
        cut(log, slice(every - 1, rows * every, every)),
        left_m=by_row(log.left_m).sum(axis=1),
        right_m=by_row(log.right_m).sum(axis=1),
        gyro_dps=gyro[:, -1] if sampled else gyro.mean(axis=1),
    )
    told = [
        e for e in diagnose_drive("drive.csv", slow, resting).diagnosis.effects if e.effect == "gyro_delay"
    ]
    assert [e.seen for e in told] == ([Remark(Said.SAMPLES_OF_ROWS)] if sampled else [])


def test_gaps_and_jitter_are_found() -> None:
    log = simulate(Hidden(), 1)
    assert missing_rows(log.t_s) is None
    assert uneven_clock(log.t_s) is None
    holes = np.r_[0:500, 520:1500, 1560 : len(log)]
    lost = missing_rows(log.t_s[holes])
    assert lost is not None
    assert lost.seen.said is Said.MISSING_ROWS
    assert lost.seen.facts["count"] == 80
    assert lost.amplitude.value == pytest.approx(100.0 * 80 / len(log))
    # A row at the time of the row before is no step.
    doubled = missing_rows(np.repeat(log.t_s[holes], 2))
    assert doubled is not None
    assert doubled.seen.facts["count"] == 80
    rng = np.random.default_rng(1)
    uneven = uneven_clock(np.sort(log.t_s + 0.01 * rng.normal(size=len(log))))
    assert uneven is not None
    assert uneven.facts["jitter_ms"] == pytest.approx(10.0, rel=0.1)


def test_lost_gyro_samples_are_bridged(robot: Robot) -> None:
    """Taken as no turn, one in fifty lost would be a scale of two percent."""
    log = simulate(Hidden(), 1)
    lost = replace(log, gyro_dps=np.where(np.arange(len(log)) % 50 == 20, np.nan, log.gyro_dps))
    whole, holed = (drive_series("d", x, robot, None) for x in (log, lost))
    assert Remark(Said.GYRO_BRIDGED, {"count": 60}) in holed.notes
    turned = float(np.sum(np.abs(np.diff(whole.gyro_rad))))
    assert float(np.sum(np.abs(np.diff(holed.gyro_rad)))) == pytest.approx(turned, rel=2e-3)


def test_short_and_still_logs_are_refused(robot: Robot) -> None:
    log = simulate(Hidden(), 1)
    with pytest.raises(DataError, match="log at least 60 s"):
        diagnose_drive("short.csv", cut(log, slice(0, 300)), robot)
    still = replace(log, left_m=np.zeros(len(log)), right_m=np.zeros(len(log)))
    with pytest.raises(DataError, match="the wheels move less than 1 m"):
        diagnose_drive("still.csv", still, robot)


def test_a_gyro_that_says_one_thing_is_refused(robot: Robot) -> None:
    """Before: the robot file was blamed for the track that came of it."""
    log = simulate(Hidden(), 1)
    with pytest.raises(DataError, match=r"gyro_dps is 0\.1 in every row"):
        diagnose_drive("stuck", replace(log, gyro_dps=np.full(log.t_s.size, 0.1)), robot)


def test_columns_that_replay_refuses_are_refused(robot: Robot) -> None:
    log = simulate(Hidden(), 1)
    half = np.where(np.arange(len(log)) % 2, np.nan, log.gyro_dps)
    with pytest.raises(DataError, match=r"gyro_dps is empty in \d+ of"):
        diagnose_drive("half", replace(log, gyro_dps=half), robot)
    with pytest.raises(DataError, match="in kelvin"):
        diagnose_drive("hot", replace(log, gyro_temp_c=np.full(len(log), 293.15)), robot)


@pytest.mark.slow
def test_mirrored_truth_is_seen_and_correlated_errors_are_no_mirror(resting: Robot) -> None:
    plan = Plan("random", 3.0, 10.0, truth_m=0.3, truth_wander_m=0.6)
    log = drive(plan, 7)
    straight = examine("a.csv", log, resting, None)
    assert straight.truth is not None
    assert not straight.truth.mirrored
    mirrored = examine("b.csv", replace(log, truth_y_m=-log.truth_y_m), resting, None)
    assert mirrored.truth is not None
    assert mirrored.truth.mirrored
    assert Remark(Said.TRUTH_MIRRORED) in mirrored.notes


@pytest.mark.slow
def test_a_mirrored_truth_of_one_speed_is_a_wrong_sign_of_either(resting: Robot) -> None:
    log = _speed_only(drive(Plan("random", 3.0, 10.0, truth_m=0.05), 7))
    for one in (replace(log, truth_y_m=-log.truth_y_m), replace(log, gyro_dps=-log.gyro_dps)):
        found = diagnose_drive("car.csv", one, resting).diagnosis
        assert [e.effect for e in found.effects] == ["unit_or_sign"]


def test_a_truth_that_stands_still_says_nothing(resting: Robot) -> None:
    log = drive(Plan("lawn", 2.0, 10.0, truth_m=0.02, tick_m=4e-4), 3)
    rng = np.random.default_rng(3)
    stuck_m = [np.where(np.isfinite(log.truth_x_m), 0.005 * rng.normal(size=len(log)), np.nan) for _ in "xy"]
    stuck = replace(log, truth_x_m=stuck_m[0], truth_y_m=stuck_m[1])
    assert diagnose_drive("drive.csv", stuck, resting).truth is None


def in_other_units(log: DriveBlock) -> DriveBlock:
    """The log with a truth in millimetres and radians."""
    return replace(
        log,
        truth_x_m=1e3 * log.truth_x_m,
        truth_y_m=1e3 * log.truth_y_m,
        truth_heading_deg=np.deg2rad(log.truth_heading_deg),
    )


def test_truth_in_other_units_is_that_in_metres_and_degrees(resting: Robot) -> None:
    log = drive(Plan("random", 2.0, 10.0, truth_m=0.02, truth_heading_deg=0.05), 3)
    plain, notes = wrong_truth(drive_series("a.csv", log, resting, None))
    assert notes == []
    other, notes = wrong_truth(drive_series("b.csv", in_other_units(log), resting, None))
    assert [n.said for n in notes] == [Said.TRUTH_RADIANS, Said.TRUTH_UNIT]
    assert "millimetres" in remark_words(notes[1])
    for name in ("truth_x_m", "truth_y_m", "truth_heading_deg"):
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), rtol=1e-12)


@pytest.mark.slow
def test_truth_in_other_units_is_taken_as_such(resting: Robot) -> None:
    plan = Plan("random", 2.0, 10.0, truth_m=0.02, truth_heading_deg=0.05)
    log = drive(plan, 3)
    plain = diagnose_drive("a.csv", log, resting)
    other = diagnose_drive("b.csv", in_other_units(log), resting)
    assert Remark(Said.TRUTH_RADIANS) in other.diagnosis.notes
    assert [n for n in map(remark_words, other.diagnosis.notes) if "millimetres" in n]
    assert plain.truth is not None
    assert other.truth is not None
    assert other.truth.values["wheel_scale"] == pytest.approx(plain.truth.values["wheel_scale"], abs=1e-6)


@pytest.mark.slow
def test_what_was_found_makes_the_path_better_elsewhere(resting: Robot) -> None:
    plan = Plan(
        "rests",
        6.0,
        10.0,
        arw_dps_rt_s=0.001,
        truth_m=0.02,
        effects={"gyro_scale": 1.5, "bias_temperature": 5.0},
    )
    other = Plan("lawn", 4.0, 10.0, arw_dps_rt_s=0.001, truth_m=0.01, effects=plan.effects)
    result = diagnose_drive("a.csv", drive(plan, 1), resting, others=[("b.csv", drive(other, 2))])
    (shown,) = result.shown
    assert shown.log == "b.csv"
    assert shown.after_m < 0.3 * shown.before_m


@pytest.mark.slow
def test_what_is_wrong_with_another_log_is_said(resting: Robot) -> None:
    plan = Plan("rests", 6.0, 10.0, arw_dps_rt_s=0.001, truth_m=0.02, effects={"gyro_scale": 1.5})
    sound = drive(plan, 2)
    mirrored = replace(sound, truth_y_m=-sound.truth_y_m, truth_heading_deg=-sound.truth_heading_deg)
    inverted = replace(sound, gyro_dps=-sound.gyro_dps)
    others = [("b.csv", mirrored), ("c.csv", inverted), ("d.csv", sound)]
    result = diagnose_drive("a.csv", drive(plan, 1), resting, others=others)
    wrong = [[note.said for note in shown.wrong] for shown in result.shown]
    assert wrong == [[Said.TRUTH_MIRRORED], [Said.GYRO_COLUMN], []]
    assert np.isnan(result.shown[0].before_m)
    assert any("Of b.csv: the truth follows the path in a mirror" in line for line in drive_sentences(result))


@pytest.mark.slow
def test_intervals_cover(robot: Robot) -> None:
    """Track and asymmetry of ten short drives: a collapsed interval would show at once."""
    covered, trials = 0, 0
    rng = np.random.default_rng(9)
    for seed in range(10):
        slip, asymmetry = 0.02 * rng.normal(), 0.003 * rng.normal()
        log = simulate(Hidden(slip=slip, asymmetry=asymmetry), 700 + seed, 90.0)
        yaw = examine_yaw(drive_series("d", log, robot, None))
        for name, truth in (("track", slip), ("asymmetry", asymmetry)):
            value, std = yaw.estimate(name)
            covered += abs(value - truth) < 1.96 * std
            trials += 1
    assert covered >= stats.binom.ppf(1e-3, trials, 0.93)


def _to_and_fro(seed: int) -> DriveBlock:
    """Turns of all sizes, each the other way than that before, within a fifth of a second; a rest at both ends and between."""
    rng = np.random.default_rng(seed)
    rows, dt_s = 6000, 0.05
    t_s = dt_s * np.arange(float(rows))
    moving = (np.abs(t_s - 75.0) < 55.0) | (np.abs(t_s - 210.0) < 70.0)
    turn = np.searchsorted(np.cumsum(rng.uniform(2.0, 6.0, 300)), t_s)
    rate_dps = np.where(moving, (rng.uniform(0.0, 30.0, 400) * np.resize([1, -1], 400))[turn], 0.0)
    rate_dps = np.where(moving, np.convolve(rate_dps, np.full(4, 0.25), "same"), 0.0)
    way_m = np.where(moving, 0.3 + 0.1 * (turn % 7), 0.0) * dt_s
    slip_deg = 0.5 * np.sqrt(np.abs(rate_dps) * dt_s) * rng.standard_normal(rows)
    half_m = 0.25 * np.deg2rad(rate_dps * dt_s + slip_deg) + np.diff(rng.normal(0.0, 1e-5, rows), prepend=0.0)
    nothing = np.full(rows, np.nan)
    gyro_dps = rate_dps + rng.normal(0.0, 0.05, rows)
    return DriveBlock(2, t_s, way_m - half_m, way_m + half_m, gyro_dps, nothing, nothing, nothing, nothing)


def test_turns_to_and_fro_within_an_interval_slip_like_others(resting: Robot) -> None:
    """And the level of that is found beside the many laws that a bias in motion may follow after a rest."""
    log = _to_and_fro(1)
    yaw = examine_yaw(drive_series("d", log, resting, None))
    assert yaw.model.noise.turn == pytest.approx(0.5 * np.sqrt(np.pi / 180.0), rel=0.05)
    assert not yaw.named
    nodes = yaw.model.frame.nodes
    turned, net = (
        nodes.between(np.cumsum(np.deg2rad(x) * 0.05)) for x in (np.abs(log.gyro_dps), log.gyro_dps)
    )
    to_and_fro = (turned > np.deg2rad(0.2)) & (np.abs(net) < 0.2 * turned)
    assert np.count_nonzero(to_and_fro) > 3
    # What a law does to such an interval is smooth over a few rows.
    assert np.all(yaw.model.white[to_and_fro] > 0.3 * yaw.model.noise.turn**2 * turned[to_and_fro])


def test_laws_that_differ_by_a_lag_alone_leave_columns_that_arithmetic_can_tell(resting: Robot) -> None:
    series = drive_series("d", _to_and_fro(2), resting, None)
    frame = frame_of(series, nodes_of(series), 0.0, 0.0, 0.0)
    laws = [x for name, x in candidate_laws(frame).items() if name in MOVING]
    field = _Sources.of(frame).field(usual_noise(series), np.zeros(frame.nodes.dt_s.size))
    apart = _independent(np.column_stack([*(x.column for x in laws), laws[0].column]), field)
    assert 1 < apart.shape[1] <= len(laws)
    assert field.given(apart).gram == pytest.approx(np.eye(apart.shape[1]), abs=1e-5)


@pytest.mark.parametrize("share", [0.6, pytest.param(1.0, marks=pytest.mark.slow)])
def test_the_real_drive(share: float) -> None:
    log, robot_file = SHARED / "skid_steer_drive.csv", SHARED / "skid_steer_robot.toml"
    if not log.exists():
        pytest.skip("../shared is absent")
    rows = read_drive_log(log)
    begin = cut(rows, slice(round(share * len(rows))))
    result = diagnose_drive(log.name, begin, read_robot(robot_file))
    assert names(result)[0] == "gyro_delay"
    delay = result.diagnosis.effects[0].parameters
    # By hand, from the impulse response: flat over one second, 0.39 s late.
    assert delay["encoder_window_s"].value == pytest.approx(1.0)
    assert delay["amplitude"].value == pytest.approx(-0.39, abs=0.02)
    assert result.diagnosis.verdict == "partly_explained"


@pytest.mark.slow
def test_false_names_and_strangers_over_many_drives(robot: Robot) -> None:
    trials = 60
    false_names = sum(bool(names(found(Hidden(), robot, 100 + i))) for i in range(trials))
    assert false_names <= stats.binom.ppf(0.999, trials, 0.02)
    results = [found(Hidden(slip=0.06), robot, 500 + i) for i in range(trials)]
    inside = [r for r in results if names(r) == ["skid_slip"]]
    assert len(inside) >= 0.9 * trials
    covered = 0
    for result in inside:
        low, high = result.diagnosis.effects[0].parameters["amplitude"].interval_95
        covered += low <= 6.0 <= high
    assert covered >= stats.binom.ppf(1e-3, len(inside), 0.92)


def test_a_turn_of_one_row_is_no_spike_of_the_gyro_unless_the_wheels_go_straight(robot: Robot) -> None:
    t_s = np.arange(120.0)
    rate_dps = np.where(np.arange(120) % 20 == 10, 30.0, 0.0)
    apart_m = np.radians(rate_dps) * SEPARATION_M
    gyro_dps = rate_dps + 0.01 * np.random.default_rng(3).standard_normal(120)
    gyro_dps[45] += 30.0
    nothing = np.full(120, np.nan)
    log = DriveBlock(
        2, t_s, 0.5 - apart_m / 2, 0.5 + apart_m / 2, gyro_dps, nothing, nothing, nothing, nothing
    )
    series = drive_series("drive.csv", log, robot, None)
    assert [n.facts for n in series.notes if isinstance(n, Remark) and n.said is Said.GYRO_SPIKES] == [
        {"count": 1, "largest_dps": pytest.approx(30.0, abs=0.1)}
    ]
    np.testing.assert_allclose(series.gyro_dps, rate_dps, atol=0.1)
