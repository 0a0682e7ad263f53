"""Errors of a few rates that are far larger than those of the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.model.layers import Fitted, Model, full_model, surface_of
from gyrocal.diagnosis.model.parts import EACH_RATE
from gyrocal.diagnosis.model.rate_errors import largest, toll, with_tails
from gyrocal.diagnosis.model.starts import fit_anyhow
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]

_SIZES = np.linspace(5.0, 100.0, 20)


def fitted_to(errors: Floats, seed: int) -> tuple[Model, Fitted]:
    """Sweeps at five temperatures, both ways, of a gyro without error on a table with these errors, as shares of the rate."""
    rng = np.random.default_rng(seed)
    rate = np.tile(np.concatenate([_SIZES, -_SIZES]), 5)
    temp = np.repeat(np.linspace(5.0, 45.0, 5), rate.size // 5) + 0.01 * rng.standard_normal(rate.size)
    gyro = rate * (1.0 + np.tile(errors, 10)) + 1e-3 * rng.standard_normal(rate.size)
    table = DataSetTable(
        Path("sweeps.csv"), rate, gyro, temp, t_s=60.0 * np.arange(rate.size, dtype=np.float64)
    )
    full = full_model(means_of(series_of_table(table)))
    return full, fit_anyhow(full)


def of_few(size: float) -> Floats:
    errors = np.zeros(_SIZES.size)
    errors[[7, 14]] = size, -0.7 * size
    return errors


def test_toll_is_that_of_the_law_of_the_errors() -> None:
    """Of an error that is known the normal law with its own scale, and what the scale costs, is Cauchy's."""
    errors = np.array([0.0, 0.3, 1.0, 5.0, 100.0])
    scales = np.sqrt(0.5 * (1.0 + errors**2))
    nats = -stats.norm.logpdf(errors, scale=scales) + toll(errors**2)
    np.testing.assert_allclose(nats, -stats.cauchy.logpdf(errors), rtol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_errors_of_a_few_rates_do_not_bend_the_surface(seed: int) -> None:
    full, plain = fitted_to(of_few(3e-4), seed)
    found, tailed = with_tails(full, plain)
    assert tailed.nll < plain.nll - 3.0
    assert found.components[EACH_RATE] is tailed.model.components[EACH_RATE]
    rates = np.linspace(-100.0, 100.0, 81)

    def off_dps(fitted: Fitted) -> float:
        # Of all that stays with the gyro, at rates between those of the record, too.
        solution = fitted.solve()
        error = surface_of(fitted.model, solution).error_dps(rates, np.full(rates.size, 25.0))
        return float(np.sqrt(np.mean(error**2)))

    assert off_dps(tailed) < 0.5 * off_dps(plain)
    (first, second, third) = largest(tailed)
    assert [first[0], second[0]] == pytest.approx([40.0, 75.0])
    assert abs(first[1] - 300.0) < 4.0 * first[2] < 100.0
    assert abs(second[1] + 210.0) < 4.0 * second[2] < 100.0
    assert abs(third[1]) < 4.0 * third[2]


@pytest.mark.parametrize("seed", range(3))
def test_errors_of_one_size_keep_one_variance(seed: int) -> None:
    errors = 2e-4 * np.random.default_rng(100 + seed).standard_normal(_SIZES.size)
    full, plain = fitted_to(errors, seed)
    found, same = with_tails(full, plain)
    assert same is plain
    assert found.components[EACH_RATE] is full.components[EACH_RATE]


def test_without_errors_of_each_rate_nothing_is_done() -> None:
    full, plain = fitted_to(of_few(0.0), 0)
    less = full.without([EACH_RATE])
    alone = plain.refit(plain.model.without([EACH_RATE]))
    assert with_tails(less, alone) == (less, alone)


def of_sizes(size: Floats, odd_dps: Floats, seed: int) -> Examination:
    """What a table of rest and a few sizes of the rate, both ways at six temperatures, says of an odd error at each."""
    rng = np.random.default_rng(seed)
    rate, odd = (np.tile(np.concatenate([x, -x, [0.0]]), 6) for x in (size, odd_dps))
    temp = np.repeat(np.linspace(0.0, 50.0, 6), rate.size // 6) + 0.01 * rng.standard_normal(rate.size)
    gyro = rate + odd + 1e-3 * rng.standard_normal(rate.size)
    t_s = 30.0 * np.arange(rate.size, dtype=np.float64)
    return examine(series_of_table(DataSetTable(Path("few.csv"), rate, gyro, temp, t_s=t_s)), 0.01)


@pytest.mark.parametrize(("sizes", "seed"), [(3, 0), (4, 5), (5, 7)])
def test_errors_of_a_few_sizes_of_the_rate_are_no_law_that_goes_through_them(sizes: int, seed: int) -> None:
    """Of ten such tables of each of these numbers of sizes five, one and one had a dead zone, an order and a saturation."""
    size = np.linspace(20.0 / sizes, 20.0, sizes)
    errors = 2e-3 * np.random.default_rng(100 + seed).standard_normal(sizes)
    assert of_sizes(size, size * errors, seed).naming.named == ()


def test_one_number_that_is_odd_in_the_rate_is_no_direction_of_the_fit() -> None:
    """A surface of the input fits three sizes of a sine well, and "cubic in the input" had been said of it."""
    size = np.array([26.0, 53.0, 80.0])
    found = of_sizes(size, np.sin(0.008 * size) / 0.008 - size, 1)
    assert found.naming.input_gain > 100.0
    assert not found.of_the_input


def test_an_output_of_zero_where_the_table_turns_is_a_dead_zone_at_any_number_of_sizes() -> None:
    """No table errs by a hundred per cent, or by one."""
    (named,) = of_sizes(np.array([0.1, 20.0, 50.0]), np.array([-0.1, 0.0, 0.0]), 1).naming.named
    assert named.law.effect == "dead_zone"
