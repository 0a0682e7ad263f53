"""The Kalman filter: its matrices, its consistency, and what it does with bad rows."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.fusion import STATES, FilterNoise, InitialStd, Navigator, RobotParameters, Trajectory
from gyrocal.fusion import filter as loop
from tests.fusion.drive import Drive, paper, simulate

Floats = NDArray[np.float64]

PRIORS = InitialStd(
    right_scale=0.003, left_scale=0.003, wheel_separation_m=0.005, gyro_scale=0.0005, gyro_bias_dps=0.001
)
ROBOTS = {
    "paper": RobotParameters(0.5, PRIORS, FilterNoise(0.005, 0.0, 0.08, 0.0, 0.05)),
    "skid steer, walking bias": RobotParameters(0.5, PRIORS, FilterNoise(0.005, 0.05, 0.1, 1e-4, 0.05)),
}
ROBOT = ROBOTS["paper"]
FALSE_ALARM = 1e-3


def run(
    robot: RobotParameters, drive: Drive, *, filtering: bool = True, estimate_scale: bool = True
) -> tuple[Navigator, Trajectory]:
    navigator = paper(robot, filtering=filtering, estimate_scale=estimate_scale)
    return navigator, navigator.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)


# ------------------------------------------------------------------------------------- transition matrix


def model(errors: Floats, right: float, left: float, rate: float, dt: float) -> Floats:
    """Estimate after one step (eqs. 6, 7, 10) when the estimate before errs by `errors`; in the loop's order.

    True: psi = phi = 0.3 rad, D = 0.5 m, B_s = 1, B_rb = 0.
    """
    x, y, psi, phi, bias, scale, s_right, s_left, width = errors
    by_right, by_left = (1 + s_right) * right, (1 + s_left) * left
    turned = (by_right - by_left) / (0.5 + width)
    middle, travel = 0.3 + psi + 0.5 * turned, 0.5 * (by_right + by_left)
    phi = 0.3 + phi + ((1 + scale) * rate + bias) * dt
    pose = [x + np.cos(middle) * travel, y + np.sin(middle) * travel, 0.3 + psi + turned, phi]
    return np.array([*pose, *errors[4:]])


@pytest.mark.parametrize(("right", "left"), [(0.12, 0.12), (0.05, 0.11), (-0.04, 0.07)])
def test_transition_matrix_is_the_derivative_of_the_model(right: float, left: float) -> None:
    dt, rate = 0.1, (right - left) / 0.5 / 0.1
    columns = []
    for k in range(9):
        h = np.zeros(9)
        h[k] = 1e-5
        columns.append((model(h, right, left, rate, dt) - model(-h, right, left, rate, dt)) / 2e-5)
    nav, m = np.zeros(loop.MEMORY_SIZE), np.eye(loop.MATRIX_ROWS, 9)
    nav[[loop.SCALE, loop.RIGHT, loop.LEFT]], nav[loop.WIDTH] = 1.0, 0.5
    nav[loop.PSI] = nav[loop.PHI] = 0.3
    loop._advance(nav, m, np.zeros(9), dt, left, right, rate, True, True, True)
    np.testing.assert_allclose(m[:9], np.array(columns).T, atol=1e-9)
    np.testing.assert_allclose(nav[:4], model(np.zeros(9), right, left, rate, dt)[:4], atol=1e-15)


def test_factorised_filter_equals_the_dense_one() -> None:
    """P and gain of the loop against F P F' + Q and the Joseph form, written with dense matrices."""
    robot = ROBOTS["skid steer, walking bias"]
    drive = simulate(robot, np.random.default_rng(7), 60.0)
    navigator = paper(robot)
    navigator.step(0.0, 0.0, 0.0, 0.0)
    figures = navigator._figures
    p = np.diag(navigator._matrix[loop.D])
    h = np.zeros(9)
    h[[loop.PSI, loop.PHI]] = 1.0, -1.0
    for k in range(1, drive.t_s.size):
        before = navigator._nav.copy()
        navigator.step(0.1, drive.left_m[k], drive.right_m[k], drive.gyro_dps[k])
        f, q = dense_matrices(before, figures, drive.left_m[k], drive.right_m[k], drive.gyro_dps[k])
        p = f @ p @ f.T + q
        gain = p @ h / (h @ p @ h + figures[loop.MEASUREMENT])
        a = np.eye(9) - np.outer(gain, h)
        p = a @ p @ a.T + np.outer(gain, gain) * figures[loop.MEASUREMENT]
    u, d = navigator._matrix[:9], navigator._matrix[loop.D]
    scale = np.sqrt(np.diag(p))
    np.testing.assert_allclose((u * d) @ u.T / np.outer(scale, scale), p / np.outer(scale, scale), atol=1e-9)


