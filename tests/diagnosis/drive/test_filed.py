"""The robot file that is written is what was fitted and what the page claims; a given one is taken as the runtime takes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from gyrocal.diagnosis.drive.engine import _own_slip, diagnose_drive, examine
from gyrocal.diagnosis.drive.filed import asked_anew, beyond_given, filed
from gyrocal.diagnosis.drive.improved import _slip, improved_robot
from gyrocal.diagnosis.drive.laws import HALF_CURVATURES
from gyrocal.diagnosis.drive.search import YawAnswer
from gyrocal.diagnosis.drive.series import drive_series
from gyrocal.physics.slip import SLIP_LAWS, slip_shape
from gyrocal.records.robot import Robot, robot_of
from gyrocal.report.remarks import remark_words
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.test_lasting import PLAN, turned
from tests.diagnosis.drive.world import SEPARATION_M, Hidden, simulate


def robot(**figures: object) -> Robot:
    return robot_of({"wheel_separation_m": 0.5, "static_s": 7.0} | figures, Path("robot.toml"))


@pytest.mark.slow
def test_a_window_is_written_with_its_delay_beside_a_law_of_slip() -> None:
    """What the slip leaves of the delay changes within the drive, and the file had the window alone."""
    log = drive(replace(PLAN, minutes=5.0, truth_m=0.01), 4)
    log = turned(log, 1.0 + 0.2 * np.abs(log.gyro_dps) / 30.0)
    rows = 20
    left, right = (
        uniform_filter1d(x, rows, origin=rows // 2 - 1, mode="constant") for x in (log.left_m, log.right_m)
    )
    found = diagnose_drive("log", replace(log, left_m=left, right_m=right), robot())
    assert "slip_turn_rate" in found.yaw.named
    assert found.robot is not None
    written = found.robot.parameters
    assert written.encoders.window_s == pytest.approx(1.0)
    assert written.gyro.delay_s == pytest.approx(-0.5, abs=0.1)
    # Of the same figures as the file.
    (shown,) = found.shown
    assert shown.after_m < 0.5 * shown.before_m


@pytest.mark.slow
def test_what_is_claimed_is_of_the_file() -> None:
    """Before: bias and delay of the given file, which replay takes, were not in its path."""
    log = simulate(Hidden(bias_dps=0.3, gps_m=0.02), 3)
    knows = {"gyro": {"bias_dps": 0.3}, "wheel_separation_m": SEPARATION_M, "static_s": 0.0}
    (shown,) = diagnose_drive("log", log, robot(**knows)).shown
    assert shown.before_m < 0.1


@pytest.mark.slow
def test_scales_of_a_given_file_are_taken_out_of_the_log_and_stay_in_the_file() -> None:
    log = simulate(Hidden(gyro_factor=1.03, scale=0.02, bias_dps=0.2, gps_m=0.02), 3)
    known = {
        "gyro": {"scale": 0.03, "bias_dps": 0.206},
        "encoders": {"left_scale": 0.02, "right_scale": 0.02},
    }
    given = robot(wheel_separation_m=SEPARATION_M, static_s=0.0, **known)
    found = diagnose_drive("log", log, given)
    assert not found.diagnosis.effects
    assert found.robot is not None
    written = found.robot.parameters
    assert written.gyro.scale == 0.03
    assert written.encoders.left_scale == pytest.approx(0.02, abs=2e-3)
    assert written.gyro.bias_dps == pytest.approx(0.206, abs=0.01)


def test_laws_of_a_given_file_do_not_outlive_what_was_fitted_beside_them() -> None:
    old = {
        "gyro": {"bias_motion_dps": 0.1, "bias_dps": 0.2, "scale": 0.01, "delay_s": 0.3},
        "encoders": {"window_s": 0.5, "left_scale": 0.02},
        "slip": {"law": "curvature", "amplitude": 0.3},
    }
    kept = asked_anew(robot(**old))
    assert (
        kept.parameters
        == robot(gyro={"bias_dps": 0.2, "scale": 0.01}, encoders={"left_scale": 0.02}).parameters
    )
    assert kept.given == {
        "wheel_separation_m", "static_s", "gyro.bias_dps", "gyro.scale", "encoders.left_scale",
    }  # fmt: skip


def test_a_file_says_of_a_log_what_is_beyond_the_file_that_it_came_with() -> None:
    given = robot(gyro={"scale": 0.03, "bias_dps": 0.5}, encoders={"left_scale": 0.02, "right_scale": 0.02})
    series = drive_series("log", drive(PLAN, 4), given, None)
    nothing = filed(series, given.parameters)
    assert nothing.bias_dps == 0.5
    assert [nothing.gyro_scale, nothing.left_scale, nothing.right_scale, nothing.track] == pytest.approx(
        [0.0] * 4
    )
    keys: dict[str, Any] = {"gyro.bias_dps": 0.6, "gyro.scale": 0.01, "gyro.bias_motion_dps": 0.1}
    better = given.with_figures(beyond_given(series, keys | {"encoders.left_scale": 0.01}))
    found = filed(series, better.parameters)
    assert [found.bias_dps, found.gyro_scale, found.bias_motion_dps, found.left_scale] == pytest.approx(
        [0.6, 0.01, 0.1, 0.01]
    )
    # As the runtime has it: (output - bias) / (1 + scale).
    plain = drive_series("log", drive(PLAN, 4), robot(), None)
    gyro = better.parameters.gyro
    np.testing.assert_allclose(
        (plain.gyro_dps - gyro.bias_dps) / (1.0 + gyro.scale),
        (series.gyro_dps - found.bias_dps) / (1.0 + found.gyro_scale),
    )


@pytest.mark.parametrize(("law", "shape"), [(0, 1.0), (1, 1.0), (2, HALF_CURVATURES[1])])
def test_a_robot_widens_its_own_track_as_the_fit_does_that_of_the_given_file(law: int, shape: float) -> None:
    """With a track half as wide again the encoders' heading was 64 deg rms off by the file."""
    track, amplitude = 0.5, 0.3
    answer = SimpleNamespace(
        laws={"slip_law": SimpleNamespace(shape={"law": float(law), "shape": shape})},
        estimate=lambda name: ({"slip_law": amplitude, "track": track}[name], 0.03),
    )
    slip = _slip(cast("YawAnswer", answer), ["slip_law"])
    assert slip is not None
    assert slip.amplitude_std == pytest.approx(0.1 * slip.amplitude)
    # Turns that the law of curvature does not cut.
    rate_dps, speed_mps = np.array([5.0, 20.0, 40.0]), np.array([1.0, 0.4, 0.3])
    fitted = 1.0 + track + amplitude * slip_shape(SLIP_LAWS[law], rate_dps, speed_mps, 0.5, shape)
    driven = slip_shape(slip.law, rate_dps, speed_mps, 0.5 * (1.0 + track), slip.shape)
    np.testing.assert_allclose((1.0 + track) * (1.0 + slip.amplitude * driven), fitted)


