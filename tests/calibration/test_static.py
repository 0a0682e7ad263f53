"""Records of a gyro that stands: figures with intervals, gaps that are gaps, earth rate and clock."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy import stats

from gyrocal.calibration.course import Course, CourseSums
from gyrocal.calibration.jumps import jumps_of
from gyrocal.calibration.noise import gaps
from gyrocal.calibration.static import StaticConfig, StaticFigures, earth_rate_dph, examine_static
from gyrocal.calibration.trend import Trend, trend_of
from gyrocal.cli import gyrocal_command
from gyrocal.errors import DataError, GyrocalError
from tests.calibration.runs import Part, gyro_row, write_run
from tests.calibration.simulation import flicker

Floats = NDArray[np.float64]

ARW_DPS_RT_S = 1.389e-3
#: Chance that a correct test of coverage fails.
FALSE_ALARM = 1e-3


def write_log(
    path: Path, t_s: NDArray[np.floating[Any]], gyro_dps: Floats, temp_c: Floats | None = None
) -> Path:
    columns = [t_s, gyro_dps] + ([] if temp_c is None else [temp_c])
    header = "t_s,gyro_dps" + ("" if temp_c is None else ",temp_c")
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.7f")
    return path


def white(rng: np.random.Generator, samples: int, dt_s: float = 0.1) -> Floats:
    return np.asarray(rng.normal(0.0, ARW_DPS_RT_S / np.sqrt(dt_s), samples))


def interval(found: StaticFigures, name: str) -> tuple[float, float, float]:
    figure = found.figures[name].interval or found.noise.figures[name].interval
    if figure is None:
        raise AssertionError(found.figures[name].reason)
    return figure


@pytest.mark.parametrize("stuck_dps", [0.0, 0.01])
def test_an_output_that_never_changes_tells_of_no_noise(tmp_path: Path, stuck_dps: float) -> None:
    path = write_log(tmp_path / "stuck.csv", np.arange(400.0), np.full(400, stuck_dps))
    with pytest.raises(DataError, match=rf"stuck.csv: the output is {stuck_dps:g} deg/s in all 400 samples"):
        examine_static(StaticConfig(path))


def test_a_log_without_temperature(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t_s = 0.1 * (1.0 + 2e-4) * np.arange(60_000)
    log = write_log(tmp_path / "still.csv", t_s, 0.005 + white(rng, t_s.size))
    found = examine_static(StaticConfig(log, latitude_deg=30.0, rate_hz=10.0))
    walk = found.noise.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert walk[0] == pytest.approx(60.0 * ARW_DPS_RT_S, rel=0.03)
    assert walk[2] / walk[1] < 1.05
    mean, without, clock = (
        interval(found, n) for n in ("mean_bias", "bias_without_earth_rate", "clock_error")
    )
    assert mean[1] < 18.0 < mean[2]
    assert mean[0] - without[0] == pytest.approx(15.04106864 * 0.5)
    assert clock[0] == pytest.approx(-200.0, abs=1.0)
    assert found.figures["bias_temperature_sensitivity"].reason == "the temperature is not known"
    assert "not told from noise" in found.figures["rate_ramp"].reason
    assert found.samples == 60_000
    json.dumps(found.to_json(), allow_nan=False)


@pytest.mark.parametrize("size_dps", [2.0, pytest.param(90.0, marks=pytest.mark.slow)])
def test_a_turn_in_a_log_is_left_out_of_its_noise(tmp_path: Path, size_dps: float) -> None:
    """Ten seconds in half an hour: taken for noise they are a random walk of the rate, and its interval is short."""
    rng = np.random.default_rng(5)
    t_s = 0.02 * np.arange(90_000)
    gyro = white(rng, t_s.size, 0.02)
    gyro[25_000:25_500] += size_dps
    found = examine_static(StaticConfig(write_log(tmp_path / "moved.csv", t_s, gyro)))
    walk = found.noise.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert walk[1] < 60.0 * ARW_DPS_RT_S < walk[2]
    assert walk[2] / walk[1] < 1.1
    assert found.noise.figures["rate_random_walk"].value is None
    assert "the output jumps (at 50" in found.warnings[0]
    assert found.figures["mean_bias"].reason == "the output jumps within the record: cut out a rest"


def test_noise_of_any_kind_does_not_jump() -> None:
    """2 of 600 logs of ten kinds when this was written: white, 1/f, walks, filters, rounding, warm-ups, telegraphs."""
    rng = np.random.default_rng(6)
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    noise = white(rng, t_s.size)
    logs = (
        noise,
        noise + flicker(rng, t_s.size, 2e-3, 0.1),
        noise + np.cumsum(rng.normal(0.0, 1e-4, t_s.size)),
        noise + np.exp(-t_s / 300.0),
        np.round(noise / 0.02) * 0.02,
    )
    for gyro in logs:
        sums = CourseSums()
        sums.add(t_s, gyro, np.full(t_s.size, np.nan))
        steps = np.abs(np.diff(gyro))
        assert jumps_of(sums.course(), float(np.min(steps[steps > 0]))) == []


def course_of_log(t_s: Floats, gyro_dps: Floats) -> Course:
    sums = CourseSums()
    sums.add(t_s, gyro_dps, np.full(t_s.size, np.nan))
    return sums.course()


@pytest.mark.parametrize("seeds", [1, pytest.param(60, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])])
def test_noise_of_any_kind_has_no_trend(seeds: int) -> None:
    """One of a thousand is allowed to drift, one to settle, one to step."""
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    found = 0
    for seed in range(seeds):
        rng = np.random.default_rng([61, seed])
        noise = white(rng, t_s.size)
        logs = (
            noise,
            noise + flicker(rng, t_s.size, 1e-3, 0.1),
            noise + np.cumsum(rng.normal(0.0, 1e-5, t_s.size)),
            noise + np.cumsum(rng.normal(0.0, 1e-4, t_s.size)),
            noise + flicker(rng, t_s.size, 5e-4, 0.1) + np.cumsum(rng.normal(0.0, 1e-5, t_s.size)),
        )
        found += sum(trend_of(course_of_log(t_s, gyro), [], 0.0) != Trend() for gyro in logs)
    assert found <= stats.binom.isf(FALSE_ALARM, 5 * seeds, 3e-3)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("drift", "a straight drift, "),
        ("step", "the output jumps (at 1"),
        ("settling", "what settles as after power-on"),
    ],
)
def test_what_is_no_noise_is_no_random_walk(tmp_path: Path, kind: str, said: str) -> None:
    """Before: a walk of 5.5, 17 and 25 deg/h/√h, each with an interval that was far from none, and nothing said."""
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    off = {
        "drift": 20.0 / 3600.0**2 * t_s,
        "step": np.where(t_s > 1800.0, 0.005, 0.0),
        "settling": 0.02 * np.exp(-t_s / 400.0),
    }
    log = write_log(tmp_path / "log.csv", t_s, off[kind] + white(np.random.default_rng(62), t_s.size))
    found = examine_static(StaticConfig(log))
    figures = found.noise.figures
    assert figures["rate_random_walk"].value is None
    assert figures["bias_instability"].value is None
    assert figures["angle_random_walk"].low < 60.0 * ARW_DPS_RT_S < figures["angle_random_walk"].high  # type: ignore[operator]
    assert any(said in text for text in (*found.warnings, *found.notes))
    ramp = found.figures["rate_ramp"]
    assert (ramp.value is not None and ramp.low < 20.0 < ramp.high) == (kind == "drift")  # type: ignore[operator]


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_a_swing_is_no_random_walk(seed: int, tmp_path: Path) -> None:
    """Of 2 mdeg/s in two minutes: "50.1 (41.4 to 57.7) deg/h/√h" beside a floor that was a hundredth of such a walk."""
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    swing = 2e-3 * np.sin(2.0 * np.pi * t_s / 120.0)
    log = write_log(tmp_path / "log.csv", t_s, swing + white(np.random.default_rng(seed), t_s.size))
    found = examine_static(StaticConfig(log))
    walk = found.noise.figures["rate_random_walk"]
    assert walk.value is None
    assert walk.high is None or walk.high < 5.0
    _, low, high = interval(found, "mean_bias")
    assert low < 0.0 < high
    assert high - low < 10.0


def test_what_temperature_does_is_said_to_be_in_the_noise(tmp_path: Path) -> None:
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    temp_c: Floats = np.asarray(25.0 + 2.0 * np.sin(2.0 * np.pi * t_s / 1200.0))
    noise = white(np.random.default_rng(1), t_s.size)
    for slope, said in ((1e-3, 1), (0.0, 0)):
        log = write_log(tmp_path / f"{said}.csv", t_s, slope * temp_c + noise, temp_c)
        notes = examine_static(StaticConfig(log)).notes
        assert sum("follows the temperature" in note for note in notes) == said


def test_a_walk_beside_a_drift_is_told(tmp_path: Path) -> None:
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    rng = np.random.default_rng(66)
    walk = np.cumsum(rng.normal(0.0, 1e-4 * np.sqrt(0.1), t_s.size))
    log = write_log(tmp_path / "log.csv", t_s, 1000.0 / 3600.0**2 * t_s + walk + white(rng, t_s.size))
    found = examine_static(StaticConfig(log))
    told = found.noise.figures["rate_random_walk"].interval
    assert told is not None
    assert told[1] < 1e-4 * 216_000 < told[2]
    assert interval(found, "rate_ramp")[1] < 1000.0 < interval(found, "rate_ramp")[2]


def test_single_samples_far_off_are_set_aside_and_said(tmp_path: Path) -> None:
    """Before: 20 of 36,000 made half of the angle random walk as much again, unsaid."""
    rng = np.random.default_rng(64)
    gyro = white(rng, 36_000)
    gyro[rng.choice(gyro.size, 20, replace=False)] += 0.5
    found = examine_static(StaticConfig(write_log(tmp_path / "log.csv", 0.1 * np.arange(gyro.size), gyro)))
    walk = found.noise.angle_random_walk_deg_per_rt_h
    assert walk is not None
    assert walk[1] < 60.0 * ARW_DPS_RT_S < walk[2]
    assert found.set_aside == found.to_json()["samples_set_aside"] == 20
    assert any(text.startswith("20 single samples stand far off all others") for text in found.notes)


@pytest.mark.parametrize(
    "noise",
    [
        pytest.param(lambda rng: rng.laplace(0.0, 0.004, 20_000), id="laplace", marks=pytest.mark.slow),
        pytest.param(lambda rng: 0.004 * rng.standard_t(3, 20_000), id="student"),
        pytest.param(lambda rng: np.round(rng.normal(0.0, 0.4, 20_000)), id="steps", marks=pytest.mark.slow),
    ],
)
def test_a_noise_of_heavy_tails_stays_as_it_is(
    tmp_path: Path, noise: Callable[[np.random.Generator], Floats]
) -> None:
    gyro = noise(np.random.default_rng(65))
    found = examine_static(StaticConfig(write_log(tmp_path / "log.csv", 0.1 * np.arange(gyro.size), gyro)))
    assert found.set_aside == 0


@pytest.mark.slow
def test_a_telegraph_is_noise() -> None:
    rng = np.random.default_rng(67)
    t_s: Floats = np.asarray(0.1 * np.arange(36_000))
    telegraph = 0.01 * (np.cumsum(rng.random(t_s.size) < 1.0 / 2000.0) % 2)
    assert trend_of(course_of_log(t_s, telegraph + white(rng, t_s.size)), [], 0.0) == Trend()


@pytest.mark.parametrize("rows", [3, 50])
def test_a_few_rows_have_no_steps(tmp_path: Path, rows: int) -> None:
    log = write_log(tmp_path / "few.csv", 0.1 * np.arange(rows), white(np.random.default_rng(68), rows))
    assert examine_static(StaticConfig(log)).warnings == ()


def test_earth_rate_by_axis() -> None:
    assert earth_rate_dph(90.0, 90.0, 0.0) == pytest.approx(15.04106864)
    assert earth_rate_dph(42.0, -90.0, 0.0) == pytest.approx(-15.04106864 * np.sin(np.radians(42.0)))
    assert earth_rate_dph(60.0, 0.0, 0.0) == pytest.approx(15.04106864 / 2)
    assert earth_rate_dph(60.0, 0.0, 90.0) == pytest.approx(0.0, abs=1e-12)


def test_drift_and_temperature_are_told_apart(tmp_path: Path) -> None:
    """A box that heats and cools while the bias drifts: 20 deg/h each hour and 3 deg/h for each degree."""
    rng = np.random.default_rng(2)
    t_s = 0.1 * np.arange(72_000)
    temp_c = 25.0 + 8.0 * np.sin(2.0 * np.pi * t_s / 3000.0)
    gyro = white(rng, t_s.size) + (20.0 * t_s / 3600.0 + 3.0 * temp_c) / 3600.0
    found = examine_static(StaticConfig(write_log(tmp_path / "warm.csv", t_s, gyro, temp_c)))
    warm = found.figures["bias_temperature_sensitivity"]
    assert warm.interval is None or warm.interval[1] < 3.0 < warm.interval[2]


def test_drift_and_an_even_rise_of_temperature_are_not_told_apart(tmp_path: Path) -> None:
    """The thermometer's own noise would pass for what the temperature does."""
    rng = np.random.default_rng(5)
    t_s = 0.1 * np.arange(36_000)
    temp_c = np.round(25.0 + 20.0 * t_s / 3600.0, 1)
    gyro = white(rng, t_s.size) + 3.0 * temp_c / 3600.0
    found = examine_static(StaticConfig(write_log(tmp_path / "warm.csv", t_s, gyro, temp_c)))
    for name in ("rate_ramp", "bias_temperature_sensitivity"):
        assert found.figures[name].value is None
        assert found.figures[name].reason.startswith("the temperature changes evenly with time")


