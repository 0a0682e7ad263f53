"""A small simulator of data-set means and samples that shares nothing with the fit: numpy only, 1/f by FFT."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.datasets import DataSets
from gyrocal.inference.flicker import Rest, merge_rest, rest_of_windows
from gyrocal.physics.surface import Surface

Floats = NDArray[np.float64]

#: RD2100-like: 0.5 % nonlinearity, 2 % scale and 0.2 deg/s bias over temperature.
SURFACE = Surface(
    np.array(
        [[0.02, -0.08, 0.015], [0.3, 0.9, -0.1], [0.05, -0.02, 0.01], [-0.55, 0.04, 0.02]],
    ),
    0.0,
    100.0,
    20.0,
    30.0,
)


def flicker(
    rng: np.random.Generator, size: int, floor_dps: float, step_s: float = 1.0, finer: int = 4
) -> Floats:
    """1/f noise on a grid by FFT; ``S(f) = B^2 / (2 pi f)``, so that its Allan floor is 0.664 B = `floor_dps`."""
    # Made finer and averaged: a gyro averages over its sample time, so nothing is cut at Nyquist. What the finer grid
    # folds back is 3 % of the Allan variance at one step for 4, and 0.3 % for 16.
    fine, step_s = finer * size, step_s / finer
    b = floor_dps / 0.664
    padded = 1 << int(np.ceil(np.log2(2 * fine)))
    f = np.fft.rfftfreq(padded, step_s)
    f[0] = np.inf
    amplitude = np.sqrt(b**2 / (2 * np.pi * f) / (2 * step_s) * padded)
    spectrum = amplitude * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2)
    wandering = np.fft.irfft(spectrum, padded)[:fine].reshape(-1, finer).mean(axis=1) * np.sqrt(2)
    # 1/f goes on below the lowest frequency of the grid, down to 1 uHz: a constant for as long as this lasts.
    slow = b * np.sqrt(np.log(max(1e6 / (padded * step_s), 1.0)) / np.pi)
    return np.asarray(wandering + slow * rng.spawn(1)[0].standard_normal())


def schedule(rng: np.random.Generator, rates: Floats, temps: Floats, set_s: float, soak_s: float) -> Floats:
    """Rows (start in s, rate, temperature): rates shuffled at each temperature, a soak between temperatures."""
    rows, t_s = [], 0.0
    for temp in temps:
        t_s += soak_s
        for rate in rng.permutation(rates):
            rows.append((t_s, rate, temp))
            t_s += set_s + 4.0
    return np.array(rows)


def simulate(
    rng: np.random.Generator,
    *,
    surface: Surface = SURFACE,
    rates: Floats | None = None,
    temps: Floats | None = None,
    set_s: float = 20.0,
    arw_dps_rt_s: float = 1.389e-3,
    floor_dps: float = 5e-4,
    jitter: float = 5e-6,
    timed: bool = True,
) -> DataSets:
    """Data sets of a bench run: angle random walk, 1/f bias noise, table jitter; sample rate 10 Hz."""
    rates = np.linspace(-100.0, 100.0, 17) if rates is None else rates
    temps = np.array([-10.0, 10.0, 30.0, 50.0, 40.0, 20.0, 0.0]) if temps is None else temps
    start_s, rate, temp = schedule(rng, rates, temps, set_s, 1800.0).T
    bias = flicker(rng, int(start_s[-1] + set_s) + 2, floor_dps)
    return observe(rng, start_s, rate, temp, bias, surface, set_s, arw_dps_rt_s, jitter, timed)


def observe(
    rng: np.random.Generator,
    start_s: Floats,
    rate: Floats,
    temp: Floats,
    bias: Floats,
    surface: Surface,
    set_s: float,
    arw_dps_rt_s: float,
    jitter: float,
    timed: bool,
) -> DataSets:
    """Data sets at given times; `bias` is the drift, a value a second."""
    size = rate.size
    temp = temp + rng.normal(0, 0.3, size)
    drift = np.array([bias[int(s) : int(s + set_s)].mean() for s in start_s])
    true_rate = rate * (1.0 + jitter * rng.standard_normal(size))
    noise = rng.normal(0.0, arw_dps_rt_s / np.sqrt(set_s), size) + drift
    gyro = surface.output_dps(true_rate, temp) + noise
    samples = set_s * 10
    std = arw_dps_rt_s * np.sqrt(10.0) * np.sqrt(rng.chisquare(samples - 1, size) / (samples - 1))
    unknown = np.full(size, np.nan)
    return DataSets(
        rate_dps=rate,
        gyro_dps=gyro,
        temp_c=temp,
        gyro_std_dps=std,
        n=np.full(size, samples),
        gyro_peak_dps=unknown,
        t_s=start_s + set_s / 2 if timed else unknown,
        duration_s=np.full(size, set_s) if timed else unknown,
        temp_rate_c_per_min=unknown,
        averaging_s=np.full(size, 0.1),
        segment=np.arange(1, size + 1),
        outcome=np.full(size, "ok"),
        kind=np.full(size, "rate"),
        reference=np.full(size, "given"),
    )


def quick_run(
    rng: np.random.Generator, *, floor_dps: float = 5e-4, jitter: float = 1e-5
) -> tuple[DataSets, Rest]:
    """A quick run: five temperatures, twelve data sets of 10 s each, 15 min at rest at 20 deg C and steady soaks."""
    set_s, arw = 10.0, 1.389e-3
    rates = np.array([-100.0, -85.0, -65.0, -40.0, -15.0, 15.0, 40.0, 65.0, 85.0, 100.0])
    rows, quiet, t_s = [], [], 0.0
    for temp in (-10.0, 20.0, 50.0, 35.0, 5.0):
        t_s += 2700.0
        quiet.append((t_s - 600.0, t_s))
        if temp == 20.0:
            quiet.append((t_s, t_s + 900.0))
            t_s += 900.0
        for rate in (0.0, *rng.permutation(rates), 0.0):
            rows.append((t_s, rate, temp))
            t_s += set_s + 4.0
    start_s, rate, temp_c = np.array(rows).T
    bias = flicker(rng, int(t_s) + 2, floor_dps)
    sets = observe(rng, start_s, rate, temp_c, bias, SURFACE, set_s, arw, jitter, timed=True)
    records = []
    for start, end in quiet:
        window = 15
        drift = bias[int(start) : int(end)].reshape(-1, window).mean(axis=1)
        noisy = drift + rng.normal(0.0, arw / np.sqrt(window), drift.size)
        middle = window * (np.arange(drift.size) + 0.5)
        records.append(rest_of_windows(middle, noisy, np.full(drift.size, np.nan), float(window)))
    rest = merge_rest(records)
    if rest is None:
        raise ValueError
    return sets, rest
