"""What table and chamber did in a made-up recording: rates, temperatures, angles and supply, a row for each reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Step of the thermal history, s.
GRID_S = 1.0
#: Between two samples of the gyro at a rate.
SAMPLE_S = 0.1
_ACCELERATION_DPS2 = 50.0
_SETTLE_S = 4.0
_COARSE_S = 5.0
_SUPPLY_V = 12.0


@dataclass(frozen=True)
class Frame:
    """Ranges of a gyro: what rate and temperature are counted in."""

    max_rate_dps: float
    centre_c: float
    half_range_c: float


@dataclass(frozen=True)
class Segment:
    """One file of a run; a table of data sets has a segment for each row."""

    kind: str
    rate_dps: float
    chamber_c: float
    start_s: float
    end_s: float
    averaging_s: float


@dataclass(frozen=True)
class Bench:
    """A row for each reading of the gyro, shape (n,), and the thermal history on a grid of `GRID_S`, shape (m,).

    Attributes
    ----------
    segment : ndarray of int
        Index into `segments`.
    since_step_s, step_dps : ndarray
        Time since the table arrived at its rate, and by how much that rate differed from the one before.
    """

    frame: Frame
    is_run: bool
    segments: tuple[Segment, ...]
    segment: Ints
    t_s: Floats
    averaging_s: Floats
    rate_dps: Floats
    angle_deg: Floats
    since_step_s: Floats
    step_dps: Floats
    supply_v: Floats
    grid_c: Floats
    chamber_grid_c: Floats

    @property
    def u(self) -> Floats:
        """Rate in units of the largest."""
        return self.rate_dps / self.frame.max_rate_dps

    @property
    def temp_c(self) -> Floats:
        """True temperature at the thermometer."""
        return self.at_rows(self.grid_c)

    @property
    def v(self) -> Floats:
        """Temperature from the middle of the range, in units of its half."""
        return self.scaled(self.temp_c)

    @property
    def is_rate(self) -> NDArray[np.bool_]:
        """Rows of data sets; the others are ramps and soaks."""
        return np.array([s.kind == "rate" for s in self.segments])[self.segment]

    def at_rows(self, grid: Floats) -> Floats:
        """A history on the grid, at the times of the rows."""
        return np.interp(self.t_s, GRID_S * np.arange(grid.size), grid)

    def scaled(self, temp_c: Floats) -> Floats:
        """Temperatures in units of the frame."""
        return (temp_c - self.frame.centre_c) / self.frame.half_range_c


def lagged(values: Floats, tau_s: float) -> Floats:
    """First-order lag on the grid, exact for values held over a step; at rest before the record."""
    keep = float(np.exp(-GRID_S / tau_s))
    out, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(out, dtype=np.float64)


def sweep(max_dps: float, rates: int) -> Floats:
    """Rates up one side and then the other: 0, d, 2d ... max, -d ... -max; `rates` in all, odd."""
    side = np.linspace(0.0, max_dps, rates // 2 + 1)
    return np.concatenate([side, -side[1:]])


def table_bench(frame: Frame, rates_dps: Floats, sets: int, rng: np.random.Generator) -> Bench:
    """Sweeps on a table in a heated box whose temperature drifts all the while: `sets` data sets of 16 s."""
    spacing = max(20.0, 3000.0 / sets)
    t_s = np.asarray(12.0 + spacing * np.arange(sets), dtype=np.float64)
    stops = rng.permutation(np.linspace(-0.9, 0.9, int(rng.integers(4, 7))))
    levels = frame.centre_c + frame.half_range_c * (stops + rng.uniform(-0.1, 0.1, size=stops.size))
    of_grid = np.arange(0.0, t_s[-1] + spacing, GRID_S)
    which = np.minimum((of_grid / of_grid[-1] * levels.size).astype(int), levels.size - 1)
    box = lagged(levels[which], float(rng.uniform(200.0, 500.0)))
    rate = np.asarray(np.resize(rates_dps, sets), dtype=np.float64)
    segments = tuple(
        Segment("rate", r, 0.0, t - 8.0, t + 8.0, 16.0)
        for t, r in zip(t_s.tolist(), rate.tolist(), strict=True)
    )
    return Bench(
        frame,
        False,
        segments,
        np.arange(sets),
        t_s,
        np.full(sets, 16.0),
        rate,
        np.zeros(sets),
        np.full(sets, 8.0),
        np.diff(rate, prepend=0.0),
        np.full(sets, _SUPPLY_V),
        lagged(box, float(rng.uniform(100.0, 250.0))),
        box,
    )


@dataclass(frozen=True)
class RunPlan:
    """A run with a chamber: temperatures in their order, and the rates at each."""

    temperatures_c: Sequence[float]
    rates_dps: Sequence[Floats]
    dwell_s: float = 10.0
    ramp_c_per_min: float = 2.0
    soak_s: float = 600.0


def run_bench(frame: Frame, plan: RunPlan, rng: np.random.Generator) -> Bench:
    """Carry a plan out: ramp, soak, then the rates, at each temperature."""
    segments = _segments(plan, frame.centre_c)
    t_s, index = _sample_times(segments)
    chamber = _chamber(segments, plan, frame.centre_c)
    heating = rng.uniform(1.0, 4.0) * (
        1.0 - np.exp(-GRID_S * np.arange(chamber.size) / rng.uniform(300.0, 900.0))
    )
    since, step, angle = _motion(segments, t_s, index, float(rng.uniform(0.0, 360.0)))
    return Bench(
        frame,
        True,
        tuple(segments),
        index,
        t_s,
        np.array([s.averaging_s for s in segments])[index],
        np.array([s.rate_dps for s in segments])[index],
        angle,
        since,
        step,
        _supply(t_s, rng),
        lagged(chamber, float(rng.uniform(200.0, 500.0))) + heating,
        chamber,
    )


def _segments(plan: RunPlan, start_c: float) -> list[Segment]:
    segments: list[Segment] = []
    t, last_c, last_dps = 0.0, start_c, 0.0
    for temperature, rates in zip(plan.temperatures_c, plan.rates_dps, strict=True):
        ramp_s = _COARSE_S * round(abs(temperature - last_c) / plan.ramp_c_per_min * 60.0 / _COARSE_S + 6.0)
        for kind, length in (("ramp", ramp_s), ("soak", plan.soak_s)):
            segments.append(Segment(kind, 0.0, temperature, t, t + length, _COARSE_S))
            t += length
        for rate in rates.tolist():
            t += abs(rate - last_dps) / _ACCELERATION_DPS2 + _SETTLE_S
            segments.append(Segment("rate", rate, temperature, t, t + plan.dwell_s, SAMPLE_S))
            t, last_dps = t + plan.dwell_s, rate
        t += abs(last_dps) / _ACCELERATION_DPS2 + _SETTLE_S
        last_c, last_dps = temperature, 0.0
    return segments


def _sample_times(segments: Sequence[Segment]) -> tuple[Floats, Ints]:
    times, index = [], []
    for k, s in enumerate(segments):
        n = round((s.end_s - s.start_s) / s.averaging_s)
        times.append(s.start_s + s.averaging_s * (np.arange(n) + 0.5))
        index.append(np.full(n, k))
    return np.concatenate(times), np.concatenate(index)


def _chamber(segments: Sequence[Segment], plan: RunPlan, start_c: float) -> Floats:
    t, corners, values = 0.0, [0.0], [start_c]
    for s in segments:
        if s.kind == "ramp":
            t = s.start_s
            corners += [t, t + abs(s.chamber_c - values[-1]) / plan.ramp_c_per_min * 60.0]
            values += [values[-1], s.chamber_c]
    grid_s = np.arange(0.0, segments[-1].end_s + 2 * GRID_S, GRID_S)
    return np.asarray(np.interp(grid_s, corners, values), dtype=np.float64)


def _motion(
    segments: Sequence[Segment], t_s: Floats, index: Ints, angle_deg: float
) -> tuple[Floats, Floats, Floats]:
    """Time since the last change of rate, its size, and the table's angle, unwrapped."""
    since, step, angle = np.empty(t_s.size), np.empty(t_s.size), np.empty(t_s.size)
    arrived, change, last_end, last_dps = -3600.0, 0.0, 0.0, 0.0
    for k, s in enumerate(segments):
        if s.rate_dps != last_dps:
            change = s.rate_dps - last_dps
            arrived = last_end + abs(change) / _ACCELERATION_DPS2
        turning_s = min(abs(s.rate_dps - last_dps) / _ACCELERATION_DPS2, s.start_s - last_end)
        angle_deg += 0.5 * (s.rate_dps + last_dps) * turning_s + s.rate_dps * (
            s.start_s - last_end - turning_s
        )
        rows = index == k
        since[rows], step[rows] = t_s[rows] - arrived, change
        angle[rows] = angle_deg + s.rate_dps * (t_s[rows] - s.start_s)
        angle_deg += s.rate_dps * (s.end_s - s.start_s)
        last_end, last_dps = s.end_s, s.rate_dps
    return since, step, angle


def _supply(t_s: Floats, rng: np.random.Generator) -> Floats:
    """Volts: a compressor that comes and goes, and a slow wander."""
    period, phase = rng.uniform(400.0, 1500.0), rng.uniform(0.0, 2 * np.pi)
    compressor = np.where(np.sin(2 * np.pi * t_s / period + phase) > rng.uniform(-0.3, 0.5), -0.3, 0.0)
    wander = 0.1 * np.sin(2 * np.pi * t_s / rng.uniform(2500.0, 6000.0) + rng.uniform(0.0, 2 * np.pi))
    return np.asarray(_SUPPLY_V + compressor + wander, dtype=np.float64)
