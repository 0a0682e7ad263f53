"""Surfaces of the true rate and terms without a name, as a robot runs them: against closed forms and scipy's root finder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from gyrocal.errors import CoefficientError
from gyrocal.fusion import Coefficients, Compensator, Term, Valid, parse_coefficients
from gyrocal.fusion.coefficients import FLAG_NOT_FINITE, FLAG_TERM
from gyrocal.physics.conditions import Conditions, Memory
from gyrocal.physics.effect import Floats
from gyrocal.physics.smooth import Column, Factor, Frame, SmoothTerm, columns_of
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import Part

#: A cubic in the true rate whose slope falls to a third at the ends of the range, as a strong open loop's does.
STRONG = Surface(
    np.array([[0.05, -0.02, 0.01], [0.4, 0.3, -0.1], [0.5, 0.1, 0.0], [-22.0, 0.5, 0.2]]),
    0.0,
    100.0,
    20.0,
    30.0,
    "input",
)
MILD = replace(STRONG, coefficients_dps=0.05 * STRONG.coefficients_dps)
VALID = Valid((-90.0, 90.0), (-10.0, 50.0))


def output_of(
    surface: Surface, terms: Sequence[Part], memories: Sequence[Memory], c: Conditions
) -> tuple[Floats, list[Memory]]:
    """Output at the true rates of `c`, deg/s, shape (n,), of a gyro with this surface and these terms."""
    last = [term.at(c, surface, memory)(c.rate_dps) for term, memory in zip(terms, memories, strict=True)]
    output = surface.output_dps(c.rate_dps, c.temp_c) + sum(error for error, _ in last)
    return np.asarray(output), [memory for _, memory in last]


def coefficients(surface: Surface, *terms: Term | SmoothTerm) -> Coefficients:
    return Coefficients({"model": "test"}, surface, 1e-8 * np.eye(12), VALID, terms=terms)


def record(n: int = 300, seed: int = 0) -> Conditions:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.1, 1.0, 30.0], n))
    temp = 20 + 28 * np.sin(t / 900) + rng.normal(0, 0.01, n)
    return Conditions(t, rng.uniform(-100, 100, n), temp, since_power_on_s=t + 60.0)


COLUMNS = (
    Column(Factor("even_bump", (40.0, 12.0))),
    Column(Factor("odd_asinh_bump", (5.0, 1.0))),
    Column(Factor("linear"), Factor("bump", (5.0, 9.0))),
    Column(Factor("legendre", (5.0,))),
    Column(Factor("linear"), driver=Factor("lag", (240.0,))),
    Column(driver=Factor("band", (80.0, 640.0))),
    Column(Factor("legendre", (2.0,)), Factor("legendre", (1.0,)), Factor("play", (3.0,))),
    Column(driver=Factor("warm_up", (900.0,))),
    Column(driver=Factor("temperature_rate")),
    Column(Factor("absolute")),
)


def smooth(size_dps: float = 0.05, columns: tuple[Column, ...] = COLUMNS) -> SmoothTerm:
    rng = np.random.default_rng(3)
    frame = Frame(100.0, 20.0, 30.0)
    x, _ = columns_of(record(3000, 9), frame, columns)
    seen = np.column_stack([x.min(axis=0), x.max(axis=0)])
    p = len(columns)
    b = size_dps * rng.choice([-1.0, 1.0], p) / np.abs(x).max(axis=0)
    return SmoothTerm("rate shape", "part 1", frame, columns, b, np.diag((0.01 * b) ** 2), seen)


NAMED = (
    Term("thermal_lag", {"amplitude": {"value": 0.6}, "tau_s": {"value": 400.0}}, True),
    Term("scale_asymmetry", {"amplitude": {"value": 500.0}}, True),
)


@pytest.mark.parametrize("surface", [STRONG, MILD, replace(MILD, direction="output")])
@pytest.mark.parametrize(
    "terms", [(), NAMED, (smooth(),), (*NAMED, smooth())], ids=["bare", "named", "smooth", "all"]
)
def test_the_compensator_is_the_inverse_of_the_gyro(
    surface: Surface, terms: tuple[Term | SmoothTerm, ...]
) -> None:
    c = coefficients(surface, *terms)
    at = record()
    gyro, _ = output_of(surface, c.runtime_terms(), [None] * len(terms), at)
    assert np.abs(gyro - at.rate_dps).max() > 0.5
    corrected = Compensator(c).evaluate(at.t_s, gyro, at.temp_c, at.since_power_on_s)
    np.testing.assert_allclose(corrected.rate_dps, at.rate_dps, atol=1e-9)
    assert not np.any(corrected.flags & FLAG_NOT_FINITE)


def test_a_third_of_nonlinearity_against_scipy() -> None:
    """The Sagnac sine at 1.5 rad as its own closed form, a cubic of it, and the bump of a resonance upon it."""
    k = 1.5 / 100.0
    sine = Term("sagnac_sine", {"amplitude": {"value": 1.0}, "phase_rad_per_dps": {"value": k}}, True)
    flat = replace(STRONG, coefficients_dps=np.zeros((4, 3)))
    rate = np.linspace(-100, 100, 401)
    gyro = np.sin(k * rate) / k
    assert np.abs(gyro - rate).max() / 100 > 0.33
    alone = Compensator(coefficients(flat, sine)).correct(0.0, gyro, 20.0)
    closed = np.arcsin(gyro * k) / k
    # At the ends the slope is 0.07, which makes a rounding of the output fourteen times as large.
    np.testing.assert_allclose(alone, closed, atol=1e-9)

    bump = SmoothTerm(
        "rate shape", "b", Frame(100, 20, 30), (Column(Factor("odd_bump", (60.0, 5.0))),), np.array([0.3]),
        np.eye(1), np.array([[-1.0, 1.0]]),
    )  # fmt: skip
    c = coefficients(MILD, sine, bump)

    def output(w: float) -> float:
        law = np.exp(-0.5 * ((w - 60) / 5) ** 2) - np.exp(-0.5 * ((w + 60) / 5) ** 2)
        return float(w + MILD.error_dps(w, 31.0) + np.sin(k * w) / k - w + 0.3 * law)

    wanted = np.linspace(output(-95.0), output(95.0), 101)
    solved = Compensator(c).correct(0.0, wanted, 31.0)
    independent = [brentq(lambda w, g=g: output(w) - g, -100, 100, xtol=1e-13) for g in wanted]
    np.testing.assert_allclose(solved, independent, atol=1e-9)


def test_a_cubic_in_the_input_inverted_by_the_roots_of_the_polynomial() -> None:
    gyro = np.linspace(-70, 70, 57)
    a = STRONG.coefficients_dps[:, 0]  # at the centre of temperature
    for g, w in zip(gyro, coefficients(STRONG).correct(gyro, 20.0), strict=True):
        roots = 100 * np.roots([a[3], a[2], a[1] + 100, a[0] - g])
        assert np.abs(roots - w).min() < 1e-10


def test_where_no_rate_has_the_output_it_is_flagged() -> None:
    # w - 22 (w/100)^3 + ... turns over near 123 deg/s, where the output is about 83.
    top = STRONG.output_dps(np.linspace(0, 200, 20001), 20.0).max()
    result = Compensator(coefficients(STRONG)).evaluate(
        np.arange(4.0), [top - 0.5, top + 0.5, -300.0, 0.0], 20.0
    )
    np.testing.assert_array_equal(result.flags & FLAG_NOT_FINITE, [0, FLAG_NOT_FINITE, FLAG_NOT_FINITE, 0])
    np.testing.assert_array_equal(np.isnan(result.rate_dps), [False, True, True, False])
    # On the rising branch, beyond the range that was fitted.
    assert 100 < result.rate_dps[0] < 130
    assert STRONG.output_dps(result.rate_dps[0], 20.0) == pytest.approx(top - 0.5, abs=1e-9)
    assert np.isnan(coefficients(STRONG).correct(top + 0.5, 20.0))


@settings(max_examples=8)
@given(cuts=st.lists(st.integers(0, 80), max_size=8), seed=st.integers(0, 100))
def test_any_split_gives_the_same_bits(cuts: list[int], seed: int) -> None:
    c = coefficients(STRONG, *NAMED, smooth())
    at = record(80, seed)
    gyro = at.rate_dps.copy()
    gyro[[9, 40]] = 1e9, np.nan
    at.temp_c[5] = np.nan
    batch = Compensator(c).evaluate(at.t_s, gyro, at.temp_c, at.t_s)
    stream = Compensator(c)
    parts = [
        stream.evaluate(at.t_s[a:b], gyro[a:b], at.temp_c[a:b], at.t_s[a:b])
        for a, b in pairwise([0, *sorted(cuts), 80])
    ]
    np.testing.assert_array_equal(np.concatenate([p.rate_dps for p in parts]), batch.rate_dps)
    np.testing.assert_array_equal(np.concatenate([p.flags for p in parts]), batch.flags)
    np.testing.assert_allclose(np.concatenate([p.sigma_dps for p in parts]), batch.sigma_dps, rtol=1e-12)


def test_single_samples_equal_the_batch_bit_for_bit() -> None:
    c = coefficients(STRONG, *NAMED, smooth())
    at = record(60)
    stream = Compensator(c)
    singles = [
        stream.correct(t, g, temp, t) for t, g, temp in zip(at.t_s, at.rate_dps, at.temp_c, strict=True)
    ]
    batch = Compensator(c).correct(at.t_s, at.rate_dps, at.temp_c, at.t_s)
    np.testing.assert_array_equal(singles, batch)


@pytest.mark.parametrize("bad", ["temp", "time"])
def test_one_bad_sample_does_not_poison_the_memory(bad: str) -> None:
    for terms in (NAMED, (smooth(),)):
        c = coefficients(MILD, *terms)
        at = record(300)
        t, temp = at.t_s.copy(), at.temp_c.copy()
        (temp if bad == "temp" else t)[100] = np.inf if bad == "temp" else np.nan
        hurt = Compensator(c).evaluate(t, at.rate_dps, temp, at.t_s)
        assert hurt.flags[100] & FLAG_NOT_FINITE
        others = np.arange(300) != 100
        assert np.isfinite(hurt.rate_dps[others]).all()
        whole = Compensator(c).correct(at.t_s, at.rate_dps, at.temp_c, at.t_s)
        # The same as if that sample had not been there.
        without = Compensator(c).correct(*(x[others] for x in (at.t_s, at.rate_dps, at.temp_c, at.t_s)))
        np.testing.assert_array_equal(hurt.rate_dps[others], without)
        np.testing.assert_allclose(hurt.rate_dps[others][-50:], whole[-50:], atol=1e-4)


@pytest.mark.slow
def test_sigma_is_that_of_drawn_calibrations() -> None:
    """Surface and term with a joint covariance, where the slope of the output is a third to one."""
    rng = np.random.default_rng(8)
    term = smooth()
    p = len(COLUMNS)
    scale = np.concatenate([np.full(12, 2e-3), 0.02 * np.abs(term.coefficients_dps)])
    root = scale[:, None] * rng.normal(size=(12 + p, 30)) / np.sqrt(30)
    joint = root @ root.T
    c = replace(
        coefficients(STRONG, replace(term, covariance_dps2=joint[12:])), covariance_dps2=joint[:12, :12]
    )
    c = parse_coefficients(c.to_text(), "c.json")
    at = record(60)
    gyro, _ = output_of(STRONG, c.runtime_terms(), [None], at)
    sigma = Compensator(c).evaluate(at.t_s, gyro, at.temp_c, at.since_power_on_s).sigma_dps
    rates = []
    for draw in rng.multivariate_normal(np.zeros(12 + p), joint, 1000):
        surface = replace(STRONG, coefficients_dps=STRONG.coefficients_dps + draw[:12].reshape(4, 3))
        moved = replace(term, coefficients_dps=term.coefficients_dps + draw[12:])
        rates.append(
            Compensator(coefficients(surface, moved)).correct(at.t_s, gyro, at.temp_c, at.since_power_on_s)
        )
    ratio = sigma / np.std(rates, axis=0)
    # As in test_compensation: 5 standard deviations of a standard deviation, and two percent for curvature.
    assert np.all(np.abs(ratio - 1) < 0.02 + 5 / np.sqrt(2 * 1000))


def test_sigma_grows_and_flags_come_where_a_driver_was_not_covered() -> None:
    term = smooth(columns=(Column(driver=Factor("lag", (300.0,))),))
    low, high = term.seen[0]
    t = np.arange(0.0, 7200.0, 10.0)
    temp = np.where(t < 3600, 20.0, 20.0 + (t - 3600) * 0.06)  # 3.6 degC/min: a lag of 18 degC, 7.7 was seen
    result = Compensator(coefficients(MILD, term)).evaluate(t, 10.0, temp, t)
    lag = -0.06 * 300 * -np.expm1(-np.maximum(t - 3600, 0) / 300)
    beyond = (lag < low - 0.1 * (high - low)) | (lag > high + 0.1 * (high - low))
    assert beyond.any()
    np.testing.assert_array_equal((result.flags & FLAG_TERM) > 0, beyond)
    assert result.sigma_dps[-1] > 2 * result.sigma_dps[0]


def test_the_file_says_what_it_needs_of_its_reader() -> None:
    output = replace(MILD, direction="output")
    for c, version in (
        (coefficients(output), 1), (coefficients(output, *NAMED), 1), (coefficients(MILD), 2),
        (coefficients(output, smooth()), 2),
    ):  # fmt: skip
        body = json.loads(c.to_text())
        assert body["schema"] == f"gyrocal-coefficients/{version}"
        assert ("direction" in body["surface"]) == (c.surface.direction == "input")
        again = parse_coefficients(c.to_text(), "c.json")
        assert again.to_text() == c.to_text()
        at = record(20)
        a, b = (Compensator(x).correct(at.t_s, at.rate_dps, at.temp_c, at.t_s) for x in (c, again))
        np.testing.assert_array_equal(a, b)


def test_a_direction_or_shape_that_is_not_known_is_refused() -> None:
    body = json.loads(coefficients(MILD, smooth()).to_text())
    body["surface"]["direction"] = "sideways"
    with pytest.raises(CoefficientError, match="the direction is 'sideways'; output or input is wanted"):
        parse_coefficients(sealed(body), "c.json")
    body["surface"]["direction"] = "input"
    body["terms"][0]["columns"][0]["rate"] = {"kind": "wavelet"}
    with pytest.raises(CoefficientError, match="the shape 'wavelet' is not known"):
        parse_coefficients(sealed(body), "c.json")


def sealed(body: dict[str, Any]) -> str:
    """As `fit` would have written it."""
    rest = {key: value for key, value in body.items() if key != "sha256"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return json.dumps(rest | {"sha256": hashlib.sha256(canonical.encode()).hexdigest()})


def test_a_supply_that_is_not_read_is_that_of_the_recording() -> None:
    term = SmoothTerm(
        "supply", "supply", Frame(100, 20, 30, 12), (Column(driver=Factor("supply")),), np.ones(1), np.eye(1),
        np.array([[-1.0, 1.0]]),
    )  # fmt: skip
    law = Term("supply_voltage", {"amplitude": {"value": 1000.0}, "nominal_v": {"value": 12.0}}, True)
    bare = Compensator(coefficients(MILD)).correct(0.0, 5.0, 20.0)
    for part in (term, law):
        compensator = Compensator(coefficients(MILD, part))
        assert not compensator.not_applied
        assert compensator.correct(0.0, 5.0, 20.0) == pytest.approx(bare)
        assert compensator.correct(0.0, 5.0, 20.0, supply_v=np.nan) == pytest.approx(bare)
        read = compensator.correct(0.0, 5.0, 20.0, supply_v=12.5)
        assert read == pytest.approx(Compensator(coefficients(MILD)).correct(0.0, 4.5, 20.0), abs=1e-9)


def test_fit_direction_turns_round_with_the_surface() -> None:
    """With amplitude 1 a surface of the input becomes the same polynomial of the output, and the other way round."""
    rate: Floats = np.linspace(-100, 100, 41)
    whole = Term("fit_direction", {"amplitude": {"value": 1.0}}, True)
    turned = {"input": replace(MILD, direction="output"), "output": MILD}
    for surface in (MILD, replace(MILD, direction="output")):
        at = Conditions(np.zeros(41), rate, np.full(41, 33.0))
        gyro, _ = output_of(surface, coefficients(surface, whole).runtime_terms(), [None], at)
        np.testing.assert_allclose(gyro, turned[surface.direction].output_dps(rate, 33.0), atol=1e-9)


def test_thermal_lag_moves_a_surface_of_the_input_to_the_temperature_of_the_coil() -> None:
    lag = Term("thermal_lag", {"amplitude": {"value": 1.0}, "tau_s": {"value": 300.0}}, True)
    t = np.arange(0.0, 3000.0, 10.0)
    temp = 0.01 * t
    behind = 0.01 * 300 * -np.expm1(-t / 300)
    rate = 80 * np.cos(t)
    gyro = STRONG.output_dps(rate, temp - behind)
    corrected = Compensator(coefficients(STRONG, lag)).correct(t, gyro, temp)
    np.testing.assert_allclose(corrected, rate, atol=1e-9)
