"""Made-up gyros: their ranges, their surface over the true rate, noise, thermometer and steps of output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrocal.trial.disturbed import Noise
from gyrocal.trial.plans import SAMPLE_S, Bench, Frame

Floats = NDArray[np.float64]

RATE_POWERS, TEMPERATURE_POWERS = 4, 3


@dataclass(frozen=True)
class Make:
    """A class of sensors.

    Attributes
    ----------
    sizes : tuple of 4 tuples of 3
        Standard deviations of the surface's coefficients, over powers of rate and of temperature, deg/s.
    """

    frame: Frame
    noise: Noise
    sizes: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Gyro:
    """One unit; `surface_dps` has shape (12,), over powers of rate (outer) and temperature (inner)."""

    model: str
    frame: Frame
    noise: Noise
    surface_dps: Floats
    thermometer_step_c: float = 0.0
    thermometer_noise_c: float = 0.01
    lsb_dps: float = 0.0

    def read_temperature(self, temp_c: Floats, rng: np.random.Generator) -> Floats:
        """What the thermometer says."""
        read = temp_c + self.thermometer_noise_c * rng.standard_normal(temp_c.size)
        step = self.thermometer_step_c
        return np.asarray(step * np.round(read / step) if step else read)

    def read_rate(self, rate_dps: Floats, bench: Bench, rng: np.random.Generator) -> Floats:
        """What the output says, in steps where it has them: samples are rounded, and means taken of them."""
        if not self.lsb_dps:
            return rate_dps
        counts = np.round(bench.averaging_s / SAMPLE_S).astype(int)
        out = np.empty_like(rate_dps)
        for n in np.unique(counts).tolist():
            rows = counts == n
            dither = self.noise.white / np.sqrt(SAMPLE_S) * rng.standard_normal((np.count_nonzero(rows), n))
            samples = rate_dps[rows, None] + dither - dither.mean(axis=1, keepdims=True)
            out[rows] = (self.lsb_dps * np.round(samples / self.lsb_dps)).mean(axis=1)
        return out


def left_by_steps(lsb_dps: float, sample_dps: float) -> float:
    """Error that rounding leaves in a mean of samples with white noise, which smooths the steps: first harmonic, rms."""
    if not lsb_dps:
        return 0.0
    return float(lsb_dps / (np.pi * np.sqrt(2.0)) * np.exp(-2.0 * (np.pi * sample_dps / lsb_dps) ** 2))


def powers(u: Floats, v: Floats) -> Floats:
    """Columns of the surface, shape (n, 12)."""
    rate = np.vander(u, RATE_POWERS, increasing=True)
    temperature = np.vander(v, TEMPERATURE_POWERS, increasing=True)
    return np.asarray((rate[:, :, None] * temperature[:, None, :]).reshape(u.size, -1))


_FIBRE = ((0.02, 0.02, 0.005), (0.3, 0.2, 0.05), (0.005, 0.003, 0.001), (0.02, 0.01, 0.003))

MAKES: Mapping[str, Make] = {
    "fog": Make(Frame(100.0, 20.0, 30.0), Noise(8e-4, flicker=3e-4, jitter=1.5e-5), _FIBRE),
    "box": Make(Frame(100.8, 42.0, 12.0), Noise(8e-3, flicker=1e-3, jitter=3e-5), _FIBRE),
    "mems": Make(
        Frame(200.0, 20.0, 40.0),
        Noise(5e-3, flicker=2e-3, jitter=5e-5),
        ((0.3, 0.3, 0.1), (2.0, 2.0, 0.5), (0.05, 0.02, 0.01), (0.1, 0.05, 0.02)),
    ),
    "navigation": Make(
        Frame(100.0, 20.0, 30.0),
        Noise(2e-5, flicker=3e-6, jitter=1e-6),
        ((5e-5, 5e-5, 1e-5), (3e-3, 2e-3, 5e-4), (1e-5, 1e-5, 3e-6), (1e-4, 5e-5, 1e-5)),
    ),
}


@dataclass(frozen=True)
class Oddity:
    """What makes a recording awkward beside what is hidden, and the levels that it replaces."""

    name: str = "none"
    figures: Mapping[str, float] = field(default_factory=dict)


def make_gyro(make: str, oddity: Oddity, rng: np.random.Generator) -> Gyro:
    """A unit of a make; `oddity` may replace levels of its noise, its thermometer and its steps."""
    kind = MAKES[make]
    noise = {**vars(kind.noise), **{k: v for k, v in oddity.figures.items() if k in vars(kind.noise)}}
    noise["steps"] = left_by_steps(oddity.figures.get("lsb_dps", 0.0), noise["white"] / np.sqrt(SAMPLE_S))
    own = ("thermometer_step_c", "thermometer_noise_c", "lsb_dps")
    return Gyro(
        make,
        kind.frame,
        Noise(**noise),
        np.array(kind.sizes).ravel() * rng.standard_normal(RATE_POWERS * TEMPERATURE_POWERS),
        **{k: v for k, v in oddity.figures.items() if k in own},
    )


def surface_columns(bench: Bench, coil_c: Floats) -> Floats:
    """Columns of the surface at the rates of the bench and the temperatures of the coil."""
    return powers(bench.u, bench.scaled(coil_c))
