"""Layers over one another, on records made here from closed forms, and judged on a second run of the same gyro."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.correction import correction
from gyrocal.diagnosis.engine import diagnose, series_of
from gyrocal.diagnosis.examine import examine
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.model.blocks import around_itself, settle_direction
from gyrocal.diagnosis.model.layers import Law, beyond_input, fit_model, full_model, surface_of
from gyrocal.diagnosis.model.parts import SURFACE, legendre_to_powers, polynomials, staying
from gyrocal.diagnosis.model.starts import fit_anyhow
from gyrocal.diagnosis.model.within import patterns
from gyrocal.diagnosis.names.naming import _at_rest
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.series import series_of_run
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.errors import CoefficientError
from gyrocal.fusion.coefficients import Coefficients, parse_coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.run import read_run
from gyrocal.report.folds import fold_of
from tests.diagnosis.concealed_bench import make_recording, write_run
from tests.diagnosis.test_lag_posterior import SHARE, TAU_S, lagging

Floats = NDArray[np.float64]


def sweeps(seed: int, noise_dps: float = 4e-4) -> tuple[DataSetTable, Floats]:
    """Sweeps of an open-loop gyro whose coil lags 250 s behind a drifting thermometer, and the true rates.

    The reference is off by 100 ppm for each size of rate; without noise there is none of this either.
    """
    rng = np.random.default_rng(seed)
    sizes = np.linspace(0.0, 100.0, 11)
    rate = np.concatenate([s * sizes for s in rng.permutation([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])])
    t: Floats = 25.0 * np.arange(rate.size, dtype=np.float64)
    temp = 25.0 + rng.uniform(4.0, 8.0) * np.sin(2.0 * np.pi * t / rng.uniform(1500.0, 3000.0)) + 2e-3 * t
    coil = np.empty(t.size)
    coil[0] = temp[0]
    for k in range(1, t.size):
        # exact for a temperature that is linear between rows
        a = np.exp(-25.0 / 250.0)
        slope = (temp[k] - temp[k - 1]) / 25.0
        coil[k] = temp[k] - 250.0 * slope + a * (coil[k - 1] - temp[k - 1] + 250.0 * slope)
    true = rate * (
        1.0 + 1e-4 * np.random.default_rng(3).standard_normal(11)[np.round(np.abs(rate) / 10.0).astype(int)]
    )
    if noise_dps == 0.0:
        true = rate
    phase = 0.004
    gyro = (1.0 + 2e-4 * (coil - 25.0)) * np.sin(phase * true) / phase + 0.01 + 1e-3 * (coil - 25.0)
    gyro = gyro + noise_dps * rng.standard_normal(t.size)
    return DataSetTable(Path("sweeps.csv"), rate, gyro, temp, t_s=t), rate


def left_dps(coefficients: Coefficients, table: DataSetTable, rate_dps: Floats) -> float:
    """Error of the corrected rates, rms."""
    assert table.t_s is not None
    found = Compensator(coefficients).evaluate(table.t_s, table.gyro_dps, table.temp_c, None).rate_dps
    return float(np.sqrt(np.mean((found - rate_dps) ** 2)))


@pytest.fixture(scope="module")
def layered() -> Diagnosis:
    """Diagnosis of the sweeps."""
    return diagnose(sweeps(1)[0])


def test_layers_of_a_table_are_named_and_a_second_run_is_corrected(layered: Diagnosis) -> None:
    named = {e.effect for e in layered.effects}
    assert {"thermal_lag", "reference_rate_error"} <= named
    assert named & {"fit_direction", "sagnac_sine", "rate_order"}
    lag = next(e for e in layered.effects if e.effect == "thermal_lag").parameters["tau_s"]
    assert lag.interval_95[0] < 250.0 < lag.interval_95[1]
    (where,) = [place for place in layered.located if place.coordinate == "temperature_rate"]
    assert where.rms_dps is not None
    assert 2e-3 < where.rms_dps < 0.1
    assert layered.surface is not None
    assert layered.improved is not None
    second, rate = sweeps(2, noise_dps=0.0)
    file = parse_coefficients(layered.improved.to_text(), "improved")
    # The reference of the first run was off by 100 ppm of a rate, of which the mean over the sizes stays.
    assert left_dps(file, second, rate) < 0.25 * left_dps(layered.surface, second, rate)
    assert left_dps(file, second, rate) < 6e-3


def test_the_lag_of_a_table_is_drawn_with_what_the_others_did_taken_out(layered: Diagnosis) -> None:
    (lag,) = [e for e in layered.effects if e.effect == "thermal_lag"]
    seen = fold_of(layered, lag)
    assert seen is not None
    before, after, noise = seen.rms()
    assert after < 2.0 * noise < 0.2 * before
    np.testing.assert_allclose(seen.before - seen.after, seen.law, atol=0.2 * np.ptp(seen.law))


def test_the_staircase_goes_down_to_the_noise(layered: Diagnosis) -> None:
    steps = [layer.logloss for layer in layered.layers]
    assert len(steps) >= 2
    assert steps[-1] < steps[0] - 0.5
    assert layered.layers[-1].heldout_rms_dps < 1.5 * layered.layers[-1].noise_floor_dps
    document = layered.to_json()
    assert document["layers"][0]["layer"] == "surface"


def test_smooth_parts_are_free_of_the_surface() -> None:
    """What the projection takes of a part is what the surface gives back: polynomials themselves, wholly."""
    means = means_of(series_of_table(sweeps(1)[0]))
    model = full_model(means)
    taken = polynomials(SURFACE, model.basis.frame)
    np.testing.assert_allclose(taken, np.eye(len(SURFACE)), atol=1e-9)
    assert {p.block for p in staying(means, model.basis.frame, np.arange(12))} >= {"memory", "odd rate"}


def test_what_is_constant_has_its_value_as_mean_of_every_row() -> None:
    """The history of the temperature begins with the second sample of a row at times: half of what it had been was its mean."""
    means = means_of(series_of_run(read_run(Path(__file__).parents[2] / "sample_data" / "run")))
    basis = full_model(means).basis
    assert means.from_s[0] < means.series.history.t_s[0]
    ones = np.ones(means.series.history.t_s.size)
    np.testing.assert_allclose(basis._averaged(ones), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("rates", "temperatures"),
    [(2, 2), (4, 4), (6, 5), (7, 5), (12, 15), (12, 40), pytest.param(40, 40, marks=pytest.mark.slow)],
)
def test_shapes_are_those_that_the_visited_places_can_tell_apart(rates: int, temperatures: int) -> None:
    """Sizes of rate beside rest: a curve of more orders than places goes anywhere between them."""
    sizes = np.linspace(0.0, 100.0, rates + 1)
    rate, temp = (
        a.ravel() for a in np.meshgrid(np.r_[-sizes, sizes], np.linspace(-10.0, 50.0, temperatures))
    )
    table = DataSetTable(Path("t.csv"), rate, rate, temp, t_s=30.0 * np.arange(rate.size, dtype=np.float64))
    means = means_of(series_of_table(table))
    parts = {p.name: p for p in staying(means, full_model(means).basis.frame, np.arange(12))}

    def orders(name: str, of_surface: int) -> int:
        return of_surface + (len(parts[name].columns) if name in parts else 0)

    assert orders("odd orders", SHAPE[0] // 2) <= max(rates, SHAPE[0] // 2)
    assert orders("even orders", SHAPE[0] // 2) <= max(rates + 1, SHAPE[0] // 2)
    for target in ("bias", "scale"):
        assert orders(f"temperature orders on {target}", SHAPE[1]) <= max(temperatures, SHAPE[1])
    for bumps in ("odd bumps", "even bumps"):
        assert (bumps in parts) == (rates >= 7)
    for target in ("bias", "scale"):
        assert (f"temperature on {target}" in parts) == (temperatures >= 15)
        assert (f"narrow temperature on {target}" in parts) == (temperatures == 40)
    assert all(p.columns for p in parts.values())


def test_the_scale_factor_has_the_shapes_of_the_temperatures_at_which_it_turned() -> None:
    temp = np.linspace(-10.0, 50.0, 60)
    rate = np.where(np.arange(60) % 20 == 0, 50.0, 0.0)
    table = DataSetTable(Path("t.csv"), rate, rate, temp, t_s=30.0 * np.arange(60, dtype=np.float64))
    means = means_of(series_of_table(table))
    parts = {p.name for p in staying(means, full_model(means).basis.frame, np.arange(12))}
    assert {"temperature orders on bias", "temperature on bias"} <= parts
    assert not {"temperature orders on scale", "temperature on scale"} & parts


def test_a_ripple_over_temperature_is_no_noise() -> None:
    """Up and down through 75 degC, a period of 20 degC: 1/f noise can follow it, and knows nothing of its return."""
    rng = np.random.default_rng(8)
    t_s = 20.0 * np.arange(120.0)
    temp = 17.0 - 37.0 * np.cos(2.0 * np.pi * t_s / t_s[-1])
    rate = np.concatenate([rng.permutation(np.linspace(-80.0, 80.0, 12)) for _ in range(10)])
    ripple = 0.05 * np.sin(2.0 * np.pi * temp / 20.0)
    gyro = 1.001 * rate + 0.02 + ripple + 5e-4 * rng.standard_normal(rate.size)
    means = means_of(series_of_table(DataSetTable(Path("t.csv"), rate, gyro, temp, t_s=t_s)))
    fitted = fit_model(full_model(means, memory=False))
    assert fitted.has_died("flicker 2000 s")
    narrow = "narrow temperature on bias"
    found = np.asarray(fitted.model.components[narrow].columns) @ fitted.solve().amplitudes[narrow]
    # The surface has taken what of the ripple is a quadratic.
    assert np.std(found) > 0.7 * np.std(ripple)


def test_a_warm_up_is_looked_for_at_the_times_that_the_record_lasts() -> None:
    t_s = np.linspace(0.0, 1000.0, 60)
    rate = np.tile([-50.0, 0.0, 50.0], 20)
    temp = 20.0 + np.sin(t_s / 300.0)
    means = means_of(series_of_table(DataSetTable(Path("t.csv"), rate, rate, temp, t_s=t_s)))
    (warm,) = (p for p in full_model(means).parts if p.block == "warm-up")
    assert [column.driver.numbers for column in warm.columns] == [(150.0,), (300.0,), (600.0,), (1200.0,)]


def test_legendre_products_are_powers() -> None:
    rng = np.random.default_rng(1)
    c, u, v = rng.standard_normal(12), 0.3, -0.7
    products = [
        np.polynomial.legendre.legval(u, np.eye(4)[i]) * np.polynomial.legendre.legval(v, np.eye(3)[j])
        for i in range(SHAPE[0])
        for j in range(SHAPE[1])
    ]
    powers = (legendre_to_powers() @ c).reshape(SHAPE)
    assert np.polynomial.polynomial.polyval2d(u, v, powers) == pytest.approx(float(np.dot(c, products)))


def test_a_second_start_never_fits_worse() -> None:
    model = full_model(means_of(series_of_table(sweeps(1)[0])), memory=False)
    found = fit_anyhow(model)
    assert np.isfinite(found.nll)
    assert found.nll <= found.refit(model).nll + 1.0


def test_a_surface_of_the_output_bends_as_the_surface_that_it_has_in_the_end() -> None:
    """Or the file, whose surface is one of the output, would be another model than the one that was fitted."""
    fitted = fit_model(full_model(means_of(series_of_table(sweeps(1)[0])), memory=False))
    other = 3.0 * fitted.model.legendre(fitted.solve())
    found = around_itself(fitted.refit(fitted.model.directed("output", other)))
    assert found.model.bend is not None
    now = found.model.bend_of(found.solve())
    bends = [beyond_input(found.model.basis, b) @ now for b in (found.model.bend, now)]
    np.testing.assert_allclose(bends[0], bends[1], atol=5e-3 * np.abs(bends[1]).max())


@pytest.mark.parametrize("seed", range(3))
def test_a_steep_surface_of_the_output_leaves_nothing(seed: int) -> None:
    """Twelve terms of the output that reach 4 % of full rate are no twelve terms of anything that is known of the rate."""
    rng = np.random.default_rng(seed)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 15), np.linspace(-10.0, 50.0, 7)))
    c = rng.standard_normal(SHAPE) * np.array([[0.2], [1.0], [0.5], [4.0]]) * np.array([1.0, 0.3, 0.1])
    gyro = Surface(c, 0.0, 100.0, 20.0, 30.0).output_dps(rate, temp) + 1e-3 * rng.standard_normal(rate.size)
    series = series_of_table(DataSetTable(Path("steep.csv"), rate, gyro, temp))
    fitted = settle_direction(fit_model(full_model(means_of(series), memory=False)))
    left_dps = around_itself(fitted).solve().left
    assert fitted.model.direction == "output"
    assert np.sqrt(np.mean(left_dps**2)) == pytest.approx(1e-3, rel=0.25)


@pytest.mark.slow
def test_flicker_within_data_sets_makes_no_pattern(tmp_path: Path) -> None:
    """Four recordings of nothing but noise at a level of 0.01: two false alarms have a chance of 0.06 %."""
    alarms = 0
    for seed in range(4):
        write_run(make_recording([], 300 + seed, "even"), tmp_path / str(seed))
        alarms += bool(patterns(series_of(tmp_path / str(seed)), 0.01))
    assert alarms <= 1


@pytest.mark.slow
def test_a_creep_after_steps_has_its_time_constant_though_the_first_sample_is_early(tmp_path: Path) -> None:
    """Among steps of very different sizes, of which few tell most: the shape is that which fits."""
    write_run(make_recording([], 310, "even"), tmp_path / "run")
    series = series_of(tmp_path / "run")
    assert series.since_set_s is not None
    assert series.step_dps is not None
    assert series.since_set_s.min() >= 0.0
    crept = 3e-3 * series.step_dps * np.exp(-series.since_set_s / 2.2) * series.is_set
    (found, *_) = patterns(replace(series, gyro_dps=series.gyro_dps + crept), 0.01)
    assert found.effect == "step_response"
    assert found.shape["frequency_hz"] == 0.0
    assert found.shape["tau_s"] == pytest.approx(2.2, rel=0.07)


def at_rest(change_dps: Floats, t: Floats, seed: int = 5) -> Diagnosis:
    """Diagnosis of data sets at rest from power-on, with noise of 0.4 mdeg/s and a change of the bias."""
    rng = np.random.default_rng(seed)
    temp = 25.0 + 0.1 * np.sin(t / 500.0)
    gyro = 0.01 + change_dps + 4e-4 * rng.standard_normal(t.size)
    return diagnose(DataSetTable(Path("rest.csv"), np.zeros(t.size), gyro, temp, t_s=t))


def test_ageing_is_a_drift_and_is_held_where_it_was_last_and_a_warm_up_comes_again() -> None:
    t: Floats = 60.0 * np.arange(120, dtype=np.float64)
    aged, warmed = at_rest(5e-3 * np.sqrt(t / t[-1]), t), at_rest(5e-3 * np.exp(-t / 900.0), t)
    of_logarithm = at_rest(5e-3 * np.log1p(t / 400.0) / np.log1p(t[-1] / 400.0), t)
    assert [e.effect for e in aged.effects] == ["bias_drift"]
    assert [e.effect for e in of_logarithm.effects] == ["bias_drift"]
    assert [e.effect for e in warmed.effects] == ["warm_up"]
    # What slows down from power-on may be a warm-up of another law.
    for slowing in (*aged.effects, *of_logarithm.effects):
        assert [a.effect for a in slowing.alternatives] == ["warm_up"]
    later = np.array([0.0, 3600.0])
    held = [0.015, 0.015]
    for found, expected in ((aged, held), (of_logarithm, held), (warmed, [0.015, 0.0101])):
        assert found.improved is not None
        file = parse_coefficients(found.improved.to_text(), "improved")
        gyro, temp = np.array(expected), np.full(2, 25.0)
        since = later if found is warmed else None
        left = Compensator(file).evaluate(later, gyro, temp, since).rate_dps
        np.testing.assert_allclose(left, 0.0, atol=8e-4)


def test_a_run_of_which_nobody_says_when_it_was_switched_on_needs_no_time_since_then() -> None:
    """Whoever applies its file to another such run has no such time; what the bias came to is held."""
    t: Floats = 60.0 * np.arange(120, dtype=np.float64)
    gyro = 0.01 + 5e-3 * np.exp(-t / 900.0) + 4e-4 * np.random.default_rng(5).standard_normal(t.size)
    temp = 25.0 + 0.1 * np.sin(t / 500.0)
    series = series_of_table(DataSetTable(Path("rest.csv"), np.zeros(t.size), gyro, temp, t_s=t))
    found = examine(series, 0.01)
    unknown = replace(found, series=replace(series, is_table=False))
    assert found.comes_again > 0.9
    assert unknown.comes_again == 0.0
    with pytest.raises(CoefficientError, match="time since power-on"):
        Compensator(correction(found)).correct(t[-1], 0.01, temp[-1])
    assert abs(Compensator(correction(unknown)).correct(t[-1], 0.01, temp[-1])) < 8e-4


@pytest.mark.slow
def test_it_is_said_where_it_is_open_whether_a_change_since_power_on_comes_again() -> None:
    """A slow warm-up in noise is half a drift; one that is over within the record is none."""
    t: Floats = 60.0 * np.arange(120, dtype=np.float64)
    for change, is_open in ((4e-3 * np.exp(-t / 4000.0), True), (5e-3 * np.exp(-t / 900.0), False)):
        said = [n for n in at_rest(change, t, seed=2).notes if isinstance(n, Remark)]
        assert (Said.OPEN_SINCE_POWER_ON in [n.said for n in said]) == is_open


def test_a_transient_of_two_time_constants_is_a_warm_up_and_no_drift() -> None:
    """A power of time follows it nearly as well (on 1 of 12 draws of the noise better), and would be held where it was last."""
    t: Floats = 60.0 * np.arange(120, dtype=np.float64)
    found = at_rest(5e-3 * np.exp(-t / 150.0) + 8e-3 * np.exp(-t / 2000.0), t, seed=7)
    assert [e.effect for e in found.effects] == ["warm_up"]
    assert found.improved is not None
    file = parse_coefficients(found.improved.to_text(), "improved")
    gyro = np.array([0.023, 0.0101])
    left_dps = Compensator(file).evaluate(
        np.array([0.0, 9000.0]), gyro, np.full(2, 25.0), np.array([0.0, 9000.0])
    )
    np.testing.assert_allclose(left_dps.rate_dps, 0.0, atol=1.2e-3)


def test_a_model_tells_its_laws_apart_by_their_shapes() -> None:
    """Columns cannot be compared: two laws of one effect are enough to ask."""
    means = means_of(series_of_table(sweeps(1)[0]))
    fast, slow = (Law("warm_up", {"tau_s": tau}, np.exp(-means.t_s / tau)[:, None]) for tau in (60.0, 600.0))
    model = full_model(means).with_laws(fast, slow)
    assert model.holds(replace(slow))
    assert not model.without_laws([fast.name]).holds(fast)


def test_a_lag_acts_through_the_surface_that_stands_beside_it_at_the_end() -> None:
    """Found beside another surface, as before a step took the place of a slope over temperature, it was of another size."""
    full = full_model(means_of(series_of_table(lagging(1.5e-3, 1))), memory=False)
    fitted = fit_model(full)
    right = surface_of(fitted.model, fitted.solve())
    steeper = right.coefficients_dps * np.where(np.arange(3) == 1, 1.5, 1.0)
    stale = laws_of(full.means, replace(right, coefficients_dps=steeper))
    shape = {"tau_s": TAU_S}
    law = Law("thermal_lag", shape, stale.at(CATALOGUE["thermal_lag"], shape))
    before = fitted.refit(full.with_laws(law))
    after, _, laws = _at_rest(before, [], stale)
    sizes = [float(f.solve().amplitudes[f.model.laws[0].name][0]) for f in (before, after)]
    assert sizes[0] < 0.9 * SHARE
    assert sizes[1] == pytest.approx(SHARE, abs=0.03)
    np.testing.assert_allclose(
        laws.surface.coefficients_dps,
        surface_of(after.model, after.solve()).coefficients_dps,
        atol=5e-3,
    )
