"""Recordings of four kinds, drawn whole from a seed: layers, other laws, other sensors, and nothing at all made hard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gyrocal.trial.conceal import Concealed, Hidden, error_dps, hide
from gyrocal.trial.gyros import Gyro, Oddity, make_gyro
from gyrocal.trial.laws import ON_TABLES, OPEN_LOOP, OTHER, PLAIN, TRUE_OF_ALL, TRUE_OF_OUTLIERS, Law
from gyrocal.trial.plans import Bench, Frame, RunPlan, run_bench, sweep, table_bench
from gyrocal.trial.recordings import write_run, write_table
from gyrocal.trial.second import SecondRun, second_run

Floats = NDArray[np.float64]

#: Rates near zero, in shares of the largest.
_LOW = (1e-4, 2e-4, 4e-4, 7e-4, 1e-3, 1.5e-3, 2.5e-3, 5e-3)
_SENSORS = ("mems", "open_loop", "open_loop", "navigation", "thermometer", "steps")
_NULLS = ("flicker", "walk", "scatter_by_rate", "outliers", "missing_rates", "thermometer", "few", "many")


@dataclass(frozen=True)
class MadeUp:
    """A recording, its answer, and the second run.

    Attributes
    ----------
    gyro_dps, temp_c : ndarray, shape (n,)
        What gyro and thermometer say in the rows of `bench`.
    told : bool
        Whether a table tells times and scatter.
    """

    answer: Concealed
    gyro: Gyro
    hidden: tuple[Hidden, ...]
    bench: Bench
    gyro_dps: Floats
    temp_c: Floats
    second: SecondRun
    told: bool

    def write(self, out: Path) -> Path:
        """The recording that is to be diagnosed, in `out`."""
        spread = np.full(self.temp_c.size, 4.0) * self.gyro.noise.white_dps(self.bench) if self.told else None
        return self._write(out, "recording", self.bench, self.gyro_dps, self.temp_c, spread)

    def write_second(self, out: Path) -> Path:
        """The second run, in `out`."""
        bench = self.second.bench
        spread = np.zeros(bench.t_s.size) if self.told else None
        return self._write(out, "second", bench, self.second.gyro_dps, bench.temp_c, spread)

    def _write(
        self, out: Path, name: str, bench: Bench, gyro_dps: Floats, temp_c: Floats, spread_dps: Floats | None
    ) -> Path:
        if bench.is_run:
            return write_run(out / name, bench, self.gyro, gyro_dps, temp_c, self.answer.nonce[:8])
        return write_table(out / f"{name}.csv", bench, gyro_dps, temp_c, spread_dps)


@dataclass(frozen=True)
class Wish:
    """What a recording is to be, before anything of it is drawn."""

    make: str
    pool: tuple[Law, ...] = ()
    given: tuple[Law, ...] = ()
    count: int = 0
    strengths: tuple[float, ...] = (20.0,)
    least: float = 0.0
    plan: str = "shuffled"
    sets: int = 171
    oddity: Oddity = field(default_factory=Oddity)
    fixed: Mapping[str, float] | None = None


def make_up(kind: str, seed: int, number: int) -> MadeUp:
    """Recording `number` of a kind; the same for the same arguments."""
    rng = np.random.default_rng([seed, number, sorted(KINDS).index(kind)])
    order = np.random.default_rng([seed, sorted(KINDS).index(kind)])
    wish = KINDS[kind](number, order, rng)
    gyro = make_gyro(wish.make, wish.oddity, rng)
    bench = _bench(wish, gyro.frame, rng)
    hidden, layers = hide(
        bench,
        gyro,
        wish.pool,
        wish.count,
        wish.strengths,
        rng,
        given=wish.given,
        least=wish.least,
        fixed=wish.fixed,
    )
    noise_dps, walked_dps = gyro.noise.draw(bench, rng)
    analogue_dps = bench.rate_dps + error_dps(bench, gyro, hidden) + noise_dps
    gyro_dps = gyro.read_rate(analogue_dps, bench, rng)
    told = bool(rng.random() < 0.5)
    also = TRUE_OF_ALL + (TRUE_OF_OUTLIERS if gyro.noise.outliers else ())
    answer = Concealed(kind, wish.make, wish.plan, wish.oddity.name, also, tuple(layers), rng.bytes(16).hex())
    second = second_run(bench, _second_bench(wish, gyro.frame, rng), gyro, hidden, walked_dps)
    return MadeUp(
        answer, gyro, tuple(hidden), bench, gyro_dps, gyro.read_temperature(bench.temp_c, rng), second, told
    )


def _layers(number: int, order: np.random.Generator, rng: np.random.Generator) -> Wish:
    """Three to five laws of the catalogue, by turns on tables of means and on full runs."""
    count, strengths = int(rng.integers(3, 6)), (8.0, 12.0, 20.0, 40.0, 100.0, 300.0)
    if number % 2 == 0:
        return Wish("box", ON_TABLES, (OPEN_LOOP,), count, strengths, plan="table")
    pool = tuple(law for law in PLAIN if not law.low_rates and law.acts != "front")
    return Wish("fog", pool, count=count, strengths=strengths, least=5.0, plan=_plan(rng))


def _laws(number: int, order: np.random.Generator, rng: np.random.Generator) -> Wish:
    """One law that only resembles the catalogue's, each in its turn."""
    law = OTHER[int(order.permutation(len(OTHER))[number % len(OTHER)])]
    plan = "low" if law.low_rates else _plan(rng)
    return Wish("fog", given=(law,), count=1, strengths=(20.0, 40.0, 60.0, 100.0), least=12.0, plan=plan)


