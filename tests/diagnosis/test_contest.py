"""Laws against each other for a block of smooth parts."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.laws.at_rows import effects_of, laws_of
from gyrocal.diagnosis.laws.contest import Winner, _evidence, _gain, _seen, becomes_another, best_law
from gyrocal.diagnosis.laws.in_place import beyond_chance
from gyrocal.diagnosis.model.blocks import evidence
from gyrocal.diagnosis.model.layers import Law, full_model, surface_of
from gyrocal.diagnosis.model.starts import alive, fit_anyhow
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.physics.catalogue import find_effect
from gyrocal.records.datasets import DataSetTable


def test_a_law_of_more_shapes_has_to_explain_more() -> None:
    """A rival is as much worse as its fit is, beside the logarithms of the roots of how many shapes either had."""
    t_s = 60.0 * np.arange(120.0)
    temp = 25.0 + 12.0 * np.sin(t_s / 900.0)
    late = np.interp(t_s - 200.0, t_s, temp)
    gyro = 0.01 + 4e-4 * (late - temp) + 3e-4 * np.random.default_rng(1).standard_normal(t_s.size)
    series = series_of_table(DataSetTable(Path("rest.csv"), np.zeros(t_s.size), gyro, temp, t_s=t_s))
    fitted = alive(fit_anyhow(full_model(means_of(series))))
    laws = laws_of(fitted.model.means, surface_of(fitted.model, fitted.solve()))
    (block,) = {b for b in fitted.model.blocks.values() if b == "memory"}
    without = evidence(fitted, block)[1]
    trials = [t for e in effects_of(block) for t in laws.trials(e)]

    def won(beside: str = "") -> Winner:
        left = [t for t in trials if t.effect.id != beside]
        found = best_law(fitted, without, block, left, laws)
        assert found is not None
        return found

    first = won()
    second = won(first.effect.id)
    assert second.shapes != first.shapes
    worse = second.fitted.nll - first.fitted.nll
    worse += 0.5 * float(np.log(second.shapes / first.shapes))
    worse += first.effect.search.prior_nats - second.effect.search.prior_nats
    assert first.rivals[second.effect.id] == pytest.approx(worse, abs=1e-6)


def test_what_as_many_parameters_take_of_any_curve_is_no_evidence_for_a_law() -> None:
    """Five sizes of rate leave a cubic three differences: of three numbers two parameters take two thirds by chance."""
    rate = np.tile(np.linspace(-100.0, 100.0, 11), 5)
    temp = np.repeat(np.linspace(-10.0, 50.0, 5), 11)
    gyro = rate + 1e-3 * np.random.default_rng(1).standard_normal(rate.size)
    fitted = alive(
        fit_anyhow(full_model(means_of(series_of_table(DataSetTable(Path("r.csv"), rate, gyro, temp)))))
    )
    laws = laws_of(fitted.model.means, surface_of(fitted.model, fitted.solve()))
    unit = np.ones((len(fitted.model.means), 1))
    sine = Law("sagnac_sine", {"phase_rad_per_dps": 0.005}, unit)
    knee = Law("saturation", {"knee_dps": 60.0, "softness_dps": 0.0}, unit)
    asymmetry = Law("scale_asymmetry", {}, unit)
    assert beyond_chance(2.0 / 3.0, [sine], "odd rate", laws) == pytest.approx(0.0)
    assert beyond_chance(0.9, [sine], "odd rate", laws) == pytest.approx(0.7)
    assert beyond_chance(0.75, [asymmetry], "even rate", laws) == pytest.approx(2.0 / 3.0)
    assert beyond_chance(1.0, [sine, knee], "odd rate", laws) == 0.0
    # What goes by the temperature or by time has more than some numbers to fit.
    assert beyond_chance(0.6, [sine], "memory", laws) == 0.6


def test_the_evidence_of_many_pairs_at_once_is_that_of_each() -> None:
    rng = np.random.default_rng(5)
    columns, factor, y = rng.standard_normal((30, 6)), rng.standard_normal((30, 30)), rng.standard_normal(30)
    p = np.asarray(np.linalg.inv(factor @ factor.T + np.eye(30)), dtype=np.float64)
    pairs = np.array(list(combinations(range(6), 2)))
    information, pull = _seen(columns, p @ y, p)
    together = _evidence(information[pairs[:, :, None], pairs[:, None, :]], pull[pairs], 2.0)
    each = [_gain(columns[:, pair], p @ y, p, 2.0) for pair in pairs]
    assert together == pytest.approx(each, rel=1e-10)
    # Of one covariance more: log N(y; 0, V + 2 x x') - log N(y; 0, V), V the inverse of p.
    x = columns[:, pairs[0]] / np.sqrt(np.mean(columns[:, pairs[0]] ** 2, axis=0))
    v = np.linalg.inv(p)
    nlls = [0.5 * (y @ np.linalg.solve(c, y) + np.linalg.slogdet(c)[1]) for c in (v, v + 2.0 * x @ x.T)]
    assert each[0] == pytest.approx(nlls[0] - nlls[1], abs=1e-8)


def test_an_even_order_of_the_rate_is_no_corner_between_two_sides() -> None:
    """The softer a corner, the more it is like a fourth order, which had its name on open loops of a third of a radian."""
    rng = np.random.default_rng(8)
    rate = np.tile(np.linspace(-100.0, 100.0, 21), 8)
    temp = np.repeat(25.0 + 10.0 * np.sin(np.arange(8.0)), 21)
    gyro = rate + 0.02 * (rate / 100.0) ** 4 + 1e-3 * rng.standard_normal(rate.size)
    table = DataSetTable(Path("fourth.csv"), rate, gyro, temp, t_s=60.0 * np.arange(float(rate.size)))
    model = full_model(means_of(series_of_table(table)), memory=False)
    fitted = fit_anyhow(model)
    laws = laws_of(model.means, surface_of(fitted.model, fitted.solve()))
    without = fitted.refit(fitted.model.without(fitted.model.of_block("even rate")))
    found = best_law(fitted, without, "even rate", laws.of_one_amplitude("even rate"), laws)
    assert found is not None
    assert found.effect.id == "rate_order"
    asymmetry = find_effect("scale_asymmetry")
    ends = [becomes_another(asymmetry, {"softness_dps": x}, laws) for x in (0.0, 12.0, 12.5)]
    assert ends == [False, False, True]
