"""The first look at a log: counts, and refusals of channels that cannot be right."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrocal.errors import DataError
from gyrocal.navigation.channels import check
from gyrocal.navigation.replay import replay_log
from gyrocal.navigation.survey import Survey, survey
from gyrocal.navigation.yaw import compare_yaw
from gyrocal.records.drive import UNUSED_STEERING, DriveBlock
from gyrocal.records.drive_log import iterate_drive_log
from gyrocal.units import DEG_TO_RAD
from tests.diagnosis.drive.fleet import Plan
from tests.diagnosis.drive.fleet import drive as fleet_drive
from tests.navigation.drives import BAD, drive, robot, source


def assert_same(a: Survey, b: Survey) -> None:
    for name, value in vars(a).items():
        if name != "source":
            np.testing.assert_allclose(getattr(b, name), value, err_msg=name, atol=1e-9)


@settings(max_examples=12)
@given(chunk_rows=st.integers(4, 500))
def test_blocks_of_any_size_give_the_same_survey(chunk_rows: int) -> None:
    log = drive()
    whole = survey("log", [log])
    assert_same(whole, survey("log", source(log, chunk_rows).blocks()))


def test_a_count_that_is_missing_is_said_and_its_way_kept(tmp_path: Path) -> None:
    log, counts = tmp_path / "drive.csv", [*range(0, 400, 10)]
    rows = [f"{0.1 * k:.1f},{n if k != 20 else 'nan'},{n},0.0" for k, n in enumerate(counts)]
    log.write_text("t_s,left_ticks,right_ticks,gyro_dps\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = survey("drive", iterate_drive_log(log, (0.001, 0.001), chunk_rows=15))
    assert found.late_counts == 1
    assert "1 row without a count of the wheels, whose way stands in the next one that has" in found.notes()
    assert found.distance_m == pytest.approx(0.39)


def test_what_is_missing_is_counted() -> None:
    log = drive()
    gyro, left, t_s = log.gyro_dps.copy(), log.left_m.copy(), log.t_s.copy()
    gyro[[5, 50]], left[60] = np.nan, np.nan
    t_s[700] = t_s[699]
    t_s[900:] += 3.0
    found = survey("log", [replace(log, gyro_dps=gyro, left_m=left, t_s=t_s)])
    assert (found.bad_gyro, found.bad_encoder, found.duplicates, found.gaps) == (2, 1, 1, 1)
    assert found.notes() == (
        "2 rows without a gyro sample",
        "1 row without an encoder sample",
        "1 row with the time of the row before",
        "1 gap of more than 5 usual steps",
    )
    assert found.usual_dt_s == pytest.approx(0.1)


def test_a_gyro_that_is_stuck_in_a_turn_is_said_and_one_that_stands_is_not() -> None:
    """A cable that came loose for ten seconds had passed without a word."""
    log = drive()
    corner_s = float(log.t_s[np.argmax(np.abs(log.gyro_dps))])
    stuck = (log.t_s > corner_s - 5.0) & (log.t_s < corner_s + 5.0)
    held = replace(log, gyro_dps=np.where(stuck, 0.0, log.gyro_dps))
    for blocks in ([held], [*source(held, 17).blocks()]):
        (said,) = (n for n in check(survey("log", blocks), 0.5) if "one number" in n)
        assert f"from t_s = {log.t_s[stuck][0]:.0f} to {log.t_s[stuck][-1]:.0f} (" in said
    # Of coarse steps a gyro at rest, or on a straight, reads one number, too: such a log had been refused.
    coarse = replace(log, gyro_dps=np.round(log.gyro_dps / 0.25) * 0.25)
    assert max(until - since for since, until in survey("log", [coarse]).held_s) > 5.0
    assert not [n for n in check(survey("log", [coarse]), 0.5) if "one number" in n]


def test_what_a_gyro_reads_at_rest_is_no_saturation_where_the_robot_turns_one_way_only() -> None:
    log = drive()
    one_way = replace(log, gyro_dps=np.where(log.gyro_dps < 5.0, 0.0, log.gyro_dps))
    found = survey("log", [one_way])
    assert found.gyro_dps[0] == 0.0
    assert found.longest_extreme < 10
    clipped = replace(one_way, gyro_dps=np.minimum(one_way.gyro_dps, 20.0))
    assert survey("log", [clipped]).longest_extreme >= 10


def test_a_gyro_beside_one_speed_is_stuck_while_the_vehicle_goes_and_not_while_it_stands() -> None:
    parked, log = robot().with_figures({"static_s": 0.0}), _vehicle()
    middle = np.abs(log.t_s - np.median(log.t_s)) < 0.15 * np.ptp(log.t_s)
    held = replace(log, gyro_dps=np.where(middle, 0.0, log.gyro_dps))
    with pytest.raises(DataError, match="gyro_dps does not change for"):
        replay_log(source(held), parked)
    way = np.where(middle, 0.0, log.left_m)
    assert replay_log(source(replace(held, left_m=way, right_m=way)), parked)


def test_one_speed_in_both_columns_is_one_speed() -> None:
    log = drive()
    way = 0.5 * (log.left_m + log.right_m)
    twice = replace(log, left_m=way, right_m=way * (1.0 + 1e-6))
    assert survey("log", [twice]).speed_only
    assert not survey("log", [log]).speed_only
    replayed = replay_log(source(twice), robot())
    assert [track.condition.id for track in replayed.tracks] == ["uncalibrated"]
    assert any("one speed" in note for note in replayed.notes)


def test_one_speed_that_each_side_counts_in_ticks_is_one_speed() -> None:
    """Sides that part by a tick and come together again had an effective track of -95 %, and `skid_slip`."""
    log = drive()
    way = np.cumsum(0.5 * (log.left_m + log.right_m))
    sides = [np.diff(np.floor(way / 1e-3 + phase), prepend=0.0) * 1e-3 for phase in (0.0, 0.4)]
    assert survey("log", [replace(log, left_m=sides[0], right_m=sides[1])]).speed_only
    # Two wheels of a robot that turns, in ticks as coarse.
    turning = [np.diff(np.floor(np.cumsum(x) / 1e-3), prepend=0.0) * 1e-3 for x in (log.left_m, log.right_m)]
    assert not survey("log", [replace(log, left_m=turning[0], right_m=turning[1])]).speed_only


def _vehicle(rate: float = 1.0, way: float = 1.0) -> DriveBlock:
    """A drive of one speed without truth, its rates and its way times so much."""
    log = fleet_drive(Plan("random", 3.0, 10.0), 1)
    middle, none = 0.5 * way * (log.left_m + log.right_m), np.full(log.t_s.size, np.nan)
    bare = replace(log, truth_x_m=none, truth_y_m=none, truth_heading_deg=none)
    return replace(bare, left_m=middle, right_m=middle, speed_only=True, gyro_dps=rate * log.gyro_dps)


def test_the_unit_of_a_gyro_beside_one_speed_is_doubted_by_what_vehicles_do() -> None:
    """Rates in rad/s had been taken for deg/s without a word."""
    parked = robot().with_figures({"static_s": 0.0})
    said = {rate: " ".join(replay_log(source(_vehicle(rate)), parked).notes) for rate in (1.0, 1 / 57.2958)}
    assert "rad/s" not in said[1.0]
    assert "hardly ever turns faster than" in said[1 / 57.2958]
    assert "if it went round corners, the gyro is in rad/s" in said[1 / 57.2958]
    with pytest.raises(DataError, match=r"across the way.*converted to degrees twice"):
        replay_log(source(_vehicle(57.2958)), parked)


def test_one_speed_may_be_zero_on_the_spot() -> None:
    """A robot that logs the mean of its wheels shows no turn on the spot: it had been refused for encoders that are stuck."""
    parked = robot().with_figures({"static_s": 0.0})
    log = _vehicle()
    begin, end = log.t_s.searchsorted([log.t_s[0] + 60.0, log.t_s[0] + 75.0])
    way, rate = log.left_m.copy(), log.gyro_dps.copy()
    way[begin:end], rate[begin:end] = 0.0, 20.0
    notes = replay_log(source(replace(log, left_m=way, right_m=way, gyro_dps=rate)), parked).notes
    assert any("the speed is zero" in note and "turn on the spot" in note for note in notes)
    assert not any("the speed is zero" in note for note in replay_log(source(log), parked).notes)


def test_a_vehicle_without_a_filter_leaves_nothing_to_it() -> None:
    parked = robot().with_figures({"static_s": 0.0})
    notes = replay_log(source(_vehicle()), parked).notes
    assert any(
        n.endswith("no static bias was taken; nothing but a rest on the way takes its error off")
        for n in notes
    )
    assert not any("left to the filter" in n for n in notes)


def test_a_speed_in_millimetres_names_the_columns_that_a_speed_may_have() -> None:
    with pytest.raises(DataError, match="speed_mps is in m/s, speed_m in metres since the row before"):
        replay_log(source(_vehicle(way=1e3)), robot())


@pytest.mark.parametrize("name", BAD)
def test_bad_logs_are_refused(name: str) -> None:
    spoil, message = BAD[name]
    with pytest.raises(DataError) as error:
        replay_log(source(spoil(drive()), name="drive7"), robot())
    assert str(error.value).startswith("drive7: ")
    assert message in str(error.value)


@pytest.mark.parametrize(("factor", "said"), [(0.5, True), (1.0, False), (2.0, True)])
def test_turns_that_no_sound_robot_file_makes_are_said(factor: float, said: bool) -> None:
    log = drive()
    found = survey("log", [replace(log, gyro_dps=factor * log.gyro_dps)])
    assert (
        any("times as far as the encoders" in note for note in check(found, robot().wheel_separation_m))
        is said
    )


def test_a_sound_log_passes() -> None:
    check(survey("log", [drive()]), robot().wheel_separation_m)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_circle_is_a_turn_too(sign: float) -> None:
    rows = 600
    t_s = 0.1 * np.arange(rows, dtype=np.float64)
    gyro = 15.0 * sign + np.random.default_rng(1).normal(0.0, 0.1, rows)
    side = np.full(rows, 0.1)
    nothing = np.full(rows, np.nan)
    half = 0.5 * 0.6 * np.radians(1.5)
    log = DriveBlock(2, t_s, side - half, side + half, gyro, nothing, nothing, nothing, nothing)
    if sign > 0:
        check(survey("log", [log]), 0.6)
    else:
        with pytest.raises(DataError, match="encoder and gyro turns"):
            check(survey("log", [log]), 0.6)


@pytest.mark.parametrize("delay_s", [-0.3, 0.0, 0.42])
def test_a_delay_of_the_encoders_is_measured(delay_s: float) -> None:
    log = delayed(drive(), delay_s)
    found = compare_yaw(survey("log", [log]), robot().wheel_separation_m)
    assert found.delay_s == pytest.approx(delay_s, abs=max(4 * found.delay_sigma_s, 0.02))
    assert ("nothing takes it out" in found.sentence()) == (delay_s != 0)
    assert ("takes it out" in found.sentence(delay_s)) == (delay_s != 0)
    assert found.correlation > 0.99


def delayed(log: DriveBlock, delay_s: float) -> DriveBlock:
    """The log with encoders that tell `delay_s` later how far they are."""
    left, right = (
        np.diff(np.interp(log.t_s - delay_s, log.t_s, np.cumsum(side)), prepend=0.0)
        for side in (log.left_m, log.right_m)
    )
    return replace(log, left_m=left, right_m=right)


def test_the_ratio_of_turns_is_that_of_the_separations() -> None:
    log = drive()
    turned_rad = np.radians(np.diff(log.truth_heading_deg, prepend=0.0))
    travel_m = 0.5 * (log.left_m + log.right_m)
    exact = replace(
        log,
        left_m=travel_m - 0.5 * 0.75 * turned_rad,
        right_m=travel_m + 0.5 * 0.75 * turned_rad,
        gyro_dps=np.degrees(turned_rad) / 0.1,
    )
    found = compare_yaw(survey("log", [exact]), 0.6)
    assert found.ratio == pytest.approx(0.75 / 0.6, rel=1e-6)
    assert found.effective_separation_m == pytest.approx(0.75, rel=1e-6)
    assert found.offset_dps == pytest.approx(0.0, abs=1e-6)


def test_sigma_of_the_ratio_is_its_scatter() -> None:
    """Over drives that differ in noise alone; a jackknife over ten blocks is known to a quarter."""
    log, rng = drive(), np.random.default_rng(6)
    noisy = [replace(log, left_m=log.left_m + rng.normal(0.0, 3e-3, len(log))) for _ in range(6)]
    found = [compare_yaw(survey("log", [x]), robot().wheel_separation_m) for x in noisy]
    scatter = np.std([x.ratio for x in found], ddof=1)
    assert 0.5 < np.mean([x.ratio_sigma for x in found]) / scatter < 2.0


def test_a_circling_robot_that_stops_is_not_one_whose_encoders_stick() -> None:
    rows = 1800
    t_s = 0.1 * np.arange(rows, dtype=np.float64)
    turning = (t_s < 120.0) | (t_s > 140.0)
    gyro = np.where(turning, 15.0, 0.0) + np.random.default_rng(1).normal(0.0, 0.1, rows) + 0.5
    side, half = np.where(turning, 0.1, 0.0), np.where(turning, 0.5 * 0.6 * np.radians(1.5), 0.0)
    nothing = np.full(rows, np.nan)
    log = DriveBlock(2, t_s, side - half, side + half, gyro, nothing, nothing, nothing, nothing)
    check(survey("log", [log]), 0.6)


def test_rows_that_are_far_apart_are_said() -> None:
    log = drive()
    assert not any("is lost" in note for note in survey("log", [log]).notes())
    slow = replace(log, t_s=10.0 * log.t_s)
    assert any("a row every 1 s" in note for note in survey("log", [slow]).notes())


def test_a_steering_angle_that_nothing_uses_is_said_once() -> None:
    log = drive()
    steered = replace(log, steering_deg=np.zeros(len(log)))
    assert UNUSED_STEERING not in survey("log", [log]).notes()
    assert (
        survey("log", [steered, replace(steered, t_s=steered.t_s + 1e3)]).notes().count(UNUSED_STEERING) == 1
    )


def test_a_rate_that_no_robot_has_is_refused_by_its_line() -> None:
    log = drive()
    spoilt = replace(log, gyro_dps=np.where(np.arange(len(log)) == 1500, -9e5, log.gyro_dps))
    with pytest.raises(DataError, match=r"log, line 1502: gyro_dps is 900,000 deg/s in size"):
        replay_log(source(spoilt, chunk_rows=1000), robot())


def test_an_early_stamp_is_no_speed() -> None:
    """Of a row that is a fiftieth of the others long the way is an ordinary one; that of a hundred rows in one is not."""
    log = drive()
    stamps = log.t_s.copy()
    stamps[1500] -= 0.98 * (stamps[1500] - stamps[1499])
    fast_mps = survey("log", [log]).max_speed_mps
    assert survey("log", [replace(log, t_s=stamps)]).max_speed_mps < 1.5 * fast_mps
    far = np.where(np.arange(len(log)) == 1500, 100.0, 1.0)
    leap = replace(log, left_m=log.left_m * far, right_m=log.right_m * far)
    assert survey("log", [leap]).max_speed_mps > 50.0 * fast_mps


def test_a_bias_that_changed_between_rests_is_said() -> None:
    """The heading was 36 deg off in between, and the first sentence said that the filter holds."""
    rng = np.random.default_rng(3)
    t_s: NDArray[np.float64] = 0.02 * np.arange(9000, dtype=np.float64)
    moving = (t_s % 60.0) > 20.0
    way = np.where(moving, 0.01, 0.0)
    turn = np.where(moving, 20.0 * np.sin(0.5 * t_s), 0.0)
    apart = turn * DEG_TO_RAD * 0.02 * 0.5
    nothing = np.full(t_s.size, np.nan)

    def said(jump_dps: float) -> tuple[str, ...]:
        gyro = turn + 0.1 + jump_dps * (t_s > 90.0) + 0.05 * rng.standard_normal(t_s.size)
        log = DriveBlock(
            2, t_s, way - 0.5 * apart, way + 0.5 * apart, gyro, nothing, nothing, nothing, nothing
        )
        return check(survey("log", [log]), 0.5)

    (text,) = said(0.5)
    assert re.match(
        r"the gyro reads 0\.(1|099\d|10\d) deg/s at the rest about t_s = 70 and 0\.(6|599|60\d) at the next, about 130",
        text,
    )
    assert "off by up to 30 deg" in text
    assert said(0.0) == ()
    assert said(0.1) == ()


def test_empty_cells_are_neither_a_rest_nor_a_rate_of_zero() -> None:
    """Three seconds without wheels in a turn had been a rest, at which the bias had changed by the rate of the turn."""
    log = drive()
    hole, first = np.abs(log.t_s - np.median(log.t_s)) < 1.5, log.t_s < log.t_s[np.flatnonzero(log.left_m)[0]]
    gyro = np.where(hole, 2.0, np.where(first, 0.0, log.gyro_dps))

    def said(**channels: NDArray[np.float64]) -> list[str]:
        given: dict[str, Any] = {"gyro_dps": gyro} | channels
        found = survey("log", [replace(log, **given)])
        return [n for n in check(found, 0.5) if "at the rest" in n]

    empty, still = (
        {name: np.where(hole, v, getattr(log, name)) for name in ("left_m", "right_m")} for v in (np.nan, 0.0)
    )
    assert said(**still)
    assert not said(**empty)
    assert not said(**still, gyro_dps=np.where(hole, np.nan, np.where(first, 2.0, log.gyro_dps)))
