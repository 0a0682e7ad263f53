"""Newton's steps against minima that are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.inference.newton import SETTLED, descend

Floats = NDArray[np.float64]
WIDE = np.array([[-40.0, 5.0], [-40.0, 5.0]])


@dataclass(frozen=True)
class Scatter:
    """Mean squares of two samples, of the sizes 50 and 20, under variances that add up in the second: nats."""

    logs: Floats
    squares: tuple[float, float]

    @property
    def _variances(self) -> Floats:
        size = np.exp(self.logs)
        return np.array([size[0], size.sum()])

    @property
    def _of_size(self) -> Floats:
        """How the two variances follow the logarithms, shape (2, 2)."""
        size = np.exp(self.logs)
        return np.array([[size[0], 0.0], [size[0], size[1]]])

    @property
    def value(self) -> float:
        v = self._variances
        return float(0.5 * np.array([50.0, 20.0]) @ (np.log(v) + np.array(self.squares) / v))

    @property
    def slope(self) -> Floats:
        v = self._variances
        return np.asarray(
            (0.5 * np.array([50.0, 20.0]) * (1 / v - np.array(self.squares) / v**2)) @ self._of_size
        )

    @property
    def bend(self) -> Floats:
        expected = 0.5 * np.array([50.0, 20.0]) / self._variances**2
        return np.asarray(self._of_size.T * expected @ self._of_size)


def test_the_minimum_is_found_from_far() -> None:
    for first in (np.array([-20.0, -20.0]), np.array([4.0, 4.0]), np.array([-3.0, 1.0])):
        logs, there = descend(lambda x: Scatter(x, (1.0, 3.0)), first, WIDE)
        assert np.exp(logs) == pytest.approx([1.0, 2.0], rel=0.05)
        assert there.value - Scatter(np.log([1.0, 2.0]), (1.0, 3.0)).value < SETTLED


def test_a_variance_that_is_none_goes_away() -> None:
    logs, there = descend(lambda x: Scatter(x, (1.0, 0.4)), np.zeros(2), WIDE)
    assert logs[1] < -9.0
    mean = (50.0 * 1.0 + 20.0 * 0.4) / 70.0
    assert there.value == pytest.approx(35.0 * (np.log(mean) + 1.0), abs=SETTLED)


def test_bounds_hold() -> None:
    held = np.array([[0.5, 0.5], [-40.0, 0.2]])
    logs, _ = descend(lambda x: Scatter(x, (1.0, 30.0)), np.array([0.5, -1.0]), held)
    assert logs == pytest.approx([0.5, 0.2], abs=1e-12)


def test_where_there_is_no_function_steps_are_shorter() -> None:
    def within(logs: Floats) -> Scatter:
        if logs[1] < -1.0:
            raise np.linalg.LinAlgError
        return Scatter(logs, (1.0, 1.5))

    logs, _ = descend(within, np.array([0.0, 2.0]), WIDE)
    assert np.exp(logs) == pytest.approx([1.0, 0.5], rel=0.1)


@dataclass(frozen=True)
class Valley:
    """A quadratic function whose valley runs askew: cut short along one axis, the way to its bottom leads up its side."""

    logs: Floats

    bend = np.array([[1.0, 9.99], [9.99, 100.0]])
    bottom = np.array([-20.0, 2.0])

    @property
    def value(self) -> float:
        away = self.logs - self.bottom
        return float(0.5 * away @ self.bend @ away)

    @property
    def slope(self) -> Floats:
        return np.asarray(self.bend @ (self.logs - self.bottom))


def test_a_step_that_is_cut_short_goes_no_way_up() -> None:
    first = np.zeros(2)
    logs, there = descend(Valley, first, WIDE)
    assert there.value < SETTLED < Valley(first).value
    assert logs == pytest.approx(Valley.bottom, abs=1.0)
