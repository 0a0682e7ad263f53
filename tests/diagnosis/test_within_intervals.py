"""Intervals of patterns within data sets: from the scatter between sets, and of a decay time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import series_of
from gyrocal.diagnosis.estimates import of_pattern
from gyrocal.diagnosis.within import jackknife, patterns
from tests.diagnosis.concealed_bench import make_recording, write_run


def test_leaving_out_each_set_is_what_the_jackknife_does() -> None:
    rng = np.random.default_rng(3)
    sets = np.repeat(np.arange(8), 20)
    z = rng.standard_normal((sets.size, 2))
    y = z @ np.array([1.0, -2.0]) + rng.standard_normal(8)[sets]
    each = np.array([np.linalg.lstsq(z[sets != k], y[sets != k], rcond=None)[0] for k in range(8)])
    change = each - np.linalg.lstsq(z, y, rcond=None)[0]
    assert jackknife(y, z, sets) == pytest.approx(7.0 / 8.0 * change.T @ change)


def test_a_decay_time_has_an_interval(tmp_path: Path) -> None:
    write_run(make_recording([("step_response", 60.0)], 21, "even"), tmp_path / "run")
    (found,) = patterns(series_of(tmp_path / "run"), 0.01)
    assert found.effect == "step_response"
    for estimate in (of_pattern(found)[name] for name in ("tau_s", "amplitude")):
        low, high = estimate.interval_95
        assert low < estimate.value < high
        assert high - low < abs(estimate.value)
