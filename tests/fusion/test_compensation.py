"""The runtime with added physics: exact inverse of what the effects do, the same in any split, and refusals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrocal.errors import CoefficientError
from gyrocal.fusion import Coefficients, Compensator, Term, Valid, parse_coefficients
from gyrocal.fusion.coefficients import FLAG_TERM
from gyrocal.physics.catalogue import CATALOGUE, find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Floats
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import runtime_term

SURFACE = Surface(
    np.array([[0.05, -0.02, 0.01], [0.4, 0.3, -0.1], [0.02, 0.01, 0.0], [-0.3, 0.05, 0.02]]), 0, 100, 20, 30
)
RUNTIME = [e for e in CATALOGUE.values() if e.runtime]


def entry(effect_id: str, *, runtime: bool = True, **values: float) -> Term:
    parameters: dict[str, Mapping[str, Any]] = {
        name: {"value": value, "std": 0.1 * abs(value), "unit": find_effect(effect_id).parameter(name).unit}
        for name, value in values.items()
    }
    return Term(effect_id, parameters, runtime)


def coefficients(*terms: Term) -> Coefficients:
    return Coefficients(
        {"model": "test"}, SURFACE, 1e-8 * np.eye(12), Valid((-100, 100), (-10, 50)), terms=terms
    )


def record(n: int = 300, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.1, 1.0, 30.0], n))
    return t, rng.uniform(-100, 100, n), 20 + 28 * np.sin(t / 900) + rng.normal(0, 0.01, n)


def output(terms: tuple[Term, ...], t: Floats, rate: Floats, temp: Floats) -> Floats:
    c = Conditions(t, rate, temp, since_power_on_s=t + 60.0)
    gyro = SURFACE.output_dps(rate, temp)
    for term in terms:
        effect = find_effect(term.effect)
        p = effect.complete({name: x["value"] for name, x in term.parameters.items()})
        gyro = gyro + effect.error_dps(c, p, SURFACE, None)[0]
    return gyro


@pytest.mark.parametrize("effect", RUNTIME, ids=[e.id for e in RUNTIME])
def test_the_compensator_is_the_inverse_of_the_gyro(effect: Any) -> None:
    terms = (entry(effect.id, runtime=True, **effect.typical()),)
    t, rate, temp = record()
    corrected = Compensator(coefficients(*terms)).correct(t, output(terms, t, rate, temp), temp, t + 60.0)
    # Rates that are remembered are those of the surface alone.
    of_rates = "rate_dps" in effect.needs and effect.has_memory
    np.testing.assert_allclose(corrected, rate, atol=1e-6 if of_rates else 1e-9)


def test_several_strong_terms_at_once() -> None:
    terms = (
        entry("sagnac_sine", amplitude=1.0, phase_rad_per_dps=0.006),
        entry("shupe", amplitude=20.0),
        entry("thermal_lag", amplitude=1.0, tau_s=400.0),
        entry("warm_up", amplitude=30.0, tau_s=900.0),
    )
    t, rate, temp = record()
    gyro = output(terms, t, rate, temp)
    assert np.abs(gyro - SURFACE.output_dps(rate, temp)).max() > 1.0
    corrected = Compensator(coefficients(*terms)).correct(t, gyro, temp, t + 60.0)
    np.testing.assert_allclose(corrected, rate, atol=1e-9)


@settings(max_examples=8)
@given(cuts=st.lists(st.integers(0, 80), max_size=8), seed=st.integers(0, 100))
def test_any_split_gives_the_same_numbers(cuts: list[int], seed: int) -> None:
    c = coefficients(*(entry(e.id, runtime=True, **e.typical()) for e in RUNTIME))
    t, rate, temp = record(80, seed)
    temp[5] = np.nan
    rate[9] = 1e9
    batch = Compensator(c).correct(t, rate, temp, t)
    stream = Compensator(c)
    parts = [
        stream.correct(t[a:b], rate[a:b], temp[a:b], t[a:b]) for a, b in pairwise([0, *sorted(cuts), t.size])
    ]
    np.testing.assert_allclose(np.concatenate(parts), batch, rtol=1e-13, atol=1e-13)


def test_single_samples_are_floats_and_equal_the_batch() -> None:
    c = coefficients(entry("thermal_lag", amplitude=0.5, tau_s=100.0))
    t, rate, temp = record(40)
    stream = Compensator(c)
    singles = [stream.correct(a, b, d) for a, b, d in zip(t, rate, temp, strict=True)]
    assert all(isinstance(x, float) for x in singles)
    np.testing.assert_allclose(singles, Compensator(c).correct(t, rate, temp), rtol=1e-13)


def test_without_terms_it_is_the_surface() -> None:
    c = coefficients(entry("table_eccentricity", runtime=False, amplitude=3.0))
    t, rate, temp = record(40)
    compensator = Compensator(c)
    assert compensator.not_applied == ("table_eccentricity",)
    np.testing.assert_array_equal(compensator.correct(t, rate, temp), rate - SURFACE.error_dps(rate, temp))
    np.testing.assert_array_equal(c.correct(rate, temp), compensator.correct(t, rate, temp))


def test_stateless_correct_applies_memoryless_terms_and_refuses_the_others() -> None:
    terms = (entry("scale_asymmetry", amplitude=500.0),)
    _, rate, temp = record(40)
    gyro = output(terms, np.arange(40.0), rate, temp)
    np.testing.assert_allclose(coefficients(*terms).correct(gyro, temp), rate, atol=1e-9)
    assert isinstance(coefficients(*terms).correct(3.0, 20.0), float)
    for effect_id in ("shupe", "warm_up"):
        with pytest.raises(CoefficientError, match=rf"hold {effect_id}, .* use gyrocal\.fusion\.Compensator"):
            coefficients(entry(effect_id)).correct(gyro, temp)


def test_evaluate_adds_uncertainty_of_the_terms_and_flags() -> None:
    terms = (entry("scale_asymmetry", amplitude=500.0),)
    c = coefficients(*terms)
    result = Compensator(c).evaluate(
        [0.0, 1.0, 2.0, 3.0], [80.0, 150.0, 0.0, np.nan], [20.0, 20.0, 70.0, 20.0]
    )
    np.testing.assert_array_equal(result.flags, [0, 1, 2, 4])
    # The amplitude's own uncertainty, where there is no covariance; both as they move the rate that is solved for.
    surface = float(c.sigma_dps(result.rate_dps[0] + SURFACE.error_dps(80.0, 20.0), 20.0))
    ahead = replace(c, terms=(entry("scale_asymmetry", amplitude=500.5),)).correct(80.0, 20.0)
    term = 50.0 * (ahead - result.rate_dps[0]) / 0.5
    whole = 1.0 + 500e-6 * (1.0 - SURFACE.slope_per_dps(80.0, 20.0))
    assert result.sigma_dps[0] == pytest.approx(np.hypot(surface / whole, term), rel=1e-5)


def test_sigma_from_the_joint_covariance_is_that_of_drawn_calibrations() -> None:
    gradient = find_effect("shupe_gradient")
    rng = np.random.default_rng(8)
    root = 1e-3 * rng.normal(size=(14, 20)) * np.array([1.0] * 13 + [2000.0])[:, None]
    joint = root @ root.T
    value = {"amplitude": 2.0, "tau_s": 300.0}
    term = Term(
        "shupe_gradient",
        {
            name: {
                "value": value[name],
                "unit": gradient.parameter(name).unit,
                "covariance": joint[12 + k].tolist(),
            }
            for k, name in enumerate(value)
        },
        True,
    )
    c = replace(coefficients(term), covariance_dps2=joint[:12, :12])
    c = parse_coefficients(c.to_text(), "c.json")
    t, gyro, temp = record(60)
    stream = Compensator(c)
    sigma = np.concatenate(
        [stream.evaluate(t[i : i + 7], gyro[i : i + 7], temp[i : i + 7]).sigma_dps for i in range(0, 60, 7)]
    )
    draws = rng.multivariate_normal(np.zeros(14), joint, 1000)
    rates = []
    for draw in draws:
        table = SURFACE.coefficients_dps + draw[:12].reshape(4, 3)
        other = replace(SURFACE, coefficients_dps=table)
        moved = entry("shupe_gradient", amplitude=2.0 + draw[12], tau_s=300.0 + draw[13])
        rates.append(Compensator(replace(coefficients(moved), surface=other)).correct(t, gyro, temp))
    # A standard deviation from n draws has a relative error of 1/sqrt(2 n); 5 of them for 60 samples is a false
    # alarm in 3e-5 runs, and two percent are for what is not linear.
    ratio = sigma / np.std(rates, axis=0)
    assert np.all(np.abs(ratio - 1) < 0.02 + 5 / np.sqrt(2 * len(draws)))


def test_a_covariance_of_the_wrong_length_is_refused() -> None:
    term = Term("shupe", {"amplitude": {"value": 1.0, "covariance": [0.0] * 12}}, True)
    with pytest.raises(CoefficientError, match="has not the 13 numbers"):
        Compensator(coefficients(term))


def test_refusals() -> None:
    with pytest.raises(CoefficientError, match="warm_up, which needs the time since power-on"):
        Compensator(coefficients(entry("warm_up"))).correct(0.0, 1.0, 20.0)
    with pytest.raises(CoefficientError, match="no effect 'gremlins'"):
        Compensator(coefficients(Term("gremlins", {}, True)))
    with pytest.raises(CoefficientError, match="no parameter 'tau'"):
        runtime_term("warm_up", {"tau": {"value": 1.0}})
    with pytest.raises(CoefficientError, match=r"'shupe' cannot be evaluated \('value'\)"):
        runtime_term("shupe", {"amplitude": {"std": 1.0}})
    for value in (0.0, float("nan")):
        with pytest.raises(CoefficientError, match=f"tau_s is {value:g}"):
            runtime_term("warm_up", {"tau_s": {"value": value}})
    assert runtime_term("sagnac_sine", {"amplitude": {"value": 7.0}}).parameters["amplitude"] == 7.0
    with pytest.raises(CoefficientError, match="amplitude is in 'deg/s', and 'mdeg/s' is wanted"):
        runtime_term("warm_up", {"amplitude": {"value": 1.0, "unit": "deg/s"}})
    with pytest.raises(CoefficientError, match="a robot cannot evaluate it: it needs angle_deg"):
        runtime_term("magnetic", {})
    with pytest.raises(CoefficientError, match="it belongs to the bench"):
        runtime_term("bias_drift", {})


def test_terms_survive_the_file() -> None:
    c = coefficients(entry("thermal_lag", amplitude=0.5, tau_s=100.0))
    again = parse_coefficients(c.to_text(), "c.json")
    t, rate, temp = record(40)
    np.testing.assert_array_equal(
        Compensator(again).correct(t, rate, temp), Compensator(c).correct(t, rate, temp)
    )


def test_a_settling_is_flagged_before_the_record_that_showed_it_began() -> None:
    warm_up = replace(entry("warm_up", amplitude=20.0, tau_s=900.0), seen_from_s=600.0)
    c = parse_coefficients(coefficients(warm_up).to_text(), "c.json")
    since_s = np.array([0.0, 599.0, 600.0, 5000.0])
    found = Compensator(c).evaluate(since_s, 10.0, 20.0, since_s)
    np.testing.assert_array_equal(found.flags, [FLAG_TERM, FLAG_TERM, 0, 0])
    # A file that does not say it is as it was.
    again = parse_coefficients(coefficients(replace(warm_up, seen_from_s=0.0)).to_text(), "c.json")
    np.testing.assert_array_equal(Compensator(again).evaluate(since_s, 10.0, 20.0, since_s).flags, 0)
