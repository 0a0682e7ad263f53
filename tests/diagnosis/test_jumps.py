"""The scan for jumps: where they are, how much they gain, and how often noise looks like one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2

from gyrocal.diagnosis.gram import project
from gyrocal.diagnosis.hypotheses import Hypothesis
from gyrocal.diagnosis.jumps import scan
from gyrocal.diagnosis.whitening import NoiseLevels, NoiseModel
from tests.diagnosis.test_whitening import make_series

LEVELS = NoiseLevels(1.0, 7e-4, 2e-6)
SERIES = make_series(60)
MODEL = NoiseModel(SERIES)
SURFACE = np.column_stack([np.ones(len(SERIES)), SERIES.rate_dps, SERIES.temp_c - 20.0])


def test_a_jump_is_found_to_the_row_with_its_exact_gain() -> None:
    rng = np.random.default_rng(1)
    row = 301
    jump = (np.arange(len(SERIES)) >= row).astype(np.float64)
    y = MODEL.simulate(LEVELS, rng, 1)[:, 0] + 6e-3 * jump
    found = scan(SERIES, MODEL, LEVELS, y, SURFACE, rng)
    assert abs(int(np.argmax(found.gains)) + 1 - row) <= 1
    white = MODEL.whiten(LEVELS, np.column_stack([y, SURFACE, jump]))[0]
    exact, _ = project(white.T @ white, np.arange(3)).block(np.array([3]))
    # The variance of a score comes from 300 draws: 8 % (one sigma).
    assert found.gains[row - 1] == pytest.approx(exact, rel=0.3)
    assert found.at_s[row - 1] in found.candidates(3, 2)


def test_noise_looks_like_a_jump_as_rarely_as_it_says() -> None:
    noise = MODEL.simulate(LEVELS, np.random.default_rng(2), 60).T
    alarms = 0
    for k, y in enumerate(noise):
        found = scan(SERIES, MODEL, LEVELS, y, SURFACE, np.random.default_rng([3, k]))
        alarms += found.trials * float(chi2.sf(found.gains.max(), 1)) < 0.05
    assert alarms <= binom.ppf(0.999, 60, 0.05)


def test_a_finer_grid_here_makes_a_law_no_likelier() -> None:
    def law(instants: list[float]) -> Hypothesis:
        points = np.arange(len(instants))[:, None]
        return Hypothesis("bias_step", "time", "time", tuple({"at_s": t} for t in instants), points)

    coarse, fine = law([0.0, 10.0, 20.0, 30.0]), law([0.0, 10.0, 19.0, 20.0, 21.0, 30.0])
    assert coarse.weights.sum() == pytest.approx(1.0)
    assert fine.weights[2:5].sum() == pytest.approx(coarse.weights[2], rel=0.2)
