"""Scores of the drive diagnosis on fresh made-up drives: false names, right names, intervals.

    python -m tests.diagnosis.drive.score --trials 60 --seed 1 [--effect gyro_delay=0.03]

One line a drive, then the sums. Not run by the tests: a drive takes some five seconds.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import click
import numpy as np

from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.records.robot import robot_of
from tests.diagnosis.drive.fleet import any_plan, drive


def main() -> None:
    """Draw drives, diagnose them, print what was named."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effect", default="", help="Hidden in all: NAME=SIZE, sizes as in fleet.drive.")
    options = parser.parse_args()
    name, _, size = options.effect.partition("=")
    hidden = {name: float(size)} if name else {}
    named, right, covered = 0, 0, 0
    for trial in range(options.trials):
        rng = np.random.default_rng([options.seed, trial])
        plan = any_plan(rng, hidden)
        robot = robot_of(
            {"wheel_separation_m": plan.separation_m, "static_s": plan.rest_s}, Path("robot.toml")
        )
        began = time.process_time()
        result = diagnose_drive("drive.csv", drive(plan, int(rng.integers(2**31))), robot)
        found = [e.effect for e in result.diagnosis.effects]
        named += bool(found)
        right += found[:1] == [name]
        if found[:1] == [name] and name:
            low, high = result.diagnosis.effects[0].parameters["amplitude"].interval_95
            covered += low <= float(size) <= high
        took = time.process_time() - began
        click.echo(
            f"{trial:3d} {plan.shape:8s} {plan.minutes:4.0f} min {took:5.1f} s  {result.diagnosis.verdict}: {found}"
        )
    click.echo(
        f"named something: {named}; right name first: {right}, its interval covers: {covered}; of {options.trials}"
    )


if __name__ == "__main__":
    main()
