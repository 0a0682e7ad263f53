"""Made-up gyros on a table, and their user's simulation, which lacks one to three effects and has another surface.

Written from `physics.md` without the catalogue: the unit lags behind its chamber, every course of the chamber is another
one, and the simulation counts on a clock of its own. A command line scores what `diagnose --simulation` makes of them::

    python -m tests.diagnosis.versus.pairs --first 1 --last 24
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrocal.diagnosis.engine import Options
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import Versus, versus
from gyrocal.records.datasets import DataSetTable

Floats = NDArray[np.float64]
Law = Callable[["_World", Mapping[str, float]], Floats]

_SAMPLE_S, _SET_S, _SOAK_S = 0.2, 30.0, 300.0
_RAMP_C_PER_MIN, _UNIT_LAG_S, _TOP_DPS = 1.5, 120.0, 100.0
#: Standard deviations of the surface's terms, deg/s, by order of the rate; and what each order of the temperature has of that.
_BY_RATE, _BY_TEMP = np.array([[0.02], [0.05], [0.01], [0.02]]), np.array([1.0, 0.4, 0.15])
#: Strengths that are hidden, d' beside a surface; and the largest drift of a scale factor, an hour.
_D_PRIMES, _MOST_DRIFT = (20.0, 200.0), 3e-4
#: Names that are as good: one law in three forms.
_TWINS = frozenset({"shupe", "shupe_gradient", "thermal_lag"})


@dataclass(frozen=True)
class _World:
    """A course of the bench, a row a sample."""

    t_s: Floats
    rate_dps: Floats
    temp_c: Floats
    set_index: NDArray[np.int64]

    def means(self, values: Floats) -> Floats:
        """Over each data set."""
        inside = self.set_index >= 0
        number = self.set_index[inside]
        return np.asarray(np.bincount(number, values[inside]) / np.bincount(number))


@dataclass(frozen=True)
class Pair:
    """A recording, a simulation of it, what the latter lacks (ids and d'), and the white noise of a second, deg/s."""

    real: DataSetTable
    simulated: DataSetTable
    hidden: dict[str, float]
    noise_dps: float


def _lagged(x: Floats, tau_s: float) -> Floats:
    keep = float(np.exp(-_SAMPLE_S / tau_s))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0])


def _play(world: _World, p: Mapping[str, float]) -> Floats:
    inside, last = 0.0, world.temp_c[0]
    found = np.empty(world.t_s.size)
    for k, now in enumerate(world.temp_c):
        inside = min(max(inside + (now - last) / p["width_c"], -1.0), 1.0)
        found[k], last = inside, now
    return found


_LAWS: dict[str, Law] = {
    "warm_up": lambda w, p: np.exp(-w.t_s / p["tau_s"]),
    "thermal_lag": lambda w, p: _lagged(w.temp_c, p["lag_s"]) - w.temp_c,
    "shupe": lambda w, p: np.gradient(w.temp_c, _SAMPLE_S) * 60.0,
    "scale_asymmetry": lambda w, p: np.abs(w.rate_dps),
    "temperature_order": lambda w, p: ((w.temp_c - 20.0) / 30.0) ** 3,
    "bias_step": lambda w, p: (w.t_s > p["at"] * w.t_s[-1]).astype(np.float64),
    "scale_drift": lambda w, p: w.rate_dps * w.t_s / 3600.0,
    "sagnac_sine": lambda w, p: np.sin(p["phase"] * w.rate_dps) / p["phase"] - w.rate_dps,
    "mechanical_resonance": lambda w, p: np.exp(-0.5 * ((np.abs(w.rate_dps) - p["center_dps"]) / 3.0) ** 2),
    "thermal_hysteresis": _play,
}
#: What a plan without a way back does not show.
_BOTH_WAYS = "thermal_hysteresis"


def _world(rates: Floats, temps: Floats, shuffled: bool, rng: np.random.Generator) -> _World:
    rate: list[Floats] = []
    chamber: list[Floats] = []
    index: list[NDArray[np.int64]] = []
    here, number = float(temps[0]), 0
    for goal in temps + rng.normal(0.0, 0.3, temps.size):
        way = np.linspace(here, goal, int(abs(goal - here) / _RAMP_C_PER_MIN * 60.0 / _SAMPLE_S))
        still = np.full(int(_SOAK_S / _SAMPLE_S), goal)
        rate.append(np.zeros(way.size + still.size))
        chamber.append(np.concatenate([way, still]))
        index.append(np.full(rate[-1].size, -1))
        for turn in rng.permutation(rates) if shuffled else rates:
            rate.append(np.full(int(_SET_S / _SAMPLE_S), turn))
            chamber.append(np.full(rate[-1].size, goal))
            index.append(np.full(rate[-1].size, number))
            number += 1
        here = float(goal)
    case = np.concatenate(chamber)
    t_s: Floats = _SAMPLE_S * np.arange(case.size, dtype=np.float64)
    return _World(t_s, np.concatenate(rate), _lagged(case, _UNIT_LAG_S), np.concatenate(index))


