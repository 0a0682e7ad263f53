"""The Python file of a law, run, against the objects that it was made from."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.diagnosis.versus.law_file import python_file
from gyrocal.fusion import Coefficients, Term, Valid
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Floats
from gyrocal.physics.surface import Direction
from tests.calibration.test_export import smooth_part
from tests.diagnosis.versus.tables import SURFACE

N = 300


def conditions() -> Conditions:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.choice([0.1, 2.0, 30.0], N))
    return Conditions(
        t,
        rng.uniform(-90, 90, N),
        20 + 28 * np.sin(t / 900),
        angle_deg=3.0 * t,
        supply_v=12 + rng.normal(0, 0.1, N),
        since_power_on_s=t + 60,
        since_step_s=t % 50,
        step_dps=np.full(N, 10.0),
        data_set_index=np.floor(t / 50),
    )


def channels(c: Conditions) -> dict[str, Floats]:
    names = ("t_s", "angle_deg", "supply_v", "since_power_on_s", "since_step_s", "step_dps", "data_set_index")
    return {name: c.need(name) for name in names}


def function_of(source: str) -> Callable[..., Floats]:
    space: dict[str, Any] = {}
    exec(compile(source, "law.py", "exec"), space)  # noqa: S102 - the file under test
    function: Callable[..., Floats] = space["added_dps"]
    return function


def term(name: str) -> Any:
    if name == "smooth":
        return smooth_part()
    return Term(name, {k: {"value": v} for k, v in CATALOGUE[name].typical().items()}, True)


@pytest.mark.parametrize("direction", ["output", "input"])
@pytest.mark.parametrize(
    "names", [*((name,) for name in CATALOGUE), ("smooth",), ("smooth", *CATALOGUE)], ids="+".join
)
def test_every_law_of_the_catalogue_gives_its_numbers(names: tuple[str, ...], direction: Direction) -> None:
    surface = replace(SURFACE, direction=direction)
    already = replace(SURFACE, coefficients_dps=0.9 * SURFACE.coefficients_dps)
    terms = tuple(term(name) for name in names)
    law = Coefficients(
        {"model": "t"}, surface, np.eye(12), Valid((-100.0, 100.0), (-10.0, 50.0)), terms=terms
    )
    c = conditions()
    added = function_of(python_file(law, already, "Title.", "- formula"))(c.rate_dps, c.temp_c, **channels(c))
    wanted = surface.output_dps(c.rate_dps, c.temp_c) - already.output_dps(c.rate_dps, c.temp_c)
    wanted = wanted + sum(t.error_dps(c, surface) for t in terms)
    np.testing.assert_allclose(added, wanted, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("truncation", {"of_output": 1.0}),
        ("mechanical_resonance", {"form": 1.0, "scatter": 0.0}),
        ("warm_up", {"of_scale": 1.0}),
        ("thermal_hysteresis", {"of_scale": 1.0}),
        *(("dead_zone", {"form": form}) for form in (0.0, 1.0, 2.0)),
    ],
)
def test_a_law_of_few_forms_gives_its_numbers_in_each(name: str, kind: dict[str, float]) -> None:
    c, usual = conditions(), CATALOGUE[name].typical()
    law = Term(name, {k: {"value": v} for k, v in {**usual, **kind}.items()}, True)
    valid = Valid((-100.0, 100.0), (-10.0, 50.0))
    written = Coefficients({"model": "t"}, SURFACE, np.eye(12), valid, terms=(law,))
    function = function_of(python_file(written, SURFACE, "Title.", "- formula"))
    added = function(c.rate_dps, c.temp_c, **channels(c))
    np.testing.assert_allclose(added, law.error_dps(c, SURFACE), atol=1e-10)


def test_it_needs_numpy_alone_and_asks_for_its_channels(tmp_path: Path) -> None:
    law = Coefficients(
        {"model": "t"}, SURFACE, np.eye(12), Valid((-100.0, 100.0), (-10.0, 50.0)), terms=(term("warm_up"),)
    )
    path = tmp_path / "law.py"
    path.write_text(python_file(law, SURFACE, "Title.", "- formula"), encoding="utf-8")
    program = (
        "import sys, law; print(law.added_dps([10.0], [20.0], since_power_on_s=[0.0])); "
        "print('gyrocal' in sys.modules, 'scipy' in sys.modules); law.added_dps([10.0], [20.0])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split("\n")[:2] == ["[0.01]", "False False"]
    assert "the law needs since_power_on_s: give it by this name" in done.stderr


def test_time_since_power_on_counts_from_where_the_record_began() -> None:
    warm_up = term("warm_up")
    law = Coefficients(
        {"model": "t"}, SURFACE, np.eye(12), Valid((-100.0, 100.0), (-10.0, 50.0)), terms=(warm_up,)
    )
    added = function_of(python_file(law, SURFACE, "Title.", "- formula", began_s=40.0))
    told = added([10.0, 10.0], [20.0, 20.0], since_power_on_s=[0.0, 60.0])
    np.testing.assert_array_equal(added([10.0, 10.0], [20.0, 20.0], t_s=[40.0, 100.0]), told)
    np.testing.assert_array_equal(added(10.0, 20.0, t_s=40.0), told[:1])


def test_a_clock_on_which_samples_come_before_power_on_is_refused() -> None:
    coefficients = Coefficients(
        {"model": "test"},
        SURFACE,
        np.zeros((12, 12)),
        Valid((-100, 100), (-10, 50)),
        terms=(term("warm_up"),),
    )
    added = function_of(python_file(coefficients, SURFACE, "T.", "- f", began_s=1.7e9))
    assert np.isfinite(added(10.0, 20.0, t_s=1.7e9 + 5.0)).all()
    with pytest.raises(ValueError, match="before power-on: give t_s on the recording's clock"):
        added(10.0, 20.0, t_s=910.0)


def law_file_of(effect: str, began_s: float | None = None) -> Callable[..., Floats]:
    """The function of a law file with one effect of the catalogue."""
    valid = Valid((-100.0, 100.0), (-10.0, 50.0))
    law = Coefficients({"model": "t"}, SURFACE, np.eye(12), valid, terms=(term(effect),))
    return function_of(python_file(law, SURFACE, "Title.", "- formula", began_s=began_s))


@pytest.mark.parametrize("name", [*CATALOGUE, "smooth"])
def test_a_channel_that_was_not_given_is_named(name: str) -> None:
    """A lag of two samples without times had ended in Python's words, and of one in no lag, without a word."""
    law = Coefficients(
        {"model": "t"}, SURFACE, np.eye(12), Valid((-100.0, 100.0), (-10.0, 50.0)), terms=(term(name),)
    )
    added = function_of(python_file(law, SURFACE, "Title.", "- formula"))
    reads = {"t_s"} if name == "smooth" else {*CATALOGUE[name].needs} - {"rate_dps", "temp_c"}
    if name == "mechanical_resonance":
        reads = {"t_s"}
    for rate, temp in (([50.0, 60.0], [20.0, 21.0]), (50.0, 20.0)):
        if not reads or name in ("thermal_hysteresis", "time_base"):
            assert np.isfinite(added(rate, temp)).all()
            continue
        with pytest.raises(ValueError, match=r"the law needs \w+: give it by this name"):
            added(rate, temp)


