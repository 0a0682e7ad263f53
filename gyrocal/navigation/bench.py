"""A bench run of the robot's gyro, at the level of data sets: quick enough for a Monte Carlo of hundreds of units.

Same unit, same noise (every sample comes from `GyroStream`), the paper's rates and temperatures and its least
squares (eq. 5); the chamber's ramps and the table's own errors, which `gyrocal acquire --simulate` has, are not in it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrocal.fusion import Coefficients, Valid
from gyrocal.physics.gyro import GyroModel, GyroStream
from gyrocal.physics.surface import SHAPE, Surface

#: The paper's bench: -100..100 deg/s, here in steps of 10, and -10..50 deg C in steps of 10; 20 s a data set.
RATES_DPS = np.linspace(-100.0, 100.0, 21)
TEMPERATURES_C = np.linspace(-10.0, 50.0, 7)
DATA_SET_S = 20.0


def calibrate_unit(model: GyroModel, rng: np.random.Generator) -> Coefficients:
    """Coefficients of one unit from its simulated data sets, by the paper's least squares.

    The error of eq. 1 is regressed on gyro output and reported temperature; data-set means keep the sample noise
    in the regressor below 1e-4 of its span.
    """
    gyro = GyroStream(model, rng)
    dt_s = 1.0 / model.sample_rate_hz
    samples = round(DATA_SET_S / dt_s)
    rate, temp = (a.ravel() for a in np.meshgrid(RATES_DPS, TEMPERATURES_C))
    mean_dps, mean_c = np.empty(rate.size), np.empty(rate.size)
    for k in range(rate.size):
        mean_dps[k] = gyro.samples(dt_s, np.full(samples, rate[k]), temp[k]).mean()
        mean_c[k] = gyro.temperatures(np.full(samples, temp[k])).mean()
    empty = Surface(np.zeros(SHAPE), 0.0, float(RATES_DPS[-1]), float(TEMPERATURES_C.mean()), 30.0)
    design = empty.design(mean_dps, mean_c)
    error = mean_dps - rate  # eq. 1
    solution = np.asarray(np.linalg.lstsq(design, error)[0], dtype=np.float64)
    scatter = error - design @ solution
    variance = float(scatter @ scatter) / (error.size - solution.size)
    surface = replace(empty, coefficients_dps=solution.reshape(SHAPE))
    valid = Valid((float(mean_dps.min()), float(mean_dps.max())), (float(mean_c.min()), float(mean_c.max())))
    return Coefficients(
        sensor={"model": "KVH E-Core RD2100, simulated"},
        surface=surface,
        covariance_dps2=np.asarray(variance * np.linalg.inv(design.T @ design), dtype=np.float64),
        valid=valid,
        provenance={"method": "least squares on simulated data sets", "data_sets": int(rate.size)},
    )
