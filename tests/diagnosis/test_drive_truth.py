"""Drives with truth, slips and rests, by a generator of many shapes: no wrong names, honest intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.diagnosis.drive_noise import ISOLATED, yaw_noise
from gyrocal.diagnosis.drive_reml import Source, fit
from gyrocal.diagnosis.drive_rests import Rest, rests, rests_speak_against
from gyrocal.diagnosis.drive_result import diagnose_drive
from gyrocal.diagnosis.drive_series import drive_series
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.records.robot import INITIAL_STD_DEFAULTS, NOISE_DEFAULTS, Robot
from tests.diagnosis.drive_fleet import Plan, any_plan, drive

KNOWN = Plan(minutes=4.0, truth_m=0.03, truth_heading_deg=0.1, lever_m=(0.2, 0.1))


def robot(plan: Plan) -> Robot:
    static_s = 0.0 if "gyro_bias" in plan.effects else plan.rest_s - 0.5
    initial = dict(INITIAL_STD_DEFAULTS) | {"gyro_bias_dps": 0.01 if static_s else 0.2}
    return Robot(Path("robot.toml"), plan.separation_m, None, None, static_s, initial, dict(NOISE_DEFAULTS))


def diagnosis(plan: Plan, seed: int) -> Diagnosis:
    return diagnose_drive("drive.csv", drive(plan, seed), robot(plan)).diagnosis


def names(found: Diagnosis) -> list[str]:
    return [e.effect for e in found.effects]


@pytest.mark.parametrize("heading_deg", [0.0, 0.1])
def test_a_gyro_scale_is_told_from_the_track_width_by_the_truth(heading_deg: float) -> None:
    plan = replace(KNOWN, truth_heading_deg=heading_deg, effects={"gyro_scale": 3.0})
    found = diagnosis(plan, 5)
    assert names(found) == ["gyro_scale"]
    assert found.verdict == "explained"
    amplitude = found.effects[0].parameters["amplitude"]
    assert abs(amplitude.value - 3e4) < 4 * amplitude.std
    assert amplitude.std < 1000
    assert "gyro_scale" not in found.not_testable


def test_scales_of_wheels_and_gyro_at_once() -> None:
    plan = replace(KNOWN, effects={"gyro_scale": -2.0, "wheel_scale": 1.5})
    found = diagnosis(plan, 6)
    assert sorted(names(found)) == ["gyro_scale", "wheel_scale"]
    for effect, true in (("gyro_scale", -2e4), ("wheel_scale", 1.5)):
        amplitude = next(e for e in found.effects if e.effect == effect).parameters["amplitude"]
        assert abs(amplitude.value - true) < 4 * amplitude.std


def test_without_truth_the_alternatives_are_said() -> None:
    plan = Plan(minutes=4.0, effects={"gyro_scale": 3.0})
    found = diagnosis(plan, 5)
    assert names(found) == ["skid_slip"]
    others = {a.effect: a.evidence_ratio for a in found.effects[0].alternatives}
    # Encoders that see less than the gyro: a gyro or wheels off by a factor, but never a tilted gyro.
    assert others == {"gyro_scale": 1.0, "wheel_scale": 1.0}


def test_slip_that_the_truth_confirms_has_no_twins() -> None:
    found = diagnosis(replace(KNOWN, effects={"skid_slip": 15.0}), 8)
    assert names(found) == ["skid_slip"]
    assert found.effects[0].alternatives == ()


@pytest.mark.parametrize(
    ("shape", "truth_m", "wander_m", "heading_deg"),
    [("random", 0.01, 0.0, 0.05), ("straight", 0.02, 0.0, 0.0), ("slow", 0.01, 0.0, 0.0), ("lawn", 1.0, 1.0, 0.0),
     ("reverse", 0.1, 0.1, 0.5), ("rests", 0.05, 0.0, 0.0), ("eights", 0.0, 0.0, 0.0)],
)  # fmt: skip
def test_nothing_is_named_on_drives_with_nothing(
    shape: str, truth_m: float, wander_m: float, heading_deg: float
) -> None:
    plan = Plan(
        shape=shape, minutes=5.0, truth_m=truth_m, truth_wander_m=wander_m, truth_heading_deg=heading_deg,
        lever_m=(-0.2, 0.1), bias_walk=0.0003,
    )  # fmt: skip
    found = diagnosis(plan, 21)
    assert names(found) == []
    assert found.verdict == "consistent"
    assert found.sentences[0] == "Encoders and gyro agree within their noise."
    assert [place for place in found.located if place.statistic == "variance"] == []


@pytest.mark.parametrize("truth_m", [0.0, 0.02])
def test_isolated_slips_are_reported_and_get_no_name(truth_m: float) -> None:
    found = diagnosis(Plan(minutes=6.0, truth_m=truth_m, effects={"slips": 10}), 4)
    assert names(found) == []
    assert found.verdict == "unexplained"
    (place,) = [place for place in found.located if place.remains]
    assert place.coordinate == "time"
    assert place.region.startswith(ISOLATED)
    assert any("left out of all fits" in text for text in found.sentences)


def test_slips_do_not_hide_a_law() -> None:
    found = diagnosis(Plan(minutes=6.0, effects={"slips": 8, "gyro_delay": 0.2}), 4)
    assert names(found) == ["gyro_delay"]
    assert found.verdict == "partly_explained"
    amplitude = found.effects[0].parameters["amplitude"]
    assert abs(amplitude.value - 0.2) < 5 * amplitude.std


def test_a_bias_is_named_where_the_rests_agree() -> None:
    found = diagnosis(Plan(shape="rests", minutes=6.0, bias_dps=0.0, effects={"gyro_bias": 300.0}), 4)
    assert names(found) == ["gyro_bias"]
    assert found.effects[0].alternatives == ()
    standing = (Rest(0.0, 0.001, 0.004, 0.0), Rest(60.0, -0.002, 0.004, 1.0))
    assert rests_speak_against(standing, (0.0, 0.0), (0.3, 0.0))
    assert not rests_speak_against(standing, (0.0, 0.0), (0.002, 0.0))
    assert not rests_speak_against((), (0.0, 0.0), (0.3, 0.0))


def test_a_drift_by_temperature_is_told_from_a_bias_by_the_rest() -> None:
    found = diagnosis(Plan(minutes=10.0, wheel_noise=0.002, effects={"bias_temperature": 60.0}), 4)
    assert names(found) == ["bias_temperature"]
    amplitude = found.effects[0].parameters["amplitude"]
    assert abs(amplitude.value - 60.0) < 4 * amplitude.std


def test_a_small_bias_within_what_the_rest_leaves_is_no_effect() -> None:
    plan = Plan(minutes=6.0, wheel_noise=1e-4, arw_dps_rt_s=0.01, bias_walk=0.0003)
    assert names(diagnosis(plan, 4)) == []


def test_rests_are_found_with_the_gyro_s_rate() -> None:
    plan = Plan(shape="rests", minutes=6.0, bias_dps=0.0, wheel_noise=0.0)
    seen = rests(drive_series("x", drive(plan, 3), robot(plan), None))
    assert len(seen) >= 3
    assert all(abs(r.rate_dps) < 4 * r.std_dps for r in seen)


def test_noise_grows_with_the_way() -> None:
    plan = Plan(minutes=8.0, wheel_noise=0.005)
    series = drive_series("x", drive(plan, 3), robot(plan), None)
    noise = yaw_noise(series)
    assert noise.slips.size == 0
    # Two wheels of 5 mm a root metre, 0.5 m apart; a metre of way: 0.81 deg.
    moving = noise.std_deg[-100:]
    assert 0.3 < np.median(moving) < 1.2
    assert noise.std_deg[:5].max() < 0.3 * np.median(moving)


@pytest.mark.parametrize("frame", ["mirrored", "still"])
def test_a_truth_that_does_not_follow_is_left_aside(frame: str) -> None:
    plan = replace(KNOWN, truth_heading_deg=0.0, minutes=3.0)
    log = drive(plan, 7)
    known = np.isfinite(log.truth_x_m)
    broken = (
        replace(log, truth_y_m=-log.truth_y_m)
        if frame == "mirrored"
        else replace(log, truth_x_m=np.where(known, 1.0, np.nan), truth_y_m=np.where(known, 2.0, np.nan))
    )
    found = diagnose_drive("drive.csv", broken, robot(plan)).diagnosis
    assert names(found) == []
    assert any("do not follow the path" in note for note in found.notes)


def test_values_and_intervals_are_rounded_alike() -> None:
    found = diagnosis(Plan(minutes=4.0, effects={"gyro_delay": 0.2}), 9)
    text = next(s for s in found.sentences if s.startswith("gyro_delay"))
    numbers = text.split("rate.")[-1].split(": ", 1)[1].replace("(95 %:", "").replace(")", "").split()
    decimals = {len(x.split(".")[1]) for x in numbers if "." in x}
    assert len(decimals) == 1


def test_levels_by_restricted_likelihood_and_coverage() -> None:
    rng = np.random.default_rng(3)
    n, trials, covered = 60, 120, 0
    walk = np.tril(np.ones((n, n)))
    columns = np.stack([np.ones(n), np.linspace(-1, 1, n)], axis=1)
    sources = [Source("walk", walk @ walk.T, 1e-3, 2.0), Source("white", np.eye(n), 1e-2)]
    levels = []
    for _ in range(trials):
        y = walk @ rng.normal(0, 0.1, n) + rng.normal(0, 0.3, n)
        found = fit(y, columns, sources)
        half = stats.t.ppf(0.975, found.freedom(np.array([0.0, 1.0]))) * np.sqrt(found.covariance[1, 1])
        covered += abs(found.values[1]) < half
        levels.append(found.levels)
    assert stats.binom.ppf(1e-3, trials, 0.95) <= covered
    assert np.median(np.array(levels), axis=0) == pytest.approx([0.01, 0.09], rel=0.5)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_null_drives_of_all_shapes_are_not_named() -> None:
    trials = 100
    plans = [any_plan(np.random.default_rng([seed, 7])) for seed in range(trials)]
    named = [names(diagnosis(plan, seed)) for seed, plan in enumerate(plans)]
    assert sum(map(bool, named)) <= stats.binom.ppf(0.999, trials, 0.02)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_intervals_of_the_scales_cover() -> None:
    trials, covered, seen = 40, 0, 0
    for seed in range(trials):
        rng = np.random.default_rng([seed, 8])
        plan = replace(any_plan(rng), truth_m=0.05, truth_wander_m=0.0, shape="random")
        plan = replace(plan, effects={"gyro_scale": 3.0, "wheel_scale": -2.0})
        found = {e.effect: e.parameters["amplitude"] for e in diagnosis(plan, seed).effects}
        assert sorted(found) == ["gyro_scale", "wheel_scale"]
        for effect, true in (("gyro_scale", 3e4), ("wheel_scale", -2.0)):
            low, high = found[effect].interval_95
            seen, covered = seen + 1, covered + (low <= true <= high)
    assert covered >= stats.binom.ppf(1e-3, seen, 0.93)
