"""What a user reads: rounded to what is known, never "nan", one line for what a name explains."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.result import Diagnosis, Estimate, Improvement, Located
from gyrocal.report.diagnosis import diagnosis_page, tables
from gyrocal.report.remarks import statement
from gyrocal.report.sentences import (
    Counted,
    counted,
    plain_sentences,
    short_data_sentences,
    short_sentences,
    traded_sentence,
    verdict_sentence,
)
from gyrocal.report.words import (
    estimate_text,
    fixed,
    interval_text,
    parameter_words,
    region_words,
    span_text,
    times_text,
    value_text,
)
from gyrocal.units import p_equals, p_text
from tests.diagnosis.concealed_bench import make_recording
from tests.diagnosis.made_up import made_up_diagnosis

#: Within the noise: the floor lies above the error before and after.
HIDDEN = Improvement(
    1.212e-3,
    1.078e-3,
    1.228e-3,
    (2e-5, 2.5e-4),
    37.24,
    36.37,
    (0.50, 1.28),
    float("nan"),
    Remark(Said.LEFT_OUT_SETS),
)


@pytest.fixture(scope="module")
def shupe() -> Diagnosis:
    return made_up_diagnosis(make_recording([("shupe", 20.0)], 7, "even"))


def _with_gain(found: Diagnosis, gain: Improvement | None) -> Diagnosis:
    effects = tuple(replace(e, improvement=gain) for e in found.effects)
    return replace(found, effects=effects, improvement=gain)


def _everything_read(d: Diagnosis) -> str:
    cells = [cell for t in tables(d) for row in t.rows for cell in row]
    return "\n".join([*plain_sentences(d), *cells, diagnosis_page(d, [], {})])


def test_error_within_the_noise_is_said_in_words(shupe: Diagnosis) -> None:
    """Before: "Excess removed nan%", and an rms that barely moves in front."""
    read = _with_gain(shupe, HIDDEN)
    text = _everything_read(read)
    assert not re.search(r"\bnan\b", text)
    assert "within the noise of such a mean (1.23 mdeg/s)" in text
    gain = next(s for s in plain_sentences(read) if "on data left out" in s)
    assert gain.startswith(
        "shupe: on data left out a segment becomes 2.4 times as probable (95 %: 1.6 to 3.6)"
    )
    folded = next(s for s in plain_sentences(read) if "its picture)" in s)
    assert folded.startswith("shupe: over temperature rate (its picture) the rms of the residual falls from ")
    assert next(t for t in tables(read) if t.name == "improvement").rows[0][6] == "within the noise"


def test_error_of_means_leads_where_it_shows_the_gain() -> None:
    found = made_up_diagnosis(make_recording([("scale_asymmetry", 20.0)], 7, "even"))
    gain = Improvement(
        2e-3, 1.2e-3, 1.1e-3, (5e-4, 9e-4), 1.5, 0.6, (0.5, 1.2), 0.9, Remark(Said.LEFT_OUT_SETS)
    )
    said = next(s for s in plain_sentences(_with_gain(found, gain)) if "left out" in s)
    assert said == (
        "scale_asymmetry: on data left out the rms of segment means falls from 2.00 to 1.20 mdeg/s (drop 0.50 to "
        "0.90 at 95 %), where noise alone would leave 1.10; a segment becomes 2.5 times as probable (95 %: 1.6 to 3.3)."
    )
    none = _with_gain(found, replace(gain, interval_95=(-1e-4, 9e-4), logloss_interval_95=(-0.1, 1.2)))
    assert next(s for s in plain_sentences(none) if "left out" in s).count("no sure gain") == 2


def test_errors_have_two_digits_of_the_noise_at_least(shupe: Diagnosis) -> None:
    """A drop that is known to tens left "60 to 6"."""
    wide = replace(
        HIDDEN, heldout_rms_before_dps=59.8e-3, heldout_rms_after_dps=6.15e-3, noise_floor_dps=5.67e-3
    )
    said = plain_sentences(_with_gain(shupe, replace(wide, interval_95=(0.040, 0.067), excess_removed=1.0)))
    assert any(
        "falls from 59.8 to 6.2 mdeg/s (drop 40 to 67 at 95 %), where noise alone would leave 5.7" in s
        for s in said
    )


def test_place_of_a_finding_is_not_its_whole_sentence(shupe: Diagnosis) -> None:
    """Single bad data sets: the sentence stood three times."""
    effect = shupe.effects[0]
    place = Located("data_set_index", "mean", 1e-20, 1.0, target="data sets", finding="shupe")
    found = replace(shupe, located=(place,))
    assert next(t for t in tables(found) if t.name == "located").rows[0][2] == "see shupe"
    assert sum(statement(effect) in s for s in plain_sentences(found)) == 1


def test_same_error_before_is_not_said_twice_of_one_effect(shupe: Diagnosis) -> None:
    """Two rows with two values of "before" were read as a mistake."""
    one = _with_gain(shupe, HIDDEN)
    assert [r[:2] for t in tables(one) if t.name == "improvement" for r in t.rows] == [("shupe", "surface")]
    assert not any("All named physics" in s for s in plain_sentences(one))
    two = made_up_diagnosis(make_recording([("shupe", 20.0), ("warm_up", 20.0)], 7, "even"))
    said = plain_sentences(_with_gain(two, HIDDEN))
    assert any(s.startswith("shupe, beside warm_up: ") for s in said)
    assert any(s.startswith("All named physics together, against the surface alone: ") for s in said)


def test_what_a_law_only_resembles_is_said_with_what_it_takes(shupe: Diagnosis) -> None:
    (effect,) = shupe.effects
    assert "only resembles" not in "\n".join(plain_sentences(shupe))
    resembling = replace(shupe, effects=(replace(effect, share=0.57),))
    told = "shupe only resembles it: the law takes 57 % of the evidence for this thermal transient"
    assert any(told in s for s in plain_sentences(resembling))
    in_name = plain_sentences(replace(shupe, effects=(replace(effect, share=0.002),)))
    assert any(
        "less than 1 % of the evidence for this thermal transient, too little to tell its" in s
        for s in in_name
    )
    assert not any(s.startswith("shupe: ") and "Amplitude" in s for s in in_name)
    # Beside what takes the rest its size may be zero, however sure it is that something is there.
    open_size = replace(effect.parameters["amplitude"], interval_95=(-1.0, 3.0))
    beside = replace(effect, share=0.1, parameters={**effect.parameters, "amplitude": open_size})
    assert not any("Amplitude" in s for s in plain_sentences(replace(shupe, effects=(beside,))))


def test_nothing_named_has_no_row_of_gain(shupe: Diagnosis) -> None:
    nothing = replace(shupe, effects=(), improvement=HIDDEN, verdict="unexplained")
    assert next(t for t in tables(nothing) if t.name == "improvement").rows == []
    assert "left out" not in " ".join(plain_sentences(nothing))
    assert "Held-out" not in diagnosis_page(nothing, [], {}).split("<h2>Figures")[0]


def test_large_errors_are_read_in_degrees(shupe: Diagnosis) -> None:
    large = replace(HIDDEN, heldout_rms_before_dps=1.82, heldout_rms_after_dps=0.47, noise_floor_dps=0.23)
    text = _everything_read(_with_gain(shupe, replace(large, interval_95=(1.1, 1.6), excess_removed=0.95)))
    assert "falls from 1.82 to 0.47 deg/s (drop 1.10 to 1.60 at 95 %)" in text


def test_explained_coordinates_are_one_line(shupe: Diagnosis) -> None:
    rate: dict[str, Any] = {"low": -1.5, "high": -0.6, "unit": "degC/min", "rms_dps": 1.1e-3}
    places = [
        Located("temperature_rate", "mean", 0.0, 1.0, **rate),
        Located("time", "mean", 1e-41, 0.9, low=0.0, high=2500.0, unit="s", target="bias", rms_dps=1.2e-3),
        Located("temperature_branch", "mean", 7e-12, 0.2, unit="degC/min", rms_dps=1.4e-3),
    ]
    said = plain_sentences(replace(shupe, located=tuple(places)))
    assert said[1] == (
        "The mean departs most in temperature rate -1.50 to -0.60 degC/min (1.1 mdeg/s rms), p < 1e-12; it is also "
        "seen in time and temperature branch."
    )
    assert "With shupe in the model nothing is left beyond the noise." in said


def test_what_is_left_is_said_once(shupe: Diagnosis) -> None:
    """Before: "noise is left", and on the same page that a pattern, which the improved file takes away, was still there."""
    curve = Located(
        "temperature", "mean", 1e-20, 0.9, True, curve=True, low=30.0, high=36.0, unit="degC", rms_dps=1.8e-3
    )
    found = replace(shupe, verdict="partly_explained", located=(curve,))
    (said,) = [s for s in plain_sentences(found) if "in the model" in s]
    assert said == (
        "With shupe and a curve without a name over temperature in the model nothing is left beyond the noise."
    )
    assert next(t for t in tables(found) if t.name == "located").rows[0][-1] == "a curve without a name"
    left = (
        curve,
        Located("table_angle", "mean", 1e-10, 1.0, True, rms_dps=2e-3),
        Located("rate", "variance", 1e-6, 1.0, True, low=32.0, high=32.0, unit="deg/s"),
    )
    (said,) = [s for s in plain_sentences(replace(found, located=left)) if "in the model" in s]
    assert said == (
        "With shupe and a curve without a name over temperature in the model there is left: table angle: all along "
        "(2 mdeg/s rms); scatter in rate at 32 deg/s."
    )


def test_the_strongest_place_is_said_first(shupe: Diagnosis) -> None:
    scatter = Located("rate", "variance", 1e-7, 0.6, True, low=32.4, high=32.4, unit="deg/s")
    mean = Located("temperature", "mean", 0.002, 0.5, True, curve=True, rms_dps=7.6e-3)
    first, second = plain_sentences(replace(shupe, located=(scatter, mean)))[1:3]
    assert first == "The scatter stands out most in rate at 32.4 deg/s, p = 1e-07."
    assert second.startswith("The mean departs most in temperature")


def test_where_nothing_stands_out_no_mean_departs(shupe: Diagnosis) -> None:
    """Before: "nothing beyond noise", and then where "the mean departs most"."""
    nothing = replace(shupe, effects=(), improvement=None, verdict="consistent")
    first, second = plain_sentences(nothing)[:2]
    assert first == "Beyond the error surface nothing stands out of the noise."
    assert second.startswith("It comes nearest to that in ")
    assert "departs" not in " ".join(plain_sentences(nothing))


def test_place_that_is_not_testable_is_not_named_so(shupe: Diagnosis) -> None:
    places = (
        Located("rate", "mean", 1e-51, 1.0, low=93.6, high=100.8, unit="deg/s"),
        Located("time_since_step", "mean", 0.005, 0.03),
    )
    untested = {"time_since_step": "a table carries no samples"}
    table = replace(shupe, located=places, not_testable=untested)
    assert "also seen in the rates measured before." in plain_sentences(table)[1]


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ({}, "everywhere"),
        ({"rms_dps": 1e-3}, "all along (1 mdeg/s rms)"),
        ({"target": "noise", "times_given": 4.2}, "noise 4.2 times what was given"),
        ({"low": 3.0, "high": 9.0, "unit": "data set"}, "data sets 3 to 9"),
        ({"low": 3.0, "high": 3.0, "unit": "data set"}, "data set 3"),
        (
            {"low": 0.0, "high": 7200.0, "unit": "s", "target": "one rate alone"},
            "0 to 2.0 h (one rate alone)",
        ),
        ({"rms_dps": 1e-3, "target": "scale factor"}, "all along (in proportion to the rate; 1 mdeg/s rms)"),
        ({"rms_dps": 2e-3, "target": "walk"}, "the bias walks at random (2 mdeg/s rms)"),
        (
            {"rms_dps": 2e-3, "target": "surface"},
            "the error surface itself is not the one given (2 mdeg/s rms); fit again",
        ),
        ({"low": 100.0, "high": 3000.0, "unit": "s", "target": "samples"}, "single samples, 0 to 0.83 h"),
    ],
)
def test_a_place_in_words(where: dict[str, Any], words: str) -> None:
    assert region_words(Located("time", "mean", 0.01, 0.5, **where)) == words


def test_log_at_one_rate_has_no_data_sets(shupe: Diagnosis) -> None:
    assert counted(shupe).each == "segment"
    rows = shupe.rows
    assert rows is not None
    n = rows.t_s.size
    still = replace(
        rows, rate_dps=np.zeros(n), set_index=np.arange(n), t_s=np.arange(n, dtype=np.float64) * 8.08
    )
    assert counted(replace(shupe, rows=still)) == Counted("step of 8.1 s", "8.1 s means")
    untimed = replace(shupe, rows=still, not_testable={"time": "the table has no t_s"})
    assert counted(untimed).each == "row"
    table = replace(rows, set_index=np.arange(n), is_set=np.ones(n, dtype=bool))
    assert counted(replace(shupe, rows=table)).each == "data set"
    few = replace(rows, set_index=np.zeros(n, dtype=np.int64))
    assert counted(replace(shupe, rows=few)).each == "stretch of time"
    assert counted(replace(shupe, rows=None, counted_in="block of 10 s")).each == "block of 10 s"


def test_amplitude_traded_for_a_shape_is_said_with_what_is_known() -> None:
    found = made_up_diagnosis(make_recording([("thermal_lag", 20.0)], 7, "even"))
    effect = replace(
        found.effects[0],
        parameters={
            "amplitude": Estimate(0.0331, 0.0179, "1", (0.011, 0.092)),
            "tau_s": Estimate(354.5, 92.2, "s", (244.7, 606.2)),
        },
        adds=Estimate(1.35, 0.02, "mdeg/s", (1.31, 1.39)),
    )
    assert traded_sentence(effect) == (
        "thermal_lag: this record cannot separate amplitude and tau, and each interval allows for the other; known is "
        "what the effect adds beyond the surface, 1.350 mdeg/s (95 %: 1.310 to 1.390) rms."
    )
    assert traded_sentence(replace(effect, adds=None)) == ""
    known = {**effect.parameters, "amplitude": Estimate(0.0331, 0.0002, "1", (0.0327, 0.0335))}
    assert traded_sentence(replace(effect, parameters=known)) == ""


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "text"),
    [
        (-0.9987, -1.0, -0.995, "1", "-0.9987 (95 %: -1.0000 to -0.9950)"),
        (1391.93, 1068.2, 1871.0, "s", "1390 s (95 %: 1070 to 1870)"),
        (3.4272, 3.0247, 3.8297, "mdeg/s", "3.43 mdeg/s (95 %: 3.02 to 3.83)"),
        (2.0, 2.0, 2.0, "1", "2"),
        (
            1e5,
            99942.0,
            math.inf,
            "ppm",
            "at least 100000 ppm, the bound of the catalogue (95 %: from 99942 on)",
        ),
        (0.0031, 0.0, 0.92, "1", "0.0031 (95 %: 0.00 to 0.92)"),
        (
            -10.0,
            -math.inf,
            -9.97,
            "mdeg/s",
            "at most -10.000 mdeg/s, the bound of the catalogue (95 %: up to -9.970)",
        ),
    ],
)
def test_value_and_interval_have_the_digits_of_the_half_width(
    value: float, low: float, high: float, unit: str, text: str
) -> None:
    assert estimate_text(Estimate(value, 1.0, unit, (low, high))) == text


def test_unknown_numbers_are_words() -> None:
    nan = float("nan")
    assert fixed(nan, 2) == "not known"
    assert value_text(Estimate(nan, nan, "s", (nan, nan))) == "not known"
    # An interval far wider than the value: it is not nothing.
    assert value_text(Estimate(0.042, 30.0, "1", (0.01, 60.0))) == "0.042"
    assert interval_text(Estimate(0.042, 30.0, "1", (0.01, 60.0))) == "0.010 to 60"
    assert interval_text(Estimate(0.0, nan, "1", (nan, nan))) == "chosen, not estimated"
    assert p_text(nan) == "not known"
    assert fixed(1.234e-9, 11) == "1.23e-09"
    assert fixed(-0.0004, 2) == "0.00"


def test_p_values_and_names_as_people_read_them() -> None:
    assert [p_text(p) for p in (0.0, 1e-12, 0.0123)] == ["< 1e-12", "1e-12", "0.012"]
    assert [p_equals(p) for p in (1e-40, 0.0054)] == ["p < 1e-12", "p = 0.0054"]
    assert parameter_words("tau_data_sets") == "tau"
    assert [parameter_words(n) for n in ("tau_s", "knee_dps", "amplitude")] == ["tau", "knee", "amplitude"]


def test_regions_are_rounded_to_their_length() -> None:
    assert span_text(0.0009722, 2.001) == "0 to 2.0"
    assert span_text(0.001475, 0.0506) == "0 to 0.051"
    assert span_text(48.213, 48.982) == "48.21 to 48.98"
    assert span_text(347.0, 375.9) == "347 to 376"


def test_the_short_answer_has_every_verdict_name_and_gain_and_no_detail() -> None:
    """A terminal had 85 to 108 lines, with "nats" and "folded" that nothing explained."""
    two = _with_gain(
        made_up_diagnosis(make_recording([("shupe", 20.0), ("warm_up", 20.0)], 7, "even")), HIDDEN
    )
    full, short = plain_sentences(two), short_sentences(two)
    assert set(short) < set(full)
    assert len(short) <= 10
    assert short[0] == verdict_sentence(two)
    assert [s for s in short if s.startswith(("shupe: ", "warm_up: "))] == [
        s for s in full if "95 %" in s and s.startswith(("shupe: ", "warm_up: "))
    ]
    assert any(s.startswith("All named physics together") for s in short)
    assert "With shupe and warm_up in the model nothing is left beyond the noise." in short
    assert not re.search(r"nats|folded|\(its picture\)", " ".join(short))
    untested = short_data_sentences(replace(two, notes=(), not_testable={"supply": "x", "shupe": "y"}))
    assert untested == ["Not testable with this record (why: see the page): supply, shupe."]


def test_evidence_is_odds_in_words() -> None:
    said = [times_text(nats) for nats in (0.015, 0.9, 6.27, -0.02, 35.2)]
    assert said == ["1.015", "2.5", "530", "0.980", "more than 1,000,000"]


def test_a_nat_is_explained_where_it_is_a_unit(shupe: Diagnosis) -> None:
    page = diagnosis_page(_with_gain(shupe, HIDDEN), [], {})
    assert "A nat is a unit of evidence" in page
    assert "A segment left out is" in page
