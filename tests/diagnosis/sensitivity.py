"""What each numeric constant of `gyrocal.diagnosis` is worth: every one halved and doubled on made-up recordings.

A command line; a row a constant goes to JSON lines as it comes, and a repeated call goes on where the last one stopped::

    nice -n 10 python -m tests.diagnosis.sensitivity --out sensitivity.jsonl [--only names.py] [--small]
    python -m tests.diagnosis.sensitivity --out sensitivity.jsonl --table

With `--small` on the recordings of `test_frozen`, a few seconds a constant: which of them changes its answer at all. The tables of
what has been measured so far are in `sensitivity.md` beside this file. An error is that of a second run without noise (or a
second drive) by the improved file; names and verdict are told where they become others.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.rows.series import Series, series_of_run
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import versus
from gyrocal.diagnosis.versus.between import between
from gyrocal.records.datasets import read_data_sets
from gyrocal.records.drive import DriveBlock
from gyrocal.records.run import read_run
from gyrocal.trial.made_up import MadeUp, make_up
from gyrocal.trial.second import corrected_rms_dps
from tests.diagnosis.drive.fleet import Plan, again, drive
from tests.diagnosis.drive.score import diagnosed, metres, plans, robot_file
from tests.diagnosis.test_frozen import QUICK, SLOW, differences, rounded
from tests.diagnosis.versus.tables import SURFACE, plan, table

PACKAGE = Path(__file__).parents[2] / "gyrocal"
#: What recordings of either kind do not read, by folder or file of `gyrocal/diagnosis`.
ONLY_TABLES = (
    "sweeps/candidates.py",
    "sweeps/changes.py",
    "sweeps/coil.py",
    "sweeps/finer.py",
    "answer/fresh_run.py",
    "sweeps/lag_posterior.py",
    "rows/table_series.py",
    "answer/untimed.py",
)
ONLY_DRIVES, ONLY_VERSUS = "drive/", "versus/"
#: Share of the data sets that a simulation has, of those that are compared with one.
_SIMULATED = 0.9
#: Kind, seed and number of made-up recordings, and effect, d' and trial of made-up drives.
RECORDINGS = (("layers", 102, 1), ("layers", 101, 0), ("nulls", 101, 0))
TABLES = (("layers", 101, 0), ("layers", 103, 0))
DRIVES = (("gyro_delay", 12.0, 0), ("gyro_scale", 12.0, 1), ("", 0.0, 2))
#: Of the frozen recordings; the first that changes ends the search.
SMALL, SMALL_DRIVES = ("warm_up", "resonance", "asymmetry"), ("drive", "drive_with_truth")
#: Errors that differ by less are the same.
_SAME_ERROR = 0.01


@dataclass(frozen=True)
class Constant:
    """A number that stands by its name at the top of a module."""

    module: str
    name: str
    value: float

    @property
    def key(self) -> str:
        """File and name."""
        return f"{self.file}:{self.name}"

    @property
    def file(self) -> str:
        """File below ``gyrocal/diagnosis``."""
        return self.module.removeprefix("gyrocal.diagnosis.").replace(".", "/") + ".py"

    def times(self, factor: float) -> float:
        """A multiple of it; of a whole number a whole one, and another one."""
        scaled = self.value * factor
        if isinstance(self.value, int):
            rounded = int(np.floor(scaled)) if factor < 1.0 else int(np.ceil(scaled))
            return max(rounded, 1)
        return scaled

    @contextlib.contextmanager
    def set_to(self, value: float) -> Iterator[None]:
        """With another value, here and wherever it was imported."""
        own = [importlib.import_module(self.module)]
        if not self.name.startswith("_"):
            own += [
                m
                for n, m in sys.modules.items()
                if n.startswith("gyrocal.") and getattr(m, self.name, None) is getattr(own[0], self.name)
            ]
        try:
            for module in own:
                setattr(module, self.name, value)
            yield
        finally:
            for module in own:
                setattr(module, self.name, self.value)


def constants() -> Iterator[Constant]:
    """Every number of `gyrocal.diagnosis` that is a name at the top of its module."""
    for path in sorted((PACKAGE / "diagnosis").rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.Assign):
                continue
            targets = node.targets[0]
            for name in targets.elts if isinstance(targets, ast.Tuple) else [targets]:
                if isinstance(name, ast.Name) and name.id == name.id.upper():
                    value = getattr(importlib.import_module(module), name.id)
                    if isinstance(value, int | float) and not isinstance(value, bool):
                        yield Constant(module, name.id, value)


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis says, and the error that its file leaves another time."""

    verdict: str
    names: list[str]
    error: float

    def against(self, usual: Outcome) -> str:
        """How it differs from the usual one."""
        changes = [f"+{n}" for n in self.names if n not in usual.names]
        changes += [f"-{n}" for n in usual.names if n not in self.names]
        if abs(self.error - usual.error) > _SAME_ERROR * usual.error:
            changes.append(f"error {self.error / usual.error - 1.0:+.0%}")
        return " ".join(changes) or (self.verdict if self.verdict != usual.verdict else "")


def _small(constant: Constant) -> Iterator[dict[str, Any]]:
    """Documents of the frozen recordings that may depend on a constant, one by one."""
    if constant.file.startswith(ONLY_VERSUS):
        # Sets are left out, which costs most, by the constants of one file alone.
        yield rounded(_units_against_a_simulation(heldout=constant.file == "versus/answer.py"))
        return
    names = SMALL_DRIVES if constant.file.startswith(ONLY_DRIVES) else SMALL
    for name in names:
        yield rounded((QUICK | SLOW)[name]())


