"""Units beside each other: who is out of line, what drifts, and a unit that cannot be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.calibrate import FitConfig
from gyrocal.calibration.fleet import (
    FleetConfig,
    Unit,
    compare_units,
    measure,
    measure_all,
    measure_fleet,
    refuse_models,
    rosner,
)
from gyrocal.errors import DataError
from gyrocal.physics.surface import Surface
from tests.calibration.runs import Part, gyro_row, write_run
from tests.report.examples import SURFACE


def units(columns: dict[str, Sequence[float] | NDArray[np.float64]]) -> list[Unit]:
    """Units with serials A1, A2, ... and the given figures."""
    n = len(next(iter(columns.values())))
    return [
        Unit(f"run{k}", f"A{k + 1}", "RD2100", "", {name: (float(x[k]), 0.1) for name, x in columns.items()})
        for k in range(n)
    ]


@pytest.mark.parametrize("n", [6, 12, pytest.param(40, marks=pytest.mark.slow)])
def test_rosner_calls_normal_samples_normal(n: int) -> None:
    trials = 2000
    alarms = sum(bool(rosner(np.random.default_rng([n, k]).normal(size=n), 0.05)) for k in range(trials))
    low, high = stats.binom.interval(0.9999, trials, 0.055)
    assert 0.6 * low <= alarms <= high, alarms / trials


def test_rosner_agrees_with_the_published_example() -> None:
    """Rosner's 54 values (NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.5.17.3): three outliers at 5 %."""
    text = """-0.25 0.68 0.94 1.15 1.20 1.26 1.26 1.34 1.38 1.43 1.49 1.49 1.55 1.56 1.58 1.65 1.69 1.70 1.76 1.77 1.81
    1.91 1.94 1.96 1.99 2.06 2.09 2.10 2.14 2.15 2.23 2.24 2.26 2.35 2.37 2.40 2.47 2.54 2.62 2.64 2.90 2.92 2.92
    2.93 3.21 3.26 3.30 3.59 3.68 4.30 4.64 5.34 5.42 6.01"""
    x = np.array(text.split(), dtype=float)
    assert [x[i] for i, _, _ in rosner(x, 0.05)] == [6.01, 5.42, 5.34]


def test_a_unit_out_of_line_is_named_with_the_figure() -> None:
    rng = np.random.default_rng(1)
    bias = rng.normal(size=20)
    bias[7] += 9.0
    fleet = compare_units(units({"bias [deg/h]": bias, "scale [ppm]": rng.normal(size=20)}))
    assert [(o.serial, o.figure) for o in fleet.outlying] == [("A8", "bias [deg/h]")]
    assert fleet.outlying[0].deviations > 5
    assert fleet.drifts == ()


def test_a_drift_along_the_serials_is_seen_in_counting_order() -> None:
    scale = 0.5 * np.arange(25) + np.random.default_rng(2).normal(size=25)
    fleet = compare_units(list(reversed(units({"scale [ppm]": scale}))))
    assert [u.serial for u in fleet.units][8:11] == ["A9", "A10", "A11"]
    assert fleet.drifts[0].low < 0.5 < fleet.drifts[0].high


def test_units_of_two_models_are_refused_before_any_is_fitted(tmp_path: Path) -> None:
    """With three rows each, of which no figure can be made; a table names no sensor and goes with all."""
    models = {"a": "RD2100", "b": "RD2100", "c": "DSP-3000"}
    runs = [
        write_run(
            tmp_path / name,
            [Part([gyro_row(0.1 * k, f"1.{n}") for k in range(3)], kind="static")],
            {"sensor": {"model": model}},
        )
        for n, (name, model) in enumerate(models.items())
    ]
    table = write_table(tmp_path / "table.csv", 1)
    with pytest.raises(DataError, match=r"are of DSP-3000 \(.*\), RD2100 \(.*\): compare units of one model"):
        measure_fleet(FleetConfig((*runs, table)), lambda share, what: None)
    refuse_models([*runs[:2], table])


def test_a_recording_that_cannot_be_fitted_does_not_stop_the_others(tmp_path: Path) -> None:
    good = write_table(tmp_path / "good.csv", 1)
    bad = tmp_path / "bad.csv"
    bad.write_text("rate_dps,gyro_dps,temp_c\n1,1,20\n")
    with ThreadPoolExecutor(2) as pool:
        done = list(measure_all([good, bad], [FitConfig()] * 2, pool, lambda share, what: None))
    fleet = compare_units(done)
    assert [Path(u.source).name for u in fleet.failed] == ["bad.csv"]
    # Its name stands before it wherever it is shown.
    assert fleet.failed[0].error.startswith("a recording at one rate")
    assert {s.figure for s in fleet.spreads} >= {"c00 [deg/s]", "residual_rms [deg/h]"}


def test_units_are_compared_in_the_same_terms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: each in those that predict it best, so that 310 of 400 fleets of ten equal units had one out of line."""
    few = Surface(
        np.array([[0.02, 0.01, 0.0], [-1.0, 0.3, 0.0], [0.0] * 3, [0.0] * 3]), 0.0, 100.0, 20.0, 30.0
    )
    paths = [write_table(tmp_path / f"unit{seed}.csv", seed, few) for seed in (1, 2)]
    assert any(0.0 in [x for x, _ in measure(path, FitConfig()).figures.values()] for path in paths)
    monkeypatch.setattr("gyrocal.calibration.fleet._workers", lambda config: ThreadPoolExecutor(1))
    for unit in measure_fleet(FleetConfig(tuple(paths)), lambda share, what: None).units:
        assert 0.0 not in [x for x, _ in unit.figures.values()]


def test_no_recording_that_can_be_fitted_is_an_error() -> None:
    with pytest.raises(DataError, match="None of the 1 recordings can be fitted; the first says: broken"):
        compare_units([Unit("a", "", "", "", {}, "broken")])


def write_table(path: Path, seed: int, surface: Surface = SURFACE) -> Path:
    """A table of data sets of a gyro near `SURFACE`."""
    rng = np.random.default_rng(seed)
    temps = np.repeat([-10.0, 10, 30, 50, 40, 20, 0], 11)
    rates = np.concatenate([rng.permutation(np.linspace(-100, 100, 11)) for _ in range(7)])
    temps = temps + rng.normal(0, 0.1, temps.size)
    gyro = surface.output_dps(rates, temps) + rng.normal(0, 1e-3, rates.size)
    rows = [
        f"{w:.4f},{g:.6f},{t:.3f},{30 * k}"
        for k, (w, g, t) in enumerate(zip(rates, gyro, temps, strict=True))
    ]
    path.write_text("\n".join(["rate_dps,gyro_dps,temp_c,t_s", *rows]) + "\n")
    return path