def test_a_resonance_that_does_not_scatter_needs_no_times() -> None:
    values = {**CATALOGUE["mechanical_resonance"].typical(), "scatter": 0.0}
    law = Term("mechanical_resonance", {k: {"value": v} for k, v in values.items()}, True)
    valid = Valid((-100.0, 100.0), (-10.0, 50.0))
    written = Coefficients({"model": "t"}, SURFACE, np.eye(12), valid, terms=(law,))
    assert np.isfinite(function_of(python_file(written, SURFACE, "Title.", "- f"))(50.0, 20.0)).all()


def test_a_law_that_does_not_count_from_power_on_takes_any_time() -> None:
    assert np.isfinite(law_file_of("scale_step", began_s=1.7e9)(10.0, 20.0, t_s=910.0)).all()


def test_a_channel_of_another_name_or_unit_is_refused() -> None:
    with pytest.raises(TypeError, match="temp_rate_c_per_min is no channel of the law"):
        law_file_of("shupe")([10.0], [20.0], t_s=[0.0], temp_rate_c_per_min=[1.0])


def test_samples_too_far_apart_to_tell_the_temperature_rate_have_to_come_with_it() -> None:
    added, rate = law_file_of("shupe"), np.zeros(4)
    temp_c = 20.0 + np.array([0.0, 1.0, 2.0, 3.0])
    assert np.isfinite(added(rate, temp_c, t_s=np.arange(4.0))).all()
    with pytest.raises(ValueError, match="the law needs temp_rate_c_per_s, deg C/s, of samples 40 s apart"):
        added(rate, temp_c, t_s=40.0 * np.arange(4.0))
    told = added(rate, temp_c, t_s=40.0 * np.arange(4.0), temp_rate_c_per_s=np.full(4, 0.025))
    assert np.ptp(told) == 0.0
    assert told[0] != 0.0
