"""Warm-up time: covered where a record shows it, and refused with the reason where it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from gyrocal.calibration.course import Course
from gyrocal.calibration.static import StaticConfig, examine_static
from gyrocal.calibration.warm_up import WARM_UP, warm_up
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.simulation import flicker

#: deg/h to deg/s
DPH = 1.0 / 3600.0
#: Chance that a figure that is as stated fails its test.
FALSE_ALARM = 1e-3


def course(rng: np.random.Generator, amplitude_dph: float, tau_s: float) -> Course:
    """Two hours in means over 10 s: angle random walk of 0.08 deg/√h, 1/f, and a warm-up."""
    t_s = np.linspace(5.0, 7195.0, 720)
    noise = rng.normal(0.0, 0.08 / 60.0 / np.sqrt(10.0), t_s.size) + flicker(rng, t_s.size, 0.7 * DPH, 10.0)
    gyro_dps = noise + amplitude_dph * DPH * np.exp(-t_s / tau_s)
    return Course(t_s, gyro_dps, np.full(t_s.size, np.nan), np.full(t_s.size, 100.0))


@pytest.mark.parametrize("runs", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_its_interval_holds_the_truth(runs: int) -> None:
    rng = np.random.default_rng(31)
    found = [warm_up(course(rng, 40.0, 600.0), 0.0, "") for _ in range(runs)]
    held = sum((f.low or 0.0) <= 30.0 <= (f.high or 0.0) for f in found)
    assert held >= stats.binom.ppf(FALSE_ALARM, runs, 0.95)


@pytest.mark.slow
def test_noise_is_no_warm_up() -> None:
    rng, runs = np.random.default_rng(32), 300
    found = [warm_up(course(rng, 0.0, 600.0), 0.0, "") for _ in range(runs)]
    told = sum(f.reason != "no change since power-on stands out of the noise" for f in found)
    assert told <= stats.binom.isf(FALSE_ALARM, runs, 0.01)


def test_a_record_that_ends_before_it_is_over_bounds_nothing() -> None:
    found = warm_up(course(np.random.default_rng(33), 200.0, 7000.0), 0.0, "")
    assert found.value is None
    assert found.reason.startswith("the record is too short for it: longer than ")


@pytest.mark.parametrize(
    ("on_s", "reason"),
    [
        (None, "the record does not say when the power came on"),
        (
            -3600.0,
            "the record begins 60 min after power-on; record at rest from power-on (sensor.on_before_s)",
        ),
    ],
)
def test_what_a_record_does_not_show(on_s: float | None, reason: str) -> None:
    found = warm_up(course(np.random.default_rng(34), 40.0, 600.0), on_s, "")
    assert (found.value, found.reason) == (None, reason)


@pytest.mark.slow
def test_a_run_from_power_on_tells_it(tmp_path: Path) -> None:
    t_s = np.arange(7200) + 0.5
    gyro = np.random.default_rng(35).normal(0.0, 0.08 / 60.0, t_s.size) + 40.0 * DPH * np.exp(-t_s / 600.0)
    rows = [gyro_row(t, f"{x:.7f}") for t, x in zip(t_s, gyro, strict=True)]
    run = write_run(tmp_path / "run", [Part(rows, kind="static", averaging_s=1.0)])
    figure = examine_static(StaticConfig(run)).figures[WARM_UP]
    assert figure.interval is not None
    assert figure.interval[1] < 30.0 < figure.interval[2]
