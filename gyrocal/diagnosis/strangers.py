"""Shapes that are not in the catalogue, by coordinate.

Two uses. *Strangers* are one- and two-column laws that compete with the catalogue for the same data: where one of
them wins, the effect is located and not named. *Blocks* are generic bases of each coordinate: they locate an
excess, and they say what a model has left behind (lack of fit).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.diagnosis.columns import Book, hats, quantile_knots
from gyrocal.diagnosis.hypotheses import STRANGE, Hypothesis
from gyrocal.diagnosis.series import Series

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Block:
    """A generic basis of a coordinate.

    Attributes
    ----------
    coordinate, label : str
        ``label`` tells apart several blocks of one coordinate.
    columns : ndarray of int
        Ordered from coarse to fine where `nested`.
    sizes : tuple of int
        How many of the leading columns each test uses.
    """

    coordinate: str
    label: str
    columns: Ints
    sizes: tuple[int, ...]


def _scaled(x: Floats) -> Floats:
    span = float(np.ptp(x))
    return np.asarray((x - x.min()) / span if span > 0 else np.zeros_like(x))


def _cosines(x: Floats, count: int) -> Floats:
    """Cosine basis of a coordinate, coarse to fine, shape (n, count)."""
    return np.asarray(np.cos(np.pi * _scaled(x)[:, None] * np.arange(1, count + 1)))


def _waves(t: Floats, periods: Floats) -> Floats:
    """Cosine and sine of each period, shape (n, 2 len(periods)), pairs side by side."""
    phase = 2 * np.pi * (t - t[0])[:, None] / periods
    return np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(t.size, -1)


def strangers(series: Series, book: Book) -> list[Hypothesis]:
    """Laws outside the catalogue, coordinate by coordinate."""
    found: list[Hypothesis] = []

    def enter(name: str, coordinate: str, columns: Floats, k: int = 1) -> None:
        numbers = book.add(columns).reshape(-1, k)
        found.append(
            Hypothesis(
                f"({name})",
                coordinate,
                "",
                tuple({} for _ in numbers),
                numbers,
                prior=STRANGE,
                in_catalogue=False,
            )
        )

    for make in (_in_time, _in_temperature, _in_temperature_rate, _in_rate, _in_angle, _in_rest):
        make(series, enter)
    return found


Enter = Callable[..., None]


def _in_time(s: Series, enter: Enter) -> None:
    span = float(np.ptp(s.t_s))
    turning = np.ptp(s.rate_dps) > 0
    where = s.time_coordinate
    cycles = np.concatenate([np.arange(0.75, 12.0, 0.25), np.arange(12.0, 45.0, 0.75)])
    periods = span / cycles
    periods = periods[periods > 120.0]
    if not s.has_time:
        periods = span / cycles[cycles < len(s) / 6]
    if periods.size:
        enter("periodic in time", where, _waves(s.t_s, periods), 2)
        if turning:
            slow = periods[:45:2]
            enter("scale factor periodic in time", where, _waves(s.t_s, slow) * s.rate_dps[:, None], 2)
    centres = np.linspace(0.05, 0.95, 19)
    x = _scaled(s.t_s)[:, None]
    pulses = [np.exp(-0.5 * ((x - centres) / w) ** 2) for w in (0.02, 0.06)]
    enter("passing disturbance", where, np.concatenate(pulses, axis=1))
    enter("bend in time", where, np.maximum(x - centres[2:-2:2], 0.0))
    enter("drift as the square root of time", where, np.sqrt(x[:, 0]))
    decay = (x > centres) * np.exp(-np.maximum(x - centres, 0.0) / 0.08)
    enter("disturbance that decays", where, decay)
    if turning:
        enter("passing change of scale factor", where, pulses[1] * s.rate_dps[:, None])


def _in_temperature(s: Series, enter: Enter) -> None:
    if np.ptp(s.temp_c) < 10.0:
        return
    span = float(np.ptp(s.temp_c))
    x = _scaled(s.temp_c)[:, None]
    centres = np.linspace(0.0, 1.0, 15)
    bumps = [np.exp(-0.5 * ((x - centres) / w) ** 2) for w in (0.04, 0.1)]
    bends = [0.05 * np.logaddexp(0.0, (x - centres[2:-2]) / 0.05), np.tanh((x - centres[1:-1]) / 0.05)]
    enter("bump in temperature", "temperature", np.concatenate(bumps, axis=1))
    enter("bend or step in temperature", "temperature", np.concatenate(bends, axis=1))
    enter("ripple in temperature", "temperature", _waves(s.temp_c, span / np.arange(1.5, 12.1, 0.5)), 2)
    if np.ptp(s.rate_dps) > 0:
        w = s.rate_dps[:, None]
        enter("scale factor bump in temperature", "temperature", bumps[1] * w)
        enter("scale factor of third order in temperature", "temperature", (x - 0.5) ** 3 * w)
        uneven = np.column_stack([np.abs(s.rate_dps), 50.0 * np.sign(s.rate_dps)])
        enter("asymmetry that changes with temperature", "rate", uneven * (x - 0.5))


def _in_temperature_rate(s: Series, enter: Enter) -> None:
    rate = s.temp_rate_c_per_min
    if "temperature_rate" in s.untestable or np.ptp(rate) < 0.05:
        return
    enter("size of the temperature rate", "temperature_rate", np.abs(rate))
    enter("square of the temperature rate", "temperature_rate", rate**2)
    if np.ptp(s.rate_dps) > 0:
        enter("scale factor by temperature rate", "temperature_rate", rate * s.rate_dps)
        lagged = [s.temp_c - s.history.lagged_at(tau, s.t_s) for tau in (300.0, 1200.0)]
        enter(
            "scale factor by lagged temperature",
            "temperature_rate",
            np.column_stack(lagged) * s.rate_dps[:, None],
        )
        branch = s.history.play_at(0.1 * float(np.ptp(s.history.temp_c)), s.t_s) - s.temp_c
        enter("scale factor by branch", "temperature_branch", branch * s.rate_dps)


def _in_rate(s: Series, enter: Enter) -> None:
    sizes = np.unique(np.round(s.rate_dps, 3))
    if sizes.size < 6:
        return
    full = float(np.max(np.abs(s.rate_dps)))
    enter("one rate alone", "rate", (np.abs(s.rate_dps[:, None] - sizes) < 1e-3).astype(np.float64))
    x = s.rate_dps / full
    enter("ripple in rate", "rate", _waves(x - x.min(), 2.0 / np.arange(2.0, sizes.size / 2.5, 0.5)), 2)
    warm = [s.rate_dps * 0 + _low_passed(s, np.abs(x), tau) for tau in (60.0, 300.0, 1200.0)]
    # A table has no samples after a step: what remembers past rates shows in the order of its data sets.
    where = "data_set_index" if "time_since_step" in s.untestable else "time_since_step"
    enter("memory of past rates", where, np.column_stack(warm))


def _low_passed(s: Series, values: Floats, tau_s: float) -> Floats:
    out = np.empty_like(values)
    state = float(values[0])
    gaps = np.exp(-np.diff(s.t_s, prepend=s.t_s[0]) / tau_s)
    for i, (a, v) in enumerate(zip(gaps.tolist(), values.tolist(), strict=True)):
        state = a * state + (1.0 - a) * v
        out[i] = state
    return out


def _in_angle(s: Series, enter: Enter) -> None:
    if s.angle_deg is None or np.ptp(s.rate_dps) == 0:
        return
    theta = np.deg2rad(s.angle_deg)
    constant = [f(k * theta) for k in range(2, 9) for f in (np.cos, np.sin)]
    enter("harmonic of the table angle", "table_angle", np.column_stack(constant), 2)
    growing = [s.rate_dps * f(k * theta) for k in range(3, 9) for f in (np.cos, np.sin)]
    enter("harmonic of the table angle growing with rate", "table_angle", np.column_stack(growing), 2)
    warm = _scaled(s.temp_c)[:, None] - 0.5
    if np.ptp(s.temp_c) > 5.0:
        turns = np.column_stack([f(k * theta) for k in (1, 2) for f in (np.cos, np.sin)])
        enter("harmonic of the table angle that changes with temperature", "table_angle", turns * warm, 2)
    sectors = np.floor(np.mod(s.angle_deg, 360.0) / 15.0)
    moving = (np.abs(s.rate_dps) > 0)[:, None]
    enter(
        "one sector of the table",
        "table_angle",
        ((sectors[:, None] == np.arange(24)) & moving).astype(np.float64),
    )


def _in_rest(s: Series, enter: Enter) -> None:
    if s.supply_v is not None and "supply" not in s.untestable:
        dv = s.supply_v - float(np.median(s.supply_v))
        enter("square of the supply", "supply", dv**2)
        if np.ptp(s.rate_dps) > 0:
            enter("scale factor by supply", "supply", dv * s.rate_dps)
    if s.since_set_s is not None and s.step_dps is not None:
        taus = (0.5, 1.5, 4.0, 12.0, 40.0)
        decays = np.column_stack([np.exp(-s.since_set_s / tau) for tau in taus])
        moved = (s.step_dps != 0)[:, None]
        enter("start of a data set, whatever the step", "time_since_step", decays * moved)
        enter("start of a data set, by size of step", "time_since_step", decays * np.abs(s.step_dps)[:, None])
        enter("slow settling after a step", "time_since_step", decays[:, 3:] * s.step_dps[:, None])


def blocks(series: Series, book: Book) -> list[Block]:
    """Generic bases of every coordinate that the record has."""
    s = series
    found: list[Block] = []

    def enter(coordinate: str, label: str, columns: Floats, sizes: tuple[int, ...] | None = None) -> None:
        numbers = book.add(columns)
        found.append(Block(coordinate, label, numbers, sizes or (numbers.size,)))

    turning = np.ptp(s.rate_dps) > 0
    w = s.rate_dps[:, None] / max(float(np.max(np.abs(s.rate_dps))), 1e-9)
    when = s.time_coordinate
    enter(when, "bias", _cosines(s.t_s, 32), (3, 8, 16, 32))
    if turning:
        enter(when, "scale factor", _cosines(s.t_s, 16) * w, (3, 8, 16))
        rates = np.unique(np.round(s.rate_dps, 3))
        if rates.size > 4:
            knots = rates if rates.size <= 41 else quantile_knots(s.rate_dps, 41)
            enter("rate", "mean", hats(s.rate_dps, knots))
            enter(
                "rate",
                "by temperature",
                hats(s.rate_dps, quantile_knots(rates, 9)) * _scaled(s.temp_c)[:, None],
            )
            enter("rate", "uneven with temperature", _uneven(w[:, 0], s.temp_c), (4, 13))
    if np.ptp(s.temp_c) > 3.0:
        enter("temperature", "bias", _cosines(s.temp_c, 16), (4, 8, 16))
        if turning:
            enter("temperature", "scale factor", _cosines(s.temp_c, 10) * w, (4, 10))
    if "temperature_rate" not in s.untestable and np.ptp(s.temp_rate_c_per_min) > 0.05:
        _thermal_blocks(s, w if turning else None, enter)
    if s.angle_deg is not None and turning:
        theta = np.deg2rad(s.angle_deg)
        moving = (np.abs(s.rate_dps) > 0).astype(np.float64)
        waves = [f(k * theta) for k in range(1, 9) for f in (np.cos, np.sin)]
        enter("table_angle", "constant", np.column_stack(waves) * moving[:, None], (2, 6, 16))
        enter("table_angle", "growing with rate", np.column_stack(waves) * w, (2, 6, 16))
        warm = (_scaled(s.temp_c)[:, None] - 0.5) * np.column_stack(waves[:6])
        enter("table_angle", "with temperature", np.column_stack([warm, warm * w]), (6, 12))
    if s.since_set_s is not None and s.step_dps is not None and turning:
        early = np.exp(-s.since_set_s[:, None] / np.array([0.3, 0.7, 1.5, 3.0, 7.0, 20.0]))
        enter("time_since_step", "per step", early * s.step_dps[:, None] / 50.0)
        enter("time_since_step", "constant", early)
    if s.supply_v is not None and "supply" not in s.untestable:
        enter("supply", "bias", _cosines(s.supply_v, 4), (1, 4))
        if turning:
            enter("supply", "scale factor", _cosines(s.supply_v, 3) * w, (1, 3))
    return found


def _uneven(x: Floats, temp_c: Floats) -> Floats:
    """Corners at rate zero that change with temperature: what the surface's smooth products cannot follow."""
    v = _scaled(temp_c) - 0.5
    smooth = [corner * v**power for corner in (np.sqrt(np.abs(x)), np.sign(x)) for power in (1, 2)]
    each = hats(temp_c, quantile_knots(temp_c, 9)) * np.sqrt(np.abs(x))[:, None]
    return np.column_stack([*smooth, each])


