"""What `gyrocal simulate drive` writes: logs, robot file, and a note of what is true in them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gyrocal
from gyrocal.navigation.montecarlo import World, simulate_drives, simulated_robot_file, unit_of
from gyrocal.navigation.simulate import CCW, CW, draw_day, draw_robot
from gyrocal.records.drive import format_drive_log
from gyrocal.records.output import check_output, write_directory
from gyrocal.records.robot import format_robot

DIRECTIONS = {"cw": (CW,), "ccw": (CCW,), "both": (CW, CCW)}

#: Schema of simulation.json.
SCHEMA = "gyrocal-simulated-drives/1"


@dataclass(frozen=True)
class DriveRequest:
    """What to simulate; see `gyrocal simulate drive --help`."""

    out: Path
    seed: int
    unit_seed: int = 1
    runs: int = 5
    direction: str = "both"


def simulated_files(request: DriveRequest) -> tuple[dict[str, str], dict[str, Any]]:
    """Texts by file name, and the note of what is true; the same request gives the same bytes."""
    world = World(runs=request.runs)
    model = unit_of(world, request.unit_seed)
    runs = simulate_drives(world, model, request.seed, DIRECTIONS[request.direction])
    robot = draw_robot(world.spread, request.seed)
    note = {
        "schema": SCHEMA,
        "software": f"gyrocal {gyrocal.__version__}",
        "seed": request.seed,
        "unit_seed": request.unit_seed,
        "gyro": f"KVH E-Core RD2100, virtual unit {request.unit_seed}: the one of bench profiles with virtual.unit_seed = {request.unit_seed}",
        "day": asdict(draw_day(request.seed, *world.temp_range_c)),
        "robot_as_it_is": {
            "right_scale": robot.scale_right,
            "left_scale": robot.scale_left,
            "wheel_separation_m": robot.wheel_separation_m,
        },
        "robot_as_it_is_known": asdict(world.spread),
        "runs": [
            {
                "file": f"{run.name}.csv",
                "direction": "ccw" if run.direction == CCW else "cw",
                "rows": len(run.log),
                "duration_s": float(run.log.t_s[-1]),
            }
            for run in runs
        ],
    }
    files = {f"{run.name}.csv": format_drive_log(run.log, run.metres_per_tick) for run in runs}
    files["robot.toml"] = format_robot(simulated_robot_file(world))
    files["simulation.json"] = json.dumps(note, indent=1) + "\n"
    return files, note


def simulate_to_directory(request: DriveRequest) -> dict[str, Any]:
    """Simulate, then write everything to ``request.out``: logs, ``robot.toml``, ``simulation.json``."""
    check_output(request.out)
    files, note = simulated_files(request)
    write_directory(request.out, files)
    return note
