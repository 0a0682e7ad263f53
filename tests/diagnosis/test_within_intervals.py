"""Intervals of patterns within data sets: from the scatter between sets, and of a decay time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import diagnose, series_of
from gyrocal.diagnosis.laws.estimates import _shapes, of_pattern
from gyrocal.diagnosis.model.within import Pattern, jackknife, patterns
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.units import MDPS
from tests.diagnosis.concealed_bench import make_recording, write_run


def test_leaving_out_each_set_is_what_the_jackknife_does() -> None:
    rng = np.random.default_rng(3)
    sets = np.repeat(np.arange(8), 20)
    z = rng.standard_normal((sets.size, 2))
    y = z @ np.array([1.0, -2.0]) + rng.standard_normal(8)[sets]
    each = np.array([np.linalg.lstsq(z[sets != k], y[sets != k], rcond=None)[0] for k in range(8)])
    change = each - np.linalg.lstsq(z, y, rcond=None)[0]
    assert jackknife(y, z, sets) == pytest.approx(7.0 / 8.0 * change.T @ change)


@pytest.mark.slow
def test_a_decay_time_has_an_interval(tmp_path: Path) -> None:
    write_run(make_recording([("step_response", 60.0)], 21, "even"), tmp_path / "run")
    (found,) = patterns(series_of(tmp_path / "run"), 0.01)
    assert found.effect == "step_response"
    for estimate in (of_pattern(found)[name] for name in ("tau_s", "amplitude")):
        low, high = estimate.interval_95
        assert low < estimate.value < high
        assert high - low < abs(estimate.value)


@pytest.mark.parametrize("harmonic", [2.0, 3.0])
def test_an_error_of_the_reference_is_turned_by_a_gyro_that_is_not_straight(
    harmonic: float, tmp_path: Path
) -> None:
    """An angle error of 20 arcsec, a few times a turn, under a gyro whose scale factor grows by a tenth up to the largest rate."""
    write_run(make_recording([], 22, "even"), tmp_path / "run")
    series = series_of(tmp_path / "run")
    effect, shape = find_effect("table_eccentricity"), {"harmonic": harmonic}
    off = effect.error_dps(conditions_of(series), {**shape, "amplitude": 20.0, "phase_rad": 0.7}, None, None)[
        0
    ]
    bent = series.gyro_dps + 0.1 / 3.0 * series.rate_dps**3 / np.max(np.abs(series.rate_dps)) ** 2
    turned = np.polyval(np.polyder(np.polyfit(series.rate_dps, bent, 3)), series.rate_dps)
    (found,) = patterns(replace(series, gyro_dps=bent + turned * off), 0.01)
    assert (found.effect, found.shape) == (effect.id, shape)
    low, high = of_pattern(found)["amplitude"].interval_95
    assert low < 20.0 < high
    assert high - low < 1.0


@pytest.mark.slow
def test_a_table_that_wobbles_is_no_error_of_the_gyro(tmp_path: Path) -> None:
    write_run(make_recording([], 22, "even"), tmp_path / "run")
    series = series_of(tmp_path / "run")
    assert series.angle_deg is not None
    wobble_dps = 0.05 * np.sin(np.radians(series.angle_deg)) * (series.rate_dps != 0)
    wobbling = replace(series, rate_dps=series.rate_dps + wobble_dps, gyro_dps=series.gyro_dps + wobble_dps)
    assert patterns(replace(series, gyro_dps=wobbling.gyro_dps), 0.01) != []
    assert patterns(wobbling, 0.01) == []


def test_amplitude_and_phase_are_those_of_the_law() -> None:
    """Cosine and sine of a turn, and the law of the catalogue at the amplitude and phase that they are said to be."""
    effect, angle = find_effect("earth_rate_tilt"), np.linspace(0.0, 360.0, 25)
    c = Conditions(np.arange(25.0), np.full(25, 10.0), np.full(25, 20.0), angle_deg=angle)
    both = np.array([0.3, 0.4])
    covariance = np.array([[0.01, 0.004], [0.004, 0.02]])
    pattern = Pattern(effect.id, {}, effect.columns(c, {}, None), both, covariance, 1e-9, 1e9)
    found = of_pattern(pattern)
    law = effect.error_dps(c, {n: e.value for n, e in found.items()}, None, None)[0]
    np.testing.assert_allclose(law, pattern.values, atol=1e-12)
    draws = np.random.default_rng(1).multivariate_normal(both, 1e-4 * covariance, 20_000)
    for name, each in (
        ("amplitude", np.hypot(*draws.T)),
        ("phase_rad", np.arctan2(-draws[:, 1], draws[:, 0])),
    ):
        assert found[name].std == pytest.approx(100.0 * each.std(), rel=0.03)


def test_what_is_chosen_from_a_few_has_no_interval() -> None:
    shape = {"knee_dps": 80.0, "softness_dps": 0.0}
    stated = _shapes(find_effect("saturation"), shape, {"knee_dps": (70.0, 90.0)})
    told = stated["softness_dps"].to_json()
    assert told == {"value": 0.0, "std": None, "unit": "deg/s", "interval_95": [None, None]}
    assert stated["knee_dps"].interval_95 == (70.0, 90.0)


@pytest.mark.parametrize(
    ("size_mdps", "names"),
    [(3.0, ["earth_rate_tilt", "magnetic", "g_sensitivity"]), (50.0, ["g_sensitivity"])],
)
def test_what_is_larger_than_the_rate_of_the_earth_is_not_that(
    size_mdps: float, names: list[str], tmp_path: Path
) -> None:
    write_run(make_recording([], 22, "even"), tmp_path / "run")
    series = series_of(tmp_path / "run")
    assert series.angle_deg is not None
    once = size_mdps * MDPS * np.cos(np.deg2rad(series.angle_deg) - 1.0)
    found = diagnose(replace(series, gyro_dps=series.gyro_dps + once))
    (effect,) = found.effects
    assert [effect.effect, *(a.effect for a in effect.alternatives)] == names
