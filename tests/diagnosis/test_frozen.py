"""Numbers of `diagnosis.json` and of the files written, as they were: a pure move of code leaves every one of them.

What is meant to change them says so in its message and freezes them anew, after blind trials have said that it may::

    python -m tests.diagnosis.test_frozen
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
import pytest

from gyrocal.diagnosis.drive.engine import diagnose_drive
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.surface import Surface
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.robot import format_robot
from gyrocal.trial.made_up import make_up
from tests.diagnosis.concealed_bench import make_recording, write_run
from tests.diagnosis.drive.fleet import Plan, drive
from tests.diagnosis.drive.score import robot_file

FROZEN = Path(__file__).parent / "frozen"
#: Another BLAS moves optima and grids' neighbours by less: levels are climbed until their slope is some thousandths of a nat.
_RELATIVE, _ABSOLUTE = 5e-3, 1e-12
#: Of what a drive's noise is made the log hardly tells: levels move until their slope is as small, and intervals with them.
_OF_DRIVES, _LEVELS_OF_DRIVES = 0.05, 0.3
#: Below a part of the sample noise a level is none, and where on its way to nothing the climb ends is anyone's guess.
_NO_LEVEL_DPS = 1e-4
#: Digits that are kept.
_DIGITS = 9
_SURFACE = Surface(
    np.array([[0.02, 0.1, 0.0], [0.3, 0.0, 0.0], [0.1, 0.0, 0.0], [-0.5, 0.0, 0.0]]), 0.0, 100.0, 20.0, 30.0
)


def _table(
    seed: int, *, asymmetry: float = 0.0, warm_up_dps: float = 0.0, step_dps: float = 0.0
) -> DataSetTable:
    """Sweeps at five temperatures with times and scatter, and what is hidden in them."""
    rng = np.random.default_rng(seed)
    rate, temp = np.tile(np.linspace(-100.0, 100.0, 11), 5), np.repeat(np.linspace(-10.0, 50.0, 5), 11)
    temp = temp + rng.normal(0.0, 0.3, rate.size)
    t_s = 40.0 * np.arange(float(rate.size))
    gyro = _SURFACE.output_dps(rate, temp) + asymmetry * np.maximum(rate, 0.0)
    gyro += warm_up_dps * np.exp(-t_s / 400.0) + step_dps * (t_s > 1500.0)
    gyro += 5e-4 * rng.standard_normal(rate.size)
    scatter = 5e-3 * np.sqrt(rng.chisquare(99.0, rate.size) / 99.0)
    return DataSetTable(
        Path("made.csv"), rate, gyro, temp, t_s=t_s, gyro_std_dps=scatter, n=np.full(rate.size, 100.0)
    )


def _diagnosed(found: Diagnosis) -> dict[str, Any]:
    file = found.improved or found.surface
    return found.to_json() | {"file": json.loads(file.to_text()) if file is not None else None}


def _asymmetry() -> dict[str, Any]:
    return _diagnosed(diagnose(_table(1, asymmetry=1.5e-4)))


def _warm_up() -> dict[str, Any]:
    return _diagnosed(diagnose(_table(2, warm_up_dps=0.02), options=Options(heldout=False)))


def _step() -> dict[str, Any]:
    return _diagnosed(diagnose(_table(3, step_dps=0.02), options=Options(heldout=False)))


def _resonance() -> dict[str, Any]:
    table = _table(6)
    shift_dps = 0.02 / (1.0 + ((np.abs(table.rate_dps) - 60.0) / 12.0) ** 2)
    resonant = replace(table, gyro_dps=table.gyro_dps + shift_dps)
    return _diagnosed(diagnose(resonant, options=Options(heldout=False)))


def _another_gyro() -> dict[str, Any]:
    given = Coefficients(
        {"model": "made up"}, _SURFACE, 1e-10 * np.eye(12), Valid((-100.0, 100.0), (-10.0, 50.0))
    )
    table = _table(5)
    moved = replace(table, gyro_dps=table.gyro_dps + 1e-4 * table.rate_dps)
    return _diagnosed(diagnose(moved, given, Options(heldout=False)))


def _driven(plan: Plan, seed: int) -> dict[str, Any]:
    found = diagnose_drive("drive.csv", drive(plan, seed), robot_file(plan))
    file = None if found.robot is None else tomllib.loads(format_robot(found.robot))
    return found.diagnosis.to_json() | {"file": file}


def _drive() -> dict[str, Any]:
    return _driven(Plan("eights", 2.0, 10.0, tick_m=4e-4, effects={"skid_slip": 6.0}), 11)


def _drive_with_truth() -> dict[str, Any]:
    effects = {"wheel_scale": 2.0, "gyro_scale": 0.5}
    return _driven(Plan("rests", 4.0, 10.0, truth_m=0.02, tick_m=4e-4, effects=effects), 12)


def _run() -> dict[str, Any]:
    with TemporaryDirectory() as place:
        write_run(
            make_recording([("step_response", 60.0), ("warm_up", 20.0)], 21, "even"), Path(place) / "run"
        )
        return _diagnosed(diagnose(Path(place) / "run", options=Options(heldout=False)))


def _trial(kind: str, seed: int, number: int) -> dict[str, Any]:
    with TemporaryDirectory() as place:
        return _diagnosed(
            diagnose(make_up(kind, seed, number).write(Path(place)), options=Options(heldout=False))
        )


QUICK: dict[str, Callable[[], dict[str, Any]]] = {
    "asymmetry": _asymmetry,
    "drive": _drive,
}
SLOW: dict[str, Callable[[], dict[str, Any]]] = {
    "step": _step,
    "another_gyro": _another_gyro,
    "warm_up": _warm_up,
    "resonance": _resonance,
    "drive_with_truth": _drive_with_truth,
    "run": _run,
    "trial_table": lambda: _trial("layers", 101, 0),
    "trial_run": lambda: _trial("layers", 102, 1),
    "trial_null": lambda: _trial("nulls", 101, 0),
}


def rounded(value: Any) -> Any:
    """With the digits that are kept; texts and hashes of a file are no numbers of its own."""
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items() if k not in ("sha256", "provenance", "sensor")}
    if isinstance(value, list | tuple):
        return [rounded(v) for v in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _relative(at: str) -> float:
    """How far a number may be off another machine's, by its place, which begins with the name of the recording."""
    if not at.startswith("drive"):
        return _RELATIVE
    return _LEVELS_OF_DRIVES if "/file/noise/" in at else _OF_DRIVES