def _sensors(number: int, order: np.random.Generator, rng: np.random.Generator) -> Wish:
    """Another sensor, with one law or none, each class in its turn."""
    name = _SENSORS[int(order.permutation(len(_SENSORS))[number % len(_SENSORS)])]
    pool = tuple(law for law in PLAIN if not law.low_rates and law.acts == "adds")
    count = int(rng.random() < 0.75)
    strengths = (20.0, 30.0, 40.0, 100.0)
    if name == "open_loop":
        short = float(np.exp(rng.uniform(np.log(0.01), np.log(0.35))))
        reach = float(brentq(lambda x: np.sin(x) / x - 1.0 + short, 1e-3, 3.0))
        oddity = Oddity(f"open loop, {short:.0%} short at full rate")
        return Wish("fog", pool, (OPEN_LOOP,), 1 + count, strengths, plan=_plan(rng), oddity=oddity, fixed={"reach": reach})  # fmt: skip
    if name == "thermometer":
        oddity = Oddity("coarse thermometer", {"thermometer_step_c": float(rng.choice([0.5, 1.0]))})
    elif name == "steps":
        oddity = Oddity("coarse output", {"lsb_dps": float(rng.choice([0.003, 0.0122, 0.03]))})
    else:
        oddity = Oddity()
    make = name if name in ("mems", "navigation") else "fog"
    return Wish(make, pool, count=count, strengths=strengths, plan=_plan(rng), oddity=oddity)


