"""The file of a gyro with a dead zone, on a second run at rates that the first has not visited."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.coefficients import Coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

NOISE_DPS = 3e-4
SIZES_DPS = (0.01, 0.02, 0.05, 0.2, 1.0, 4.0, 12.0, 30.0, 60.0, 100.0)
#: Between those, and beyond either zone.
UNVISITED_DPS = (0.095, 0.13, 0.35, 0.6, 2.2, 7.0, 20.0, 45.0, 80.0)


def band(rate_dps: Floats) -> Floats:
    """Nothing below 0.03 deg/s, and 0.03 less beyond."""
    return np.asarray(np.sign(rate_dps) * np.maximum(np.abs(rate_dps) - 0.03, 0.0))


def lock_in(rate_dps: Floats) -> Floats:
    """Nothing below 0.06 deg/s, and a hyperbola beyond."""
    return np.asarray(np.sign(rate_dps) * np.sqrt(np.maximum(rate_dps**2 - 0.06**2, 0.0)))


GYROS = {"band": (band, 0.03), "lock-in": (lock_in, 0.06)}


def output(through: Callable[[Floats], Floats], rate_dps: Floats, temp_c: Floats) -> Floats:
    """What comes through the zone, with a scale error, a cubic and a bias that follow the temperature."""
    v = (temp_c - 20.0) / 30.0
    scale = 1e-3 * (1.0 + 0.3 * v)
    return np.asarray(through(rate_dps) + scale * rate_dps + 0.02 * (rate_dps / 100.0) ** 3 + 0.01 + 4e-3 * v)


@pytest.fixture(
    scope="module",
    # A band has its like in `test_rising`.
    params=[pytest.param(gyro, id=name, marks=pytest.mark.slow) for name, gyro in GYROS.items()],
)
def diagnosed(request: pytest.FixtureRequest) -> tuple[Callable[[Floats], Floats], float, Coefficients]:
    """What comes through the gyro's zone, the zone's half width, and the file."""
    through, width_dps = request.param
    rng = np.random.default_rng(11)
    rates = np.array([0.0, *(side * size for size in SIZES_DPS for side in (-1.0, 1.0))])
    temps = np.array([20.0, 40.0, 50.0, 30.0, 10.0, -10.0, 0.0])
    rate = np.concatenate([rng.permutation(rates) for _ in temps])
    temp = np.repeat(temps, rates.size) + 0.1 * rng.standard_normal(rate.size)
    gyro = output(through, rate, temp) + NOISE_DPS * rng.standard_normal(rate.size)
    t_s = 60.0 * np.arange(rate.size, dtype=np.float64)
    found = diagnose(
        series_of_table(DataSetTable(Path("zone.csv"), rate, gyro, temp, t_s=t_s)),
        None,
        Options(heldout=False),
    )
    assert "dead_zone" in [e.effect for e in found.effects]
    assert not {a.effect for e in found.effects for a in e.alternatives} & found.not_testable.keys()
    assert found.improved is not None
    return through, width_dps, found.improved


def off_and_sigma(
    diagnosed: tuple[Callable[[Floats], Floats], float, Coefficients],
    sizes_dps: Floats,
    noise_dps: float = 0.0,
) -> tuple[Floats, Floats]:
    """Errors of the corrected rate, deg/s, and its standard deviation by the file, at either sign of the rates."""
    through, _, file = diagnosed
    rate = np.concatenate([sizes_dps, -sizes_dps])
    temp = np.linspace(-5.0, 45.0, rate.size)
    noise = noise_dps * np.random.default_rng(3).standard_normal(rate.size)
    gyro = output(through, rate, temp) + noise
    got = Compensator(file).evaluate(np.arange(rate.size) * 1.0, gyro, temp)
    return got.rate_dps - rate, got.sigma_dps


def test_the_file_has_the_law_with_its_width(
    diagnosed: tuple[Callable[[Floats], Floats], float, Coefficients],
) -> None:
    _, width_dps, file = diagnosed
    (zone,) = [t for t in file.terms if t.name == "dead_zone"]
    width = zone.to_json()["parameters"]["width_dps"]
    assert 0.0 < width["std"] < 0.02 * width_dps
    assert abs(width["value"] - width_dps) < 4.0 * width["std"]


def test_beyond_the_zone_rates_that_nobody_visited_are_as_right_as_the_others(
    diagnosed: tuple[Callable[[Floats], Floats], float, Coefficients],
) -> None:
    visited = np.array([s for s in SIZES_DPS if s > 1.5 * diagnosed[1]])
    off_there, sigma_there = off_and_sigma(diagnosed, visited)
    off, sigma = off_and_sigma(diagnosed, np.array(UNVISITED_DPS))
    assert np.sqrt(np.mean(off**2)) < 1.5 * np.sqrt(np.mean(off_there**2)) + 0.2 * NOISE_DPS
    assert np.max(np.abs(off) / sigma) < 4.0
    assert np.max(sigma) < 2.0 * np.max(sigma_there)


def test_within_the_zone_sigma_is_that_of_a_rate_that_may_be_anywhere_in_it(
    diagnosed: tuple[Callable[[Floats], Floats], float, Coefficients],
) -> None:
    through, width_dps, _ = diagnosed
    off, sigma = off_and_sigma(diagnosed, width_dps * np.linspace(0.005, 0.995, 100))
    assert 0.9 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.1
    beyond = width_dps * np.linspace(1.0, 2.0, 50)
    edge, edge_sigma = off_and_sigma(diagnosed, beyond[through(beyond) < 0.45 * width_dps])
    assert np.max(np.abs(edge) / edge_sigma) < 1.8, "just beyond the zone the file is no surer"


@pytest.mark.parametrize("noise_dps", [1e-3, 1e-2, 0.1])
def test_a_gyro_that_stands_is_not_thrown_about(
    diagnosed: tuple[Callable[[Floats], Floats], float, Coefficients], noise_dps: float
) -> None:
    off, _ = off_and_sigma(diagnosed, np.zeros(4000), noise_dps)
    assert np.std(off) < 2.1 * noise_dps
    assert abs(np.mean(off)) < 4.0 * 2.1 * noise_dps / np.sqrt(off.size) + NOISE_DPS
