"""Noise figures by model: intervals that cover, a filter that is not taken for noise, a fit that is tested."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal, stats

from gyrocal.inference import allan_model
from gyrocal.inference.allan import AllanCurve, AllanSums, covariance_parts
from gyrocal.inference.allan_model import FLICKER, NoiseModel, fit_noise
from tests.calibration.simulation import flicker

Floats = NDArray[np.float64]

#: Chance that a correct test of coverage fails.
FALSE_ALARM = 1e-3


@dataclass(frozen=True)
class Sensor:
    """Noise of a sensor in deg/s and s; `order` 0: the samples are means of white noise."""

    white: float = 1.4e-3
    flicker: float = 0.0
    walk: float = 0.0
    low_pass_s: float = 0.0
    order: int = 0
    step_dps: float = 0.0

    @property
    def coefficients(self) -> Floats:
        """Of the model, from the second on, for samples of 0.1 s."""
        return np.array(
            [self.white**2 + 0.1 * self.step_dps**2 / 12.0, FLICKER * self.flicker**2, self.walk**2 / 3.0]
        )

    def record(self, rng: np.random.Generator, samples: int, dt_s: float = 0.1, finer: int = 4) -> Floats:
        """Output at rest."""
        step_s = dt_s / finer
        gyro = rng.normal(0.0, self.white / np.sqrt(step_s), samples * finer)
        if self.order:
            b, a = signal.butter(self.order, step_s / (np.pi * self.low_pass_s))
            gyro = np.asarray(signal.lfilter(b, a, gyro))[::finer]
        else:
            gyro = gyro.reshape(-1, finer).mean(axis=1)
        if self.flicker:
            gyro = gyro + flicker(rng, samples, 0.664 * self.flicker, dt_s)
        gyro = gyro + np.cumsum(rng.normal(0.0, self.walk * np.sqrt(dt_s), samples))
        return np.round(gyro / self.step_dps) * self.step_dps if self.step_dps else gyro


def curve_of(values: Floats, dt_s: float = 0.1) -> AllanCurve:
    sums = AllanSums(dt_s)
    sums.add(values)
    return sums.curve()


def model_of(values: Floats, dt_s: float = 0.1) -> NoiseModel:
    model = fit_noise([curve_of(values, dt_s)])
    if model is None:
        raise ValueError
    return model


FILTERED = Sensor(flicker=7e-4, low_pass_s=0.2, order=2, step_dps=1e-3)
SENSORS = {
    "white, 1/f": Sensor(flicker=1.5e-3),
    "low-pass of first order": Sensor(flicker=7e-4, low_pass_s=0.3, order=1),
    "low-pass of second order, rounded": FILTERED,
    "walk": Sensor(walk=5e-5),
    "low-pass, 1/f, walk": Sensor(flicker=7e-4, walk=3e-5, low_pass_s=0.2, order=1, step_dps=3e-3),
}


def coverage(sensor: Sensor, runs: int, seed: int) -> Floats:
    """Share of intervals with the truth, shape (3,): angle random walk, bias instability, rate random walk."""
    hits = np.zeros(3)
    for k in range(runs):
        model = model_of(sensor.record(np.random.default_rng([seed, k]), 36_000))
        hits += [
            part.low <= truth <= part.high
            for part, truth in zip(model.parts[1:], sensor.coefficients, strict=True)
        ]
    return hits / runs


@pytest.mark.slow
def test_intervals_cover() -> None:
    """Fifteen records: a correlation that is dropped, or an interval of half the length, is noticed."""
    runs = 15
    found = coverage(FILTERED, runs, 11)
    assert np.all(found * runs >= stats.binom.ppf(FALSE_ALARM, runs, 0.95))


def test_correlation_of_the_variances_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the same records give intervals that are too short, and too few cover."""

    def diagonal(curve: AllanCurve) -> Floats:
        return np.asarray(covariance_parts(curve) * np.eye(curve.factor.size)[:, :, None, None])

    values = SENSORS["white, 1/f"].record(np.random.default_rng(12), 36_000)
    right = model_of(values)
    monkeypatch.setattr(allan_model, "covariance_parts", diagonal)
    wrong = model_of(values)
    for k in (1, 2):
        assert wrong.parts[k].high - wrong.parts[k].low < 0.9 * (right.parts[k].high - right.parts[k].low)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", SENSORS)
def test_coverage(name: str) -> None:
    """92 to 98 % for angle random walk and bias instability; at least 92 % for a walk that may be nothing."""
    runs = 300
    found = coverage(SENSORS[name], runs, 13)
    slack = stats.norm.ppf(1.0 - FALSE_ALARM / 2.0) * np.sqrt(0.95 * 0.05 / runs)
    assert np.all(found > 0.92 - slack)
    assert np.all(found[:2][SENSORS[name].coefficients[:2] > 0] < 0.98 + slack)


def test_a_low_pass_is_no_noise() -> None:
    """At averaging times near the filter's memory the Allan deviation is too small by up to a half."""
    sensor = Sensor(low_pass_s=0.5, order=1)
    model = model_of(sensor.record(np.random.default_rng(14), 100_000))
    white = model.parts[1]
    assert white.low < sensor.white**2 < white.high
    assert white.high / white.low < 1.5
    assert model.coefficients[0] < 0
    assert model.memory_s == pytest.approx(0.5, rel=0.2)
    assert model.parts[2].low == 0.0
    assert not model.used[0]
    assert model.misfit[-5:] == pytest.approx(np.zeros(5), abs=4.0)


