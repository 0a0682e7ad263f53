"""Empirical parts: each shape against its formula, any split of a record, and the coefficient file's form."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import eval_legendre

from gyrocal.physics.conditions import Conditions
from gyrocal.physics.effect import Floats
from gyrocal.physics.shapes import DRIVERS, RATE, TEMPERATURE
from gyrocal.physics.smooth import (
    Column,
    Factor,
    Frame,
    SmoothTerm,
    columns_of,
    design,
    histories,
    seen_of,
    smooth_term,
)

FRAME = Frame(100.0, 20.0, 30.0, 12.0)
NUMBERS = {
    "order": 5.0, "center_dps": 40.0, "width_dps": 12.0, "center": 6.0, "width": 1.5, "center_c": 10.0,
    "width_c": 9.0, "tau_s": 300.0, "longer_tau_s": 600.0, "half_width_c": 4.0,
}  # fmt: skip


def factors(kinds: Any) -> list[Factor]:
    return [Factor(kind, tuple(NUMBERS[name] for name in shape.names)) for kind, shape in kinds.items()]


ALL = tuple(
    [Column(rate=f) for f in factors(RATE)]
    + [Column(Factor("linear"), f) for f in factors(TEMPERATURE)]
    + [Column(Factor("legendre", (3.0,)), Factor("legendre", (2.0,)), f) for f in factors(DRIVERS)]
)


def record(n: int = 400, seed: int = 0) -> Conditions:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.1, 2.0, 60.0], n))
    temp = 20 + 28 * np.sin(t / 900) + rng.normal(0, 0.01, n)
    return Conditions(
        t, rng.uniform(-100, 100, n), temp, supply_v=12 + rng.normal(0, 0.1, n), since_power_on_s=t + 60
    )


def one(column: Column, c: Conditions) -> Floats:
    return columns_of(c, FRAME, (column,))[0][:, 0]


def gauss(x: Any) -> Any:
    return np.exp(-0.5 * np.square(x))


def test_factors_of_rate_and_temperature_are_their_formulas() -> None:
    c = record()
    w, u, v = c.rate_dps, c.rate_dps / 100, (c.temp_c - 20) / 30
    x = np.arcsinh(u / 1e-3)
    expected = {
        "one": np.ones(w.size), "linear": u, "legendre": eval_legendre(5, u), "absolute": np.abs(u),
        "even_bump": gauss((w - 40) / 12) + gauss((w + 40) / 12),
        "odd_bump": gauss((w - 40) / 12) - gauss((w + 40) / 12),
        "even_asinh_bump": gauss((x - 6) / 1.5) + gauss((x + 6) / 1.5),
        "odd_asinh_bump": gauss((x - 6) / 1.5) - gauss((x + 6) / 1.5),
    }  # fmt: skip
    assert set(expected) == set(RATE)
    for factor in factors(RATE):
        np.testing.assert_allclose(one(Column(factor), c), expected[factor.kind], rtol=1e-12, atol=1e-12)
    over_temperature = {
        "one": np.ones(w.size),
        "legendre": eval_legendre(5, v),
        "bump": gauss((c.temp_c - 10) / 9),
        "edge": 2 / (1 + np.exp(-2 * (c.temp_c - 10) / 9)) - 1,
    }
    for factor in factors(TEMPERATURE):
        np.testing.assert_allclose(
            one(Column(temperature=factor), c), over_temperature[factor.kind], atol=1e-12
        )


def test_drivers_on_a_ramp_have_their_closed_forms() -> None:
    t = np.arange(0.0, 3000.0, 7.0)
    ramp = 0.01  # degC/s
    squares = np.square(FRAME.rate_scale_dps) * 2e-4 * t
    c = Conditions(t, np.sqrt(squares), 20 + ramp * t, supply_v=np.full(t.size, 11.5), since_power_on_s=t)

    def behind(tau: float) -> Floats:
        return np.asarray(-ramp * tau * -np.expm1(-t / tau))

    expected = {
        "one": np.ones(t.size), "lag": behind(300.0), "band": behind(300.0) - behind(600.0),
        "temperature_rate": -behind(30.0) / 30, "play": -np.minimum(ramp * t, 4.0),
        "warm_up": np.exp(-t / 300), "supply": np.full(t.size, -0.5), "supply_squared": np.full(t.size, 0.25),
        "heat": 2e-4 * (t + 300.0 * np.expm1(-t / 300.0)),
    }  # fmt: skip
    assert set(expected) == set(DRIVERS)
    for factor in factors(DRIVERS):
        np.testing.assert_allclose(one(Column(driver=factor), c), expected[factor.kind], atol=1e-12)


def test_a_column_is_the_product_of_its_factors() -> None:
    c = record()
    rate, temp, driver = Factor("odd_bump", (30.0, 9.0)), Factor("legendre", (2.0,)), Factor("lag", (200.0,))
    whole = one(Column(rate, temp, driver), c)
    parts = one(Column(rate), c) * one(Column(temperature=temp), c) * one(Column(driver=driver), c)
    np.testing.assert_allclose(whole, parts, rtol=1e-14)


def test_the_design_takes_drivers_averaged_elsewhere() -> None:
    c = record(60)
    values, _ = histories(c, FRAME, [column.driver for column in ALL])
    np.testing.assert_array_equal(
        design(c.rate_dps, c.temp_c, FRAME, ALL, values), columns_of(c, FRAME, ALL)[0]
    )


@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 80), max_size=8), seed=st.integers(0, 100))
def test_any_split_gives_the_same_numbers(cuts: list[int], seed: int) -> None:
    c = record(80, seed)
    c.temp_c[[7, 30]] = np.nan, np.inf
    whole, _ = columns_of(c, FRAME, ALL)
    memory, parts = None, []
    for a, b in pairwise([0, *sorted(cuts), 80]):
        part, memory = columns_of(c.cut(slice(a, b)), FRAME, ALL, memory)
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_one_bad_temperature_or_time_does_not_poison_what_follows() -> None:
    good = record(60)
    for bad in ("temp_c", "t_s"):
        c = good.cut(slice(None))
        values = getattr(c, bad).copy()
        values[20] = np.inf if bad == "temp_c" else np.nan
        object.__setattr__(c, bad, values)
        columns, _ = columns_of(c, FRAME, ALL)
        assert np.isfinite(np.delete(columns, 20, axis=0)).all()


def term() -> SmoothTerm:
    p = len(ALL)
    rng = np.random.default_rng(5)
    c = record()
    x, _ = columns_of(c, FRAME, ALL)
    root = rng.normal(size=(p, p))
    seen = np.column_stack([x.min(axis=0), x.max(axis=0)])
    return SmoothTerm("thermal transient", "part 1", FRAME, ALL, rng.normal(size=p), root @ root.T, seen)


def test_json_and_back() -> None:
    a = term()
    b = smooth_term(json.loads(json.dumps(a.to_json())))
    assert (a.family, a.label, a.frame, a.columns) == (b.family, b.label, b.frame, b.columns)
    for name in ("coefficients_dps", "covariance_dps2", "seen"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.has_memory
    assert a.channels == {"temp_c", "since_power_on_s", "supply_v", "rate_dps"}
    assert a.remembers_rates


def test_beyond_what_was_seen() -> None:
    a = term()
    x, _ = columns_of(record(), FRAME, ALL)
    assert not a.beyond(record(), x).any()
    x[3, 1] = 2.0  # u was seen up to 1
    np.testing.assert_array_equal(np.flatnonzero(a.beyond(record(), x)), [3])


def test_what_adds_next_to_nothing_is_known_anywhere() -> None:
    """A shape that died had flagged samples at rates of the calibration, for the last digits of a column."""
    x, _ = columns_of(record(), FRAME, ALL)
    sizes_dps = np.full(len(ALL), 1e-2)
    sizes_dps[1] = 1e-8
    a = replace(term(), seen=seen_of(x, sizes_dps, least_dps=1e-5))
    x[3, 1] = 2.0
    assert not a.beyond(record(), x).any()
    x[4, 2] += 2.0 * np.ptp(x[:, 2]) + 0.1
    np.testing.assert_array_equal(np.flatnonzero(a.beyond(record(), x)), [4])


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("columns", 0, "rate"), {"kind": "wavelet"}, "shape 'wavelet' is not known"),
        (("columns", 4, "rate"), {"kind": "even_bump", "center_dps": 1, "width_dps": 0}, "width_dps .* is 0"),
        (("columns", 0, "coefficient_dps"), float("nan"), "coefficients_dps .* not finite"),
        (("covariance_dps2",), [[1.0]], "covariance_dps2 .* does not fit"),
        (("frame", "rate_scale_dps"), 0.0, "scales .* must be positive"),
    ],
)
def test_malformed_entries_are_refused(path: tuple[Any, ...], value: Any, says: str) -> None:
    raw: Any = term().to_json()
    at = raw
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(ValueError, match=says):
        smooth_term(raw)
