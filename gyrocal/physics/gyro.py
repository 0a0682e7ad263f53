"""The gyro that the virtual bench and the simulated robot share: true surface, noise, bandwidth, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.physics.surface import Surface
from gyrocal.units import DEG_PER_RT_H_TO_DPS_PER_RT_HZ, DPH_TO_DPS

Floats = NDArray[np.float64]

#: Correlation times of the Ornstein-Uhlenbeck processes that add up to 1/f noise: two a decade keep the sum
#: within 3 % of a straight 1/f line from 0.05 to 10 mHz; faster than 1 s it drowns in the white noise.
_OU_RATIO = 10.0**0.5
_OU_TIMES_S = 1.0 * _OU_RATIO ** np.arange(11)

#: Samples whose recursion is solved by one matrix product.
_SCAN = 64


@dataclass(frozen=True)
class GyroModel:
    """A gyro as it really is; calibration never sees this.

    Attributes
    ----------
    surface : Surface
        True error in the gyro's own output and temperature (paper eqs. 2 and 3).
    angle_random_walk_deg_per_rt_h, bias_instability_deg_per_h : float
        N and B of IEEE 952: PSD ``N^2`` of white noise, ``B^2 / (2 pi f)`` of flicker (Allan floor 0.664 B).
    lsb_deg : float
        Angle of one bit; increments are rounded with the remainder carried on. 0: no rounding.
    bandwidth_hz : float
        First-order bandwidth; infinite is allowed.
    sample_rate_hz : float
        Native sample rate; a sample is the mean rate over its interval.
    rate_range_dps, temp_range_c : tuple of float
        What the data sheet allows.
    temp_noise_c, temp_lsb_c : float
        White noise (standard deviation of a sample) and resolution of the temperature sensor.
    """

    surface: Surface
    angle_random_walk_deg_per_rt_h: float
    bias_instability_deg_per_h: float
    lsb_deg: float
    bandwidth_hz: float
    sample_rate_hz: float
    rate_range_dps: tuple[float, float]
    temp_range_c: tuple[float, float]
    temp_noise_c: float
    temp_lsb_c: float


def rd2100_unit(seed: int) -> GyroModel:
    """Draw a KVH E-Core RD2100 whose errors have the sizes of the paper's Table I; the seed shapes them.

    Over -10..50 deg C: nonlinearity 0.5 % of full scale rms about the best line (at 20 deg C), scale factor
    2 % and bias 0.2 deg/s peak to peak. Bias instability 1.8 deg/h: the quiet end of Table I's 0.002 deg/s.
    """
    rng = np.random.default_rng([seed, 2100])
    v = np.linspace(-1.0, 1.0, 121)

    def over_temperature(peak_to_peak: float) -> tuple[float, float]:
        linear, square = rng.choice([-1.0, 1.0]), rng.uniform(-0.5, 0.5)
        size = np.ptp(linear * v + square * v**2)
        return peak_to_peak * linear / size, peak_to_peak * square / size

    u = np.linspace(-1.0, 1.0, 401)
    even, odd = rng.uniform(-0.15, 0.15), rng.choice([-1.0, 1.0])
    shape = even * u**2 + odd * u**3
    bent = shape - np.polyval(np.polyfit(u, shape, 1), u)
    full_scale_dps = 100.0
    size = 0.005 * full_scale_dps / float(np.sqrt(np.mean(bent**2)))

    c = np.zeros((4, 3))
    c[0] = (rng.normal(0.0, 0.02), *over_temperature(0.2))
    # The factory's scale factor is the best line, which takes 0.6 u of u^3; its own error comes on top.
    c[1] = (-0.6 * odd * size + rng.normal(0.0, 0.1), *over_temperature(0.02 * full_scale_dps))
    c[2] = even * size, *(even * size * rng.uniform(-0.1, 0.1, 2))
    c[3] = odd * size, *(odd * size * rng.uniform(-0.1, 0.1, 2))
    return GyroModel(
        surface=Surface(c, 0.0, full_scale_dps, 20.0, 30.0),
        angle_random_walk_deg_per_rt_h=5.0 / 60.0,
        bias_instability_deg_per_h=1.8,
        lsb_deg=0.000305,
        bandwidth_hz=100.0,
        sample_rate_hz=10.0,
        rate_range_dps=(-full_scale_dps, full_scale_dps),
        temp_range_c=(-40.0, 75.0),
        temp_noise_c=0.02,
        temp_lsb_c=0.01,
    )


class GyroStream:
    """A gyro that runs: noise, filter and remainder live on from block to block."""

    def __init__(self, model: GyroModel, rng: np.random.Generator) -> None:
        self.model = model
        # A generator each, so that the split into blocks does not change the noise.
        self._white_rng, self._flicker_rng, self._temp_rng = rng.spawn(3)
        variance = (model.bias_instability_deg_per_h * DPH_TO_DPS) ** 2 * np.log(_OU_RATIO) / np.pi
        self._ou_std_dps = float(np.sqrt(variance))
        self._ou_dps = self._ou_std_dps * self._flicker_rng.standard_normal(_OU_TIMES_S.size)
        self._filtered_dps: float | None = None
        self._remainder_deg = 0.0
        self._scan_dt_s = 0.0
        self._decay = np.empty(0)
        self._scan = np.empty(0)

    def samples(self, dt_s: float, rate_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Output of the next samples, deg/s, shape (n,).

        Parameters
        ----------
        dt_s : float
            Interval of a sample.
        rate_dps : array_like, shape (n,)
            True mean rate over each interval.
        temp_c : array_like, shape (n,) or scalar
            True temperature of the coil.
        """
        return self.digitise(dt_s, self.analogue(dt_s, rate_dps, temp_c))

    def analogue(self, dt_s: float, rate_dps: ArrayLike, temp_c: ArrayLike) -> Floats:
        """Output before it is put into bits: surface, bandwidth and noise; arguments as in `samples`."""
        rate = self._limit_bandwidth(dt_s, np.atleast_1d(np.asarray(rate_dps, dtype=np.float64)))
        n = rate.size
        white = self.model.angle_random_walk_deg_per_rt_h * DEG_PER_RT_H_TO_DPS_PER_RT_HZ / np.sqrt(dt_s)
        gyro = self.model.surface.output_dps(rate, np.broadcast_to(temp_c, rate.shape))
        return np.asarray(gyro + white * self._white_rng.standard_normal(n) + self._flicker(dt_s, n))

    def digitise(self, dt_s: float, gyro_dps: Floats) -> Floats:
        """Angle increments in whole bits; what is rounded off comes with the next sample, so nothing is lost."""
        lsb = self.model.lsb_deg
        if lsb <= 0 or gyro_dps.size == 0:
            return gyro_dps
        angle = self._remainder_deg + np.cumsum(gyro_dps) * dt_s
        bits = np.round(angle / lsb)
        self._remainder_deg = float(angle[-1] - bits[-1] * lsb)
        return np.asarray(np.diff(bits, prepend=0.0) * lsb / dt_s)

    def temperatures(self, temp_c: ArrayLike) -> Floats:
        """What the temperature sensor reports, deg C, shape (n,)."""
        true = np.atleast_1d(np.asarray(temp_c, dtype=np.float64))
        noisy = true + self.model.temp_noise_c * self._temp_rng.standard_normal(true.size)
        lsb = self.model.temp_lsb_c
        return np.asarray(np.round(noisy / lsb) * lsb if lsb > 0 else noisy)

    def _limit_bandwidth(self, dt_s: float, rate: Floats) -> Floats:
        """First-order filter of a rate that is constant over each interval, averaged over the interval."""
        if rate.size == 0 or not np.isfinite(self.model.bandwidth_hz):
            return rate
        tau_s = 1.0 / (2.0 * np.pi * self.model.bandwidth_hz)
        decay = float(np.exp(-dt_s / tau_s))
        start = rate[0] if self._filtered_dps is None else self._filtered_dps
        if decay < 1e-15:  # settled within every interval: no recursion is needed
            before = np.concatenate(([start], rate[:-1]))
            self._filtered_dps = float(rate[-1])
        else:
            before = np.empty(rate.size)
            for k, value in enumerate(rate):
                before[k] = start
                start = value + (start - value) * decay
            self._filtered_dps = float(start)
        return np.asarray(rate + (before - rate) * (tau_s / dt_s) * (1.0 - decay))

    def _flicker(self, dt_s: float, n: int) -> Floats:
        """Sum of Ornstein-Uhlenbeck processes, discretised exactly: x[k] = a x[k-1] + s sqrt(1 - a^2) w[k]."""
        if self._ou_std_dps == 0.0:
            return np.zeros(n)
        self._prepare_scan(dt_s)
        a = self._decay
        drive = (
            self._flicker_rng.standard_normal((n, a.size)).T
            * (self._ou_std_dps * np.sqrt(1.0 - a**2))[:, None]
        )
        powers = a[:, None] ** np.arange(1, _SCAN + 1)
        total = np.empty(n)
        for first in range(0, n, _SCAN):
            block = drive[:, first : first + _SCAN]
            m = block.shape[1]
            path = (self._scan[:, :m, :m] @ block[:, :, None])[:, :, 0] + powers[:, :m] * self._ou_dps[
                :, None
            ]
            total[first : first + m] = path.sum(axis=0)
            self._ou_dps = path[:, -1]
        return total

    def _prepare_scan(self, dt_s: float) -> None:
        """Lower-triangular powers of the decay, shape (processes, _SCAN, _SCAN), for this interval."""
        if dt_s == self._scan_dt_s:
            return
        self._scan_dt_s = dt_s
        self._decay = np.exp(-dt_s / _OU_TIMES_S)
        lag = np.subtract.outer(np.arange(_SCAN), np.arange(_SCAN))
        self._scan = np.where(lag >= 0, self._decay[:, None, None] ** np.maximum(lag, 0), 0.0)