def dense_matrices(
    nav: Floats, figures: Floats, left: float, right: float, gyro_dps: float
) -> tuple[Floats, Floats]:
    """F and Q of one 0.1 s step of `nav`, entry by entry from the equations."""
    dt, width, omega = 0.1, nav[loop.WIDTH], np.radians(gyro_dps)
    travel = 0.5 * (nav[loop.RIGHT] * right + nav[loop.LEFT] * left)
    by_wheels = (nav[loop.RIGHT] * right - nav[loop.LEFT] * left) / width
    turned = (nav[loop.SCALE] * omega + nav[loop.BIAS]) * dt
    u_right, u_left = travel + 0.5 * width * turned, travel - 0.5 * width * turned
    middle = nav[loop.PSI] + 0.5 * by_wheels
    sin, cos = np.sin(middle), np.cos(middle)
    f = np.eye(9)
    wheels = [loop.RIGHT, loop.LEFT, loop.WIDTH]
    f[loop.PSI, wheels] = u_right / width, -u_left / width, (u_left - u_right) / width**2
    f[loop.PHI, [loop.BIAS, loop.SCALE]] = dt, omega * dt
    f[loop.X, loop.PSI], f[loop.Y, loop.PSI] = -sin * travel, cos * travel
    f[loop.X, wheels] = 0.5 * cos * np.array([u_right, u_left, 0]) - 0.5 * sin * travel * f[loop.PSI, wheels]
    f[loop.Y, wheels] = 0.5 * sin * np.array([u_right, u_left, 0]) + 0.5 * cos * travel * f[loop.PSI, wheels]
    across = np.zeros(9)
    across[[loop.X, loop.Y, loop.PSI]] = -0.5 * sin * travel, 0.5 * cos * travel, 1.0
    along = np.zeros(9)
    along[[loop.X, loop.Y]] = 0.5 * cos, 0.5 * sin
    q = np.zeros((9, 9))
    for sign, distance in ((1, u_right), (-1, u_left)):
        v = along + sign * across / width
        q += figures[loop.SLIP] * abs(distance) * np.outer(v, v)
    q += figures[loop.TURN] * abs(turned) * np.outer(across, across)
    q[loop.PHI, loop.PHI] += figures[loop.WALK] * dt
    q[loop.BIAS, loop.BIAS] += figures[loop.BIAS_WALK] * dt
    return f, q


# ------------------------------------------------------------------------------------------- consistency


def consistency(robot: RobotParameters, seeds: range, scale: bool) -> tuple[float, int, float, int]:
    """Sums of NIS and NEES over seeds, with their degrees of freedom."""
    nis = nees = 0.0
    nis_rows = 0
    kept = [k for k in range(9) if scale or STATES[k] != "gyro_scale_error"]
    for seed in seeds:
        drive = simulate(robot, np.random.default_rng(seed), scale=scale)
        navigator, out = run(robot, drive, estimate_scale=scale)
        normalised = out.innovation_deg[1:] / out.innovation_sigma_deg[1:]
        nis += float(normalised @ normalised)
        nis_rows += normalised.size
        heading = drive.heading_deg[-1]
        # The white heading error is in the encoders, and so in the heading, but no state of the filter.
        pose = [drive.x_m[-1], drive.y_m[-1], heading + drive.heading_noise_deg[-1]]
        truth = np.array([*pose, *drive.constants[:3], heading, *drive.constants[3:]])
        error = (out.states[-1] - truth)[kept]
        nees += float(error @ np.linalg.solve(navigator.covariance[np.ix_(kept, kept)], error))
    return nis, nis_rows, nees, len(seeds) * len(kept)


def check_consistency(robot: RobotParameters, seeds: range, scale: bool) -> None:
    nis, nis_rows, nees, nees_rows = consistency(robot, seeds, scale)
    half = FALSE_ALARM / 4  # two sides of two statistics
    assert stats.chi2.ppf(half, nis_rows) < nis < stats.chi2.isf(half, nis_rows)
    assert stats.chi2.ppf(half, nees_rows) < nees < stats.chi2.isf(half, nees_rows)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("scale", [True, False])
def test_nis_and_nees_lie_in_chi_square_bounds(name: str, scale: bool) -> None:
    check_consistency(ROBOTS[name], range(40), scale)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("scale", [True, False])
def test_nis_and_nees_over_many_seeds(name: str, scale: bool) -> None:
    check_consistency(ROBOTS[name], range(1000, 1400), scale)


def test_consistency_check_sees_a_filter_that_is_too_sure() -> None:
    robot = ROBOTS["paper"]
    sure = replace(robot, noise=replace(robot.noise, wheel_slip_m_per_rt_m=0.9 * 0.005))
    drives = [simulate(robot, np.random.default_rng(seed)) for seed in range(20)]
    nis = [run(sure, d)[1] for d in drives]
    total = sum(float(np.nansum((t.innovation_deg / t.innovation_sigma_deg) ** 2)) for t in nis)
    assert total > stats.chi2.isf(FALSE_ALARM / 4, sum(t.t_s.size - 1 for t in nis))


