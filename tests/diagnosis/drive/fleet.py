"""A fleet of made-up drives of many shapes, lengths, rates and noises; shares no formula with the finder.

The motion is integrated finely; gyro, wheels and truth are sampled from it, and effects act where they arise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.records.drive import DriveBlock

Floats = NDArray[np.float64]
FINE_HZ = 200.0
SHAPES = ("random", "lawn", "eights", "square", "straight", "slow", "reverse", "rests")


@dataclass(frozen=True)
class Plan:
    """One drive. Strengths of effects: zero is none; `flicker_dps` is the floor of the Allan deviation (1/f noise)."""

    shape: str = "random"
    minutes: float = 8.0
    hz: float = 20.0
    separation_m: float = 0.5
    rest_s: float = 8.0
    arw_dps_rt_s: float = 0.006
    bias_walk: float = 0.0001
    bias_dps: float = 0.02
    flicker_dps: float = 0.0
    tick_m: float = 0.0
    wheel_noise: float = 0.003
    turn_noise: float = 0.0
    truth_m: float = 0.0
    truth_wander_m: float = 0.0
    truth_every_s: float = 0.5
    truth_heading_deg: float = 0.0
    lever_m: tuple[float, float] = (0.0, 0.0)
    effects: dict[str, float] = field(default_factory=dict)


def any_plan(rng: np.random.Generator, effects: dict[str, float] | None = None) -> Plan:
    """A drive of random circumstances."""
    truth = float(rng.choice([0.0, 0.01, 0.03, 0.1, 0.3, 1.0]))
    return Plan(
        shape=str(rng.choice(SHAPES)),
        minutes=float(rng.choice([4, 6, 10, 18])),
        hz=float(rng.choice([10, 20, 50])),
        separation_m=float(rng.choice([0.3, 0.5, 0.8])),
        rest_s=float(rng.choice([6.0, 10.0])),
        arw_dps_rt_s=float(10 ** rng.uniform(-3.0, -1.5)),
        bias_walk=float(10 ** rng.uniform(-5, -3.5)),
        wheel_noise=float(10 ** rng.uniform(-3.0, -2.2)),
        turn_noise=float(rng.choice([0.0, 0.002, 0.005])),
        truth_m=truth,
        truth_wander_m=float(rng.choice([0.0, 1.0])) * truth,
        truth_every_s=float(rng.choice([0.1, 0.5, 1.0])),
        truth_heading_deg=float(rng.choice([0.0, 0.05, 0.5])) if truth else 0.0,
        lever_m=(float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.2, 0.2))),
        effects=effects or {},
    )


def scored_plan(rng: np.random.Generator) -> Plan:
    """A drive as it is scored: as `any_plan`, with 1/f noise and ticks, standing at its start or not."""
    plan = any_plan(rng)
    flicker_dps = plan.arw_dps_rt_s * 60.0 * 25.0 / 3600.0 * float(np.exp(0.5 * rng.normal()))
    bias_dps = float(rng.normal(0.0, 0.02))
    return replace(
        plan,
        minutes=min(plan.minutes, 10.0),
        rest_s=float(rng.choice([0.0, plan.rest_s])),
        bias_dps=bias_dps,
        bias_walk=0.0,
        flicker_dps=flicker_dps,
        tick_m=float(rng.choice([1e-4, 4e-4, 1.5e-3])),
        lever_m=(0.0, 0.0),
    )


def again(plan: Plan, rng: np.random.Generator) -> Plan:
    """The same robot switched on again, its bias changed by a twentieth, with a truth that is exact."""
    bias_dps = plan.bias_dps * (1.0 + 0.05 * float(rng.normal()))
    return replace(plan, bias_dps=bias_dps, truth_m=1e-6, truth_wander_m=0.0, truth_every_s=0.2)


def _flicker(rng: np.random.Generator, rows: int, floor: float) -> Floats:
    """1/f noise whose Allan deviation is flat at `floor`, made in the frequency domain over four times the length."""
    count = 4 * rows
    k = np.arange(1, count // 2 + 1)
    lines = rng.normal(size=k.size) + 1j * rng.normal(size=k.size)
    amplitude = floor / np.sqrt(2.0 * np.log(2.0)) * np.sqrt(1.0 / k)
    spectrum = np.concatenate([[0.0], amplitude * lines])
    noise = np.fft.irfft(spectrum, count) * count / 2.0
    return np.asarray(noise[:rows])


def _smooth(x: Floats, seconds: float) -> Floats:
    kernel = np.hanning(int(seconds * FINE_HZ) + 2)[1:-1]
    return np.asarray(np.convolve(x, kernel / kernel.sum(), "same"))


def _commands(plan: Plan, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Speed (m/s) and turn rate (rad/s) over fine time."""
    n = int(plan.minutes * 60 * FINE_HZ)
    speed, turn = np.zeros(n), np.zeros(n)
    now, side, number = plan.rest_s + 1.0, 1.0, 0
    top = 0.12 if plan.shape == "slow" else float(rng.uniform(0.5, 1.5))

    def go(seconds: float, v: float, w_dps: float) -> None:
        nonlocal now
        i, j = int(now * FINE_HZ), int((now + seconds) * FINE_HZ)
        speed[i:j], turn[i:j] = v, np.deg2rad(w_dps)
        now += seconds

    while now < plan.minutes * 60 - 4:
        number += 1
        v = top * float(rng.uniform(0.6, 1.0))
        match plan.shape:
            case "lawn":
                go(float(rng.uniform(10, 14)), v, 0.0)
                go(4.5, 0.4 * v, 40.0 * side)
                side = -side
            case "eights":
                go(12.0, v, 30.0 * side)
                side = -side
            case "square":
                go(float(rng.uniform(6, 9)), v, 0.0)
                go(3.0, 0.5 * v, 30.0)
            case "straight":
                go(float(rng.uniform(5, 20)), v, float(rng.normal(0, 0.2)))
            case "reverse":
                go(float(rng.uniform(3, 8)), v * float(rng.choice([-1, 1])), float(rng.uniform(-25, 25)))
            case _:
                go(float(rng.uniform(2, 9)), v, float(rng.choice([0, 0, 1])) * float(rng.uniform(-45, 45)))
        if plan.shape == "rests" and number % 5 == 0:
            go(float(rng.uniform(5, 12)), 0.0, 0.0)
    return _smooth(speed, 0.8), _smooth(turn, 0.6)


