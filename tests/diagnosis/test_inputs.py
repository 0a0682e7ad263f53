"""What a diagnosis refuses, and says, before it looks for physics."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, diagnose, series_of
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.inputs import check_inputs
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import versus
from gyrocal.errors import DataError, InputError
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.surface import Surface
from gyrocal.records.datasets import DataSetTable, read_data_sets
from gyrocal.report.remarks import remark_words
from tests.diagnosis.concealed_bench import make_recording, write_run
from tests.records.whole import read_drive_log


def make_table(scale: float = 1.0, full_dps: float = 240.0) -> DataSetTable:
    """A table of 55 data sets without time stamps, heated and cooled."""
    rng = np.random.default_rng(1)
    rate = np.tile(np.linspace(-full_dps, full_dps, 11), 5)
    temp = np.repeat(np.array([-20.0, 20.0, 60.0, 40.0, 0.0]), 11) + rng.normal(0, 0.1, rate.size)
    gyro = scale * (1.002 * rate + 0.3) + 0.003 * rng.standard_normal(rate.size)
    return DataSetTable(Path("made.csv"), rate, gyro, temp)


def model(cubic_dps: float, linear_dps: float = 0.0) -> Coefficients:
    c = np.zeros((4, 3))
    c[1, 0], c[3, 0] = linear_dps, cubic_dps
    surface = Surface(c, 0.0, 100.0, 20.0, 30.0)
    return Coefficients({"model": "x"}, surface, np.eye(12) * 1e-8, Valid((-100.0, 100.0), (-10.0, 50.0)))


@pytest.mark.parametrize(
    ("scale", "said"),
    [(np.pi / 180, "rad/s"), (-1.0, "inverted"), (0.5, "half of the rate"), (1e-5, "does not follow")],
)
def test_another_unit_or_sign_is_refused_before_a_surface_swallows_it(scale: float, said: str) -> None:
    with pytest.raises(DataError, match=said) as caught:
        check_inputs(series_of_table(make_table(scale)), None)
    assert str(caught.value).startswith("made.csv: ")


def test_a_stuck_gyro_is_refused_at_any_rate() -> None:
    table = make_table()
    for rate in (table.rate_dps, np.zeros(table.rate_dps.size)):
        stuck = replace(table, rate_dps=rate, gyro_dps=np.ones(rate.size))
        with pytest.raises(DataError, match="stuck"):
            check_inputs(series_of_table(stuck), None)


def test_a_slip_of_the_pen_is_named_by_its_data_set() -> None:
    table = make_table()
    table.gyro_dps[5] = 1e30
    with pytest.raises(DataError, match=r"data set 6 .* says 1e\+30"):
        check_inputs(series_of_table(table), None)


def test_a_scale_far_off_is_said_and_a_sound_one_is_not() -> None:
    assert check_inputs(series_of_table(make_table()), None) == ()
    (note,) = check_inputs(series_of_table(make_table(0.8)), None)
    assert "0.802 times the rate" in remark_words(note)


def test_a_table_in_radians_is_said() -> None:
    table = make_table()
    rate_dps = np.tile([-50.0, -10.0, -1.0, 1.0, 10.0, 50.0], 50)[: table.rate_dps.size]
    for unit, said in ((1.0, 0), (np.pi / 180.0, 1)):
        gyro_dps = rate_dps * 1.01 + table.gyro_dps - table.rate_dps
        one = series_of_table(replace(table, rate_dps=unit * rate_dps, gyro_dps=unit * gyro_dps))
        assert sum("in rad/s" in str(note) for note in check_inputs(one, None)) == said


def test_a_clipped_gyro_is_not_taken_for_one_of_another_unit() -> None:
    table = make_table()
    np.clip(table.gyro_dps, -70.0, 70.0, out=table.gyro_dps)
    assert check_inputs(series_of_table(table), None) == ()


def test_kelvin_is_refused() -> None:
    table = make_table()
    with pytest.raises(DataError, match=r"from 253.2 to 333.\d °C, and no gyro works so hot. Convert"):
        check_inputs(series_of_table(replace(table, temp_c=table.temp_c + 273.15)), None)


def test_coefficients_of_another_gyro_are_refused() -> None:
    series = series_of_table(make_table())
    assert check_inputs(series, model(0.1)) == ()
    with pytest.raises(DataError, match="cannot be this gyro's: it has no output"):
        check_inputs(series, model(40.0))
    with pytest.raises(DataError, match="cannot be this gyro's: corrected with it"):
        check_inputs(series, model(0.0, linear_dps=60.0))


def test_coefficients_may_take_up_another_unit() -> None:
    """Who has forced a fit in counts per hour may diagnose with it."""
    series = series_of_table(make_table(2.0))
    assert check_inputs(series, model(0.0, linear_dps=50.0)) == ()
    with pytest.raises(DataError, match="twice the rate"):
        check_inputs(series, model(0.1))


def test_a_surface_without_an_output_says_what_to_do() -> None:
    with pytest.raises(DataError, match="fit again"):
        model(40.0).surface.output_dps(np.array([0.0, 200.0]), 20.0)


def test_one_row_is_refused_without_a_murmur_of_numpy() -> None:
    table = make_table()
    one = DataSetTable(table.source, table.rate_dps[:1], table.gyro_dps[:1], table.temp_c[:1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DataError, match="has 1 row; a diagnosis needs at least 12"):
            series_of_table(one)


@pytest.mark.parametrize("sets", [1, 2, 4, 6])
def test_a_run_of_a_few_data_sets_is_refused_with_how_many_it_takes(sets: int) -> None:
    """Thirty rows each: enough of them, but the layers have one for each set."""
    rows = sets * 30
    rng = np.random.default_rng(3)
    rate = np.repeat(np.linspace(-100.0, 100.0, sets), 30)
    t_s, temp = 4.0 * np.arange(rows, dtype=np.float64), 20.0 + np.linspace(0.0, 15.0, rows)
    table = DataSetTable(Path("r"), rate, rate + 1e-3 * rng.standard_normal(rows), temp, t_s=t_s)
    whole = series_of_table(table)
    run = replace(whole, is_table=False, set_index=np.repeat(np.arange(sets), 30))
    with pytest.raises(DataError, match=f"has {sets} data sets?, and .* needs at least [0-9]+ data sets"):
        check_inputs(run, None)


def test_no_scatter_and_shared_times_are_said() -> None:
    table = make_table()
    n = table.rate_dps.size
    std = np.full(n, 0.1)
    std[:8] = 0.0
    t_s = np.repeat(np.arange(n // 5) * 100.0, 5)
    series = series_of_table(replace(table, gyro_std_dps=std, n=np.full(n, 100.0), t_s=t_s))
    assert Remark(Said.NO_SPREAD, {"count": 8}) in series.notes
    assert Remark(Said.SAME_TIMES, {"count": n - n // 5}) in series.notes
    assert np.ptp(series.white_std_dps) == 0
    series = series_of_table(replace(table, gyro_std_dps=np.zeros(n), n=np.full(n, 100.0)))
    assert Remark(Said.NO_SPREAD, {"count": n}) in series.notes
    assert np.all(series.white_std_dps == 1.0)
    assert not series.states_noise
    # Of the others there is one sample each: nothing is known of their noise.
    series = series_of_table(replace(table, gyro_std_dps=0.1 - std, n=np.where(std == 0.0, 1.0, 100.0)))
    assert np.all(series.white_std_dps == 1.0)


@pytest.mark.slow
def test_a_table_without_time_states_nothing_in_time() -> None:
    """A jump between data sets 27 and 28, and no hours, seconds or rates of temperature anywhere."""
    table = make_table()
    table.gyro_dps[27:] += 0.15
    found = diagnose(table, options=Options(heldout=False))
    (effect,) = found.effects
    assert effect.effect == "bias_step"
    assert effect.beside == Remark(Said.BETWEEN_SETS, {"first": 27, "last": 28})
    low, high = effect.parameters["at_data_set"].interval_95
    assert 27.0 <= low < high <= 28.0
    assert {e.unit for e in effect.parameters.values()} <= {"mdeg/s", "1"}
    assert not {p.coordinate for p in found.located} & set(found.not_testable)
    assert not {p.unit for p in found.located} & {"s", "degC/min"}


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("rate_dps;gyro_dps;temp_c", "1,5;1,4;20,0", "separated by semicolons"),
        ("rate_dps\tgyro_dps\ttemp_c", "1.5\t1.4\t20.0", "separated by tabs"),
        ("t_s,left_m,right_m,gyro_dps,gyro_temp_c", "0,0,0,0,20", "with --robot"),
    ],
)
def test_a_file_of_another_kind_is_told_by_its_header(
    tmp_path: Path, header: str, row: str, said: str
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{header}\n{row}\n")
    with pytest.raises(InputError, match=said):
        read_data_sets(path)


def test_a_table_or_a_run_where_a_drive_log_is_wanted_says_so(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("rate_dps,gyro_dps,temp_c\n0,0,20\n")
    with pytest.raises(InputError, match="without --robot"):
        read_drive_log(path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds a run of the bench.*without --robot"):
        read_drive_log(tmp_path / "run")


def test_a_gyro_without_thermometer_is_taken_at_the_chambers_temperature(tmp_path: Path) -> None:
    whole = series_of(write_run_of(tmp_path / "whole"))
    blind = series_of(write_run_of(tmp_path / "blind", thermometer=False))
    assert Remark(Said.CHAMBER_FOR_GYRO) in blind.notes
    # After a ramp of up to 25 degC and a soak of three time constants the gyro is within 2 degC of the chamber.
    np.testing.assert_allclose(blind.temp_c[blind.is_set], whole.temp_c[whole.is_set], atol=2.0)


def write_run_of(directory: Path, *, thermometer: bool = True) -> Path:
    """A concealed recording, with the gyro's own temperature or without."""
    write_run(make_recording([], 5, "even"), directory)
    if thermometer:
        return directory
    journal = directory / "journal.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    for line in lines:
        file = directory / line["file"]
        text = re.sub(r"^([^,]*,[^,]+),[^,]*,", r"\1,,", file.read_text(), flags=re.MULTILINE)
        head = file.read_text().split("\n", 1)[0]
        file.write_text(head + "\n" + text.split("\n", 1)[1])
        line["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
    journal.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return directory


@pytest.mark.slow
def test_a_very_nonlinear_gyro_is_no_gyro_of_another_unit() -> None:
    rng = np.random.default_rng(2)
    rate = np.tile(np.linspace(-100.0, 100.0, 11), 6)
    temp = np.repeat(np.linspace(-10.0, 50.0, 6), 11) + rng.normal(0, 0.1, rate.size)
    # A fifth of the rate more at full scale, all of it cubic.
    gyro = rate + 20.0 * (rate / 100.0) ** 3 + 0.001 * rng.standard_normal(rate.size)
    found = diagnose(DataSetTable(Path("made.csv"), rate, gyro, temp), options=Options(heldout=False))
    assert found.surface is not None
    left = gyro - found.surface.surface.output_dps(rate, temp)
    # A cubic of the output is not the inverse of a cubic of the rate: some of it stays, and no more.
    assert np.std(left) < 1.0


def test_an_output_that_is_the_rate_itself_is_refused_unless_it_is_simulated() -> None:
    table = make_table()
    with pytest.raises(DataError, match=r"says what made.csv says in every row"):
        versus(series_of_table(table), series_of_table(table), Options(heldout=False))
    copied = replace(table, gyro_dps=table.rate_dps.copy())
    for coefficients in (None, model(0.1)):
        with pytest.raises(DataError, match="exactly the rate in every row"):
            diagnose(copied, coefficients)
    assert versus(series_of_table(table), series_of_table(copied), Options(heldout=False)).match.difference


def test_a_table_that_was_entered_twice_is_refused_and_single_copies_are_said() -> None:
    table = make_table()
    rows = np.tile(np.arange(table.rate_dps.size), 2)
    twice = replace(
        table, rate_dps=table.rate_dps[rows], gyro_dps=table.gyro_dps[rows], temp_c=table.temp_c[rows]
    )
    with pytest.raises(DataError, match="55 of 110 data sets repeat an earlier one"):
        check_inputs(series_of_table(twice), None)
    assert check_inputs(series_of_table(twice), None, ideal=True) == ()
    for column in (table.rate_dps, table.gyro_dps, table.temp_c):
        column[-2:] = column[:2]
    (note,) = check_inputs(series_of_table(table), None)
    assert str(note).startswith("2 of 55 data sets repeat an earlier one")
    # Measured again later they agree by chance.
    assert check_inputs(series_of_table(replace(table, t_s=60.0 * np.arange(55.0))), None) == ()


def test_a_temperature_that_never_changes_is_said() -> None:
    table = make_table()
    constant = replace(table, temp_c=np.full(table.rate_dps.size, 20.0))
    assert str(series_of_table(constant).notes[0]).startswith("temp_c is 20 degC in every row")
    # Of one that scatters the output knows nothing here.
    assert [n.said for n in series_of_table(table).notes if isinstance(n, Remark)] == [Said.SMOOTHED]


def test_rates_that_were_mixed_up_are_said() -> None:
    table = make_table()
    table.rate_dps[[10, 11]] = table.rate_dps[[11, 10]]
    (note,) = check_inputs(series_of_table(table), None)
    assert remark_words(note).startswith("data sets 11, 12 are far off the line of the others")


def test_a_temperature_that_goes_one_way_is_said() -> None:
    """Time and temperature are one there: a drift of the bias stands in the surface, with the noise for its uncertainty."""
    table = make_table()
    assert check_inputs(series_of_table(table), None) == ()
    for rose in (True, False):
        order = np.argsort(np.round(table.temp_c), kind="stable")[:: 1 if rose else -1]
        columns = table.rate_dps[order], table.gyro_dps[order], table.temp_c[order]
        (said,) = check_inputs(series_of_table(DataSetTable(table.source, *columns)), None)
        assert said == Remark(Said.ONE_WAY, {"rose": rose})
        assert remark_words(Remark(Said.ONE_WAY, {"rose": rose})).startswith("the temperature")


@pytest.mark.parametrize(("temps_c", "said"), [((20.0, 60.0, -10.0, 40.0), True), ((25.0,), False)])
def test_what_a_few_temperatures_cannot_tell_is_said(temps_c: tuple[float, ...], said: bool) -> None:
    rates = np.linspace(-100.0, 100.0, 15)
    rate_dps, temp_c = np.tile(rates, len(temps_c)), np.repeat(temps_c, rates.size)
    gyro_dps = rate_dps + 1e-3 * np.random.default_rng(1).standard_normal(rate_dps.size)
    notes = check_inputs(series_of_table(DataSetTable(Path("t.csv"), rate_dps, gyro_dps, temp_c)), None)
    few = Remark(Said.FEW_TEMPERATURES, {"count": 4, "branches": False})
    assert (few in notes) is said
    assert "nor has a hysteresis of the bias; turn at five or more" in remark_words(few)
    rested = Remark(Said.FEW_TEMPERATURES, {"count": 4, "branches": True})
    assert "has no name here; turn at five or more" in remark_words(rested)
