"""The bench of the concealed recordings, in the time domain. Shares no code and no formula with gyrocal.

One fine time grid of 0.1 s carries table, chamber, gyro case and supply. A plan goes through its temperatures in
order: ramp and soak at rest, then every rate in shuffled order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEP_S = 0.1
TRANSITION_S = 3.0
SETTLE_S = 4.0
ROOM_C = 22.0


@dataclass(frozen=True)
class Plan:
    """Temperatures in order, rates at each (shuffled), dwell and soak, slope of the ramps."""

    temperatures_c: tuple[float, ...]
    rates_dps: tuple[float, ...]
    dwell_s: float
    soak_s: float
    ramp_c_per_min: float


def _both_signs(*rates: float) -> tuple[float, ...]:
    return (*(-r for r in reversed(rates)), 0.0, *rates)


PLANS: dict[str, Plan] = {
    "even": Plan((0, 20, 40, 50, 30, 10, -10), _both_signs(20, 40, 60, 80, 100), 20, 900, 2.0),
    "fine": Plan(
        (-10, 10, 30, 50, 40, 20, 0),
        _both_signs(12.5, 25, 37.5, 50, 62.5, 75, 87.5, 100),
        15,
        900,
        1.5,
    ),
    "near_zero": Plan((-10, 5, 20, 35, 50, 42, 27, 12), _both_signs(5, 10, 25, 50, 75, 100), 20, 1200, 1.5),
    "paper": Plan((-10, 10, 30, 50, 40, 20, 0), _both_signs(*range(10, 101, 10)), 20, 1200, 1.5),
}


@dataclass(frozen=True)
class Piece:
    """A segment: fine samples ``start`` to ``stop``, in rows of ``per_row`` fine samples."""

    kind: str
    rate_dps: float
    chamber_c: float
    start: int
    stop: int
    per_row: int
    step_dps: float


@dataclass(frozen=True)
class World:
    """What the bench did, on the fine grid; every array has shape (n,)."""

    pieces: tuple[Piece, ...]
    t_s: Floats
    rate_dps: Floats
    angle_deg: Floats
    air_c: Floats
    case_c: Floats
    supply_v: Floats

    def rows(self, fine: Floats) -> Floats:
        """Means of a fine signal over every logged row, in time order."""
        return np.concatenate(
            [fine[p.start : p.stop].reshape(-1, p.per_row).mean(axis=1) for p in self.pieces]
        )

    def row_seconds(self) -> Floats:
        """Averaging time of every logged row."""
        return np.concatenate(
            [np.full((p.stop - p.start) // p.per_row, p.per_row * STEP_S) for p in self.pieces]
        )

    def row_set(self) -> NDArray[np.int64]:
        """Number of the segment of every logged row."""
        return np.repeat(np.arange(len(self.pieces)), [(p.stop - p.start) // p.per_row for p in self.pieces])


def first_order(x: Floats, tau_s: float, start: float, step_s: float = STEP_S) -> Floats:
    """Solve ``tau dy/dt = x - y`` on a grid by the trapezoidal rule, on a grid of 1 s for slow signals."""
    stride = max(1, round(1.0 / step_s)) if tau_s > 20 else 1
    coarse = x[::stride].tolist()
    h = step_s * stride / tau_s
    keep, gain = (1 - h / 2) / (1 + h / 2), (h / 2) / (1 + h / 2)
    y, before, out = start, coarse[0], []
    for now in coarse:
        y = keep * y + gain * (now + before)
        before = now
        out.append(y)
    grid = np.arange(0, x.size, stride)
    return np.asarray(np.interp(np.arange(x.size), grid, out))


def _chamber(
    plan: Plan, ends: list[tuple[int, int, float]], n: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Air temperature under a two-point controller, and whether its compressor runs."""
    set_point = np.full(n, ROOM_C)
    before = ROOM_C
    for start, stop, target in ends:
        set_point[start:stop] = before + (target - before) * np.linspace(0, 1, stop - start)
        set_point[stop:] = target
        before = target
    slope = rng.uniform(0.0022, 0.0032)
    off, direction, swing, cooling = 0.0, 1.0, [], []
    for _ in range(n // 10 + 1):
        off += direction * slope
        if abs(off) > 0.25:
            off, direction = np.sign(off) * 0.25, -direction
        swing.append(off)
        cooling.append(direction < 0)
    second = np.minimum(np.arange(n) // 10, len(swing) - 1)
    ripple = np.interp(np.arange(n) / 10.0, np.arange(len(swing)), swing)
    return set_point + ripple, np.array(cooling, dtype=float)[second]


def build_world(plan: Plan, supply_steps: bool, rng: np.random.Generator) -> World:
    """Run the plan: every motion, temperature and voltage of the record."""
    pieces: list[Piece] = []
    ramps: list[tuple[int, int, float]] = []
    rate: list[Floats] = []
    at, now_c, now_dps = 0, ROOM_C, 0.0

    def stay(kind: str, dps: float, target_c: float, seconds: float, per_row: int, step: float) -> None:
        nonlocal at
        count = round(seconds / STEP_S)
        pieces.append(Piece(kind, dps, target_c, at, at + count, per_row, step))
        rate.append(np.full(count, dps))
        at += count

    for target_c in plan.temperatures_c:
        ramp_s = float(round(abs(target_c - now_c) / plan.ramp_c_per_min * 60))
        ramps.append((at, at + round(ramp_s / STEP_S), target_c))
        stay("ramp", 0.0, target_c, ramp_s, 10, -now_dps)
        stay("soak", 0.0, target_c, plan.soak_s, 10, 0.0)
        now_c, now_dps = target_c, 0.0
        for dps in rng.permutation(np.array(plan.rates_dps)):
            transition = np.interp(
                np.arange(round(SETTLE_S / STEP_S)) * STEP_S, [0, TRANSITION_S], [now_dps, dps]
            )
            rate.append(transition)
            at += transition.size
            stay("rate", float(dps), target_c, plan.dwell_s, 1, float(dps) - now_dps)
            now_dps = float(dps)
    rate_dps = np.concatenate(rate)
    t_s: Floats = (np.arange(at, dtype=np.float64) + 0.5) * STEP_S
    air, cooling = _chamber(plan, ramps, at, rng)
    case = first_order(first_order(air, 30.0, ROOM_C), rng.uniform(300, 420), ROOM_C)
    offset = np.zeros(at)
    if supply_steps:
        for piece in pieces:
            offset[piece.start : piece.stop] = rng.choice([-0.3, 0.3])
    return World(
        tuple(pieces),
        t_s,
        rate_dps,
        np.asarray(rng.uniform(0, 360) + np.cumsum(rate_dps) * STEP_S, dtype=np.float64),
        air,
        case,
        12.0 + offset - 0.05 * cooling,
    )
