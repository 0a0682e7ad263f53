"""What is to be added to a simulation holds the laws of the bench too, which no coefficient file keeps."""

from __future__ import annotations

import numpy as np

from gyrocal.diagnosis.columns import conditions_of
from gyrocal.diagnosis.engine import Options
from gyrocal.diagnosis.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import left_by, versus
from gyrocal.diagnosis.versus.law_file import python_file
from tests.diagnosis.versus.tables import SURFACE, plan, table
from tests.diagnosis.versus.test_law_file import function_of

NOISE_DPS = 3e-4


def test_a_drift_of_the_bias_is_added_as_the_law_that_it_is() -> None:
    t, rate, temp = plan(12)
    drift = 20e-3 * t / 3600.0
    noise = np.random.default_rng(1).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    real = series_of_table(table("real.csv", t, rate, simulated + drift + noise, temp))
    answer = versus(real, series_of_table(table("sim.csv", t, rate, simulated, temp)), Options(heldout=False))
    assert [e.effect for e in answer.diagnosis.effects] == ["bias_drift"]
    assert answer.comparison is None
    difference = answer.match.difference
    # Noise, and the simulation's surface and the drift as they are estimated, in 156 sets.
    assert np.std(left_by(answer.law, difference)) < 1.2 * NOISE_DPS
    added = function_of(python_file(answer.law, answer.match.surface, "T.", "- f"))
    c = conditions_of(difference)
    law = added(rate, temp, t_s=t, since_power_on_s=c.need("since_power_on_s"))
    np.testing.assert_allclose(law, drift, atol=5 * NOISE_DPS)
    entry = answer.to_json()["law"]["terms"][-1]
    assert entry["effect"] == "bias_drift"
    low, high = entry["parameters"]["amplitude"]["interval_95"]
    assert low < 20.0 < high
