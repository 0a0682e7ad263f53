"""What is to be added to a simulation holds the laws of the bench too, which no coefficient file keeps."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrocal.diagnosis.engine import Options, diagnose
from gyrocal.diagnosis.rows.columns import conditions_of
from gyrocal.diagnosis.rows.table_series import series_of_table
from gyrocal.diagnosis.versus.answer import (
    Comparison,
    Versus,
    _drop_interval,
    _jumped_meanwhile,
    _worse_at,
    counts_from_s,
    versus,
)
from gyrocal.diagnosis.versus.law import _without_unseen, left_by
from gyrocal.diagnosis.versus.law_file import python_file
from gyrocal.errors import DataError
from gyrocal.fusion.coefficients import Coefficients, Valid
from gyrocal.physics.terms import Term
from gyrocal.report.versus import LAW_PYTHON, law_files
from tests.diagnosis.versus.tables import SURFACE, plan, table
from tests.diagnosis.versus.test_law_file import function_of

NOISE_DPS = 3e-4


@pytest.mark.slow
def test_a_drift_of_the_bias_is_added_as_the_law_that_it_is() -> None:
    t, rate, temp = plan(8)
    drift = 20e-3 * t / 3600.0
    noise = np.random.default_rng(1).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    real = series_of_table(table("real.csv", t, rate, simulated + drift + noise, temp))
    answer = versus(real, series_of_table(table("sim.csv", t, rate, simulated, temp)), Options(heldout=False))
    assert [e.effect for e in answer.diagnosis.effects] == ["bias_drift"]
    assert answer.comparison is None
    difference = answer.match.difference
    # Noise, and the simulation's surface and the drift as they are estimated, in 104 sets.
    assert np.std(left_by(answer.law, difference)) < 1.2 * NOISE_DPS
    added = function_of(python_file(answer.law, answer.match.surface, "T.", "- f"))
    c = conditions_of(difference)
    law = added(rate, temp, t_s=t, since_power_on_s=c.need("since_power_on_s"))
    np.testing.assert_allclose(law, drift, atol=5 * NOISE_DPS)
    entry = answer.to_json()["law"]["terms"][-1]
    assert entry["effect"] == "bias_drift"
    low, high = entry["parameters"]["amplitude"]["interval_95"]
    assert low < 20.0 < high


@pytest.mark.slow
def test_a_name_takes_the_place_of_the_smooth_parts_that_stand_for_it() -> None:
    """With a law of time in a table its coefficient file holds the asymmetry as smooth parts: not twice, and by name."""
    t, rate, temp = plan(8)
    asymmetry = 900e-6 * np.maximum(rate, 0.0)
    warming = 20e-3 * np.exp(-t / 1500.0)
    noise = np.random.default_rng(2).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    lacking = asymmetry + warming
    real = series_of_table(table("real.csv", t, rate, simulated + lacking + noise, temp))
    answer = versus(real, series_of_table(table("sim.csv", t, rate, simulated, temp)), Options(heldout=False))
    terms = {e.get("effect"): e for e in answer.to_json()["law"]["terms"]}
    assert {"scale_asymmetry", "warm_up"} <= terms.keys()
    low, high = terms["scale_asymmetry"]["parameters"]["amplitude"]["interval_95"]
    assert low < 900.0 < high
    added = function_of(python_file(answer.law, answer.match.surface, "T.", "- f"))
    # Of the warm-up's beginning it says 14 to 25 mdeg/s.
    np.testing.assert_allclose(added(rate, temp, t_s=t, since_power_on_s=t), lacking, atol=7 * NOISE_DPS)


def warmed(sweeps: int) -> Versus:
    """A warm-up and a ripple over temperature, which a law of temperature and smooth parts follow."""
    t, rate, temp = plan(sweeps)
    lacking = 0.01 * np.exp(-t / 1500.0) + 0.004 * np.sin(2.0 * np.pi * temp / 25.0)
    noise = np.random.default_rng(2).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    real = series_of_table(table("real.csv", t, rate, simulated + lacking + noise, temp))
    answer = versus(real, series_of_table(table("sim.csv", t, rate, simulated, temp)), Options(heldout=False))
    return replace(answer, comparison=Comparison(2e-3, 1e-3, (5e-4, 1.5e-3), 140, 12, 4))


def test_a_law_that_helps_most_at_one_rate_and_spoils_another_is_not_added() -> None:
    """What no rate suffers from is worse at none in 98 of 100 trials at the least."""
    rng = np.random.default_rng(6)
    rate = np.tile([-50.0, -3.0, 3.0, 50.0], 40)
    noise = rng.normal(0.0, 1e-6, (300, rate.size))
    assert np.mean([bool(_worse_at(rate, grown)) for grown in noise]) < 0.02
    grown = np.where(np.abs(rate) == 3.0, -0.05, 0.001) + noise[0]
    assert _worse_at(rate, grown) == (-50.0, 50.0)
    gains = Comparison(0.2, 0.1, (0.05, 0.15), 160, 0, 0)
    assert (gains.helps, replace(gains, worse_at_dps=(50.0,)).helps) == (True, False)


def test_a_law_whose_signal_lies_in_one_stretch_of_the_record_has_a_sure_gain() -> None:
    """A warm-up of ten times the noise had a gain of -0.2 to 5.8 of 2.9: a third of all draws of its blocks had none of it."""
    rng = np.random.default_rng(8)
    block = np.repeat(np.arange(18), 7)
    law = np.where(block == 0, 15.0, 0.0)
    # As the other blocks know it: within a tenth.
    before = law + rng.normal(0.0, 1.5, block.size)
    low, high = _drop_interval(before, before - 0.9 * law, block)
    drop = np.sqrt(np.mean(before**2)) - np.sqrt(np.mean((before - 0.9 * law) ** 2))
    assert 0.8 * drop < low < drop < high < 1.2 * drop


def test_the_interval_of_a_gain_holds_what_the_next_run_gains_and_allows_for_errors_that_go_together() -> (
    None
):
    rng, block = np.random.default_rng(9), np.repeat(np.arange(20), 6)
    law, added = np.sin(0.1 * np.arange(120)), 0.7 * np.sin(0.1 * np.arange(120) + 0.3)
    for together in (0.0, 0.8):
        held = 0
        for _ in range(400):
            common = np.repeat(rng.normal(0.0, np.sqrt(together), 20), 6)
            before = law + common + rng.normal(0.0, np.sqrt(1.0 - together), 120)
            after = before - added
            by = 120 * (np.sqrt(np.mean(before**2)) + np.sqrt(np.mean(after**2)))
            low, high = _drop_interval(before, after, block)
            held += low < (2.0 * law @ added - added @ added) / by < high
        # 0.95, less four standard deviations of so many trials.
        assert held > 0.906 * 400


def test_a_law_of_noise_alone_has_no_sure_gain() -> None:
    """Eight columns fitted to the other folds: of so many runs without a law at most one in a hundred is told to gain."""
    rng, block = np.random.default_rng(10), np.repeat(np.arange(20), 5)
    sure = 0
    for _ in range(300):
        X, noise = rng.normal(size=(100, 8)), rng.normal(size=100)
        added = np.empty(100)
        for fold in range(5):
            held = block % 5 == fold
            added[held] = X[held] @ np.linalg.lstsq(X[~held], noise[~held], rcond=None)[0]
        sure += _drop_interval(noise, noise - added, block)[0] > 0.0
    assert sure <= 3


def test_rows_left_out_while_something_jumped_are_not_judged() -> None:
    """A jump of the scale factor, sure to p < 1e-12, had been no sure gain, for one tenth of the rows was on the wrong side of it."""
    surface = Coefficients({"model": "t"}, SURFACE, np.eye(12), Valid((-1.0, 1.0), (0.0, 1.0)))
    jump = Term("scale_step", {"amplitude": {"value": 300.0}, "at_s": {"value": 45.0}}, False)
    t_s = np.arange(10.0) * 10.0
    known_s = t_s[[0, 1, 2, 6, 7, 8, 9]]
    meanwhile = _jumped_meanwhile(replace(surface, terms=(jump,)), t_s, known_s)
    assert np.flatnonzero(meanwhile).tolist() == [3, 4, 5]
    assert not _jumped_meanwhile(replace(surface, terms=(jump,)), t_s, t_s).any()
    assert not _jumped_meanwhile(surface, t_s, known_s).any()
    late = replace(jump, parameters={**jump.parameters, "at_s": {"value": 85.0}})
    assert np.flatnonzero(_jumped_meanwhile(replace(surface, terms=(late,)), t_s, t_s[:8])).tolist() == [8, 9]


@pytest.mark.slow
def test_a_law_at_another_shape_than_the_search_found_gains_what_it_gains() -> None:
    """The gain of a warm-up beside a ripple had been 0.000: the law that was to be left out had another name."""
    effect = next(e for e in diagnose(warmed(12).match.difference).effects if e.effect == "warm_up")
    assert effect.improvement is not None
    assert effect.improvement.logloss_interval_95[0] > 1.0
    assert effect.improvement.heldout_rms_before_dps > 2.0 * effect.improvement.heldout_rms_after_dps


@pytest.mark.slow
def test_the_file_has_the_largest_terms_first_and_says_which_it_has_not() -> None:
    """Two dozen lines of which a few carry the law had stood in no order and without a word."""
    answer = warmed(8)
    source = law_files(answer)[LAW_PYTHON]
    assert isinstance(source, str)
    sizes = [float(s) for s in re.findall(r"e = e \+ .*  # (\S+) mdeg/s rms", source)]
    assert len(sizes) == len(answer.law.terms)
    assert sizes == sorted(sizes, reverse=True)
    told = source.split('"""')[1]
    lines = [float(s) for s in re.findall(r"^- .*; (\S+) mdeg/s rms$", told, re.MULTILINE)]
    assert lines == sorted(lines, reverse=True)
    assert answer.unseen is not None
    assert f"{answer.unseen.count} terms that models have which are about as likely are not in it" in told
    assert answer.to_json()["law"]["terms_unseen"]["count"] == answer.unseen.count
    assert "; ;" not in told


