"""Laws against each other for a block of smooth parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.blocks import evidence
from gyrocal.diagnosis.contest import Winner, best_law
from gyrocal.diagnosis.examine import alive, fit_anyhow
from gyrocal.diagnosis.laws import effects_of, laws_of
from gyrocal.diagnosis.layers import full_model, surface_of
from gyrocal.diagnosis.means import means_of
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.records.datasets import DataSetTable


def test_a_law_of_more_shapes_has_to_explain_more() -> None:
    """A rival is as much worse as its fit is, beside the logarithms of the roots of how many shapes either had."""
    t_s = 60.0 * np.arange(120.0)
    temp = 25.0 + 12.0 * np.sin(t_s / 900.0)
    late = np.interp(t_s - 200.0, t_s, temp)
    gyro = 0.01 + 4e-4 * (late - temp) + 3e-4 * np.random.default_rng(1).standard_normal(t_s.size)
    series = series_of_table(DataSetTable(Path("rest.csv"), np.zeros(t_s.size), gyro, temp, t_s=t_s))
    fitted = alive(fit_anyhow(full_model(means_of(series))))
    laws = laws_of(fitted.model.means, surface_of(fitted.model, fitted.solve()))
    (block,) = {b for b in fitted.model.blocks.values() if b == "memory"}
    without = evidence(fitted, block)[1]
    trials = [t for e in effects_of(block) for t in laws.trials(e)]

    def won(beside: str = "") -> Winner:
        left = [t for t in trials if t.effect.id != beside]
        found = best_law(fitted, without, block, left, laws)
        assert found is not None
        return found

    first = won()
    second = won(first.effect.id)
    assert second.shapes != first.shapes
    worse = second.fitted.nll - first.fitted.nll
    worse += 0.5 * float(np.log(second.shapes / first.shapes))
    worse += first.effect.search.prior_nats - second.effect.search.prior_nats
    assert first.rivals[second.effect.id] == pytest.approx(worse, abs=1e-6)
