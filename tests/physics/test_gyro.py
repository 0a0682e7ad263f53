"""The gyro model has the sizes of the paper's Table I, and its noise the Allan deviation it promises."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from gyrocal.physics.gyro import GyroModel, GyroStream, rd2100_unit
from gyrocal.physics.surface import Surface
from tests.inference.allan_reference import overlapping_avar

#: Quantiles of a two-sided test that errs once in 10,000.
FALSE_ALARM = (0.5e-4, 1 - 0.5e-4)

QUIET = Surface(np.zeros((4, 3)), 0.0, 100.0, 20.0, 30.0)


def _quiet(**changes: Any) -> GyroModel:
    base = replace(
        rd2100_unit(0), surface=QUIET, angle_random_walk_deg_per_rt_h=0.0, bias_instability_deg_per_h=0.0
    )
    return replace(base, lsb_deg=0.0, temp_noise_c=0.0, temp_lsb_c=0.0, **changes)


@pytest.mark.parametrize("seed", range(5))
def test_unit_has_the_sizes_of_table_one(seed: int) -> None:
    surface = rd2100_unit(seed).surface
    temp_c = np.linspace(-10.0, 50.0, 241)
    gyro_dps = np.linspace(-100.0, 100.0, 401)
    bias = surface.error_dps(0.0, temp_c)
    assert np.ptp(bias) == pytest.approx(0.2, rel=1e-3)
    slope = surface.coefficients_dps[1]
    v = (temp_c - 20.0) / 30.0
    assert np.ptp(slope[1] * v + slope[2] * v**2) / 100.0 == pytest.approx(0.02, rel=1e-3)
    error = surface.error_dps(gyro_dps, 20.0)
    bent = error - np.polyval(np.polyfit(gyro_dps, error, 1), gyro_dps)
    assert np.sqrt(np.mean(bent**2)) == pytest.approx(0.5, rel=1e-3)


def test_units_differ_and_repeat() -> None:
    a, b, c = (rd2100_unit(seed).surface.coefficients_dps for seed in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.allclose(a, c)


def test_noiseless_output_solves_the_surface() -> None:
    model = replace(_quiet(bandwidth_hz=np.inf), surface=rd2100_unit(3).surface)
    rate = np.linspace(-100.0, 100.0, 50)
    gyro = GyroStream(model, np.random.default_rng(0)).samples(0.1, rate, 35.0)
    assert gyro - model.surface.error_dps(gyro, 35.0) == pytest.approx(rate, abs=1e-9)


def test_white_noise_is_the_stated_angle_random_walk() -> None:
    model = _quiet(angle_random_walk_deg_per_rt_h=5.0 / 60.0)
    n = 20_000
    gyro = GyroStream(model, np.random.default_rng(1)).samples(0.1, np.zeros(n), 20.0)
    # sum of squares over sigma^2 is chi-square with n degrees of freedom; false-alarm rate 1e-4
    statistic = np.sum(gyro**2) / (5.0 / 3600.0 / np.sqrt(0.1)) ** 2
    low, high = (stats.chi2.ppf(q, n) for q in FALSE_ALARM)
    assert low < statistic < high


def test_flicker_floor_is_0_664_of_the_bias_instability() -> None:
    model = _quiet(bias_instability_deg_per_h=1.8)
    taus = np.array([30.0, 100.0, 300.0, 1000.0])
    squares = []
    for seed in range(24):
        gyro = GyroStream(model, np.random.default_rng(seed)).samples(1.0, np.zeros(20_000), 20.0)
        squares.append([overlapping_avar(gyro * 3600.0, int(tau)) for tau in taus])
    floor = np.sqrt(np.mean(squares, axis=0)) / 1.8
    spread = np.std(squares, axis=0, ddof=1) / np.sqrt(24) / np.mean(squares, axis=0) / 2
    # Student t over 24 records and 4 averaging times: 1e-4 false alarms; 2 % is the ripple of the sum
    margin = stats.t.ppf(1 - 1e-4 / 8, 23) * spread * floor + 0.02 * 0.664
    assert np.all(np.abs(floor - 0.664) < margin)
    assert np.all(margin < 0.2)


def test_blocks_continue_each_other() -> None:
    model = replace(_quiet(), lsb_deg=0.000305)
    rate = np.linspace(0.0, 3.0, 1000)
    whole = GyroStream(model, np.random.default_rng(5)).samples(0.1, rate, 20.0)
    stream = GyroStream(model, np.random.default_rng(5))
    parts = [stream.samples(0.1, part, 20.0) for part in np.split(rate, [7, 64, 65, 700])]
    assert np.concatenate(parts) == pytest.approx(whole, abs=0.000305 / 0.1 * 1.001)
    assert np.sum(np.concatenate(parts)) == pytest.approx(np.sum(whole), abs=0.004)


def test_flicker_remembers_across_blocks() -> None:
    model = _quiet(bias_instability_deg_per_h=1000.0)
    stream = GyroStream(model, np.random.default_rng(2))
    gyro = np.concatenate([stream.samples(0.1, np.zeros(10), 20.0) for _ in range(2000)])
    within = np.diff(gyro)[np.arange(gyro.size - 1) % 10 != 9]
    across = np.diff(gyro)[np.arange(gyro.size - 1) % 10 == 9]
    # equal variances: F test, false-alarm rate 1e-4
    low, high = (stats.f.ppf(q, across.size, within.size) for q in FALSE_ALARM)
    assert low < np.var(across) / np.var(within) < high


def test_quantisation_is_a_lattice_and_loses_no_angle() -> None:
    model = replace(_quiet(bandwidth_hz=np.inf), lsb_deg=0.000305)
    gyro = GyroStream(model, np.random.default_rng(0)).samples(0.1, np.full(10_000, 0.0007), 20.0)
    bits = gyro * 0.1 / 0.000305
    assert bits == pytest.approx(np.round(bits), abs=1e-9)
    assert abs(np.sum(gyro) * 0.1 - 0.0007 * 1000.0) <= 0.000305 / 2 * 1.001


@pytest.mark.parametrize("bandwidth_hz", [100.0, 0.5])
def test_bandwidth_delays_a_ramp_by_its_time_constant(bandwidth_hz: float) -> None:
    model = _quiet(bandwidth_hz=bandwidth_hz)
    rate = 0.1 * np.arange(400.0)  # 1 deg/s^2 in steps of 0.1 s
    gyro = GyroStream(model, np.random.default_rng(0)).samples(0.1, rate, 20.0)
    tau_s = 1.0 / (2.0 * np.pi * bandwidth_hz)
    # a staircase held over each interval lags its own filter by tau, give or take the half step of the hold
    assert rate[-1] - gyro[-1] == pytest.approx(tau_s, abs=0.051 if bandwidth_hz < 1 else 1e-4)


def test_temperature_sensor_rounds_and_scatters() -> None:
    model = replace(_quiet(), temp_noise_c=0.02, temp_lsb_c=0.01)
    temp = GyroStream(model, np.random.default_rng(0)).temperatures(np.full(5000, 20.0))
    assert temp / 0.01 == pytest.approx(np.round(temp / 0.01), abs=1e-9)
    low, high = (stats.chi2.ppf(q, 4999) for q in FALSE_ALARM)
    assert low < 4999 * np.var(temp, ddof=1) / (0.02**2 + 0.01**2 / 12) < high
