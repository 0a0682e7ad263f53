"""Where things are: a pattern without a name and a jump are told by their coordinate, and what is told is corrected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.answer.given import without_terms
from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.result import Diagnosis
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.datasets import DataSetTable
from tests.diagnosis.test_engine import make_table

_SETS, _PERIOD_S = 200, 60.0
_T_S: NDArray[np.float64] = _PERIOD_S * np.arange(_SETS, dtype=np.float64)


def rippled(seed: int, sets: int = 140, rates: int = 28) -> DataSetTable:
    """A table with a ripple over the rate, of which the catalogue has no law, at so many rates that it is no error of each."""
    plain = make_table(seed=seed, sets=sets, rates=rates)
    ripple_dps = 4e-3 * np.sin(2.0 * np.pi * plain.rate_dps / 43.0)
    return make_table(ripple_dps, seed=seed, sets=sets, rates=rates)


def at_rest(added_dps: NDArray[np.float64], timed: bool = True) -> DataSetTable:
    """Data sets at rest through a cycle of temperature, with noise of 0.2 mdeg/s."""
    temp = 25.0 + 10.0 * np.sin(_T_S / 1500.0)
    gyro = 0.01 + added_dps + 2e-4 * np.random.default_rng(0).standard_normal(_SETS)
    return DataSetTable(Path("rest.csv"), np.zeros(_SETS), gyro, temp, t_s=_T_S if timed else None)


@pytest.fixture(scope="module")
def ripple() -> Diagnosis:
    """The diagnosis of one such table."""
    return diagnose(rippled(0), options=Options(heldout=False))


@pytest.mark.slow
def test_a_pattern_without_a_name_is_placed_and_its_correction_makes_another_run_better(
    ripple: Diagnosis,
) -> None:
    found = ripple
    assert found.verdict == "unexplained"
    assert found.effects == ()
    (part,) = found.unnamed
    assert (part.coordinate, part.unit, part.corrected) == ("rate", "deg/s", True)
    assert part.evidence_nats > 20.0
    assert part.rms_dps == pytest.approx(4e-3 / np.sqrt(2.0), rel=0.4)
    assert part.low is not None
    assert part.high is not None
    assert -100.0 <= part.low <= part.high <= 100.0
    assert found.surface is not None
    assert found.improved is not None
    again = rippled(1)
    t_s = np.zeros(again.gyro_dps.size) if again.t_s is None else again.t_s
    before, after = (
        float(np.std(Compensator(c).correct(t_s, again.gyro_dps, again.temp_c) - again.rate_dps))
        for c in (found.surface, found.improved)
    )
    assert after < 0.5 * before


@pytest.mark.slow
def test_a_ripple_at_seven_sizes_of_rate_is_no_knee() -> None:
    """It may as well be an error of each; a law has no name for what smooth parts beside it explain."""
    found = diagnose(rippled(0, sets=98, rates=14), options=Options(heldout=False))
    assert {e.effect for e in found.effects} <= {"reference_rate_error"}
    assert found.verdict != "explained"


@pytest.mark.slow
def test_what_a_file_has_in_smooth_terms_is_taken_off_before_another_run_is_examined(
    ripple: Diagnosis,
) -> None:
    assert ripple.improved is not None
    again = series_of_table(rippled(1))
    left = without_terms(again, ripple.improved)
    surface = ripple.improved.surface
    own, bare = (
        float(np.std(surface.rate_dps(s.gyro_dps, s.temp_c) - again.rate_dps)) for s in (left, again)
    )
    assert own < 0.5 * bare


@pytest.mark.parametrize(
    ("timed", "unit", "ends"),
    [(True, "s", (119.5 * _PERIOD_S, _T_S[-1])), (False, "data set", (120.5, 200.0))],
)
def test_a_jump_is_placed_from_its_instant_to_the_end(
    timed: bool, unit: str, ends: tuple[float, float]
) -> None:
    found = diagnose(
        at_rest(np.where(np.arange(_SETS) >= 120, 3e-3, 0.0), timed), options=Options(heldout=False)
    )
    assert [e.effect for e in found.effects] == ["bias_step"]
    (place,) = [p for p in found.located if p.coordinate == ("time" if timed else "data_set_index")]
    assert place.unit == unit
    assert place.low == pytest.approx(ends[0], abs=0.5 * (_PERIOD_S if timed else 1.0))
    assert place.high == pytest.approx(ends[1])
    assert not place.remains
    assert place.rms_dps == pytest.approx(3e-3 * np.sqrt(0.4), rel=0.2)
