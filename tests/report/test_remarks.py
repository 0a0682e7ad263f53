"""Words of the remarks of a diagnosis."""

from __future__ import annotations

from typing import Any

import pytest

from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.report.remarks import WORDS, remark_words

SIDES = {"change": 1.0123, "least": 0.5, "most": 1.5}
LACKING = {
    "chance": 0.62, "rates": 0, "temps": 0, "one_way": False, "no_gain": False, "surface_alone": False,
}  # fmt: skip


def test_every_remark_has_words() -> None:
    assert set(WORDS) == set(Said)


def test_encoders_that_are_late_may_be_samples_of_the_gyro() -> None:
    """Half a row is no proof: on a drive whose rows held means, encoders that average had been told as samples."""
    words = remark_words(Remark(Said.SAMPLES_OF_ROWS))
    assert "sample" in words
    assert "encoders average or come late" in words


def test_what_a_reader_said_stays_as_it_is() -> None:
    assert remark_words("row 7 is empty") == "row 7 is empty"


@pytest.mark.parametrize(
    ("said", "facts", "words"),
    [
        (Said.STRAY_SAMPLES, {"count": 1}, "1 sample stands out of the noise"),
        (Said.STRAY_SAMPLES, {"count": 2}, "2 samples stand out of the noise"),
        (Said.STRANGE_SETS, {"sets": [(41, -20.0, 24.96, 312.4)]}, "number 41 (-20 deg/s at 25.0 degC, off by 312 mdeg/s)."),
        (Said.LARGEST_RATES, {"rates": [(54.12, -312.4, 15.2)]}, "The errors are largest at 54.12 deg/s (-312 +- 15 ppm)."),
        (Said.NOT_TEMPERATURE_ALONE, {"left_mdps": 1.23456, "branches_mdps": None}, "1.23 mdeg/s rms are left"),
        (Said.NOT_TEMPERATURE_ALONE, {"left_mdps": 1.0, "branches_mdps": 0.5}, "cooling differ by 0.5 mdeg/s rms"),
        (Said.NOT_WRITTEN, {"coordinate": "temperature_rate"}, "What follows temperature rate without a name"),
        (Said.SAMPLE_CLOCK, {"ppm": -120.4}, "Samples arrive 120 ppm sooner"),
        (Said.SAMPLE_CLOCK, {"ppm": 120.4}, "Samples arrive 120 ppm later"),
        (Said.GYRO_COLUMN, {"unit": "rad/s", "inverted": True}, "is in rad/s and with the sign inverted"),
        (Said.GYRO_COLUMN, {"unit": "", "inverted": True}, "is with the sign inverted"),
        (Said.DEAD_SETS, {"count": 5, "sets": 55, "lost_mdps": 12.345}, "exactly 0 in 5 of 55 data sets where the others say up to 12.3"),
        (Said.MISSING_ROWS, {"count": 1, "percent": 1.333, "longest_s": 0.8}, "About 1 row is missing (1.3 %"),
        (Said.UNUSABLE_SAMPLES, {"count": 1}, "1 gyro sample is empty or of bad status and left out"),
        (Said.UNUSABLE_SAMPLES, {"count": 3}, "3 gyro samples are empty or of bad status and left out"),
        (Said.MISSING_ROWS, {"count": 80, "percent": 1.333, "longest_s": 0.8}, "About 80 rows are missing (1.3 % of the log, the longest gap 0.8 s)."),
        (Said.SIDES_DIFFER, SIDES | {"or_moving_dps": None, "filed": True, "told": False}, "larger in turns to the left than in turns to the right; the robot file has it"),
        (Said.SIDES_DIFFER, SIDES | {"or_moving_dps": None, "filed": False, "told": False}, "By the truth the gyro's scale factor is 1.01 % (95 %: 0.5 to 1.5) larger in turns to the left"),
        (Said.SIDES_DIFFER, SIDES | {"or_moving_dps": (0.06125, 0.0128), "filed": False, "told": False}, "or its bias is +0.061 deg/s (95 %: +0.036 to +0.086) another while the robot moves: this drive does not tell which."),
        (Said.SIDES_DIFFER, SIDES | {"or_moving_dps": (0.06125, 0.0128), "filed": False, "told": True}, "this drive does not tell which, and the latter, which more gyros have, is what is told. Turn"),
        (Said.NO_SURE_GAIN, LACKING, "0.62 only: no improved coefficients are written, for what of it stays with the gyro is known no better than it is large: record"),
        (Said.NO_SURE_GAIN, {**LACKING, "surface_alone": True}, "for none of it stays with the gyro (it is the table's, or passes)"),
        (Said.NO_SURE_GAIN, {**LACKING, "no_gain": True}, "for on data left out it gains nothing for sure: record more sweeps of the same rates."),
        (Said.NO_SURE_GAIN, {**LACKING, "rates": 4, "temps": 3}, "for 4 rates carry a cubic and no more: record more of them; 3 temperatures carry"),
        (Said.NO_SURE_GAIN, {**LACKING, "one_way": True}, "for all rates are of one sign, so that"),
        (Said.NO_INVERSE, {"count": 1, "rate_dps": 90.0, "temp_c": 20.0}, "what was found 1 data set has an output that no rate gives (the first at +90 deg/s, 20.0 °C)"),
        (Said.MEANS_OF_ROWS, {"half_row_s": 0.05}, "Where rows hold the mean rate since the row before, as `replay` takes them (samples: 0.05 s more)"),
        (Said.STANDS, {"total_s": 20.6, "most_mps": 0.028}, "the speed reads up to 0.028 m/s where the gyro is as still as its own noise: 21 s are taken as rests"),
        (Said.CREEPS, {}, "it creeps there in an even bend, and no rest is taken of it"),
        (
            Said.TRUTH_SENSOR,
            {"lever_ahead": (0.4991, 0.0013), "lever_left": (-0.2, 0.0013), "clock": (0.25, 0.01)},
            "the truth is of a point 0.499 ± 0.001 m ahead and 0.2 ± 0.001 m to the right of the robot's middle and is 0.25 ± 0.01 s late: that is",
        ),
        (Said.TRUTH_SENSOR, {"clock": (-0.25, 0.01)}, "the truth is 0.25 ± 0.01 s early: that is taken out"),
        (Said.TRUTH_MIRRORED, {}, "the truth follows the path in a mirror only"),
    ],
)  # fmt: skip
def test_words(said: Said, facts: dict[str, Any], words: str) -> None:
    assert words in remark_words(Remark(said, facts))