@pytest.mark.parametrize("rows", [50_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_p_stays_symmetric_and_positive_over_half_a_million_and_ten_million_steps(rows: int) -> None:
    if loop.njit is None:
        pytest.skip("millions of steps take numba")
    robot = replace(ROBOT, noise=replace(ROBOT.noise, heading_noise_deg=0.001))
    navigator = paper(robot)
    drive = simulate(robot, np.random.default_rng(2), rows * 0.1)
    for block in range(10):
        t = drive.t_s + block * rows * 0.1
        out = navigator.run(t, drive.left_m, drive.right_m, drive.gyro_dps)
    p = navigator.covariance
    assert np.array_equal(p, p.T)
    assert np.all(navigator._matrix[loop.D] >= 0.0)
    assert np.all(out.std >= 0.0)
    scale = np.sqrt(np.diag(p))
    eigenvalues = np.linalg.eigvalsh(p / np.outer(scale, scale))
    assert eigenvalues.min() > -9 * np.finfo(float).eps * eigenvalues.max()
    assert out.counts.rows == 10 * rows
    assert out.counts.gated < 10 * rows * 1e-5


# -------------------------------------------------------------------------------------- one code, one answer


def bad_rows(drive: Drive) -> Drive:
    """The drive with a gap, duplicated times, and missing readings of each kind."""
    left, right, gyro, t = (a.copy() for a in (drive.left_m, drive.right_m, drive.gyro_dps, drive.t_s))
    left[100], right[200:205], gyro[300:310] = np.nan, np.inf, np.nan
    left[400] = gyro[400] = np.nan
    t[500:] += 3.0
    t[600:] -= t[600] - t[599]
    t[700:] -= t[700] - t[699]
    left[700], right[700], gyro[700] = left[699], right[699], gyro[699]
    right[800] += 0.1
    return replace(drive, t_s=t, left_m=left, right_m=right, gyro_dps=gyro)


def test_counts_name_every_bad_row() -> None:
    drive = bad_rows(simulate(ROBOT, np.random.default_rng(1)))
    for filtering in (True, False):
        navigator, out = run(ROBOT, drive, filtering=filtering)
        c = navigator.counts
        assert (c.rows, c.gaps, c.duplicates, c.repeated) == (2000, 1, 2, 1)
        assert (c.no_encoders, c.no_gyro) == (7, 11)
        assert np.isfinite(out.states).all()
        if filtering:
            assert c.gated == 1
            # First row, seven without encoders, ten more without gyro, gap, two duplicates: nothing measured.
            assert c.updates == 2000 - 21 == np.isfinite(out.innovation_deg).sum()


@pytest.mark.parametrize("filtering", [True, False])
def test_stream_equals_batch_to_the_bit(filtering: bool) -> None:
    drive = bad_rows(simulate(ROBOT, np.random.default_rng(1)))
    _, batch = run(ROBOT, drive, filtering=filtering)
    by_step, by_block = paper(ROBOT, filtering=filtering), paper(ROBOT, filtering=filtering)
    channels = (drive.left_m, drive.right_m, drive.gyro_dps)
    rows = [by_step.step(*row) for row in zip(np.diff(drive.t_s, prepend=0.0), *channels, strict=True)]
    edges = [0, 1, 1, 7, 400, 401, 1999, 2000]
    blocks = [by_block.run(drive.t_s[a:b], *(c[a:b] for c in channels)) for a, b in itertools.pairwise(edges)]
    for name in ("x_m", "y_m", "heading_deg", "states", "std", "innovation_deg", "innovation_sigma_deg"):
        expected = getattr(batch, name)
        assert np.array_equal([getattr(r, name) for r in rows], expected, equal_nan=True), name
        joined = np.concatenate([getattr(b, name) for b in blocks])
        assert np.array_equal(joined, expected, equal_nan=True), name
    assert by_step.counts == by_block.counts == batch.counts


def test_without_numba_the_same_numbers_to_1e_12() -> None:
    if loop.njit is None:
        pytest.skip("numba is not installed, so there is nothing to compare with")
    code = """
import json, sys
sys.modules["numba"] = None
import numpy as np
from gyrocal.fusion import Navigator, filter as loop
from tests.fusion.drive import simulate
from tests.fusion.test_filter import ROBOTS, bad_rows, run
assert loop.njit is None
robot = ROBOTS["skid steer, walking bias"]
drive = bad_rows(simulate(robot, np.random.default_rng(1), 100.0))
out = run(robot, drive)[1]
alone = run(robot, drive, filtering=False)[1]
print(json.dumps([out.states.tolist(), out.std.tolist(), alone.states.tolist()]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    robot = ROBOTS["skid steer, walking bias"]
    drive = bad_rows(simulate(robot, np.random.default_rng(1), 100.0))
    out, alone = run(robot, drive)[1], run(robot, drive, filtering=False)[1]
    for slow, fast in zip(json.loads(done.stdout), (out.states, out.std, alone.states), strict=True):
        scale = np.maximum(np.abs(fast).max(axis=0), 1e-3)
        np.testing.assert_allclose(np.array(slow) / scale, fast / scale, rtol=0, atol=1e-12)


# ------------------------------------------------------------------------------------------- what it does


def test_wheel_slip_is_gated_counted_and_leaves_the_constants_alone() -> None:
    drive = simulate(ROBOT, np.random.default_rng(5))
    _, clean = run(ROBOT, drive)
    slipped = drive.right_m.copy()
    slipped[1200] += 0.2  # 23 deg of heading in one step
    navigator, out = run(ROBOT, replace(drive, right_m=slipped))
    assert navigator.counts.gated == 1
    assert out.innovation_deg[1200] > 20.0
    assert abs(out.heading_deg[1200] - out.states[1200, 6]) < 0.2
    constants = [3, 4, 5, 7, 8]
    moved = np.abs(out.states[-1] - clean.states[-1]) / clean.std[-1]
    assert np.all(moved[constants] < 0.3)


def test_missing_encoders_hold_the_speed_and_widen_the_position() -> None:
    robot = replace(ROBOT, initial_std=InitialStd(), noise=replace(ROBOT.noise, wheel_slip_m_per_rt_m=0.0))
    rows = 100
    left = np.full(rows, 0.1)
    left[50:60] = np.nan
    out = paper(robot).run(np.arange(rows) * 0.1, left, np.full(rows, 0.1), np.zeros(rows))
    assert out.x_m[-1] == pytest.approx(0.1 * rows, abs=1e-9)
    # Ten held steps of 0.1 m might each be wrong by all of it, and all in the same direction.
    grown = out.std[59, 0] ** 2 - out.std[49, 0] ** 2
    assert grown == pytest.approx(1.0, rel=0.05)


def test_missing_gyro_takes_the_heading_of_the_encoders() -> None:
    rows, turn = 200, 0.02
    half = 0.5 * 0.5 * turn
    gyro = np.full(rows, np.degrees(turn / 0.1))
    gyro[50:90] = np.nan
    t = np.arange(rows) * 0.1
    for filtering in (True, False):
        navigator = paper(ROBOT, filtering=filtering)
        out = navigator.run(t, np.full(rows, 0.1 - half), np.full(rows, 0.1 + half), gyro)
        assert out.heading_deg[-1] == pytest.approx(
            np.degrees(turn * (rows - 1)), abs=np.degrees(turn) * 1.01
        )


def test_gap_does_not_integrate_the_gyro() -> None:
    t = np.arange(100) * 0.1
    t[60:] += 20.0
    gyro = np.zeros(100)
    gyro[60] = 50.0  # one sample after the gap says nothing of the 20 s before it
    navigator = paper(ROBOT, filtering=False)
    out = navigator.run(t, np.zeros(100), np.zeros(100), gyro)
    assert navigator.counts.gaps == 1
    assert out.heading_deg[-1] == 0.0


def test_slower_sampling_is_followed_not_counted_as_gaps_for_ever() -> None:
    t = np.concatenate([np.arange(100) * 0.01, 1.0 + np.arange(600) * 0.1])
    n = t.size
    navigator = paper(ROBOT, filtering=False)
    navigator.run(t, np.zeros(n), np.zeros(n), np.zeros(n))
    assert 0 < navigator.counts.gaps < 100


def test_filter_finds_the_wheels_by_the_gyro() -> None:
    robot = RobotParameters(
        0.5,
        InitialStd(
            right_scale=0.01, left_scale=0.01, wheel_separation_m=0.05, gyro_scale=0.0, gyro_bias_dps=0.0
        ),
        FilterNoise(0.002, 0.0, 0.08, 0.0, 0.05),
    )
    drive = simulate(robot, np.random.default_rng(11), 600.0)
    _, out = run(robot, drive, estimate_scale=False)
    s_right, s_left, width = drive.constants[:3]
    assert out.states[-1, 3] - out.states[-1, 4] == pytest.approx(s_right - s_left, abs=3e-4)
    assert out.std[-1, 5] < 0.3 * 0.05
    assert abs(out.states[-1, 5] - width) < 4 * out.std[-1, 5]
    # Heading differences say nothing of the size of both wheels and D together.
    assert out.std[-1, 3] > 0.5 * 0.01
