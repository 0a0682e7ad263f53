"""What a truth's own noise makes of a distance from it, and which differences it hides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.drive.engine import DriveDiagnosis, Shown, diagnose_drive
from gyrocal.diagnosis.drive.path_laid import Levels
from gyrocal.diagnosis.drive.reckoning import laid_on
from gyrocal.diagnosis.drive.truth import TruthAnswer
from gyrocal.diagnosis.drive.visible import truth_floor
from gyrocal.report.drive_words import drive_sentences
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.score import robot_file


def test_floor_and_least_difference_are_those_of_drawn_truths() -> None:
    """Truths with white and wandering errors: what a perfect path is off by, and how the difference of two paths scatters."""
    rng = np.random.default_rng(3)
    white_m, wander_m, wander_s = 0.3, 0.8, 60.0
    levels = Levels(np.log([1.0, white_m**2, wander_m**2]), wander_s)
    truth = TruthAnswer({}, {}, np.eye(2), np.zeros((0, 0)), {}, levels=levels)
    t_s = np.arange(0.0, 400.0, 2.0)
    path = 15.0 * np.exp(0.03j * t_s) + 0.05 * t_s
    other = path + 0.5 * np.sin(0.02 * t_s) + 0.3j * np.cos(0.05 * t_s)
    fade = wander_m**2 * np.exp(-np.abs(t_s[:, None] - t_s[None, :]) / wander_s)
    root = np.linalg.cholesky(fade + white_m**2 * np.eye(t_s.size))
    rms = []
    for _ in range(400):
        told = path + root @ (rng.standard_normal(t_s.size) + 1j * rng.standard_normal(t_s.size))
        rms.append((laid_on(path, told)[1], laid_on(other, told)[1]))
    perfect, worse = np.array(rms).T
    apart = laid_on(other, path)[0] - path
    middle = float(np.sqrt(np.mean(perfect**2))), float(np.sqrt(np.mean(worse**2)))
    floor_m, seen_m = truth_floor(truth, t_s, path, apart, middle)
    assert floor_m == pytest.approx(middle[0], rel=0.05)
    # The scatter of 400 draws is known to 4 %; the rest is first order.
    assert seen_m == pytest.approx(1.96 * float(np.std(worse - perfect)), rel=0.15)


@pytest.fixture(scope="module")
def by_satellite(tmp_path_factory: pytest.TempPathFactory) -> DriveDiagnosis:
    """Positions that are off by half a metre on each axis, and a gyro that is a tenth of a second late."""
    plan = Plan("random", 2.0, 10.0, arw_dps_rt_s=0.001, truth_m=0.5, effects={"gyro_delay": 0.1})
    return diagnose_drive("log", drive(plan, 4), robot_file(plan))


@pytest.mark.slow
def test_metres_within_the_noise_of_the_truth_are_said_to_tell_nothing(by_satellite: DriveDiagnosis) -> None:
    (shown,) = by_satellite.shown
    assert shown.truth_m == pytest.approx(0.5 * np.sqrt(2.0), rel=0.2)
    assert abs(shown.after_m - shown.before_m) < shown.seen_m
    (said,) = [s for s in drive_sentences(by_satellite) if "position error along" in s]
    assert "which tells nothing: a perfect path would be off by about 0." in said
    entry = by_satellite.diagnosis.to_json()["drive"]["position_error"][0]
    assert entry["least_seen_m"] == shown.seen_m


@pytest.mark.slow
def test_a_difference_that_the_truth_shows_is_told_as_such(by_satellite: DriveDiagnosis) -> None:
    (shown,) = by_satellite.shown
    better: Shown = replace(shown, before_m=5.0, after_m=0.8)
    said = " ".join(drive_sentences(replace(by_satellite, shown=(better,))))
    assert "falls from 5 to 0.8 m rms; a perfect path would be off by" in said


@pytest.mark.slow
def test_figures_that_do_not_change_are_not_said_to_have_been_tested(by_satellite: DriveDiagnosis) -> None:
    (shown,) = by_satellite.shown
    same = replace(shown, after=shown.before, after_m=shown.before_m, apart_m=0.0)
    said = " ".join(drive_sentences(replace(by_satellite, shown=(same,))))
    assert "nothing is put to the test" in said
    assert "stays at" not in said
