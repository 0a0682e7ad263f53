"""Laws that the trial hides, written from physics.md alone: the catalogue's own, and others of the same physics.

They share nothing with `gyrocal.physics`, so that a formula that is wrong there is not wrong here too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.trial.plans import Bench, lagged

Floats = NDArray[np.float64]
Parameters = Mapping[str, float]
#: Unit error in the rows, deg/s; of a coil its temperature, deg C; of a front end the error itself.
Column = Callable[[Bench, Parameters], Floats]
#: Name of a parameter to the range that it is drawn from, evenly in its logarithm where both ends are positive.
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Law:
    """One law.

    Attributes
    ----------
    right : tuple of str
        Names that count as right, the nearest first.
    group : str
        Of two laws of a group only one is hidden in a recording.
    ranges : mapping
        Parameters; those in ``u`` and ``v`` are counted in the gyro's ranges of rate and temperature.
    stays : bool
        Whether it belongs to the gyro, and comes again in its next run.
    grows : callable, optional
        How something that may last has grown at a share of the record: what it adds, times rate if `of_scale`.
    acts : str
        ``adds`` to the output, moves the temperature of the ``coil``, or is the ``front`` end of the gyro.
    run_only : bool
        Needs ramps, angle, supply or time since a step, which tables of means do not have.
    low_rates : bool
        Shows only at rates near zero.
    positive : bool
        Physics knows one sign only.
    most : float
        Largest amplitude that a gyro or table in order has.
    """

    name: str
    right: tuple[str, ...]
    group: str
    column: Column
    ranges: Ranges
    stays: bool = True
    grows: Callable[[Floats, Parameters], Floats] | None = None
    of_scale: bool = False
    acts: Literal["adds", "coil", "front"] = "adds"
    run_only: bool = False
    low_rates: bool = False
    positive: bool = False
    most: float = float("inf")

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Parameters at random."""
        return {name: _between(low, high, rng) for name, (low, high) in self.ranges.items()}

    def lasting(self, bench: Bench, p: Parameters) -> Floats | None:
        """What its state at the end of the record would add in the rows of another, if it lasted."""
        if self.grows is None:
            return None
        end = float(self.grows(np.array([1.0]), p)[0])
        return end * (bench.rate_dps if self.of_scale else np.ones(bench.t_s.size))


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    if low > 0.0:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return float(rng.uniform(low, high))


def play(values: Floats, half_width: float) -> Floats:
    """Play operator: follows with a slack of `half_width` to either side; centred at the beginning."""
    out, state = np.empty_like(values), float(values[0])
    for k, value in enumerate(values.tolist()):
        state = min(max(state, value - half_width), value + half_width)
        out[k] = state
    return out


def _grown(
    name: str,
    right: tuple[str, ...],
    grows: Callable[[Floats, Parameters], Floats],
    ranges: Ranges,
    most: float = float("inf"),
) -> Law:
    """A law of time over the record that does not come again, on bias or scale factor as its name says."""
    of_scale = name.startswith("scale")

    def column(b: Bench, p: Parameters) -> Floats:
        return grows(b.t_s / b.t_s[-1], p) * (b.rate_dps if of_scale else 1.0)

    group = "scale in time" if of_scale else "bias in time"
    return Law(name, right, group, column, ranges, stays=False, grows=grows, of_scale=of_scale, most=most)


def _memory(
    name: str, right: tuple[str, ...], of_grid: Callable[[Floats, Parameters], Floats], ranges: Ranges
) -> Law:
    """A law of the temperature's history, on the bias."""
    return Law(name, right, "memory", lambda b, p: b.at_rows(of_grid(b.grid_c, p)), ranges, run_only=True)


def _coil(name: str, of_grid: Callable[[Floats, Parameters], Floats], ranges: Ranges) -> Law:
    """The surface is that of the coil's temperature, a share of the way from the thermometer's to a lagged one."""

    def column(b: Bench, p: Parameters) -> Floats:
        return b.at_rows(b.grid_c + p["share"] * (of_grid(b.grid_c, p) - b.grid_c))

    return Law(name, ("thermal_lag",), "memory", column, {"share": (0.5, 1.0), **ranges}, acts="coil")


def _rate(
    name: str,
    right: tuple[str, ...],
    column: Column,
    ranges: Ranges,
    *,
    low_rates: bool = False,
    positive: bool = False,
    most: float = float("inf"),
) -> Law:
    return Law(name, right, "rate", column, ranges, low_rates=low_rates, positive=positive, most=most)


def _bench(
    name: str, right: tuple[str, ...], column: Column, ranges: Ranges, most: float = float("inf")
) -> Law:
    """What belongs to the table, and is gone on another."""
    return Law(name, right, name, column, ranges, stays=False, run_only=True, most=most)


def _sine(b: Bench, p: Parameters) -> Floats:
    """sin(K rate)/K less the rate; K may change with temperature."""
    k = p["reach"] / b.frame.max_rate_dps * (1.0 + p.get("per_v", 0.0) * b.v)
    return np.asarray(np.sin(k * b.rate_dps) / k - b.rate_dps)


