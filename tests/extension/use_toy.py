"""Run where `gyrocal_toy` is installed: each use of what it adds, and what came of it as JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal.bench.profile import load_profile
from gyrocal.calibration.export import export_c_header
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.fusion.compensation import Compensator
from gyrocal.physics.catalogue import find_effect
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.surface import Surface
from gyrocal.physics.terms import Term
from gyrocal.records.datasets import DataSetTable
from gyrocal.records.run import read_run
from gyrocal.report.diagnosis import diagnosis_page
from gyrocal.report.folds import coordinate_of, fold_of
from gyrocal.report.sentences import document
from gyrocal.trial.blind import draw_secret, rehearse
from tests.bench.onwire.stand import WireStand

#: The period lies in the middle between two points of the grid, 2.5 % from either.
SIZE_MDPS, PERIOD_DPS = 20.0, 47.8


def table() -> DataSetTable:
    """Data sets at 25 rates and three temperatures, with a ripple under white noise of half a mdeg/s."""
    rng = np.random.default_rng(7)
    rate = np.concatenate([rng.permutation(np.linspace(-100.0, 100.0, 25)) for _ in range(3)])
    temp = np.repeat([-10.0, 20.0, 50.0], 25) + rng.normal(0.0, 0.2, rate.size)
    c = np.zeros((4, 3))
    c[0, :2], c[1, 0], c[2, 0], c[3, 0] = (0.02, 0.1), 0.3, 0.1, -0.5
    t_s = 30.0 * np.arange(rate.size, dtype=np.float64)
    p = {"amplitude": SIZE_MDPS, "period_dps": PERIOD_DPS}
    ripple = find_effect("toy_ripple").error_dps(Conditions(t_s, rate, temp), p, None, None)[0]
    gyro = Surface(c, 0.0, 100.0, 20.0, 30.0).output_dps(rate, temp) + ripple
    return DataSetTable(Path("toy.csv"), rate, gyro + 5e-4 * rng.standard_normal(rate.size), temp, t_s=t_s)


def found_in_a_table() -> dict[str, Any]:
    """`diagnose` on it, its page, its coefficient file as C and on a robot."""
    recording = table()
    found = diagnose(recording, options=Options(heldout=False))
    body: dict[str, Any] = {"document": document(found), "page": diagnosis_page(found, [], {})}
    effect = next((e for e in found.effects if e.effect == "toy_ripple"), None)
    if effect is None or found.rows is None or found.improved is None:
        return body
    folded, axis = fold_of(found, effect), coordinate_of(found.rows, effect)
    t_s = 30.0 * np.arange(recording.rate_dps.size, dtype=np.float64)
    right = Compensator(found.improved).correct(t_s, recording.gyro_dps, recording.temp_c)
    return body | {
        "axis": axis.label,
        "furthest_on_axis": float(np.nanmax(axis.x)),
        "folded": None if folded is None else folded.rms()[:2],
        "c": export_c_header(replace(found.improved, terms=(term(),))).text,
        "error_left_dps": float(np.std(right - recording.rate_dps)),
    }


def term() -> Term:
    """The ripple as a term of a coefficient file: `diagnose` may leave what it names to a smooth part."""
    effect = find_effect("toy_ripple")
    sizes = {"amplitude": SIZE_MDPS, "period_dps": PERIOD_DPS}
    entries = {
        name: {"value": value, "std": 0.0, "unit": effect.parameter(name).unit}
        for name, value in sizes.items()
    }
    return Term("toy_ripple", entries, True)


def drawn(run: Path) -> list[dict[str, float]]:
    """What blind trials hide of it."""
    stage = rehearse(run, load_profile("quick").virtual.table.max_acceleration_dps2)
    secrets = [draw_secret(stage, np.random.default_rng([5, k])) for k in range(60)]
    return [dict(s.effects["toy_ripple"]) for s in secrets if "toy_ripple" in s.effects]


def acquired(out: Path) -> dict[str, Any]:
    """A run with the toy devices on the wire."""
    stand = WireStand(out, gyro="toy-gyro", table="toy-table", chamber="toy-chamber")
    summary = stand.run()
    run = read_run(out)
    return {
        "failed": len(summary.failed),
        "segments": len(run.segments),
        "rates": sorted({s.rate_dps for s in run.segments if s.kind == "rate"}),
    }


def main(out: Path) -> None:
    """All of it."""
    found = {
        "table": found_in_a_table(),
        "run": acquired(out / "run"),
        "drawn": drawn(Path("sample_data/run")),
    }
    (out / "found.json").write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
