"""Scores of the drive diagnosis on fresh made-up drives: names, intervals, and metres on a second drive.

    python -m tests.diagnosis.drive.score --trials 60 --seed 1 [--effects gyro_delay,skid_slip] [--d-primes 8,12]

Without effects nothing is hidden. One line a drive, then shares with Wilson intervals. An effect is hidden at each d'
in turn: so many standard deviations of its amplitude by a fit that knows the noise, with bias, track and wheels free.
Not run by the tests: a drive takes some five seconds.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from gyrocal.diagnosis.drive.engine import examine
from gyrocal.diagnosis.drive.estimates import DriveEstimate, estimates_of
from gyrocal.diagnosis.drive.findings import named_effects, verdict
from gyrocal.diagnosis.drive.improved import improved_robot
from gyrocal.diagnosis.drive.laws import candidate_laws, constant_laws, frame_of, wheel_laws
from gyrocal.diagnosis.drive.places import places
from gyrocal.diagnosis.drive.prior import known_before
from gyrocal.diagnosis.drive.reckoning import laid_on
from gyrocal.diagnosis.drive.series import drive_series, nodes_of
from gyrocal.diagnosis.drive.weighing import gram_of
from gyrocal.diagnosis.drive.yaw import YawModel, YawNoise, usual_noise
from gyrocal.diagnosis.result import NamedEffect
from gyrocal.navigation.equip import DriveSource, aligned, equip
from gyrocal.records.drive import DriveBlock
from gyrocal.records.robot import Robot, robot_of
from tests.diagnosis.drive.fleet import Plan, again, drive, scored_plan

#: Sizes of the fleet in SI (deg/s of the gyro) and the law of the finder with which d' is worked out.
HIDDEN: Mapping[str, tuple[str, float]] = {
    "gyro_bias": ("step", 1e3),
    "bias_temperature": ("slope", 1e3),
    "gyro_delay": ("delay", 1.0),
    "skid_slip": ("slip_turn_rate", 100.0),
    "wheel_asymmetry": ("asymmetry", 100.0),
    "wheel_eccentricity": ("wheel_cos", 100.0),
    "gyro_scale": ("gyro_scale", 100.0),
    "wheel_scale": ("wheel_scale", 100.0),
}
_NEEDS_TRUTH = ("gyro_scale", "wheel_scale")
_NAMES_TRUE = {"gyro_bias", "earth_rate"}
_RADIUS_M = 0.12


def wilson(hits: int, trials: int) -> str:
    """A share with its 95 % interval."""
    if not trials:
        return "-"
    z, share = 1.959964, hits / trials
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials**2))
    return f"{hits} of {trials}: {100 * share:.1f} % ({100 * (middle - half):.1f} to {100 * (middle + half):.1f})"


def robot_file(plan: Plan) -> Robot:
    """The robot file of a plan: true geometry and noise, as a user has them from data sheets."""
    return robot_of(
        {
            "wheel_separation_m": plan.separation_m,
            "static_s": max(plan.rest_s - 0.5, 0.0),
            "initial_std": {
                "wheel_separation_m": 0.02 * plan.separation_m,
                "left_scale": 0.002,
                "right_scale": 0.002,
            },
            "noise": {"angle_random_walk_deg_per_rt_h": 60.0 * plan.arw_dps_rt_s},
        },
        Path("robot.toml"),
    )


def _sigma(effect: str, plan: Plan, seed: int) -> float:
    """Standard deviation of an effect's amplitude in SI on this drive, by the noise that it was made with."""
    series = drive_series("drive.csv", drive(plan, seed), robot_file(plan), None)
    frame = frame_of(series, nodes_of(series), 0.0, 0.0, plan.bias_dps)
    # Three Gauss-Markov parts a decade apart, each of the strength of the floor.
    noise = YawNoise(
        plan.arw_dps_rt_s,
        max(plan.wheel_noise, 1e-5),
        max(math.sqrt(2.0) * plan.turn_noise / plan.separation_m, 1e-5),
        plan.tick_m * math.sqrt(2.0 / 12.0),
        plan.flicker_dps,
        1e-4,
        4.0,
        1e-5,
        4.0,
        1e-5,
    )
    if effect in _NEEDS_TRUTH:
        found = examine("drive.csv", drive(plan, seed), robot_file(plan), None).truth
        return math.inf if found is None else found.stds[effect]
    starting = ~frame.nodes.resting & ~series.moved[frame.nodes.rows[:-1]]
    y = np.zeros(frame.nodes.dt_s.size)
    left_out = np.where(frame.nodes.broken | starting, 1.0, 0.0)
    model = YawModel(frame, y, noise, usual_noise(series), left_out, np.zeros(0, dtype=np.int64), {})
    laws = constant_laws(frame)
    law, _ = HIDDEN[effect]
    if effect == "wheel_eccentricity":
        laws |= dict(zip(("wheel_cos", "wheel_sin"), wheel_laws(frame, 1.0, _RADIUS_M), strict=True))
    else:
        candidates = candidate_laws(frame)
        if law not in (laws | candidates):
            return math.inf
        laws[law] = (laws | candidates)[law]
    gram = gram_of(model, {n: x.column for n, x in laws.items()}).knowing(known_before(series))
    names = list(laws)
    return float(np.sqrt(gram.solve(names)[1][names.index(law), names.index(law)]))