def drive(plan: Plan, seed: int) -> DriveBlock:
    """Drive it."""
    rng = np.random.default_rng([seed, 20])
    h, e = 1 / FINE_HZ, plan.effects
    speed, turn = _commands(plan, rng)
    moving = np.abs(speed) > 1e-9
    turn = turn + np.deg2rad(1.0) * moving * _smooth(rng.normal(0, 8, turn.size), 2.0)
    t = np.arange(turn.size) * h
    theta = np.cumsum(turn) * h + rng.uniform(-3, 3)
    course = np.interp(t + e.get("course_s", 0.0), t, theta - 0.5 * turn * h)
    place = np.cumsum(speed * h * np.exp(1j * course))
    side = np.rad2deg(np.abs(turn)) / 30
    seen = turn * (1 + e.get("skid_slip", 0.0) / 100 * side ** e.get("exponent", 0.0))
    half = 0.5 * plan.separation_m * seen
    gain = 1 + e.get("wheel_scale", 0.0) / 100
    unlike = e.get("wheel_asymmetry", 0.0) / 200
    wheels = [(speed - half) * gain * (1 - unlike), (speed + half) * gain * (1 + unlike)]
    slips = rng.choice(np.flatnonzero(np.abs(speed) > 0.1), int(e.get("slips", 0)))
    for i in slips:
        wheels[1][i : i + int(0.5 * FINE_HZ)] *= 1.7
    every = round(FINE_HZ / plan.hz)
    rows = turn.size // every

    def summed(x: Floats) -> Floats:
        return np.asarray(x[: rows * every].reshape(rows, every).sum(axis=1))

    moved = []
    for wheel in wheels:
        s = summed(wheel) * h
        rough = rng.normal(size=rows) * plan.wheel_noise * np.sqrt(np.abs(s))
        rough += rng.normal(size=rows) * plan.turn_noise * np.sqrt(summed(np.abs(turn)) * h)
        moved.append(s + rough)
    if "wheel_eccentricity" in e:
        # By the angle that the encoder counts, slip and all.
        radius_m = e.get("radius_m", 0.12)
        swing = np.sin(np.cumsum(moved[1]) / radius_m + 1.0)
        moved[1] = moved[1] + e["wheel_eccentricity"] / 100 * radius_m * np.diff(swing, prepend=swing[0])
    gyro = np.rad2deg(np.interp(t - e.get("gyro_delay", 0.0), t, turn))
    temp = 20 + 5 * (1 - np.exp(-t / 200))
    rate = summed(gyro) / every * (1 + e.get("gyro_scale", 0.0) / 100)
    rate += plan.bias_dps + np.cumsum(rng.normal(size=rows)) * plan.bias_walk / np.sqrt(plan.hz)
    rate += rng.normal(size=rows) * plan.arw_dps_rt_s * np.sqrt(plan.hz)
    rate += e.get("bias_temperature", 0.0) / 1e3 * (summed(temp) / every - 20)
    times = np.asarray((np.arange(rows) + 1.0) / plan.hz)
    rate += e.get("gyro_bias", 0.0) / 1e3 * (np.cumsum(np.abs(moved[1])) > 0)
    if plan.flicker_dps:
        rate += _flicker(np.random.default_rng([seed, 21]), rows, plan.flicker_dps)
    if plan.tick_m:
        moved = [
            plan.tick_m * np.diff(np.floor(np.cumsum(way) / plan.tick_m + 0.3), prepend=0.0) for way in moved
        ]
    temps = summed(temp) / every + 0.01 * rng.normal(size=rows)
    truth = _truth(plan, rng, rows, place, theta, every)
    return DriveBlock(2, times, moved[0], moved[1], rate, temps, *truth)


