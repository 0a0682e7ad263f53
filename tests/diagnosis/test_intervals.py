"""Intervals of amplitudes that are traded against a shape."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from gyrocal.diagnosis.answer.locate import block_p_value
from gyrocal.diagnosis.laws.at_rows import Laws
from gyrocal.diagnosis.laws.estimates import of_draws
from gyrocal.diagnosis.laws.scan import Scan
from gyrocal.diagnosis.model.intervals import (
    Point,
    along_axis,
    amplitude_interval,
    instant_interval,
    of_mass,
    profile_interval,
    shapes_within,
)
from gyrocal.diagnosis.model.layers import Fitted, Law
from gyrocal.diagnosis.model.rate_errors import of_a_table
from gyrocal.diagnosis.result import Estimate
from gyrocal.physics.catalogue import find_effect

Floats = NDArray[np.float64]


def test_shape_that_no_row_shows_says_nothing_of_the_amplitude() -> None:
    """A knee above the highest rate leaves a column of zeros: no amplitude, and no bound from it."""

    points = [Point(500.0 + (knee - 80.0) ** 2, 2.0, 0.1) for knee in np.linspace(79.0, 100.0, 15)]
    interval = amplitude_interval([*points, Point(0.0, 0.0, float("inf"))])
    # The best of the shapes that show allow for 95 % by themselves.
    assert interval == pytest.approx((2.0 - 0.196, 2.0 + 0.196), abs=0.02)


def test_an_interval_reaches_over_all_shapes_that_fit_as_well() -> None:
    """Amplitude and phase of a sine: what its fifth order fixes is the amplitude times the fourth power."""
    phases = np.geomspace(0.5, 2.0, 15)
    points = [Point(0.0, 3.0 / phase**4, 0.01) for phase in phases]
    low, high = amplitude_interval(points)
    assert low == pytest.approx(3.0 / 2.0**4, abs=0.03)
    assert high == pytest.approx(3.0 / 0.5**4, abs=0.03)


def test_an_amplitude_follows_a_shape_that_is_known_to_a_percent() -> None:
    """Shapes are tried within the interval of the shape, however narrow it is."""
    shapes = shapes_within((1.0 - 1.96 * 0.005, 1.0 + 1.96 * 0.005))
    points = [Point(((x - 1.0) / 0.005) ** 2, 5.0 - 4.0 * (x - 1.0) / 0.005, 0.1) for x in shapes]
    low, high = amplitude_interval([Point(0.0, 5.0, 0.1), *points])
    # An ellipse of two that go together: 1.96 of the root of the sum of squares.
    assert (low, high) == pytest.approx((5.0 - 1.96 * 4.0, 5.0 + 1.96 * 4.0), abs=0.2)


def test_a_profile_on_a_grid_is_read_between_its_points() -> None:
    values = np.linspace(0.0, 10.0, 101)
    low, high = along_axis(values, 7.0 + (values - 4.0) ** 2, 7.0)
    assert (low, high) == pytest.approx((4.0 - 1.96, 4.0 + 1.96), abs=0.02)
    assert along_axis(values, np.zeros(101), 0.0) == (0.0, 10.0)


def test_a_shape_reaches_to_where_its_likelihood_has_fallen() -> None:
    """Of a normal law that is 1.96 standard deviations either way."""
    interval = profile_interval(lambda x: ((x - 5.0) / 0.2) ** 2, 5.0, (0.1, 100.0))
    assert interval == pytest.approx((5.0 - 0.392, 5.0 + 0.392), abs=2e-3)
    assert Estimate.spanning(5.0, interval, "1").std == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize("limits", [(4.0, 6.0), (0.1, 6.0), (4.0, 100.0)])
def test_a_bound_beyond_the_interval_is_no_end_of_it(limits: tuple[float, float]) -> None:
    interval = profile_interval(lambda x: ((x - 5.0) / 0.2) ** 2, 5.0, limits)
    assert interval == pytest.approx((5.0 - 0.392, 5.0 + 0.392), abs=2e-3)
    assert profile_interval(lambda x: ((x - 5.0) / 0.2) ** 2, 5.0, (4.9, 5.1)) == (4.9, 5.1)


def test_the_instant_of_a_jump_has_an_interval_of_its_own_law() -> None:
    """The likelihood has a corner there: 95 % is a rise of -2 log(1 - sqrt(0.95)), not of a chi-square."""
    instants = np.arange(21.0)
    rise = -2.0 * np.log(1.0 - np.sqrt(0.95))
    for slope, last in ((rise / 3.01, 3), (rise / 2.99, 2)):
        losses = slope * np.abs(instants - 10.0)

        def loss(at_s: float, losses: Floats = losses) -> float:
            return float(losses[round(at_s)])

        assert instant_interval(loss, 10.0, instants) == (10.0 - last - 0.5, 10.0 + last + 0.5)


def test_the_size_of_draws_is_within_its_likelihood() -> None:
    """A likelihood that is normal in the logarithm of the variance, of a standard deviation of 0.5."""

    def nll(components: object, logs: dict[str, float]) -> float:
        return float(0.5 * ((logs["each rate"] - np.log(4e-8)) / 0.5) ** 2)

    fit = SimpleNamespace(log_variance={"each rate": np.log(4e-8)}, variance={"each rate": 4e-8})
    basis = SimpleNamespace(frame=SimpleNamespace(rate_scale_dps=100.0))
    model = SimpleNamespace(all=[], basis=basis)
    fitted = cast(Fitted, SimpleNamespace(fit=fit, contrasts=SimpleNamespace(nll=nll), model=model))
    found = of_draws(fitted)
    assert of_a_table(fitted)
    assert found.value == pytest.approx(2.0)
    assert found.interval_95 == pytest.approx((2.0 * np.exp(-0.49), 2.0 * np.exp(0.49)), rel=0.02)


def test_no_table_errs_by_a_percent_from_rate_to_rate() -> None:
    """About the edges of a dead zone 30 % were told as the table's."""
    basis = SimpleNamespace(frame=SimpleNamespace(rate_scale_dps=100.0))
    for share, expected in ((0.0099, True), (0.0101, False)):
        fit = SimpleNamespace(variance={"each rate": (100.0 * share) ** 2})
        fitted = SimpleNamespace(fit=fit, model=SimpleNamespace(basis=basis))
        assert of_a_table(cast(Fitted, fitted)) is expected