def _thermal_blocks(s: Series, w: Floats | None, enter: Enter) -> None:
    rate = s.temp_rate_c_per_min
    span = float(np.ptp(s.history.temp_c))
    lagged = np.column_stack([s.temp_c - s.history.lagged_at(t, s.t_s) for t in (60.0, 180.0, 600.0, 1800.0)])
    knots = np.unique(np.quantile(rate, [0.01, 0.1, 0.3, 0.7, 0.9, 0.99]))
    enter("temperature_rate", "instant", hats(rate, knots))
    enter("temperature_rate", "lagged", lagged)
    branch = np.column_stack([s.history.play_at(r * span, s.t_s) - s.temp_c for r in (0.03, 0.1, 0.25)])
    enter(
        "temperature_branch", "bias", np.column_stack([branch, branch[:, 1:2] * _scaled(s.temp_c)[:, None]])
    )
    if w is not None:
        enter("temperature_rate", "scale factor", np.column_stack([rate[:, None] * w, lagged * w]))
        enter("temperature_branch", "scale factor", branch * w)
    if s.since_power_on_s is not None and s.since_power_on_s.min() < 5400:
        early = np.exp(-s.since_power_on_s[:, None] / np.array([150.0, 400.0, 1000.0, 2500.0]))
        enter("time_since_power_on", "bias", early)
