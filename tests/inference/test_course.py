"""The course of a temperature through its thermometer: against dense formulas, and how near it comes to the truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import approx_fprime

from gyrocal.inference.course import _Field, _Readings, _room, smooth_course

Floats = NDArray[np.float64]


def heated_box(t_s: Floats) -> Floats:
    """Temperatures that settle at one stop after the other, through two lags."""
    stops = np.array([30.0, 46.0, 37.0, 52.0])
    grid = np.arange(0.0, float(t_s[-1]) + 2.0)
    temp = stops[np.minimum((4.0 * grid / grid[-1]).astype(int), 3)]
    for tau in (300.0, 150.0):
        lagged = np.empty_like(temp)
        lagged[0] = temp[0]
        for k in range(1, temp.size):
            lagged[k] = lagged[k - 1] + (temp[k] - lagged[k - 1]) / tau
        temp = lagged
    return np.asarray(np.interp(t_s, grid, temp))


def test_without_steps_it_is_the_regression_on_an_integrated_walk() -> None:
    """Mean and covariance in closed form, from the dense covariance of the process and its flat straight line."""
    t = np.array([0.0, 1.0, 2.5, 4.0, 5.5, 6.0, 8.0, 9.0])
    y = np.array([1.0, 1.5, 0.5, 2.0, 2.5, 2.0, 4.0, 3.5])
    walk, noise = 0.3, 0.4
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)
    kernel = walk * low**2 * (3.0 * high - low) / 6.0
    v = kernel + noise**2 * np.eye(t.size)
    line = np.column_stack([np.ones_like(t), t])
    b = np.linalg.solve(line.T @ np.linalg.solve(v, line), line.T @ np.linalg.solve(v, y))
    expected = line @ b + kernel @ np.linalg.solve(v, y - line @ b)
    readings = _Readings(np.arange(t.size), y, np.ones(t.size), 0.0)
    found = _Field(
        readings, np.diff(t), np.zeros(t.size - 1, dtype=bool), np.zeros(2 * t.size), np.ones(t.size)
    )
    np.testing.assert_allclose(found.settle(walk, noise)[1][::2], expected, atol=1e-4)


def test_the_evidence_is_that_of_the_contrasts() -> None:
    """Up to a constant of the record it is the restricted likelihood of a straight line in the dense covariance."""
    rng = np.random.default_rng(3)
    t = np.arange(12.0)
    y = rng.standard_normal(12)
    line = np.column_stack([np.ones_like(t), t])
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)

    def dense(walk: float, noise: float) -> float:
        v = walk * low**2 * (3.0 * high - low) / 6.0 + noise**2 * np.eye(t.size)
        vx = np.linalg.solve(v, line)
        p = np.linalg.inv(v) - vx @ np.linalg.solve(line.T @ vx, vx.T)
        return float(-0.5 * (np.linalg.slogdet(v)[1] + np.linalg.slogdet(line.T @ vx)[1] + y @ p @ y))

    readings = _Readings(np.arange(t.size), y, np.ones(t.size), 0.0)
    found = _Field(
        readings, np.diff(t), np.zeros(t.size - 1, dtype=bool), np.zeros(2 * t.size), np.ones(t.size)
    )
    levels = [(0.01, 1.0), (1.0, 0.5), (0.1, 0.2)]
    difference = [found.settle(*x)[0] - dense(*x) for x in levels]
    assert np.ptp(difference) < 0.01


@pytest.mark.parametrize("noise", [0.05, 0.4, 3.0])
def test_the_slope_of_a_rounded_reading_is_that_of_its_probability(noise: float) -> None:
    readings = _Readings(
        np.array([0, 1, 1, 2]), np.array([0.0, 1.0, 2.0, 5.0]), np.array([1.0, 2.0, 1.0, 3.0]), 1.0
    )
    x = np.array([0.3, 1.45, 4.2])
    _, slope, curvature = readings.terms(x, noise)

    def value(at: Floats) -> float:
        return readings.terms(at, noise)[0]

    expected: Floats = np.asarray(approx_fprime(x, value, 1e-7), dtype=np.float64)
    np.testing.assert_allclose(slope, expected, rtol=1e-4)
    # Each node's slope depends on its own value only.
    further = [readings.terms(x + h, noise)[1] for h in (1e-5, -1e-5)]
    np.testing.assert_allclose(curvature, (further[1] - further[0]) / 2e-5, rtol=1e-4)


@pytest.mark.parametrize(("step", "noise"), [(0.0, 0.3), (0.5, 0.05), (1.0, 0.05), (1.0, 0.3)])
def test_a_poor_thermometer_is_seen_through(step: float, noise: float) -> None:
    """A third of what the readings are off is left, and it is no larger than stated: of fine noise in coarse steps less."""
    t = np.arange(12.0, 3400.0, 20.0)
    truth = heated_box(t)
    raw, left, stated = [], [], []
    for seed in range(4):
        read = truth + noise * np.random.default_rng(seed).standard_normal(t.size)
        read = step * np.round(read / step) if step else read
        course = smooth_course(t, read, np.ones(t.size), step)
        raw.append(np.mean((read - truth) ** 2))
        left.append(np.mean((course.at(t)[0] - truth) ** 2))
        stated.append(np.mean(np.diag(course.covariance(t))))
    assert np.mean(left) < 0.35 * np.mean(raw)
    assert 0.12 < np.mean(left) / np.mean(stated) < 1.5


@pytest.mark.slow
def test_whole_degrees_of_a_quiet_thermometer_are_seen_through_in_a_warming_room() -> None:
    """When it goes to the next degree is told to a hundredth of it: with more noise granted the course was a staircase."""
    t = np.arange(0.0, 6000.0, 0.5)
    truth = 29.0 + 4.6 * np.sin(2.0 * np.pi * t / 9000.0) + 0.4 * np.sin(2.0 * np.pi * t / 2100.0)
    read = np.round(truth + 0.005 * np.random.default_rng(4).standard_normal(t.size))
    course = smooth_course(t, read, np.ones(t.size), 1.0, all_along=True)
    rows = np.arange(15.0, 6000.0, 30.0)
    off = course.at(rows)[0] - np.interp(rows, t, truth)
    assert np.std(off) < 0.1
    covariance = course.covariance(rows) + 1e-6 * np.eye(rows.size)
    assert off @ np.linalg.solve(covariance, off) < 1.3 * rows.size


def test_where_a_chamber_stands_still_only_the_step_is_known() -> None:
    """A smooth curve from ramp to ramp overshoots between them, by more than it said before: 0.5 degC with 0.2 stated."""
    ends = 20.0 + np.array([0.0, 9.86, 3.4, -4.3, 6.6, -8.1, 2.3, 10.4])
    t = np.arange(0.0, 1200.0 * (ends.size - 1), 5.0)
    ramps = np.linspace(0.0, 1200.0 * (ends.size - 2), ends.size - 1)
    corners = np.column_stack([ramps, ramps + 60.0 * np.abs(np.diff(ends))]).ravel()
    truth = np.interp(t, corners, np.column_stack([ends[:-1], ends[1:]]).ravel())
    read = np.round(truth + 0.01 * np.random.default_rng(3).standard_normal(t.size))
    course = smooth_course(t, read, np.ones(t.size), 1.0, all_along=True)
    halts = np.asarray(ramps + 1000.0, dtype=np.float64)
    error = course.at(halts)[0] - np.interp(halts, t, truth)
    covariance = course.covariance(halts)
    assert np.sqrt(np.mean(error**2 / np.diag(covariance))) < 1.3
    between = covariance - np.diag(np.diag(covariance))
    assert np.abs(between).max() < 1e-3
    same = course.covariance(halts[:1] + np.array([0.0, 40.0]))
    assert same[0, 1] > 0.9 * same[0, 0]


def test_the_noise_of_a_fine_thermometer_is_found() -> None:
    t = np.arange(12.0, 3400.0, 20.0)
    read = heated_box(t) + 0.2 * np.random.default_rng(5).standard_normal(t.size)
    assert smooth_course(t, read, np.ones(t.size), 0.0).noise == pytest.approx(0.2, rel=0.2)


def test_over_a_pause_the_course_is_straight() -> None:
    t = np.concatenate([np.arange(0.0, 400.0, 5.0), np.arange(8000.0, 8400.0, 5.0)])
    read = 20.0 + 0.05 * t
    course = smooth_course(t, read, np.ones(t.size), 0.0)
    times = np.array([395.0, 3000.0, 8000.0])
    value, slope = course.at(times)
    np.testing.assert_allclose(value, 20.0 + 0.05 * times, atol=1e-3)
    np.testing.assert_allclose(slope, 0.05, atol=1e-4)


def test_a_mean_between_two_steps_is_made_of_readings_of_both() -> None:
    """Where a data set crosses a step, its mean says when."""
    t = np.arange(0.0, 600.0, 10.0)
    truth = 20.0 + 0.013 * t
    fine = 20.0 + 0.013 * (t[:, None] + np.linspace(-4.9, 4.9, 50))
    read = np.round(fine).mean(axis=1)
    course = smooth_course(t, read, np.full(t.size, 50.0), 1.0)
    assert np.abs(course.at(t)[0] - truth).max() < 0.1


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_few_readings_have_a_course(count: int) -> None:
    t: Floats = 10.0 * np.arange(count, dtype=np.float64)
    read = 20.0 + 0.1 * t
    course = smooth_course(t, read, np.ones(count), 0.0)
    np.testing.assert_allclose(course.at(t)[0], read, atol=1e-3)
    assert course.covariance(t).shape == (count, count)


def test_where_within_its_step_a_turning_course_is_known_best_where_it_came_and_left() -> None:
    """It came up to the step, turned, and left it downwards, at a fifth of a step a second each way."""
    t_s, run = np.arange(11.0), np.array([0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2])
    mean, slope = (run == 1).astype(np.float64), np.where(t_s < 5.0, 0.2, -0.2)
    room = np.sqrt(12.0) * _room(t_s, slope, mean, run, 1.0)
    np.testing.assert_allclose(room[3:8], [0.2, 0.4, 0.6, 0.4, 0.2], rtol=1e-12)
