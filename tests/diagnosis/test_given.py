"""Whether a given surface is still that of the gyro, and whether bias is one of the temperature alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyrocal.diagnosis.answer.at_rest import temperature_alone
from gyrocal.diagnosis.answer.given import surface_change, with_terms
from gyrocal.diagnosis.examine import Examination, examine
from gyrocal.diagnosis.remarks import Said
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.surface import SHAPE, Surface
from gyrocal.physics.terms import Term
from gyrocal.records.datasets import DataSetTable

_WHITE_DPS = 1e-4


def sweep() -> Examination:
    """As much of an examination as the question for a change asks for: rows, and their noise."""
    rate, temp = np.tile(np.linspace(-50.0, 50.0, 11), 6), np.repeat(np.linspace(10.0, 40.0, 6), 11)
    means = means_of(
        series_of_table(DataSetTable(Path("sweep.csv"), rate, rate, temp, t_s=30.0 * np.arange(66.0)))
    )
    whole = SimpleNamespace(
        model=SimpleNamespace(means=means), fit=SimpleNamespace(variance={"white": _WHITE_DPS**2})
    )
    return cast(Examination, SimpleNamespace(whole=whole))


def file(bias_dps: float, std_dps: float) -> Coefficients:
    """A surface with a bias alone, each coefficient of which is known so well."""
    bias = np.zeros(SHAPE)
    bias[0, 0] = bias_dps
    return Coefficients(
        sensor={"model": "made up"},
        surface=Surface(bias, 0.0, 50.0, 25.0, 15.0),
        covariance_dps2=std_dps**2 * np.eye(12),
        valid=Valid((-50.0, 50.0), (10.0, 40.0)),
    )


@pytest.mark.parametrize("unsure", ["given", "fitted"])
def test_a_surface_has_changed_where_neither_covariance_allows_for_it(unsure: str) -> None:
    change = surface_change(sweep(), file(1e-3, 1e-6), file(0.0, 1e-6))
    assert change is not None
    assert change.coordinate == "rate"
    assert change.rms_dps == pytest.approx(1e-3)
    stds = {"given": 1e-6, "fitted": 1e-6, unsure: 1e-3}
    assert surface_change(sweep(), file(1e-3, stds["given"]), file(0.0, stds["fitted"])) is None


@pytest.mark.parametrize(("stds", "said"), [(5.5, False), (8.0, True)])
def test_a_change_must_be_beyond_doubt(stds: float, said: bool) -> None:
    """Chi-square of twelve: 30 has p = 3e-3, 64 has 4e-9."""
    assert (surface_change(sweep(), file(1e-3, 1e-3 / stds), file(0.0, 1e-9)) is not None) == said


def test_a_change_below_the_noise_of_a_data_set_is_not_worth_a_word() -> None:
    assert surface_change(sweep(), file(0.9 * _WHITE_DPS, 1e-9), file(0.0, 1e-9)) is None
    assert surface_change(sweep(), file(1.1 * _WHITE_DPS, 1e-9), file(0.0, 1e-9)) is not None


@pytest.mark.parametrize(
    ("late_s", "reach_c", "said"),
    [(200.0, 12.0, Said.NOT_TEMPERATURE_ALONE), (0.0, 12.0, Said.TEMPERATURE_ALONE), (200.0, 4.0, None)],
)
def test_whether_a_bias_is_one_of_the_temperature_alone(
    late_s: float, reach_c: float, said: Said | None
) -> None:
    """At rest through cycles of 900 s: a bias that follows late differs between heating and cooling."""
    t_s = 30.0 * np.arange(400.0)
    temp = 25.0 + reach_c * np.sin(t_s / 900.0)
    behind = np.sin((t_s - late_s) / 900.0) - np.sin(t_s / 900.0)
    gyro = 0.01 + 1e-4 * (temp - 25.0) + 5e-3 * behind
    gyro = gyro + 3e-4 * np.random.default_rng(1).standard_normal(t_s.size)
    found = examine(
        series_of_table(DataSetTable(Path("rest.csv"), np.zeros(t_s.size), gyro, temp, t_s=t_s)), 0.01
    )
    remarks = temperature_alone(found)
    assert [r.said for r in remarks] == ([] if said is None else [said])
    if said is Said.NOT_TEMPERATURE_ALONE:
        assert remarks[0].facts["left_mdps"] == pytest.approx(1e3 * float(np.std(5e-3 * behind)), rel=0.3)
        # The lag's part at a quarter of a cycle, up less down; towards either end the branches meet.
        widest = 2e3 * 5e-3 * float(np.sin(late_s / 900.0))
        assert 0.5 * widest < remarks[0].facts["branches_mdps"] < widest


def test_the_terms_of_a_given_file_stay_in_the_new_one() -> None:
    """They are taken off before anything is looked for, and had been lost with it."""
    parameters = {
        "amplitude": {"value": 200.0, "std": 10.0, "unit": "ppm", "covariance": [0.0] * 12 + [1e-8]}
    }
    given = replace(file(1e-3, 1e-6), terms=(Term("scale_asymmetry", parameters, True),))
    both = with_terms(with_terms(file(0.0, 1e-6), given), given)
    assert [t.name for t in both.terms] == ["scale_asymmetry"] * 2
    once = with_terms(file(0.0, 1e-6), given)
    assert once.correct(50.0, 25.0) == pytest.approx(given.correct(50.0, 25.0) + 1e-3, abs=1e-6)
    sigma_dps = Compensator(once).evaluate(np.zeros(1), np.array([50.0]), np.array([25.0])).sigma_dps
    assert sigma_dps[0] == pytest.approx(10e-6 * 50.0, rel=0.02)
