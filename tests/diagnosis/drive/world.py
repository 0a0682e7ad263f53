"""A simulated drive that shares no formula with the finder: the motion is integrated finely, effects act where they arise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrocal.records.drive import DriveBlock

Floats = NDArray[np.float64]

SEPARATION_M = 0.57
_FINE = 10


@dataclass(frozen=True)
class Hidden:
    """What is concealed in a drive; zeros: nothing. `lag_s`, a first-order lag of the wheels, is in no catalogue."""

    delay_s: float = 0.0
    slip: float = 0.0
    slip_exponent: float = 0.0
    asymmetry: float = 0.0
    bias_dps: float = 0.0
    eccentricity: float = 0.0
    wheel_radius_m: float = 0.15
    scale: float = 0.0
    lag_s: float = 0.0
    gyro_factor: float = 1.0
    gps_m: float = 0.0


def _first_order(x: Floats, tau_s: float, h: float) -> Floats:
    keep = np.exp(-h / tau_s)
    return np.asarray(lfilter([1 - keep], [1, -keep], x))


def simulate(hidden: Hidden, seed: int, duration_s: float = 300.0, dt_s: float = 0.1) -> DriveBlock:
    """A drive with turns both ways, changing speed, slip noise that grows in turns."""
    rng = np.random.default_rng(seed)
    rows = int(duration_s / dt_s)
    n, h = rows * _FINE, dt_s / _FINE
    t = np.arange(n) * h
    turn = np.zeros(n)
    begin = 0
    while begin < n:
        length = int(rng.uniform(3, 12) / h)
        turn[begin : begin + length] = rng.choice([0, 0, 1]) * rng.uniform(-35, 35)
        begin += length
    turn = _first_order(turn, 0.4, h)
    speed = 1.0 + 0.3 * np.sin(2 * np.pi * t / 47) + 0.15 * np.sin(2 * np.pi * t / 13.3)
    seen = turn * (1 + hidden.slip * (np.abs(turn) / 30) ** hidden.slip_exponent)
    if hidden.lag_s:
        seen = _first_order(seen, hidden.lag_s, h)
    half = np.deg2rad(seen) * SEPARATION_M / 2
    left = (speed - half) * (1 - hidden.asymmetry / 2) * (1 + hidden.scale)
    right = (speed + half) * (1 + hidden.asymmetry / 2) * (1 + hidden.scale)
    angle = np.cumsum(right) * h / hidden.wheel_radius_m
    right = right * (1 + hidden.eccentricity * np.cos(angle))

    def each_row(x: Floats) -> Floats:
        return np.asarray(x.reshape(rows, _FINE).mean(axis=1))

    gyro = np.interp(t - hidden.delay_s, t, turn)
    gyro_dps = each_row(gyro) + hidden.bias_dps + rng.normal(0, 0.013, rows)
    rough = 0.002 * (1 + each_row(np.abs(turn)) / 20)

    def counted(speed_mps: Floats) -> Floats:
        moved = dt_s * each_row(speed_mps)
        return np.asarray(moved + rng.normal(0, 1, rows) * np.sqrt(np.abs(moved)) * rough)

    left_m, right_m = counted(left), counted(right)
    heading = np.deg2rad(np.cumsum(turn) * h)
    nothing = np.full(rows, np.nan)
    x, y = nothing, nothing
    if hidden.gps_m:
        x = np.cumsum(speed * np.cos(heading))[::_FINE] * h + rng.normal(0, hidden.gps_m, rows)
        y = np.cumsum(speed * np.sin(heading))[::_FINE] * h + rng.normal(0, hidden.gps_m, rows)
    times = np.asarray(np.arange(rows) * dt_s, dtype=np.float64)
    return DriveBlock(2, times, left_m, right_m, gyro_dps * hidden.gyro_factor, nothing, x, y, nothing)
