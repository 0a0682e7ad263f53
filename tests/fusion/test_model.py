"""The drive model as a filter: against dense matrices, against its own statistics, and what it does at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import lfilter

from gyrocal.fusion import (
    EncoderFigures,
    FilterNoise,
    GyroFigures,
    InitialStd,
    Navigator,
    RobotParameters,
    SlipFigures,
    Trajectory,
)
from gyrocal.physics.drive import FLICKER_TAUS_S, tick_wait_s
from gyrocal.physics.slip import slip_shape

Floats = NDArray[np.float64]
DT, WIDTH = 0.1, 0.5
NOISE = FilterNoise(
    0.002, 0.1, 0.2, tick_m=0.001, jitter_s=0.002, flicker_dps=0.002,
    track_wander=0.02, track_wander_s=6.0, wheel_wander=0.003, wheel_wander_s=12.0,
)  # fmt: skip
PRIOR = InitialStd(
    right_scale=0.002, left_scale=0.002, wheel_separation_m=0.005, gyro_scale=0.0, gyro_bias_dps=0.02
)
ROBOT = RobotParameters(WIDTH, PRIOR, NOISE, static_s=0.0)
#: A robot of which nobody has measured how far and how much it really went.
UNSURE = replace(
    ROBOT, initial_std=replace(PRIOR, gyro_scale=0.003), encoders=EncoderFigures(0.0, 0.005, 0.0, 0.005)
)


@dataclass(frozen=True)
class Drive:
    """Log and truth."""

    t_s: Floats
    left_m: Floats
    right_m: Floats
    gyro_dps: Floats
    heading_deg: Floats
    x_m: Floats
    y_m: Floats
    moving: NDArray[np.bool_]


def markov(rng: np.random.Generator, n: int, tau_s: float, sigma: float) -> Floats:
    keep = np.exp(-DT / tau_s)
    value, out = sigma * rng.normal(), np.empty(n)
    for k, shock in enumerate(rng.normal(size=n)):
        value = keep * value + sigma * np.sqrt(1.0 - keep * keep) * shock
        out[k] = value
    return out


def draw(
    rng: np.random.Generator, rest_s: float = 10.0, duration_s: float = 300.0, robot: RobotParameters = ROBOT
) -> Drive:
    """A drive of the model: stand, wind, stand in the middle, wind, stand."""
    t: Floats = np.arange(0.0, duration_s, DT)
    n = t.size
    middle = abs(t - 0.5 * duration_s) < 0.5 * rest_s
    moving = (t > rest_s) & ~middle & (t < duration_s - rest_s)
    omega = np.radians(25.0 * np.sin(t / 7.0) + 8.0) * moving
    travel = (1.0 + 0.4 * np.sin(t / 11.0)) * DT * moving
    turned = omega * DT
    std, noise = robot.initial_std, robot.noise
    right_scale, left_scale = rng.normal(0.0, std.right_scale), rng.normal(0.0, std.left_scale)
    width = WIDTH - rng.normal(0.0, std.wheel_separation_m or 0.0)
    scale, way = rng.normal(0.0, robot.gyro_scale_std), rng.normal(0.0, robot.way_std)
    right, left = travel + 0.5 * width * turned, travel - 0.5 * width * turned
    constant = rng.normal(0.0, std.gyro_bias_dps or 0.0)
    bias = constant + sum(markov(rng, n, tau, noise.flicker_dps) for tau in FLICKER_TAUS_S)
    walk = noise.angle_random_walk_deg_per_rt_h / 60.0 / np.sqrt(DT) * rng.normal(size=n)
    slip = noise.wheel_slip_m_per_rt_m * np.sqrt(np.abs([right, left])) * rng.normal(size=(2, n))
    spin = np.radians(noise.turn_slip_deg_per_rt_deg * np.sqrt(np.degrees(np.abs(turned)))) * rng.normal(
        size=n
    )
    spin = spin - markov(rng, n, noise.track_wander_s, noise.track_wander) * turned
    spin = spin - markov(rng, n, noise.wheel_wander_s, noise.wheel_wander) * travel / WIDTH
    e = np.hypot(noise.tick_m / np.sqrt(6.0) / WIDTH, noise.jitter_s * omega) * rng.normal(size=n)
    held = np.zeros(n)
    for k in range(n):
        held[k] = e[k] if moving[k] else (held[k - 1] if k else 0.0)
    across = 0.5 * WIDTH * (spin + np.diff(held, prepend=0.0))
    heading = np.cumsum(turned)
    along = heading - 0.5 * turned
    # Wheels and track agree with the gyro: by themselves they know neither the true turn nor the true way.
    heading, along, travel = heading / (1 + scale), along / (1 + scale), travel / (1 + way)
    return Drive(
        t,
        (1 + left_scale) * left + slip[1] * moving - across,
        (1 + right_scale) * right + slip[0] * moving + across,
        np.degrees(omega) + bias + walk,
        np.degrees(heading),
        np.cumsum(travel * np.cos(along)),
        np.cumsum(travel * np.sin(along)),
        moving,
    )


def run(
    drive: Drive, robot: RobotParameters = ROBOT, *, filtering: bool = True
) -> tuple[Navigator, Trajectory]:
    navigator = Navigator(robot, filtering=filtering)
    return navigator, navigator.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)


@pytest.mark.parametrize("filtering", [True, False])
def test_position_and_heading_err_as_the_covariance_says(filtering: bool) -> None:
    squares, drives = 0.0, 60
    for seed in range(drives):
        drive = draw(np.random.default_rng(seed))
        navigator, out = run(drive, filtering=filtering)
        error = np.array(
            [
                out.x_m[-1] - drive.x_m[-1],
                out.y_m[-1] - drive.y_m[-1],
                out.heading_deg[-1] - drive.heading_deg[-1],
            ]
        )
        places = [0, 1, 6]
        squares += float(error @ np.linalg.solve(navigator.covariance[np.ix_(places, places)], error))
        np.testing.assert_allclose(out.std[-1], np.sqrt(np.diag(navigator.covariance)), rtol=1e-6)
    # False alarm in 2 of 1000 sets of seeds.
    assert stats.chi2.ppf(1e-3, 3 * drives) < squares < stats.chi2.ppf(1 - 1e-3, 3 * drives)


@pytest.mark.parametrize("filtering", [True, False])
def test_deviations_hold_what_the_scales_are_unsure_by(filtering: bool) -> None:
    squares, drives = np.zeros(3), 60
    for seed in range(drives):
        drive = draw(np.random.default_rng(seed), robot=UNSURE)
        _, out = run(drive, UNSURE, filtering=filtering)
        for k, name in enumerate(("x_m", "y_m", "heading_deg")):
            error = getattr(out, name)[-1] - getattr(drive, name)[-1]
            squares[k] += float(error / out.std[-1, (0, 1, 6)[k]]) ** 2
    # Each on its own: a turn of the whole path by ten degrees is no small one, and bends their correlation.
    assert np.all((stats.chi2.ppf(1e-3, drives) < squares) & (squares < stats.chi2.ppf(1 - 1e-3, drives)))


def test_what_no_filter_lessens_is_no_part_of_the_drift() -> None:
    drive = draw(np.random.default_rng(1), robot=UNSURE)
    sure = replace(UNSURE, gyro=replace(UNSURE.gyro, scale_std=1e-6))
    (_, wide), (_, narrow) = run(drive, UNSURE, filtering=False), run(drive, sure, filtering=False)
    assert wide.std[-1, 0] > narrow.std[-1, 0]
    np.testing.assert_array_equal(wide.drift_m, narrow.drift_m)


def test_innovations_are_white_and_of_the_size_that_the_filter_expects() -> None:
    z = []
    for seed in range(20):
        _, out = run(draw(np.random.default_rng(100 + seed)))
        normalised = out.innovation_deg / out.innovation_sigma_deg
        z.append(normalised[np.isfinite(normalised)])
    whole = np.concatenate(z)
    # One sigma is 0.6 %; that a log begins and stops between nodes makes the filter expect 0.8 % too much.
    assert float(whole @ whole) / whole.size == pytest.approx(0.992, abs=0.02)
    pairs = np.concatenate([v[1:] * v[:-1] for v in z])
    assert abs(float(pairs.sum())) < 3.3 * np.sqrt(pairs.size)


def test_the_filter_beats_the_gyro_alone_and_both_know_by_how_much() -> None:
    errors = {True: [], False: []}  # type: dict[bool, list[float]]
    sigma = dict.fromkeys(errors, 0.0)
    for seed in range(30):
        drive = draw(np.random.default_rng(300 + seed), rest_s=1.0)
        for filtering in errors:
            _, out = run(drive, filtering=filtering)
            errors[filtering].append(float(out.heading_deg[-1] - drive.heading_deg[-1]))
            sigma[filtering] = float(out.std[-1, 6])
    rms = {k: float(np.sqrt(np.mean(np.square(v)))) for k, v in errors.items()}
    assert rms[True] < rms[False]
    assert sigma[True] < sigma[False]


def test_a_log_of_any_rate_gives_the_same_path() -> None:
    drive = draw(np.random.default_rng(5))
    fine = 10
    split = {name: np.repeat(getattr(drive, name) / fine, fine) for name in ("left_m", "right_m")}
    t = np.concatenate(
        [drive.t_s[:1] - DT + DT / fine * np.arange(1, fine + 1)]
        + [s - DT + DT / fine * np.arange(1, fine + 1) for s in drive.t_s[1:]]
    )
    _, slow = run(drive)
    fast = Navigator(ROBOT).run(t, split["left_m"], split["right_m"], np.repeat(drive.gyro_dps, fine))
    for name in ("x_m", "y_m"):
        np.testing.assert_allclose(getattr(fast, name)[fine - 1 :: fine], getattr(slow, name), atol=0.05)


def test_rows_of_a_second_follow_the_curve_between_them() -> None:
    fine, seconds = 100, 60
    t: Floats = np.arange(fine * seconds) / fine
    omega, speed = np.radians(20.0 * np.sin(t / 2.0)), 1.0 + 0.5 * np.sin(t / 3.0)
    heading = np.cumsum(omega) / fine
    truth = np.cumsum(speed * np.exp(1j * (heading - 0.5 * omega / fine))) / fine
    way, turn = (np.add.reduceat(v, np.arange(0, t.size, fine)) / fine for v in (speed, omega))
    half = 0.5 * WIDTH * turn
    rows = [np.append(0.0, v) for v in (way - half, way + half, np.degrees(turn))]
    out = Navigator(ROBOT, filtering=False).run(np.arange(seconds + 1.0), *rows)
    apart = np.abs((out.x_m + 1j * out.y_m)[1:] - truth[fine - 1 :: fine])
    # 0.3 m by arcs alone.
    assert apart.max() < 0.03


def test_a_turn_before_the_first_tick_is_not_taken_for_a_bias() -> None:
    drive = draw(np.random.default_rng(15), rest_s=6.0)
    start = int(np.argmax(drive.moving))
    early = drive.gyro_dps.copy()
    early[start - 5 : start] += 5.0
    (_, out), (_, clean) = run(replace(drive, gyro_dps=early)), run(drive)
    assert abs(out.states[start, 8] - clean.states[start, 8]) < 0.01


def test_a_slope_of_the_bias_is_known_as_well_as_the_file_says() -> None:
    drive = draw(np.random.default_rng(16), rest_s=0.0)
    robot = replace(ROBOT, gyro=GyroFigures(bias_slope_dps_per_c_std=0.1, temp_c=20.0))
    temp_c = 20.0 + 0.02 * drive.t_s
    out = Navigator(robot, filtering=False).run(
        drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps, temp_c
    )
    np.testing.assert_allclose(
        out.std[-1, 8] ** 2 - out.std[0, 8] ** 2, (0.1 * (temp_c[-1] - 20.0)) ** 2, rtol=0.05
    )


def test_flicker_goes_on_for_hours() -> None:
    """The bias's processes of 20, 200 and 2000 s keep their size, and turn the heading by their integral."""
    sigma, t = 0.002, np.arange(0.0, 8000.0, 1.0)
    still = InitialStd(right_scale=0.0, left_scale=0.0, gyro_scale=0.0, gyro_bias_dps=0.0)
    noise = FilterNoise(0.0, 0.0, 0.0, flicker_dps=sigma)
    robot = RobotParameters(WIDTH, still, noise, static_s=0.0)
    out = Navigator(robot, filtering=False).run(t, np.ones(t.size), np.ones(t.size), np.zeros(t.size))
    taus = np.array(FLICKER_TAUS_S)
    expected = np.sqrt(np.sum(2.0 * sigma**2 * taus**2 * (t[-1] / taus - 1.0 + np.exp(-t[-1] / taus))))
    assert out.std[-1, 6] == pytest.approx(expected, rel=0.05)
    assert out.std[-1, 8] == pytest.approx(sigma * np.sqrt(3.0), rel=0.01)