def plans(seed: int, trial: int, effect: str, d_prime: float) -> Iterator[tuple[Plan, int, float]]:
    """Plans in which the effect can show at all, with the amplitude hidden, in the fleet's unit."""
    for attempt in range(50):
        rng = np.random.default_rng([seed, trial, attempt])
        plan, own = scored_plan(rng), int(rng.integers(2**31))
        if not effect:
            yield plan, own, 0.0
            continue
        if effect in _NEEDS_TRUTH and not 0.0 < plan.truth_m <= 0.3:
            continue
        sigma = _sigma(effect, plan, own)
        _, per_si = HIDDEN[effect]
        # A gyro is never early: encoders that are late would be late against the truth too.
        sign = 1.0 if effect == "gyro_delay" else float(rng.choice([-1.0, 1.0]))
        size = d_prime * sigma * per_si * sign
        limit = {"gyro_delay": 0.3, "skid_slip": 40.0, "wheel_eccentricity": 8.0}.get(effect, math.inf)
        if not math.isfinite(size) or abs(size) > limit:
            continue
        extra = {"exponent": 1.0} if effect == "skid_slip" else {}
        yield replace(plan, effects={effect: size, **extra}), own, size


def _second(plan: Plan, seed: int, trial: int, robot: Robot, better: Robot | None, with_filter: bool) -> Any:
    """Metres on a second drive by the gyro's heading, and by the filter: before, after."""
    rng = np.random.default_rng([seed, trial, 99])
    log = drive(again(plan, rng), int(rng.integers(2**31)))
    kinds = ("gyro", "filter") if with_filter else ("gyro",)
    return {
        k: [None if r is None else metres(log, r, filtering=k == "filter") for r in (robot, better)]
        for k in kinds
    }


def metres(log: DriveBlock, robot: Robot, *, filtering: bool) -> float:
    """Rms position error of the drive model on a log with truth, the frame laid on it."""
    source = DriveSource("drive", lambda: iter([log]))
    equipment = equip(source, robot, "model", None, None)
    navigator = equipment.navigator(filtering=filtering)
    at = []
    for rows, _ in aligned(source, robot.parameters):
        out = navigator.run(rows.t_s, rows.left_m, rows.right_m, rows.gyro_dps, rows.temp_c, rows.smooth_dps)
        at.append(out.x_m + 1j * out.y_m)
    return laid_on(np.concatenate(at), log.truth_x_m + 1j * log.truth_y_m)[1]


def _amplitude(effects: list[NamedEffect], effect: str) -> tuple[float, float, float] | None:
    for e in effects:
        if e.effect == effect:
            a = e.parameters["amplitude"]
            return a.value, *a.interval_95
    return None


@dataclass(frozen=True)
class Diagnosed:
    """Verdict and names of a drive, its estimates, and the robot file that comes of it."""

    verdict: str
    effects: list[NamedEffect]
    estimates: tuple[DriveEstimate, ...]
    better: Robot | None