@pytest.mark.parametrize(("step_dps", "said"), [(0.004, False), (0.04, True)])
def test_steps_that_hide_the_noise_are_said(tmp_path: Path, step_dps: float, said: bool) -> None:
    """A mean of a tenth of a step is rounded to nothing, and the interval knows it."""
    t_s = 0.1 * np.arange(9000)
    gyro = np.random.default_rng(6).normal(0.1 * step_dps, 0.01, t_s.size)
    log = write_log(tmp_path / "steps.csv", t_s, step_dps * np.round(gyro / step_dps))
    found = examine_static(StaticConfig(log))
    assert any("in steps of 0.04 deg/s" in text for text in found.warnings) is said
    _, low, high = interval(found, "mean_bias")
    assert low < 360.0 * step_dps < high


@pytest.mark.slow
def test_noise_of_a_log_through_a_thermal_cycle(tmp_path: Path) -> None:
    """What temperature does is a thousand times what the noise leaves after averaging."""
    rng = np.random.default_rng(31)
    t_s = 0.5 * np.arange(8000)
    temp_c = 28.0 - 45.0 * np.cos(2.0 * np.pi * t_s / 3600.0)
    bend = 0.02 * (temp_c - 20.0) + 3e-4 * (temp_c - 20.0) ** 2
    gyro = rng.normal(0.0, 0.0184, t_s.size) + bend
    found = examine_static(StaticConfig(write_log(tmp_path / "cycle.csv", t_s, gyro, temp_c)))
    walk = found.noise.angle_random_walk_deg_per_rt_h
    assert walk is not None
    _, low, high = walk
    assert low < 60.0 * 0.0184 * np.sqrt(0.5) < high
    assert high < 1.2 * low
    assert any("is taken off before noise is told" in note for note in found.notes)
    assert found.noise.figures["bias_instability"].value is None


