"""Table II many times over: units, days and robots drawn anew, and how the improvement factors scatter."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from gyrocal.navigation.bench import calibrate_unit
from gyrocal.navigation.equip import DriveSource
from gyrocal.navigation.replay import LogReplay, replay_log
from gyrocal.navigation.simulate import (
    CCW,
    CW,
    Day,
    SimulatedRun,
    Spread,
    draw_day,
    draw_robot,
    robot_figures,
    simulate_experiment,
)
from gyrocal.navigation.table import FACTORS, Table, make_table
from gyrocal.navigation.track import CONDITIONS
from gyrocal.physics.gyro import GyroModel, rd2100_unit
from gyrocal.physics.surface import Surface
from gyrocal.records.robot import Robot, robot_of
from gyrocal.workers import deaf_to_interrupts

Floats = NDArray[np.float64]

_STREAM_BENCH, _STREAM_CHANGE = 11, 12


@dataclass(frozen=True)
class World:
    """What experiments are drawn from. The default is the paper's robot with the data sheet's gyro.

    The further fields change one physical input each, to see what it does to the factors:

    Attributes
    ----------
    nonlinearity, temperature_slope : float
        Factor on the terms of second and third order in rate with the slope that goes with them, and on all terms
        in temperature.
    bias_instability_deg_per_h : float or None
        None: the unit's own.
    scale_change_std : float
        Scale factor error that appears between bench and drive (ageing, supply, mounting).
    temp_offset_std_c : float
        Reported temperature on the robot minus that of the coil (gradients in the housing), within a day.
    """

    spread: Spread = field(default_factory=Spread)
    runs: int = 5
    static_s: float = 10.0
    temp_range_c: tuple[float, float] = (5.0, 35.0)
    nonlinearity: float = 1.0
    temperature_slope: float = 1.0
    bias_instability_deg_per_h: float | None = None
    scale_change_std: float = 0.0
    temp_offset_std_c: float = 0.0


#: The nonlinearity of the data sheet read as a share of the rate, over that read as a share of full scale: a cubic about
#: its best line, u^3 - 0.6 u, has an rms of 0.151 over -1..1, and 0.400 when each value is taken of its own u.
OF_THE_RATE = 0.151 / 0.400
#: Worlds to choose from: the two readings of the data sheet's "nonlinearity 0.5 % rms", and what all inputs together
#: would have to be to give the paper's table. The last is no reading of anything; it says what the table hangs on.
WORLDS: Mapping[str, World] = {
    "full-scale": World(),
    "rate": World(nonlinearity=OF_THE_RATE),
    "paper": World(
        Spread(
            separation_std=0.003,
            separation_run_std=0.0003,
            wheel_scale_std=0.0003,
            turn_slip_deg_per_rt_deg=0.03,
        ),
        nonlinearity=0.26,
        temperature_slope=0.25,
        scale_change_std=0.0008,
    ),
}


@dataclass(frozen=True)
class MonteCarlo:
    """Mean errors of each experiment, m, shape (experiments, 4), in the order of `CONDITIONS`, by direction."""

    world: World
    seed: int
    cw_m: Floats
    ccw_m: Floats

    @property
    def all_m(self) -> Floats:
        """Mean over both directions."""
        return np.asarray(0.5 * (self.cw_m + self.ccw_m))

    def factors(self) -> dict[str, Floats]:
        """Improvement factors of each experiment over no calibration and no filter, shape (experiments,)."""
        index = {c.id: k for k, c in enumerate(CONDITIONS)}
        mean = self.all_m
        return {name: mean[:, 0] / mean[:, index[condition]] for name, condition in FACTORS.items()}


def simulated_robot_file(world: World) -> Robot:
    """The robot file of a world: the same for every experiment and every condition."""
    instability = world.bias_instability_deg_per_h
    figures = robot_figures(
        world.spread,
        world.static_s,
        0.02 * world.nonlinearity,
        rd2100_unit(0).bias_instability_deg_per_h if instability is None else instability,
    )
    return robot_of(figures, Path("simulated"))


def unit_of(world: World, unit_seed: int) -> GyroModel:
    """One gyro, as it is on the bench."""
    model = rd2100_unit(unit_seed)
    c = model.surface.coefficients_dps.copy()
    # The factory's best line takes 0.6 u of u^3 (rd2100_unit): it shrinks with the cubic that it belongs to.
    c[1, 0] += 0.6 * (1.0 - world.nonlinearity) * c[3, 0]
    c[2:] *= world.nonlinearity
    c[:2, 1:] *= world.temperature_slope
    surface = replace(model.surface, coefficients_dps=c)
    instability = world.bias_instability_deg_per_h
    return replace(
        model,
        surface=surface,
        bias_instability_deg_per_h=model.bias_instability_deg_per_h if instability is None else instability,
    )


def simulate_and_replay(world: World, seed: int) -> list[LogReplay]:
    """One experiment: bench run of a unit, drives of a robot with it, every run in four conditions."""
    model = unit_of(world, seed)
    coefficients = calibrate_unit(model, np.random.default_rng([seed, _STREAM_BENCH]))
    robot = simulated_robot_file(world)
    return [
        replay_log(DriveSource(run.name, partial(_once, run)), robot, coefficients, kind="paper")
        for run in simulate_drives(world, model, seed)
    ]


def simulate_drives(
    world: World, model: GyroModel, seed: int, directions: tuple[int, ...] = (CW, CCW)
) -> list[SimulatedRun]:
    """The drives of one experiment: a robot and a day drawn, `World.runs` runs in each direction."""
    rng = np.random.default_rng([seed, _STREAM_CHANGE])
    scale_change = world.scale_change_std * rng.standard_normal()
    temp_offset_c = world.temp_offset_std_c * rng.standard_normal()
    c = model.surface.coefficients_dps.copy()
    c[1, 0] += scale_change * model.surface.rate_scale_dps
    changed: Surface = replace(model.surface, coefficients_dps=c)
    day: Day = draw_day(seed, *world.temp_range_c)
    runs = simulate_experiment(
        replace(model, surface=changed),
        draw_robot(world.spread, seed),
        day,
        seed,
        runs=world.runs,
        directions=directions,
        static_s=world.static_s,
    )
    return [
        replace(run, log=replace(run.log, gyro_temp_c=run.log.gyro_temp_c + temp_offset_c)) for run in runs
    ]


def _once(run: SimulatedRun) -> Iterator:  # type: ignore[type-arg]
    yield run.log


def experiment(world: World, seed: int) -> tuple[list[float], list[float]]:
    """Mean errors of the clockwise and of the counter-clockwise runs in the four conditions, m."""
    table: Table = make_table(simulate_and_replay(world, seed))
    means = {row.direction: [row.errors_m[c.id] for c in CONDITIONS] for row in table.means}
    return means["cw"], means["ccw"]


def monte_carlo(
    world: World,
    experiments: int,
    seed: int,
    report: Callable[[int], None],
    workers: int | None = None,
) -> MonteCarlo:
    """Many experiments on all cores; the result does not depend on how many there are.

    Parameters
    ----------
    report : callable
        Told the number of experiments done.
    workers : int, optional
        Processes; None: one a core. 1: in this process.
    """
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(experiments, dtype=np.uint32)]
    rows = []
    with closing(_map(partial(experiment, world), seeds, workers or cores())) as found:
        for row in found:
            rows.append(row)
            report(len(rows))
    errors = np.array(rows)
    return MonteCarlo(world, seed, errors[:, 0], errors[:, 1])


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _map(
    function: Callable[[int], tuple[list[float], list[float]]], seeds: Sequence[int], workers: int
) -> Generator[tuple[list[float], list[float]], None, None]:
    if workers == 1:
        yield from map(function, seeds)
        return
    # Fresh processes: a fork would copy the locks of numba's and BLAS's threads.
    context = multiprocessing.get_context("spawn")
    ended, alive = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(min(workers, len(seeds)), context, _end_with_parent, (ended,))
    with pool, alive:
        with deaf_to_interrupts():
            waiting = [pool.submit(function, seed) for seed in seeds]
        for future in waiting:
            yield future.result()


def _end_with_parent(ended: Connection) -> None:
    """Let this process end when its parent closes the other end of the pipe or dies, whatever it was killed by."""
    Thread(target=_end_at, args=(ended,), daemon=True).start()


def _end_at(ended: Connection) -> None:
    ended.poll(None)
    os._exit(1)