@pytest.mark.parametrize("width_m", [0.3, 2.0])
def test_a_track_that_nobody_measured_is_known_to_a_tenth(width_m: float) -> None:
    assert RobotParameters(width_m).initial_std.wheel_separation_m == pytest.approx(0.1 * width_m)


@pytest.mark.parametrize("filtering", [True, False])
def test_a_rest_in_the_middle_gives_the_bias(filtering: bool) -> None:
    drive = draw(np.random.default_rng(8), rest_s=20.0)
    biased = replace(drive, gyro_dps=drive.gyro_dps + 0.3)
    robot = replace(ROBOT, initial_std=replace(PRIOR, gyro_bias_dps=0.5))
    _, out = run(biased, robot, filtering=filtering)
    assert out.std[0, 8] == pytest.approx(0.5, rel=0.01)
    assert out.std[-1, 8] < 0.01
    assert abs(out.heading_deg[-1] - drive.heading_deg[-1]) < 4.0 * out.std[-1, 6]


@pytest.mark.parametrize("filtering", [True, False])
def test_a_bias_that_has_changed_by_a_rest_is_believed_and_the_path_stays(filtering: bool) -> None:
    log = draw(np.random.default_rng(3))
    gyro = log.gyro_dps + 0.05 * (log.t_s > 80.0)
    nav = Navigator(ROBOT, kind="model", filtering=filtering)
    out = nav.run(log.t_s, log.left_m, log.right_m, gyro)
    left = np.searchsorted(log.t_s, 154.0)
    assert out.counts.gated == 0
    assert out.states[left, 8] == pytest.approx(0.05, abs=3.0 * out.std[left, 8])
    stands = (log.t_s > 146.0) & (log.t_s < 155.0)
    assert np.ptp(out.heading_deg[stands]) < 0.3
    assert np.hypot(np.ptp(out.x_m[stands]), np.ptp(out.y_m[stands])) < 0.2


