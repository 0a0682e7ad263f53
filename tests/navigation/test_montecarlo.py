"""Table II many times over: the same for any number of processes; and what sensitivities must be."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.navigation.bench import calibrate_unit
from gyrocal.navigation.montecarlo import World, cores, monte_carlo, simulated_robot_file, unit_of
from gyrocal.navigation.sensitivity import (
    calibration_error_cm,
    coefficient_sensitivities,
    sensitivities,
)
from gyrocal.navigation.simulate import Spread
from gyrocal.navigation.table import FACTORS, Row, table_of
from gyrocal.physics.gyro import rd2100_unit

SMALL = World(runs=1)


@pytest.mark.slow
def test_the_processes_do_not_change_the_result() -> None:
    said: list[int] = []
    alone = monte_carlo(SMALL, 2, 7, said.append, workers=1)
    shared = monte_carlo(SMALL, 2, 7, said.append, workers=2)
    np.testing.assert_array_equal(alone.all_m, shared.all_m)
    assert said == [1, 2, 1, 2]
    assert set(alone.factors()) == set(FACTORS)
    assert cores() >= 1


#: Says when its two processes are at work on something long.
LONG = """
import multiprocessing, threading, time
from gyrocal.navigation import montecarlo
def say():
    while len(multiprocessing.active_children()) < 2:
        time.sleep(0.05)
    print("at work", flush=True)
threading.Thread(target=say, daemon=True).start()
list(montecarlo._map(time.sleep, [600] * 8, 2))
"""


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGKILL])
def test_no_process_outlives_its_parent(number: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert parent.stdout is not None
    assert parent.stdout.readline() == "at work\n"
    parent.send_signal(number)
    # The processes share this pipe: it ends when the last of them has ended.
    assert parent.communicate(timeout=60)[0] == ""
    assert parent.returncode != 0


def test_calibrated_units_are_right_to_their_standard_errors() -> None:
    model = rd2100_unit(9)
    found = calibrate_unit(model, np.random.default_rng(1))
    rate, temp = (a.ravel() for a in np.meshgrid(np.linspace(-60, 60, 13), np.linspace(0, 40, 5)))
    gyro = model.surface.output_dps(rate, temp)
    error_dps = found.correct(gyro, temp) - rate
    # Before, up to a degree a second; after, the mean of 20 s at 0.44 mdeg/s and 1/f noise in each data set.
    assert np.abs(gyro - rate).max() > 0.3
    assert np.sqrt(np.mean(error_dps**2)) < 2e-3


def test_a_changed_world_changes_one_thing() -> None:
    plain, straight = unit_of(World(), 4), unit_of(World(nonlinearity=0.0), 4)
    c = straight.surface.coefficients_dps
    assert np.all(c[2:] == 0.0)
    # What is left of the slope is the factory's own error, 0.1 % sigma; the best line through the cubic is gone.
    assert abs(c[1, 0]) < 0.5
    assert abs(plain.surface.coefficients_dps[1, 0]) > 1.0
    flat = unit_of(World(temperature_slope=0.0), 4).surface.coefficients_dps
    assert np.all(flat[:2, 1:] == 0.0)
    np.testing.assert_array_equal(flat[:, 0], plain.surface.coefficients_dps[:, 0])
    assert unit_of(World(bias_instability_deg_per_h=7.0), 4).bias_instability_deg_per_h == 7.0


def test_sensitivities_against_geometry() -> None:
    spread = Spread()
    parameters = simulated_robot_file(SMALL).parameters
    model = unit_of(SMALL, 2)
    found = {s.source: s for s in sensitivities(spread, parameters, model, np.random.default_rng(3))}
    # Without the filter only the gyro gives heading, so wheels that err alike scale a closed path: nothing is left.
    assert found["scale of both wheels"].no_filter_cm < 0.1
    assert found["effective wheel separation"].no_filter_cm < 0.1
    scale = found["gyro scale factor"]
    # Turns of 45 deg at eight corners, 0.1 % each: the last sides are off by k * 90 deg * 0.001.
    sides = [53.0 * np.radians(90.0e-3 * k) for k in range(4)]
    rough_cm = 100 * np.hypot(sides[1] - sides[3], sides[2] - sides[0])
    assert scale.no_filter_cm == pytest.approx(rough_cm, rel=0.25)
    assert scale.for_paper == pytest.approx(16.3 / scale.no_filter_cm)
    bias = found["gyro bias that the static mean misses"]
    assert bias.no_filter_cm == pytest.approx(10.6, abs=1.5)
    # The filter learns the wheels' scale from the gyro, so that does not matter with it either.
    assert found["scale of right against left wheel"].filter_cm < 1.0


def test_coefficients_with_their_covariance() -> None:
    parameters = simulated_robot_file(SMALL).parameters
    coefficients = calibrate_unit(unit_of(SMALL, 2), np.random.default_rng(3))
    rows = {s.source: s for s in coefficient_sensitivities(Spread(), parameters, coefficients, 35.0)}
    assert len(rows) == 12
    # A constant goes with the static mean; a slope does not, and v = 0.5 at 35 deg C halves the next term.
    assert rows["c[0][0]"].no_filter_cm < 0.05
    assert rows["c[1][1]"].no_filter_cm == pytest.approx(0.5 * rows["c[1][0]"].no_filter_cm, rel=0.01)
    both = calibration_error_cm(Spread(), parameters, coefficients, 35.0)
    quiet = replace(coefficients, covariance_dps2=0.25 * coefficients.covariance_dps2)
    assert calibration_error_cm(Spread(), parameters, quiet, 35.0) == pytest.approx(0.5 * both)


def test_the_table_has_the_papers_layout() -> None:
    def row(name: str, direction: str, *values: float) -> Row:
        ids = ("uncalibrated", "uncalibrated_filter", "calibrated", "calibrated_filter")
        return Row(name, direction, dict(zip(ids, values, strict=True)))

    table = table_of([row("b", "ccw", 3.0, 1.5, 0.3, 0.1), row("a", "cw", 1.0, 0.5, 0.1, 0.1)], "return")
    assert [line[0] for line in table.lines()] == ["a", "b"]
    twice = table_of([*table.rows, *table.rows], "return").lines()
    assert [line[0] for line in twice] == ["a", "a", "mean cw", "b", "b", "mean ccw"]
    assert table.lines()[1][1:] == ("300.0", "150.0", "30.0", "10.0")
    assert table.factors["all"] == pytest.approx({"filter": 2.0, "calibration": 10.0, "both": 20.0})
    assert table.csv().splitlines()[0].startswith("run,direction,uncalibrated_m")
    gap = table_of([row("a", "cw", 1.0, 0.5, float("nan"), float("nan"))], "end")
    assert gap.lines()[0][3] == "-"
    assert gap.csv().splitlines()[1].endswith(",,")
