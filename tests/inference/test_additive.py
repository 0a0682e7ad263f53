"""Variance components against closed forms: the balanced one-way layout, and what simulation says of intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, multivariate_normal, norm

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
    found = Contrasts(y, flat).fit(parts).variance
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


def test_what_is_expected_comes_back_and_is_not_doubted_for_its_size() -> None:
    """One that had died where another stood for it: the balanced layout has its variance to rounding."""
    groups, each = 30, 8
    y, flat, (member, white) = one_way(groups, each, np.random.default_rng(1))
    cell = y.reshape(groups, each)
    within = float(np.sum((cell - cell.mean(axis=1, keepdims=True)) ** 2) / (groups * (each - 1)))
    between = float(each * np.sum((cell.mean(axis=1) - y.mean()) ** 2) / (groups - 1))
    parts = [replace(c, expected=True) for c in (member, white)]
    found = Contrasts(y, flat).fit(parts, {"group": -30.0, "white": 0.0}).variance
    assert found["white"] == pytest.approx(within, rel=2e-3)
    assert found["group"] == pytest.approx((between - within) / each, rel=5e-3)


def test_a_toll_is_paid_once() -> None:
    y, flat, (member, white) = one_way(30, 8, np.random.default_rng(1))
    contrasts = Contrasts(y, flat)
    free, paid = contrasts.fit([member, white]), contrasts.fit([replace(member, toll=3.5), white])
    assert paid.nll == pytest.approx(free.nll + 3.5, abs=1e-6)
    assert contrasts.nll([replace(member, toll=3.5), white], free.log_variance) == pytest.approx(
        free.nll + 3.5, abs=0.2
    )


@pytest.mark.parametrize("slope", [False, True])
def test_likelihood_is_the_density_of_the_contrasts(slope: bool) -> None:
    """By the textbook's formula of the restricted likelihood, comparable between flat columns of any size."""
    y, flat, parts = one_way(6, 5, np.random.default_rng(3))
    flat = np.column_stack([flat, 7.0 * np.arange(y.size)]) if slope else flat
    contrasts = Contrasts(y, flat)
    (member, variance) = parts[0].columns, {"group": 4.0, "white": 1.0}
    assert member is not None
    v = 4.0 * member @ member.T + np.eye(y.size)
    vx = np.linalg.solve(v, flat)
    left = y - flat @ np.linalg.solve(flat.T @ vx, vx.T @ y)
    textbook = 0.5 * float(
        np.linalg.slogdet(v)[1] + np.linalg.slogdet(flat.T @ vx)[1] + left @ np.linalg.solve(v, left)
    )
    logs = {
        c.name: float(np.log(variance[c.name] * contrasts.part(c).scale / contrasts.unit**2)) for c in parts
    }
    prior = sum(np.exp(0.5 * x) for x in logs.values())
    assert contrasts.nll(parts, logs) - float(prior) == pytest.approx(textbook, abs=1e-5)


def test_columns_beyond_the_flat_ones_have_nothing_of_them() -> None:
    rng = np.random.default_rng(8)
    flat, column = rng.standard_normal((20, 2)), rng.standard_normal((20, 1))
    contrasts = Contrasts(rng.standard_normal(20), flat)
    np.testing.assert_allclose(contrasts.beyond(flat), 0.0, atol=1e-12)
    np.testing.assert_allclose(flat.T @ contrasts.beyond(column), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        contrasts.beyond(contrasts.beyond(column)), contrasts.beyond(column), atol=1e-12
    )


def _mixed() -> tuple[Floats, Floats, list[Component], dict[str, float]]:
    """A record with two flat columns, three amplitudes of one variance, and noise with a memory."""
    rng = np.random.default_rng(9)
    n = 12
    flat = np.column_stack([np.ones(n), np.arange(n) / n])
    memory = np.exp(-np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / 3.0)
    parts = [
        Component("part", rng.standard_normal((n, 3))),
        Component("noise", covariance=memory + np.eye(n)),
    ]
    return rng.standard_normal(n), flat, parts, {"part": 0.7, "noise": 0.4}


def test_covariance_of_a_solution_is_that_of_hendersons_equations() -> None:
    y, flat, parts, variance = _mixed()
    z, shape = parts[0].columns, parts[1].covariance
    assert z is not None
    assert shape is not None
    weight = np.linalg.inv(variance["noise"] * shape)
    both = np.column_stack([flat, z])
    matrix = both.T @ weight @ both
    matrix[2:, 2:] += np.eye(3) / variance["part"]
    found = solve(y, flat, parts, variance)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(matrix), atol=1e-8)
    np.testing.assert_allclose(
        np.concatenate([found.flat, found.amplitudes["part"]]),
        np.linalg.solve(matrix, both.T @ weight @ y),
        atol=1e-8,
    )


def test_what_variances_add_to_a_covariance_is_how_the_solution_moves_with_them() -> None:
    """Slopes by differences of solutions, and the expected information by its definition."""
    y, flat, parts, variance = _mixed()
    solution = solve(y, flat, parts, variance)

    def moved(name: str, step: float) -> Floats:
        found = solve(y, flat, parts, {**variance, name: variance[name] * np.exp(step)})
        return np.concatenate([found.flat, found.amplitudes["part"]])

    slopes = np.column_stack([(moved(n, 1e-4) - moved(n, -1e-4)) / 2e-4 for n in variance])
    _, p = precision(y, flat, parts, variance)
    z, shape = parts[0].columns, parts[1].covariance
    assert z is not None
    assert shape is not None
    each = [p @ (variance["part"] * z @ z.T), p @ (variance["noise"] * shape)]
    information = np.array([[0.5 * np.trace(a @ b) for b in each] for a in each])
    # Beside what the record tells stands a weak knowledge: a factor of e^2 either way.
    spread = np.linalg.inv(information + 0.25 * np.eye(2))
    added = widened(y, flat, parts, variance, solution) - solution.covariance
    np.testing.assert_allclose(added, slopes @ spread @ slopes.T, atol=1e-6)


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


def test_a_model_of_noise_alone_is_fitted_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    y, flat, (_, white) = one_way(10, 8, np.random.default_rng(4))
    found = Contrasts(y, flat).fit([white])
    assert found.variance["white"] == pytest.approx(float(np.var(y, ddof=1)), rel=0.05)
    assert capfd.readouterr() == ("", "")


def test_fits_beside_other_flat_columns_are_compared_by_their_evidence() -> None:
    """As under a prior so wide that only its constant is left, which as many columns share."""
    rng = np.random.default_rng(9)
    n = 30
    y, own = rng.standard_normal(n), rng.standard_normal((n, 2))
    parts = [
        Component("part", own, held=0.5, expected=True),
        Component("white", covariance=np.eye(n), held=0.8, expected=True),
    ]
    flats = [scale * rng.standard_normal((n, 3)) for scale in (1.0, 20.0)]
    noise = 0.5 * own @ own.T + 0.8 * np.eye(n)
    wide = [-multivariate_normal(np.zeros(n), noise + 1e4 * x @ x.T).logpdf(y) for x in flats]
    found = [Contrasts(y, x).fit(parts).nll for x in flats]
    assert found[1] - found[0] == pytest.approx(wide[1] - wide[0], abs=1e-3)