@pytest.mark.slow
def test_a_run_s_long_record(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = white(rng, 8000) + 0.001
    rows = [gyro_row(i / 10, f"{v:.6f}", status=int(i == 5)) for i, v in enumerate(values)]
    parts = [Part(rows, kind="static"), Part([gyro_row(900.0 + i / 10, "50.0") for i in range(40)], 50.0)]
    run = write_run(tmp_path / "run", parts, {"bench": {"latitude_deg": 90.0}})
    found = examine_static(StaticConfig(run))
    assert found.missing == 1
    assert found.samples == 7999
    assert interval(found, "mean_bias")[0] - interval(found, "bias_without_earth_rate")[0] == pytest.approx(
        15.04106864
    )
    turning = write_run(tmp_path / "turning", [Part([gyro_row(i / 10, "50.0") for i in range(40)], 50.0)])
    with pytest.raises(
        DataError, match=r"holds no samples at rest\. Record some with the static_allan profile"
    ):
        examine_static(StaticConfig(turning))


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        (
            "t_s,gyro_dps",
            "{t},nan",
            "fewer than two samples of the gyro are there that are neither empty nor infinite. Check its column",
        ),
        ("t_s,gyro_dps", "7,0.1", "t_s is 7 in every row. Log the time of each sample"),
        (
            "t_s,rate_dps,gyro_dps,temp_c",
            "{t}00,{t},{t},20",
            "is a table of data sets: `fit` and `report` take it",
        ),
        ("t_s,gyro_dps,temp_c", "{t}00,0.1,20", "they look like milliseconds"),
    ],
)
def test_logs_that_are_none_are_told_what_they_are(tmp_path: Path, header: str, row: str, said: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *(row.format(t=i) for i in range(60))]) + "\n")
    with pytest.raises(GyrocalError, match=re.escape(said)):
        examine_static(StaticConfig(path))