def _truth(
    plan: Plan, rng: np.random.Generator, rows: int, place: NDArray[np.complex128], theta: Floats, every: int
) -> tuple[Floats, Floats, Floats]:
    nothing = np.full(rows, np.nan)
    x, y, heading = nothing.copy(), nothing.copy(), nothing.copy()
    if not plan.truth_m:
        return x, y, heading
    at = np.arange(0, rows, max(1, round(plan.truth_every_s * plan.hz)))
    fine = (at + 1) * every - 1
    antenna = place[fine] + complex(*plan.lever_m) * np.exp(1j * theta[fine])
    noise = np.zeros(at.size, dtype=np.complex128)
    noise += plan.truth_m * (rng.normal(size=at.size) + 1j * rng.normal(size=at.size))
    if plan.truth_wander_m:
        keep = np.exp(-plan.truth_every_s / 25.0)
        pushes = (rng.normal(size=at.size) + 1j * rng.normal(size=at.size)) * np.sqrt(1 - keep**2)
        wander = np.zeros(at.size, dtype=np.complex128)
        for i in range(1, at.size):
            wander[i] = keep * wander[i - 1] + pushes[i]
        noise += plan.truth_wander_m * wander
    seen = np.exp(1j * rng.uniform(-3, 3)) * (antenna + noise) + complex(3.0, -40.0)
    x[at], y[at] = seen.real, seen.imag
    if plan.truth_heading_deg:
        heading[at] = (
            np.rad2deg(theta[fine]) + plan.truth_heading_deg * rng.normal(size=at.size) + 180
        ) % 360 - 180
    return x, y, heading
