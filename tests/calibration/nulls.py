"""Tables of an exact surface and nothing but noise, of many kinds: what no test may call structured."""

from __future__ import annotations

import numpy as np

from gyrocal.calibration.datasets import DataSets
from tests.calibration.simulation import SURFACE, Floats, flicker

KINDS = ("white", "growing", "tails", "flicker", "walk", "coarse", "jitter")


def _plan(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Rates and temperatures: chamber levels or a drifting box, up or up and down, rates in order or shuffled."""
    rates = np.linspace(-100.0, 100.0, int(rng.choice([9, 11, 13, 17, 21])))
    temps = np.linspace(-10.0, 50.0, int(rng.choice([4, 5, 7, 9])))
    if rng.random() < 0.5:
        temps = np.concatenate([temps[::2], temps[1::2][::-1]])
    if rng.random() < 0.4:
        size = rates.size * temps.size
        return np.tile(rates, temps.size), np.linspace(-10.0, 50.0, size) + rng.normal(0.0, 0.2, size)
    order = [rng.permutation(rates) if rng.random() < 0.5 else rates for _ in temps]
    rate = np.concatenate(order)
    return rate, np.repeat(temps, rates.size) + rng.normal(0.0, 0.3, rate.size)


def _noise(rng: np.random.Generator, kind: str, level_dps: float, rate: Floats) -> Floats:
    noise = rng.normal(0.0, level_dps, rate.size)
    if kind == "growing":
        return np.asarray(noise * (0.1 + np.abs(rate) / 50.0))
    if kind == "tails":
        return np.asarray(level_dps * rng.standard_t(4, rate.size))
    if kind == "flicker":
        return 0.3 * noise + flicker(rng, rate.size, level_dps)
    if kind == "walk":
        return np.asarray(noise + np.cumsum(rng.normal(0.0, 0.2 * level_dps, rate.size)))
    if kind == "jitter":
        return np.asarray(0.2 * noise + rate * rng.normal(0.0, level_dps / 50.0, rate.size))
    return noise


def null_table(rng: np.random.Generator, kind: str) -> DataSets:
    """One table; its noise is 1 to 50 mdeg/s, with or without times and sample noise."""
    rate, temp = _plan(rng)
    size, level = rate.size, float(10.0 ** rng.uniform(-3.0, -1.3))
    gyro = SURFACE.output_dps(rate, temp) + _noise(rng, kind, level, rate)
    if kind == "coarse":
        gyro = np.round(gyro / (2.0 * level)) * (2.0 * level)
    unknown = np.full(size, np.nan)
    samples, std, t_s = unknown, unknown, unknown
    if rng.random() < 0.5:
        samples = np.full(size, 200.0)
        spread = np.sqrt(rng.chisquare(199, size) / 199.0) * rng.choice([0.3, 1.0])
        std = 0.3 * level * np.sqrt(200.0) * spread
    if rng.random() < 0.5:
        soaks = np.cumsum(np.abs(np.diff(temp, prepend=temp[0])) > 3.0)
        t_s = np.arange(size) * 24.0 + soaks * 1800.0
    return DataSets(
        rate_dps=rate,
        gyro_dps=gyro,
        temp_c=temp,
        gyro_std_dps=std,
        n=samples,
        gyro_peak_dps=unknown,
        t_s=t_s,
        duration_s=np.where(np.isfinite(t_s), 20.0, np.nan),
        temp_rate_c_per_min=unknown,
        averaging_s=unknown,
        segment=np.arange(1, size + 1),
        outcome=np.full(size, "ok"),
        kind=np.full(size, "rate"),
        reference=np.full(size, "given"),
    )