def test_late_samples_are_no_gaps_and_missing_ones_are() -> None:
    rng = np.random.default_rng(4)
    t_s = np.sort(0.02 * np.arange(5000) + rng.exponential(0.004, 5000))
    t_s[700:720] = t_s[719]
    kept = np.delete(t_s, np.arange(3000, 3003))
    cuts, tail = gaps(np.empty(0), kept[:4000], 0.02)
    assert cuts.tolist() == [3000]
    again, _ = gaps(tail, kept[4000:], 0.02)
    assert again.size == 0


@pytest.mark.parametrize("cuts", [[], [1, 700, 701, 3333]])
def test_a_course_is_the_same_however_it_is_read(cuts: list[int]) -> None:
    t_s = 0.1 * np.arange(5000)
    sums = CourseSums()
    for part in np.split(t_s, cuts):
        sums.add(part, 2.0 * part, np.full(part.size, np.nan))
    course = sums.course()
    assert 256 <= course.t_s.size <= 1024
    assert course.n.sum() == 5000
    np.testing.assert_allclose(course.gyro_dps, 2.0 * course.t_s)
    assert course.t_s[0] == pytest.approx(0.1 * (course.n[0] - 1) / 2)
    assert np.isnan(course.temp_c).all()


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_interval_of_the_mean_covers(tmp_path: Path) -> None:
    """White and 1/f noise that goes on below the record, to 1 uHz: at least 92 % (the fit allows for 200,000 s)."""
    runs, hits = 200, 0
    for k in range(runs):
        rng = np.random.default_rng([5, k])
        gyro = white(rng, 36_000) + flicker(rng, 36_000, 5e-4, 0.1)
        log = write_log(tmp_path / "still.csv", 0.1 * np.arange(gyro.size), gyro)
        low, high = interval(examine_static(StaticConfig(log)), "mean_bias")[1:]
        hits += low <= 0.0 <= high
    assert hits >= stats.binom.ppf(FALSE_ALARM, runs, 0.92)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_mean_of_a_walk_is_as_unsure_as_the_walk_went(tmp_path: Path, seed: int) -> None:
    """The mean of a walk of K over T is off its beginning by K sqrt(T / 3)."""
    samples, step_dps = 4000, 1e-4
    rng = np.random.default_rng([9, seed])
    gyro = np.cumsum(step_dps * rng.standard_normal(samples)) + 1e-3 * rng.standard_normal(samples)
    log = write_log(tmp_path / "walk.csv", np.arange(float(samples)), gyro)
    low, high = interval(examine_static(StaticConfig(log)), "mean_bias")[1:]
    ratio = 0.5 * (high - low) / 1.96 / (3600.0 * step_dps * np.sqrt(samples / 3.0))
    assert ratio == pytest.approx(1.0, abs=0.15)