def test_blocks_of_any_size_and_single_rows_give_the_same_numbers() -> None:
    drive = draw(np.random.default_rng(9), duration_s=60.0)
    _, whole = run(drive)
    by_step, by_block = Navigator(ROBOT), Navigator(ROBOT)
    dt = np.diff(drive.t_s, prepend=0.0)
    parts = [
        by_block.run(
            drive.t_s[k : k + 37],
            drive.left_m[k : k + 37],
            drive.right_m[k : k + 37],
            drive.gyro_dps[k : k + 37],
        )
        for k in range(0, drive.t_s.size, 37)
    ]
    np.testing.assert_array_equal(np.concatenate([p.states for p in parts]), whole.states)
    for k in range(drive.t_s.size):
        row = by_step.step(float(dt[k]), drive.left_m[k], drive.right_m[k], drive.gyro_dps[k])
        np.testing.assert_array_equal(row.states, whole.states[k])


def test_what_the_file_knows_of_gyro_and_wheels_is_taken_away() -> None:
    drive = draw(np.random.default_rng(10))
    temp = 20.0 + 0.02 * drive.t_s
    spoilt = 1.01 * drive.gyro_dps + 0.2 + 0.01 * (temp - 25.0)
    figures = GyroFigures(0.2, bias_slope_dps_per_c=0.01, temp_c=25.0, scale=0.01)
    robot = replace(ROBOT, gyro=figures)
    _, clean = run(drive)
    out = Navigator(robot).run(drive.t_s, drive.left_m, drive.right_m, spoilt, temp)
    np.testing.assert_allclose(out.heading_deg, clean.heading_deg, atol=0.02)