def test_a_variance_that_may_be_zero_is_tested_at_the_edge_of_its_range() -> None:
    """Half of the law is at zero: half of the tail of chi-square, for each of the blocks."""
    nats = 0.5 * float(chi2.isf(0.002, 1))
    assert block_p_value(nats, 1) == pytest.approx(0.001)
    assert block_p_value(nats, 9) == pytest.approx(0.009)
    assert block_p_value(-1.0, 9) == 1.0


def test_a_shape_that_does_next_to_nothing_has_no_amplitude_and_no_overflow() -> None:
    """A Gauss peak far from every rate is all but zero, and the inverse of its square is no number."""
    n = 12
    scan = Scan(
        find_effect("mechanical_resonance"), cast(Laws, None), np.eye(n)[:, :1], np.ones(n), np.eye(n)
    )
    point = scan.of(np.full((n, 1), 1e-160), {"center_dps": 50.0, "width_dps": 1.0})
    assert (point.loss, point.amplitude, point.std) == (0.0, 0.0, np.inf)


def test_what_a_law_does_to_the_scale_factor_is_told_at_a_hundred_degrees_a_second() -> None:
    """Its only figure had been that of a bias of nothing."""
    rng = np.random.default_rng(4)
    rate, cubed = np.tile([-150.0, -50.0, 50.0, 150.0], 30), np.repeat(np.linspace(-1.0, 1.0, 30) ** 3, 4)
    columns = 1e-3 * np.column_stack([cubed, cubed * rate / 150.0])
    noise = 1e-3 * rng.standard_normal(rate.size)
    precision = np.eye(rate.size) / 1e-6
    law = Law("temperature_order", {"order": 3.0, "rate_scale_dps": 150.0}, columns)
    score = precision @ (columns @ [0.0, 45.0] + noise)
    scan = Scan(find_effect(law.effect), cast(Laws, None), np.ones((rate.size, 1)), score, precision)
    told = scan.on_scale(law)
    low, high = told.interval_95
    assert low < 30.0 < high
    assert high - low < 2.0
    assert told.unit == "mdeg/s"


@pytest.mark.parametrize("true", [1.0, 0.8, 0.0])
def test_an_interval_of_what_has_a_bound_holds_the_truth_at_the_bound_as_elsewhere(true: float) -> None:
    """A share of a lag cannot be more than the whole: one that is the whole lay above 14 of 17 intervals."""
    values, rng = np.linspace(-1.0, 1.0, 81), np.random.default_rng(5)
    inside = 0
    for seen in true + 0.1 * rng.standard_normal(400):
        low, high = of_mass(values, np.exp(-0.5 * ((values - seen) / 0.1) ** 2))
        inside += low <= true <= high
    assert inside / 400 > 0.93