def test_terms_that_the_data_do_not_show_are_not_in_the_law() -> None:
    """An asymmetry of 250 ppm had stood among seven lags of a hundredth of the noise, which asked for times."""
    t, rate, temp = plan(8)
    noise = np.random.default_rng(4).normal(0.0, NOISE_DPS, t.size)
    recorded = SURFACE.output_dps(rate, temp) + 400e-6 * np.maximum(rate, 0.0) + noise
    difference = series_of_table(table("real.csv", t, rate, recorded, temp))
    asymmetry = Term("scale_asymmetry", {"amplitude": {"value": 400.0}}, True)
    lags = [
        Term("thermal_lag", {"amplitude": {"value": a}, "tau_s": {"value": 60.0}}, True) for a in (1e-4, 2e-4)
    ]
    valid = Valid((-100.0, 100.0), (-10.0, 50.0))
    law = Coefficients(
        {"model": "t"}, SURFACE, 1e-14 * np.eye(12), valid, terms=(lags[0], asymmetry, lags[1])
    )
    kept, unseen = _without_unseen(law, difference, ())
    assert kept.terms == (asymmetry,)
    assert unseen is not None
    assert unseen.count == 2
    lost = np.sum([lag.error_dps(conditions_of(difference), SURFACE) for lag in lags], axis=0)
    assert unseen.rms_dps == pytest.approx(np.sqrt(np.mean(lost**2)))
    assert np.all(np.diag(kept.covariance_dps2) >= 1e-14)
    assert np.diag(kept.covariance_dps2).max() > 1e-12
    # What has a name, or is seen, stays.
    assert _without_unseen(law, difference, {"thermal_lag"}) == (law, None)
    large = replace(lags[1], parameters={"amplitude": {"value": 1.0}, "tau_s": {"value": 60.0}})
    assert _without_unseen(replace(law, terms=(asymmetry, large)), difference, ())[1] is None


