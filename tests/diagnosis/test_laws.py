"""Columns of laws: what a robot that has the law takes off."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal.diagnosis.engine import series_of
from gyrocal.diagnosis.laws.at_rows import Laws, laws_of, wanted
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from tests.diagnosis.concealed_bench import make_recording, write_run

ON_ROBOTS = sorted(e.id for e in CATALOGUE.values() if e.runtime and wanted(e))


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> Laws:
    run = tmp_path_factory.mktemp("laws") / "run"
    write_run(make_recording([], 5, "even"), run)
    coefficients = np.zeros((4, 3))
    coefficients[:2, :2] = [[0.0, 0.1], [0.5, 0.2]]
    return laws_of(means_of(series_of(run)), Surface(coefficients, 0.0, 100.0, 25.0, 25.0))


@pytest.mark.parametrize("effect_id", ON_ROBOTS)
def test_a_law_that_has_a_name_is_the_one_that_a_robot_evaluates(laws: Laws, effect_id: str) -> None:
    """Its samples are as noisy as those of the bench; but for the rate of the temperature, which a whole record knows and a robot derives as it goes."""
    effect, c = CATALOGUE[effect_id], laws.conditions
    robot = Conditions(
        c.t_s,
        c.rate_dps,
        c.temp_c,
        since_power_on_s=c.since_power_on_s,
        supply_v=c.supply_v,
        temp_rate_c_per_s=c.temp_rate_c_per_s,
        sample_std_dps=c.sample_std_dps,
    )
    for trial in laws.trials(effect)[:3]:
        there = laws.means.spread(effect.unit_dps(robot, trial.shape, laws.surface))
        np.testing.assert_allclose(trial.columns[:, 0], there, atol=1e-9 * np.abs(there).max())
