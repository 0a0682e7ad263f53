"""The page of a diagnosis, its pictures and files: with a known answer, without the finder."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal.calibration.datasets import load_recording
from gyrocal.calibration.noise import noise_figures
from gyrocal.commands.diagnose import (
    DiagnoseConfig,
    diagnosis_files,
    with_noise_at_rest,
    write_diagnosis,
)
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis, Located
from gyrocal.errors import InputError, OutputError
from gyrocal.physics.catalogue import CATALOGUE
from gyrocal.physics.conditions import Conditions
from gyrocal.physics.fold import plain
from gyrocal.records.run import read_run
from gyrocal.report.diagnosis import (
    diagnosis_page,
    figures,
    tables,
)
from gyrocal.report.diagnosis_figures import before_and_after
from gyrocal.report.folds import Fold, beyond_surface, bin_rows, clusters, coordinate_of, fold, fold_of
from gyrocal.report.sentences import not_testable_sentences, plain_sentences
from tests.calibration.runs import Part, gyro_row, write_run
from tests.diagnosis.concealed_bench import make_recording
from tests.diagnosis.made_up import made_up_diagnosis

ONE_OF_EACH_COORDINATE = (
    "shupe_gradient",
    "thermal_lag",
    "warm_up",
    "scale_drift",
    "step_response",
    "supply_voltage",
    "table_eccentricity",
)


def _quiet(share: float, what: str) -> None:
    """No progress is shown."""


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return made_up_diagnosis(make_recording([("shupe", 20.0), ("table_eccentricity", 20.0)], 7, "even"))


@pytest.fixture(scope="module")
def files(found: Diagnosis) -> dict[str, bytes | str]:
    return diagnosis_files(found, figures(found), {"software": "gyrocal"}, _quiet)


@pytest.mark.parametrize("effect", ONE_OF_EACH_COORDINATE)
def test_every_effect_is_seen_on_its_own_coordinate(effect: str) -> None:
    """Before, the fold follows the law; after, 95 % intervals hold zero as often as they state (binomial, 1e-4)."""
    diagnosis = made_up_diagnosis(make_recording([(effect, 60.0)], 11, "even"))
    rows = diagnosis.rows
    assert rows is not None
    folded = fold(rows, diagnosis.effects[0])
    assert folded is not None
    visible = np.ptp(folded.law)
    assert visible > 0
    assert np.ptp(folded.after) < visible
    # The weighted slope of residual on law is one before and zero after.
    weight = folded.law - folded.law.mean()
    slope = [float(weight @ y / (weight @ weight)) for y in (folded.before, folded.after)]
    assert slope == pytest.approx([1.0, 0.0], abs=0.2)


def test_bins_are_levels_where_values_repeat_and_widths_where_they_do_not() -> None:
    levels, centres = bin_rows(np.array([3.0, 1.0, 3.0, 1.0]))
    assert levels.tolist() == [1, 0, 1, 0]
    assert centres.tolist() == [1.0, 3.0]
    _, near = bin_rows(np.linspace(-100.0, 100.0, 20_001), 0.1)
    assert np.count_nonzero(np.abs(near) < 0.1) >= 2
    _, many = bin_rows(np.linspace(0.0, 1.0, 1000))
    assert many.size == 24
    assert np.diff(many) == pytest.approx(np.full(23, 1 / 24), rel=0.02)


def test_every_bin_has_an_error_bar_even_with_one_data_set_in_it() -> None:
    """A warm-up is seen in ramps and soaks, of which a stretch of time has one: no scatter of its own."""
    diagnosis = made_up_diagnosis(make_recording([("warm_up", 20.0)], 7, "even"))
    assert diagnosis.rows is not None
    folded = fold(diagnosis.rows, diagnosis.effects[0])
    assert folded is not None
    white = float(np.median(diagnosis.rows.white_std_dps)) * 1e3
    assert np.all(np.isfinite(folded.std_error))
    assert folded.std_error.min() > white / np.sqrt(diagnosis.rows.t_s.size)
    before, after, noise = folded.rms()
    assert before > 3 * after
    assert noise > 0


def test_log_without_segments_scatters_between_stretches_of_time(found: Diagnosis) -> None:
    """Noise is correlated from row to row: error bars from the scatter of single rows would be too short."""
    rows = found.rows
    assert rows is not None
    assert np.unique(clusters(rows)).size == np.unique(rows.set_index).size
    n = rows.t_s.size
    still = replace(rows, rate_dps=np.zeros(n), set_index=np.arange(n))
    assert np.unique(clusters(still)).size == 120
    assert np.all(np.diff(clusters(still)) >= 0)


def test_order_stands_for_time_where_there_is_none(found: Diagnosis) -> None:
    assert found.rows is not None
    drift = replace(found.effects[0], effect="bias_drift")
    rows = replace(found.rows, effect_dps={"bias_drift": np.zeros(found.rows.t_s.size)})
    untimed = coordinate_of(rows, drift, has_time=False)
    assert untimed.label == "Data set, in the order recorded"
    assert untimed.x[[0, -1]].tolist() == [1.0, rows.t_s.size]


def test_effect_of_single_samples_is_not_folded(found: Diagnosis) -> None:
    bursts = replace(found.effects[0], effect="bursts")
    drawn = {p.name: (p, figure) for p, figure in figures(replace(found, effects=(bursts,)))}
    picture, figure = drawn["effect_bursts"]
    assert figure is None
    assert "single samples" in picture.missing


def test_legends_lie_outside_the_data(found: Diagnosis) -> None:
    for picture, figure in figures(found):
        assert figure is not None
        figure.draw_without_rendering()
        for axes in figure.axes:
            legend = axes.get_legend()
            if legend is not None:
                assert legend.get_window_extent().y0 >= axes.get_window_extent().y1 - 1, picture.name


def test_step_is_shown_in_its_own_unit(found: Diagnosis) -> None:
    diagnosis = made_up_diagnosis(make_recording([("scale_step", 20.0)], 7, "even"))
    assert diagnosis.rows is not None
    folded = fold(diagnosis.rows, diagnosis.effects[0], seen_dps=diagnosis.rows.effect_dps["scale_step"])
    assert folded is not None
    assert folded.coordinate.unit == "ppm of rate"
    assert np.ptp(folded.law) == pytest.approx(
        abs(diagnosis.effects[0].parameters["amplitude"].value), rel=0.02
    )


def test_before_is_what_the_surface_leaves_not_what_it_follows() -> None:
    """A difference between left and right is mostly slope, which the surface takes: its gain must not count that."""
    diagnosis = made_up_diagnosis(make_recording([("scale_asymmetry", 20.0)], 7, "even"))
    rows, effect = diagnosis.rows, diagnosis.effects[0]
    assert rows is not None
    whole = rows.effect_dps[effect.effect]
    seen = beyond_surface(rows, whole)
    assert np.std(seen[rows.is_set]) < 0.5 * np.std(whole[rows.is_set])
    # A refitted surface takes the same again: nothing is left to follow.
    assert beyond_surface(rows, seen) == pytest.approx(seen, abs=1e-12)
    folded = fold_of(diagnosis, effect)
    assert folded is not None
    assert np.ptp(folded.law) < 0.5 * np.ptp(whole) * 1e3
    assert diagnosis.surface is not None
    fitted = replace(diagnosis, surface=replace(diagnosis.surface, provenance={"by": "diagnose"}))
    exact = fold_of(fitted, effect)
    assert exact is not None
    assert np.ptp(exact.law) == pytest.approx(np.ptp(rows.before_dps - rows.after_dps) * 1e3, rel=1e-6)


def test_effect_without_its_channel_is_not_drawn(found: Diagnosis) -> None:
    assert found.rows is not None
    blind = replace(found.rows, temp_rate_c_per_min=np.full(found.rows.t_s.size, np.nan))
    assert np.isnan(coordinate_of(blind, found.effects[0]).x).all()
    drawn = {p.name: (p, figure) for p, figure in figures(replace(found, rows=blind))}
    picture, figure = drawn["effect_shupe"]
    assert figure is None
    assert "no coordinate" in picture.missing


def test_page_says_and_shows_everything(files: dict[str, bytes | str]) -> None:
    page = str(files["diagnosis.html"])
    assert set(files) >= {
        "diagnosis.json",
        "surface.json",
        "improved.json",
        "diagnosis.html",
        "figures/map.png",
    }
    # Self-contained: nothing is fetched.
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert page.count("data:image/png") == len([f for f in files if f.endswith(".png")]) == 6
    for text in ("shupe", "table_eccentricity", "Before", "acceleration"):
        assert text.lower() in page.lower()


def test_files_are_the_same_each_time(found: Diagnosis, files: dict[str, bytes | str]) -> None:
    assert diagnosis_files(found, figures(found), {"software": "gyrocal"}, _quiet) == files


def test_record_without_rows_has_a_page_too(found: Diagnosis) -> None:
    page = diagnosis_page(replace(found, rows=None), [], {})
    assert "Where the excess lives" in page


def test_recording_at_one_rate_says_why_there_is_no_map(found: Diagnosis) -> None:
    assert found.rows is not None
    still = np.zeros(found.rows.t_s.size)
    rows = replace(found.rows, rate_dps=still)
    missing = {
        p.name: p.missing for p, figure in figures(replace(found, rows=rows, effects=())) if figure is None
    }
    assert missing == {
        "map": "The recording has one rate only, so there is no surface to map.",
        "angle": "The table did not turn long enough.",
    }


def test_what_cannot_be_tested_is_said_once_a_reason(found: Diagnosis) -> None:
    reasons = {
        "shupe": "no ramp was logged",
        "shupe_gradient": "no ramp was logged",
        "supply": "it did not change",
    }
    assert not_testable_sentences(replace(found, not_testable=reasons)) == [
        "Not testable with this record: shupe, shupe_gradient, because no ramp was logged.",
        "Not testable with this record: supply, because it did not change.",
    ]


def test_each_thing_is_said_once(found: Diagnosis) -> None:
    twice = replace(found, sentences=("A.", "B."), notes=("A.", "c is new"), not_testable={})
    assert plain_sentences(twice) == ["A.", "B.", "C is new."]


def test_tables_hold_located_parameters_and_gain(found: Diagnosis) -> None:
    place = Located("rate", "variance", 1e-20, 0.5, remains=True, low=32.0, high=32.0, unit="deg/s")
    assert found.noise is not None
    noise = replace(found.noise, rate_random_walk_deg_per_h_per_rt_h=0.25)
    assert noise.to_json()["rate_random_walk_deg_per_h_per_rt_h"] == 0.25
    by_name = {t.name: t for t in tables(replace(found, located=(place,), noise=noise))}
    assert by_name["located"].rows == [("rate", "variance", "at 32 deg/s", "< 1e-12", "50%", "still there")]
    assert [r[1] for r in by_name["effects"].rows] == ["amplitude", "amplitude", "harmonic", "phase_rad"]
    assert [r[:2] for r in by_name["improvement"].rows] == [
        ("shupe", "surface and table_eccentricity"),
        ("table_eccentricity", "surface and shupe"),
        ("all named physics", "surface"),
    ]
    assert by_name["laws"].rows[0] == (
        "shupe",
        "e = k dT/dt",
        "Shupe, Applied Optics 19(5), 654-655 (1980)",
        "shupe_gradient, thermal_lag",
    )
    assert ["rate random walk", "0.25 deg/h/√h"] in [list(row) for row in by_name["noise"].rows]


def test_existing_output_is_refused_before_the_work(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "kept").write_text("mine")
    with pytest.raises(OutputError, match="exists and is not empty"):
        write_diagnosis(DiagnoseConfig(tmp_path / "none", out), _quiet)
    assert (out / "kept").read_text() == "mine"


def test_missing_recording_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        write_diagnosis(DiagnoseConfig(tmp_path / "none", tmp_path / "out"), _quiet)
    assert list(tmp_path.iterdir()) == []


def test_json_is_plain_and_finite(files: dict[str, bytes | str]) -> None:
    body = json.loads(files["diagnosis.json"])
    assert body["schema"] == "gyrocal-diagnosis/1"
    assert body["verdict"] == "explained"
    assert {e["effect"] for e in body["effects"]} == {"shupe", "table_eccentricity"}


def test_noise_figures_of_a_run_are_those_of_fit(found: Diagnosis, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [gyro_row(i / 10, f"{v:.6f}") for i, v in enumerate(rng.normal(0.0, 4.4e-3, 6000))]
    run = write_run(tmp_path / "run", [Part(rows, kind="static")])
    figure = noise_figures(load_recording(run)).angle_random_walk_deg_per_rt_h
    said = with_noise_at_rest(found, read_run(run)).noise
    assert figure is not None
    assert said is not None
    assert found.noise is not None
    assert said.angle_random_walk_deg_per_rt_h == figure[0]
    # Ten minutes of white noise resolve no bias instability: the model of the whole recording keeps its own.
    assert said.bias_instability_deg_per_h == found.noise.bias_instability_deg_per_h


def test_what_the_data_lack_stands_behind_all_that_was_found(found: Diagnosis) -> None:
    odd = replace(
        found,
        notes=(
            "run.json does not say profile",
            Remark(Said.UNUSABLE_SAMPLES, {"count": 2}),
            Remark(Said.TEMPERATURE_ALONE),
        ),
        not_testable={"supply": "it did not change"},
        next_experiment={"statement": "Measure at rest."},
    )
    last = [
        "Measure at rest.",
        "run.json does not say profile.",
        "2 gyro samples are empty or of bad status and left out.",
        "Not testable with this record: supply, because it did not change.",
    ]
    assert plain_sentences(odd)[-4:] == last
    page = diagnosis_page(odd, [], {})
    places = [
        page.index(text)
        for text in ("as far as this record can tell", last[0], "Limits of the data", *last[1:])
    ]
    assert places == sorted(places)
    told = diagnosis_page(replace(odd, notes=(*odd.notes, "It differs.")), [], {}, told=("It differs.",))
    assert told.index("It differs.") < told.index("Measure at rest.")


def test_a_zone_of_a_thousandth_of_the_range_is_seen(found: Diagnosis) -> None:
    """On a linear axis a dead zone of 0.08 deg/s had been one pixel of a picture from -100 to 100 deg/s."""
    rates = np.array([-100.0, -10.0, -1.0, -0.1, 0.0, 0.1, 1.0, 10.0, 100.0])
    axis = replace(plain("Table rate, deg/s", rates), linear_within=0.08)
    folded = Fold(axis, rates, 0.1 * rates, 0.0 * rates, np.ones(9), 0.1 * rates)
    figure = before_and_after(folded, found.effects[0])
    figure.draw_without_rendering()
    left, right = figure.axes
    (low, _), (high, _) = left.transData.transform([(-0.08, 0.0), (0.08, 0.0)])
    assert high - low > 0.15 * left.get_window_extent().width
    assert {"−100", "−0.1", "0", "0.1", "100"} <= {t.get_text() for t in left.get_xticklabels()}
    assert right.get_legend() is not None


def test_a_dead_zone_is_folded_on_the_rate_within_its_width() -> None:
    nothing = np.zeros(3)
    c = Conditions(t_s=nothing, rate_dps=np.array([-1.0, 0.0, 1.0]), temp_c=nothing)
    assert CATALOGUE["dead_zone"].fold_axis(c, {"width_dps": 0.05}, nothing).linear_within == 0.05