def _nulls(number: int, order: np.random.Generator, rng: np.random.Generator) -> Wish:
    """Nothing hidden, and noise, thermometer or plan awkward, each way in its turn; tables and runs at random."""
    name = _NULLS[int(order.permutation(len(_NULLS))[number % len(_NULLS)])]
    table = name in ("few", "many") or bool(rng.random() < 0.4)
    make = "box" if table else "fog"
    figures = {
        "flicker": {"flicker": float(rng.uniform(1e-3, 4e-3))},
        "walk": {"walk": float(rng.uniform(2e-3, 1e-2))},
        "scatter_by_rate": {"grows": float(rng.uniform(3.0, 20.0)), "jitter": float(rng.uniform(3e-5, 3e-4))},
        "outliers": {"outliers": float(rng.uniform(0.002, 0.02))},
        "thermometer": {"thermometer_step_c": float(rng.choice([0.0, 0.5, 1.0])), "thermometer_noise_c": float(rng.choice([0.05, 0.3]))},
    }.get(name, {})  # fmt: skip
    sets = {"few": int(rng.integers(14, 40)), "many": int(rng.integers(300, 601))}.get(name, 171)
    plan = "table" if table else _plan(rng)
    if name == "missing_rates" and not table:
        plan = "missing"
    return Wish(make, plan=plan, sets=sets, oddity=Oddity(name, figures))


#: Kind to what draws its wish from number, an order that all numbers share, and what is drawn afresh.
KINDS: Mapping[str, Callable[[int, np.random.Generator, np.random.Generator], Wish]] = {
    "layers": _layers,
    "laws": _laws,
    "sensors": _sensors,
    "nulls": _nulls,
}


def _plan(rng: np.random.Generator) -> str:
    return str(rng.choice(["sweep", "shuffled", "dense"]))


def _bench(wish: Wish, frame: Frame, rng: np.random.Generator) -> Bench:
    if wish.plan == "table":
        rates = sweep(frame.max_rate_dps, 57 if wish.sets > 100 else 9)
        if wish.oddity.name == "missing_rates":
            rates = rates[rng.random(rates.size) > 0.4]
        return table_bench(frame, rates, wish.sets, rng)
    rates = sweep(frame.max_rate_dps, 21 if wish.plan == "dense" else 13)
    if wish.plan == "low":
        low = frame.max_rate_dps * np.array(_LOW)
        rates = np.concatenate([rates, low, -low])
    visits = [_visit(rates, wish.plan, rng) for _ in range(_temperatures(frame, rng).size)]
    temperatures = _temperatures(frame, rng, len(visits))
    dwell = float(rng.choice([1.0, 2.0])) if wish.plan == "missing" else 10.0
    return run_bench(frame, RunPlan(temperatures.tolist(), visits, dwell), rng)


def _visit(rates: Floats, plan: str, rng: np.random.Generator) -> Floats:
    if plan in ("shuffled", "low"):
        return np.asarray(rng.permutation(rates))
    if plan == "missing":
        return np.asarray(rates[np.append(True, rng.random(rates.size - 1) > 0.4)])
    return np.asarray(rates)


def _temperatures(frame: Frame, rng: np.random.Generator, count: int = 0) -> Floats:
    """Stops of the chamber: up through the range, and down between the stops of the way up."""
    count = count or int(rng.integers(5, 8))
    way_up = np.linspace(-0.95, 0.95, count - count // 3)
    way_down = 0.5 * (way_up[1:] + way_up[:-1])[::-1][: count // 3]
    jitter = rng.uniform(-0.05, 0.0, size=count)
    return np.asarray(frame.centre_c + frame.half_range_c * (np.concatenate([way_up, way_down]) + jitter))


def _second_bench(wish: Wish, frame: Frame, rng: np.random.Generator) -> Bench:
    """Other temperatures, rates, times and order."""
    if wish.plan == "table":
        return table_bench(frame, 0.97 * sweep(frame.max_rate_dps, 41), 171, rng)
    rates = 0.96 * sweep(frame.max_rate_dps, 11)
    if wish.plan == "low":
        low = 1.2 * frame.max_rate_dps * np.array(_LOW)
        rates = np.concatenate([rates, low, -low])
    temperatures = frame.centre_c + frame.half_range_c * rng.uniform(-0.85, 0.85, size=5)
    visits = [np.asarray(rng.permutation(rates)) for _ in temperatures]
    return run_bench(
        frame, RunPlan(temperatures.tolist(), visits, 4.0, float(rng.uniform(1.5, 3.0)), 480.0), rng
    )
