"""Allan variances against published values, another library, and what they vary by in simulation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.inference.allan import POWERS, AllanCurve, AllanSums, covariance_parts
from tests.inference.allan_reference import overlapping_avar

Floats = NDArray[np.float64]


def test_the_nine_numbers_of_nbs_14() -> None:
    """NBS Monograph 140, annex 8.E, as in Riley, NIST SP 1065, table 31: overlapping Allan deviation."""
    values = np.array([892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0])
    found = [np.sqrt(overlapping_avar(values, m)) for m in (1, 2)]
    np.testing.assert_allclose(found, [91.22945, 85.95287], rtol=1e-7)


def test_the_thousand_numbers_of_sp_1065() -> None:
    """Riley, NIST SP 1065, section 12.4: a congruential generator, and its overlapping Allan deviation."""
    number, values = 1234567890, []
    for _ in range(1000):
        values.append(number / 2147483647)
        number = 16807 * number % 2147483647
    found = [np.sqrt(overlapping_avar(np.array(values), m)) for m in (1, 10, 100)]
    np.testing.assert_allclose(found, [2.922319e-01, 9.159953e-02, 3.241343e-02], rtol=2e-7)


def curve_of(values: Floats, dt_s: float, cuts: list[int]) -> AllanCurve:
    sums = AllanSums(dt_s)
    for part in np.split(values, cuts):
        sums.add(part)
    return sums.curve()


def test_a_stream_gives_what_the_whole_record_gives() -> None:
    values = 5.0 + np.random.default_rng(1).normal(size=10_000)
    curve = curve_of(values, 0.1, [1, 2, 900, 903, 4000])
    np.testing.assert_array_equal(curve.factor, 2 ** np.arange(12))
    whole = [overlapping_avar(values, m) for m in curve.factor.tolist()]
    np.testing.assert_allclose(curve.avar[:6], whole[:6], rtol=1e-9)
    # Beyond 32 samples a stretch starts at every 32nd of tau only.
    np.testing.assert_allclose(curve.avar[6:], whole[6:], rtol=0.03)
    np.testing.assert_allclose(curve.tau_s, 0.1 * curve.factor)
    assert curve.record_s == pytest.approx(1000.0)


def test_no_estimate_bridges_a_gap() -> None:
    values = np.random.default_rng(2).normal(size=4096)
    sums = AllanSums(0.1)
    sums.add(values)
    sums.cut()
    sums.add(values + 50.0)
    curve, one = sums.curve(), curve_of(values, 0.1, [])
    np.testing.assert_allclose(curve.avar[: one.factor.size], one.avar, rtol=1e-9)
    assert curve.lengths.tolist() == [4096]
    assert curve.repeats.tolist() == [2]


def test_estimates_of_another_library() -> None:
    allantools = pytest.importorskip("allantools", reason="allantools is a dependency of development only")
    values = np.random.default_rng(3).normal(size=20_000)
    curve = curve_of(values, 0.5, [])
    adev = allantools.oadev(values, rate=2.0, data_type="freq", taus=curve.tau_s)[1]
    np.testing.assert_allclose(np.sqrt(curve.avar[:6]), adev[:6], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(curve.avar[6:]), adev[6:], rtol=0.03)


def degrees_of_freedom(curve: AllanCurve, coefficients: list[float]) -> Floats:
    c = np.array(coefficients)
    variance = np.einsum("aakl,k,l->a", covariance_parts(curve), c, c)
    expected = curve.tau_s[:, None] ** np.array(POWERS, dtype=float) @ c
    return np.asarray(2.0 * expected**2 / variance)


@pytest.mark.parametrize(("part", "alpha"), [(0, 2), (1, 0), (2, -1), (3, -2)])
def test_degrees_of_freedom_of_each_noise(part: int, alpha: int) -> None:
    """Greenhall and Riley 2003: their formula interpolates, for white noise to 6 %."""
    allantools = pytest.importorskip("allantools", reason="allantools is a dependency of development only")
    curve = curve_of(np.random.default_rng(4).normal(size=20_000), 1.0, [])
    coefficients = np.eye(4)[part].tolist()
    theirs = [
        allantools.edf_greenhall(alpha, 2, m, 20_001, overlapping=True, modified=False)
        for m in curve.factor.tolist()
    ]
    if part == 0:
        # Their record has a difference at every start, ours at each 32nd of tau: of white angle noise each is another.
        theirs = [edf / max(m // 32, 1) for edf, m in zip(theirs, curve.factor.tolist(), strict=True)]
    rows = slice(4, None)
    np.testing.assert_allclose(degrees_of_freedom(curve, coefficients)[rows], theirs[rows], rtol=0.06)


def test_the_spread_of_white_angle_noise_is_that_of_simulated_records() -> None:
    """A ring laser's: with a difference at every start it would be half as large at 4 times 32 samples."""
    rng = np.random.default_rng(21)
    curves = [curve_of(np.diff(rng.normal(size=20_001)), 1.0, []) for _ in range(150)]
    values = np.log([c.avar for c in curves])[:, 5:10]
    expected = np.sqrt(2.0 / degrees_of_freedom(curves[0], [3.0, 0.0, 0.0, 0.0])[5:10])
    # 150 values tell a standard deviation to 6 %.
    np.testing.assert_allclose(values.std(axis=0, ddof=1) / expected, 1.0, atol=0.23)


def test_degrees_of_freedom_by_hand() -> None:
    """Differences of neighbouring white samples have correlation -1/2 with the next: 2/3 of a degree for each."""
    curve = curve_of(np.random.default_rng(5).normal(size=3001), 1.0, [])
    assert degrees_of_freedom(curve, [0, 1, 0, 0])[0] == pytest.approx(2.0 / 3.0 * 3000, rel=1e-3)


def test_covariance_is_that_of_simulated_noise() -> None:
    """White noise and random walk together, 4000 records: each correlation within 4.5 standard errors."""
    rng, runs = np.random.default_rng(6), 4000
    values = []
    for _ in range(runs):
        noise = rng.normal(size=512) + np.cumsum(rng.normal(0.0, 0.1, 512))
        curve = curve_of(noise, 1.0, [])
        values.append(curve.avar)
    c = np.array([0.0, 1.0, 0.0, 0.01 / 3.0])
    expected = np.einsum("abkl,k,l->ab", covariance_parts(curve), c, c)
    scale = np.sqrt(np.diag(expected))
    found = np.cov(np.array(values).T)
    # The variance of a sum of squares with few degrees of freedom is known worse than that of a normal value.
    few = np.sqrt(1.0 + 6.0 / degrees_of_freedom(curve, c.tolist()))
    # The walk of a sample adds within it what the continuous law takes for a third less: 1 % of the shortest.
    np.testing.assert_array_less(
        np.abs(found - expected) / np.outer(scale, scale),
        4.5 * np.outer(few, few) * np.sqrt(2.0 / runs) + 0.02,
    )
