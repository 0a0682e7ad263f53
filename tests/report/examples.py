"""Small recordings made on the spot, with a known truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.corrected import Examined
from gyrocal.calibration.datasets import DataSets
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: A surface of the size of the paper's figure 1.
#: Scatter that the examples expect of a data set.
SIGMA_DPS = 1e-3
SURFACE = Surface(
    np.array([[0.05, 0.02, -0.01], [0.4, -0.3, 0.02], [-0.05, 0.01, 0.0], [-0.6, 0.2, 0.01]]),
    0.0,
    100.0,
    20.0,
    30.0,
)


def examined(
    rate_dps: Floats,
    residual_dps: Floats,
    temp_c: Floats | float = 20.0,
    t_s: Floats | float = np.nan,
    gyro_std_dps: float = np.nan,
    n: float = np.nan,
) -> Examined:
    """Data sets of a gyro with `SURFACE` and a given residual."""
    size = rate_dps.size

    def full(value: Floats | float) -> Floats:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (size,)).copy()

    temp = full(temp_c)
    gyro = SURFACE.output_dps(rate_dps + residual_dps, temp)
    sets = DataSets(
        rate_dps=rate_dps,
        gyro_dps=gyro,
        temp_c=temp,
        gyro_std_dps=full(gyro_std_dps),
        n=full(n),
        gyro_peak_dps=full(np.nan),
        t_s=full(t_s),
        duration_s=full(np.nan),
        temp_rate_c_per_min=full(np.nan),
        averaging_s=full(np.nan),
        segment=np.arange(1, size + 1),
        outcome=np.full(size, "ok"),
        kind=np.full(size, "rate"),
        reference=np.full(size, "given"),
    )
    return Examined(sets, residual_dps, np.diag(full(SIGMA_DPS**2)), np.zeros(size, dtype=bool))


def grid(noise_dps: float = 1e-3, seed: int = 1) -> Examined:
    """21 rates at 7 temperatures, up and down, timed."""
    rng = np.random.default_rng(seed)
    temps = np.array([-10.0, 10, 30, 50, 40, 20, 0])
    rate = np.concatenate([rng.permutation(np.linspace(-100, 100, 21)) for _ in temps])
    temp = np.repeat(temps, 21) + rng.normal(0, 0.1, rate.size)
    residual = rng.normal(0, noise_dps, rate.size)
    t_s = np.arange(rate.size) * 30.0 + np.repeat(np.arange(7), 21) * 3600.0
    return examined(rate, residual, temp, t_s, gyro_std_dps=4e-3, n=200.0)
