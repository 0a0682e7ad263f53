"""What earns its place in the improved coefficients."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer import correction as module
from gyrocal.diagnosis.answer.correction import _estimate, _items, correction, doubtful, mixed
from gyrocal.diagnosis.answer.standing import left_by_drifts, state_of_laws
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.examine import Examination
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.model.blocks import around_itself
from gyrocal.diagnosis.model.layers import Fitted, Law, fit_model, full_model, surface_of
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.candidates import Candidate
from gyrocal.diagnosis.versus.law import left_by
from gyrocal.fusion.coefficients import parse_coefficients
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.effect import Effect
from gyrocal.physics.rate import RATE_ORDER, SAGNAC_SINE
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.thermal import SHUPE
from gyrocal.physics.timewise import BIAS_DRIFT, SCALE_DRIFT
from gyrocal.records.datasets import DataSetTable
from gyrocal.units import MDPS, PPM

Floats = NDArray[np.float64]


def _found(
    nats: float, named: str = "", candidates: tuple[Any, ...] = (), block: str = "memory"
) -> Examination:
    naming = SimpleNamespace(named=[SimpleNamespace(block=named)], unnamed={block: nats})
    return cast(Examination, SimpleNamespace(candidates=candidates, naming=naming))


@pytest.mark.parametrize(
    ("found", "beside", "expected"),
    [
        (_found(7.0), 7.0, ["memory"]),
        (_found(30.0), 30.0, []),
        (_found(30.0), 2.0, ["memory"]),
        (_found(7.0, named="memory"), 7.0, []),
        (_found(7.0, block="odd rate"), 7.0, []),
        (_found(7.0, candidates=((1.0, None),)), 7.0, []),
    ],
)
def test_a_part_without_a_name_must_be_beyond_doubt_also_where_the_gyro_may_wander(
    monkeypatch: pytest.MonkeyPatch, found: Examination, beside: float, expected: list[str]
) -> None:
    monkeypatch.setattr(module, "_beside_wander", lambda _, blocks: dict.fromkeys(blocks, beside))
    assert doubtful(found) == expected


def _of_temperature(table: DataSetTable) -> Fitted:
    """A surface, shapes in temperature and white noise, and nothing that wanders."""
    model = full_model(means_of(series_of_table(table)))
    stays = {p.name for p in model.parts if p.block in ("surface", "temperature")}
    return fit_model(model.without([n for n in model.components if n not in {*stays, "white"}]))


@pytest.mark.parametrize("wanders", [True, False])
def test_what_a_walk_explains_as_well_is_not_beyond_doubt(wanders: bool) -> None:
    """A bias that climbs with the temperature of the one ramp that a record has, and one that follows it down again."""
    rng = np.random.default_rng(3)
    n = 160
    course = np.linspace(0.0, 1.0, n) if wanders else 0.5 - 0.5 * np.cos(np.linspace(0.0, 24.0, n))
    temp_c, rate_dps = 20.0 + 20.0 * course, np.tile([-50.0, -20.0, 20.0, 50.0], n // 4)
    bump = 0.02 * np.exp(-(((temp_c - 30.0) / 3.0) ** 2))
    gyro_dps = rate_dps + bump + 1e-3 * rng.standard_normal(n)
    t_s = 60.0 * np.arange(n, dtype=np.float64)
    fitted = _of_temperature(DataSetTable(Path("bump.csv"), rate_dps, gyro_dps, temp_c, t_s=t_s))
    naming = SimpleNamespace(fitted=fitted, named=[], unnamed={"temperature": 30.0})
    found = cast(Examination, SimpleNamespace(candidates=(), naming=naming, model=fitted.model))
    assert doubtful(found) == (["temperature"] if wanders else [])


def test_what_is_left_out_falls_to_the_surface_of_the_whole_record() -> None:
    """A bias that rises at the end of the one ramp of a record: where it ended is no state that the next run has."""
    rng = np.random.default_rng(4)
    n = 160
    temp_c, rate_dps = np.linspace(20.0, 40.0, n), np.tile([-50.0, -20.0, 20.0, 50.0], n // 4)
    rise = 0.02 * np.exp((temp_c - 40.0) / 2.0)
    gyro_dps = rate_dps + rise + 2e-4 * rng.standard_normal(n)
    t_s = 60.0 * np.arange(n, dtype=np.float64)
    fitted = _of_temperature(DataSetTable(Path("rise.csv"), rate_dps, gyro_dps, temp_c, t_s=t_s))
    naming = SimpleNamespace(fitted=fitted, named=(), unnamed={"temperature": 30.0})
    found = cast(Examination, SimpleNamespace(candidates=(), naming=naming, laws=None, comes_again=0.0))
    file = correction(found, ["temperature"])
    columns = np.column_stack([np.ones(n), temp_c, rate_dps, rate_dps * temp_c, rate_dps**2, rate_dps**3])
    error_dps = gyro_dps - rate_dps
    plain_dps = error_dps - columns @ np.linalg.lstsq(columns, error_dps, rcond=None)[0]
    left_dps = Compensator(file).correct(t_s, gyro_dps, temp_c, t_s, None) - rate_dps
    assert np.sqrt(np.mean(left_dps**2)) < 1.1 * np.sqrt(np.mean(plain_dps**2))


@pytest.mark.parametrize(("effect", "of_scale"), [(BIAS_DRIFT, False), (SCALE_DRIFT, True)])
def test_a_drift_is_held_where_it_ends_in_what_it_is_a_drift_of(effect: Effect, of_scale: bool) -> None:
    rate_dps, t_s = np.tile([-50.0, 0.0, 50.0, 80.0], 10), 90.0 * np.arange(40.0)
    table = DataSetTable(Path("t.csv"), rate_dps, rate_dps, np.linspace(20.0, 22.0, 40), t_s=t_s)
    model = full_model(means_of(series_of_table(table)))
    law = Law(effect.id, {}, np.zeros((40, 1)))
    per_h, scale_dps = (PPM, 80.0) if of_scale else (MDPS, 1.0)
    held = per_h * scale_dps * t_s[-1] / 3600.0
    assert state_of_laws(model.with_laws(law)) == {
        law.name: pytest.approx((0.0, held) if of_scale else (held, 0.0))
    }


@pytest.mark.parametrize(("effect", "of_scale"), [(BIAS_DRIFT, False), (SCALE_DRIFT, True)])
def test_what_a_drift_of_a_table_leaves_about_its_mean_is_in_the_uncertainty(
    effect: Effect, of_scale: bool
) -> None:
    rate_dps, t_s = np.tile([-50.0, 0.0, 50.0, 80.0], 10), 90.0 * np.arange(40.0)
    grown = (t_s - t_s.mean()) / 3600.0
    size = 100.0 * PPM * rate_dps if of_scale else 8.0 * MDPS * np.ones(40)
    rng = np.random.default_rng(3)
    gyro_dps, temp_c = rate_dps + size * grown + 1e-4 * rng.standard_normal(40), rng.uniform(20.0, 22.0, 40)
    table = DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c, t_s=t_s)
    model = full_model(means_of(series_of_table(table)), memory=False)
    law = Law(effect.id, {"power": 1.0}, ((size / 10.0) * grown)[:, None], from_end=True)
    kept = {"white", *(p.name for p in model.parts if p.block == "surface")}
    fitted = fit_model(model.without([n for n in model.components if n not in kept]).with_laws(law))
    constant, share = left_by_drifts(fitted.model, fitted.solve())
    turning = np.where(rate_dps != 0.0, grown, np.nan)
    if of_scale:
        assert constant == 0.0
        assert np.sqrt(share) == pytest.approx(100.0 * PPM * 80.0 * np.sqrt(np.nanmean(turning**2)), rel=0.05)
    else:
        assert share == 0.0
        assert np.sqrt(constant) == pytest.approx(8.0 * MDPS * np.std(grown), rel=0.05)


def test_a_walk_stands_in_its_mean_and_is_in_the_uncertainty() -> None:
    """Where it ended had been in the file: 20 mdeg/s from its mean here, as a gyro with hysteresis never was again."""
    rate_dps, t_s = np.tile([-50.0, 0.0, 50.0, 80.0], 30), 90.0 * np.arange(120.0)
    rng = np.random.default_rng(3)
    walk_dps = 0.04 * np.sqrt(t_s / t_s[-1]) + np.cumsum(1e-3 * rng.standard_normal(120))
    gyro_dps, temp_c = rate_dps + walk_dps + 2e-4 * rng.standard_normal(120), rng.uniform(20.0, 22.0, 120)
    table = DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c, t_s=t_s)
    model = full_model(means_of(series_of_table(table)), memory=False)
    kept = {"white", "bias walk", *(p.name for p in model.parts if p.block == "surface")}
    fitted = fit_model(model.without([n for n in model.components if n not in kept]))
    naming = SimpleNamespace(fitted=fitted, named=(), unnamed={})
    found = cast(Examination, SimpleNamespace(candidates=(), naming=naming, laws=None, comes_again=0.0))
    left_dps = Compensator(correction(found)).correct(t_s, gyro_dps, temp_c, t_s, None) - rate_dps
    assert abs(np.mean(left_dps)) < 2e-3
    assert walk_dps[-1] - walk_dps.mean() > 0.01
    constant, share = left_by_drifts(fitted.model, fitted.solve())
    assert np.sqrt(constant) == pytest.approx(np.std(walk_dps), rel=0.1)
    assert share == 0.0


@pytest.mark.slow
def test_where_a_drift_has_come_to_is_known_no_better_than_the_drift() -> None:
    """Over drawn noise the bias of the file lies about the truth as it says."""
    rate_dps, t_s = np.tile([-50.0, 0.0, 50.0, 80.0, 20.0], 12), 90.0 * np.arange(60.0)
    drift = 3e-3 * t_s / t_s[-1]
    off = []
    for seed in range(20):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(60)
        gyro = rate_dps + drift + noise
        table = DataSetTable(Path("t.csv"), rate_dps, gyro, np.full(60, 20.0), t_s=t_s)
        means = means_of(series_of_table(table))
        law = Law(BIAS_DRIFT.id, {"power": 1.0}, (MDPS * t_s / 3600.0)[:, None])
        model = full_model(means)
        kept = {"white", *(p.name for p in model.parts if p.block == "surface")}
        fitted = fit_model(model.without([n for n in model.components if n not in kept]).with_laws(law))
        items, total = _items([(1.0, fitted.model, fitted.solve())], 0.0)
        found = _estimate(fitted.model, fitted.solve(), items, total, False, ())
        off.append((found.values[0] - 3e-3) / np.sqrt(found.covariance[0, 0]))
    assert 0.6 < float(np.sqrt(np.mean(np.square(off)))) < 1.5


def test_models_that_differ_are_known_no_better_than_they_differ() -> None:
    rng = np.random.default_rng(5)
    laws = [
        (0.3, np.array([1.0, 2.0]), np.diag([0.1, 0.2])),
        (0.7, np.array([3.0, -1.0]), np.diag([0.3, 0.1])),
    ]
    mean, covariance = mixed(laws)
    draws = np.concatenate(
        [rng.multivariate_normal(at, within, round(100_000 * w)) for w, at, within in laws]
    )
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.03)


def test_the_file_corrects_what_the_model_explains() -> None:
    """A bump in temperature at rest: the surface gives back what the smooth part was freed of."""
    t_s = 60.0 * np.arange(150.0)
    temp_c = 25.0 + 20.0 * np.sin(t_s / 1500.0)
    bias = 0.01 + 4e-4 * temp_c + 0.02 * np.exp(-(((temp_c - 30.0) / 5.0) ** 2))
    noise = 2e-4 * np.random.default_rng(6).standard_normal(t_s.size)
    table = DataSetTable(Path("rest.csv"), np.zeros(t_s.size), bias + noise, temp_c, t_s=t_s)
    fitted = fit_model(full_model(means_of(series_of_table(table))))
    naming = SimpleNamespace(fitted=fitted, named=())
    found = SimpleNamespace(candidates=(), naming=naming, laws=None, comes_again=1.0)
    file = correction(cast(Examination, found))
    left = Compensator(file).correct(t_s, bias, temp_c, t_s - t_s[0], None)
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.std(bias)


@pytest.mark.parametrize("bend", [0.0, 1.5])
def test_what_follows_the_supply_is_corrected_on_another_run(bend: float) -> None:
    """In a straight line, as the law says, or not: what a regulator lets through bends near its drop-out."""

    def lets_through(volt: Floats | float) -> Floats | float:
        return 5e-3 * ((volt - 11.9) + bend * (volt - 11.9) ** 2)

    rng = np.random.default_rng(5)
    t = 30.0 * np.arange(80.0)
    supply = 11.9 + rng.uniform(-0.4, 0.4, t.size)
    gyro = 0.01 + lets_through(supply) + 2e-4 * rng.standard_normal(t.size)
    table = DataSetTable(Path("rest.csv"), np.zeros(t.size), gyro, 25.0 + 5.0 * np.sin(t / 500.0), t_s=t)
    series = series_of_table(table)
    known = {k: why for k, why in series.untestable.items() if k != "supply"}
    found = diagnose(replace(series, supply_v=supply, untestable=known), None, Options(heldout=False))
    assert "supply_voltage" in {e.effect for e in found.effects}
    assert found.improved is not None
    compensator = Compensator(parse_coefficients(found.improved.to_text(), "improved"))
    here = [
        compensator.correct(0.0, 0.01 + lets_through(v), 25.0, supply_v=v)
        for v in (11.5, 11.7, 11.9, 12.1, 12.3)
    ]
    np.testing.assert_allclose(here, 0.0, atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sizes", "center_dps", "form"),
    [
        ((5, 15, 25, 35, 45, 55, 65, 80, 100), 45.0, "Lorentz"),
        ((5, 15, 25, 35, 45, 55, 65, 80, 100), 45.0, "Gauss"),
        ((7, 21, 40, 68, 119, 155), 62.0, "Lorentz"),
    ],
)
def test_a_peak_over_the_rate_is_in_the_file_as_far_as_it_is_known(
    sizes: tuple[float, ...], center_dps: float, form: str
) -> None:
    """Between rates far from each other many peaks are as likely, and the file says how little it knows."""
    rng = np.random.default_rng(11)
    rate = np.tile([*(-s for s in sizes), 0.0, *sizes], 9)
    temp = np.repeat(np.linspace(-10.0, 50.0, 9), 2 * len(sizes) + 1)

    def gyro(rate_dps: Floats, temp_c: Floats) -> Floats:
        squared = ((np.abs(rate_dps) - center_dps) / 8.0) ** 2
        peak = 0.02 / (1.0 + squared) if form == "Lorentz" else 0.02 * 2.0**-squared
        return np.asarray(1.001 * rate_dps + 0.01 + 1e-4 * temp_c + peak)

    noisy = gyro(rate, temp) + 3e-4 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("peak.csv"), rate, noisy, temp, t_s=60.0 * np.arange(rate.size, dtype=np.float64)
    )
    found = diagnose(series_of_table(table), None, Options(heldout=False))
    assert [e.effect for e in found.effects] == ["mechanical_resonance"]
    assert found.improved is not None
    unseen = np.linspace(-0.9 * max(sizes), 0.9 * max(sizes), 181)
    warm = np.full(unseen.size, 20.0)
    out = Compensator(found.improved).evaluate(np.arange(unseen.size) * 1.0, gyro(unseen, warm), warm)
    off = out.rate_dps - unseen
    assert np.sqrt(np.mean((off / out.sigma_dps) ** 2)) < 2.5
    if len(sizes) > 8:
        # Be it one peak or the mean of many that are alike.
        assert np.sqrt(np.mean(off**2)) < 1.5e-4
        assert np.sqrt(np.mean(out.sigma_dps**2)) < 5e-4
    else:
        assert [t.name for t in found.improved.terms].count("mechanical_resonance") > 1
        # A wide low peak between the rates is nearly as likely as the narrow high one that is there.
        own = found.effects[0].parameters
        for name, true in (("amplitude", 20.0), ("center_dps", center_dps), ("width_dps", 8.0)):
            low, high = own[name].interval_95
            assert low <= true <= high
        assert found.surface is not None
        alone = Compensator(found.surface).correct(np.arange(unseen.size) * 1.0, gyro(unseen, warm), warm)
        assert np.mean(off**2) < 0.5 * np.mean((alone - unseen) ** 2)


@pytest.mark.slow
def test_two_peaks_over_the_rate_are_two_and_not_one_between_them() -> None:
    """One of -49 mdeg/s at 58 deg/s had stood for both, beside a curve: 5.5 became 6.5 mdeg/s on another run."""
    rng = np.random.default_rng(7)
    sizes = np.arange(5.0, 94.0, 8.0)
    rate = np.tile([*-sizes, 0.0, *sizes], 9)
    temp = np.repeat([-10.0, 5.0, 20.0, 35.0, 50.0, 35.0, 20.0, 5.0, -10.0], 2 * sizes.size + 1)

    def gyro(rate_dps: Floats, temp_c: Floats) -> Floats:
        size = np.abs(rate_dps)
        peaks = 0.015 * np.exp(-0.5 * ((size - 30.0) / 6.0) ** 2) + 0.02 / (1.0 + ((size - 70.0) / 5.0) ** 2)
        return np.asarray(1.001 * rate_dps + 0.01 + 1e-4 * temp_c + peaks)

    noisy = gyro(rate, temp) + 1e-3 * rng.standard_normal(rate.size)
    table = DataSetTable(Path("peaks.csv"), rate, noisy, temp, t_s=40.0 * np.arange(float(rate.size)))
    found = diagnose(series_of_table(table), None, Options(heldout=False))
    assert [e.effect for e in found.effects] == ["mechanical_resonance"]
    low, high = found.effects[0].parameters["center_dps"].interval_95
    assert low < 70.0 < high
    assert found.improved is not None
    unseen, warm = np.linspace(-90.0, 90.0, 181), np.full(181, 12.0)
    off = Compensator(found.improved).correct(np.arange(181.0), gyro(unseen, warm), warm) - unseen
    assert np.sqrt(np.mean(off**2)) < 1e-3


def _of_two(models: tuple[tuple[float, Fitted], ...]) -> Examination:
    """A table that is about as well explained by either of some models."""
    fitted = models[0][1]
    laws = laws_of(fitted.model.means, surface_of(fitted.model, fitted.solve()))
    naming = SimpleNamespace(fitted=fitted, named=[], unnamed={})
    near = tuple((w, Candidate(None, (), f, 0.0)) for w, f in models)
    found = SimpleNamespace(candidates=near, naming=naming, laws=laws, comes_again=1.0, model=fitted.model)
    return cast(Examination, found)


def test_models_of_the_output_and_of_the_input_have_one_file() -> None:
    """Coefficients of the one are not those of the other: mixed as they stood, the file left five times what either left."""
    c = np.zeros(SHAPE)
    c[0, 0], c[1, 0], c[1, 2], c[3, 0] = 0.05, 0.1, -0.27, -0.44
    bent = Surface(c, 0.0, 100.0, 20.0, 30.0, "input")
    rng = np.random.default_rng(2)
    rate, temp = (x.ravel() for x in np.meshgrid(np.linspace(-100.0, 100.0, 13), np.linspace(-10.0, 50.0, 7)))
    gyro = rate + bent.error_dps(rate, temp) + 5e-4 * rng.standard_normal(rate.size)
    series = series_of_table(DataSetTable(Path("both.csv"), rate, gyro, temp))
    model = full_model(means_of(series), memory=False)
    of_input = fit_model(model)
    of_output = of_input.refit(model.directed("output", model.bend_of(of_input.solve())))
    rest = np.std(of_output.solve().left)
    file = correction(_of_two(((0.6, of_input), (0.4, of_output))))
    assert file.surface.direction == "input"
    left = left_by(file, series)
    assert np.std(left) < 1.2 * max(rest, np.std(of_input.solve().left))


def test_laws_beside_which_the_surface_is_another_have_one_file() -> None:
    """Beside a sine of a small phase the cubic is a degree per second: over the output the file left ten times the noise."""
    rng = np.random.default_rng(5)
    sizes = np.array([0.4, 1.5, 4.5, 15.0, 45.0, 90.0, 135.0])
    rates = np.concatenate([-sizes[::-1], [0.0], sizes])
    rate, temp = (x.ravel() for x in np.meshgrid(rates, np.linspace(-10.0, 50.0, 5)))
    gyro = 150.0 * np.tanh(rate / 150.0) * 2e-4 + rate * (1.0 - 2e-4) + 2e-5 * rng.standard_normal(rate.size)
    series = series_of_table(DataSetTable(Path("tanh.csv"), rate, gyro, temp))
    full = full_model(means_of(series), memory=False)
    kept = {"white", *(p.name for p in full.parts if p.block == "surface")}
    plain = fit_model(full.without([n for n in full.components if n not in kept]))
    laws = laws_of(plain.model.means, surface_of(plain.model, plain.solve()))
    models = []
    for effect, shape in (
        (SAGNAC_SINE, {"phase_rad_per_dps": 1.6e-3}),
        (RATE_ORDER, {"order": 5.0, "scale_dps": 135.0}),
    ):
        fitted = plain.refit(plain.model.with_laws(Law(effect.id, shape, laws.at(effect, shape))))
        bend = fitted.model.bend_of(fitted.solve())
        models.append(around_itself(fitted.refit(fitted.model.directed("output", bend))))
    files = [correction(_of_two(((1.0, fitted),))) for fitted in models]
    assert all(file.surface.direction == "output" for file in files)
    both = left_by(correction(_of_two(((0.5, models[0]), (0.5, models[1])))), series)
    assert np.std(both) < 1.2 * max(np.std(left_by(file, series)) for file in files)


@pytest.mark.parametrize(("weight", "written"), [(0.5, True), (1e-6, False)])
def test_what_an_unlikely_model_alone_holds_is_no_term(weight: float, written: bool) -> None:
    """A law that adds several times the noise, in a model of half the weight and in one of a millionth."""
    n = 120
    temp_c, rate_dps = (
        20.0 + 5.0 * np.sin(np.linspace(0.0, 12.0, n)),
        np.tile([-50.0, -20.0, 20.0, 50.0], n // 4),
    )
    follows = MDPS * np.gradient(temp_c)
    gyro_dps = rate_dps + 20.0 * follows + 1e-3 * np.random.default_rng(5).standard_normal(n)
    table = DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c, t_s=60.0 * np.arange(n, dtype=np.float64))
    plain = _of_temperature(table)
    other = plain.refit(plain.model.with_laws(Law(SHUPE.id, {}, follows[:, None])))
    models = [(1.0 - weight, plain.model, plain.solve()), (weight, other.model, other.solve())]
    items, _ = _items(models, 0.0)
    assert any(item.law is not None and item.law.effect == SHUPE.id for item in items) is written