def _terms(world: _World) -> Floats:
    """Twelve terms of a surface, shape (n, 12)."""
    u, v = world.rate_dps / _TOP_DPS, (world.temp_c - 20.0) / 30.0
    return np.column_stack([u**i * v**j for i in range(4) for j in range(3)])


def _unit(law: str, world: _World, p: Mapping[str, float]) -> tuple[Floats, float]:
    """A law of amplitude one, and its d' beside a surface in white noise of one in a second."""
    column = _LAWS[law](world, p)
    mean, X = world.means(column), np.column_stack([world.means(x) for x in _terms(world).T])
    beyond = mean - X @ np.linalg.lstsq(X, mean, rcond=None)[0]
    return column, float(np.linalg.norm(beyond) * np.sqrt(_SET_S))


def make_pair(seed: int) -> Pair:
    """The pair of a seed."""
    rng = np.random.default_rng([77, seed])
    sizes = np.sort(rng.choice([5.0, 10, 20, 30, 45, 60, 75, 90], 4, replace=False))
    rates = np.concatenate([-sizes[::-1], [0.0], sizes])
    temps = np.linspace(-10.0, 50.0, int(rng.integers(4, 7)))
    back = rng.random() < 0.5
    temps = np.concatenate([temps, temps[::-1][1:]]) if back else temps
    noise = 10.0 ** rng.uniform(-3.3, -2.3)
    names = rng.choice([n for n in _LAWS if back or n != _BOTH_WAYS], int(rng.integers(1, 4)), replace=False)
    shuffled = rng.random() < 0.5
    here, there = (_world(rates, temps, shuffled, rng) for _ in range(2))
    surface = (rng.normal(size=(4, 3)) * _BY_RATE * _BY_TEMP).ravel()
    output, hidden = here.rate_dps + _terms(here) @ surface, {}
    for name in (str(n) for n in names):
        p = {"tau_s": rng.uniform(600, 3000), "lag_s": rng.uniform(200, 900), "at": rng.uniform(0.2, 0.8)}
        p |= {"phase": rng.uniform(0.004, 0.012), "center_dps": rng.choice(sizes) + rng.normal()}
        p["width_c"] = rng.uniform(3, 12)
        column, one = _unit(name, here, p)
        size = 1.0 if name == "sagnac_sine" else noise * np.exp(rng.uniform(*np.log(_D_PRIMES))) / one
        size = min(size, _MOST_DRIFT) if name == "scale_drift" else size
        hidden[name] = size * one / noise
        output += size * rng.choice([-1.0, 1.0]) * column if name != "sagnac_sine" else column
    output += rng.normal(0.0, noise / np.sqrt(_SAMPLE_S), output.size)
    simulated = there.rate_dps + _terms(there) @ (surface * rng.normal(1.0, 0.1, 12))
    clock_s = 300.0 + there.t_s * (1.0 + 200e-6 * rng.normal())
    return Pair(
        _table("real.csv", here, here.t_s, output, rng),
        _table("simulated.csv", there, clock_s, simulated, rng),
        hidden,
        noise,
    )


def _table(
    name: str, world: _World, t_s: Floats, output_dps: Floats, rng: np.random.Generator
) -> DataSetTable:
    read = np.round(world.temp_c + rng.normal(0.0, 0.02, world.temp_c.size), 2)
    columns = (world.means(x) for x in (world.rate_dps, output_dps, read, t_s))
    rate, gyro, temp, t = columns
    return DataSetTable(Path(name), rate, gyro, np.round(temp, 4), t_s=t)


def answer(pair: Pair, *, heldout: bool = True) -> Versus:
    """What `diagnose` makes of a pair."""
    return versus(series_of_table(pair.real), series_of_table(pair.simulated), Options(heldout=heldout))


def is_named(law: str, names: set[str]) -> bool:
    """Whether a law has a right name among these."""
    return bool(names & (_TWINS if law in _TWINS else {law}))


def judged(pair: Pair, found: Versus) -> tuple[list[bool], list[bool]]:
    """Of each strong law whether it is named, and of each name whether it is wrong."""
    names = {e.effect for e in found.diagnosis.effects}
    right = [is_named(n, names) for n, d in pair.hidden.items() if d >= _D_PRIMES[0]]
    return right, [not any(is_named(h, {n}) for h in pair.hidden) for n in names]


def main() -> None:
    """Print a line a pair, and the sums."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--last", type=int, default=24)
    options = parser.parse_args()
    counts = np.zeros(6, dtype=int)
    for seed in range(options.first, options.last + 1):
        pair = make_pair(seed)
        found = answer(pair)
        names = [e.effect for e in found.diagnosis.effects]
        right, wrong = judged(pair, found)
        counts += [sum(right), len(right), sum(wrong), len(wrong), found.helps, 1]
        told = ", ".join(f"{n} {d:.0f}" for n, d in pair.hidden.items())
        left = found.comparison and (1e3 * found.comparison.before_dps, 1e3 * found.comparison.after_dps)
        click.echo(
            f"{seed}: hidden {told}; named {', '.join(sorted(names)) or '-'}; left out, mdeg/s: {left}"
        )
    click.echo(
        "named {} of {}, wrong {} of {} names, nearer on data left out {} of {}".format(*counts.tolist())
    )


if __name__ == "__main__":
    main()
