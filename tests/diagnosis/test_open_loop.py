"""The sine of an open loop behind errors of single rates: its cubic is seen, its higher orders follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyrocal.diagnosis.answer.correction import correction
from gyrocal.diagnosis.engine import _before_sine, diagnose
from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.laws.at_rows import laws_of
from gyrocal.diagnosis.laws.in_place import Named
from gyrocal.diagnosis.model.layers import Law, OpenLoop, full_model, surface_of
from gyrocal.diagnosis.names.naming import Naming
from gyrocal.diagnosis.remarks import Said
from gyrocal.diagnosis.result import NamedEffect
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps import open_loop
from gyrocal.diagnosis.sweeps.changes import Change
from gyrocal.diagnosis.sweeps.coil import table_search
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.rate import SATURATION
from gyrocal.records.datasets import DataSetTable
from gyrocal.report.remarks import remark_words

_PHASE = 0.008


def _sweeps(
    seed: int,
    front: str = "sine",
    errors_ppm: float = 400.0,
    own: float = 0.04,
    before: float = 0.0,
    behind: float = 0.0,
) -> DataSetTable:
    """Six sweeps up and down 14 sizes of rate while the temperature drifts; the gyro's own cubic is a share of the sine's.

    From the middle on the scale factor is another: by a share of the rate, or of what comes out of the sine.
    """
    rng = np.random.default_rng(seed)
    sizes = 7.2 * np.arange(1.0, 15.0)
    sweep = np.concatenate([[0.0], sizes, [0.0], -sizes])
    rate = np.tile(sweep, 6)
    t_s = 20.0 * np.arange(float(rate.size))
    temp = 38.0 + 5.0 * np.sin(2.0 * np.pi * t_s / 2500.0) + t_s / 1500.0
    warm = (temp - 40.0) / 8.0
    table = rng.normal(0.0, 1e-6 * errors_ppm, sizes.size)
    off = np.interp(np.abs(rate), np.concatenate([[0.0], sizes]), np.concatenate([[0.0], table]))
    cubic_dps = -((_PHASE * 100.8) ** 2) * 100.8 / 6.0
    surface = 0.05 + 0.05 * warm + rate / 100.8 * (0.3 * warm + 0.1 * warm**2)
    surface = surface + own * cubic_dps * (rate / 100.8) ** 3
    later = np.arange(rate.size) >= rate.size // 2
    true = rate * (1.0 + off) * (1.0 + before * later)
    bent = {
        "sine": np.sin(_PHASE * true) / _PHASE,
        "cubic": true + cubic_dps * (true / 100.8) ** 3,
        "expanding": true - cubic_dps * (true / 100.8) ** 3,
    }[front]
    bent = bent * (1.0 + behind * later)
    gyro = bent + surface + 4e-3 * rng.standard_normal(rate.size)
    return DataSetTable(Path("sweeps.csv"), rate, gyro, temp, t_s=t_s)


def _left(found: Examination) -> float:
    """Error of the file on a run without noise or errors of the table, deg/s rms."""
    again = _sweeps(1, errors_ppm=0.0)
    assert again.t_s is not None
    rate = Compensator(correction(found)).correct(again.t_s, again.gyro_dps, again.temp_c)
    return float(np.sqrt(np.mean((rate - again.rate_dps) ** 2)))


def _weight_of_sine(found: Examination) -> float:
    return sum(w for w, c in found.candidates if c.is_open_loop)


@pytest.fixture(scope="module", params=[1, 2])
def tables(request: pytest.FixtureRequest) -> list[Examination]:
    return [examine(series_of_table(_sweeps(seed)), 1e-3) for seed in range(10, 10 + request.param)]


@pytest.mark.slow
def test_the_phase_is_in_its_interval_and_the_file_is_better_than_one_with_shapes(
    tables: list[Examination],
) -> None:
    assert all(_weight_of_sine(found) == pytest.approx(1.0) for found in tables)
    ratios, far = [], []
    for found in tables:
        shapes = replace(found, candidates=((1.0, found.ranked[0]),))
        ratios.append(_left(found) / _left(shapes))
        (sine,) = (t for t in correction(found).terms if getattr(t, "effect", "") == "sagnac_sine")
        phase = sine.parameters["phase_rad_per_dps"]  # type: ignore[union-attr]
        amplitude = sine.parameters["amplitude"]  # type: ignore[union-attr]
        assert (amplitude["value"], amplitude["std"]) == (1.0, 0.0)
        far.append((phase["value"] - _PHASE) / phase["std"])
    assert np.exp(np.mean(np.log(ratios))) < 0.9
    assert np.max(np.abs(far)) < 2.5


@pytest.mark.slow
def test_what_is_not_known_of_the_phase_is_in_the_sigma_of_the_corrected_rate(
    tables: list[Examination],
) -> None:
    again = _sweeps(1, errors_ppm=0.0)
    assert again.t_s is not None
    squares = []
    for found in tables:
        file = Compensator(correction(found))
        answer = file.evaluate(again.t_s, again.gyro_dps, again.temp_c, again.t_s)
        squares.append(
            ((answer.rate_dps - again.rate_dps) / answer.sigma_dps)[np.abs(again.rate_dps) > 80.0] ** 2
        )
    assert 0.1 < float(np.mean(squares)) < 2.5


@pytest.mark.slow
def test_a_cubic_that_no_sine_has_is_none() -> None:
    found = examine(series_of_table(_sweeps(20, "expanding")), 1e-3)
    assert found.candidates
    assert _weight_of_sine(found) == 0.0


@pytest.mark.slow
def test_a_cubic_of_less_than_a_percent_is_not_taken_for_a_sines() -> None:
    found = examine(series_of_table(_sweeps(22, "cubic", own=-0.95)), 1e-3)
    assert found.candidates
    assert _weight_of_sine(found) == 0.0


@pytest.mark.slow
def test_a_cubic_without_higher_orders_is_no_sine_where_the_table_is_exact() -> None:
    found = examine(series_of_table(_sweeps(21, "cubic", errors_ppm=10.0, own=0.0)), 1e-3)
    assert _weight_of_sine(found) == 0.0


@pytest.mark.slow
def test_a_sine_in_the_file_is_said_with_its_name_or_without() -> None:
    answer = diagnose(_sweeps(10))
    assert answer.improved is not None
    said = [note for note in answer.notes if not isinstance(note, str) and note.said is Said.SINE_WRITTEN]
    assert len(said) == 1


def test_prior_odds_of_a_sine() -> None:
    """Log-uniform in the phase, the cubic has half the width that log-uniform cubics of two signs have on a scale two decades longer; three in four are open loops."""
    low, high = 0.25, 1.45
    cubics = np.log((high / low) ** 2)
    assert open_loop.in_favour() == pytest.approx(np.log(3.0 * 2.0 * (cubics + np.log(100.0)) / cubics))


@pytest.mark.slow
def test_the_sine_stands_whole_in_the_model(tables: list[Examination]) -> None:
    (_, best), *_ = tables[0].candidates
    sine = best.fitted.model.open_loop
    assert isinstance(sine, OpenLoop)
    rate = best.fitted.model.means.rate_dps
    k = sine.phase_rad_per_dps
    np.testing.assert_allclose(sine.sine_dps, np.sin(k * rate) / k - rate, atol=1e-12)
    np.testing.assert_allclose(sine.by_phase[:, 0], rate * np.cos(k * rate) - np.sin(k * rate) / k, atol=2e-3)


@pytest.mark.slow
def test_a_file_with_the_sine_itself_errs_as_the_straight_line_in_its_phase_did(
    tables: list[Examination],
) -> None:
    """The cubic goes with the square of the phase, so that of another phase it would be off by far more than is open."""
    (_, best), *_ = tables[0].candidates
    model, solution = best.fitted.model, best.fitted.solve()
    sine = model.open_loop
    assert isinstance(sine, OpenLoop)
    scale = model.basis.frame.rate_scale_dps
    phase = sine.phase_rad_per_dps * 1.06
    back, slope = open_loop.given_back(sine, phase, scale)
    u = np.linspace(-1.0, 1.0, 41)

    def put_out(k: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.asarray(np.sin(k * scale * u) / k - scale * u)

    step = 1e-7
    line = (put_out(sine.phase_rad_per_dps + step) - put_out(sine.phase_rad_per_dps)) / step
    straight = put_out(sine.phase_rad_per_dps) + (phase - sine.phase_rad_per_dps) * line
    powers = np.vander(u, 4, increasing=True)
    assert np.max(np.abs(put_out(phase) - straight)) > 0.03
    assert np.max(np.abs(put_out(phase) - powers @ back - straight)) < 0.003
    here = (put_out(phase + step) - put_out(phase)) / step
    assert np.max(np.abs(here - powers @ slope - line)) < 0.05 * np.max(np.abs(here - line))
    assert "phase" in solution.amplitudes


@pytest.mark.parametrize(("where", "size"), [("before", 1000.0), ("behind", 932.0)])
def test_a_step_of_the_scale_factor_is_told_to_be_before_the_sine_or_behind_it(
    where: str, size: float
) -> None:
    """Behind the sine a step of 0.1 % adds as the output does, before it by the sine's slope: less at the largest rates.

    A share of the output is less than one of the rate: of a sine of 0.8 rad 0.93 of it, by least squares.
    """
    table = _sweeps(3, own=0.0, before=1e-3 * (where == "before"), behind=1e-3 * (where == "behind"))
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    first = search.fit(None, (), None)
    slope = open_loop.slope_of(first)
    assert slope is not None
    assert slope == pytest.approx(np.cos(_PHASE * table.rate_dps), abs=0.05)
    step = (Change("scale_step", float(table.rate_dps.size // 2)),)
    plain, felt = search.fit(None, step, first), search.before_sine(slope).fit(None, step, first)
    assert (felt.score < plain.score - 3.0) is (where == "before")
    likelier = min(plain, felt, key=lambda c: c.score).fitted
    amplitudes = likelier.solve().amplitudes
    (size_ppm,) = (float(x[0]) for name, x in amplitudes.items() if "scale_step" in name)
    assert size_ppm == pytest.approx(size, abs=60.0)
    found = cast(Examination, SimpleNamespace(model=likelier.model))
    told = _before_sine(found, [cast(NamedEffect, SimpleNamespace(effect="scale_step"))])
    said = [remark_words(remark) for remark in told]
    assert bool(said) is (where == "before")
    assert all("at 100.8 deg/s its figures count 0.6" in text for text in said)


def test_where_the_models_have_the_sine_no_gain_that_rises_has_its_name() -> None:
    """A knee at the end of the range follows the fifth order of a sine, with a sign that no saturation has."""
    table = _sweeps(4, errors_ppm=0.0, own=0.0)
    search = table_search(full_model(means_of(series_of_table(table)), memory=False))
    first = search.fit(None, (), None)
    laws = laws_of(search.base.means, surface_of(first.fitted.model, first.fitted.solve()))
    shape = {"knee_dps": 80.0, "softness_dps": 4.0}
    knee = Law("saturation", shape, laws.at(SATURATION, shape))
    plain = first.fitted.model.without(first.fitted.model.of_block("odd rate"))
    fitted = first.fitted.refit(plain.with_laws(knee))
    named = (Named(knee, "odd rate", 30.0, 1.0, {}, 12),)
    near = [(1.0, c) for c in open_loop.with_open_loop([first])]
    told = open_loop.told_as_sine(Naming(fitted, named), laws, near)
    (sine,) = told.named
    assert sine.law.effect == "sagnac_sine"
    assert sine.law.shape["phase_rad_per_dps"] == pytest.approx(_PHASE, rel=0.03)
    assert told.fitted.nll < fitted.nll - 10.0
    other = (replace(named[0], block="even rate"),)
    assert open_loop.told_as_sine(Naming(fitted, other), laws, near).named == other
