"""`gyrocal simulate table2`: the paper's experiments many times over, and all that is written of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gyrocal.navigation.bench import calibrate_unit
from gyrocal.navigation.montecarlo import (
    WORLDS,
    MonteCarlo,
    monte_carlo,
    simulate_and_replay,
    simulated_robot_file,
    unit_of,
)
from gyrocal.navigation.sensitivity import calibration_error_cm, coefficient_sensitivities, sensitivities
from gyrocal.navigation.simulate import draw_day
from gyrocal.navigation.table import make_table
from gyrocal.records.files import make_output_directory
from gyrocal.report.navigation_table2 import WHAT_IF, Simulated, Table2Request, Table2Result, write_table2

Report = Callable[[float, str], None]


def table2_to_directory(request: Table2Request, report: Report) -> Table2Result:
    """Run the experiments, then write page, figures, tables and summary to ``request.out``."""
    make_output_directory(request.out)
    result = write_table2(request, _simulated(request, report))
    report(1.0, "")
    return result


def _simulated(request: Table2Request, report: Report) -> Simulated:
    chosen = WORLDS[request.world]
    others = {name: world for name, world in WHAT_IF.items() if world != chosen} if request.what_if else {}
    total = request.experiments + request.what_if * len(others)
    base = 0

    def said(done: int) -> None:
        report(0.97 * (base + done) / total, f"{base + done} of {total} experiments")

    table = make_table(simulate_and_replay(chosen, request.seed))
    main = monte_carlo(chosen, request.experiments, request.seed, said, request.workers)
    base = request.experiments
    changed: dict[str, MonteCarlo] = {}
    for name, world in others.items():
        changed[name] = monte_carlo(world, request.what_if, request.seed, said, request.workers)
        base += request.what_if
    world, rng = chosen, np.random.default_rng([request.seed, 21])
    model = unit_of(world, request.seed)
    parameters = simulated_robot_file(world).parameters
    coefficients = calibrate_unit(model, rng)
    temp_c = draw_day(request.seed, *world.temp_range_c).temp_c
    parts = {
        "sensitivity": sensitivities(world.spread, parameters, model, rng),
        "coefficients": coefficient_sensitivities(world.spread, parameters, coefficients, temp_c),
    }
    both = calibration_error_cm(world.spread, parameters, coefficients, temp_c)
    return Simulated(table, main, changed, parts, both)
