"""What rounding does to means, against rounded samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.inference.rounding import (
    StepCounts,
    harmonic,
    lattice,
    lattice_of_means,
    least_noise,
    mean_error,
    mean_error_std,
    slope_error,
)

Floats = NDArray[np.float64]


@pytest.mark.parametrize("noise_steps", [0.05, 0.15, 0.3, 0.4, 0.5])
def test_the_mean_is_off_by_as_much_at_most(noise_steps: float) -> None:
    rng = np.random.default_rng(1)
    truth = np.linspace(-0.5, 0.5, 81)
    means = np.array([np.round(rng.normal(m, noise_steps, 200_000)).mean() for m in truth])
    scatter = np.hypot(noise_steps, 12**-0.5)
    assert np.max(np.abs(means - truth)) == pytest.approx(mean_error(1.0, scatter), rel=0.1, abs=0.003)
    rms = np.sqrt(np.mean((means - truth)[1:] ** 2))
    assert rms == pytest.approx(mean_error_std(1.0, scatter), rel=0.1, abs=0.003)
    assert abs(harmonic(1.0, scatter)) == pytest.approx(
        2.0 * abs(np.mean((means - truth)[1:] * np.sin(2.0 * np.pi * truth[1:]))), rel=0.1, abs=0.003
    )


@pytest.mark.parametrize("noise_steps", [0.3, 0.4, 0.5])
def test_what_is_slow_comes_out_too_large_or_too_small(noise_steps: float) -> None:
    rng = np.random.default_rng(1)
    low, high = (np.round(rng.normal(m, noise_steps, 400_000)).mean() for m in (-0.05, 0.05))
    scatter = np.hypot(noise_steps, 12**-0.5)
    assert abs((high - low) / 0.1 - 1.0) == pytest.approx(slope_error(1.0, scatter), rel=0.1, abs=0.04)


def test_it_goes_with_the_step() -> None:
    assert mean_error(0.02, 0.01) == pytest.approx(0.02 * mean_error(1.0, 0.5))
    assert slope_error(0.02, 0.01) == pytest.approx(slope_error(1.0, 0.5))


@pytest.mark.parametrize("noise_steps", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("place", [0.0, 0.25, 0.5])
def test_the_noise_below_steps_is_told_by_how_often_each_comes(noise_steps: float, place: float) -> None:
    rng = np.random.default_rng(2)
    below = 0
    for _ in range(60):
        rounded = np.round(rng.normal(place, noise_steps, 2000))
        least = least_noise([np.unique(rounded, return_counts=True)], 1.0)
        below += least <= noise_steps
    # 60 at 95 %: 51 is undershot once in a thousand.
    assert below >= 51


@pytest.mark.parametrize("rows", [3, 10, 50])
def test_a_few_rows_that_are_not_rounded_have_no_steps(rows: int) -> None:
    """Before: each value came once, of which the least noise was none, and the output "comes in steps"."""
    counts = StepCounts()
    counts.add(1, np.random.default_rng(3).normal(0.0, 0.004, rows), 0.1)
    assert not counts.few
    counts = StepCounts()
    counts.add(1, np.round(np.random.default_rng(3).normal(0.0, 0.4, rows)), 0.1)
    assert counts.few == (rows > 3)


def test_a_toggling_output_says_nothing_of_its_noise() -> None:
    """Its scatter is half a step, which had been taken for noise enough."""
    rng = np.random.default_rng(2)
    toggling = np.round(rng.normal(0.5, 0.1, 2000))
    toggling[7] = 5.0
    assert np.std(toggling) > 0.45
    assert least_noise([np.unique(toggling, return_counts=True)], 1.0) == 0.0


@pytest.mark.parametrize("noise_steps", [1.4, 3.0, 8.0])
def test_noise_over_many_steps_is_told_as_much(noise_steps: float) -> None:
    """Of steps far above the mean the share was nothing to all digits, and the noise had come out as the least."""
    rounded = np.round(np.random.default_rng(4).normal(0.3, noise_steps, 200_000))
    assert min(noise_steps, 2.0) > least_noise([np.unique(rounded, return_counts=True)], 1.0) > 1.2


def test_means_among_samples_and_places_of_other_means_are_no_finer_steps() -> None:
    rng = np.random.default_rng(5)
    counted = StepCounts()
    for segment, mean in enumerate((0.0, 20.3, -11.8)):
        counted.add(segment, np.round(rng.normal(mean, 0.05, (200, 10)).mean(axis=1), 3), 1.0)
        counted.add(segment, np.round(rng.normal(mean, 1.4, 20_000)), 0.1)
    assert counted.step == 1.0
    assert 1.4 > counted.least_noise() > 1.2


def test_steps_that_the_file_rounds_are_found_over_many_rates() -> None:
    """A step of 0.7823 mdeg/s in six decimals is 0.000782 or 0.000783 each, and 0.0006 off after two of them."""
    rng = np.random.default_rng(3)
    rates = np.repeat([-150.0, -30.0, 0.1, 30.0, 150.0], 200)
    step = 0.0007823
    values = np.round(np.round(rng.normal(rates, 0.01) / step) * step, 6)
    assert lattice(values) == pytest.approx(step, rel=1e-5)
    assert lattice(np.round(rng.normal(rates, 0.01), 6)) is None


def soaks(resolution_c: float, places_c: list[float], seed: int) -> Floats:
    """Means of sixty readings each, of a temperature that settles at some places in turn."""
    rng = np.random.default_rng(seed)
    settling = np.exp(-np.arange(12 * 60) / 400.0)
    course = np.concatenate([c - 0.3 * settling for c in places_c])
    readings = resolution_c * np.round((course + 0.002 * rng.standard_normal(course.size)) / resolution_c)
    return np.asarray(np.round(readings.reshape(-1, 60).mean(axis=1), 3))


@pytest.mark.parametrize("resolution_c", [0.25, 0.5, 1.0])
def test_few_places_tell_the_steps_of_a_thermometer(resolution_c: float) -> None:
    """Their distances, of ten degrees and more, have no step in common that says anything."""
    for seed in range(5):
        read_c = soaks(resolution_c, [3.6, 14.1, 26.3, 48.1, 26.4, 14.2], seed)
        assert lattice_of_means(read_c) == pytest.approx(resolution_c)


def test_two_steps_in_a_row_tell_it_too() -> None:
    assert lattice_of_means(soaks(1.0, [28.8, 29.1, 30.2], 1)) == pytest.approx(1.0)
    # Of two fine readings the common divisor says nothing.
    assert lattice_of_means(np.repeat([28.5, 31.0], 30)) is None


def test_places_of_a_fine_thermometer_tell_no_coarse_one() -> None:
    for seed in range(20):
        places = np.random.default_rng([9, seed]).uniform(-20.0, 60.0, 6)
        step_c = lattice_of_means(soaks(0.01, places.tolist(), seed))
        assert step_c is None or step_c <= 0.01 + 1e-9
    # Set points are multiples of more than any thermometer's step.
    assert lattice_of_means(np.repeat([-20.0, 0.0, 25.0, 60.0], 20)) == pytest.approx(5.0)


def test_few_values_that_come_again_and_again_are_steps() -> None:
    """As of a thermometer of whole degrees in a room that hardly warms."""
    rng = np.random.default_rng(6)
    course = 25.0 + 1.4 * np.sin(np.linspace(0.0, 9.0, 4000))
    assert lattice(np.round(course + 0.03 * rng.standard_normal(course.size))) == pytest.approx(1.0)
    assert lattice(np.repeat([24.0, 25.0], 60)) == pytest.approx(1.0)
    # Of a few values that come a few times nothing is said.
    assert lattice(np.repeat([24.0, 25.0], 30)) is None


def test_means_with_a_single_reading_on_the_next_degree_hide_no_step() -> None:
    """Two such means in a row stand as those of one degree do, and had made steps of a hundredth."""
    read_c = np.repeat([29.0, 29.01, 30.0, 27.0, 26.0, 28.0, 29.37, 29.46], [20, 2, 9, 9, 8, 8, 2, 2])
    between_c = [29.06, 29.15, 28.83, 27.12, 26.48, 25.87, 26.91, 28.2, 29.64]
    assert lattice_of_means(np.append(read_c, between_c)) == pytest.approx(1.0)
