"""Tables of data sets at held temperatures, without times: what drifts between them did so for longer than their order says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.remarks import Remark, Said
from gyrocal.diagnosis.rows.order import LEAP_SETS, SURROGATE_PERIOD_S, clock_s, leaps_before
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.sweeps.unclocked import leaps
from gyrocal.fusion.compensation import Compensator
from gyrocal.records.datasets import DataSetTable
from gyrocal.report.remarks import remark_words

Floats = NDArray[np.float64]

RATES = np.linspace(-100.0, 100.0, 11)
CYCLE = np.array([-20.0, 0.0, 20.0, 40.0, 60.0, 50.0, 30.0, 10.0, -10.0])
SET_S, SOAK_S = 20.0, 2400.0


def held(temps: Floats, seed: int = 1) -> tuple[Floats, Floats, Floats]:
    """Rates in turn at each temperature, what the thermometer reads, and the times that no column has."""
    rng = np.random.default_rng(seed)
    rate = np.concatenate([rng.permutation(RATES) for _ in temps])
    number = np.repeat(np.arange(temps.size), RATES.size)
    temp = temps[number] + 0.05 * rng.standard_normal(rate.size)
    return rate, temp, SET_S * np.arange(rate.size) + SOAK_S * number


def table(rate: Floats, gyro: Floats, temp: Floats, t_s: Floats | None = None) -> DataSetTable:
    return DataSetTable(Path("sets.csv"), rate, gyro, temp, t_s=t_s)


def surface(rate: Floats, temp: Floats) -> Floats:
    u = temp / 40.0
    return np.asarray((1.0 + 2e-3 * u) * rate + 0.02 - 0.01 * u)


def test_a_leap_between_held_temperatures_takes_time_and_a_pause_in_a_drift_does_not() -> None:
    _, temp, _ = held(CYCLE)
    assert np.flatnonzero(leaps_before(temp)).tolist() == [11 * k for k in range(1, 9)]
    steps = np.diff(clock_s(temp)) / SURROGATE_PERIOD_S
    assert set(steps.tolist()) == {1.0, 1.0 + LEAP_SETS}
    _, rising, _ = held(np.sort(CYCLE))
    assert set(np.diff(clock_s(rising)).tolist()) == {SURROGATE_PERIOD_S}
    drifting = np.linspace(30.0, 50.0, 300) + 3.0 * (np.arange(300) > 150)
    assert not leaps_before(drifting).any()


def test_times_leave_no_leap() -> None:
    rate, temp, t_s = held(CYCLE)
    gyro = surface(rate, temp)
    counts = [leaps(series_of_table(table(rate, gyro, temp, times))) for times in (None, t_s)]
    assert counts == [8, 0]


@pytest.mark.slow
@pytest.mark.parametrize("timed", [False, True])
def test_a_drift_over_the_soaks_leaves_the_surface_as_it_is(timed: bool) -> None:
    """By the order alone it goes by steps: a hysteresis and an order of the temperature had been named in its place."""
    rate, temp, t_s = held(CYCLE)
    rng = np.random.default_rng(5)
    drift = 1.6e-3 * (t_s / t_s[-1] - 0.5) * rate
    gyro = surface(rate, temp) + drift + 2e-3 * rng.standard_normal(rate.size)
    found = diagnose(table(rate, gyro, temp, t_s if timed else None), options=Options(heldout=False))
    assert "scale_drift" in [e.effect for e in found.effects]
    told = [n for n in found.notes if isinstance(n, Remark) and n.said is Said.GIVE_TIMES]
    assert bool(told) != timed
    assert found.improved is not None
    again, at_c, times = held(np.array([55.0, 25.0, -5.0]), seed=9)
    right = Compensator(found.improved).correct(times, surface(again, at_c), at_c)
    # The mean of the drift is zero here, and nobody knows where it stands.
    assert np.std(right - again) < 0.012


@pytest.mark.slow
def test_a_transient_after_a_leap_is_told_and_not_taken_to_another_run() -> None:
    """How large one is depends on how long the temperature took, and a soak elsewhere is another."""
    rate, temp, t_s = held(CYCLE)
    rng = np.random.default_rng(6)
    number = np.repeat(np.arange(CYCLE.size), RATES.size)
    leap_c = np.diff(CYCLE, prepend=CYCLE[0])[number]
    within_s = t_s - t_s[11 * number]
    gyro = (
        surface(rate, temp) + 2e-3 * leap_c * np.exp(-within_s / 80.0) + 1e-3 * rng.standard_normal(rate.size)
    )
    found = diagnose(table(rate, gyro, temp), options=Options(heldout=False))
    (told,) = [n for n in found.notes if isinstance(n, Remark) and n.said is Said.GIVE_TIMES]
    assert told.facts["left_out"]
    assert "Give the times." in remark_words(told)
    assert found.improved is None or not any(term.has_memory for term in found.improved.runtime_terms())
