"""The navigator's interface: geometry, calibration, refusals."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrocal.errors import DataError, ProfileError
from gyrocal.fusion import (
    STATES,
    Coefficients,
    FilterNoise,
    InitialStd,
    Navigator,
    RobotParameters,
    Valid,
)
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_RATE, FLAG_TEMPERATURE
from gyrocal.physics.surface import Surface
from tests.fusion.drive import paper
from tests.fusion.test_compensation import coefficients, entry

Floats = NDArray[np.float64]
ROBOT = RobotParameters(0.5)


def calibration() -> Coefficients:
    table = np.zeros((4, 3))
    table[0], table[1] = [0.02, 0.01, 0.003], [0.3, 0.05, 0.0]
    surface = Surface(table, 0.0, 100.0, 25.0, 30.0)
    return Coefficients({"model": "RD2100"}, surface, np.zeros((12, 12)), Valid((-90.0, 90.0), (0.0, 50.0)))


def circle(rows: int) -> tuple[Floats, Floats, Floats, Floats]:
    """A full turn to the left on a radius of 2 m, in `rows` steps of 0.1 s after the first row."""
    turn = 2.0 * math.pi / rows
    t: Floats = 0.1 * np.arange(rows + 1, dtype=np.float64)
    left, right, rate = (
        np.where(t > 0.0, v, 0.0) for v in (1.75 * turn, 2.25 * turn, math.degrees(turn / 0.1))
    )
    return t, left, right, rate


@pytest.mark.parametrize("filtering", [True, False])
def test_circle_closes_and_lies_to_the_left(filtering: bool) -> None:
    t, left, right, rate = circle(400)
    navigator = paper(ROBOT, filtering=filtering)
    out = navigator.run(t, left, right, rate)
    assert out.heading_deg[-1] == pytest.approx(360.0, abs=1e-9)
    assert math.hypot(out.x_m[-1], out.y_m[-1]) < 1e-9
    assert out.x_m[100] == pytest.approx(2.0, rel=1e-4)
    assert out.y_m[100] == pytest.approx(2.0, rel=1e-4)
    assert out.y_m.max() == pytest.approx(4.0, rel=1e-4)
    assert np.abs(out.x_m).max() == pytest.approx(2.0, rel=1e-4)


def test_without_filter_the_gyro_alone_turns_the_robot() -> None:
    t, left, right, _ = circle(400)
    out = paper(ROBOT, filtering=False).run(t, left, right, np.zeros(t.size))
    assert out.heading_deg[-1] == 0.0
    assert out.states[-1, STATES.index("heading_deg")] > 350.0
    assert np.isnan(out.std).all()
    assert np.isnan(out.innovation_deg).all()
    assert np.all(out.states[:, 3:6] == 0.0)


def test_calibration_then_static_bias() -> None:
    rng = np.random.default_rng(0)
    c = calibration()
    n = 200
    t, temp = np.arange(n) * 0.1, 20.0 + np.linspace(0.0, 5.0, n)
    gyro, left, right = rng.normal(0.0, 20.0, n), rng.normal(0.1, 0.01, n), rng.normal(0.1, 0.01, n)
    by_navigator = paper(ROBOT, c, static_bias_dps=0.015).run(t, left, right, gyro, temp)
    by_hand = paper(ROBOT, estimate_scale=False).run(t, left, right, c.correct(gyro, temp) - 0.015)
    np.testing.assert_allclose(by_navigator.states, by_hand.states, rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_navigator.std, by_hand.std, rtol=0, atol=1e-12)


def test_with_calibration_the_scale_factor_is_not_estimated_without_it_is() -> None:
    scale = STATES.index("gyro_scale_error")
    t, left, right, rate = circle(400)
    calibrated = paper(ROBOT, calibration()).run(t, left, right, rate, 25.0)
    assert np.all(calibrated.states[:, scale] == 0.0)
    assert np.all(calibrated.std[:, scale] == 0.0)
    wheels = InitialStd(right_scale=0.0, left_scale=0.0, wheel_separation_m=0.0)
    known = replace(ROBOT, initial_std=wheels, noise=FilterNoise(0.001, 0.0, 0.08, 0.0, 0.1))
    alone = paper(known).run(t, left, right, rate * 1.01)
    assert alone.std[0, scale] == ROBOT.initial_std.gyro_scale
    assert alone.states[-1, scale] == pytest.approx(0.01, abs=0.002)
    both = paper(ROBOT, calibration(), estimate_scale=True).run(t, left, right, rate, 25.0)
    assert both.std[0, scale] == ROBOT.initial_std.gyro_scale


def test_rows_outside_the_calibration_are_flagged_and_counted() -> None:
    gyro = np.array([0.0, 95.0, -95.0, 0.0, 0.0, np.nan])
    temp = np.array([25.0, 25.0, 25.0, 60.0, np.nan, 25.0])
    navigator = paper(ROBOT, calibration(), filtering=False)
    out = navigator.run(np.arange(6) * 0.1, np.zeros(6), np.zeros(6), gyro, temp)
    held = FLAG_TEMPERATURE | FLAG_NOT_FINITE  # the last temperature, itself outside
    assert out.flags.tolist() == [0, FLAG_RATE, FLAG_RATE, FLAG_TEMPERATURE, held, FLAG_NOT_FINITE]
    c = navigator.counts
    assert (c.outside_rate, c.outside_temperature, c.no_temperature, c.no_gyro) == (2, 2, 1, 1)


def test_temperature_is_held_over_the_edge_of_a_block() -> None:
    def heading(edge: int) -> float:
        navigator = paper(ROBOT, calibration(), filtering=False)
        t, temp = np.arange(6) * 0.1, np.array([40.0, 40.0, np.nan, np.nan, 10.0, np.nan])
        for rows in (slice(edge), slice(edge, None)):
            out = navigator.run(
                t[rows], np.zeros(6)[rows], np.zeros(6)[rows], np.full(6, 30.0)[rows], temp[rows]
            )
        assert navigator.counts.no_temperature == 3
        return float(out.heading_deg[-1])

    assert len({heading(edge) for edge in range(1, 6)}) == 1


def test_no_temperature_yet_means_no_gyro_yet() -> None:
    navigator = paper(ROBOT, calibration(), filtering=False)
    for temp in (math.nan, math.nan, 25.0):
        navigator.step(0.1, 0.0, 0.0, 10.0, temp)
    assert (navigator.counts.no_gyro, navigator.counts.no_temperature) == (2, 2)


def test_calibration_without_temperature_is_refused() -> None:
    with pytest.raises(DataError, match=r"needs the gyro's temperature.*replay without it"):
        paper(ROBOT, calibration()).step(0.1, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("dt", [-0.1, math.nan, math.inf])
def test_time_that_goes_back_or_is_not_finite_is_refused(dt: float) -> None:
    navigator = paper(ROBOT)
    navigator.step(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(DataError, match=r"row 1: the time step is .*mend the log"):
        navigator.step(dt, 0.0, 0.0, 0.0)
    with pytest.raises(DataError, match=r"row 3: the time step is -0.5 s"):
        navigator.run([0.1, 0.6, 0.1], *[np.zeros(3)] * 3)
    assert navigator.counts.rows == 1


def test_lengths_that_differ_are_refused() -> None:
    with pytest.raises(DataError, match=r"differ in their number of rows"):
        paper(ROBOT).run(np.arange(3.0), np.zeros(3), np.zeros(2), np.zeros(3))


def test_absurd_distances_are_refused() -> None:
    with pytest.raises(DataError, match=r"no longer be finite: check units"):
        paper(ROBOT).run([0.0, 0.1], [0.0, 1e308], [0.0, 1e308], [0.0, 0.0])


@pytest.mark.parametrize("kind", ["model", "paper"])
@pytest.mark.parametrize("row", [(0.05, 0.06, 1e308), (1e200, 1e200, 1.0), (1e308, 1e308, 1.0)])
def test_a_row_that_is_refused_changes_nothing(kind: str, row: tuple[float, float, float]) -> None:
    spoilt, other, sound = (Navigator(ROBOT, kind=kind) for _ in range(3))
    for navigator in (spoilt, other, sound):
        for k in range(50):
            navigator.step(0.05, 0.04 + 1e-4 * k, 0.05, 10.0)
    with pytest.raises(DataError, match=r"no longer be finite.*stays as it was"):
        spoilt.step(0.05, *row)
    with pytest.raises(DataError, match=r"no longer be finite.*stays as it was"):
        other.run(other.t_s + np.array([0.05, 0.1]), *(np.array([0.0, value]) for value in row))
    wanted = sound.step(0.05, 0.05, 0.06, 3.0)
    for navigator in (spoilt, other):
        row_after = navigator.step(0.05, 0.05, 0.06, 3.0)
        assert np.array_equal(row_after.states, wanted.states)
        assert (row_after.t_s, navigator.counts) == (wanted.t_s, sound.counts)


def test_a_row_that_is_refused_leaves_the_calibration_as_it_was() -> None:
    spoilt, sound = (paper(ROBOT, calibration(), filtering=False) for _ in range(2))
    for navigator in (spoilt, sound):
        navigator.step(0.1, 0.1, 0.1, 10.0, 25.0)
    with pytest.raises(DataError, match=r"no longer be finite"):
        spoilt.step(0.1, 1e308, 1e308, 10.0, 49.0)
    # The temperature is held at the last one that was taken.
    a, b = (n.step(0.1, 0.1, 0.1, 10.0, math.nan) for n in (spoilt, sound))
    assert np.array_equal(a.states, b.states)


@pytest.mark.parametrize("row", [(0.05, 0.05, None), (None, 0.05, 1.0), (0.05, "none", 1.0)])
def test_a_reading_that_is_no_number_is_refused(row: tuple[float, float, float]) -> None:
    navigator = paper(ROBOT)
    with pytest.raises(DataError, match=r"row 0: .* are numbers; give NaN for a reading that is missing"):
        navigator.step(0.05, *row)
    assert navigator.counts.rows == 0


def test_an_unknown_filter_is_refused() -> None:
    with pytest.raises(DataError, match=r"no filter 'modle'; kind is 'model' or 'paper'"):
        Navigator(ROBOT, kind="modle")


def test_single_rows_count_from_the_start_that_is_given() -> None:
    start_s, warming = 1234.5, coefficients(entry("warm_up", amplitude=30.0, tau_s=900.0))
    by_row, by_block = (
        Navigator(ROBOT, warming, filtering=False, power_on_t_s=1200.0, start_t_s=t) for t in (start_s, 0.0)
    )
    t_s = start_s + 0.5 * np.arange(20.0)
    block = by_block.run(t_s, np.zeros(20), np.zeros(20), np.full(20, 1.0), np.full(20, 25.0))
    for k in range(20):
        row = by_row.step(0.5 if k else 0.0, 0.0, 0.0, 1.0, 25.0)
        assert row.t_s == t_s[k]
        assert np.array_equal(row.states, block.states[k])


def test_static_bias_must_be_finite() -> None:
    with pytest.raises(DataError, match=r"static bias is nan deg/s"):
        paper(ROBOT, static_bias_dps=math.nan)


def test_empty_block_changes_nothing() -> None:
    navigator = paper(ROBOT)
    navigator.step(0.1, 0.1, 0.1, 0.0)
    before = navigator.covariance
    assert navigator.run([], [], [], []).states.shape == (0, 9)
    assert np.array_equal(navigator.covariance, before)


@given(st.lists(st.sampled_from([0.0, 1.0, -1e3, 1e12, math.nan, math.inf]), min_size=4, max_size=40))
def test_whatever_the_readings_the_states_are_finite_or_it_says_so(values: list[float]) -> None:
    n = len(values) // 4
    dt, left, right, gyro = (np.array(values[k * n : (k + 1) * n]) for k in range(4))
    navigator = paper(ROBOT)
    t = np.cumsum(np.abs(np.nan_to_num(dt, posinf=1.0)))
    try:
        out = navigator.run(t, left, right, gyro)
    except DataError as error:
        assert "no longer be finite" in str(error)  # noqa: PT017 - either outcome is right
        return
    assert np.isfinite(out.states[-1]).all()
    assert navigator.counts.rows == n


@pytest.mark.parametrize(
    ("robot", "text"),
    [
        (lambda: RobotParameters(0.0), "wheel_separation_m is 0.0; allowed: a number, 0.001 to 10."),
        (lambda: RobotParameters(math.nan), "wheel_separation_m is nan"),
        (lambda: replace(ROBOT, gap_factor=1.0), "gap_factor is 1.0; allowed: a number, 1 to"),
        (lambda: FilterNoise(heading_noise_deg=0.0), "heading_noise_deg is 0.0"),
        (lambda: FilterNoise(wheel_slip_m_per_rt_m=-1.0), "wheel_slip_m_per_rt_m is -1.0"),
        (lambda: InitialStd(x_m=math.inf), "x_m is inf; allowed: a number, 0 to 10000."),
    ],
)
def test_robot_figures_are_checked(robot: object, text: str) -> None:
    assert callable(robot)
    with pytest.raises(ProfileError) as caught:
        robot()
    assert text in str(caught.value)


def test_import_takes_numpy_only() -> None:
    code = """
import sys
for name in ("scipy", "pandas", "matplotlib", "click", "rich", "jinja2", "serial"):
    sys.modules[name] = None
import gyrocal.fusion
assert "numba" not in sys.modules
gyrocal.fusion.Navigator(gyrocal.fusion.RobotParameters(0.5)).step(0.0, 0.0, 0.0, 0.0)
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