def differences(frozen: Any, now: Any, at: str = "") -> list[str]:
    """Places where two documents differ by more than another machine makes them."""
    if isinstance(frozen, dict) and isinstance(now, dict) and frozen.keys() == now.keys():
        return [d for k in frozen for d in differences(frozen[k], now[k], f"{at}/{k}")]
    if isinstance(frozen, list) and isinstance(now, list) and len(frozen) == len(now):
        return [
            d for k, pair in enumerate(zip(frozen, now, strict=True)) for d in differences(*pair, f"{at}/{k}")
        ]
    if isinstance(frozen, float) and isinstance(now, int | float):
        least = _NO_LEVEL_DPS if at.endswith("/white_std_dps") else _ABSOLUTE
        same = now == pytest.approx(frozen, rel=_relative(at), abs=least)
        return [] if same else [f"{at}: {frozen} is now {now}"]
    return [] if frozen == now else [f"{at}: {frozen!r} is now {now!r}"]


def _compare(name: str, made: dict[str, Any]) -> None:
    frozen = json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))
    changed = differences(frozen, json.loads(json.dumps(rounded(made))), name)
    assert not changed, "\n".join(changed[:12])


@pytest.mark.parametrize("name", QUICK)
def test_numbers_are_what_they_were(name: str) -> None:
    _compare(name, QUICK[name]())


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_numbers_of_longer_recordings_are_what_they_were(name: str) -> None:
    _compare(name, SLOW[name]())


def test_what_differs_is_told() -> None:
    assert differences({"a": [1.0, None]}, {"a": [1.0 + 1e-6, None]}) == []
    assert differences({"a": [1.0, "x"]}, {"a": [1.1, "y"]}) == [
        "/a/0: 1.0 is now 1.1",
        "/a/1: 'x' is now 'y'",
    ]
    assert differences({"a": 1}, {"b": 1}) == [": {'a': 1} is now {'b': 1}"]


def main() -> None:
    """Freeze the numbers of today."""
    FROZEN.mkdir(exist_ok=True)
    for name, made in (QUICK | SLOW).items():
        text = json.dumps(rounded(made()), indent=1)
        (FROZEN / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        click.echo(name)


if __name__ == "__main__":
    main()