def _each_rate(b: Bench, p: Parameters) -> Floats:
    """A relative error of its own at each size of the rate, the same on both sides."""
    sizes, which = np.unique(np.round(np.abs(b.rate_dps), 6), return_inverse=True)
    return np.asarray(np.random.default_rng(int(p["seed"])).standard_normal(sizes.size)[which] * b.rate_dps)


def _lock_in(b: Bench, p: Parameters) -> Floats:
    """A laser-like threshold: nothing below it, a hyperbola above."""
    lock = p["u"] * b.frame.max_rate_dps
    beyond = np.sqrt(np.maximum(b.rate_dps**2 - lock**2, 0.0))
    return np.asarray(np.sign(b.rate_dps) * beyond - b.rate_dps)


def _slow_plays(grid: Floats, p: Parameters) -> Floats:
    """Plays whose memory fades: branches close again in a soak."""
    stuck = sum(play(grid, p["slack_c"] * k) - grid for k in (0.5, 1.0, 2.0))
    return np.asarray(stuck - 0.5 * lagged(np.asarray(stuck), p["tau_s"]))


def _plays(grid: Floats, p: Parameters) -> Floats:
    stuck = sum(w * play(grid, p["slack_c"] * k) for w, k in ((0.5, 0.4), (0.3, 1.0), (0.2, 2.2)))
    return np.asarray(stuck - grid)


def _harmonics(b: Bench, p: Parameters) -> Floats:
    """Rate error of a reference whose angle errs at one, two and four times a turn."""
    turn = np.deg2rad(b.angle_deg)
    wave = sum(
        a * k * np.cos(k * turn + k * k * p["phase_rad"])
        for k, a in ((1, 1.0), (2, p["second"]), (4, p["fourth"]))
    )
    return np.asarray(b.rate_dps * wave)


_PHASE: Ranges = {"phase_rad": (-np.pi, np.pi)}
_TILT = ("earth_rate_tilt", "magnetic", "g_sensitivity")
_SINE = ("sagnac_sine", "fit_direction", "rate_order")

#: Laws of the catalogue's form.
PLAIN: tuple[Law, ...] = (
    Law("warm_up", ("warm_up",), "bias in time", lambda b, p: np.exp(-b.t_s / p["tau_s"]), {"tau_s": (300.0, 2400.0)}),
    _grown("bias_step", ("bias_step",), lambda s, p: np.heaviside(s - p["at"], 0.0), {"at": (0.25, 0.75)}),
    _grown("bias_drift", ("bias_drift",), lambda s, p: s, {}),
    _grown("scale_step", ("scale_step",), lambda s, p: np.heaviside(s - p["at"], 0.0), {"at": (0.25, 0.75)}, most=3e-3),
    _grown("scale_drift", ("scale_drift",), lambda s, p: s, {}, most=3e-3),
    _memory("shupe", ("shupe",), lambda g, p: 60.0 * np.gradient(g), {}),
    _memory("shupe_gradient", ("shupe_gradient",), lambda g, p: g - lagged(g, p["tau_s"]), {"tau_s": (100.0, 800.0)}),
    _memory("thermal_hysteresis", ("thermal_hysteresis",), _plays, {"slack_c": (1.0, 5.0)}),
    _coil("thermal_lag", lambda g, p: lagged(g, p["tau_s"]), {"tau_s": (60.0, 500.0)}),
    _rate("scale_asymmetry", ("scale_asymmetry",), lambda b, p: np.maximum(b.rate_dps, 0.0), {}, most=2e-3),
    _rate("dead_zone", ("dead_zone",), lambda b, p: np.where(np.abs(b.u) < p["u"], -b.rate_dps, 0.0), {"u": (2e-4, 2e-3)}, low_rates=True, positive=True, most=1.0),
    _rate("truncation", ("truncation",), lambda b, p: -np.sign(b.rate_dps), {}, positive=True),
    _rate("saturation", ("saturation",), lambda b, p: -np.sign(b.u) * np.maximum(np.abs(b.u) - p["u"], 0.0), {"u": (0.5, 0.8)}, positive=True),
    _rate("rate_order", ("rate_order", "sagnac_sine", "saturation"), lambda b, p: b.u**5, {}),
    _rate("mechanical_resonance", ("mechanical_resonance",), lambda b, p: np.exp(-0.5 * ((np.abs(b.u) - p["u"]) / 0.05) ** 2), {"u": (0.3, 0.8)}),
    Law("temperature_order", ("temperature_order",), "temperature", lambda b, p: b.v**3 * (1.0 + p["scale"] * b.u), {"scale": (-2.0, 2.0)}, most=0.3),
    Law("sagnac_sine", _SINE, "front", _sine, {"reach": (0.3, 0.9)}, acts="front"),
    Law("reference_rate_error", ("reference_rate_error",), "reference", _each_rate, {"seed": (1.0, 1e6)}, stays=False, most=1e-3),
    Law("supply_voltage", ("supply_voltage",), "supply", lambda b, p: b.supply_v - 12.0, {}, run_only=True),
    _bench("earth_rate_tilt", _TILT, lambda b, p: np.cos(np.deg2rad(b.angle_deg) - p["phase_rad"]), _PHASE),
    _bench("table_eccentricity", ("table_eccentricity",), lambda b, p: b.rate_dps * np.cos(np.deg2rad(b.angle_deg) + p["phase_rad"]), _PHASE, most=3e-4),
    _bench("step_response", ("step_response",), lambda b, p: b.step_dps * np.exp(-b.since_step_s / p["tau_s"]), {"tau_s": (1.0, 5.0)}),
)  # fmt: skip