def test_what_is_no_output_of_a_gyro_is_named_whichever_side_it_is_on() -> None:
    t, rate, temp = plan(4)
    right = series_of_table(table("right.csv", t, rate, SURFACE.output_dps(rate, temp), temp))
    wrong = series_of_table(table("wrong.csv", t, rate, -SURFACE.output_dps(rate, temp), temp))
    for pair in ((right, wrong), (wrong, right)):
        with pytest.raises(DataError, match=r"wrong\.csv: .*sign of the output"):
            versus(*pair, Options(heldout=False))


def test_a_law_since_power_on_counts_from_the_same_instant_whatever_rows_are_left_out() -> None:
    t, rate, temp = plan(2)
    gyro = SURFACE.output_dps(rate, temp)
    difference = series_of_table(table("real.csv", t + 600.0, rate, gyro, temp))
    part = difference.take(np.arange(t.size) >= 10)
    assert counts_from_s(part) == counts_from_s(difference) == 0.0


@pytest.mark.slow
def test_a_warm_up_is_judged_where_the_others_enclose_its_time() -> None:
    """Of a fifth of the record its first tenth had most of it and could not be known from the rest: a right law was never sure."""
    t, rate, temp = plan()
    noise = np.random.default_rng(3).normal(0, NOISE_DPS, t.size)
    simulated = SURFACE.output_dps(rate, temp)
    real = simulated + 0.01 * np.exp(-t / 1200.0) + noise
    recorded = series_of_table(table("real.csv", t, rate, real, temp))
    found = versus(recorded, series_of_table(table("sim.csv", t, rate, simulated, temp)), Options())
    assert [e.effect for e in found.diagnosis.effects] == ["warm_up"]
    assert found.comparison is not None
    assert found.helps
    assert found.comparison.sets + found.comparison.beyond == t.size
    assert found.comparison.after_dps < 2.0 * NOISE_DPS < found.comparison.before_dps
    # One answer to what the law brings, and not a second one against a surface of its own.
    assert found.diagnosis.improvement is None
    assert not found.diagnosis.layers
