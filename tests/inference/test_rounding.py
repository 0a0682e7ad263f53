"""What rounding does to means, against rounded samples."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.inference.rounding import mean_error, slope_error


@pytest.mark.parametrize("noise_steps", [0.3, 0.4, 0.5])
def test_the_mean_is_off_by_as_much_at_most(noise_steps: float) -> None:
    rng = np.random.default_rng(1)
    truth = np.linspace(-0.5, 0.5, 21)
    means = np.array([np.round(rng.normal(m, noise_steps, 200_000)).mean() for m in truth])
    scatter = np.hypot(noise_steps, 12**-0.5)
    assert np.max(np.abs(means - truth)) == pytest.approx(mean_error(1.0, scatter), rel=0.1, abs=0.003)
    slope = (means[11] - means[9]) / (truth[11] - truth[9])
    assert abs(slope - 1.0) == pytest.approx(slope_error(1.0, scatter), rel=0.1, abs=0.04)


def test_it_goes_with_the_step() -> None:
    assert mean_error(0.02, 0.01) == pytest.approx(0.02 * mean_error(1.0, 0.5))
    assert slope_error(0.02, 0.01) == pytest.approx(slope_error(1.0, 0.5))
