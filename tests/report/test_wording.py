"""Words of the page: no double signs, no Python in the provenance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.material import gather
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.surface import SHAPE, Direction, Surface
from gyrocal.report.build import plain_text
from gyrocal.report.tables import coefficient_table


@pytest.mark.parametrize(("center", "said"), [(-0.5, "(gyro + 0.5 deg/s)"), (0.5, "(gyro − 0.5 deg/s)")])
def test_the_formula_has_no_double_sign(center: float, said: str) -> None:
    surface = Surface(np.zeros(SHAPE), center, 100.0, 20.0, 30.0)
    made = Coefficients({"model": "m"}, surface, np.zeros((12, 12)), Valid((-100.0, 100.0), (0.0, 40.0)))
    assert said in coefficient_table(made).note


@pytest.mark.parametrize("direction", ["output", "input"])
def test_the_formula_gives_the_corrected_rate(direction: Direction) -> None:
    """Of a surface of the true rate the output is the rate and its error."""
    coefficients = np.zeros(SHAPE)
    coefficients[1, 0] = 2.0
    surface = Surface(coefficients, 0.0, 100.0, 20.0, 30.0, direction)
    made = Coefficients({"model": "m"}, surface, np.zeros((12, 12)), Valid((-100.0, 100.0), (0.0, 40.0)))
    corrected = Compensator(made).correct(0.0, 51.0, 20.0)
    note = coefficient_table(made).note
    if direction == "output":
        assert "u = (gyro − 0 deg/s)" in note
        assert "corrected = gyro − error" in note
        assert corrected == pytest.approx(51.0 - 2.0 * 0.51)
    else:
        assert "u = (true rate − 0 deg/s)" in note
        assert "gyro = true rate + error" in note
        assert corrected + 2.0 * corrected / 100.0 == pytest.approx(51.0)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"bad_status": 2, "non_finite": 0}, "bad status 2, non finite 0"),
        ([3, 7], "3, 7"),
        (True, "yes"),
        ("gls", "gls"),
        (1.5, "1.5"),
    ],
)
def test_provenance_reads_as_words(value: object, said: str) -> None:
    assert plain_text(value) == said


def test_too_few_data_sets_are_refused_in_a_sentence(tmp_path: Path) -> None:
    surface = Surface(np.zeros(SHAPE), 0.0, 100.0, 20.0, 30.0)
    made = Coefficients({"model": "m"}, surface, np.zeros((12, 12)), Valid((-100.0, 100.0), (0.0, 40.0)))
    (tmp_path / "c.json").write_text(made.to_text(), encoding="utf-8")
    (tmp_path / "t.csv").write_text("rate_dps,gyro_dps,temp_c\n0,0.1,20\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"t\.csv: holds 1 data sets, too few to judge 3 terms by"):
        gather(tmp_path / "t.csv", tmp_path / "c.json", None, False, lambda share, what: None)


def test_intervals_of_coefficients_are_those_of_the_fit(tmp_path: Path) -> None:
    surface = Surface(np.full(SHAPE, 1.0), 0.0, 100.0, 20.0, 30.0)
    made = Coefficients({"model": "m"}, surface, np.eye(12), Valid((-100.0, 100.0), (0.0, 40.0)))
    half = np.arange(12.0).reshape(SHAPE) + 3.8
    stated = replace(made, figures={"fit": {"half_width_95_dps": half.tolist()}})
    for coefficients, wanted in ((stated, half.ravel()), (made, np.full(12, 1.959964))):
        (tmp_path / "c.csv").write_text(coefficient_table(coefficients).csv)
        table = np.genfromtxt(tmp_path / "c.csv", delimiter=",", names=True)
        np.testing.assert_allclose(table["high_95_dps"] - 1.0, wanted)
        np.testing.assert_allclose(1.0 - table["low_95_dps"], wanted)
    assert "those of the fit" in coefficient_table(stated).note
    assert "states no intervals" in coefficient_table(made).note