def test_the_command_prints_and_writes(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    log = write_log(
        tmp_path / "still.csv", 0.1 * np.arange(20_000), white(rng, 20_000), np.full(20_000, 21.0)
    )
    out = tmp_path / "noise"
    result = CliRunner().invoke(gyrocal_command, ["noise", str(log), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "angle random walk" in result.output
    assert "the model fits averaging times from" in result.output
    assert sorted(p.name for p in out.iterdir()) == [
        "allan_deviation.png",
        "allan_deviation.svg",
        "course.png",
        "noise.html",
        "noise.json",
    ]
    page = (out / "noise.html").read_text(encoding="utf-8")
    assert '<p class="verdict plain">Angle random walk ' in page
    assert "no bias instability" not in page
    written = json.loads((out / "noise.json").read_text())
    assert written["schema"] == "gyrocal-noise/1"
    assert written["figures"]["angle_random_walk"]["interval_95"][0] > 0
    assert written["figures"]["clock_error"]["reason"] == "the nominal sample rate is not given (--rate-hz)"
    shown = CliRunner().invoke(gyrocal_command, ["noise", str(log), "--json"])
    assert json.loads(shown.stdout)["allan"] == written["allan"]


@pytest.mark.parametrize("options", [[], ["--bias-only"]])
def test_fit_says_what_a_record_at_rest_is_for(tmp_path: Path, options: list[str]) -> None:
    rows = [gyro_row(i / 10, f"{0.001 * (i % 7):.4f}") for i in range(400)]
    run = write_run(tmp_path / "run", [Part(rows, kind="static")])
    result = CliRunner().invoke(gyrocal_command, ["fit", str(run), "-o", str(tmp_path / "c.json"), *options])
    assert result.exit_code != 0
    assert "gyrocal noise" in str(result.exception or result.output)


def test_the_shipped_profile_at_rest_has_no_warning(tmp_path: Path) -> None:
    """Its soak is kept as means over a second, whose steps of a tenth had been taken for those of the samples."""
    rng = np.random.default_rng(23)
    step_dps = 0.00305
    parts = list[Part]()
    for kind, dt_s, samples, scatter_dps, digits in (
        ("soak", 1.0, 900, 1.4e-3, 0.1),
        ("static", 0.1, 9000, 4.4e-3, 1.0),
    ):
        gyro = np.round(rng.normal(-0.03, scatter_dps, samples) / (step_dps * digits)) * step_dps * digits
        rows = [gyro_row(1000.0 * len(parts) + dt_s * k, f"{x:.6f}") for k, x in enumerate(gyro)]
        parts.append(Part(rows, kind=kind, averaging_s=None if dt_s == 0.1 else dt_s))
    assert examine_static(StaticConfig(write_run(tmp_path / "run", parts))).warnings == ()
