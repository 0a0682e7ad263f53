"""Runs of a unit beside each other: what did not change is not said to have, and what did is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.calibrate import Calibration, FitConfig, calibrate
from gyrocal.calibration.compare import Change, compare_runs
from tests.calibration.simulation import SURFACE, Floats


def run(
    folder: Path, name: str, temps_c: Floats, added: float = 0.0, rates_dps: float = 100.0
) -> Calibration:
    """A run at these temperatures of a gyro whose scale factor has a slope; `added` is a scale factor error more."""
    rng = np.random.default_rng([7, sum(name.encode())])
    steps = np.linspace(-rates_dps, rates_dps, 11)
    rate = np.concatenate([rng.permutation(steps) for _ in temps_c])
    temp = np.repeat(temps_c, steps.size) + rng.normal(0, 0.05, rate.size)
    gyro = SURFACE.output_dps(rate, temp) + added * rate + rng.normal(0, 5e-4, rate.size)
    rows = zip(rate, gyro, temp, 60.0 * np.arange(rate.size), strict=True)
    path = folder / f"{name}.csv"
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    path.write_text("\n".join(["rate_dps,gyro_dps,temp_c,t_s", *lines]), encoding="utf-8")
    return calibrate(path, FitConfig())


def changes(runs: list[Calibration]) -> dict[str, Change]:
    return {c.figures[0].name: c for c in compare_runs(runs)}


def test_a_run_over_other_temperatures_and_rates_is_no_change(tmp_path: Path) -> None:
    """Each at its own middle, the scale factor of this gyro differs by 300 ppm for a degree, and its error by a hundredth."""
    first = run(tmp_path, "a", np.linspace(-10, 50, 6))
    last = run(tmp_path, "b", np.linspace(-4, 50, 6), rates_dps=80.0)
    found = changes([first, last])
    assert [name for name, c in found.items() if c.changed] == []
    # Each over its own range they do differ.
    own = [r.merit["scale_factor_error"].before.interval for r in (first, last)]
    assert own[0] is not None
    assert own[1] is not None
    assert own[1][1] > own[0][2] or own[1][2] < own[0][1]
    change = found["scale_factor_error"]
    assert change.low is not None
    assert change.high is not None
    assert change.low < 0 < change.high


def test_a_change_is_found_with_its_size(tmp_path: Path) -> None:
    temps = np.linspace(-10, 50, 6)
    found = changes([run(tmp_path, "a", temps), run(tmp_path, "b", temps, added=1e-4)])
    change = found["scale_factor_error"]
    assert change.changed
    assert change.change == pytest.approx(100.0, abs=15.0)
    assert not found["bias"].changed


def test_runs_with_nothing_in_common_say_so(tmp_path: Path) -> None:
    runs = [run(tmp_path, "a", np.linspace(-30, 0, 5)), run(tmp_path, "b", np.linspace(10, 50, 5))]
    change = changes(runs)["scale_factor_error"]
    assert change.change is None
    assert not change.changed
    assert "in common" in change.figures[0].reason