def test_a_slip_that_changes_within_the_drive_is_a_wider_track_in_the_file() -> None:
    log = drive(Plan(minutes=5.0, tick_m=2e-4, arw_dps_rt_s=0.003, wheel_noise=3e-4), 4)
    found = examine("log", turned(log, 1.0 + 0.3 * np.abs(log.gyro_dps) / 30.0), robot(static_s=0.0), None)
    (slip,) = (n for n in found.yaw.named if n.startswith("slip_"))
    for uneven in (frozenset[str](), frozenset({slip})):
        written = improved_robot(found.series, replace(found.yaw, uneven=uneven), None, {}, found.figures)
        assert written is not None
        assert (written.parameters.slip.amplitude > 0.2) == (not uneven)
        assert (written.wheel_separation_m > 0.54) == bool(uneven)


@pytest.mark.slow
def test_a_scale_that_may_be_a_tilt_stays_out_of_the_file() -> None:
    """Beside something left over the turns; where nothing is, a gyro that reads less than was granted is what it seems."""
    log = drive(Plan(minutes=6.0, tick_m=2e-4, truth_m=0.02), 3)
    less = replace(log, gyro_dps=0.95 * log.gyro_dps)
    found = examine("log", less, robot(initial_std={"gyro_scale": 0.01}), None)
    assert "gyro_scale" in found.parts

    def written(yaw: YawAnswer) -> float:
        better = improved_robot(found.series, yaw, found.truth, found.parts, found.figures)
        assert better is not None
        return better.parameters.gyro.scale

    assert written(replace(found.yaw, odd=())) == pytest.approx(-0.05, abs=0.01)
    assert written(replace(found.yaw, odd=("turn_rate",))) == 0.0


def test_a_slip_of_another_track_than_the_given_one_is_told() -> None:
    """The page had 27 %, of the separation that was given, and the file 30 %, of its own."""
    given = robot(slip={"law": "curvature", "amplitude": 0.3})
    own = robot(wheel_separation_m=0.45, slip={"law": "curvature", "amplitude": 0.37})
    (said,) = _own_slip(given, own)
    assert remark_words(said).endswith("as a share of its own, 0.45 m: 37 % (curvature).")
    assert _own_slip(given, given) == _own_slip(given, robot(wheel_separation_m=0.45)) == []