@pytest.mark.parametrize("kind", ["model", "paper"])
@pytest.mark.parametrize("lag_s", [0.0, 1.0])
def test_a_bias_that_follows_the_motion_is_taken_away(lag_s: float, kind: str) -> None:
    drive = draw(np.random.default_rng(12))
    shaken, stood_s = np.zeros(drive.t_s.size), 1.0
    for k, dt_s in enumerate(np.diff(drive.t_s, prepend=drive.t_s[0])):
        stood_s = 0.0 if max(abs(drive.left_m[k]), abs(drive.right_m[k])) > 1e-6 else stood_s + dt_s
        shaken[k] = stood_s < tick_wait_s(ROBOT.noise.tick_m)
    if lag_s:
        keep = np.exp(-DT / lag_s)
        shaken = lfilter([1.0 - keep], [1.0, -keep], shaken)
    figures = GyroFigures(bias_moving_dps=0.2, bias_moving_s=lag_s)
    known = Navigator(replace(ROBOT, gyro=figures), kind=kind)
    told = known.run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps + 0.2 * shaken)
    clean = Navigator(ROBOT, kind=kind).run(drive.t_s, drive.left_m, drive.right_m, drive.gyro_dps)
    np.testing.assert_allclose(told.heading_deg, clean.heading_deg, atol=0.02)