def test_a_low_pass_that_is_fast_against_its_points_is_left_out() -> None:
    """Points of a filter of 0.04 s at each 0.1 s: at the first averaging time it is not yet over."""
    last = np.exp(-0.1 / 0.04)
    for k in range(3):
        noise = np.random.default_rng([18, k]).normal(0.0, 4.4e-3, 36_100)
        model = model_of(np.asarray(signal.lfilter([1.0 - last], [1.0, -last], noise))[100:])
        assert not model.used[0]
        assert model.parts[1].low < 0.1 * 4.4e-3**2 < model.parts[1].high


@pytest.mark.slow
def test_a_filter_that_rings_does_not_bend_the_angle_random_walk() -> None:
    """A resonance of Q 1.5 at 2 Hz: its ringing goes on behind the averaging times that it visibly bends."""
    omega, step_s = 2.0 * np.pi * 2.0, 0.0125
    b, a = signal.bilinear([omega**2], [1.0, omega / 1.5, omega**2], 1.0 / step_s)
    hits = 0
    for k in range(8):
        noise = np.random.default_rng([19, k]).normal(0.0, 1.4e-3 / np.sqrt(step_s), 36_600 * 8)
        white = model_of(np.asarray(signal.lfilter(b, a, noise))[::8][600:]).parts[1]
        hits += white.low < 1.4e-3**2 < white.high
    assert hits >= 7


#: Overlapping Allan deviations of the three gyros of an ADIS16448, deg/h, at these multiples of 0.005 s: a real sensor,
#: as github.com/gaowenliang/imu_utils publishes it (data/data_16448_gyr_*.txt; about 1.6 h).
FACTORS = (
    1,
    2,
    4,
    8,
    17,
    32,
    62,
    121,
    267,
    520,
    1010,
    1964,
    4363,
    8484,
    16500,
    32087,
    62402,
    138624,
    269590,
    524288,
)
PUBLISHED = {
    "x": "365.42 311.0 235.77 171.74 119.81 88.223 63.906 46.508 32.666 25.406 21.449 18.493 17.648 18.009 19.99 20.742 "
    "22.788 28.311 27.323 26.602",
    "y": "368.74 312.43 237.76 173.63 120.55 88.662 63.935 46.309 31.881 23.501 18.633 15.966 15.705 17.66 20.198 24.165 "
    "31.143 41.29 43.217 57.232",
    "z": "377.38 337.77 241.66 175.72 120.8 88.735 64.098 46.521 32.232 24.504 19.316 16.718 16.447 17.151 18.18 18.862 "
    "25.447 50.623 72.501 62.777",
}


@pytest.mark.parametrize("axis", PUBLISHED)
def test_the_published_curve_of_a_real_gyro(axis: str) -> None:
    """It bends at 0.01 s by the sensor's filter, and rises behind a minute: the angle random walk is the slope between."""
    adev = np.array(PUBLISHED[axis].split(), dtype=float) / 3600.0
    curve = AllanCurve(0.005, np.array(FACTORS), adev**2, np.array([1_150_000]), np.array([1]))
    model = fit_noise([curve])
    assert model is not None
    assert model.fits
    assert not model.used[:2].any()
    assert model.used[-1]
    second = curve.tau_s.searchsorted(1.0)
    np.testing.assert_allclose(
        np.sqrt(model.avar(curve.tau_s[5 : second + 2])), adev[5 : second + 2], rtol=0.02
    )
    walk, flat = model.parts[1], model.parts[2]
    # What the curve says at 0.085 s, where there is little else.
    assert np.sqrt(walk.value) == pytest.approx(adev[4] * np.sqrt(curve.tau_s[4]), rel=0.05)
    assert walk.high / walk.low < 1.06
    assert 0.0 < flat.low < flat.value < adev.min() ** 2


def test_noise_of_slope_minus_one_has_no_angle_random_walk() -> None:
    """A ring laser: the angle is rounded, and its increments are what is logged."""
    rng = np.random.default_rng(15)
    angle = np.round(rng.normal(0.0, 3e-5, 100_000) / 1e-4 + 0.3 * np.arange(100_000)) * 1e-4
    model = model_of(np.diff(angle + rng.normal(0.0, 1e-4, 100_000)) / 0.01, 0.01)
    quantised, white = model.parts[0], model.parts[1]
    assert quantised.low > 0.0
    assert white.low == 0.0
    longest = curve_of(np.diff(angle) / 0.01, 0.01)
    # What the curve itself allows at its longest averaging time.
    assert white.high < 30.0 * longest.avar[-1] * longest.tau_s[-1]


@pytest.mark.slow
def test_a_curve_that_is_no_noise_fits_no_stretch_of_it_all() -> None:
    rng = np.random.default_rng(16)
    t_s = 0.1 * np.arange(72_000)
    model = model_of(rng.normal(0.0, 4.4e-3, t_s.size) + 0.02 * np.sin(2.0 * np.pi * t_s / 60.0))
    assert not np.all(model.used)
    assert np.max(np.abs(model.misfit)) > 10.0


def test_a_short_record_has_no_model() -> None:
    assert fit_noise([curve_of(np.random.default_rng(17).normal(size=40))]) is None
    assert fit_noise([]) is None


@pytest.mark.parametrize("seed", [0, 5, 10])
def test_a_stretch_that_leaves_out_the_floor_as_noise_is_no_model(seed: int) -> None:
    """White noise on an output that follows a chamber: its long side had been a walk, and the white noise "bandwidth"."""
    rng = np.random.default_rng(seed)
    fade = np.exp(-0.5 / 60.0)
    course = signal.lfilter([1.0], [1.0, -2.0 * fade, fade**2], rng.standard_normal(8400))
    found = fit_noise([curve_of(0.007 * rng.standard_normal(8400) + 0.03 * course / np.std(course), 0.5)])
    assert found is not None
    assert not found.fits
