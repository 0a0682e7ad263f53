"""A dead zone cannot be undone: the file follows what lies beyond it and makes no noise of what is within."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.rising import rising
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.model.layers import Law, fit_model, full_model, surface_of
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.rate import DEAD_ZONE
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

#: Half width of the zone, deg/s.
_WIDTH = 0.02


def banded(rate_dps: Floats, temp_c: Floats) -> Floats:
    """Output of a gyro with a dead band: nothing comes out below its width, and so much less above."""
    inside = np.clip(rate_dps, -_WIDTH, _WIDTH)
    return np.asarray(1.002 * rate_dps - inside + 0.01 + 2e-4 * (temp_c - 20.0))


def table(sizes: list[float], seed: int) -> DataSetTable:
    rates = np.array([-s for s in sizes] + [0.0] * 6 + sizes)
    rate, temp = (x.ravel() for x in np.meshgrid(rates, np.linspace(-10.0, 50.0, 7)))
    # A table at rest is servoed, and moves by some thousandths of a degree.
    rng = np.random.default_rng(seed)
    rate = rate + 0.004 * rng.standard_normal(rate.size)
    gyro = banded(rate, temp) + 2e-4 * rng.standard_normal(rate.size)
    t_s = 30.0 * np.arange(rate.size)
    return DataSetTable(Path("band.csv"), rate, gyro, temp, t_s=t_s)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sizes",
    [
        [6.0, 15.0, 57.0, 100.0],
        pytest.param([0.01, 0.2, 6.0, 15.0, 57.0, 100.0], marks=pytest.mark.slow),
    ],
)
def test_the_file_of_a_gyro_with_a_dead_band_is_right_beyond_it_and_calm_within(sizes: list[float]) -> None:
    found = diagnose(series_of_table(table(sizes, 1)), None, Options(heldout=False))
    assert found.improved is not None
    assert [e.effect for e in found.effects][:1] == ["dead_zone"]
    if min(sizes) < _WIDTH:
        # The zone itself was seen, and the law of it leaves nothing.
        assert not any(p.remains for p in found.located if p.coordinate == "rate")
    robot = Compensator(found.improved)
    temp = np.linspace(0.0, 40.0, 41)
    for size in (0.0, *(s for s in sizes if s > _WIDTH)):
        rate = np.full(temp.size, size)
        off = robot.correct(np.arange(temp.size) * 1.0, banded(rate, temp), temp) - rate
        assert np.max(np.abs(off)) < 0.25 * _WIDTH, size
    # A robot that stands, and whose samples have noise, must not be thrown from one edge of the zone to the other.
    noise = 2e-3 * np.random.default_rng(2).standard_normal(4000)
    still = banded(np.zeros(4000), np.full(4000, 20.0)) + noise
    corrected = robot.correct(np.arange(4000) * 0.01, still, np.full(4000, 20.0))
    assert np.std(corrected) < 2.5 * np.std(noise)


def _hard(rate_dps: Floats, width_dps: float) -> Floats:
    return np.where(np.abs(rate_dps) < width_dps, 0.0, rate_dps)


def _locked(rate_dps: Floats, width_dps: float) -> Floats:
    return np.asarray(np.sign(rate_dps) * np.sqrt(np.maximum(rate_dps**2 - width_dps**2, 0.0)))


@pytest.mark.slow
@pytest.mark.parametrize("zone", [_hard, _locked])
def test_a_zone_under_noise_is_no_step_of_the_output_that_throws_a_standing_gyro(
    zone: Callable[[Floats, float], Floats],
) -> None:
    """Rates just beyond the zone lack what a truncation would take, and of means nobody knows that there is none."""
    width_dps, noise_dps = 0.05, 0.006
    rng = np.random.default_rng(116)
    sizes = np.array([0.015, 0.035, 0.06, 0.08, 0.15, 0.5, 2.0, 5.0, 10.0, 30.0, 60.0, 90.0])
    rates = np.concatenate([-sizes[::-1], [0.0], sizes])
    rate = np.concatenate([rng.permutation(rates) for _ in range(9)])
    n = np.arange(rate.size)
    temp = np.repeat(np.linspace(-20.0, 60.0, 9), rates.size) + np.sin(n / 37.0)

    def gyro(true_dps: Floats, temp_c: Floats) -> Floats:
        through, v = zone(true_dps, width_dps), (temp_c - 20.0) / 40.0
        own = 1.002 * through + 1e-3 * v * through + 0.01 * (1.0 + 0.5 * v) + 0.02 * (through / 90.0) ** 3
        return np.asarray(own + noise_dps * rng.standard_normal(true_dps.size))

    t_s = 60.0 * n + 3600.0 * (n // rates.size)
    recorded = DataSetTable(Path("zone.csv"), rate, gyro(rate, temp), temp, t_s=t_s)
    found = diagnose(series_of_table(recorded), None, Options(heldout=False))
    assert "dead_zone" in {e.effect for e in found.effects}
    still, warm = np.zeros(1000), np.linspace(-10.0, 50.0, 1000)
    file = found.improved or found.surface
    assert file is not None
    corrected = Compensator(file).correct(60.0 * np.arange(1000), gyro(still, warm), warm)
    assert np.sqrt(np.mean(corrected**2)) < 1.25 * noise_dps


def test_what_goes_is_fitted_beside_what_stays() -> None:
    means = means_of(series_of_table(table([0.01, 6.0, 15.0, 57.0, 100.0], 3)))
    fitted = fit_model(full_model(means, memory=False))
    calm = rising(fitted, None)
    assert "odd near zero, within" in calm.model.components
    assert all(part.name not in ("odd near zero, within", "odd near zero") for part in calm.model.parts)
    np.testing.assert_allclose(calm.solve().left, fitted.solve().left, atol=1e-7)


@pytest.mark.slow
def test_models_that_keep_other_shapes_are_averaged() -> None:
    """Of rates in any order through heating and cooling, the models near the best leave out shapes of different number."""
    rng = np.random.default_rng(1)
    rates = np.array([0.0, *(s * x for x in (0.01, 0.2, 5.0, 20.0, 60.0, 100.0) for s in (1.0, -1.0))])
    up = [-10.0, 5.0, 15.0, 25.0, 35.0, 50.0]
    temp = np.repeat([*up, *up[::-1]], rates.size) + 0.3 * rng.standard_normal(12 * rates.size)
    rate = np.concatenate([rng.permutation(rates) for _ in range(12)])
    through = np.sign(rate) * np.maximum(np.abs(rate) - _WIDTH, 0.0)
    u, v = through / 100.0, (temp - 20.0) / 30.0
    error = 0.02 + 0.03 * v + 0.008 * v**2 + u * (-0.5 - 0.2 * v + 0.05 * v**2)
    error += u**2 * (0.1 + 0.02 * v) + u**3 * (0.9 + 0.05 * v - 0.03 * v**2)
    gyro = through + error + 3e-4 * rng.standard_normal(rate.size)
    t_s = 60.0 * np.arange(rate.size) + 1800.0 * np.repeat([0.0, 1.0], rate.size // 2)
    found = diagnose(
        series_of_table(DataSetTable(Path("t.csv"), rate, gyro, temp, t_s=t_s)), None, Options(heldout=False)
    )
    assert found.improved is not None
    still = Compensator(found.improved).correct(np.zeros(1), np.full(1, 0.02), np.full(1, 20.0))
    assert abs(still[0]) < 0.1 * _WIDTH


def test_a_gyro_without_a_dead_zone_keeps_all_its_shapes() -> None:
    rng = np.random.default_rng(4)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 13), np.linspace(-10.0, 50.0, 5)))
    gyro = 1.002 * rate + 1e-5 * np.abs(rate) + 3e-4 * rng.standard_normal(rate.size)
    fitted = fit_model(full_model(means_of(series_of_table(DataSetTable(Path("t.csv"), rate, gyro, temp)))))
    assert rising(fitted, None) is fitted


def test_small_rates_alone_bring_no_order_of_the_rate() -> None:
    """Through ±0.01 deg/s within the zone a fifth order could pass with any size at the rates between."""
    means = means_of(series_of_table(table([0.01, 30.0, 100.0], 5)))
    assert all(part.name != "odd orders" for part in full_model(means).parts)


@pytest.mark.parametrize("share", [2e-4, 1.0])
def test_a_zone_that_takes_a_part_of_small_rates_stays_in_the_file(share: float) -> None:
    """Of a gyro that answers in it a robot undoes it; the file had lacked a law that explained all."""
    rng = np.random.default_rng(5)
    sizes = np.array([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0])
    rate = np.tile(np.concatenate([-sizes[::-1], [0.0], sizes]), 6)
    temp = np.repeat(np.array([-10.0, 10.0, 30.0, 50.0, 20.0, 0.0]), 17)
    width, form = 1.2, {"width_dps": 1.2, "form": 3.0}
    gyro = 1.001 * rate - share * np.clip(rate, -width, width) + 1e-5 * rng.standard_normal(rate.size)
    t_s = 30.0 * np.arange(rate.size, dtype=np.float64)
    means = means_of(series_of_table(DataSetTable(Path("zone.csv"), rate, gyro, temp, t_s=t_s)))
    model = full_model(means)
    kept = {"white", *(p.name for p in model.parts if p.block == "surface")}
    plain = fit_model(model.without([n for n in model.components if n not in kept]))
    laws = laws_of(means, surface_of(plain.model, plain.solve()))
    law = Law("dead_zone", form, laws.at(DEAD_ZONE, form))
    held = rising(plain.refit(plain.model.with_laws(law)), None).model.holds(law)
    assert held is (share < 0.5)