#: Laws that only resemble the catalogue's.
OTHER: tuple[Law, ...] = (
    Law("warm_up_two", ("warm_up",), "bias in time", lambda b, p: (1.0 - p["slow"]) * np.exp(-b.t_s / p["fast_s"]) + p["slow"] * np.exp(-b.t_s / p["slow_s"]), {"fast_s": (120.0, 500.0), "slow_s": (1500.0, 4000.0), "slow": (0.3, 0.7)}),
    Law("warm_up_power", ("warm_up",), "bias in time", lambda b, p: (1.0 + b.t_s / p["t0_s"]) ** -p["power"], {"t0_s": (100.0, 800.0), "power": (0.6, 1.6)}),
    _grown("bias_ageing", ("bias_drift",), lambda s, p: np.sqrt(s), {}),
    _grown("scale_ageing", ("scale_drift",), lambda s, p: np.log1p(s / p["share"]), {"share": (0.05, 0.5)}, most=1e-3),
    _coil("coil_two_lags", lambda g, p: (1.0 - p["slow"]) * lagged(g, p["fast_s"]) + p["slow"] * lagged(g, p["slow_s"]), {"fast_s": (40.0, 150.0), "slow_s": (500.0, 1500.0), "slow": (0.2, 0.6)}),
    _coil("coil_chain", lambda g, p: lagged(lagged(lagged(g, p["tau_s"]), p["tau_s"]), p["tau_s"]), {"tau_s": (40.0, 250.0)}),
    _memory("gradient_two_lags", ("shupe_gradient", "shupe", "thermal_lag"), lambda g, p: lagged(g, p["fast_s"]) - lagged(g, p["slow_s"]), {"fast_s": (30.0, 100.0), "slow_s": (200.0, 800.0)}),
    _memory("plays_that_fade", ("thermal_hysteresis",), _slow_plays, {"slack_c": (1.0, 5.0), "tau_s": (2000.0, 8000.0)}),
    _rate("asymmetry_soft", ("scale_asymmetry",), lambda b, p: 0.5 * b.rate_dps * (1.0 + np.tanh(b.u / p["u"])), {"u": (0.05, 0.3)}, most=2e-3),
    _rate("lock_in", ("dead_zone",), _lock_in, {"u": (3e-4, 2e-3)}, low_rates=True, positive=True, most=1.0),
    _rate("knee_soft", ("saturation", "sagnac_sine", "rate_order"), lambda b, p: b.u / (1.0 + np.abs(b.u / p["u"]) ** 6) ** (1.0 / 6.0) - b.u, {"u": (0.7, 1.2)}, positive=True),
    _rate("resonance_lorentz", ("mechanical_resonance",), lambda b, p: 1.0 / (1.0 + ((np.abs(b.u) - p["u"]) / 0.04) ** 2), {"u": (0.3, 0.8)}),
    Law("sine_of_temperature", ("sagnac_sine", "rate_order"), "front", _sine, {"reach": (0.4, 0.9), "per_v": (0.01, 0.08)}, acts="front"),
    Law("ripple", ("temperature_order",), "temperature", lambda b, p: np.sin(2 * np.pi * b.v / p["v"] + p["phase_rad"]), {"v": (0.6, 1.4), **_PHASE}),
    Law("transition", ("temperature_order",), "temperature", lambda b, p: np.logaddexp(0.0, (b.v - p["v"]) / 0.12), {"v": (-0.4, 0.4)}),
    _bench("gear", ("table_eccentricity",), _harmonics, {**_PHASE, "second": (0.2, 1.0), "fourth": (0.2, 0.8)}, most=3e-4),
    _bench("step_ringing", ("step_response",), lambda b, p: b.step_dps * np.exp(-b.since_step_s / p["tau_s"]) * np.cos(2 * np.pi * p["hz"] * b.since_step_s), {"tau_s": (2.0, 5.0), "hz": (0.1, 0.4)}),
)  # fmt: skip

LAWS: dict[str, Law] = {law.name: law for law in (*PLAIN, *OTHER)}
#: Names that are true of every made-up gyro, whose surface is one of the true rate, and of one that throws outliers.
TRUE_OF_ALL = ("fit_direction",)
TRUE_OF_OUTLIERS = ("bursts",)
#: The front end of an open loop.
OPEN_LOOP = LAWS["sagnac_sine"]
#: What tables of means of an open-loop gyro hold beside its sine.
ON_TABLES = tuple(
    LAWS[name]
    for name in (
        "reference_rate_error",
        "thermal_lag",
        "scale_step",
        "scale_drift",
        "temperature_order",
        "warm_up",
    )
)