@pytest.mark.parametrize("filtering", [True, False])
@pytest.mark.parametrize("stays", [True, False])
def test_a_stop_takes_nothing_off_a_known_bias_in_motion(stays: bool, filtering: bool) -> None:
    # A log that stands at its start only tells a step that stays from one that ends with the motion no better than its
    # file does; the stops of the next drive may show either.
    rng, t_s = np.random.default_rng(21), np.arange(0.0, 240.0, DT)
    moving = (t_s > 30.0) & ((t_s < 90.0) | (t_s > 94.0)) & ((t_s < 160.0) | (t_s > 163.0))
    turned_deg, travel_m = 20.0 * np.sin(t_s / 5.0) * moving * DT, 0.8 * DT * moving
    across_m = 0.5 * WIDTH * np.radians(turned_deg)
    slip_m = NOISE.wheel_slip_m_per_rt_m * np.sqrt(travel_m) * rng.normal(size=(2, t_s.size))
    added_dps = 0.05 * (np.cumsum(moving) > 0) if stays else 0.05 * moving
    white_dps = NOISE.angle_random_walk_deg_per_rt_h / 60.0 / np.sqrt(DT) * rng.normal(size=t_s.size)
    gyro_dps = turned_deg / DT + added_dps + white_dps
    figures = GyroFigures(bias_motion_dps=0.05, bias_motion_dps_std=0.001)
    navigator = Navigator(replace(ROBOT, gyro=figures), filtering=filtering)
    out = navigator.run(t_s, travel_m - across_m + slip_m[0], travel_m + across_m + slip_m[1], gyro_dps)
    told_deg = np.sum(turned_deg)
    # Plainly integrated it is off by the white noise: 0.1 deg.
    plain_deg = np.sum((gyro_dps - added_dps) * DT) - told_deg
    assert abs(out.heading_deg[-1] - told_deg) < abs(plain_deg) + 0.3
    assert abs(out.heading_deg[-1] - told_deg) < 3.0 * out.std[-1, 6]


