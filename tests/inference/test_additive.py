"""Variance components against closed forms: the balanced one-way layout, and what simulation says of intervals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, norm

from gyrocal.inference.additive import MOST_DIRECTIONS, Component, Contrasts, precision, solve, widened
from gyrocal.inference.processes import ornstein_uhlenbeck, wiener

Floats = NDArray[np.float64]


def one_way(groups: int, each: int, rng: np.random.Generator) -> tuple[Floats, Floats, list[Component]]:
    """A record of groups with a mean of their own, standard deviation 2, in noise of 1."""
    member = np.repeat(np.eye(groups), each, axis=0)
    y = 5.0 + member @ rng.normal(0.0, 2.0, groups) + rng.standard_normal(groups * each)
    parts = [
        Component("group", member),
        Component("white", covariance=np.eye(groups * each)),
    ]
    return y, np.ones((y.size, 1)), parts


def test_balanced_one_way_layout_has_the_estimates_of_the_analysis_of_variance() -> None:
    """REML in a balanced layout: mean squares within and between (Searle, Casella, McCulloch, 1992, 3.8)."""
    groups, each = 30, 8
    y, flat, parts = one_way(groups, each, np.random.default_rng(1))
    cell = y.reshape(groups, each)
    within = float(np.sum((cell - cell.mean(axis=1, keepdims=True)) ** 2) / (groups * (each - 1)))
    between = float(each * np.sum((cell.mean(axis=1) - y.mean()) ** 2) / (groups - 1))
    found = Contrasts(y, flat).fit(parts, iterations=200).variance
    # The weak prior of the standard deviations moves them by a small share of their own uncertainty.
    assert found["white"] == pytest.approx(within, rel=0.03)
    assert found["group"] == pytest.approx((between - within) / each, rel=0.06)


def test_a_part_that_is_not_there_gets_no_variance() -> None:
    rng = np.random.default_rng(2)
    x = rng.standard_normal((80, 6))
    found = Contrasts(rng.standard_normal(80), np.ones((80, 1))).fit(
        [Component("nothing", x), Component("white", covariance=np.eye(80))]
    )
    assert found.variance["nothing"] < 0.05
    assert found.variance["white"] == pytest.approx(1.0, rel=0.35)


def test_likelihood_is_the_density_of_the_contrasts() -> None:
    """Differences between two settings, by the textbook's formula of the restricted likelihood."""
    y, flat, parts = one_way(6, 5, np.random.default_rng(3))
    contrasts = Contrasts(y, flat)

    def textbook(group: float, white: float) -> float:
        member = parts[0].columns
        assert member is not None
        v = group * member @ member.T + white * np.eye(y.size)
        vx = np.linalg.solve(v, flat)
        b = np.linalg.solve(flat.T @ vx, vx.T @ y)
        left = y - flat @ b
        logs = np.linalg.slogdet(v)[1] + np.linalg.slogdet(flat.T @ vx)[1]
        return 0.5 * float(logs + left @ np.linalg.solve(v, left))

    def ours(group: float, white: float) -> float:
        scales = {c.name: contrasts.part(c).scale / contrasts.unit**2 for c in parts}
        logs = {"group": np.log(group * scales["group"]), "white": np.log(white * scales["white"])}
        prior = sum(np.exp(0.5 * x) for x in logs.values())
        return contrasts.nll(parts, {k: float(v) for k, v in logs.items()}) - float(prior)

    assert ours(4.0, 1.0) - ours(1.0, 2.0) == pytest.approx(textbook(4.0, 1.0) - textbook(1.0, 2.0), abs=1e-5)


def test_leaving_rows_out_is_predicting_them_from_the_others() -> None:
    y, flat, parts = one_way(6, 5, np.random.default_rng(4))
    variance = {"group": 4.0, "white": 1.0}
    score, p = precision(y, flat, parts, variance)
    out = np.array([3, 4, 20])
    rest = np.setdiff1d(np.arange(y.size), out)
    member = parts[0].columns
    assert member is not None
    known = [
        Component("group", member[rest]),
        Component("white", covariance=np.eye(rest.size)),
    ]
    fit = solve(y[rest], flat[rest], known, variance)
    predicted = flat[out] @ fit.flat + member[out] @ fit.amplitudes["group"]
    np.testing.assert_allclose(
        np.linalg.solve(p[np.ix_(out, out)], score[out]), y[out] - predicted, atol=1e-7
    )


def test_intervals_of_amplitudes_cover_with_estimated_variances() -> None:
    """95 % intervals of a smooth curve in 1/f noise; the bound is one in a thousand of a binomial law."""
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 4000.0, 60)
    curve = np.column_stack([np.cos(k * np.pi * t / 4000.0) for k in range(1, 6)])
    drift = ornstein_uhlenbeck(t, np.zeros(60), 500.0)
    half = np.linalg.cholesky(0.3 * drift + 1e-9 * np.eye(60))
    inside = 0
    for _ in range(40):
        a = rng.normal(0.0, 1.5, 5)
        y = curve @ a + half @ rng.standard_normal(60) + 0.5 * rng.standard_normal(60)
        parts = [
            Component("curve", curve),
            Component("drift", covariance=drift),
            Component("white", covariance=np.eye(60)),
        ]
        flat = np.ones((60, 1))
        variance = Contrasts(y, flat).fit(parts).variance
        found = solve(y, flat, parts, variance)
        std = np.sqrt(np.diag(widened(y, flat, parts, variance, found))[1:])
        inside += int(np.sum(np.abs(found.amplitudes["curve"] - a) < norm.ppf(0.975) * std))
    assert inside > binom.ppf(1e-3, 200, 0.92)


def test_a_long_record_is_seen_along_its_own_columns() -> None:
    """As good as exact: what is left out of a long record is noise."""
    rng = np.random.default_rng(6)
    t = np.linspace(0.0, 1.0, 500)
    curve = np.column_stack([np.cos(k * np.pi * t) for k in range(1, 9)])
    y = curve @ rng.normal(0.0, 1.0, 8) + 0.3 * rng.standard_normal(500)
    parts = [Component("curve", curve), Component("white", covariance=np.eye(500))]
    flat = np.ones((500, 1))
    exact = Contrasts(y, flat).fit(parts).variance
    short = Contrasts(y, flat, curve)
    assert short.fit(parts).variance["curve"] == pytest.approx(exact["curve"], rel=0.02)
    assert short.fit(parts).variance["white"] == pytest.approx(
        exact["white"], rel=3.0 / np.sqrt(MOST_DIRECTIONS)
    )


def test_processes_have_the_variances_that_they_are_named_for() -> None:
    t = np.array([0.0, 100.0, 400.0])
    points = ornstein_uhlenbeck(t, np.zeros(3), 200.0)
    np.testing.assert_allclose(points[0], np.exp(-t / 200.0))
    # The mean over a stretch much longer than the time constant: 2 tau / T (Papoulis, 1991, 12-4).
    assert ornstein_uhlenbeck(t, np.full(3, 2e5), 200.0)[0, 0] == pytest.approx(2.0 * 200.0 / 2e5, rel=0.01)
    assert wiener(t)[2, 2] == pytest.approx(1.0, abs=1e-5)
    assert wiener(t)[1, 2] == pytest.approx(0.25, abs=1e-5)