def _units_against_a_simulation(*, heldout: bool) -> dict[str, Any]:
    """Two units, one with a warm-up, against a simulation on another clock that lacks their asymmetry and some sets."""
    t, rate, temp = plan(8)
    rng = np.random.default_rng(0)
    there, kept = 200.0 + t * (1 + 1e-4) + rng.normal(0, 0.3, t.size), rng.random(t.size) < _SIMULATED
    output = SURFACE.output_dps(rate, temp + 0.3)
    sim = series_of_table(table("sim.csv", *(x[kept] for x in (there, rate, output, temp + 0.3))))
    answers = []
    for warm_dps in (0.0, 0.02):
        gyro = SURFACE.output_dps(rate, temp) + 5e-4 * np.maximum(rate, 0.0) + warm_dps * np.exp(-t / 900.0)
        gyro += rng.normal(0, 3e-4, t.size)
        answers.append(
            versus(series_of_table(table("real.csv", t, rate, gyro, temp)), sim, Options(heldout=heldout))
        )
    documents = [a.to_json() for a in answers]
    names = [{"effect": e.effect} for a in answers for e in a.diagnosis.effects]
    return {"effects": names, "laws": documents, "between": [b.to_json() for b in between(answers)]}


def _changes(usual: dict[str, Any], now: dict[str, Any]) -> str:
    """Names that come and go; else whether a number is another."""
    before, after = ([e["effect"] for e in d["effects"]] for d in (usual, now))
    names = [f"+{n}" for n in after if n not in before] + [f"-{n}" for n in before if n not in after]
    return " ".join(names) or ("numbers" if differences(usual, now) else "")


@cache
def _recording(kind: str, seed: int, number: int) -> tuple[MadeUp, Path, Path]:
    place = Path(tempfile.mkdtemp(prefix="gyrocal-sensitivity-"))
    made = make_up(kind, seed, number)
    return made, made.write(place), made.write_second(place)


def _of_bench(kind: str, seed: int, number: int) -> Outcome:
    made, first, second = _recording(kind, seed, number)
    series: Series = (
        series_of_run(read_run(first)) if first.is_dir() else series_of_table(read_data_sets(first))
    )
    found = diagnose(series, None, Options(heldout=False))
    error = corrected_rms_dps(second, made.second, found.improved or found.surface)
    return Outcome(found.verdict, [e.effect for e in found.effects], 3600.0 * (error or 0.0))


@cache
def _drives(effect: str, d_prime: float, trial: int) -> tuple[Plan, DriveBlock, DriveBlock]:
    plan, own, _ = next(plans(101, trial, effect, d_prime))
    rng = np.random.default_rng([101, trial, 99])
    return plan, drive(plan, own), drive(again(plan, rng), int(rng.integers(2**31)))


def _of_drive(effect: str, d_prime: float, trial: int) -> Outcome:
    plan, first, second = _drives(effect, d_prime, trial)
    robot = robot_file(plan)
    found = diagnosed(first, robot)
    return Outcome(
        found.verdict,
        [e.effect for e in found.effects],
        metres(second, found.better or robot, filtering=False),
    )


def outcomes(constant: Constant) -> list[Outcome]:
    """Of the recordings that may depend on a constant."""
    if constant.file.startswith(ONLY_DRIVES):
        return [_of_drive(*d) for d in DRIVES]
    return [_of_bench(*r) for r in (TABLES if constant.file in ONLY_TABLES else RECORDINGS)]


def _told(constant: Constant, usual: list[Any], *, small: bool) -> list[str]:
    if small:
        told = []
        for before, now in zip(usual, _small(constant), strict=True):
            told.append(_changes(before, now))
            if told[-1]:
                break
        return told
    return [o.against(u) for o, u in zip(outcomes(constant), usual, strict=True)]


def _measured(constant: Constant, usual: list[Any], *, small: bool) -> dict[str, Any]:
    row: dict[str, Any] = {"constant": constant.key, "value": constant.value}
    for word, factor in (("half", 0.5), ("twice", 2.0)):
        value = constant.times(factor)
        with constant.set_to(value):
            try:
                told = _told(constant, usual, small=small)
            except Exception as error:  # noqa: BLE001 (any failure is the answer)
                told = [f"fails: {type(error).__name__}"]
        row[word] = [value, told]
    return row


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield "| constant | value | half | twice |"
    yield "|---|---|---|---|"
    for row in sorted(rows, key=lambda r: str(r["constant"])):
        cells = []
        for word in ("half", "twice"):
            value, told = row[word]
            cells.append(f"{value:g}: " + (" / ".join(t or "=" for t in told) if any(told) else "the same"))
        yield f"| `{row['constant']}` | {row['value']:g} | {cells[0]} | {cells[1]} |"


def main() -> None:
    """Measure what has not been measured yet, or print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True, help="One JSON object a constant.")
    parser.add_argument(
        "--only", default="", help="Constants whose file and name hold one of these, comma-separated."
    )
    parser.add_argument("--small", action="store_true", help="On the frozen recordings.")
    parser.add_argument("--table", action="store_true", help="Print the table of what was measured.")
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.open()] if options.out.exists() else []
    if options.table:
        for line in _table(rows):
            click.echo(line)
        return
    known = {row["constant"] for row in rows}
    usual: dict[tuple[bool | str, ...], list[Any]] = {}
    for constant in constants():
        wanted = any(word in constant.key for word in options.only.split(","))
        compared = constant.file.startswith(ONLY_VERSUS)
        if constant.key in known or not wanted or (compared and not options.small):
            continue
        kind = (
            constant.file.startswith(ONLY_DRIVES),
            constant.file in ONLY_TABLES,
            compared and constant.file,
        )
        if kind not in usual:
            usual[kind] = list(_small(constant)) if options.small else outcomes(constant)
        row = _measured(constant, usual[kind], small=options.small)
        click.echo(json.dumps(row))
        with options.out.open("a") as lines:
            lines.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
