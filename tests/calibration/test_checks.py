"""Data that cannot carry a fit are refused with what is missing and what to measure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrocal.calibration.calibrate import Calibration, FitConfig, calibrate
from gyrocal.errors import DataError, GyrocalError, InputError
from gyrocal.physics.surface import SHAPE
from tests.calibration.runs import Part, parts_of, write_run
from tests.calibration.simulation import SURFACE, Floats, simulate

RATES = np.linspace(-100.0, 100.0, 9)
TEMPS = np.array([0.0, 20.0, 40.0])


def table(path: Path, rate: Floats, temp: Floats, gyro: Floats | None = None, noise: float = 1e-3) -> Path:
    rng = np.random.default_rng(1)
    gyro = SURFACE.output_dps(rate, temp) + rng.normal(0, noise, rate.size) if gyro is None else gyro
    rows = [f"{r:.6f},{g:.8f},{t:.6f}" for r, g, t in zip(rate, gyro, temp, strict=True)]
    path.write_text("\n".join(["rate_dps,gyro_dps,temp_c", *rows]) + "\n")
    return path


def grid(rates: Floats = RATES, temps: Floats = TEMPS) -> tuple[Floats, Floats]:
    rate, temp = (a.ravel() for a in np.meshgrid(rates, temps))
    return rate, temp + 0.013 * np.arange(rate.size) % 0.4


def refusal(path: Path, config: FitConfig | None = None) -> GyrocalError:
    with pytest.raises(GyrocalError) as caught:
        calibrate(path, config or FitConfig())
    return caught.value


@pytest.mark.parametrize(
    ("rates", "temps", "what", "remedy"),
    [
        (np.array([0.0]), np.linspace(0, 40, 30), "one rate", "--bias-only"),
        (np.linspace(-100, 100, 15), np.array([20.0]), "one temperature", "at least 3 temperatures"),
        (np.linspace(0, 100, 9), TEMPS, "one sign only", "the other direction"),
        (np.linspace(-10, 100, 12), TEMPS, "one sign only", "the other direction"),
        (np.array([-50.0, 0.0, 50.0]), np.linspace(0, 40, 6), "3 distinct rates", "at least 4"),
        (np.array([-50.0, -20.0, 20.0, 50.0]), TEMPS, "12 data sets for 12 coefficients", "at each of 3"),
    ],
)
def test_missing_levels(tmp_path: Path, rates: Floats, temps: Floats, what: str, remedy: str) -> None:
    error = refusal(table(tmp_path / "t.csv", *grid(rates, temps)))
    assert isinstance(error, DataError)
    assert what in str(error)
    assert remedy in str(error)
    assert "t.csv" in str(error)


@pytest.mark.parametrize("scatter_c", [0.0, 0.03, 0.4])
def test_two_temperatures_carry_a_line_and_no_bend(tmp_path: Path, scatter_c: float) -> None:
    rate, temp = (a.ravel() for a in np.meshgrid(np.tile(RATES, 2), [5.2, 38.7]))
    rng = np.random.default_rng(3)
    path = table(tmp_path / "t.csv", rate, temp + scatter_c * rng.uniform(-1.0, 1.0, rate.size))
    fitted = calibrate(path, FitConfig())
    assert not fitted.fit.terms.reshape(SHAPE)[:, 2:].any()
    assert sum("two temperatures" in note for note in fitted.notes) == 1
    # The truth bends between them, and the band says that it may.
    middle = np.full(RATES.size, 22.0)
    off = fitted.coefficients.surface.error_dps(RATES, middle) - SURFACE.error_dps(RATES, middle)
    assert np.all(np.abs(off) < 3.0 * fitted.coefficients.sigma_dps(RATES, middle))
    at_soaks = fitted.coefficients.sigma_dps(np.zeros(2), np.array([5.2, 38.7]))
    assert np.all(at_soaks < 0.3 * fitted.coefficients.sigma_dps(np.zeros(1), middle[:1]))
    assert "two temperatures" in str(refusal(path, FitConfig(paper=True)))


def test_a_bias_at_two_temperatures_is_a_line(tmp_path: Path) -> None:
    temp = np.repeat([5.2, 38.7], 8)
    fitted = calibrate(table(tmp_path / "t.csv", np.zeros(16), temp), FitConfig(bias_only=True))
    assert int(fitted.fit.terms.sum()) == 2
    assert any("two temperatures" in note for note in fitted.notes)


def test_a_run_of_few_rates_is_sent_to_noise(tmp_path: Path) -> None:
    rates = np.array([-50.0, 0.0, 50.0])
    sets = simulate(np.random.default_rng(1), rates=rates, temps=np.linspace(0, 40, 6))
    run = write_run(tmp_path / "run", parts_of(sets, np.random.default_rng(2)))
    assert str(refusal(run)).endswith(
        f"what its rests say of noise, bias and drift is gyrocal noise {run.as_posix()}."
    )
    assert "gyrocal noise" not in str(refusal(table(tmp_path / "t.csv", *grid(rates, np.linspace(0, 40, 6)))))


def test_rates_and_temperatures_that_vary_together(tmp_path: Path) -> None:
    rate = np.repeat(np.linspace(-100, 100, 40), 2)
    error = refusal(table(tmp_path / "t.csv", rate, 20 + 0.2 * rate))
    assert "do not vary independently" in str(error)
    assert "every rate at 3 temperatures" in str(error)


def test_stuck_gyro(tmp_path: Path) -> None:
    rate, temp = grid()
    error = refusal(table(tmp_path / "t.csv", rate, temp, np.full(rate.size, 0.5)))
    assert "the gyro says 0.5 at every rate: it is stuck" in str(error)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (-1.0, "-1 times"),
        (np.pi / 180.0, "0.0175 times"),
        (3600.0, "3,600 times the rate (it is in deg/h, or in counts of another scale)"),
    ],
)
def test_another_unit_or_sign_is_refused_and_forced(tmp_path: Path, factor: float, said: str) -> None:
    rate, temp = grid()
    path = table(tmp_path / "t.csv", rate, temp, factor * rate)
    error = refusal(path)
    assert f"the output is {said}" in str(error)
    assert "--counts-per-dps" in str(error)
    assert any(
        "another unit or sign; used because" in n for n in calibrate(path, FitConfig(force=True)).notes
    )


def test_rate_and_output_both_in_radians_are_refused_and_forced(tmp_path: Path) -> None:
    rate, temp = grid()
    path = table(tmp_path / "t.csv", np.deg2rad(rate), temp, np.deg2rad(SURFACE.output_dps(rate, temp)))
    assert "seem to be in rad/s. Convert both" in str(refusal(path))
    assert any("rad/s; used because of --force" in n for n in calibrate(path, FitConfig(force=True)).notes)


def test_kelvin_copies_and_a_copy_of_the_rate_are_refused(tmp_path: Path) -> None:
    rate, temp = grid()
    assert "no gyro works so hot. Convert them if they are in kelvin" in str(
        refusal(table(tmp_path / "k.csv", rate, temp + 273.15))
    )
    twice = table(
        tmp_path / "t.csv", np.tile(rate, 2), np.tile(temp, 2), np.tile(SURFACE.output_dps(rate, temp), 2)
    )
    assert "27 of 54 data sets repeat an earlier one" in str(refusal(twice))
    assert any("used because of --force" in note for note in calibrate(twice, FitConfig(force=True)).notes)
    assert "exactly the rate in every row" in str(refusal(table(tmp_path / "c.csv", rate, temp, rate)))


def test_a_broken_thermometer_is_refused(tmp_path: Path) -> None:
    rate, temp = grid()
    temp[4] = -200.0
    assert "from -200 to" in str(refusal(table(tmp_path / "t.csv", rate, temp)))


def test_an_output_without_digits_is_refused_and_is_no_bug(tmp_path: Path) -> None:
    rate = np.tile(np.linspace(-100.0, 100.0, 11), 5)
    temp = np.repeat([-10.0, 5.0, 20.0, 35.0, 50.0], 11)
    gyro = rate + np.where((rate == 100.0) & (temp >= 35.0), 1.0, 0.0)
    assert "Write rates, outputs and temperatures with more digits" in str(
        refusal(table(tmp_path / "t.csv", rate, temp, gyro))
    )


def test_a_scatter_of_samples_that_the_means_contradict_is_said(tmp_path: Path) -> None:
    rate, temp = grid()
    gyro = SURFACE.output_dps(rate, temp) + np.random.default_rng(1).normal(0, 1e-3, rate.size)
    for std, said in ((0.02, False), (2.0, True)):
        rows = [f"{r:.6f},{g:.8f},{t:.6f},{std},400" for r, g, t in zip(rate, gyro, temp, strict=True)]
        path = tmp_path / "t.csv"
        path.write_text("\n".join(["rate_dps,gyro_dps,temp_c,gyro_std_dps,n", *rows]) + "\n")
        notes = calibrate(path, FitConfig()).notes
        assert any("check these columns" in note for note in notes) == said


def test_one_temperature_is_said_once(tmp_path: Path) -> None:
    rate = np.repeat(RATES, 3)
    gyro = rate + 0.1 + 1e-3 * np.arange(rate.size)
    assert "at one temperature (20.00 °C)" in str(
        refusal(table(tmp_path / "t.csv", rate, np.full(rate.size, 20.0), gyro))
    )


def run_parts(**conditions: Any) -> list[Part]:
    sets = simulate(
        np.random.default_rng(2), rates=RATES, temps=np.array([0.0, 20.0, 40.0, 10.0]), **conditions
    )
    return parts_of(sets, np.random.default_rng(3))


def rewrite(part: Part, column: int, value: str) -> Part:
    rows = []
    for row in part.rows:
        cells = row.split(",")
        cells[column] = value if cells[1] else cells[column]
        rows.append(",".join(cells))
    return replace(part, rows=rows)


def test_stuck_data_set_is_refused_and_forced(tmp_path: Path) -> None:
    parts = run_parts()
    middle = next(k for k, p in enumerate(parts) if p.rate_dps == 25.0)
    parts[middle] = rewrite(parts[middle], 1, "25.1")
    path = write_run(tmp_path / "run", parts)
    error = refusal(path)
    assert "every sample has the same value" in str(error)
    assert f"--exclude {middle + 1}" in str(error)
    forced = calibrate(path, FitConfig(force=True))
    assert any("used because of --force" in note for note in forced.notes)
    excluded = calibrate(path, FitConfig(exclude=(middle + 1,)))
    assert len(excluded.fit.sets) == len(parts) - 1
    assert excluded.coefficients.provenance["excluded_by_user"] == [middle + 1]


def test_saturated_data_sets_are_refused(tmp_path: Path) -> None:
    parts = run_parts()
    for k, part in enumerate(parts):
        if part.rate_dps == 100.0:
            parts[k] = rewrite(part, 1, "99.5")
    error = refusal(write_run(tmp_path / "run", parts))
    assert "4 data sets are saturated" in str(error)
    assert "+100 deg/s" in str(error)
    at_rail = [k + 1 for k, part in enumerate(parts) if part.rate_dps == 100.0]
    assert f"--exclude {','.join(map(str, at_rail))}," in str(error)


def test_stuck_temperature(tmp_path: Path) -> None:
    error = refusal(write_run(tmp_path / "run", [rewrite(p, 2, "21.5") for p in run_parts()]))
    assert "temperature is stuck at 21.50" in str(error)
    assert "Repair the sensor" in str(error)


def test_whole_degrees_are_weighed_by_their_consequence(tmp_path: Path) -> None:
    rate, temp = grid(np.linspace(-100, 100, 11), np.linspace(0, 40, 11))
    true = temp + np.random.default_rng(4).uniform(-0.5, 0.5, temp.size)
    gyro = SURFACE.output_dps(rate, true)
    rounded = table(tmp_path / "rounded.csv", rate, np.round(true), gyro)
    error = refusal(rounded)
    assert "whole degrees" in str(error)
    assert "0.1 °C or finer" in str(error)
    assert any("whole degrees" in n for n in calibrate(rounded, FitConfig(force=True)).notes)
    nominal = table(tmp_path / "nominal.csv", rate, np.round(true), SURFACE.output_dps(rate, np.round(true)))
    assert any("whole degrees" in n for n in calibrate(nominal, FitConfig()).notes)


def test_compensated_run_is_not_fitted_again(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", run_parts(), {"compensated": "fog.json"})
    error = refusal(path)
    assert isinstance(error, DataError)
    assert "compensated already" in str(error)


def test_excluding_what_is_not_there(tmp_path: Path) -> None:
    error = refusal(table(tmp_path / "t.csv", *grid()), FitConfig(exclude=(99,)))
    assert isinstance(error, InputError)
    assert "has no data set 99" in str(error)


def test_too_many_data_sets(tmp_path: Path) -> None:
    error = refusal(table(tmp_path / "t.csv", *grid(np.linspace(-100, 100, 64), np.linspace(0, 40, 60))))
    assert "more than the fit takes" in str(error)
    assert "Average" in str(error)


def bias(tmp_path: Path, rate: float, size: int = 40) -> Calibration:
    temp = np.linspace(-10, 50, size)
    return calibrate(table(tmp_path / "b.csv", np.full(size, rate), temp), FitConfig(bias_only=True))


def test_bias_only_is_zero_in_every_other_term_and_says_so(tmp_path: Path) -> None:
    found = bias(tmp_path, 0.0)
    c = found.coefficients
    assert np.all(c.surface.coefficients_dps[1:] == 0)
    assert c.valid.rate_dps[1] - c.valid.rate_dps[0] < 3
    assert any("every term in the rate is zero and unknown" in note for note in found.notes)
    numbers = {name for name, pair in c.figures["gyro"].items() if pair["before"]["value"] is not None}
    assert {"bias", "bias_over_temperature", "bias_temperature_sensitivity"} == numbers
    t = np.linspace(0, 40, 5)
    np.testing.assert_allclose(c.surface.error_dps(0.0, t), SURFACE.error_dps(0.0, t), atol=2e-3)


def test_bias_only_at_another_rate_says_what_is_in_it(tmp_path: Path) -> None:
    assert any("its scale factor error is within the bias" in note for note in bias(tmp_path, 10.0).notes)


def test_bias_only_takes_the_data_sets_at_rest(tmp_path: Path) -> None:
    rate, temp = grid(RATES, np.linspace(0, 40, 8))
    found = calibrate(table(tmp_path / "t.csv", rate, temp), FitConfig(bias_only=True))
    assert len(found.fit.sets) == 8
    moving = rate != 0
    error = refusal(table(tmp_path / "u.csv", rate[moving], temp[moving]), FitConfig(bias_only=True))
    assert "none is zero" in str(error)
    few = refusal(
        table(tmp_path / "v.csv", np.zeros(3), np.array([0.0, 20.0, 40.0])), FitConfig(bias_only=True)
    )
    assert "too few for a bias" in str(few)


def test_a_long_log_at_rest_is_averaged_to_workable_size(tmp_path: Path) -> None:
    found = bias(tmp_path, 0.0, 2500)
    assert len(found.fit.sets) <= 600
    assert any("2500 rows were averaged in blocks of 5" in note for note in found.notes)
    assert found.fit.sets.n.sum() == 2500
