"""What is recorded of a drive does not hang on the blocks that it came in."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gyrocal.navigation.track import Recorder, Track


def recorded(innovation_deg: np.ndarray[Any, np.dtype[np.float64]], cuts: list[int]) -> Track:
    """A track of innovations of deviation two, with nothing else in it."""
    robot = SimpleNamespace(gate_sigma=5.0)
    navigator = SimpleNamespace(covariance=np.zeros((9, 9)), counts=None, robot=robot, filtering=True)
    recorder = Recorder(cast(Any, navigator))
    for part in np.split(innovation_deg, cuts):
        nothing, rows = np.zeros(part.size), np.zeros((part.size, 9))
        block = SimpleNamespace(
            x_m=nothing, y_m=nothing, heading_deg=nothing, states=rows, std=rows, innovation_deg=part,
            innovation_sigma_deg=np.full(part.size, 2.0), drift_m=nothing,
        )  # fmt: skip
        recorder.add(cast(Any, block), np.ones(part.size, dtype=bool))
    return recorder.track(cast(Any, None), None)


@pytest.mark.parametrize("cuts", [[], [3], [2, 4, 5]])
def test_neighbouring_innovations_are_neighbours_across_blocks(cuts: list[int]) -> None:
    """Also over a row without a measurement."""
    nu = np.array([2.0, -4.0, np.nan, 2.0, 6.0, 2.0, -2.0])
    own = nu[np.isfinite(nu)]
    track = recorded(nu, cuts)
    assert track.whiteness.lag1 == pytest.approx(own[1:] @ own[:-1] / (own @ own))
    assert track.whiteness.nis == pytest.approx(np.mean((own / 2.0) ** 2))


def test_sums_of_innovations_go_on_across_blocks() -> None:
    nu = np.random.default_rng(1).normal(size=430)
    slow = [recorded(nu, cuts).whiteness for cuts in ([], [7, 130, 399])]
    assert slow[0].slow == pytest.approx(slow[1].slow)
    assert [one.sums for one in slow] == [4, 4]


def test_a_slip_that_the_gate_takes_counts_as_its_edge() -> None:
    """A path with a few bumps is described by a filter that gates them, and one with many is not."""
    nu = 2.0 * np.random.default_rng(2).normal(size=2000)
    few, many = nu.copy(), nu.copy()
    few[::400], many[::40] = 80.0, 80.0
    assert recorded(few, []).whiteness.nis == pytest.approx(1.0 + 25.0 / 400.0, abs=0.1)
    assert recorded(few, []).whiteness.describes
    assert not recorded(many, []).whiteness.describes
