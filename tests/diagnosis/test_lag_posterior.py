"""Share and time constant of a coil's lag: known as well as the noise lets them be."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gyrocal.diagnosis.model.layers import full_model
from gyrocal.diagnosis.result import Estimate
from gyrocal.diagnosis.rows.means import means_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.coil import table_search
from gyrocal.diagnosis.sweeps.lag_posterior import lag_estimates
from gyrocal.physics.surface import Surface
from gyrocal.records.datasets import DataSetTable

SHARE, TAU_S = 0.6, 500.0
_SURFACE = Surface(
    np.array([[0.02, 0.05, 0.01], [0.3, 0.2, -0.05], [0.01, 0.0, 0.0], [-0.2, 0.03, 0.0]]),
    0.0,
    100.0,
    20.0,
    30.0,
)


def lagging(noise_dps: float, seed: int) -> DataSetTable:
    """Sweeps of the rate while the temperature swings, which a part of the coil follows late."""
    rates = np.tile([0.0, 20.0, -20.0, 60.0, -60.0, 100.0, -100.0], 16)
    t_s = 40.0 * np.arange(rates.size, dtype=np.float64)
    fine_s = np.arange(0.0, t_s[-1] + 1.0)
    temp_c = 20.0 + 25.0 * np.sin(fine_s / 800.0)
    inside_c = temp_c.copy()
    for k in range(1, inside_c.size):
        inside_c[k] += (temp_c[k - 1] - inside_c[k - 1]) / TAU_S + inside_c[k - 1] - inside_c[k]
    here_c, there_c = (np.interp(t_s, fine_s, x) for x in (temp_c, inside_c))
    outputs = [_SURFACE.output_dps(rates, x) for x in (here_c, there_c)]
    gyro = (1.0 - SHARE) * outputs[0] + SHARE * outputs[1]
    gyro = gyro + noise_dps * np.random.default_rng(seed).standard_normal(rates.size)
    return DataSetTable(Path("lag.csv"), rates, gyro, here_c, t_s=t_s)


def known_of(noise_dps: float, seed: int) -> dict[str, Estimate]:
    """What the posterior says beside the lag that was hidden."""
    search = table_search(full_model(means_of(series_of_table(lagging(noise_dps, seed))), memory=False))
    return lag_estimates([(1.0, search.fit((SHARE, TAU_S), (), None))])


def test_the_interval_of_a_lag_holds_it_and_goes_by_the_noise() -> None:
    quiet, noisy = known_of(1.5e-3, 1), known_of(3e-3, 1)
    for found in (quiet, noisy):
        for name, true in (("amplitude", SHARE), ("tau_s", TAU_S)):
            low, high = found[name].interval_95
            assert low < true < high
            assert found[name].value == true
    for name in ("amplitude", "tau_s"):
        # What is known of time constants beforehand narrows the wider one.
        assert 1.3 < noisy[name].std / quiet[name].std < 3.0