@pytest.mark.parametrize("law", ["turn_rate", "curvature", "curvature_saturating"])
def test_the_slip_law_of_the_file_makes_the_encoders_agree(law: str) -> None:
    drive = draw(np.random.default_rng(11))
    turn, travel = drive.right_m - drive.left_m, 0.5 * (drive.right_m + drive.left_m)
    rate, speed = np.degrees(turn / WIDTH / DT), travel / DT
    wider = 1.0 + 0.3 * slip_shape(law, rate, speed, WIDTH, 1.0)
    slipped = replace(drive, left_m=travel - 0.5 * turn * wider, right_m=travel + 0.5 * turn * wider)
    known = replace(ROBOT, slip=SlipFigures(law, 0.3, shape=1.0))
    (_, ignorant), (_, told), (_, clean) = run(slipped), run(slipped, known), run(drive)

    # Without the law the track takes its part.
    np.testing.assert_allclose(told.states[-1, 5], clean.states[-1, 5], atol=0.002)
    assert abs(ignorant.states[-1, 5] - clean.states[-1, 5]) > 0.01


def test_missing_cells_and_gaps_are_bridged() -> None:
    drive = draw(np.random.default_rng(12))
    rng = np.random.default_rng(13)
    lost = rng.random(drive.t_s.size) < 0.02
    lame = rng.random(drive.t_s.size) < 0.02
    spoilt = replace(
        drive,
        gyro_dps=np.where(lost, np.nan, drive.gyro_dps),
        left_m=np.where(lame & drive.moving, np.nan, drive.left_m),
    )
    navigator, out = run(spoilt)
    assert navigator.counts.no_gyro == np.count_nonzero(lost)
    assert abs(out.heading_deg[-1] - drive.heading_deg[-1]) < 4.0 * out.std[-1, 6]
    error = np.hypot(out.x_m[-1] - drive.x_m[-1], out.y_m[-1] - drive.y_m[-1])
    assert error < 4.0 * np.hypot(out.std[-1, 0], out.std[-1, 1])


@pytest.mark.parametrize("gap_s", [1.0, 60.0, 3600.0])
@pytest.mark.parametrize("turn_deg", [0.0, 720.0])
def test_over_a_gap_the_robot_moves_by_the_way_of_its_wheels(gap_s: float, turn_deg: float) -> None:
    navigator = Navigator(ROBOT, filtering=False)
    for _ in range(200):
        before = navigator.step(0.05, 0.045, 0.055, 30.0)
    # The wheels go 0.1 m while nobody reads the gyro: straight on, or on a curve that comes round twice.
    half_m = 0.5 * WIDTH * np.radians(turn_deg)
    after = navigator.step(gap_s, 0.1 - half_m, 0.1 + half_m, 0.0)
    way_m = np.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    assert way_m == pytest.approx(0.0 if turn_deg else 0.1, abs=1e-9)
    # Nor has the course before the gap to do with the row after it, whose gyro may be missing.
    for gyro_dps in (np.nan, 0.0):
        before, after = after, navigator.step(0.05, 0.05, 0.05, gyro_dps)
        along = np.exp(1j * np.radians(before.heading_deg))
        went = complex(after.x_m - before.x_m, after.y_m - before.y_m)
        assert went == pytest.approx(0.05 * along, abs=1e-9)


def test_a_slip_beyond_the_gate_is_the_wheels() -> None:
    drive = draw(np.random.default_rng(14))
    k = 600
    spun = drive.right_m.copy()
    spun[k : k + 5] += 0.05
    (navigator, out), (_, clean) = run(replace(drive, right_m=spun)), run(drive)
    assert navigator.counts.gated >= 1
    assert abs(out.heading_deg[-1] - clean.heading_deg[-1]) < 2.0 * clean.std[-1, 6]


@pytest.mark.parametrize("dt_s", [0.1, 1.0])
def test_a_bias_walks_by_the_time_and_not_by_the_rows(dt_s: float) -> None:
    noise = replace(NOISE, bias_walk_dps_per_rt_s=0.01)
    navigator = Navigator(RobotParameters(WIDTH, PRIOR, noise, static_s=0.0), filtering=False)
    t_s = dt_s * np.arange(round(20.0 / dt_s) + 1)
    variances = []
    for part in np.split(t_s, [t_s.size // 2 + 1]):
        steps = np.full(part.size, 0.1 * dt_s)
        navigator.run(part, steps, steps, np.zeros(part.size))
        variances.append(float(navigator.covariance[8, 8]))
    assert variances[1] - variances[0] == pytest.approx(10.0 * 0.01**2, rel=1e-6)