def diagnosed(log: DriveBlock, robot: Robot) -> Diagnosed:
    """Diagnose one log."""
    found = examine("drive.csv", log, robot, None)
    effects = named_effects(found.series, found.yaw, found.truth, found.parts, found.checks)
    located = places(found.series, found.yaw, found.truth, effects)
    better = improved_robot(found.series, found.yaw, found.truth, found.parts, found.figures)
    estimates = estimates_of(found.series, found.yaw, found.truth, found.parts, found.figures)
    return Diagnosed(verdict(effects, located), effects, estimates, better)


def _trial(seed: int, trial: int, effect: str, d_prime: float, *, with_filter: bool) -> dict[str, Any]:
    plan, own, size = next(plans(seed, trial, effect, d_prime))
    robot = robot_file(plan)
    found = diagnosed(drive(plan, own), robot)
    effects, better = found.effects, found.better
    bias = next(e for e in found.estimates if e.name == "gyro_bias")
    interval = _amplitude(effects, effect) if effect else None
    hidden = 1e4 * size if effect == "gyro_scale" else size
    if effect == "wheel_eccentricity":
        # Its sign is half a turn of the phase.
        hidden = abs(hidden)
    return {
        "trial": trial, "effect": effect, "d_prime": d_prime, "shape": plan.shape, "rest_s": plan.rest_s,
        "hidden": hidden, "named": [e.effect for e in effects], "verdict": found.verdict,
        "amplitude": interval, "bias": [plan.bias_dps, bias.value, bias.std],
        "file": None if better is None else sorted(better.given - robot.given),
        "second": _second(plan, seed, trial, robot, better, with_filter),
    }  # fmt: skip


def _summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    nulls = [r for r in rows if not r["effect"]]
    # Without a rest at the start a constant bias is in the log, and naming it is right.
    false = [r for r in nulls if set(r["named"]) - (_NAMES_TRUE if r["rest_s"] == 0 else set())]
    yield "nothing hidden, a name: " + wilson(len(false), len(nulls))
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for r in rows:
        if r["effect"]:
            groups[f"d' {r['d_prime']:g}"].append(r)
            groups[r["effect"]].append(r)
            groups["all"].append(r)
    for name, group in sorted(groups.items()):
        right = [r for r in group if r["named"][:1] == [r["effect"]]]
        seen = [r for r in group if r["amplitude"] is not None]
        covered = sum(r["amplitude"][1] <= r["hidden"] <= r["amplitude"][2] for r in seen)
        alone = sum(r["named"] == [r["effect"]] for r in group)
        yield f"{name}: right name first {wilson(len(right), len(group))}; nothing else {alone}; interval covers {wilson(covered, len(seen))}"
    # With a slope the bias is that of another temperature.
    off = [
        abs(r["bias"][1] - r["bias"][0]) < 1.959964 * r["bias"][2]
        for r in rows
        if r["effect"] not in ("bias_temperature", "gyro_bias")
    ]
    yield "interval of the bias covers: " + wilson(sum(off), len(off))
    for kind in ("gyro", "filter"):
        pairs = [r["second"][kind] for r in rows if kind in r["second"] and r["second"][kind][1] is not None]
        worse = sum(after > 1.05 * before for before, after in pairs)
        if pairs:
            ratio = math.exp(float(np.mean([math.log(after / before) for before, after in pairs])))
            yield f"second drive by {kind}: worse by more than 5 % {wilson(worse, len(pairs))}; geometric mean after over before {ratio:.3f}"


def main() -> None:
    """Draw drives, diagnose them, print what was named and what it was worth."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", default="", help="Comma-separated, in turn; empty: nothing is hidden.")
    parser.add_argument("--d-primes", default="8,12,20,40")
    parser.add_argument("--filter", action="store_true", help="Judge the filter on the second drive too.")
    parser.add_argument("--out", type=Path, help="One JSON object a drive.")
    options = parser.parse_args()
    effects = options.effects.split(",")
    d_primes = [float(d) for d in options.d_primes.split(",")]
    rows = []
    for trial in range(options.trials):
        effect = effects[trial % len(effects)]
        d_prime = d_primes[trial // len(effects) % len(d_primes)] if effect else 0.0
        row = _trial(options.seed, trial, effect, d_prime, with_filter=options.filter)
        rows.append(row)
        click.echo(json.dumps(row))
        if options.out:
            with options.out.open("a") as lines:
                lines.write(json.dumps(row) + "\n")
    for line in _summary(rows):
        click.echo(line)


if __name__ == "__main__":
    main()
